"""The normal equations of a block at a state: built, factored, solved.

| S  Bᵀ | photographs, points eliminated: band or dense
| B  C  | shared unknowns: the border
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpbtrf, dpotrf

from stereomate.block.kernels import normal, system
from stereomate.block.navigation import groups_of
from stereomate.block.prepared import Prepared
from stereomate.block.unknowns import State, packed_camera, prior_residuals

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

# Part of an unknown's information that must be left when all others are unknown too.
_SINGULAR: Final = 1e-13


@dataclass(frozen=True, eq=False)
class CameraArrays:
    """Cameras as the kernels read them: model codes, parameter arrays, active entries, their derivatives."""

    model: Integers
    packed: Array
    active: Integers
    jacobian: Array


@dataclass(frozen=True, eq=False)
class Equations:
    """Normal equations at a state.

    Attributes
    ----------
    cost : float
        Weighted sum of squares, or of losses.
    promised_by_points : float
    failed, undetermined : int
        Observations that cannot be computed; points without a solution.
    matrix : ndarray, shape (6 n, width)
        As in `kernels.normal`; becomes the factor.
    border, corner, right, right_border, diagonal, diagonal_border : ndarray
    v_inverse, v_right : ndarray, shape (p, 6), (p, 3)
    cameras : CameraArrays
    """

    cost: float
    promised_by_points: float
    failed: int
    undetermined: int
    matrix: Array
    border: Array
    corner: Array
    right: Array
    right_border: Array
    diagonal: Array
    diagonal_border: Array
    v_inverse: Array
    v_right: Array
    cameras: CameraArrays


@dataclass(frozen=True, eq=False)
class Factored:
    """Factor of the photographs' matrix L, ``L⁻¹ Bᵀ`` (6 n, q), and the factor of the reduced corner.

    Attributes
    ----------
    singular : int
        Index of an unknown that is not determined (photographs in the order of the matrix, then
        shared unknowns), -1 if all are.
    """

    factor: Array
    half: Array
    corner: Array
    singular: int


@dataclass(frozen=True, eq=False)
class Step:
    """Corrections: photographs (n, 6) in their own order, points (p, 3), shared unknowns (q,)."""

    photos: Array
    points: Array
    shared: Array
    promised: float


def camera_arrays(prepared: Prepared, state: State) -> CameraArrays:
    """Pack the cameras at a state."""
    layout, cameras = prepared.layout, prepared.network.cameras
    packed, derivatives = [], []
    for entry, values, chosen in zip(cameras, state.cameras, layout.chosen, strict=True):
        one, jacobian = packed_camera(entry.camera, values, chosen)
        packed.append(one)
        derivatives.append(jacobian)
    active = np.flatnonzero(np.any([np.any(j != 0.0, axis=1) for j in derivatives], axis=0)).astype(np.int64)
    most = int(layout.free.max(initial=0))
    jacobian = np.zeros((len(cameras), len(active), most))
    for c, one in enumerate(derivatives):
        jacobian[c, :, : one.shape[1]] = one[active]
    models = np.array([entry.camera.jacobian_model for entry in cameras], dtype=np.int64)
    return CameraArrays(models, np.array(packed), active, jacobian)


def build(
    prepared: Prepared, state: State, start: State, width: float = math.inf, damping: float = 0.0
) -> Equations:
    """Normal equations at a state; `width` of Huber's loss on image points, Marquardt's `damping`."""
    layout = prepared.layout
    n, p, q = len(state.centres), len(state.points), len(layout.names)
    cameras = camera_arrays(prepared, state)
    matrix, border = np.zeros((6 * n, prepared.width)), np.zeros((q, 6 * n))
    corner, right, right_border = np.zeros((q, q)), np.zeros(6 * n), np.zeros(q)
    diagonal, diagonal_border = np.zeros(6 * n), np.zeros(q)
    v_inverse, v_right = np.empty((p, 6)), np.empty((p, 3))
    cost, promised, failed, undetermined = normal.build(
        prepared.start, prepared.photo, prepared.xy, prepared.weight, state.points, state.centres,
        state.rotations, prepared.place, prepared.free_photo, prepared.network.photographs.camera,
        cameras.model, cameras.packed, cameras.active, cameras.jacobian, layout.first, layout.free,
        prepared.control, prepared.control_xyz, prepared.control_weight, prepared.control_free, width,
        damping, prepared.skew, matrix, border, corner, right, right_border, diagonal, diagonal_border,
        v_inverse, v_right,
    )  # fmt: skip
    for group in groups_of(prepared.network, layout, state).values():
        cost += system.add_group(
            group.photo, group.residual, group.weight, group.by_photo, group.columns, group.by_shared,
            prepared.place, prepared.free_photo, prepared.skew, matrix, border, corner, right, right_border,
            diagonal, diagonal_border,
        )  # fmt: skip
    if q:
        weight = 1.0 / layout.prior_sigma**2
        residual = prior_residuals(state, start, layout)
        cost += float(weight @ residual**2)
        right_border += weight * residual
        diagonal_border += weight
        corner[np.arange(q), np.arange(q)] += weight
    # Unknowns held fixed stand alone.
    rows = np.arange(6 * n)
    fixed = rows[(prepared.free_photo[np.argsort(prepared.place)] == 0.0).ravel()]
    matrix[fixed, fixed * (1 - prepared.skew)] += 1.0
    diagonal[fixed] += 1.0
    if damping > 0.0:
        matrix[rows, rows * (1 - prepared.skew)] += damping * diagonal
        corner[np.arange(q), np.arange(q)] += damping * diagonal_border
    return Equations(
        cost, promised, failed, undetermined, matrix, border, corner, right, right_border, diagonal,
        diagonal_border, v_inverse, v_right, cameras,
    )  # fmt: skip


def factor(prepared: Prepared, equations: Equations) -> Factored:
    """Cholesky factor of the photographs' matrix (in its place) and of what the border adds."""
    routine = dpbtrf if prepared.skew else dpotrf
    names = {"overwrite_ab": 1} if prepared.skew else {"overwrite_a": 1, "clean": 0}
    _, info = routine(equations.matrix.T, lower=1, **names)
    n, q = len(equations.right), len(equations.right_border)
    rows = np.arange(n)
    empty = np.zeros((n, 0))
    if info > 0:
        return Factored(equations.matrix, empty, np.zeros((0, 0)), int(info) - 1)
    pivots = equations.matrix[rows, rows * (1 - prepared.skew)] ** 2
    weak = pivots < _SINGULAR * equations.diagonal
    if weak.any():
        return Factored(equations.matrix, empty, np.zeros((0, 0)), int(np.argmax(weak)))
    half = np.ascontiguousarray(equations.border.T)
    corner = np.zeros((0, 0))
    if q:
        system.forward(equations.matrix, prepared.skew, half)
        reduced = equations.corner - half.T @ half
        corner, info = dpotrf(reduced, lower=1, clean=1)
        if info == 0:
            weak = np.diag(corner) ** 2 < _SINGULAR * equations.diagonal_border
            info = int(np.argmax(weak)) + 1 if weak.any() else 0
        if info > 0:
            return Factored(equations.matrix, half, corner, n + int(info) - 1)
    return Factored(equations.matrix, half, corner, -1)


def solve(
    prepared: Prepared, equations: Equations, factored: Factored, state: State, width: float = math.inf
) -> Step:
    """Corrections of all unknowns."""
    layout = prepared.layout
    n = len(state.centres)
    y = equations.right[:, None].copy()
    system.forward(factored.factor, prepared.skew, y)
    shared = np.zeros(len(layout.names))
    if len(shared):
        rest = equations.right_border - factored.half.T @ y[:, 0]
        lower = factored.corner
        shared = np.linalg.solve(lower.T, np.linalg.solve(lower, rest))
        y[:, 0] -= factored.half @ shared
    system.backward(factored.factor, prepared.skew, y)
    photos = y.reshape(n, 6)[prepared.place]
    points = np.empty_like(state.points)
    cameras = equations.cameras
    normal.correct_points(
        prepared.start, prepared.photo, prepared.xy, prepared.weight, state.points, state.centres,
        state.rotations, prepared.free_photo, prepared.network.photographs.camera, cameras.model,
        cameras.packed, cameras.active, cameras.jacobian, layout.first, layout.free, prepared.control,
        prepared.control_free, width, equations.v_inverse, equations.v_right, photos, shared, points,
    )  # fmt: skip
    promised = equations.promised_by_points + float(
        equations.right @ y[:, 0] + equations.right_border @ shared
    )
    return Step(photos, points, shared, promised)
