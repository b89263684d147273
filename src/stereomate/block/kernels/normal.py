"""Normal equations of a block with the points eliminated (Schur complement), and the points afterwards.

The matrix of the photographs is stored by columns of its lower part: entry (i, j), i >= j, is
``band[j, i - j]`` in band form and ``band[j, i]`` in dense form; `skew` is 1 or 0 accordingly. LAPACK reads
both as they lie. The unknowns of cameras are a border of `q` rows.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stereomate.block.kernels.projection import observe
from stereomate.jit import kernel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@kernel
def invert_symmetric(v: Array, out: Array) -> bool:
    """Inverse of a symmetric positive definite 3x3 matrix; False (and zeros) if it is singular."""
    a, b, c, d, e, f = v[0, 0], v[0, 1], v[0, 2], v[1, 1], v[1, 2], v[2, 2]
    # Scaled to a unit diagonal, so that the threshold does not depend on units.
    if not (a > 0.0 and d > 0.0 and f > 0.0):
        out[:] = 0.0
        return False
    sa, sd, sf = 1.0 / math.sqrt(a), 1.0 / math.sqrt(d), 1.0 / math.sqrt(f)
    b, c, e = b * sa * sd, c * sa * sf, e * sd * sf
    m00, m01, m02 = 1.0 - e * e, c * e - b, b * e - c
    determinant = m00 + b * m01 + c * m02
    if not determinant > 1e-14:
        out[:] = 0.0
        return False
    w = 1.0 / determinant
    out[0, 0], out[1, 1], out[2, 2] = (
        m00 * w * sa * sa,
        (1.0 - c * c) * w * sd * sd,
        (1.0 - b * b) * w * sf * sf,
    )
    out[0, 1] = out[1, 0] = m01 * w * sa * sd
    out[0, 2] = out[2, 0] = m02 * w * sa * sf
    out[1, 2] = out[2, 1] = (b * c - e) * w * sd * sf
    return True


@kernel
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
    free_photo: Array,
    camera: Indices,
    model: Indices,
    packed: Array,
    active: Indices,
    jacobian: Array,
    first: Indices,
    free: Indices,
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
    v_inverse: Array,
    v_right: Array,
) -> tuple[float, float, int, int]:
    """Reduced normal equations at a state.

    Observations are sorted by point (`start`) and within a point by ``place[photo]``. `weight` (m, 2): 0
    takes an observation out. Cameras: unknowns of camera c are border columns ``first[c]`` to ``first[c]
    + free[c]``, `jacobian` (c, n_active, q) as `projection.pixel_of` needs it. `control` (p) is the row
    of a point in `control_xyz` (k, 3), `control_weight` (k, 3, 3) and `control_free` (k, 3), or -1.
    `free_photo` (n, 6) and `control_free` are 0 for what is held fixed, else 1. `width`: of Huber's loss,
    infinite for none.

    Everything written is added to; `diagonal` and `diagonal_border` are the diagonals before elimination.

    Returns
    -------
    cost, promised, failed, undetermined
        Weighted sum of squares (or losses) of image points and control; the part of its decrease that the
        points alone promise; observations that cannot be computed; points without a solution.
    """
    q = border.shape[0]
    longest = 1
    for j in range(start.shape[0] - 1):
        longest = max(longest, start[j + 1] - start[j])
    columns = 0
    for c in range(free.shape[0]):
        columns = max(columns, free[c])
    j_photo, j_point, j_camera = np.empty((2, 6)), np.empty((2, 3)), np.empty((2, columns))
    scratch = np.zeros((2, packed.shape[1]))
    # W of each photograph of the point and W V⁻¹, transposed so that the innermost loop runs along memory.
    w_all, wv_all = np.empty((longest, 3, 6)), np.empty((longest, 3, 6))
    w_border, wv_border = np.zeros((q, 3)), np.zeros((q, 3))
    rows_of = np.empty(longest, np.int64)
    touched, is_touched = np.empty(free.shape[0], np.int64), np.zeros(free.shape[0], np.bool_)
    v, vi, b = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    cost = promised = 0.0
    failed = undetermined = 0
    for j in range(start.shape[0] - 1):
        v[:] = 0.0
        b[:] = 0.0
        used = cameras = 0
        k_control = control[j]
        for i in range(start[j], start[j + 1]):
            wx, wy = weight[i, 0], weight[i, 1]
            if wx == 0.0 and wy == 0.0:
                continue
            k = photo[i]
            c = camera[k]
            column, line, ok = observe(
                model[c], packed[c], centres[k], rotations[k], points[j], free[c], active, jacobian[c],
                j_photo, j_point, j_camera, scratch,
            )  # fmt: skip
            if not ok:
                failed += 1
                continue
            rx, ry = xy[i, 0] - column, xy[i, 1] - line
            factor, loss = loss_factor(wx * rx * rx + wy * ry * ry, width)
            cost += loss
            wx, wy = wx * factor, wy * factor
            at = place[k] * 6
            for a in range(6):
                j_photo[0, a] *= free_photo[k, a]
                j_photo[1, a] *= free_photo[k, a]
            if k_control >= 0:
                for a in range(3):
                    j_point[0, a] *= control_free[k_control, a]
                    j_point[1, a] *= control_free[k_control, a]
            # Photograph with itself.
            for a in range(6):
                jx, jy = wx * j_photo[0, a], wy * j_photo[1, a]
                right[at + a] += jx * rx + jy * ry
                base = at + a
                shift = at - skew * base
                for d in range(a, 6):
                    band[base, shift + d] += jx * j_photo[0, d] + jy * j_photo[1, d]
                diagonal[base] += jx * j_photo[0, a] + jy * j_photo[1, a]
            # Point with itself and with the photograph.
            for a in range(3):
                jx, jy = wx * j_point[0, a], wy * j_point[1, a]
                b[a] += jx * rx + jy * ry
                for d in range(3):
                    v[a, d] += jx * j_point[0, d] + jy * j_point[1, d]
                for d in range(6):
                    w_all[used, a, d] = jx * j_photo[0, d] + jy * j_photo[1, d]
            rows_of[used] = at
            used += 1
            # Camera with itself, with the photograph and with the point.
            f0 = first[c]
            if free[c] > 0 and not is_touched[c]:
                is_touched[c] = True
                touched[cameras] = c
                cameras += 1
            for a in range(free[c]):
                jx, jy = wx * j_camera[0, a], wy * j_camera[1, a]
                right_border[f0 + a] += jx * rx + jy * ry
                diagonal_border[f0 + a] += jx * j_camera[0, a] + jy * j_camera[1, a]
                for d in range(free[c]):
                    corner[f0 + a, f0 + d] += jx * j_camera[0, d] + jy * j_camera[1, d]
                for d in range(6):
                    border[f0 + a, at + d] += jx * j_photo[0, d] + jy * j_photo[1, d]
                for d in range(3):
                    w_border[f0 + a, d] += jx * j_point[0, d] + jy * j_point[1, d]
        if k_control >= 0:
            for a in range(3):
                for d in range(3):
                    g = (
                        control_weight[k_control, a, d]
                        * control_free[k_control, a]
                        * control_free[k_control, d]
                    )
                    v[a, d] += g
                    difference = control_xyz[k_control, d] - points[j, d]
                    b[a] += g * difference
                    cost += g * difference * (control_xyz[k_control, a] - points[j, a])
                if control_free[k_control, a] == 0.0:
                    v[a, a] += 1.0
        if damping > 0.0:
            for a in range(3):
                v[a, a] *= 1.0 + damping
        solvable = (used > 0 or k_control >= 0) and invert_symmetric(v, vi)
        if not solvable:
            vi[:] = 0.0
            undetermined += 1
        v_inverse[j, 0], v_inverse[j, 1], v_inverse[j, 2] = vi[0, 0], vi[0, 1], vi[0, 2]
        v_inverse[j, 3], v_inverse[j, 4], v_inverse[j, 5] = vi[1, 1], vi[1, 2], vi[2, 2]
        y0 = vi[0, 0] * b[0] + vi[0, 1] * b[1] + vi[0, 2] * b[2]
        y1 = vi[0, 1] * b[0] + vi[1, 1] * b[1] + vi[1, 2] * b[2]
        y2 = vi[0, 2] * b[0] + vi[1, 2] * b[1] + vi[2, 2] * b[2]
        v_right[j, 0], v_right[j, 1], v_right[j, 2] = b[0], b[1], b[2]
        promised += b[0] * y0 + b[1] * y1 + b[2] * y2
        # Elimination.
        for a in range(used):
            at = rows_of[a]
            for d in range(6):
                w0, w1, w2 = w_all[a, 0, d], w_all[a, 1, d], w_all[a, 2, d]
                wv_all[a, 0, d] = w0 * vi[0, 0] + w1 * vi[0, 1] + w2 * vi[0, 2]
                wv_all[a, 1, d] = w0 * vi[0, 1] + w1 * vi[1, 1] + w2 * vi[1, 2]
                wv_all[a, 2, d] = w0 * vi[0, 2] + w1 * vi[1, 2] + w2 * vi[2, 2]
                right[at + d] -= w0 * y0 + w1 * y1 + w2 * y2
            # In registers: what the compiler knows not to be changed by the stores below.
            v00 = wv_all[a, 0, 0]
            v01 = wv_all[a, 0, 1]
            v02 = wv_all[a, 0, 2]
            v03 = wv_all[a, 0, 3]
            v04 = wv_all[a, 0, 4]
            v05 = wv_all[a, 0, 5]
            v10 = wv_all[a, 1, 0]
            v11 = wv_all[a, 1, 1]
            v12 = wv_all[a, 1, 2]
            v13 = wv_all[a, 1, 3]
            v14 = wv_all[a, 1, 4]
            v15 = wv_all[a, 1, 5]
            v20 = wv_all[a, 2, 0]
            v21 = wv_all[a, 2, 1]
            v22 = wv_all[a, 2, 2]
            v23 = wv_all[a, 2, 3]
            v24 = wv_all[a, 2, 4]
            v25 = wv_all[a, 2, 5]
            for other in range(a):
                before = rows_of[other]
                for e in range(6):
                    w0, w1, w2 = w_all[other, 0, e], w_all[other, 1, e], w_all[other, 2, e]
                    row = before + e
                    at_row = at - skew * row
                    band[row, at_row] -= v00 * w0 + v10 * w1 + v20 * w2
                    band[row, at_row + 1] -= v01 * w0 + v11 * w1 + v21 * w2
                    band[row, at_row + 2] -= v02 * w0 + v12 * w1 + v22 * w2
                    band[row, at_row + 3] -= v03 * w0 + v13 * w1 + v23 * w2
                    band[row, at_row + 4] -= v04 * w0 + v14 * w1 + v24 * w2
                    band[row, at_row + 5] -= v05 * w0 + v15 * w1 + v25 * w2
            for e in range(6):
                w0, w1, w2 = w_all[a, 0, e], w_all[a, 1, e], w_all[a, 2, e]
                target = band[at + e]
                shift = at - skew * (at + e)
                for d in range(e, 6):
                    target[shift + d] -= wv_all[a, 0, d] * w0 + wv_all[a, 1, d] * w1 + wv_all[a, 2, d] * w2
        for t in range(cameras):
            c = touched[t]
            for f in range(first[c], first[c] + free[c]):
                w0, w1, w2 = w_border[f, 0], w_border[f, 1], w_border[f, 2]
                right_border[f] -= w0 * y0 + w1 * y1 + w2 * y2
                for a in range(used):
                    at = rows_of[a]
                    for d in range(6):
                        border[f, at + d] -= (
                            wv_all[a, 0, d] * w0 + wv_all[a, 1, d] * w1 + wv_all[a, 2, d] * w2
                        )
                wv_border[f, 0] = w0 * vi[0, 0] + w1 * vi[0, 1] + w2 * vi[0, 2]
                wv_border[f, 1] = w0 * vi[0, 1] + w1 * vi[1, 1] + w2 * vi[1, 2]
                wv_border[f, 2] = w0 * vi[0, 2] + w1 * vi[1, 2] + w2 * vi[2, 2]
        for t in range(cameras):
            c = touched[t]
            for f in range(first[c], first[c] + free[c]):
                for t2 in range(cameras):
                    c2 = touched[t2]
                    for g2 in range(first[c2], first[c2] + free[c2]):
                        corner[f, g2] -= (
                            wv_border[f, 0] * w_border[g2, 0]
                            + wv_border[f, 1] * w_border[g2, 1]
                            + wv_border[f, 2] * w_border[g2, 2]
                        )
        for t in range(cameras):
            c = touched[t]
            is_touched[c] = False
            w_border[first[c] : first[c] + free[c]] = 0.0
    return cost, promised, failed, undetermined


@kernel
def correct_points(
    start: Indices,
    photo: Indices,
    xy: Array,
    weight: Array,
    points: Array,
    centres: Array,
    rotations: Array,
    free_photo: Array,
    camera: Indices,
    model: Indices,
    packed: Array,
    active: Indices,
    jacobian: Array,
    first: Indices,
    free: Indices,
    control: Indices,
    control_free: Array,
    width: float,
    v_inverse: Array,
    v_right: Array,
    step: Array,
    step_border: Array,
    out: Array,
) -> None:
    """Corrections of the points ``V⁻¹ (b - Wᵀ step)`` into `out` (p, 3).

    `step` (n, 6) in the order of the photographs, `step_border` (q,). The derivatives are computed once more:
    that takes less than to write them to memory and to read them back.
    """
    columns = 0
    for c in range(free.shape[0]):
        columns = max(columns, free[c])
    j_photo, j_point, j_camera = np.empty((2, 6)), np.empty((2, 3)), np.empty((2, columns))
    scratch = np.zeros((2, packed.shape[1]))
    for j in range(start.shape[0] - 1):
        b0, b1, b2 = v_right[j, 0], v_right[j, 1], v_right[j, 2]
        k_control = control[j]
        for i in range(start[j], start[j + 1]):
            wx, wy = weight[i, 0], weight[i, 1]
            if wx == 0.0 and wy == 0.0:
                continue
            k = photo[i]
            c = camera[k]
            column, line, ok = observe(
                model[c], packed[c], centres[k], rotations[k], points[j], free[c], active, jacobian[c],
                j_photo, j_point, j_camera, scratch,
            )  # fmt: skip
            if not ok:
                continue
            rx, ry = xy[i, 0] - column, xy[i, 1] - line
            factor, _ = loss_factor(wx * rx * rx + wy * ry * ry, width)
            ex = ey = 0.0
            for a in range(6):
                moved = step[k, a] * free_photo[k, a]
                ex += j_photo[0, a] * moved
                ey += j_photo[1, a] * moved
            for a in range(free[c]):
                ex += j_camera[0, a] * step_border[first[c] + a]
                ey += j_camera[1, a] * step_border[first[c] + a]
            ex, ey = ex * wx * factor, ey * wy * factor
            if k_control >= 0:
                for a in range(3):
                    j_point[0, a] *= control_free[k_control, a]
                    j_point[1, a] *= control_free[k_control, a]
            b0 -= j_point[0, 0] * ex + j_point[1, 0] * ey
            b1 -= j_point[0, 1] * ex + j_point[1, 1] * ey
            b2 -= j_point[0, 2] * ex + j_point[1, 2] * ey
        w = v_inverse[j]
        out[j, 0] = w[0] * b0 + w[1] * b1 + w[2] * b2
        out[j, 1] = w[1] * b0 + w[3] * b1 + w[4] * b2
        out[j, 2] = w[2] * b0 + w[4] * b1 + w[5] * b2
