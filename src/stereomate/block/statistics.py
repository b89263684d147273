"""Posterior statistics of a block: covariances, redundancy numbers, standardized residuals, reliability.

Everything comes from the entries of the inverse that lie within the band of the normal matrix (`selected`);
the whole inverse is made on request only (`whole.full_covariance`). The redundancy number of an observation
is the part of an error of it that shows in its own residual; the minimal detectable error is the one that the
test of level `alpha` finds with probability `power` (Baarda).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from stereomate.block.equations import Equations, Factored, build, factor
from stereomate.block.freedom import inner_constraints
from stereomate.block.kernels import blocks
from stereomate.block.kernels import covariance as kernels
from stereomate.block.loop import Solution
from stereomate.block.navigation import groups_of
from stereomate.block.options import BlockOptions
from stereomate.block.prepared import Prepared
from stereomate.block.reliability import Reliability, of_control, of_group, of_image, of_priors
from stereomate.block.selected import selected_inverse
from stereomate.block.triangular import backward
from stereomate.errors import NotDeterminedError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


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
    equations, factored = _equations(solution, width)
    found = _blocks(solution, equations, factored, width, cross_blocks)
    photos, points, by_shared, shared = found.photos, found.points, found.by_shared, found.shared
    observations, unknowns = counts(solution)
    redundancy = observations - unknowns
    sigma0 = math.sqrt(solution.cost / redundancy) if redundancy > 0 else math.nan
    scale = sigma0 if options.scale_by == "estimated" and redundancy > 0 else 1.0
    limit = detection_limit(options.tests.alpha, options.tests.power)
    image = of_image(solution, found.computed, width, scale, limit)
    groups = groups_of(solution.prepared.network, solution.prepared.layout, solution.state)
    reliability = {
        name: of_group(group, photos, by_shared, shared, scale, limit) for name, group in groups.items()
    }
    control = of_control(solution, points, scale, limit)
    if solution.defect.size:
        change = inner_constraints(solution, equations, factored)
        photos, points, by_shared, shared = change.applied(photos, points, by_shared, shared)
    photos = np.where(solution.lonely[:, None, None], np.nan, photos)
    return Statistics(
        sigma0,
        scale,
        redundancy,
        observations,
        unknowns,
        Covariances(photos, points, shared, by_shared, found.photo_point, found.inverse, solution.prepared),
        image,
        image.minimal_detectable * np.linalg.norm(found.on_point, axis=2),
        image.minimal_detectable * np.linalg.norm(found.on_photo, axis=2),
        control,
        reliability.get("positions"),
        reliability.get("attitudes"),
        of_priors(solution, shared, scale, limit),
    )


@dataclass(frozen=True, eq=False)
class _Blocks:
    """Parts of the inverse in the order of the network, and what follows from them for image points.

    `computed` (m, 2): variances of what is computed; `on_point`, `on_photo` (m, 2, 3): motion of point
    and centre by a pixel of error. The rest as in `Covariances`.
    """

    photos: Array
    points: Array
    shared: Array
    by_shared: Array
    photo_point: Array
    inverse: Array
    computed: Array
    on_point: Array
    on_photo: Array


def _blocks(
    solution: Solution, equations: Equations, factored: Factored, width: float, cross_blocks: bool
) -> _Blocks:
    prepared, state, layout = solution.prepared, solution.state, solution.prepared.layout
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
    back = np.empty(m, np.int64)
    back[prepared.order] = np.arange(m)
    by_shared = photo_shared.reshape(n, 6, q)[prepared.place]
    return _Blocks(
        photos, point_blocks, shared, by_shared, photo_point[back] if cross_blocks else photo_point, inverse,
        computed[back], on_point[back], on_photo[back],
    )  # fmt: skip


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
    product = np.ascontiguousarray(solved.T @ shared)
    blocks.add_product(inverse, prepared.skew, product, solved)
    return inverse, -product, shared
