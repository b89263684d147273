"""What needs a part of the inverse: covariances of points, leverages, effects of single observations.

With T = W V⁻¹ of all photographs and cameras of a point and Q their covariance (a part of the inverse of the
reduced normal matrix): Q_xx = V⁻¹ + Tᵀ Q T, Q_sx = -Q T.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.block.kernels.normal import loss_factor
from stereomate.block.kernels.projection import observe
from stereomate.jit import kernel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@kernel
def lower(inverse: Array, skew: int, i: int, j: int) -> float:
    """Entry (i, j) of the symmetric matrix that is stored by columns of its lower part."""
    if i >= j:
        value: float = inverse[j, i - skew * j]
    else:
        value = inverse[i, j - skew * i]
    return value


@kernel
def photo_blocks(inverse: Array, skew: int, place: Indices, out: Array) -> None:
    """6x6 blocks on the diagonal into `out` (n, 6, 6), photographs in their own order."""
    for k in range(place.shape[0]):
        at = 6 * place[k]
        for a in range(6):
            for b in range(a + 1):
                out[k, a, b] = out[k, b, a] = inverse[at + b, at + a - skew * (at + b)]


@kernel
def pair_block(inverse: Array, skew: int, first: int, second: int, out: Array) -> None:
    """6x6 covariance of the photographs at two places of the matrix into `out`, first by second."""
    for a in range(6):
        for b in range(6):
            out[a, b] = lower(inverse, skew, 6 * first + a, 6 * second + b)


@kernel
def observation_statistics(
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
    control_free: Array,
    width: float,
    v_inverse: Array,
    skew: int,
    inverse: Array,
    photo_shared: Array,
    shared: Array,
    point_covariance: Array,
    computed: Array,
    on_point: Array,
    on_photo: Array,
    photo_point: Array,
) -> None:
    """Statistics of every image observation, and the covariance of every point.

    `inverse` holds the covariance of photographs that share a point (stored as in `normal`),
    `photo_shared` (6 n, q) and `shared` (q, q) those with the shared unknowns. Written:
    `point_covariance` (p, 6; xx xy xz yy yz zz), `computed` (m, 2): variance of the computed coordinates,
    also of observations of weight 0, `on_point` (m, 2, 3) and `on_photo` (m, 2, 6): effect of one pixel
    of error of the observation on its own point and photograph, `photo_point` (m, 6, 3) or (0, 6, 3):
    covariance of the two.
    """
    longest = 1
    for j in range(start.shape[0] - 1):
        longest = max(longest, start[j + 1] - start[j])
    columns = 0
    for c in range(free.shape[0]):
        columns = max(columns, free[c])
    q = shared.shape[0]
    j_photo, j_point, j_camera = (
        np.empty((longest, 2, 6)),
        np.empty((longest, 2, 3)),
        np.empty((longest, 2, columns)),
    )
    weights = np.empty((longest, 2))
    t_photo, qt_photo = np.empty((longest, 6, 3)), np.empty((longest, 6, 3))
    t_shared, qt_shared = np.zeros((q, 3)), np.zeros((q, 3))
    rows_of, row = np.empty(longest, np.int64), np.empty(longest, np.int64)
    touched, is_touched = np.empty(free.shape[0], np.int64), np.zeros(free.shape[0], np.bool_)
    scratch = np.zeros((2, packed.shape[1]))
    v, qx = np.empty((3, 3)), np.empty((3, 3))
    hp, hx = np.empty(6), np.empty(3)
    for j in range(start.shape[0] - 1):
        used = cameras = 0
        w = v_inverse[j]
        v[0, 0], v[0, 1], v[0, 2], v[1, 1], v[1, 2], v[2, 2] = w[0], w[1], w[2], w[3], w[4], w[5]
        v[1, 0], v[2, 0], v[2, 1] = v[0, 1], v[0, 2], v[1, 2]
        k_control = control[j]
        for i in range(start[j], start[j + 1]):
            k = photo[i]
            c = camera[k]
            column, line, ok = observe(
                model[c], packed[c], centres[k], rotations[k], points[j], free[c], active, jacobian[c],
                j_photo[used], j_point[used], j_camera[used], scratch,
            )  # fmt: skip
            if not ok:
                continue
            rx, ry = xy[i, 0] - column, xy[i, 1] - line
            factor, _ = loss_factor(weight[i, 0] * rx * rx + weight[i, 1] * ry * ry, width)
            wx, wy = weight[i, 0] * factor, weight[i, 1] * factor
            weights[used, 0], weights[used, 1] = wx, wy
            for a in range(6):
                j_photo[used, 0, a] *= free_photo[k, a]
                j_photo[used, 1, a] *= free_photo[k, a]
            if k_control >= 0:
                for a in range(3):
                    j_point[used, 0, a] *= control_free[k_control, a]
                    j_point[used, 1, a] *= control_free[k_control, a]
            rows_of[used], row[used] = 6 * place[k], i
            for b in range(3):
                # (w Jx V⁻¹) of both coordinates, then T = Jᵀ of it.
                ux = wx * (
                    j_point[used, 0, 0] * v[0, b]
                    + j_point[used, 0, 1] * v[1, b]
                    + j_point[used, 0, 2] * v[2, b]
                )
                uy = wy * (
                    j_point[used, 1, 0] * v[0, b]
                    + j_point[used, 1, 1] * v[1, b]
                    + j_point[used, 1, 2] * v[2, b]
                )
                for a in range(6):
                    t_photo[used, a, b] = j_photo[used, 0, a] * ux + j_photo[used, 1, a] * uy
                for a in range(free[c]):
                    t_shared[first[c] + a, b] += j_camera[used, 0, a] * ux + j_camera[used, 1, a] * uy
            if free[c] > 0 and not is_touched[c]:
                is_touched[c] = True
                touched[cameras] = c
                cameras += 1
            used += 1
        for a in range(used):
            qt_photo[a] = 0.0
        for a in range(used):
            at = rows_of[a]
            for b in range(a + 1):
                before = rows_of[b]
                for e in range(6):
                    base = inverse[before + e]
                    shift = at - skew * (before + e)
                    for d in range(6):
                        value = (
                            base[shift + d]
                            if (a != b or d >= e)
                            else inverse[at + d, at + e - skew * (at + d)]
                        )
                        for x in range(3):
                            qt_photo[a, d, x] += value * t_photo[b, e, x]
                        if a != b:
                            for x in range(3):
                                qt_photo[b, e, x] += value * t_photo[a, d, x]
        for t in range(cameras):
            for f in range(first[touched[t]], first[touched[t]] + free[touched[t]]):
                qt_shared[f] = 0.0
        for t in range(cameras):
            for f in range(first[touched[t]], first[touched[t]] + free[touched[t]]):
                for a in range(used):
                    at = rows_of[a]
                    for d in range(6):
                        value = photo_shared[at + d, f]
                        for x in range(3):
                            qt_photo[a, d, x] += value * t_shared[f, x]
                            qt_shared[f, x] += value * t_photo[a, d, x]
                for t2 in range(cameras):
                    for g in range(first[touched[t2]], first[touched[t2]] + free[touched[t2]]):
                        for x in range(3):
                            qt_shared[f, x] += shared[f, g] * t_shared[g, x]
        qx[:] = v
        for a in range(used):
            for d in range(6):
                for x in range(3):
                    for y in range(3):
                        qx[x, y] += t_photo[a, d, x] * qt_photo[a, d, y]
        for t in range(cameras):
            for f in range(first[touched[t]], first[touched[t]] + free[touched[t]]):
                for x in range(3):
                    for y in range(3):
                        qx[x, y] += t_shared[f, x] * qt_shared[f, y]
        if k_control >= 0:
            for a in range(3):
                if control_free[k_control, a] == 0.0:
                    qx[a, :] = 0.0
                    qx[:, a] = 0.0
        out = point_covariance[j]
        out[0], out[1], out[2], out[3], out[4], out[5] = (
            qx[0, 0],
            qx[0, 1],
            qx[0, 2],
            qx[1, 1],
            qx[1, 2],
            qx[2, 2],
        )
        for a in range(used):
            at = rows_of[a]
            c = camera[photo[row[a]]]
            f0, f1 = first[c], free[c]
            i = row[a]
            for s in range(2):
                # h = Q Jᵀ of this coordinate, over its photograph, point and camera.
                for d in range(6):
                    value = 0.0
                    for e in range(6):
                        value += lower(inverse, skew, at + d, at + e) * j_photo[a, s, e]
                    for x in range(3):
                        value -= qt_photo[a, d, x] * j_point[a, s, x]
                    for f in range(f1):
                        value += photo_shared[at + d, f0 + f] * j_camera[a, s, f]
                    hp[d] = value
                for x in range(3):
                    value = 0.0
                    for e in range(6):
                        value -= qt_photo[a, e, x] * j_photo[a, s, e]
                    for y in range(3):
                        value += qx[x, y] * j_point[a, s, y]
                    for f in range(f1):
                        value -= qt_shared[f0 + f, x] * j_camera[a, s, f]
                    hx[x] = value
                total = 0.0
                for f in range(f1):
                    value = 0.0
                    for e in range(6):
                        value += photo_shared[at + e, f0 + f] * j_photo[a, s, e]
                    for x in range(3):
                        value -= qt_shared[f0 + f, x] * j_point[a, s, x]
                    for g in range(f1):
                        value += shared[f0 + f, f0 + g] * j_camera[a, s, g]
                    total += value * j_camera[a, s, f]
                for e in range(6):
                    total += hp[e] * j_photo[a, s, e]
                    on_photo[i, s, e] = weights[a, s] * hp[e]
                for x in range(3):
                    total += hx[x] * j_point[a, s, x]
                    on_point[i, s, x] = weights[a, s] * hx[x]
                computed[i, s] = total
            if photo_point.shape[0] > 0:
                for d in range(6):
                    for x in range(3):
                        photo_point[i, d, x] = -qt_photo[a, d, x]
        for t in range(cameras):
            c = touched[t]
            is_touched[c] = False
            t_shared[first[c] : first[c] + free[c]] = 0.0


@kernel
def photos_from_points(
    start: Indices,
    photo: Indices,
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
    control_free: Array,
    values: Array,
    out: Array,
    out_shared: Array,
) -> None:
    """Subtract ``W values`` (p, 3): from `out` (6 n,) in the order of the matrix and `out_shared` (q,)."""
    columns = 0
    for c in range(free.shape[0]):
        columns = max(columns, free[c])
    j_photo, j_point, j_camera = np.empty((2, 6)), np.empty((2, 3)), np.empty((2, columns))
    scratch = np.zeros((2, packed.shape[1]))
    for j in range(start.shape[0] - 1):
        k_control = control[j]
        for i in range(start[j], start[j + 1]):
            if weight[i, 0] == 0.0 and weight[i, 1] == 0.0:
                continue
            k = photo[i]
            c = camera[k]
            _, _, ok = observe(
                model[c], packed[c], centres[k], rotations[k], points[j], free[c], active, jacobian[c],
                j_photo, j_point, j_camera, scratch,
            )  # fmt: skip
            if not ok:
                continue
            ex = ey = 0.0
            for a in range(3):
                value = values[j, a] * (control_free[k_control, a] if k_control >= 0 else 1.0)
                ex += j_point[0, a] * value
                ey += j_point[1, a] * value
            ex, ey = ex * weight[i, 0], ey * weight[i, 1]
            at = 6 * place[k]
            for a in range(6):
                out[at + a] -= (j_photo[0, a] * ex + j_photo[1, a] * ey) * free_photo[k, a]
            for a in range(free[c]):
                out_shared[first[c] + a] -= j_camera[0, a] * ex + j_camera[1, a] * ey
