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
    adjusted_in,
    attitude_score,
    certainty,
    decide,
    flying_height_m,
    ground_height,
    ordered_attitudes,
    pattern_slope,
    rank_attitudes,
    rank_hypotheses,
)
from stereomate.frames.audit.readings import HeightCandidate, attitude_readings, combined_readings
from stereomate.frames.factors import grid_factors

# Points that the many first trials use; the survivors are judged with all.
_SAMPLE: Final = 250
# Hypotheses that lie further behind in the sample are not computed with all points.
_HOPELESS: Final = 1000.0
# Above this the rays of no single reading meet, and errors are combined; first with few points.
_MEET_PX: Final = 3.0
_FEW: Final = 40
_HOPEFUL: Final = 12
_UNDECIDED: Final = 4.0
_CERTAIN: Final = 25.0


@dataclass(frozen=True)
class Finding:
    """What to put in the project file, and how sure that is.

    Attributes
    ----------
    key, value : str
        ``photos.heights`` and the like, and its value as TOML.
    sure : str
        ``practically certain``, ``very likely``, ``likely``, ``undecided``.
    sentence : str
        Why.
    """

    key: str
    value: str
    sure: str
    sentence: str


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
        """Whether known points are met to within three standard deviations in height."""
        parts = [part for part in (self.best.points, self.best.control) if part is not None]
        return all(abs(part.mean[2]) < 3.0 * self.accuracy_m for part in parts)


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
    fits = _attitude_fits(small, block, orientation_heights)
    allowed = [fit.reading for fit in fits if attitude_score(fit, fits[0]) < _CERTAIN][:3]
    pairs = [(o, r) for r in reference_heights for o in orientation_heights]
    pairs.sort(key=lambda pair: pair != declared)
    if not used.known.any():
        pairs = [declared]
    elif len(pairs) > 1:
        first = rank_hypotheses(small, allowed[:1], pairs)
        near = [h for h in first if h.score < first[0].score + _HOPELESS]
        kept = [(h.heights, h.reference_heights) for h in near]
        pairs = [pair for pair in pairs if pair in kept or pair == declared]
    evaluator = Evaluator(block, used)
    ranked = rank_hypotheses(evaluator, allowed or [fits[0].reading], pairs)
    reading = attitude_readings(block.convention)[0]
    turn = common_turn(small, reading, declared[0])
    excess, slope = _scale_pattern(evaluator, ranked)
    sigma = accuracy_m(evaluator)
    undecided: list[str] = []
    findings = _attitude_findings(fits, undecided)
    if used.known.any():
        findings += _height_findings(ranked, pairs, undecided)
        findings.append(_adjusted_finding(ranked, evaluator, excess, sigma, undecided))
    else:
        undecided.append(
            "without points of known ground nothing tells the heights' kind, nor whether the centres come "
            f"from an adjustment in the grid: the two meanings lie {excess:+.3f} m apart in height here"
        )
    return Audit(
        attitudes=fits,
        ranked=ranked,
        findings=tuple(findings),
        evidence=tuple(_evidence(evaluator, ranked, fits, turn, excess, slope)),
        undecided=tuple(undecided),
        turn=turn,
        accuracy_m=sigma,
        flying_height_m=flying_height_m(evaluator),
        scale_excess_m=excess,
        slope=slope,
        observations=used,
    )


def _attitude_fits(
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


def _attitude_findings(fits: Sequence[AttitudeFit], undecided: list[str]) -> list[Finding]:
    """One finding for each key that the best reading sets; readings that fit as well stay open."""
    best, second = fits[0], fits[1]
    for fit in fits[1:]:
        if attitude_score(fit, best) < _UNDECIDED:
            undecided.append(
                f"angles {fit.reading.name}: {fit.total_px:.3f} px against {best.total_px:.3f} px of the "
                f"best ({best.reading.name}); the photographs are too nearly level, or flown too straight"
            )
    sentence = f"{best.reading.name}: image residuals {best.total_px:.3g} px"
    found = []
    if best.reading.unsaid:
        words = ", ".join(best.reading.unsaid)
        other = next((fit for fit in fits if fit.reading.unsaid != best.reading.unsaid), None)
        margin = np.inf if other is None else attitude_score(other, best)
        found.append(
            Finding("photos (no key says it)", f"# {words}", certainty(margin), f"{sentence}; {_next(other)}")
        )
    elif not best.reading.keys:
        sure = certainty(attitude_score(second, best))
        found.append(
            Finding("photos (no key says it)", f"# {best.reading.name}", sure, f"{sentence}; {_next(second)}")
        )
    for key, value in best.reading.keys:
        other = next((fit for fit in fits if dict(fit.reading.keys).get(key) != value), None)
        margin = np.inf if other is None else attitude_score(other, best)
        found.append(Finding(key, value, certainty(margin), f"{sentence}; {_next(other)}"))
    return found


def _next(fit: AttitudeFit | None) -> str:
    if fit is None or not np.isfinite(fit.total_px):
        return "no other reading makes the rays meet"
    return f"{fit.total_px:.3g} px for the next, {fit.reading.name}"


def _height_findings(
    ranked: Sequence[Hypothesis], pairs: Sequence[Heights], undecided: list[str]
) -> list[Finding]:
    best = ranked[0]
    if len(pairs) == 0:
        return []
    found = []
    for key, word, part in (
        ("photos.heights", "the orientation's heights", lambda h: h.heights.value),
        ("control.heights", "the control's heights", lambda h: h.reference_heights.value),
    ):
        decision = decide(ranked, part)
        candidate = best.heights if key.startswith("photos") else best.reference_heights
        sentence = f"{word} are {candidate.name}"
        if decision.other is not None:
            sentence += (
                f"; otherwise known points would differ by {_height_of(decision.other):+.3f} m in height"
            )
        else:
            sentence += "; every other kind that was tried is far off"
        found.append(Finding(key, candidate.value, decision.sure, sentence))
    same = [h for h in ranked if h.heights.name == h.reference_heights.name]
    if len({h.heights.name for h in same if h.score < best.score + 4.0}) > 1:
        undecided.append(
            "orientation and known points are in one height system; the data do not tell which (the geoid is "
            "too even over the block)"
        )
    return found


def _adjusted_finding(
    ranked: Sequence[Hypothesis], evaluator: Evaluator, excess: float, sigma: float, undecided: list[str]
) -> Finding:
    best = ranked[0]
    decision = decide(ranked, adjusted_in)
    value = adjusted_in(best)
    words = {
        "grid": "the centres come from an adjustment in the grid and carry its scale in their heights",
        "space": "the centres are true positions",
    }
    sentence = words[value]
    if decision.other is not None:
        sentence += (
            f"; read the other way, known points would lie {_height_of(decision.other):+.3f} m in height "
            f"(here {_height_of(best):+.3f} m); (tau_e - 1) H is {excess:+.3f} m"
        )
    if value == "grid":
        known = evaluator.reference_map(best.reference_heights)
        ground = ground_height(evaluator.observations, known)
        if ground is not None:
            sentence += f"; the scale acts about the mean height of the control, {ground:.1f} m ellipsoidal"
    undecided += _ways_of_the_grid(ranked, decision.decided)
    if abs(excess) < 2.0 * sigma:
        undecided.append(
            f"adjusted in the grid or in space: the two lie only {abs(excess):.3f} m apart here, less than "
            f"twice the accuracy of {sigma:.3f} m"
        )
    elif decision.decided:
        undecided.append(
            f"an error of another origin of the same size and sign ({excess:+.3f} m in all heights) would "
            "look the same as the scale of the grid"
        )
    return Finding("photos.adjusted_in", f'"{value}"', decision.sure, sentence)


def _ways_of_the_grid(ranked: Sequence[Hypothesis], decided: bool) -> list[str]:
    """Which of the ways to adjust in the grid cannot be told apart."""
    best = ranked[0]
    alike = {
        h.work: h
        for h in ranked
        if (h.heights, h.reference_heights, h.attitude)
        == (best.heights, best.reference_heights, best.attitude)
    }
    if "curvature" not in alike or "cartesian" not in alike or (adjusted_in(best) == "space" and decided):
        return []
    curved, plain = alike["curvature"], alike["cartesian"]
    apart = abs(_height_of(curved) - _height_of(plain))
    margin = abs(curved.score - plain.score)
    if margin >= 9.0:
        return []
    return [
        (
            "whether that adjustment corrected the image coordinates for Earth curvature: with and without "
            f"it heights differ by {apart:.3f} m (image residuals {np.hypot(*curved.image_rms_px):.3f} and "
            f"{np.hypot(*plain.image_rms_px):.3f} px)"
        )
    ]


def _height_of(h: Hypothesis) -> float:
    """Mean height difference to known points: all, else control."""
    part = h.points or h.control
    return np.nan if part is None else part.mean[2]


def _evidence(
    evaluator: Evaluator,
    ranked: Sequence[Hypothesis],
    fits: Sequence[AttitudeFit],
    turn: CommonTurn | None,
    excess: float,
    slope: PatternSlope | None,
) -> list[str]:
    block, best = evaluator.block, ranked[0]
    middle = block.positions[:, :2].mean(axis=0)
    _, gamma = grid_factors(block.crs, middle[0], middle[1])
    lines = [
        (
            f"{len(evaluator.observations.names)} points, {len(evaluator.observations.point_of)} rays, "
            f"{len(block.positions)} photographs; flying height {flying_height_m(evaluator):.0f} m; "
            f"differences are judged by {accuracy_m(evaluator):.3f} m"
        )
    ]
    x, y = best.image_rms_px
    lines.append(f"image residuals {x:.3f} / {y:.3f} px (x, y) after forward intersection")
    for name, part in (("known points", best.points), ("control", best.control)):
        if part is not None:
            mean = " ".join(f"{value:+.3f}" for value in part.mean)
            std = " ".join(f"{value:.3f}" for value in part.std)
            lines.append(f"{name} ({part.count}): mean {mean} m, standard deviation {std} m")
    if turn is not None:
        about = ", ".join(
            f"{value:+.4f} ± {sigma:.4f}" for value, sigma in zip(turn.about_deg, turn.sigma_deg, strict=True)
        )
        lines.append(
            f"y-parallaxes ask for a common turn of all photographs as declared by {about} degrees about "
            f"east, north and up; the convergence of the grid is {np.rad2deg(float(gamma)):+.4f} degrees"
        )
    if slope is not None and adjusted_in(best) == "grid":
        told = "" if slope.told else "; the scale varies too little over the block for that to prove anything"
        lines.append(
            f"read as true positions, heights follow the pattern of the scale over the block with a slope of "
            f"{slope.slope:.2f} ± {slope.sigma:.2f} (1: the scale, 0: a constant){told}"
        )
    space = next((h for h in ranked if h.work == "space" and h.heights == best.heights), None)
    if space is not None and np.isfinite(_height_of(space)):
        lines.append(
            f"read as true positions, points lie {_height_of(space):+.3f} m in height; (tau_e - 1) H is "
            f"{excess:+.3f} m"
        )
    return lines
