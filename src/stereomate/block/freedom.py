"""Covariances of a free network: from minimal to inner constraints (Baarda's S-transformation).

With G the open directions of all unknowns and E picking the coordinates of centres and points, over which
the inner constraints are: S = I - G (Gᵀ E G)⁻¹ Gᵀ E and Q' = S Q Sᵀ. Only ``Q E G`` is needed: d solutions of
the normal equations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrs

from stereomate.block.absorbed import absorbed
from stereomate.block.equations import Equations, Factored
from stereomate.block.kernels import points as kernel_points
from stereomate.block.loop import Solution
from stereomate.block.navigation import groups_of
from stereomate.block.triangular import backward, forward

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class InnerConstraints:
    """The change ``Q' = Q - G Mᵀ - M Gᵀ + G N Gᵀ`` of the blocks of a covariance.

    Attributes
    ----------
    photo_g, photo_m : ndarray, shape (n, 6, d)
    point_g, point_m : ndarray, shape (p, 3, d)
    shared_g, shared_m : ndarray, shape (q, d)
        Shifts and other unknowns of navigation without a prior move along.
    middle : ndarray, shape (d, d)
    """

    photo_g: Array
    photo_m: Array
    point_g: Array
    point_m: Array
    shared_g: Array
    shared_m: Array
    middle: Array

    def applied(
        self, photos: Array, points: Array, photo_shared: Array, shared: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Blocks of photographs, points (p, 3, 3), photographs with shared unknowns (n, 6, q), these."""
        across = self.photo_g @ self.middle @ self.shared_g.T
        return (
            _changed(photos, self.photo_g, self.photo_m, self.middle),
            _changed(points, self.point_g, self.point_m, self.middle),
            photo_shared - self.photo_g @ self.shared_m.T - self.photo_m @ self.shared_g.T + across,
            _changed(shared[None], self.shared_g[None], self.shared_m[None], self.middle)[0],
        )


def _changed(blocks: Array, g: Array, m: Array, middle: Array) -> Array:
    mixed = np.einsum("nad,nbd->nab", g, m)
    result: Array = blocks - mixed - np.swapaxes(mixed, 1, 2) + np.einsum("nad,de,nbe->nab", g, middle, g)
    return result


def inner_constraints(solution: Solution, equations: Equations, factored: Factored) -> InnerConstraints:
    """The change from the unknowns held in the loop to inner constraints over centres and points."""
    prepared, state, defect = solution.prepared, solution.state, solution.defect
    determined = solution.determined
    n, d = len(state.centres), defect.size
    centre_g = defect.moves(state.centres)
    photo_g = np.concatenate([centre_g, np.broadcast_to(defect.turns(), (n, 3, d))], axis=1)
    point_g = defect.moves(state.points) * determined[:, None, None]
    inside = np.einsum("nid,nie->de", centre_g, centre_g) + np.einsum("pid,pie->de", point_g, point_g)
    root = np.linalg.inv(inside)
    photo_m, point_m = np.empty((n, 6, d)), np.empty_like(point_g)
    shared_m = np.empty((len(prepared.layout.names), d))
    for k in range(d):
        target = np.concatenate([centre_g[:, :, k], np.zeros((n, 3))], axis=1)
        photo_m[:, :, k], point_m[:, :, k], shared_m[:, k] = _solved(
            solution, equations, factored, target, np.ascontiguousarray(point_g[:, :, k])
        )
    middle = np.einsum("nid,nie->de", centre_g, photo_m[:, :3]) + np.einsum("pid,pie->de", point_g, point_m)
    middle = root @ (0.5 * (middle + middle.T)) @ root
    shared_g = _shared_motion(solution, photo_g)
    return InnerConstraints(
        photo_g, photo_m @ root, point_g, point_m @ root, shared_g, shared_m @ root, middle
    )


def _shared_motion(solution: Solution, photo_g: Array) -> Array:
    """Open directions of the shared unknowns (q, d): those of navigation that follow the block."""
    network, layout = solution.prepared.network, solution.prepared.layout
    shared = np.zeros((len(layout.names), photo_g.shape[2]))
    for name, group in groups_of(network, layout, solution.state).items():
        motion = np.einsum("gia,gad->gid", group.by_photo, photo_g[group.photo])
        shared += absorbed(network, layout, group, name, motion)[1]
    return shared


def _solved(
    solution: Solution, equations: Equations, factored: Factored, photos: Array, points: Array
) -> tuple[Array, Array, Array]:
    """Q times a right side over photographs (n, 6) and points (p, 3)."""
    prepared, state, layout = solution.prepared, solution.state, solution.prepared.layout
    photos = photos * prepared.free_photo
    n = len(photos)
    right = np.empty(6 * n)
    right.reshape(n, 6)[prepared.place] = photos
    w = equations.v_inverse
    values = np.stack(
        [
            w[:, 0] * points[:, 0] + w[:, 1] * points[:, 1] + w[:, 2] * points[:, 2],
            w[:, 1] * points[:, 0] + w[:, 3] * points[:, 1] + w[:, 4] * points[:, 2],
            w[:, 2] * points[:, 0] + w[:, 4] * points[:, 1] + w[:, 5] * points[:, 2],
        ],
        axis=1,
    )
    shared = np.zeros(len(layout.names))
    kernel_points.photos_from_points(
        prepared.start, prepared.photo, state.points, state.centres, prepared.place, prepared.camera_start,
        prepared.camera_of, layout.first, layout.free, equations.information, equations.by_border, values,
        right, shared,
    )  # fmt: skip
    right.reshape(n, 6)[prepared.place] *= prepared.free_photo
    y = right[None].copy()
    forward(factored.factor, prepared.skew, y)
    if len(shared):
        rest = shared - factored.half @ y[0]
        shared, _ = dpotrs(factored.corner, rest, lower=1)
        y -= shared @ factored.half
    backward(factored.factor, prepared.skew, y)
    found = y.reshape(n, 6)[prepared.place] * prepared.free_photo
    out = np.empty_like(points)
    kernel_points.correct_points(
        prepared.start, prepared.photo, state.points, state.centres, prepared.camera_start,
        prepared.camera_of, layout.first, layout.free, equations.information, equations.by_border,
        equations.v_inverse, points, found, shared, out,
    )  # fmt: skip
    return found, out, shared
