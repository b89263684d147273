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
from scipy.linalg.lapack import dpbtrf, dpotrf, dpotrs

from stereomate.block.kernels import normal, system
from stereomate.block.kernels import points as kernel_points
from stereomate.block.navigation import groups_of
from stereomate.block.prepared import Prepared
from stereomate.block.triangular import backward, forward
from stereomate.block.unknowns import State, packed_camera, prior_residuals

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

# Part of an unknown's information that must be left when all others are unknown too.
_SINGULAR: Final = 1e-13


@dataclass(frozen=True, eq=False)
class CameraArrays:
    """Cameras as the kernels read them: model codes, parameter arrays, and what moves their entries.

    `entries` (c, k, 2): an entry of the parameter array and the unknown of the camera that moves it, with
    `derivatives` (c, k); -1 ends the list of a camera.
    """

    model: Integers
    packed: Array
    entries: Integers
    derivatives: Array


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
    rows : ndarray, shape (q + 1, 6 n)
        The border, and the right side of the photographs below it; become ``L⁻¹`` times them.
    right : ndarray, shape (6 n,)
        A copy of the right side.
    corner, right_border, diagonal, diagonal_border : ndarray
    information : ndarray, shape (m, 6)
        Of each observation about its point.
    by_border : ndarray, shape (cameras of points, columns, 3)
    v_inverse, v_right, solvable : ndarray, shape (p, 6), (p, 3), (p,)
    cameras : CameraArrays
    """

    cost: float
    promised_by_points: float
    failed: int
    undetermined: int
    matrix: Array
    rows: Array
    right: Array
    corner: Array
    right_border: Array
    diagonal: Array
    diagonal_border: Array
    information: Array
    by_border: Array
    v_inverse: Array
    v_right: Array
    solvable: Mask
    cameras: CameraArrays


@dataclass(frozen=True, eq=False)
class Factored:
    """Factor of the photographs' matrix L, ``(L⁻¹ Bᵀ)ᵀ`` (q, 6 n), and the factor of the reduced corner.

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


@dataclass(frozen=True, eq=False)
class Workspace:
    """Arrays that every iteration writes anew: fresh memory costs more than the arithmetic on it."""

    matrix: Array
    rows: Array
    information: Array
    by_border: Array
    v_inverse: Array
    v_right: Array
    solvable: Mask


def workspace_of(prepared: Prepared) -> Workspace:
    """Arrays for the equations of a network."""
    layout, p = prepared.layout, len(prepared.start) - 1
    n6 = prepared.free_photo.size
    return Workspace(
        np.empty((n6, prepared.width)),
        np.empty((len(layout.names) + 1, n6)),
        np.empty((len(prepared.order), 6)),
        np.empty((len(prepared.camera_of), int(layout.free.max(initial=0)), 3)),
        np.empty((p, 6)),
        np.empty((p, 3)),
        np.empty(p, np.bool_),
    )


def camera_arrays(prepared: Prepared, state: State) -> CameraArrays:
    """Pack the cameras at a state."""
    layout, cameras = prepared.layout, prepared.network.cameras
    packed, lists = [], []
    for entry, values, chosen in zip(cameras, state.cameras, layout.chosen, strict=True):
        one, moved = packed_camera(entry.camera, values, chosen)
        packed.append(one)
        lists.append(moved)
    most = max(map(len, lists)) + 1
    entries, derivatives = np.full((len(cameras), most, 2), -1), np.zeros((len(cameras), most))
    for c, moved in enumerate(lists):
        for t, (at, unknown, derivative) in enumerate(moved):
            entries[c, t, 0], entries[c, t, 1], derivatives[c, t] = at, unknown, derivative
    models = np.array([entry.camera.jacobian_model for entry in cameras], dtype=np.int64)
    return CameraArrays(models, np.array(packed), entries, derivatives)


def build(
    prepared: Prepared,
    state: State,
    start: State,
    width: float = math.inf,
    damping: float = 0.0,
    workspace: Workspace | None = None,
) -> Equations:
    """Normal equations at a state; `width` of Huber's loss on image points, Marquardt's `damping`.

    They lie in the `workspace`, if one is given: the next ones overwrite them.
    """
    layout, own = prepared.layout, workspace or workspace_of(prepared)
    n6, q = prepared.free_photo.size, len(layout.names)
    cameras = camera_arrays(prepared, state)
    matrix, border, right = own.matrix, own.rows[:q], own.rows[q]
    matrix.fill(0.0)
    own.rows.fill(0.0)
    corner, right_border, diagonal_border = np.zeros((q, q)), np.zeros(q), np.zeros(q)
    diagonal = np.zeros(n6)
    cost, promised, failed, undetermined = normal.build(
        prepared.start, prepared.photo, prepared.xy, prepared.weight, state.points, state.centres,
        state.rotations, prepared.place, prepared.network.photographs.camera, cameras.model, cameras.packed,
        cameras.entries, cameras.derivatives, layout.first, layout.free, prepared.camera_start,
        prepared.camera_of, prepared.control, prepared.control_xyz, prepared.control_weight,
        prepared.control_free, width, damping, prepared.skew, matrix, border, corner, right, right_border,
        diagonal, diagonal_border, own.information, own.by_border, own.v_inverse, own.v_right, own.solvable,
    )  # fmt: skip
    for group in groups_of(prepared.network, layout, state).values():
        cost += system.add_group(
            group.photo, group.residual, group.weight, group.by_photo, group.columns, group.by_shared,
            prepared.place, prepared.skew, matrix, border, corner, right, right_border, diagonal,
            diagonal_border,
        )  # fmt: skip
    if q:
        weight = 1.0 / layout.prior_sigma**2
        residual = prior_residuals(state, start, layout)
        cost += float(weight @ residual**2)
        right_border += weight * residual
        diagonal_border += weight
        corner.flat[:: q + 1] += weight
    if prepared.any_held:
        kernel_points.hold(
            prepared.free_photo, prepared.place, prepared.skew, matrix, border, right, diagonal
        )
    if damping > 0.0:
        _diagonal_of(prepared, matrix)[:] += damping * diagonal
        corner.flat[:: q + 1] += damping * diagonal_border
    return Equations(
        cost, promised, failed, undetermined, matrix, own.rows, right.copy(), corner, right_border, diagonal,
        diagonal_border, own.information, own.by_border, own.v_inverse, own.v_right, own.solvable, cameras,
    )  # fmt: skip


def _diagonal_of(prepared: Prepared, matrix: Array) -> Array:
    """View of the diagonal of the photographs' matrix."""
    return matrix[:, 0] if prepared.skew else matrix.reshape(-1)[:: matrix.shape[1] + 1]


def factor(prepared: Prepared, equations: Equations) -> Factored:
    """Cholesky factor of the photographs' matrix (in its place) and of what the border adds."""
    matrix, rows = equations.matrix, equations.rows
    if prepared.skew:
        _, info = dpbtrf(matrix.T, lower=1, overwrite_ab=1)
    else:
        _, info = dpotrf(matrix.T, lower=1, overwrite_a=1, clean=0)
    n, q = len(equations.right), len(equations.right_border)
    if info > 0:
        return Factored(matrix, np.zeros((0, n)), np.zeros((0, 0)), int(info) - 1)
    weak = _diagonal_of(prepared, matrix) ** 2 < _SINGULAR * equations.diagonal
    if weak.any():
        return Factored(matrix, np.zeros((0, n)), np.zeros((0, 0)), int(np.argmax(weak)))
    forward(matrix, prepared.skew, rows)
    half = rows[:q]
    corner = np.zeros((0, 0))
    if q:
        corner, info = dpotrf(equations.corner - half @ half.T, lower=1, clean=1)
        if info == 0:
            weak = np.diag(corner) ** 2 < _SINGULAR * equations.diagonal_border
            info = int(np.argmax(weak)) + 1 if weak.any() else 0
        if info > 0:
            return Factored(matrix, half, corner, n + int(info) - 1)
    return Factored(matrix, half, corner, -1)


def solve(prepared: Prepared, equations: Equations, factored: Factored, state: State) -> Step:
    """Corrections of all unknowns."""
    layout = prepared.layout
    y = equations.rows[-1:].copy()
    shared = np.zeros(len(layout.names))
    if len(shared):
        rest = equations.right_border - factored.half @ y[0]
        shared, _ = dpotrs(factored.corner, rest, lower=1)
        y -= shared @ factored.half
    backward(factored.factor, prepared.skew, y)
    photos = y.reshape(-1, 6)[prepared.place]
    points = np.empty_like(state.points)
    kernel_points.correct_points(
        prepared.start, prepared.photo, state.points, state.centres, prepared.camera_start,
        prepared.camera_of, layout.first, layout.free, equations.information, equations.by_border,
        equations.v_inverse, equations.v_right, photos, shared, points,
    )  # fmt: skip
    promised = equations.promised_by_points + float(equations.right @ y[0] + equations.right_border @ shared)
    return Step(photos, points, shared, promised)
