"""The audit of an orientation: what its frame is, the evidence, how sure it is, and what stays open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from stereomate.frames.audit.evaluation import CommonTurn, Evaluator, common_turn
from stereomate.frames.audit.observations import AuditObservations, WrittenBlock
from stereomate.frames.audit.ranking import (
    AttitudeFit,
    Heights,
    Hypothesis,
    PatternSlope,
    accuracy_m,
    attitude_score,
    flying_height_m,
    ground_height,
    ordered_attitudes,
    pattern_slope,
    rank_attitudes,
    rank_hypotheses,
)
from stereomate.frames.audit.readings import (
    AttitudeReading,
    HeightCandidate,
    attitude_readings,
    combined_readings,
)
from stereomate.frames.audit.sentences import (
    Finding,
    adjusted_finding,
    attitude_findings,
    compared_only,
    evidence_sentences,
    explains,
    height_findings,
    unexplained,
)
from stereomate.frames.factors import grid_factors

# Points that the many first trials use; the survivors are judged with all.
_SAMPLE: Final = 250
# Hypotheses that lie further behind in the sample are not computed with all points.
_HOPELESS: Final = 1000.0
# Above this the rays of no single reading meet, and errors are combined; first with few points.
_MEET_PX: Final = 3.0
_FEW: Final = 40
_HOPEFUL: Final = 12
_CERTAIN: Final = 25.0


@dataclass(frozen=True, eq=False)
class Audit:
    """Result of an audit.

    Attributes
    ----------
    attitudes : tuple of AttitudeFit
        Readings of the attitudes, the best first.
    ranked : tuple of Hypothesis
        The best first, computed with all points.
    findings : tuple of Finding
    evidence, undecided : tuple of str
        Sentences: the numbers behind the findings, and what the data do not tell.
    turn : CommonTurn or None
        Of the attitudes as declared.
    accuracy_m, flying_height_m : float
        What differences are judged by.
    scale_excess_m : float
        (tau_e - 1) H: how far true positions and grid positions lie apart here.
    slope : PatternSlope or None
        Of height differences against the pattern of (tau_e - 1) H over the block.
    observations : AuditObservations
        Those used.
    """

    attitudes: tuple[AttitudeFit, ...]
    ranked: tuple[Hypothesis, ...]
    findings: tuple[Finding, ...]
    evidence: tuple[str, ...]
    undecided: tuple[str, ...]
    turn: CommonTurn | None
    accuracy_m: float
    flying_height_m: float
    scale_excess_m: float
    slope: PatternSlope | None
    observations: AuditObservations

    @property
    def best(self) -> Hypothesis:
        """The hypothesis that fits best."""
        return self.ranked[0]

    @property
    def explained(self) -> bool:
        """Whether known points are met to within three standard deviations in plan and height."""
        return explains(self.best, self.accuracy_m)


def audit(
    block: WrittenBlock,
    observations: AuditObservations,
    orientation_heights: Sequence[HeightCandidate],
    reference_heights: Sequence[HeightCandidate],
) -> Audit:
    """Which frame an orientation was made in.

    Parameters
    ----------
    block : WrittenBlock
    observations : AuditObservations
    orientation_heights, reference_heights : sequence of HeightCandidate
        Height systems to try for the orientation and for the known points; the declared one first.

    Raises
    ------
    InputError
        If no point is seen in two photographs, or no reading makes rays meet.
    """
    used = observations.usable()
    small = Evaluator(block, used.sample(_SAMPLE))
    declared = (orientation_heights[0], reference_heights[0])
    fits = attitude_fits(small, block, orientation_heights)
    allowed = [fit.reading for fit in fits if attitude_score(fit, fits[0]) < _CERTAIN][:3]
    pairs = _hopeful_pairs(small, allowed[:1], orientation_heights, reference_heights)
    evaluator = Evaluator(block, used)
    ranked = rank_hypotheses(evaluator, allowed or [fits[0].reading], pairs)
    reading = attitude_readings(block.convention)[0]
    turn = common_turn(small, reading, declared[0])
    excess, slope = _scale_pattern(evaluator, ranked)
    sigma = accuracy_m(evaluator)
    undecided: list[str] = []
    findings = attitude_findings(fits, undecided)
    if used.known.any():
        findings += height_findings(ranked, (len(orientation_heights), len(reference_heights)), undecided)
        findings.append(adjusted_finding(ranked, evaluator, excess, sigma, undecided))
        if not explains(ranked[0], sigma):
            findings = unexplained(findings, ranked[0], sigma, undecided)
    else:
        undecided.append(
            "without points of known ground nothing tells the heights' kind, nor whether the centres come "
            f"from an adjustment in the grid: the two meanings lie {excess:+.3f} m apart in height here"
        )
    if fits[0].total_px > _MEET_PX:
        findings = compared_only(findings, fits[0], undecided)
    return Audit(
        attitudes=fits,
        ranked=ranked,
        findings=tuple(findings),
        evidence=tuple(evidence_sentences(evaluator, ranked, fits, turn, excess, slope)),
        undecided=tuple(undecided),
        turn=turn,
        accuracy_m=sigma,
        flying_height_m=flying_height_m(evaluator),
        scale_excess_m=excess,
        slope=slope,
        observations=used,
    )


def _hopeful_pairs(
    evaluator: Evaluator,
    attitudes: Sequence[AttitudeReading],
    orientation_heights: Sequence[HeightCandidate],
    reference_heights: Sequence[HeightCandidate],
) -> list[Heights]:
    """Pairs of height systems that are not far off in a sample, the declared one first."""
    declared = (orientation_heights[0], reference_heights[0])
    if not evaluator.observations.known.any():
        return [declared]
    pairs = [(o, r) for r in reference_heights for o in orientation_heights]
    pairs.sort(key=lambda pair: pair != declared)
    if len(pairs) == 1:
        return pairs
    first = rank_hypotheses(evaluator, attitudes, pairs)
    near = [h for h in first if h.score < first[0].score + _HOPELESS]
    kept = [(h.heights, h.reference_heights) for h in near]
    return [pair for pair in pairs if pair in kept or pair == declared]


def attitude_fits(
    evaluator: Evaluator, block: WrittenBlock, heights: Sequence[HeightCandidate]
) -> tuple[AttitudeFit, ...]:
    """Single errors; where none makes the rays meet, several at once, and heights in another unit."""
    fits = rank_attitudes(evaluator, attitude_readings(block.convention), heights[:1])
    if fits[0].total_px < _MEET_PX:
        return fits
    units = {candidate.system.metres_per_unit: candidate for candidate in reversed(heights)}
    other_units = list(units.values())
    few = Evaluator(block, evaluator.observations.sample(_FEW))
    readings = (*attitude_readings(block.convention), *combined_readings(block.convention))
    first = rank_attitudes(few, readings, other_units, rough=True)
    hopeful = [fit.reading for fit in first[:_HOPEFUL]]
    again = rank_attitudes(evaluator, hopeful, other_units)
    tried = {fit.reading.name: fit for fit in (*fits, *again)}
    return ordered_attitudes(list(tried.values()))


def _scale_pattern(evaluator: Evaluator, ranked: Sequence[Hypothesis]) -> tuple[float, PatternSlope | None]:
    """(tau_e - 1) H in the mean, and whether height differences of true positions follow its pattern."""
    best = ranked[0]
    known = evaluator.reference_map(best.reference_heights)
    ground = ground_height(evaluator.observations, known)
    if ground is None:
        points = evaluator.block.positions
        tau, _ = grid_factors(evaluator.block.crs, points[:, 0], points[:, 1])
        return float((tau.mean() - 1.0) * flying_height_m(evaluator)), None
    pattern = evaluator.plane_scale_excess(best.heights, ground)
    space = next(
        (
            h
            for h in ranked
            if (h.work, h.heights, h.reference_heights) == ("space", best.heights, best.reference_heights)
        ),
        None,
    )
    slope = None if space is None else pattern_slope(space.differences[:, 2], pattern)
    return float(np.nanmean(pattern)), slope
