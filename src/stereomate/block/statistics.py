"""Posterior statistics of a block: covariances, redundancy numbers, standardized residuals, reliability.

Everything comes from the entries of the inverse that lie within the band of the normal matrix (`selected`);
the whole inverse is made on request only (`whole.full_covariance`). The redundancy number of an observation
is the part of an error of it that shows in its own residual; the minimal detectable error is the one that the
test of level `alpha` finds with probability `power` (Baarda).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from stereomate.block.equations import Equations, Factored, build, factor
from stereomate.block.freedom import inner_constraints
from stereomate.block.kernels import blocks
from stereomate.block.kernels import covariance as kernels
from stereomate.block.loop import Solution, image_residuals
from stereomate.block.navigation import Group, groups_of
from stereomate.block.options import BlockOptions
from stereomate.block.prepared import Prepared
from stereomate.block.selected import add_product, selected_inverse
from stereomate.block.triangular import backward
from stereomate.block.unknowns import prior_residuals
from stereomate.errors import NotDeterminedError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

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


@dataclass(frozen=True, eq=False)
class Covariances:
    """Cofactors of the unknowns (covariances for a standard deviation of unit weight of 1).

    Attributes
    ----------
    photos : ndarray, shape (n, 6, 6)
        Centre (m), rotation about the tangent axes (rad).
    points : ndarray, shape (p, 3, 3)
        NaN for points that are not determined.
    shared : ndarray, shape (q, q)
    photo_shared : ndarray, shape (n, 6, q)
    photo_point : ndarray, shape (m, 6, 3) or (0, 6, 3)
        Of the photograph and the point of each image observation, on request.
    """

    photos: Array
    points: Array
    shared: Array
    photo_shared: Array
    photo_point: Array
    inverse: Array
    prepared: Prepared

    def photo_pair(self, first: int, second: int) -> Array:
        """6x6 cofactors between two photographs that see one point; of free networks by minimal constraints.

        Raises
        ------
        NotDeterminedError
            If they lie too far apart: only the full matrix has their covariance.
        """
        place, skew = self.prepared.place, self.prepared.skew
        distance = 6 * abs(int(place[first]) - int(place[second])) + 6
        if skew and distance > self.inverse.shape[1]:
            raise NotDeterminedError("the photographs share no point: ask for the full matrix")
        out = np.empty((6, 6))
        blocks.pair_block(self.inverse, skew, int(place[first]), int(place[second]), out)
        return out


@dataclass(frozen=True, eq=False)
class Statistics:
    """All statistics of an adjustment.

    Attributes
    ----------
    sigma0 : float
        Estimated standard deviation of unit weight; NaN without redundancy.
    scale : float
        What standard deviations are multiplied with: `sigma0` or 1.
    redundancy, observations, unknowns : int
    cofactors : Covariances
    image : Reliability
        (m, 2), in the order of the network.
    on_point, on_photo : ndarray, shape (m, 2)
        Motion of the observation's own point and projection centre by its minimal detectable error, metres.
    control, positions, attitudes : Reliability or None
        (k, 3), check points NaN; (g, 3); attitudes in radians.
    priors : Reliability
        (q, 1).
    """

    sigma0: float
    scale: float
    redundancy: int
    observations: int
    unknowns: int
    cofactors: Covariances
    image: Reliability
    on_point: Array
    on_photo: Array
    control: Reliability | None
    positions: Reliability | None
    attitudes: Reliability | None
    priors: Reliability

    @property
    def photo_sigma(self) -> Array:
        """Standard deviations (n, 6): centre in metres, rotations in radians."""
        return _roots(self.cofactors.photos, self.scale)

    @property
    def point_sigma(self) -> Array:
        """Standard deviations (p, 3), metres."""
        return _roots(self.cofactors.points, self.scale)

    @property
    def shared_sigma(self) -> Array:
        """Standard deviations (q,) of the shared unknowns."""
        return _roots(self.cofactors.shared, self.scale)


def _roots(matrices: Array, scale: float) -> Array:
    diagonal = np.diagonal(matrices, axis1=-2, axis2=-1)
    result: Array = scale * np.sqrt(np.maximum(diagonal, 0.0))
    return np.where(np.isfinite(diagonal), result, np.nan)


def detection_limit(alpha: float, power: float) -> float:
    """Baarda's δ0: standardized size of the error that a two-sided test finds with probability `power`.

    4.13 for 0.1 % and 80 %. The far side of the test, of probability below alpha / 2, is left out.
    """
    return float(norm.isf(alpha / 2.0) + norm.ppf(power))


def counts(solution: Solution) -> tuple[int, int]:
    """Numbers of observations and of unknowns of an adjustment."""
    prepared, network = solution.prepared, solution.prepared.network
    determined = solution.determined
    observations = 2 * int(np.count_nonzero(prepared.weight[:, 0]))
    unknowns = int(prepared.free_photo.sum()) + 3 * int(determined.sum()) + len(prepared.layout.names)
    has = (prepared.control >= 0) & determined
    rows = prepared.control[has]
    observations += int((np.diagonal(prepared.control_weight[rows], axis1=1, axis2=2) > 0.0).sum())
    unknowns -= int((prepared.control_free[rows] == 0.0).sum())
    for part in (network.positions, network.attitudes):
        if part is not None:
            observations += int(np.isfinite(part.sigma).sum())
    observations += int(np.isfinite(prepared.layout.prior_sigma).sum())
    return observations, unknowns


def statistics_of(
    solution: Solution, options: BlockOptions, width: float = math.inf, cross_blocks: bool = False
) -> Statistics:
    """Statistics of a solution.

    Parameters
    ----------
    solution : Solution
    options : BlockOptions
    width : float
        Of Huber's loss, if that was used: redundancy numbers are those of the final weights.
    cross_blocks : bool
        Whether the covariances between photographs and points are kept.

    Raises
    ------
    NotDeterminedError
        If the normal matrix is singular where the loop ended.
    """
    prepared, state, layout = solution.prepared, solution.state, solution.prepared.layout
    equations, factored = _equations(solution, width)
    n, m, q = len(state.centres), len(prepared.order), len(layout.names)
    inverse, photo_shared, shared = _inverses(prepared, factored)
    points = np.empty((len(state.points), 6))
    computed, on_point, on_photo = np.full((m, 2), np.nan), np.zeros((m, 2, 3)), np.zeros((m, 2, 3))
    photo_point = np.zeros((m if cross_blocks else 0, 6, 3))
    cameras = equations.cameras
    kernels.observation_statistics(
        prepared.start, prepared.photo, prepared.xy, prepared.weight, state.points, state.centres,
        state.rotations, prepared.place, prepared.network.photographs.camera, cameras.model, cameras.packed,
        cameras.entries, cameras.derivatives, layout.first, layout.free, prepared.camera_start,
        prepared.camera_of, width, equations.information, equations.by_border, equations.v_inverse,
        prepared.skew, inverse, photo_shared, shared, points, computed, on_point, on_photo, photo_point,
    )  # fmt: skip
    photos = np.empty((n, 6, 6))
    blocks.photo_blocks(inverse, prepared.skew, prepared.place, photos)
    point_blocks = points[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    point_blocks[~solution.determined] = np.nan
    by_shared = photo_shared.reshape(n, 6, q)[prepared.place]
    observations, unknowns = counts(solution)
    redundancy = observations - unknowns
    sigma0 = math.sqrt(solution.cost / redundancy) if redundancy > 0 else math.nan
    scale = sigma0 if options.scale_by == "estimated" and redundancy > 0 else 1.0
    limit = detection_limit(options.tests.alpha, options.tests.power)
    back = np.empty(m, np.int64)
    back[prepared.order] = np.arange(m)
    image = _image(solution, computed[back], width, scale, limit)
    motion = image.minimal_detectable
    groups = groups_of(prepared.network, layout, state)
    priors = _priors(solution, shared, scale, limit)
    reliability = {
        name: _group(group, photos, by_shared, shared, scale, limit) for name, group in groups.items()
    }
    control = _control(solution, point_blocks, scale, limit)
    if solution.defect.size:
        change = inner_constraints(solution, equations, factored)
        photos, point_blocks, by_shared = change.applied(photos, point_blocks, by_shared)
    photos = np.where(solution.lonely[:, None, None], np.nan, photos)
    cofactors = Covariances(
        photos,
        point_blocks,
        shared,
        by_shared,
        photo_point[back] if cross_blocks else photo_point,
        inverse,
        prepared,
    )
    return Statistics(
        sigma0,
        scale,
        redundancy,
        observations,
        unknowns,
        cofactors,
        image,
        motion * np.linalg.norm(on_point[back], axis=2),
        motion * np.linalg.norm(on_photo[back], axis=2),
        control,
        reliability.get("positions"),
        reliability.get("attitudes"),
        priors,
    )


def _equations(solution: Solution, width: float) -> tuple[Equations, Factored]:
    """The equations at the solution: those of its last step, or built once more."""
    last = solution.linearised
    if last is not None and last.width == width:
        return last.equations, last.factored
    equations = build(solution.prepared, solution.state, solution.start, width)
    factored = factor(solution.prepared, equations)
    if factored.singular >= 0:
        raise NotDeterminedError("the normal matrix is singular at the solution")
    return equations, factored


def _inverses(prepared: Prepared, factored: Factored) -> tuple[Array, Array, Array]:
    """Covariance of photographs within the band, with the shared unknowns (6 n, q), of these (q, q)."""
    inverse = selected_inverse(factored.factor, prepared.skew)
    held = (6 * prepared.place[:, None] + np.arange(6))[prepared.free_photo == 0.0]
    inverse[held, held * (1 - prepared.skew)] = 0.0
    if not len(factored.half):
        return inverse, np.zeros((len(inverse), 0)), np.zeros((0, 0))
    root = np.linalg.inv(factored.corner)
    shared = root.T @ root
    solved = factored.half.copy()
    backward(factored.factor, prepared.skew, solved)
    solved = np.ascontiguousarray(solved.T)
    product = solved @ shared
    add_product(inverse, prepared.skew, product, solved)
    return inverse, -product, shared


def _reliability(
    residuals: Array, sigma: Array, redundancy: Array, deviation: Array, scale: float, limit: float
) -> Reliability:
    controlled = redundancy > _UNCONTROLLED
    with np.errstate(invalid="ignore", divide="ignore"):
        standardized = np.where(controlled, residuals / (scale * deviation), np.nan)
        detectable = np.where(controlled, scale * limit * sigma / np.sqrt(redundancy), np.nan)
    return Reliability(residuals, sigma, redundancy, standardized, detectable)


def _image(solution: Solution, computed: Array, width: float, scale: float, limit: float) -> Reliability:
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


def _group(
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


def _priors(solution: Solution, shared: Array, scale: float, limit: float) -> Reliability:
    layout = solution.prepared.layout
    sigma = np.where(np.isfinite(layout.prior_sigma), layout.prior_sigma, np.nan)[:, None]
    residuals = prior_residuals(solution.state, solution.start, layout)[:, None]
    redundancy = 1.0 - np.diag(shared)[:, None] / sigma**2
    with np.errstate(invalid="ignore"):
        deviation = sigma * np.sqrt(redundancy)
    return _reliability(
        np.where(np.isfinite(sigma), residuals, np.nan), sigma, redundancy, deviation, scale, limit
    )


def _control(solution: Solution, points: Array, scale: float, limit: float) -> Reliability | None:
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
