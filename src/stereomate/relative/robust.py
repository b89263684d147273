"""Relative orientation without approximate values and with wrong matches: random sampling, then all points.

The kernel draws five points, solves, tests every solution by cheirality, scores it on a random subset and
refines each new best one; all points enter only at the end. The same seed gives the same result.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from stereomate.errors import InputError
from stereomate.relative.kernels.robust import robust_pose
from stereomate.relative.pair import Correspondences, RelativePose

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RobustOptions:
    """How the search samples and what it takes for a good point.

    Parameters
    ----------
    limit_sigmas : float
        Largest Sampson distance of a good point in the search, in standard deviations of its closure.
    confidence : float
        Probability of having drawn five good points at least once.
    least_samples, most_samples : int
        Bounds of the number of samples.
    subset : int
        Points on which hypotheses are scored.
    final_limit_sigmas : (float, float)
        Bounds of the limit for the final good points, which otherwise follows their estimated scatter.
    widening : float
        Factor by which the limit may grow where the noise turns out larger than stated.
    seed : int
        Of the random numbers.
    """

    limit_sigmas: float = 3.5
    confidence: float = 0.9999
    least_samples: int = 8
    most_samples: int = 20000
    subset: int = 1000
    final_limit_sigmas: tuple[float, float] = (0.0, 1e9)
    widening: float = 4.0
    seed: int = 0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.limit_sigmas) and self.limit_sigmas > 0.0):
            raise InputError("must be positive", field="limit_sigmas", value=self.limit_sigmas)
        if not 0.0 < self.confidence < 1.0:
            raise InputError("must be a probability below 1", field="confidence", value=self.confidence)
        if not 1 <= self.least_samples <= self.most_samples:
            raise InputError("must be at least 1 and at most most_samples", field="least_samples")
        if self.subset < 5:
            raise InputError("must be at least 5", field="subset", value=self.subset)
        low, high = self.final_limit_sigmas
        if not 0.0 <= low <= high:
            raise InputError("must be two growing numbers", field="final_limit_sigmas", value=(low, high))
        if not self.widening >= 1.0:
            raise InputError("must be at least 1", field="widening", value=self.widening)
        if not 0 <= self.seed < 2**63:
            raise InputError("must be an integer from 0", field="seed", value=self.seed)


@dataclass(frozen=True)
class RobustPose:
    """What the search found.

    Parameters
    ----------
    pose : RelativePose or None
        None where no sample gave an orientation.
    inliers : ndarray of bool, shape (n,)
        Points likelier good than bad.
    samples : int
        How many five-point problems were solved.
    scale : float
        Estimated scatter of good points, in their prior standard deviations.
    in_front : int
        Good points before both cameras.
    log10_false_alarms : float
        How many orientations as well supported one expects from random matches (decimal logarithm).
    """

    pose: RelativePose | None
    inliers: NDArray[np.bool_]
    samples: int
    scale: float
    in_front: int
    log10_false_alarms: float


def robust_orientation(correspondences: Correspondences, options: RobustOptions | None = None) -> RobustPose:
    """Find the relative orientation most points agree on.

    Parameters
    ----------
    correspondences : Correspondences
        At least five, any share of them wrong.
    options : RobustOptions, optional

    Raises
    ------
    InputError
        If there are fewer than five points.
    """
    options = options or RobustOptions()
    c = correspondences
    n = len(c)
    if n < 5:
        raise InputError("must be five points or more", field="correspondences", value=n)
    numbers = np.array(
        [
            options.limit_sigmas,
            options.confidence,
            options.least_samples,
            options.most_samples,
            options.subset,
            3.0,
            *options.final_limit_sigmas,
            options.widening,
        ]
    )
    base, rotation = np.array([1.0, 0.0, 0.0]), np.eye(3)
    inliers, out = np.zeros(n, dtype=np.bool_), np.zeros(8)
    found = robust_pose(
        c.left,
        c.right,
        _variances(c.left_covariance, c.weights),
        _variances(c.right_covariance, c.weights),
        numbers,
        options.seed,
        base,
        rotation,
        inliers,
        np.empty((5, 5)),
        out,
    )
    if not found:
        return RobustPose(None, inliers, int(out[0]), math.nan, 0, math.inf)
    count = int(out[3])
    return RobustPose(
        RelativePose(base, rotation),
        inliers,
        int(out[0]),
        float(out[4]),
        int(out[6]),
        _false_alarms(c, int(out[1]), int(out[2]), options.limit_sigmas) if count >= 5 else math.inf,
    )


def _variances(covariance: Array, weights: Array | None) -> Array:
    """One variance per point: half the trace over its weight (weight 0: as good as unknown)."""
    variances: Array = 0.5 * (covariance[:, 0] + covariance[:, 2])
    if weights is None:
        return variances
    return np.ascontiguousarray(variances / np.maximum(weights, 1e-12))


def _false_alarms(c: Correspondences, n: int, inliers: int, limit: float) -> float:
    """log10 of the expected number of chance orientations with so many good points among n (a contrario).

    A random point is near a random epipolar line with the share of the photograph that the strip of the limit
    takes: L. Moisan, B. Stival 2004, "A probabilistic criterion to detect rigid point matches".
    """
    size = np.ptp(c.right, axis=0) + 1e-12
    sigma = math.sqrt(
        float(np.median(c.left_covariance[:, 0] + c.left_covariance[:, 2])) / 2.0
        + float(np.median(c.right_covariance[:, 0] + c.right_covariance[:, 2])) / 2.0
    )
    chance = min(1.0, 2.0 * limit * sigma * float(np.hypot(*size)) / float(size[0] * size[1]))
    if inliers <= 5:
        return math.inf
    log_choices = _log_binomial(n, inliers) + _log_binomial(inliers, 5) + math.log(10.0 * max(n - 5, 1))
    return (log_choices + (inliers - 5) * math.log(chance)) / math.log(10.0)


def _log_binomial(n: int, k: int) -> float:
    return float(gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1))
