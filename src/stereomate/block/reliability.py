"""Reliability of observations: redundancy numbers, standardized residuals, minimal detectable errors.

The redundancy number of an observation is the part of an error of it that shows in its own residual; the
minimal detectable error is the one that the test finds with the probability asked for (Baarda).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.block.loop import Solution, image_residuals
from stereomate.block.navigation import Group
from stereomate.block.unknowns import prior_residuals

Array = NDArray[np.float64]

# Redundancy below which a residual says nothing about its observation.
_UNCONTROLLED: Final = 1e-6


@dataclass(frozen=True, eq=False)
class Reliability:
    """Statistics of one kind of observations; NaN for what took no part or is not controlled.

    Image points that took no part have standardized residuals: of the prediction that the others make.

    Attributes
    ----------
    residuals : ndarray, shape (g, s)
        Observed minus computed, unit of the observation.
    sigma : ndarray, shape (g, s)
        A priori.
    redundancy : ndarray, shape (g, s)
        Redundancy numbers, 0 to 1.
    standardized : ndarray, shape (g, s)
        Residuals over their standard deviations.
    minimal_detectable : ndarray, shape (g, s)
        Unit of the observation.
    """

    residuals: Array
    sigma: Array
    redundancy: Array
    standardized: Array
    minimal_detectable: Array


def _reliability(
    residuals: Array, sigma: Array, redundancy: Array, deviation: Array, scale: float, limit: float
) -> Reliability:
    controlled = redundancy > _UNCONTROLLED
    with np.errstate(invalid="ignore", divide="ignore"):
        standardized = np.where(controlled, residuals / (scale * deviation), np.nan)
        detectable = np.where(controlled, scale * limit * sigma / np.sqrt(redundancy), np.nan)
    return Reliability(residuals, sigma, redundancy, standardized, detectable)


def of_image(solution: Solution, computed: Array, width: float, scale: float, limit: float) -> Reliability:
    """Of image points; those that took no part have what their own error is likely to be (`predicted`)."""
    residuals = image_residuals(solution.prepared, solution.state)
    sigma = solution.prepared.network.image.sigma
    used = solution.used[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        size = np.linalg.norm(residuals / sigma, axis=1, keepdims=True)
        weight = np.minimum(1.0, width / size) / sigma**2
        redundancy = np.where(used, 1.0 - weight * computed, np.nan)
        deviation = np.sqrt(np.where(used, redundancy / weight, sigma**2 + computed))
    known = solution.determined[solution.prepared.network.image.point][:, None]
    made = _reliability(residuals, sigma, redundancy, deviation, scale, limit)
    with np.errstate(invalid="ignore", divide="ignore"):
        standardized = np.where(used | ~known, made.standardized, residuals / (scale * deviation))
    return Reliability(residuals, sigma, redundancy, standardized, made.minimal_detectable)


def of_group(
    group: Group, photos: Array, by_shared: Array, shared: Array, scale: float, limit: float
) -> Reliability:
    """Of observations of single photographs."""
    inner = computed_variance(group, photos, by_shared, shared)
    with np.errstate(divide="ignore", invalid="ignore"):
        sigma = np.where(group.weight > 0.0, 1.0 / np.sqrt(group.weight), np.nan)
        redundancy = 1.0 - group.weight * inner
        redundancy = np.where(group.weight > 0.0, redundancy, np.nan)
        deviation = sigma * np.sqrt(redundancy)
    residuals = np.where(group.weight > 0.0, group.residual, np.nan)
    return _reliability(residuals, sigma, redundancy, deviation, scale, limit)


def computed_variance(group: Group, photos: Array, by_shared: Array, shared: Array) -> Array:
    """Cofactors (g, 3) of what is computed for observations of single photographs: diagonal of ``J Q Jᵀ``."""
    jp, k = group.by_photo, group.photo
    inner: Array = np.einsum("gia,gab,gib->gi", jp, photos[k], jp)
    if group.columns.shape[1] and shared.shape[0]:
        columns = np.where(group.columns >= 0, group.columns, 0)
        js = group.by_shared * (group.columns >= 0)[:, None, :]
        cross = np.take_along_axis(by_shared[k], columns[:, None, :], axis=2)
        inner += 2.0 * np.einsum("gia,gas,gis->gi", jp, cross, js)
        among = shared[columns[:, :, None], columns[:, None, :]]
        inner += np.einsum("gis,gst,git->gi", js, among, js)
    return inner


def of_priors(solution: Solution, shared: Array, scale: float, limit: float) -> Reliability:
    layout = solution.prepared.layout
    sigma = np.where(np.isfinite(layout.prior_sigma), layout.prior_sigma, np.nan)[:, None]
    residuals = prior_residuals(solution.state, solution.start, layout)[:, None]
    redundancy = 1.0 - np.diag(shared)[:, None] / sigma**2
    with np.errstate(invalid="ignore"):
        deviation = sigma * np.sqrt(redundancy)
    return _reliability(
        np.where(np.isfinite(sigma), residuals, np.nan), sigma, redundancy, deviation, scale, limit
    )


def of_control(solution: Solution, points: Array, scale: float, limit: float) -> Reliability | None:
    """Of control points; their coordinates may be correlated. Check points have residuals only."""
    prepared, control = solution.prepared, solution.prepared.network.control
    if control is None:
        return None
    assert control.check is not None
    k = len(control.point)
    known = np.isfinite(control.sigma)
    residuals = np.where(known, control.xyz - solution.state.points[control.point], np.nan)
    residuals[~solution.determined[control.point]] = np.nan
    redundancy, deviation = np.full((k, 3), np.nan), np.full((k, 3), np.nan)
    effective = np.full((k, 3), np.nan)
    sigma = np.where(known, control.sigma, np.nan)
    for i in np.flatnonzero(~control.check):
        j = int(control.point[i])
        if not solution.determined[j]:
            continue
        weight = prepared.control_weight[prepared.control[j]]
        axes = np.flatnonzero(np.diag(weight) > 0.0)
        if not len(axes):
            continue
        inner = np.ix_(axes, axes)
        prior = np.linalg.inv(weight[inner])
        left = prior - points[j][inner]
        redundancy[i, axes] = np.diag(left @ weight[inner])
        deviation[i, axes] = np.sqrt(np.maximum(np.diag(left), 0.0))
        # For correlated coordinates the detectable error follows from P Qvv P.
        informed = np.maximum(np.diag(weight[inner] @ left @ weight[inner]), 1e-300)
        effective[i, axes] = np.sqrt(redundancy[i, axes].clip(1e-300) / informed)
        sigma[i, axes] = np.sqrt(np.diag(prior))
    made = _reliability(residuals, effective, redundancy, deviation, scale, limit)
    return Reliability(residuals, sigma, redundancy, made.standardized, made.minimal_detectable)
