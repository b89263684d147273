"""Normal equations of a block with the points eliminated (Schur complement), and the points afterwards.

The matrix of the photographs is stored by columns of its lower part: entry (i, j), i >= j, is
``band[j, i - j]`` in band form and ``band[j, i]`` in dense form; `skew` is 1 or 0 accordingly. LAPACK reads
both as they lie. The unknowns of cameras are a border of `q` rows. What an observation adds is written with
its information N about the point and the motion T of the photograph: see `small`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stereomate.block.kernels.projection import observe
from stereomate.block.kernels.small import (
    Nine,
    columns_cross,
    general_symmetric,
    invert_symmetric,
    rows_cross,
    seen_at,
    symmetric_vector,
    times_symmetric,
)
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
        _eliminate_cameras(
            v_inverse[j], y0, y1, y2, camera_of[low:high], first, free, by_border[low:high], solved, corner,
            right_border,
        )  # fmt: skip
        _eliminate_photos(
            start[j], start[j + 1], photo, points[j], centres, place, camera, v_inverse[j], y0, y1, y2,
            information, skew, band, right, diagonal,
        )  # fmt: skip
        if columns > 0:
            _border(
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


@inline_kernel
def _eliminate_cameras(
    v_inverse: Array,
    y0: float,
    y1: float,
    y2: float,
    cameras: Indices,
    first: Indices,
    free: Indices,
    by_border: Array,
    solved: Array,
    corner: Array,
    right_border: Array,
) -> None:
    """Take a point out of the unknowns of its cameras; `solved`: these with the point, times V⁻¹."""
    for t in range(cameras.shape[0]):
        c = cameras[t]
        for f in range(free[c]):
            w0, w1, w2 = by_border[t, f, 0], by_border[t, f, 1], by_border[t, f, 2]
            row = first[c] + f
            right_border[row] -= w0 * y0 + w1 * y1 + w2 * y2
            s0, s1, s2 = symmetric_vector(v_inverse, w0, w1, w2)
            solved[t, f, 0], solved[t, f, 1], solved[t, f, 2] = s0, s1, s2
            for t2 in range(t + 1):
                c2 = cameras[t2]
                for g in range(f + 1 if t2 == t else free[c2]):
                    corner[row, first[c2] + g] -= (
                        s0 * by_border[t2, g, 0] + s1 * by_border[t2, g, 1] + s2 * by_border[t2, g, 2]
                    )


@inline_kernel
def _eliminate_photos(
    low: int,
    high: int,
    photo: Indices,
    point: Array,
    centres: Array,
    place: Indices,
    camera: Indices,
    v_inverse: Array,
    y0: float,
    y1: float,
    y2: float,
    information: Array,
    skew: int,
    band: Array,
    right: Array,
    diagonal: Array,
) -> None:
    """Add the photographs of a point with themselves and take the point out of all of them."""
    for i in range(low, high):
        n = information[i]
        if n[0] + n[3] + n[5] == 0.0:
            continue
        k = photo[i]
        at = 6 * place[k]
        dx, dy, dz = seen_at(point, centres[k])
        g0, g1, g2 = symmetric_vector(n, y0, y1, y2)
        right[at] += g0
        right[at + 1] += g1
        right[at + 2] += g2
        right[at + 3] -= g1 * dz - g2 * dy
        right[at + 4] -= g2 * dx - g0 * dz
        right[at + 5] -= g0 * dy - g1 * dx
        u = times_symmetric(n, v_inverse)
        # Itself: N - N V⁻¹ N.
        c = general_symmetric(u, n)
        own = (n[0] - c[0], n[1] - c[1], n[2] - c[2], n[1] - c[3], n[3] - c[4], n[4] - c[5],
               n[2] - c[6], n[4] - c[7], n[5] - c[8])  # fmt: skip
        e = rows_cross(own, dx, dy, dz)
        h = columns_cross(e, dx, dy, dz)
        _add_own(own, e, h, at, skew, band)
        direct = (n[0], n[1], n[2], n[1], n[3], n[4], n[2], n[4], n[5])
        turned = columns_cross(rows_cross(direct, dx, dy, dz), dx, dy, dz)
        diagonal[at] += n[0]
        diagonal[at + 1] += n[3]
        diagonal[at + 2] += n[5]
        diagonal[at + 3] += turned[0]
        diagonal[at + 4] += turned[4]
        diagonal[at + 5] += turned[8]
        for i2 in range(low, i):
            n2 = information[i2]
            if n2[0] + n2[3] + n2[5] == 0.0:
                continue
            k2 = photo[i2]
            c = general_symmetric(u, n2)
            x, y, z = seen_at(point, centres[k2])
            e = rows_cross(c, x, y, z)
            _subtract(
                c,
                e,
                columns_cross(c, dx, dy, dz),
                columns_cross(e, dx, dy, dz),
                at,
                6 * place[k2],
                skew,
                band,
            )


@inline_kernel
def _add_own(c: Nine, e: Nine, h: Nine, at: int, skew: int, band: Array) -> None:
    """Tᵀ C T of one photograph, lower part: [[C, -E], [-Eᵀ, H]], E = C K, H = Kᵀ E."""
    o = at - skew * at
    band[at, o] += c[0]
    band[at, o + 1] += c[3]
    band[at, o + 2] += c[6]
    band[at, o + 3] -= e[0]
    band[at, o + 4] -= e[1]
    band[at, o + 5] -= e[2]
    o -= skew
    band[at + 1, o + 1] += c[4]
    band[at + 1, o + 2] += c[7]
    band[at + 1, o + 3] -= e[3]
    band[at + 1, o + 4] -= e[4]
    band[at + 1, o + 5] -= e[5]
    o -= skew
    band[at + 2, o + 2] += c[8]
    band[at + 2, o + 3] -= e[6]
    band[at + 2, o + 4] -= e[7]
    band[at + 2, o + 5] -= e[8]
    o -= skew
    band[at + 3, o + 3] += h[0]
    band[at + 3, o + 4] += h[3]
    band[at + 3, o + 5] += h[6]
    o -= skew
    band[at + 4, o + 4] += h[4]
    band[at + 4, o + 5] += h[7]
    o -= skew
    band[at + 5, o + 5] += h[8]


@inline_kernel
def _subtract(c: Nine, e: Nine, g: Nine, h: Nine, at: int, before: int, skew: int, band: Array) -> None:
    """Tᵀ C T₂ of two photographs: [[C, -E], [-G, H]], E = C K₂, G = Kᵀ C, H = Kᵀ C K₂."""
    o = at - skew * before
    band[before, o] -= c[0]
    band[before, o + 1] -= c[3]
    band[before, o + 2] -= c[6]
    band[before, o + 3] += g[0]
    band[before, o + 4] += g[3]
    band[before, o + 5] += g[6]
    o -= skew
    band[before + 1, o] -= c[1]
    band[before + 1, o + 1] -= c[4]
    band[before + 1, o + 2] -= c[7]
    band[before + 1, o + 3] += g[1]
    band[before + 1, o + 4] += g[4]
    band[before + 1, o + 5] += g[7]
    o -= skew
    band[before + 2, o] -= c[2]
    band[before + 2, o + 1] -= c[5]
    band[before + 2, o + 2] -= c[8]
    band[before + 2, o + 3] += g[2]
    band[before + 2, o + 4] += g[5]
    band[before + 2, o + 5] += g[8]
    o -= skew
    band[before + 3, o] += e[0]
    band[before + 3, o + 1] += e[3]
    band[before + 3, o + 2] += e[6]
    band[before + 3, o + 3] -= h[0]
    band[before + 3, o + 4] -= h[3]
    band[before + 3, o + 5] -= h[6]
    o -= skew
    band[before + 4, o] += e[1]
    band[before + 4, o + 1] += e[4]
    band[before + 4, o + 2] += e[7]
    band[before + 4, o + 3] -= h[1]
    band[before + 4, o + 4] -= h[4]
    band[before + 4, o + 5] -= h[7]
    o -= skew
    band[before + 5, o] += e[2]
    band[before + 5, o + 1] += e[5]
    band[before + 5, o + 2] += e[8]
    band[before + 5, o + 3] -= h[2]
    band[before + 5, o + 4] -= h[5]
    band[before + 5, o + 5] -= h[8]


@inline_kernel
def _border(
    low: int,
    high: int,
    photo: Indices,
    point: Array,
    centres: Array,
    place: Indices,
    camera: Indices,
    cameras: Indices,
    first: Indices,
    free: Indices,
    information: Array,
    single: Array,
    solved: Array,
    border: Array,
) -> None:
    """Camera unknowns with the photographs of a point: ``(B - B_point V⁻¹ N) T``."""
    for i in range(low, high):
        n = information[i]
        if n[0] + n[3] + n[5] == 0.0:
            continue
        k = photo[i]
        at = 6 * place[k]
        dx, dy, dz = seen_at(point, centres[k])
        for t in range(cameras.shape[0]):
            c = cameras[t]
            own = c == camera[k]
            for f in range(free[c]):
                g0, g1, g2 = symmetric_vector(n, solved[t, f, 0], solved[t, f, 1], solved[t, f, 2])
                if own:
                    s = single[i - low, f]
                    g0, g1, g2 = g0 - s[0], g1 - s[1], g2 - s[2]
                row = border[first[c] + f]
                row[at] += g0
                row[at + 1] += g1
                row[at + 2] += g2
                row[at + 3] -= g1 * dz - g2 * dy
                row[at + 4] -= g2 * dx - g0 * dz
                row[at + 5] -= g0 * dy - g1 * dx


@kernel
def hold(
    free_photo: Array, place: Indices, skew: int, band: Array, border: Array, right: Array, diagonal: Array
) -> None:
    """Let unknowns of photographs that are held stand alone."""
    n = right.shape[0]
    reach = band.shape[1]
    for k in range(free_photo.shape[0]):
        for a in range(6):
            if free_photo[k, a] != 0.0:
                continue
            at = 6 * place[k] + a
            for i in range(at + 1, min(n, at + reach) if skew == 1 else n):
                band[at, i - skew * at] = 0.0
            for j in range(max(0, at - reach + 1) if skew == 1 else 0, at):
                band[j, at - skew * j] = 0.0
            border[:, at] = 0.0
            right[at] = 0.0
            band[at, at - skew * at] = diagonal[at] = 1.0


@kernel
def correct_points(
    start: Indices,
    photo: Indices,
    points: Array,
    centres: Array,
    camera_start: Indices,
    camera_of: Indices,
    first: Indices,
    free: Indices,
    information: Array,
    by_border: Array,
    v_inverse: Array,
    v_right: Array,
    step: Array,
    step_border: Array,
    out: Array,
) -> None:
    """Corrections of the points ``V⁻¹ (b - Wᵀ step)`` into `out` (p, 3).

    `step` (n, 6) in the order of the photographs, `step_border` (q,).
    """
    for j in range(start.shape[0] - 1):
        b0, b1, b2 = v_right[j, 0], v_right[j, 1], v_right[j, 2]
        for i in range(start[j], start[j + 1]):
            k = photo[i]
            dx, dy, dz = (
                points[j, 0] - centres[k, 0],
                points[j, 1] - centres[k, 1],
                points[j, 2] - centres[k, 2],
            )
            tx, ty, tz = step[k, 3], step[k, 4], step[k, 5]
            e0, e1, e2 = symmetric_vector(
                information[i],
                dy * tz - dz * ty - step[k, 0],
                dz * tx - dx * tz - step[k, 1],
                dx * ty - dy * tx - step[k, 2],
            )
            b0, b1, b2 = b0 - e0, b1 - e1, b2 - e2
        for t in range(camera_start[j], camera_start[j + 1]):
            c = camera_of[t]
            for f in range(free[c]):
                moved = step_border[first[c] + f]
                b0 -= by_border[t, f, 0] * moved
                b1 -= by_border[t, f, 1] * moved
                b2 -= by_border[t, f, 2] * moved
        out[j, 0], out[j, 1], out[j, 2] = symmetric_vector(v_inverse[j], b0, b1, b2)


@kernel
def photos_from_points(
    start: Indices,
    photo: Indices,
    points: Array,
    centres: Array,
    place: Indices,
    camera_start: Indices,
    camera_of: Indices,
    first: Indices,
    free: Indices,
    information: Array,
    by_border: Array,
    values: Array,
    out: Array,
    out_shared: Array,
) -> None:
    """Subtract ``W values`` (p, 3): from `out` (6 n,) in the order of the matrix and `out_shared` (q,)."""
    for j in range(start.shape[0] - 1):
        x, y, z = values[j, 0], values[j, 1], values[j, 2]
        for i in range(start[j], start[j + 1]):
            k = photo[i]
            at = 6 * place[k]
            dx, dy, dz = (
                points[j, 0] - centres[k, 0],
                points[j, 1] - centres[k, 1],
                points[j, 2] - centres[k, 2],
            )
            g0, g1, g2 = symmetric_vector(information[i], x, y, z)
            out[at] += g0
            out[at + 1] += g1
            out[at + 2] += g2
            out[at + 3] -= g1 * dz - g2 * dy
            out[at + 4] -= g2 * dx - g0 * dz
            out[at + 5] -= g0 * dy - g1 * dx
        for t in range(camera_start[j], camera_start[j + 1]):
            c = camera_of[t]
            for f in range(free[c]):
                out_shared[first[c] + f] -= (
                    by_border[t, f, 0] * x + by_border[t, f, 1] * y + by_border[t, f, 2] * z
                )
