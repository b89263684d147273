"""Relative orientation of a pair from corresponding points, without approximate values: the whole way.

Search (five-point, robust), rigorous least squares, data snooping, diagnosis. What the points do not
determine is said in the result and refused when its elements are asked for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import InputError, NotDeterminedError
from stereomate.relative.coplanarity import (
    CoplanarityAdjustment,
    CoplanarityOptions,
    PointStatistics,
    adjust_coplanarity,
)
from stereomate.relative.diagnosis import (
    DiagnosisOptions,
    GeometryDiagnosis,
    diagnose,
    why_no_orientation,
)
from stereomate.relative.elements import Elements
from stereomate.relative.minimal import five_point, most_in_front
from stereomate.relative.pair import Correspondences, RelativePose
from stereomate.relative.robust import RobustOptions, robust_orientation
from stereomate.relative.snooping import Rejection, SnoopingOptions, snoop

# Below this the vote of random samples means nothing: all points count, gross errors are left to snooping.
_LEAST_FOR_VOTING: Final = 12


@dataclass(frozen=True)
class RelativeOptions:
    """Options of every step.

    Parameters
    ----------
    robust : bool or None
        Search for the orientation most points agree on; None: from twelve points on.
    snooping : SnoopingOptions or None
        Test for single gross errors after the search; None: no test.
    """

    robust: bool | None = None
    search: RobustOptions = field(default_factory=RobustOptions)
    adjustment: CoplanarityOptions = field(default_factory=CoplanarityOptions)
    snooping: SnoopingOptions | None = None
    diagnosis: DiagnosisOptions = field(default_factory=DiagnosisOptions)


@dataclass(frozen=True)
class RelativeOrientation:
    """Relative orientation with everything that is known about it.

    Parameters
    ----------
    pose : RelativePose
        Base direction and rotation; the best found, even where it is not determined.
    adjustment : CoplanarityAdjustment
        Least squares over the points used.
    diagnosis : GeometryDiagnosis or None
        None where the search found nothing worth looking at.
    reasons : tuple of str
        Why the orientation is not determined; empty if it is.
    samples : int
        Five-point problems solved by the search.
    rejected : tuple of Rejection
        Points taken out by data snooping.
    """

    pose: RelativePose
    adjustment: CoplanarityAdjustment
    diagnosis: GeometryDiagnosis | None
    reasons: tuple[str, ...]
    samples: int
    rejected: tuple[Rejection, ...] = ()

    @property
    def determined(self) -> bool:
        """The points determine the orientation."""
        return not self.reasons

    @property
    def used(self) -> NDArray[np.bool_]:
        """Points that took part in the adjustment, shape (n,)."""
        used: NDArray[np.bool_] = self.adjustment.weights > 0.0
        return used

    @property
    def sigma0(self) -> float:
        """Standard deviation of unit weight; NaN without redundancy."""
        return self.adjustment.sigma0

    @property
    def sampson_rms(self) -> float:
        """Root mean square Sampson distance of the points used, in the unit of the correspondences."""
        statistics = self.points()
        return float(np.sqrt(np.mean(statistics.sampson[statistics.used] ** 2)))

    @property
    def sampson_robust(self) -> float:
        """Scatter of the Sampson distances of all points, also of those left out: 1.4826 times their median.

        Unlike the root mean square of the points used it does not depend on where bad points are parted from
        good ones.
        """
        return 1.4826 * float(np.median(np.abs(self.points().sampson)))

    def require_determined(self) -> RelativeOrientation:
        """This orientation.

        Raises
        ------
        NotDeterminedError
            With the reasons, if the points do not determine it.
        """
        if self.reasons:
            raise NotDeterminedError("relative orientation: " + "; ".join(self.reasons))
        return self

    def dependent(self, bx: float = 1.0) -> Elements:
        """By, bz, omega, phi, kappa with covariance; NotDeterminedError where they are not determined."""
        return self.require_determined().adjustment.dependent(bx)

    def independent(self) -> Elements:
        """Phi1, kappa1, omega2, phi2, kappa2; NotDeterminedError where they are not determined."""
        return self.require_determined().adjustment.independent()

    def points(self) -> PointStatistics:
        """Residuals, y-parallaxes, redundancy numbers and tests of every point."""
        return self.adjustment.points()


def relative_orientation(
    correspondences: Correspondences, options: RelativeOptions | None = None
) -> RelativeOrientation:
    """Orient two photographs to each other from corresponding points, whatever their tilts.

    Parameters
    ----------
    correspondences : Correspondences
        At least five; gross errors are found if there are twelve or more (see `RelativeOptions.robust`).
    options : RelativeOptions, optional

    Raises
    ------
    InputError
        If there are fewer than five points.
    NotDeterminedError
        If no orientation at all has the points before both cameras.
    """
    options = options or RelativeOptions()
    n = len(correspondences)
    if n < 5:
        raise InputError("must be five points or more", field="correspondences", value=n)
    robust = n >= _LEAST_FOR_VOTING if options.robust is None else options.robust
    if n == 5:
        return _from_five(correspondences, options)
    if not robust:
        return _from_all(correspondences, options)
    found = robust_orientation(correspondences, options.search)
    if found.pose is None:
        raise NotDeterminedError(f"relative orientation: {why_no_orientation(correspondences)}")
    use = found.inliers
    if np.count_nonzero(use) < 6 or found.log10_false_alarms > -1.0:
        # As many points as chance puts near the epipolar lines of some orientation.
        reason = f"the points agree on no orientation: the best has {np.count_nonzero(use)} of {n}"
        everything = np.ones(n, dtype=np.bool_)
        shown = adjust_coplanarity(
            correspondences,
            found.pose,
            CoplanarityOptions(max_iterations=1),
            use if np.count_nonzero(use) >= 5 else everything,
        )
        return RelativeOrientation(found.pose, shown, None, (reason,), found.samples)
    adjustment = adjust_coplanarity(correspondences, found.pose, options.adjustment, use)
    return _finish(adjustment, options, found.samples)


def _finish(adjustment: CoplanarityAdjustment, options: RelativeOptions, samples: int) -> RelativeOrientation:
    rejected: tuple[Rejection, ...] = ()
    if options.snooping is not None and not adjustment.singular:
        adjustment, rejected = snoop(adjustment, options.snooping)
    diagnosis = diagnose(adjustment, options.diagnosis, options.search.seed)
    reasons = diagnosis.reasons
    if not adjustment.converged and not reasons:
        reasons = ("the adjustment does not converge",)
    return RelativeOrientation(adjustment.pose, adjustment, diagnosis, reasons, samples, rejected)


def _from_five(correspondences: Correspondences, options: RelativeOptions) -> RelativeOrientation:
    """Exactly five points: unique only if cheirality leaves one solution."""
    solutions = five_point(correspondences.left, correspondences.right)
    if not solutions:
        raise NotDeterminedError(f"relative orientation: {why_no_orientation(correspondences)}")
    adjustment = adjust_coplanarity(correspondences, solutions[0], options.adjustment)
    result = _finish(adjustment, options, 1)
    if len(solutions) == 1:
        return result
    several = f"{len(solutions)} orientations satisfy the five points: measure more"
    return RelativeOrientation(result.pose, adjustment, result.diagnosis, (several, *result.reasons), 1)


def _from_all(correspondences: Correspondences, options: RelativeOptions) -> RelativeOrientation:
    """All points are taken as good: the best minimum over the five-point solutions of many choices."""
    rng = np.random.default_rng(options.search.seed)
    n = len(correspondences)
    best: CoplanarityAdjustment | None = None
    tried = 0
    for _ in range(40):
        rows = np.sort(rng.choice(n, 5, replace=False))
        for start in five_point(correspondences.left[rows], correspondences.right[rows], in_front=4):
            tried += 1
            adjustment = adjust_coplanarity(correspondences, start, options.adjustment)
            if adjustment.singular or not math.isfinite(adjustment.sigma0):
                continue
            if best is None or adjustment.sigma0 < best.sigma0 * (1.0 - 1e-9):
                best = adjustment
    if best is None:
        raise NotDeterminedError(f"relative orientation: {why_no_orientation(correspondences)}")
    # Four of the points of a start were before the cameras: all of them decide for the same square sum.
    arranged = most_in_front(best.pose, correspondences)
    if max(arranged.angles_to(best.pose)) > 1e-6:
        best = adjust_coplanarity(correspondences, arranged, options.adjustment)
    return _finish(best, options, tried)
