"""The one refinement loop of this folder: Gauss-Newton with damping where needed, and its statistics.

Small dense problems (transforms, resection). Residual = observed - computed. Observations are uncorrelated;
their standard deviations are a priori, ``sigma0`` scales them a posteriori.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np
import scipy  # its parts load when they are used
from numpy.typing import NDArray

from stereomate.errors import InputError, NotDeterminedError

Array = NDArray[np.float64]
State = TypeVar("State")

# Eigenvalue of the normal matrix, scaled to a unit diagonal, below which a parameter is not determined.
_SINGULAR = 1e-13
# Median of |N(0, 1)|.
_MEDIAN_OF_NORMAL = 0.6744897501960817


@dataclass(frozen=True)
class AdjustmentOptions:
    """How the loop runs.

    Parameters
    ----------
    max_iterations : int
    relative_tolerance : float
        The loop ends when a step promises to lower the weighted sum of squares by less than this part of it.
    loss : {"squared", "huber"}
        With ``huber`` residuals beyond `huber_width` standard deviations are weighted down; the standard
        deviation is the larger of the a priori one and the median estimate from the residuals.
    huber_width : float
    """

    max_iterations: int = 50
    relative_tolerance: float = 1e-14
    loss: Literal["squared", "huber"] = "squared"
    huber_width: float = 1.5

    def __post_init__(self) -> None:
        if self.max_iterations < 1:
            raise InputError("must be positive", field="max_iterations", value=self.max_iterations)
        if self.loss not in ("squared", "huber"):
            raise InputError("must be squared or huber", field="loss", value=self.loss)
        if not self.huber_width > 0.0:
            raise InputError("must be positive", field="huber_width", value=self.huber_width)


@dataclass(frozen=True)
class AdjustmentSummary:
    """Statistics of an adjustment.

    Attributes
    ----------
    sigma0 : float
        Standard deviation of unit weight a posteriori; NaN without redundancy.
    redundancy : int
    cofactor : ndarray, shape (u, u)
        Inverse of the normal matrix.
    residuals : ndarray, shape (n,)
        Observed minus computed.
    redundancy_numbers : ndarray, shape (n,)
        Part of an error of each observation that shows in its own residual; their sum is the redundancy.
    weights : ndarray, shape (n,)
        Final weights (of the robust loss too).
    iterations : int
    converged : bool
    """

    sigma0: float
    redundancy: int
    cofactor: Array
    residuals: Array
    redundancy_numbers: Array
    weights: Array
    iterations: int
    converged: bool

    @property
    def covariance(self) -> Array:
        """Covariance of the parameters, scaled with `sigma0`; NaN without redundancy."""
        return self.sigma0**2 * self.cofactor

    @property
    def standardized_residuals(self) -> Array:
        """Residuals over their standard deviations from `sigma0`; NaN where they are not controlled."""
        with np.errstate(invalid="ignore", divide="ignore"):
            deviation = self.sigma0 * np.sqrt(self.redundancy_numbers / self.weights)
            return np.where(self.redundancy_numbers > 1e-9, self.residuals / deviation, np.nan)


def adjust(
    linearise: Callable[[State], tuple[Array, Array]],
    update: Callable[[State, Array], State],
    start: State,
    sigma: Array,
    options: AdjustmentOptions | None = None,
) -> tuple[State, AdjustmentSummary]:
    """Least squares from a start.

    Parameters
    ----------
    linearise : callable
        State -> (residuals (n,), design matrix (n, u)): observed minus computed, and the derivatives of
        the computed values by the parameters.
    update : callable
        (state, correction (u,)) -> state.
    start : State
    sigma : ndarray, shape (n,)
        A priori standard deviations of the observations.
    options : AdjustmentOptions, optional

    Returns
    -------
    state, summary

    Raises
    ------
    NotDeterminedError
        If there are fewer observations than parameters or the normal matrix is singular.
    """
    options = options or AdjustmentOptions()
    state = start
    residuals, design = linearise(state)
    n, u = design.shape
    if n < u:
        raise NotDeterminedError(f"{n} observations do not determine {u} parameters")
    weights = _weights(residuals, sigma, options)
    cost = float(weights @ residuals**2)
    first_cost, damping, converged, iterations = cost, 0.0, False, 0
    while iterations < options.max_iterations and not converged:
        iterations += 1
        scale, normal = _scaled_normal(design, weights)
        right = (design.T @ (weights * residuals)) / scale
        step = scipy.linalg.cho_solve(
            scipy.linalg.cho_factor(normal + damping * np.eye(u), lower=True), right
        )
        promised = float(right @ step)
        candidate = update(state, step / scale)
        new_residuals, new_design = linearise(candidate)
        # One loss for both sides of the comparison: the weights change only with an accepted step.
        new_cost = float(weights @ new_residuals**2)
        small = promised <= options.relative_tolerance * cost or cost <= 1e-28 * first_cost
        if new_cost < cost or (small and np.isfinite(new_cost)):
            state, residuals, design = candidate, new_residuals, new_design
            new_weights = _weights(residuals, sigma, options)
            settled = np.allclose(new_weights, weights, rtol=1e-9, atol=0.0)
            weights, cost = new_weights, float(new_weights @ residuals**2)
            damping = 0.0 if damping < 1e-6 else damping / 10.0
            converged = small and settled and damping == 0.0
        elif promised <= 1e-8 * cost:  # no descent left but rounding
            converged = True
        else:
            damping = max(damping * 10.0, 1e-4)
    return state, _summary(residuals, design, weights, iterations, converged)


def _weights(residuals: Array, sigma: Array, options: AdjustmentOptions) -> Array:
    if options.loss == "squared":
        return np.asarray(1.0 / sigma**2, dtype=np.float64)
    normalised = np.abs(residuals) / sigma
    spread = max(1.0, float(np.median(normalised)) / _MEDIAN_OF_NORMAL)
    limit = options.huber_width * spread
    factor = np.minimum(1.0, limit / np.maximum(normalised, 1e-300))
    return np.asarray(factor / sigma**2, dtype=np.float64)


def _scaled_normal(design: Array, weights: Array) -> tuple[Array, Array]:
    """Scale of each parameter and the normal matrix with a unit diagonal."""
    normal = design.T @ (weights[:, None] * design)
    scale = np.sqrt(np.diag(normal))
    if not np.all(np.isfinite(scale)) or np.any(scale == 0.0):
        raise NotDeterminedError("an unknown has no influence on any observation")
    scaled: Array = normal / np.outer(scale, scale)
    if np.linalg.eigvalsh(scaled)[0] < _SINGULAR:
        raise NotDeterminedError("the observations leave a combination of the unknowns undetermined")
    return scale, scaled


def _summary(
    residuals: Array, design: Array, weights: Array, iterations: int, converged: bool
) -> AdjustmentSummary:
    n, u = design.shape
    scale, normal = _scaled_normal(design, weights)
    cofactor = np.linalg.inv(normal) / np.outer(scale, scale)
    redundancy = n - u
    cost = float(weights @ residuals**2)
    sigma0 = float(np.sqrt(cost / redundancy)) if redundancy > 0 else float("nan")
    leverage = np.einsum("ij,jk,ik->i", design, cofactor, design) * weights
    return AdjustmentSummary(
        sigma0, redundancy, cofactor, residuals, 1.0 - leverage, weights, iterations, converged
    )
