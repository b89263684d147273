"""A small bundle adjustment for predictions: fixed control, exact observations, tens of photographs.

Real blocks are adjusted by the folder `block`; this one exists below it, for errors that need no statistics.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import OrientationError
from stereomate.geometry.rotations import rotation_from_vector, skew

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

# One micrometre in the image, five centimetres for positions by GNSS: only their ratio matters.
_IMAGE_SIGMA = 1e-6
_GNSS_SIGMA = 0.05
# A step of this size is no adjustment any more.
_DIVERGED_M = 1e5


@dataclass(frozen=True, eq=False)
class BundleProblem:
    """Observations and what is known.

    Attributes
    ----------
    photo_of, point_of : (m,) int
    xy : (m, 2)
        Image coordinates, metres.
    control : (n,) bool
        Points that are held fixed.
    gnss_centres : (p, 3) or None
        Observed projection centres (5 cm against 1 µm), or None.
    free_principal_distance : bool
    """

    photo_of: Indices
    point_of: Indices
    xy: Array
    control: NDArray[np.bool_]
    gnss_centres: Array | None = None
    free_principal_distance: bool = False

    def with_images(self, xy: Array) -> BundleProblem:
        """The same with other image coordinates."""
        return replace(self, xy=xy)


@dataclass(frozen=True, eq=False)
class BundleState:
    """Unknowns of a bundle: also its start and its result."""

    centres: Array
    rotations: Array
    points: Array
    principal_distance: float


def adjust(problem: BundleProblem, start: BundleState, iterations: int = 15) -> BundleState:
    """Least-squares bundle adjustment by Gauss-Newton, points eliminated.

    Raises
    ------
    OrientationError
        If too few points are common to photographs to determine the block.
    """
    state = start
    for _ in range(iterations):
        try:
            outer, points = _step(problem, state)
        except np.linalg.LinAlgError:
            outer = points = np.full(1, np.nan)
        largest = max(float(np.abs(outer).max()), float(np.abs(points).max()))
        if not largest < _DIVERGED_M:
            raise undetermined()
        state = _moved(problem, state, outer, points)
        if largest < 1e-9:
            break
    return state


def undetermined() -> OrientationError:
    """What is wrong with a block whose photographs have too little in common."""
    rule = "is not determined by the points that its photographs have in common"
    return OrientationError(rule, field="simulated block", hint="more overlap or sidelap")


def _step(problem: BundleProblem, state: BundleState) -> tuple[Array, Array]:
    """One Gauss-Newton step: photographs and principal distance (6 p + 1,), points (n, 3)."""
    photos, points = len(state.centres), len(state.points)
    p, k = problem.photo_of, problem.point_of
    rotation_t = np.swapaxes(state.rotations, -1, -2)[p]
    q = (rotation_t @ (state.points[k] - state.centres[p])[..., None])[..., 0]
    c = state.principal_distance
    ratio = q[:, :2] / q[:, 2:]
    by_q = np.zeros((p.size, 2, 3))
    by_q[:, 0, 0] = by_q[:, 1, 1] = 1.0
    by_q[:, :, 2] = -ratio
    by_q *= (-c / q[:, 2])[:, None, None]
    by_point = by_q @ rotation_t
    by_photo = np.concatenate([-by_point, by_q @ skew(q), -ratio[..., None]], axis=2)
    misclosure = problem.xy + c * ratio
    weight = _IMAGE_SIGMA**-2

    # Columns 0 to 5 of by_photo belong to the photograph, the last to the principal distance of all.
    column = np.concatenate([6 * p[:, None] + np.arange(6), np.full((p.size, 1), 6 * photos)], axis=1)
    size = 6 * photos + 1
    normal = np.zeros((size, size))
    np.add.at(
        normal, (column[:, :, None], column[:, None, :]), weight * np.swapaxes(by_photo, 1, 2) @ by_photo
    )
    right = np.zeros(size)
    np.add.at(right, column, weight * np.einsum("mai,ma->mi", by_photo, misclosure))
    if problem.gnss_centres is not None:
        at = (6 * np.arange(photos)[:, None] + np.arange(3)).ravel()
        normal[at, at] += _GNSS_SIGMA**-2
        right[at] += _GNSS_SIGMA**-2 * (problem.gnss_centres - state.centres).ravel()
    if not problem.free_principal_distance:
        normal[-1, :] = normal[:, -1] = right[-1] = 0.0
        normal[-1, -1] = 1.0
        by_photo[..., 6] = 0.0

    inner = np.zeros((points, 3, 3))
    np.add.at(inner, k, weight * np.swapaxes(by_point, 1, 2) @ by_point)
    inner_right = np.zeros((points, 3))
    np.add.at(inner_right, k, weight * np.einsum("mai,ma->mi", by_point, misclosure))
    mixed = np.zeros((size, points, 3))
    np.add.at(mixed, (column, k[:, None]), weight * np.swapaxes(by_photo, 1, 2) @ by_point)
    # Control does not move: its inverse normal matrix is zero.
    inverse = np.zeros((points, 3, 3))
    free = ~problem.control
    inverse[free] = np.linalg.inv(inner[free])
    reduced = np.einsum("ipk,pkl->ipl", mixed, inverse)
    normal -= np.einsum("ipl,jpl->ij", reduced, mixed, optimize=True)
    right -= np.einsum("ipl,pl->i", reduced, inner_right)
    diagonal = np.diag(normal)
    if not (diagonal > 0.0).all():
        raise np.linalg.LinAlgError("normal matrix is not positive")
    scale = 1.0 / np.sqrt(diagonal)
    outer = scale * np.linalg.solve(normal * scale * scale[:, None], scale * right)
    moved = np.einsum("pkl,pl->pk", inverse, inner_right - np.einsum("ipl,i->pl", mixed, outer))
    return outer, moved


def _moved(problem: BundleProblem, state: BundleState, outer: Array, points: Array) -> BundleState:
    photos = outer[:-1].reshape(-1, 6)
    c = state.principal_distance + (float(outer[-1]) if problem.free_principal_distance else 0.0)
    return BundleState(
        state.centres + photos[:, :3],
        state.rotations @ rotation_from_vector(photos[:, 3:]),
        state.points + points,
        c,
    )
