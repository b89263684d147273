"""Data snooping (W. Baarda 1968): one gross error after another, tested against its own deviation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from stereomate.errors import InputError
from stereomate.relative.coplanarity import CoplanarityAdjustment, adjust_coplanarity

# Fewer than this and every closure says the same thing: errors are seen but not located.
_LEAST_REDUNDANCY: Final = 2


@dataclass(frozen=True)
class SnoopingOptions:
    """Which test.

    Parameters
    ----------
    variance : {"prior", "estimated"}
        Residuals over their prior standard deviation (normal distribution), or over one estimated without the
        tested point (Student's distribution), where the noise is not known beforehand.
    largest_share : float
        Stop after rejecting this share of the points: then it is not gross errors that are wrong.
    """

    variance: Literal["prior", "estimated"] = "estimated"
    largest_share: float = 0.3

    def __post_init__(self) -> None:
        if self.variance not in ("prior", "estimated"):
            raise InputError("must be prior or estimated", field="variance", value=self.variance)
        if not 0.0 < self.largest_share < 1.0:
            raise InputError("must be a share below 1", field="largest_share", value=self.largest_share)


@dataclass(frozen=True)
class Rejection:
    """One point taken out.

    Parameters
    ----------
    point : int
        Row of the correspondences.
    test_value : float
        Its test value when it was taken out.
    y_parallax : float
        Its y-parallax then, in the unit of the correspondences.
    """

    point: int
    test_value: float
    y_parallax: float


def snoop(
    adjustment: CoplanarityAdjustment, options: SnoopingOptions | None = None
) -> tuple[CoplanarityAdjustment, tuple[Rejection, ...]]:
    """Take out the point with the largest test value and adjust again, until none exceeds the critical value.

    At the end the rejected points are tested once more, and those that fit come back.

    Returns
    -------
    adjustment : CoplanarityAdjustment
        Without the rejected points (they keep residuals).
    rejected : tuple of Rejection
        In the order they were found.
    """
    options = options or SnoopingOptions()
    most = int(options.largest_share * np.count_nonzero(adjustment.weights))
    rejected: list[Rejection] = []
    used = adjustment.weights > 0.0
    while len(rejected) < most and adjustment.redundancy >= _LEAST_REDUNDANCY:
        values, critical = _test_values(adjustment, options)
        worst = int(np.argmax(np.where(used, np.abs(values), -1.0)))
        if not abs(values[worst]) > critical:
            break
        parallax = float(adjustment.points().y_parallax[worst])
        rejected.append(Rejection(worst, float(values[worst]), parallax))
        used[worst] = False
        adjustment = _again(adjustment, used)
    # A point thrown out while another still pulled the result may fit after all.
    for rejection in tuple(rejected):
        values, critical = _test_values(adjustment, options)
        if abs(values[rejection.point]) <= critical:
            used[rejection.point] = True
            rejected.remove(rejection)
            adjustment = _again(adjustment, used)
    return adjustment, tuple(rejected)


def _again(adjustment: CoplanarityAdjustment, used: NDArray[np.bool_]) -> CoplanarityAdjustment:
    return adjust_coplanarity(adjustment.correspondences, adjustment.pose, adjustment.options, used.copy())


def _test_values(
    adjustment: CoplanarityAdjustment, options: SnoopingOptions
) -> tuple[NDArray[np.float64], float]:
    statistics = adjustment.points()
    w = statistics.standardized
    if options.variance == "prior":
        return w, adjustment.options.critical
    # Externally studentized: the variance without the tested point.
    redundancy = adjustment.redundancy
    total = adjustment.sigma0**2 * redundancy
    own = np.where(statistics.used, w**2, total / redundancy)
    without = np.maximum(total - own, 1e-12 * total) / max(redundancy - 1, 1)
    critical = float(student.isf(adjustment.options.alpha / 2.0, max(redundancy - 1, 1)))
    values: NDArray[np.float64] = w / np.sqrt(without) if total > 0.0 else np.zeros_like(w)
    return values, critical if math.isfinite(critical) else math.inf
