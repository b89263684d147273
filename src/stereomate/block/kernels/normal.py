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
from stereomate.block.kernels.projection import (
    by_entries,
    by_unknowns,
    lens_of,
    observe,
    observe_general,
)
from stereomate.block.kernels.small import (
    NO_SIX,
    Six,
    Three,
    invert_symmetric,
    nine_of,
    set_six,
    symmetric_vector,
    three_of,
)
from stereomate.camera.kernels.layout import BROWN
from stereomate.jit import fused_inline_kernel as inline_kernel
from stereomate.jit import fused_kernel as kernel

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
    + free[c]``, `entries` (c, k, 2) and `derivatives` (c, k) as `projection.observe` needs them; those that
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
    by_camera, scratch = np.empty((1, 2, columns)), np.zeros((3, packed.shape[1]))
    # Camera unknowns with the point, of each observation, and of each camera times V⁻¹.
    single, solved = np.empty((longest, columns, 3)), np.empty((free.shape[0], columns, 3))
    p, flat = packed.reshape(packed.size), band.reshape(band.size)
    v, b = np.empty(6), np.empty(3)
    cost = promised = 0.0
    failed = undetermined = 0
    for j in range(start.shape[0] - 1):
        v[:] = 0.0
        b[:] = 0.0
        low, high = camera_start[j], camera_start[j + 1]
        for t in range(low, high):
            for f in range(columns):
                by_border[t, f, 0] = by_border[t, f, 1] = by_border[t, f, 2] = 0.0
        point = three_of(points, j)
        row = control[j]
        used = 0
        for i in range(start[j], start[j + 1]):
            set_six(information, i, NO_SIX)
            wx, wy = weight[i, 0], weight[i, 1]
            if wx == 0.0 and wy == 0.0:
                continue
            k = photo[i]
            c = camera[k]
            centre = three_of(centres, k)
            lens = lens_of(p, c)
            if model[c] <= BROWN:
                observed, inner = observe(model[c], lens, centre, nine_of(rotations, k), point)
                if free[c] > 0:
                    by_entries(lens, inner, scratch)
            else:
                observed = observe_general(model[c], p, c, centre, nine_of(rotations, k), point, scratch)
            column, line, ok, ax, ay = observed
            if not ok:
                failed += 1
                continue
            used += 1
            rx, ry = xy[i, 0] - column, xy[i, 1] - line
            factor, loss = loss_factor(wx * rx * rx + wy * ry * ry, width)
            wx, wy = wx * factor, wy * factor
            cost += loss
            g = _about_point(ax, ay, wx, wy, rx, ry, i, information, v, b)
            _to_photo(g, point, centre, 6 * place[k], right)
            if free[c] > 0:
                by_unknowns(c, free[c], entries, derivatives, scratch, 0, by_camera)
                at = low
                while camera_of[at] != c:
                    at += 1
                _to_camera(
                    ax, ay, by_camera, wx, wy, rx, ry, first[c], free[c], corner, right_border,
                    diagonal_border, single, i - start[j], by_border, at,
                )  # fmt: skip
        if row >= 0:
            cost += _to_control(row, control_xyz, control_weight, control_free, point, v, b)
        for x in (0, 3, 5):
            v[x] *= 1.0 + damping
        ok, w = invert_symmetric(v[0], v[1], v[2], v[3], v[4], v[5])
        solvable[j] = ok and (used > 0 or row >= 0)
        if not solvable[j]:
            w = NO_SIX
            undetermined += 1
        elif row >= 0:
            w = _held(row, control_free, w)
        y = symmetric_vector(w, b[0], b[1], b[2])
        promised += b[0] * y[0] + b[1] * y[1] + b[2] * y[2]
        set_six(v_inverse, j, w)
        v_right[j, 0], v_right[j, 1], v_right[j, 2] = b[0], b[1], b[2]
        eliminate_cameras(w, y, low, high, camera_of, first, free, by_border, solved, corner, right_border)
        eliminate_photos(
            start[j], start[j + 1], photo, point, centres, place, w, y, information,
            band.shape[1] - skew, flat, right, diagonal,
        )  # fmt: skip
        if columns > 0:
            eliminate_border(
                start[j], start[j + 1], photo, point, centres, place, camera, low, high, camera_of, first,
                free, information, single, solved, border,
            )  # fmt: skip
    return cost, promised, failed, undetermined


@inline_kernel
def _about_point(
    x: Three,
    y: Three,
    wx: float,
    wy: float,
    rx: float,
    ry: float,
    i: int,
    information: Array,
    v: Array,
    b: Array,
) -> Three:
    """Information of observation `i` about its point, added to `v` and `b` too; returns ``Aᵀ P r``."""
    px0, px1, px2, py0, py1, py2 = wx * x[0], wx * x[1], wx * x[2], wy * y[0], wy * y[1], wy * y[2]
    n = (
        px0 * x[0] + py0 * y[0], px0 * x[1] + py0 * y[1], px0 * x[2] + py0 * y[2],
        px1 * x[1] + py1 * y[1], px1 * x[2] + py1 * y[2], px2 * x[2] + py2 * y[2],
    )  # fmt: skip
    set_six(information, i, n)
    v[0] += n[0]
    v[1] += n[1]
    v[2] += n[2]
    v[3] += n[3]
    v[4] += n[4]
    v[5] += n[5]
    g = px0 * rx + py0 * ry, px1 * rx + py1 * ry, px2 * rx + py2 * ry
    b[0] += g[0]
    b[1] += g[1]
    b[2] += g[2]
    return g


@inline_kernel
def _to_photo(g: Three, point: Three, centre: Three, at: int, right: Array) -> None:
    """Right side of the photograph: ``Tᵀ g``, g = ``Aᵀ P r``."""
    dx, dy, dz = point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]
    right[at] -= g[0]
    right[at + 1] -= g[1]
    right[at + 2] -= g[2]
    right[at + 3] += g[1] * dz - g[2] * dy
    right[at + 4] += g[2] * dx - g[0] * dz
    right[at + 5] += g[0] * dy - g[1] * dx


@inline_kernel
def _to_camera(
    ax: Three,
    ay: Three,
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
    ray: int,
    total: Array,
    at: int,
) -> None:
    """Camera unknowns with themselves, and with the point: into `single` [ray] and added to `total` [at]."""
    for f in range(free):
        jx, jy = wx * by_camera[0, 0, f], wy * by_camera[0, 1, f]
        right_border[first + f] += jx * rx + jy * ry
        diagonal_border[first + f] += jx * by_camera[0, 0, f] + jy * by_camera[0, 1, f]
        for g in range(f + 1):
            corner[first + f, first + g] += jx * by_camera[0, 0, g] + jy * by_camera[0, 1, g]
        s0, s1, s2 = jx * ax[0] + jy * ay[0], jx * ax[1] + jy * ay[1], jx * ax[2] + jy * ay[2]
        single[ray, f, 0], single[ray, f, 1], single[ray, f, 2] = s0, s1, s2
        total[at, f, 0] += s0
        total[at, f, 1] += s1
        total[at, f, 2] += s2


@inline_kernel
def _to_control(row: int, xyz: Array, weight: Array, free: Array, point: Three, v: Array, b: Array) -> float:
    """Add a control point to the information about its point; its cost. Held axes stand alone."""
    cost = 0.0
    at = 0
    for a in range(3):
        for d in range(3):
            g = weight[row, a, d] * free[row, a] * free[row, d]
            difference = xyz[row, d] - point[d]
            b[a] += g * difference
            cost += g * difference * (xyz[row, a] - point[a])
            if d >= a:
                v[at] = v[at] * free[row, a] * free[row, d] + g
                if d == a and free[row, a] == 0.0:
                    v[at] = 1.0
                at += 1
    for a in range(3):
        b[a] *= free[row, a]
    return cost


@inline_kernel
def _held(row: int, free: Array, w: Six) -> Six:
    """V⁻¹ where nothing moves along axes that control holds."""
    x, y, z = free[row, 0], free[row, 1], free[row, 2]
    return w[0] * x * x, w[1] * x * y, w[2] * x * z, w[3] * y * y, w[4] * y * z, w[5] * z * z
