"""Hypotheses about an orientation, ranked by their fit to tie and control points, and how sure that is.

The score of a hypothesis is a sum of squares of its misfits over what they may be: the mean difference to
known points in height and in plan over the accuracy of a block (one GSD, or 0.03 per mille of the flying
height if that is more), and the excess of its squared image residuals over the best hypothesis' with a
hundred effective degrees of freedom (residuals of neighbours are alike: their count proves nothing).
Differences of scores are read like those of a chi-square: below 4 nothing is decided, above 25 all is.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import InputError
from stereomate.frames.audit.evaluation import ITERATIONS, Evaluator, Intersected
from stereomate.frames.audit.observations import AuditObservations
from stereomate.frames.audit.readings import (
    ADJUSTED_IN,
    WORK_WORDS,
    WORKS,
    AttitudeReading,
    HeightCandidate,
    Work,
)

Array = NDArray[np.float64]

_EFFECTIVE_FREEDOM: Final = 100.0
_SHARE_OF_HEIGHT: Final = 0.03e-3
_UNDECIDED, _LIKELY, _CERTAIN = 4.0, 9.0, 25.0


@dataclass(frozen=True)
class Differences:
    """Intersected minus known points, metres in map axes.

    Attributes
    ----------
    count : int
    mean, std, rms : (3,) tuple
        East, north, height of the map's x, y and ellipsoidal height.
    """

    count: int
    mean: tuple[float, float, float]
    std: tuple[float, float, float]
    rms: tuple[float, float, float]

    @classmethod
    def of(cls, differences: Array) -> Differences | None:
        """Of rows (n, 3); None without any."""
        rows = differences[np.isfinite(differences).all(axis=1)]
        if not len(rows):
            return None
        values = (rows.mean(axis=0), rows.std(axis=0), np.sqrt(np.mean(rows**2, axis=0)))
        mean, std, rms = ((float(v[0]), float(v[1]), float(v[2])) for v in values)
        return cls(len(rows), mean, std, rms)


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One way an orientation may have been made, and how it fits.

    Attributes
    ----------
    work : str
        See `readings.WORK_WORDS`.
    attitude : AttitudeReading
    heights, reference_heights : HeightCandidate
        Of the orientation, and of the control and other known points.
    image_rms_px : (float, float)
    points, control : Differences or None
        To known points that are no control, and to control.
    differences : ndarray (n, 3)
        Of every known point, NaN elsewhere.
    score : float
        Sum of squared misfits over their standard deviations.
    """

    work: Work
    attitude: AttitudeReading
    heights: HeightCandidate
    reference_heights: HeightCandidate
    image_rms_px: tuple[float, float]
    points: Differences | None
    control: Differences | None
    differences: Array
    score: float

    @property
    def name(self) -> str:
        """In words."""
        return (
            f"{WORK_WORDS[self.work]}; orientation in {self.heights.name}, known points in "
            f"{self.reference_heights.name}; angles {self.attitude.name}"
        )


@dataclass(frozen=True)
class AttitudeFit:
    """Image residuals of one reading of the attitudes, pixels; infinite where rays do not meet."""

    reading: AttitudeReading
    rms_px: tuple[float, float]

    @property
    def total_px(self) -> float:
        """Both coordinates together."""
        return float(np.hypot(*self.rms_px))


def rank_attitudes(
    evaluator: Evaluator,
    readings: Sequence[AttitudeReading],
    heights: Sequence[HeightCandidate],
    *,
    rough: bool = False,
) -> tuple[AttitudeFit, ...]:
    """Readings by their image residuals, the best first.

    A reading has to earn each error it supposes: one that fits as well as another of fewer errors comes after
    it, and equal ones stay in the order given.

    Parameters
    ----------
    heights : sequence of HeightCandidate
        Each reading is tried with all of them; the best fit counts.
    rough : bool
        Points are not adjusted: for a first choice among many.
    """
    fits = []
    for reading in readings:
        found = [_attitude_rms(evaluator, reading, candidate, rough) for candidate in heights]
        fits.append(AttitudeFit(reading, min(found, key=lambda rms: float(np.hypot(*rms)))))
    return ordered_attitudes(fits)


def ordered_attitudes(fits: Sequence[AttitudeFit]) -> tuple[AttitudeFit, ...]:
    """Fits in the order of `rank_attitudes`."""
    best = min(fits, key=lambda fit: fit.total_px)
    if not np.isfinite(best.total_px):
        return tuple(fits)

    def order(fit: AttitudeFit) -> float:
        return round(attitude_score(fit, best) + _UNDECIDED * fit.reading.mistakes, 6)

    return tuple(sorted(fits, key=order))


def _attitude_rms(
    evaluator: Evaluator, reading: AttitudeReading, heights: HeightCandidate, rough: bool
) -> tuple[float, float]:
    try:
        return evaluator.intersect("space", reading, heights, iterations=0 if rough else ITERATIONS).rms_px
    except InputError:  # coordinates that cannot be: the reading is no candidate
        return np.inf, np.inf


def attitude_score(fit: AttitudeFit, best: AttitudeFit) -> float:
    """Excess of squared residuals over the best reading's, with the effective degrees of freedom."""
    if not np.isfinite(fit.total_px):
        return np.inf
    return float(_EFFECTIVE_FREEDOM * ((fit.total_px / max(best.total_px, 1e-9)) ** 2 - 1.0))


Heights = tuple[HeightCandidate, HeightCandidate]


def rank_hypotheses(
    evaluator: Evaluator, attitudes: Sequence[AttitudeReading], pairs: Sequence[Heights]
) -> tuple[Hypothesis, ...]:
    """Every way of adjusting with every pair of height systems, the best first.

    Parameters
    ----------
    attitudes : sequence
        The readings that the image residuals allow.
    pairs : sequence
        Height systems of the orientation and of the known points, the declared ones first: of two that fit
        the same the earlier wins.

    Raises
    ------
    InputError
        If no reading makes rays meet.
    """
    found: list[Hypothesis] = []
    for attitude in attitudes:
        for heights, reference in pairs:
            try:
                known = evaluator.reference_map(reference)
            except InputError:  # outside the geoid grid: no candidate
                continue
            for work in WORKS:
                hypothesis = _evaluated(evaluator, work, attitude, heights, reference, known)
                if hypothesis is not None:
                    found.append(hypothesis)
    if not found:
        raise InputError(
            "no reading of the orientation makes the rays of its points meet", field="orientation"
        )
    best = min(float(np.hypot(*h.image_rms_px)) for h in found)
    sigma = accuracy_m(evaluator)
    scored = [_scored(h, best, sigma) for h in found]
    return tuple(sorted(scored, key=lambda h: round(h.score, 6)))


def accuracy_m(evaluator: Evaluator) -> float:
    """Standard deviation a block's points may have as a whole: one GSD, or 0.03 per mille of the flying
    height."""
    flying = flying_height_m(evaluator)
    return max(flying / float(np.median(evaluator.observations.c_px)), _SHARE_OF_HEIGHT * flying)


def flying_height_m(evaluator: Evaluator) -> float:
    """From the size of the block in the images: median distance of neighbours' rays, by their own heights."""
    obs = evaluator.observations
    centres = evaluator.block.positions[obs.photo_of, :2] * evaluator.ellipsoidal.unit_m
    # Two rays of a point: base over the difference of their directions, free of any height.
    order = np.argsort(obs.point_of, kind="stable")
    same = obs.point_of[order][1:] == obs.point_of[order][:-1]
    first, second = order[:-1][same], order[1:][same]
    base = np.linalg.norm(centres[first] - centres[second], axis=1)
    parallax = np.linalg.norm(obs.image[first] - obs.image[second], axis=1)
    good = parallax > 1e-3
    return float(np.median(base[good] / parallax[good])) if good.any() else 1.0


def _evaluated(
    evaluator: Evaluator,
    work: Work,
    attitude: AttitudeReading,
    heights: HeightCandidate,
    reference: HeightCandidate,
    known: Array,
) -> Hypothesis | None:
    try:
        met: Intersected = evaluator.intersect(
            work, attitude, heights, ground_height(evaluator.observations, known)
        )
    except InputError:  # below the ground, outside a geoid grid: no candidate
        return None
    if not np.isfinite(met.total_px):
        return None
    obs = evaluator.observations
    differences = met.points - known
    differences[:, :2] *= evaluator.ellipsoidal.unit_m
    return Hypothesis(
        work,
        attitude,
        heights,
        reference,
        met.rms_px,
        Differences.of(differences[~obs.control]),
        Differences.of(differences[obs.control]),
        differences,
        0.0,
    )


def ground_height(observations: AuditObservations, known: Array) -> float | None:
    """Ellipsoidal height a grid adjustment has its scale at: the mean control, else the mean known point."""
    for rows in (observations.control & observations.known, observations.known):
        if rows.any():
            return float(np.nanmean(known[rows, 2]))
    return None


def _scored(h: Hypothesis, best_px: float, sigma: float) -> Hypothesis:
    score = _EFFECTIVE_FREEDOM * ((float(np.hypot(*h.image_rms_px)) / max(best_px, 1e-9)) ** 2 - 1.0)
    # Control and earlier points each speak once: their differences are alike within the block.
    for part in (h.points, h.control):
        if part is not None:
            score += sum(value * value for value in part.mean) / sigma**2
    return Hypothesis(
        h.work,
        h.attitude,
        h.heights,
        h.reference_heights,
        h.image_rms_px,
        h.points,
        h.control,
        h.differences,
        float(score),
    )


@dataclass(frozen=True)
class Decision:
    """What the ranking says about one question.

    Attributes
    ----------
    margin : float
        Score of the best hypothesis with another answer minus that of the best; infinite without one.
    sure : str
        ``undecided``, ``likely``, ``very likely``, ``practically certain``.
    other : Hypothesis or None
        The best with another answer.
    """

    margin: float
    sure: str
    other: Hypothesis | None

    @property
    def decided(self) -> bool:
        """Whether the other answers can be left out."""
        return self.margin >= _UNDECIDED


def decide(ranked: Sequence[Hypothesis], answer: Callable[[Hypothesis], Hashable]) -> Decision:
    """How far the best hypothesis with another answer lies behind.

    Parameters
    ----------
    answer : callable
        What a hypothesis says to the question.
    """
    best = ranked[0]
    other = next((h for h in ranked if answer(h) != answer(best)), None)
    margin = np.inf if other is None else other.score - best.score
    return Decision(float(margin), certainty(float(margin)), other)


def certainty(margin: float) -> str:
    """A difference of scores in words."""
    if margin < _UNDECIDED:
        return "undecided"
    if margin < _LIKELY:
        return "likely"
    return "very likely" if margin < _CERTAIN else "practically certain"


def adjusted_in(hypothesis: Hypothesis) -> str:
    """The value of ``photos.adjusted_in`` a hypothesis asks for."""
    return ADJUSTED_IN[hypothesis.work]


@dataclass(frozen=True)
class PatternSlope:
    """Height differences of known points against a predicted pattern: 1 if it is the cause, 0 if not."""

    slope: float
    sigma: float
    spread_m: float

    @property
    def told(self) -> bool:
        """Whether the pattern varies enough over the block to speak."""
        return self.sigma < 0.25


def pattern_slope(differences: Array, pattern: Array) -> PatternSlope | None:
    """Slope of height differences (n,) against a pattern (n,), with its standard deviation.

    The standard deviation is that of residuals alike over a block of about twenty independent parts, at best.
    """
    good = np.isfinite(differences) & np.isfinite(pattern)
    if good.sum() < 10:
        return None
    p, d = pattern[good] - pattern[good].mean(), differences[good] - differences[good].mean()
    square = float(p @ p)
    if square < 1e-12:
        return None
    slope = float(p @ d) / square
    left = d - slope * p
    effective = min(int(good.sum()), 20)
    spread = float(p.std())
    return PatternSlope(slope, float(left.std()) / (spread * np.sqrt(effective - 2)), spread)
