"""Normal equations of a block with the points eliminated (Schur complement).

The matrix of the photographs is stored by columns of its lower part: entry (i, j), i >= j, is
``band[j, i - j]`` in band form and ``band[j, i]`` in dense form; `skew` is 1 or 0 accordingly. LAPACK reads
both as they lie. The unknowns of cameras are a border of `q` rows. What an observation adds is written with
its information N about the point and the motion T of the photograph: see `small`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stereomate.block.kernels.elimination import eliminate_border, eliminate_cameras, eliminate_photos
from stereomate.block.kernels.projection import observe
from stereomate.block.kernels.small import invert_symmetric, symmetric_vector
from stereomate.jit import inline_kernel, kernel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]


@inline_kernel
def loss_factor(square: float, width: float) -> tuple[float, float]:
    """Huber: (weight factor, loss) of an observation whose squared normalised residual is `square`."""
    if square <= width * width:
        return 1.0, square
    t = math.sqrt(square)
    return width / t, 2.0 * width * t - width * width


@kernel
def build(
    start: Indices,
    photo: Indices,
    xy: Array,
    weight: Array,
    points: Array,
    centres: Array,
    rotations: Array,
    place: Indices,
    camera: Indices,
    model: Indices,
    packed: Array,
    entries: Indices,
    derivatives: Array,
    first: Indices,
    free: Indices,
    camera_start: Indices,
    camera_of: Indices,
    control: Indices,
    control_xyz: Array,
    control_weight: Array,
    control_free: Array,
    width: float,
    damping: float,
    skew: int,
    band: Array,
    border: Array,
    corner: Array,
    right: Array,
    right_border: Array,
    diagonal: Array,
    diagonal_border: Array,
    information: Array,
    by_border: Array,
    v_inverse: Array,
    v_right: Array,
    solvable: Flags,
) -> tuple[float, float, int, int]:
    """Reduced normal equations at a state.

    Observations are sorted by point (`start`) and within a point by ``place[photo]``. `weight` (m, 2): 0
    takes an observation out. Cameras: unknowns of camera c are border rows ``first[c]`` to ``first[c]
    + free[c]``, `entries` (c, k, 2) and `derivatives` (c, k) as `projection.pixel_of` needs them; those that
    see point j are ``camera_of[camera_start[j] : camera_start[j + 1]]``. `control` (p) is the row
    of a point in `control_xyz` (k, 3), `control_weight` (k, 3, 3) and `control_free` (k, 3; 0 for what is
    held), or -1. `width`: of Huber's loss, infinite for none.

    Added to: `band`, `border` (q, 6 n), `corner`, `right`, `right_border`, `diagonal` and `diagonal_border`
    (before elimination). Written: `information` (m, 6), `by_border` (cameras of points, columns, 3):
    camera unknowns with the point; `v_inverse` (p, 6), `v_right` (p, 3), `solvable` (p).

    Returns
    -------
    cost, promised, failed, undetermined
        Weighted sum of squares (or losses) of image points and control; the part of its decrease that the
        points alone promise; observations that cannot be computed; points without a solution.
    """
    longest = 1
    for j in range(start.shape[0] - 1):
        longest = max(longest, start[j + 1] - start[j])
    columns = by_border.shape[1]
    by_point, by_camera = np.empty((2, 3)), np.empty((2, columns))
    scratch = np.zeros((2, packed.shape[1]))
    # Camera unknowns with the point, of each observation, and of each camera times V⁻¹.
    single, solved = np.empty((longest, columns, 3)), np.empty((free.shape[0], columns, 3))
    v, b = np.empty(6), np.empty(3)
    cost = promised = 0.0
    failed = undetermined = 0
    for j in range(start.shape[0] - 1):
        v[:] = 0.0
        b[:] = 0.0
        low, high = camera_start[j], camera_start[j + 1]
        by_border[low:high] = 0.0
        k_control = control[j]
        used = 0
        for i in range(start[j], start[j + 1]):
            information[i] = 0.0
            wx, wy = weight[i, 0], weight[i, 1]
            if wx == 0.0 and wy == 0.0:
                continue
            k = photo[i]
            c = camera[k]
            column, line, ok = observe(
                model[c], packed[c], centres[k], rotations[k], points[j], free[c], entries[c],
                derivatives[c], by_point, by_camera, scratch,
            )  # fmt: skip
            if not ok:
                failed += 1
                continue
            used += 1
            rx, ry = xy[i, 0] - column, xy[i, 1] - line
            factor, loss = loss_factor(wx * rx * rx + wy * ry * ry, width)
            cost += loss
            _about_point(by_point, wx * factor, wy * factor, rx, ry, information[i], v, b)
            dx, dy, dz = (
                points[j, 0] - centres[k, 0],
                points[j, 1] - centres[k, 1],
                points[j, 2] - centres[k, 2],
            )
            _to_photo(by_point, wx * factor, wy * factor, rx, ry, dx, dy, dz, 6 * place[k], right)
            if free[c] > 0:
                at = low
                while camera_of[at] != c:
                    at += 1
                _to_camera(
                    by_point, by_camera, wx * factor, wy * factor, rx, ry, first[c], free[c], corner,
                    right_border, diagonal_border, single[i - start[j]], by_border[at],
                )  # fmt: skip
        if k_control >= 0:
            cost += _to_control(
                control_xyz[k_control], control_weight[k_control], control_free[k_control], points[j], v, b
            )
        for a in (0, 3, 5):
            v[a] *= 1.0 + damping
        solvable[j] = (used > 0 or k_control >= 0) and invert_symmetric(
            v[0], v[1], v[2], v[3], v[4], v[5], v_inverse[j]
        )
        if not solvable[j]:
            v_inverse[j] = 0.0
            undetermined += 1
        elif k_control >= 0:
            _hold(control_free[k_control], v_inverse[j])
        v_right[j] = b
        y0, y1, y2 = symmetric_vector(v_inverse[j], b[0], b[1], b[2])
        promised += b[0] * y0 + b[1] * y1 + b[2] * y2
        eliminate_cameras(
            v_inverse[j], y0, y1, y2, camera_of[low:high], first, free, by_border[low:high], solved, corner,
            right_border,
        )  # fmt: skip
        eliminate_photos(
            start[j], start[j + 1], photo, points[j], centres, place, camera, v_inverse[j], y0, y1, y2,
            information, skew, band, right, diagonal,
        )  # fmt: skip
        if columns > 0:
            eliminate_border(
                start[j], start[j + 1], photo, points[j], centres, place, camera, camera_of[low:high], first,
                free, information, single, solved, border,
            )  # fmt: skip
    return cost, promised, failed, undetermined


@inline_kernel
def _about_point(a: Array, wx: float, wy: float, rx: float, ry: float, n: Array, v: Array, b: Array) -> None:
    """Information of an observation about its point into `n`, and added to `v` and `b`."""
    x0, x1, x2, y0, y1, y2 = a[0, 0], a[0, 1], a[0, 2], a[1, 0], a[1, 1], a[1, 2]
    px0, px1, px2, py0, py1, py2 = wx * x0, wx * x1, wx * x2, wy * y0, wy * y1, wy * y2
    n0, n1, n2 = px0 * x0 + py0 * y0, px0 * x1 + py0 * y1, px0 * x2 + py0 * y2
    n3, n4, n5 = px1 * x1 + py1 * y1, px1 * x2 + py1 * y2, px2 * x2 + py2 * y2
    n[0], n[1], n[2], n[3], n[4], n[5] = n0, n1, n2, n3, n4, n5
    v[0] += n0
    v[1] += n1
    v[2] += n2
    v[3] += n3
    v[4] += n4
    v[5] += n5
    b[0] += px0 * rx + py0 * ry
    b[1] += px1 * rx + py1 * ry
    b[2] += px2 * rx + py2 * ry


@inline_kernel
def _to_photo(
    a: Array,
    wx: float,
    wy: float,
    rx: float,
    ry: float,
    dx: float,
    dy: float,
    dz: float,
    at: int,
    right: Array,
) -> None:
    """Right side of the photograph: ``Tᵀ Aᵀ P r``."""
    rx, ry = wx * rx, wy * ry
    g0 = a[0, 0] * rx + a[1, 0] * ry
    g1 = a[0, 1] * rx + a[1, 1] * ry
    g2 = a[0, 2] * rx + a[1, 2] * ry
    right[at] -= g0
    right[at + 1] -= g1
    right[at + 2] -= g2
    right[at + 3] += g1 * dz - g2 * dy
    right[at + 4] += g2 * dx - g0 * dz
    right[at + 5] += g0 * dy - g1 * dx


@inline_kernel
def _to_camera(
    a: Array,
    by_camera: Array,
    wx: float,
    wy: float,
    rx: float,
    ry: float,
    first: int,
    free: int,
    corner: Array,
    right_border: Array,
    diagonal_border: Array,
    single: Array,
    total: Array,
) -> None:
    """Camera unknowns with themselves, and with the point: into `single` and added to `total`."""
    for f in range(free):
        jx, jy = wx * by_camera[0, f], wy * by_camera[1, f]
        right_border[first + f] += jx * rx + jy * ry
        diagonal_border[first + f] += jx * by_camera[0, f] + jy * by_camera[1, f]
        for g in range(f + 1):
            corner[first + f, first + g] += jx * by_camera[0, g] + jy * by_camera[1, g]
        for x in range(3):
            value = jx * a[0, x] + jy * a[1, x]
            single[f, x] = value
            total[f, x] += value


@inline_kernel
def _to_control(xyz: Array, weight: Array, free: Array, point: Array, v: Array, b: Array) -> float:
    """Add a control point to the information about its point; its cost. Held axes stand alone."""
    cost = 0.0
    at = 0
    for a in range(3):
        for d in range(3):
            g = weight[a, d] * free[a] * free[d]
            difference = xyz[d] - point[d]
            b[a] += g * difference
            cost += g * difference * (xyz[a] - point[a])
            if d >= a:
                v[at] = v[at] * free[a] * free[d] + g
                if d == a and free[a] == 0.0:
                    v[at] = 1.0
                at += 1
    for a in range(3):
        b[a] *= free[a]
    return cost


@inline_kernel
def _hold(free: Array, v_inverse: Array) -> None:
    """Nothing moves along axes that control holds."""
    at = 0
    for a in range(3):
        for d in range(a, 3):
            v_inverse[at] *= free[a] * free[d]
            at += 1
