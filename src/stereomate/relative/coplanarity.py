"""Coplanarity least squares: the rigorous relative orientation from approximate values, with its statistics.

Gauss-Helmert model: every pair of points gives one condition between four measured coordinates and five
unknowns, repeated at the adjusted coordinates until nothing moves. What matters per point is the closure of
its condition, an observation of its own with the redundancy number ``r``; their sum is the number of points
minus five.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from stereomate.errors import InputError
from stereomate.relative.elements import Elements, dependent_elements, independent_elements
from stereomate.relative.kernels.coplanarity import adjust, point_statistics
from stereomate.relative.pair import Correspondences, RelativePose

Array = NDArray[np.float64]
Loss = Literal["none", "huber", "tukey"]

# Tuning for 95 % efficiency under normal errors.
_HUBER: Final = 1.345
_TUKEY: Final = 4.685
# Redundancy below which a point controls itself only by rounding.
_NO_CONTROL: Final = 1e-9


@dataclass(frozen=True)
class CoplanarityOptions:
    """How the adjustment iterates and what its tests mean.

    Parameters
    ----------
    max_iterations : int
        Steps at most.
    conditions : {"propagated", "equal"}
        Weight of a condition: from the covariances of its image points (rigorous), or one for all conditions
        as in the textbook adjustment.
    loss : {"none", "huber", "tukey"}
        Reweighting of points by their standardized residuals.
    reweightings : int
        Rounds of reweighting at most.
    alpha : float
        Probability of rejecting a good point, two-sided.
    power : float
        Probability of finding an error of the minimal detectable size.
    """

    max_iterations: int = 50
    conditions: Literal["propagated", "equal"] = "propagated"
    loss: Loss = "none"
    reweightings: int = 20
    alpha: float = 0.001
    power: float = 0.80

    def __post_init__(self) -> None:
        if self.max_iterations < 1 or self.reweightings < 1:
            raise InputError("must be at least 1", field="max_iterations, reweightings")
        if self.loss not in ("none", "huber", "tukey"):
            raise InputError("must be none, huber or tukey", field="loss", value=self.loss)
        if self.conditions not in ("propagated", "equal"):
            raise InputError("must be propagated or equal", field="conditions", value=self.conditions)
        if not (0.0 < self.alpha < 0.5 and 0.0 < self.power < 1.0):
            raise InputError("must be probabilities, alpha below 0.5", field="alpha, power")

    @property
    def critical(self) -> float:
        """Critical value of a standardized residual."""
        return float(norm.isf(self.alpha / 2.0))

    @property
    def noncentrality(self) -> float:
        """Baarda's delta0: 4.13 for alpha 0.001 and power 0.80."""
        return self.critical + float(norm.ppf(self.power))


@dataclass(frozen=True)
class PointStatistics:
    """What the adjustment says of every point; arrays of n rows in the order of the correspondences.

    Parameters
    ----------
    used : ndarray of bool, shape (n,)
        Took part in the adjustment.
    residuals : ndarray, shape (n, 4)
        Observed minus adjusted x, y left and x, y right, in the unit of the correspondences.
    y_parallax : ndarray, shape (n,)
        Left minus right, perpendicular to the epipolar line in the right photograph, in the unit of the
        correspondences; for a vertical pair along x this is the y-parallax.
    sampson : ndarray, shape (n,)
        Length of the smallest movement of both points that makes the rays meet, with sign.
    redundancy : ndarray, shape (n,)
        Redundancy numbers; NaN where not used.
    standardized : ndarray, shape (n,)
        Residual over its own standard deviation (prior sigma); of unused points over that of their
        prediction.
    minimal_detectable : ndarray, shape (n,)
        Smallest y-parallax error that the test finds with the power asked for; inf without control.
    external : ndarray, shape (n,)
        Largest effect of an undetected error on any function of the elements, in its standard deviations.
    coordinate_redundancy : ndarray, shape (n, 4)
        Shares of the redundancy number in the four coordinates: errors along the epipolar line have none.
    """

    used: NDArray[np.bool_]
    residuals: Array
    y_parallax: Array
    sampson: Array
    redundancy: Array
    standardized: Array
    minimal_detectable: Array
    external: Array
    coordinate_redundancy: Array


@dataclass(frozen=True)
class CoplanarityAdjustment:
    """Result of the least squares.

    Parameters
    ----------
    pose : RelativePose
        The estimate.
    cofactor : ndarray, shape (5, 5)
        Of two steps of the base (along unit vectors perpendicular to it) and three of the rotation (left
        camera axes).
    redundancy : int
        Points used minus five.
    sigma0 : float
        Estimated standard deviation of unit weight (1: the noise is as given); NaN without redundancy.
    iterations : int
        Steps taken.
    converged : bool
        The last step was nothing.
    singular : bool
        The normal equations have no inverse: the points do not determine the elements.
    weights : ndarray, shape (n,)
        Weights of the last round, robust ones included.
    correspondences : Correspondences
        What was adjusted.
    residuals : ndarray, shape (n, 4)
        Observed minus adjusted, over the principal distances.
    options : CoplanarityOptions
    """

    pose: RelativePose
    cofactor: Array
    redundancy: int
    sigma0: float
    iterations: int
    converged: bool
    singular: bool
    weights: Array
    correspondences: Correspondences
    residuals: Array
    options: CoplanarityOptions

    @property
    def covariance(self) -> Array:
        """Covariance of the five steps; with the estimated variance factor where there is redundancy."""
        return self.cofactor * (self.sigma0**2 if self.redundancy > 0 else 1.0)

    def dependent(self, bx: float = 1.0) -> Elements:
        """Elements of the dependent pair (see `stereomate.relative.elements`)."""
        return dependent_elements(self.pose, self.covariance, bx)

    def independent(self) -> Elements:
        """Elements of the independent pair."""
        return independent_elements(self.pose, self.covariance)

    def points(self) -> PointStatistics:
        """Residuals, redundancy numbers and tests of all points."""
        return _statistics(self)


def adjust_coplanarity(
    correspondences: Correspondences,
    start: RelativePose,
    options: CoplanarityOptions | None = None,
    use: NDArray[np.bool_] | None = None,
) -> CoplanarityAdjustment:
    """Least squares of all conditions from approximate values.

    Parameters
    ----------
    correspondences : Correspondences
        At least five.
    start : RelativePose
        Approximate values; `stereomate.relative.orientation` finds them.
    options : CoplanarityOptions, optional
    use : ndarray of bool, shape (n,), optional
        Points that take part; the others get residuals and tests too.

    Raises
    ------
    InputError
        If fewer than five points take part.
    """
    options = options or CoplanarityOptions()
    n = len(correspondences)
    prior = np.ones(n) if correspondences.weights is None else correspondences.weights.copy()
    if use is not None:
        prior = np.where(use, prior, 0.0)
    count = int(np.count_nonzero(prior))
    if count < 5:
        raise InputError("must be five points or more", field="correspondences", value=count)
    result = _adjust_once(correspondences, start, options, prior, 0)
    if (options.loss == "none" and options.conditions == "propagated") or count <= 5:
        return result
    for _ in range(options.reweightings):
        weights = prior * _reweighted(result, options)
        settled = np.abs(weights - result.weights).max() < 1e-4 * prior.max()
        if settled or result.singular or np.count_nonzero(weights) < 5:
            break
        result = _adjust_once(correspondences, result.pose, options, weights, result.iterations)
    return result


def _adjust_once(
    c: Correspondences, start: RelativePose, options: CoplanarityOptions, weights: Array, steps: int
) -> CoplanarityAdjustment:
    base, rotation = np.array(start.base), np.array(start.left_from_right)
    residuals, cofactor = np.zeros((len(c), 4)), np.empty((5, 5))
    total, iterations, state = adjust(
        c.left,
        c.right,
        c.left_covariance,
        c.right_covariance,
        weights,
        base,
        rotation,
        residuals,
        cofactor,
        options.max_iterations,
    )
    redundancy = int(np.count_nonzero(weights)) - 5
    return CoplanarityAdjustment(
        RelativePose(base, rotation),
        np.full((5, 5), np.inf) if state == 2 else cofactor,
        redundancy,
        float(np.sqrt(total / redundancy)) if redundancy > 0 else float("nan"),
        steps + iterations,
        state == 0,
        state == 2,
        weights,
        c,
        residuals,
        options,
    )


def _reweighted(result: CoplanarityAdjustment, options: CoplanarityOptions) -> Array:
    """Factors of the prior weights from the last round: equal conditions, and the loss function."""
    statistics = _raw(result)
    used = result.weights > 0.0
    factors = np.ones(len(used))
    if options.conditions == "equal":
        variance = statistics[:, 1] ** 2
        factors = variance / variance[used].mean()
    if options.loss == "none":
        return factors
    t = np.abs(statistics[:, 0]) / statistics[:, 1] * np.sqrt(factors)
    # In units of their robust scale: the median of normal residuals is 0.6745 sigma.
    t = t / max(float(np.median(t[used])) / 0.6745, 1e-12)
    if options.loss == "huber":
        return factors * np.minimum(1.0, _HUBER / np.maximum(t, 1e-300))
    weights: Array = factors * np.where(t < _TUKEY, (1.0 - (t / _TUKEY) ** 2) ** 2, 0.0)
    return weights


def _raw(result: CoplanarityAdjustment) -> Array:
    c = result.correspondences
    out = np.empty((len(c), 8))
    point_statistics(
        c.left,
        c.right,
        c.left_covariance,
        c.right_covariance,
        result.residuals,
        np.array(result.pose.base),
        np.array(result.pose.left_from_right),
        result.cofactor,
        out,
    )
    return out


def _statistics(result: CoplanarityAdjustment) -> PointStatistics:
    c, options = result.correspondences, result.options
    raw = _raw(result)
    closure, sigma, leverage, sign = raw[:, 0], raw[:, 1], raw[:, 2], raw[:, 7]
    slope_right = np.hypot(raw[:, 5], raw[:, 6])
    used = result.weights > 0.0
    weight = np.where(used, result.weights, 1.0)
    # A point that took part has pulled the result towards itself; the others are predicted.
    share = np.where(used, 1.0 - leverage * weight, 1.0 + leverage)
    share = np.where(share < _NO_CONTROL, 0.0, share)
    with np.errstate(divide="ignore", invalid="ignore"):
        deviation = sigma * np.sqrt(share / weight)
        standardized = np.where(share > 0.0, closure / deviation, 0.0) * sign
        to_parallax = c.principal_distances[1] / slope_right
        detectable = options.noncentrality * sigma / np.sqrt(np.maximum(share, 0.0) * weight) * to_parallax
        external = options.noncentrality * np.sqrt(np.maximum(1.0 - share, 0.0) / share)
    scale = np.array([c.principal_distances[0]] * 2 + [c.principal_distances[1]] * 2)
    residuals = result.residuals * scale
    redundancy = np.where(used, share, np.nan)
    return PointStatistics(
        used,
        residuals,
        closure * sign * to_parallax,
        np.linalg.norm(residuals, axis=1) * np.sign(closure * sign),
        redundancy,
        standardized,
        np.where(used, detectable, np.nan),
        np.where(used, external, np.nan),
        redundancy[:, None] * _coordinate_shares(c, raw),
    )


def _coordinate_shares(c: Correspondences, raw: Array) -> Array:
    """Part of each coordinate in the variance of its closure, (n, 4); the four sum to one."""
    shares = np.empty((len(c), 4))
    for k, covariance in ((0, c.left_covariance), (2, c.right_covariance)):
        by_x, by_y = raw[:, 3 + k], raw[:, 4 + k]
        xx, xy, yy = covariance.T
        shares[:, k] = (xx * by_x + xy * by_y) * by_x
        shares[:, k + 1] = (xy * by_x + yy * by_y) * by_y
    variance = raw[:, 1:2] ** 2
    return np.divide(shares, variance, out=np.full_like(shares, 0.25), where=variance > 0.0)
