"""What needs a part of the inverse: covariances of points, leverages, effects of single observations.

With U = V⁻¹ N of each observation of a point, s = V⁻¹ B of each unknown of its cameras and m = T (dX0, θ) the
motion that a photograph gives to the point (`small`): ``dX = V⁻¹ b - Σ U m - Σ s dc``, so that the covariance
of anything y with the point is ``Q_yx = -Σ Q_ym Uᵀ - Σ Q_yc sᵀ``, and ``Q_xx = V⁻¹ - Σ U Q_mx - Σ s Q_cx``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.block.kernels.blocks import own_block
from stereomate.block.kernels.motions import moved, photos_of_point
from stereomate.block.kernels.normal import loss_factor
from stereomate.block.kernels.projection import (
    by_entries,
    by_unknowns,
    lens_of,
    observe,
    observe_general,
)
from stereomate.block.kernels.small import (
    Six,
    nine_of,
    seen_at,
    set_six,
    six_of,
    symmetric_vector,
    three_of,
    times_symmetric,
)
from stereomate.camera.kernels.layout import BROWN
from stereomate.jit import fused_inline_kernel as inline_kernel
from stereomate.jit import fused_kernel as kernel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@inline_kernel
def _shared_of_point(
    rows: int,
    rays: int,
    photo: Indices,
    place: Indices,
    d: Array,
    u: Array,
    count: int,
    columns: Indices,
    s: Array,
    photo_shared: Array,
    shared: Array,
    photo_point: Array,
    motion_point: Array,
    motion_shared: Array,
    shared_point: Array,
) -> None:
    """Part of the cameras' unknowns (`columns`; `s` (columns, 3)) in what the photographs have to do with it.

    Written: `motion_shared` (rays, columns, 3), `shared_point` (columns, 3).
    """
    for f in range(count):
        column = columns[f]
        p0 = p1 = p2 = 0.0
        for g in range(count):
            q = shared[column, columns[g]]
            p0 -= q * s[g, 0]
            p1 -= q * s[g, 1]
            p2 -= q * s[g, 2]
        for a in range(rays):
            at = 6 * place[photo[a]]
            b3, b4, b5 = (
                photo_shared[at + 3, column],
                photo_shared[at + 4, column],
                photo_shared[at + 5, column],
            )
            m0 = d[a, 1] * b5 - d[a, 2] * b4 - photo_shared[at, column]
            m1 = d[a, 2] * b3 - d[a, 0] * b5 - photo_shared[at + 1, column]
            m2 = d[a, 0] * b4 - d[a, 1] * b3 - photo_shared[at + 2, column]
            motion_shared[a, f, 0], motion_shared[a, f, 1], motion_shared[a, f, 2] = m0, m1, m2
            p0 -= u[a, 0, 0] * m0 + u[a, 0, 1] * m1 + u[a, 0, 2] * m2
            p1 -= u[a, 1, 0] * m0 + u[a, 1, 1] * m1 + u[a, 1, 2] * m2
            p2 -= u[a, 2, 0] * m0 + u[a, 2, 1] * m1 + u[a, 2, 2] * m2
            for x in range(3):
                motion_point[a, 0, x] -= m0 * s[f, x]
                motion_point[a, 1, x] -= m1 * s[f, x]
                motion_point[a, 2, x] -= m2 * s[f, x]
                for r in range(rows):
                    photo_point[a, r, x] -= photo_shared[at + r, column] * s[f, x]
        shared_point[f, 0], shared_point[f, 1], shared_point[f, 2] = p0, p1, p2


@inline_kernel
def _point_covariance(
    rays: int,
    count: int,
    v_inverse: Six,
    u: Array,
    motion_point: Array,
    s: Array,
    shared_point: Array,
    out: Array,
) -> None:
    """``V⁻¹ - Σ U Q_mx - Σ s Q_cx`` into `out` (3, 3)."""
    w = v_inverse
    out[0, 0], out[0, 1], out[0, 2] = w[0], w[1], w[2]
    out[1, 0], out[1, 1], out[1, 2] = w[1], w[3], w[4]
    out[2, 0], out[2, 1], out[2, 2] = w[2], w[4], w[5]
    for a in range(rays):
        for x in range(3):
            u0, u1, u2 = u[a, x, 0], u[a, x, 1], u[a, x, 2]
            for y in range(3):
                out[x, y] -= (
                    u0 * motion_point[a, 0, y] + u1 * motion_point[a, 1, y] + u2 * motion_point[a, 2, y]
                )
    for f in range(count):
        for x in range(3):
            for y in range(3):
                out[x, y] -= s[f, x] * shared_point[f, y]


@inline_kernel
def _of_observation(
    i: int,
    a: int,
    by_point: Array,
    by_camera: Array,
    weights: Array,
    first: int,
    free: int,
    at: int,
    qx: Array,
    motion: Array,
    motion_point: Array,
    photo_point: Array,
    own: Array,
    motion_shared: Array,
    shared_point: Array,
    column: int,
    photo_shared: Array,
    shared: Array,
    computed: Array,
    on_point: Array,
    on_photo: Array,
) -> None:
    """Variance of both computed coordinates of observation `i`, and what an error of them does.

    It is ray `a` of its point. `own` (1, 6, 3): the photograph's unknowns with its own motion;
    `column`: where its camera's unknowns stand among those of the point.
    """
    for s in range(2):
        a0, a1, a2 = by_point[a, s, 0], by_point[a, s, 1], by_point[a, s, 2]
        total = 0.0
        for x in range(3):
            # The point, and the centre, with the computed coordinate.
            to_point = (
                (qx[x, 0] + motion_point[a, 0, x]) * a0
                + (qx[x, 1] + motion_point[a, 1, x]) * a1
                + (qx[x, 2] + motion_point[a, 2, x]) * a2
            )
            to_photo = (
                (photo_point[a, x, 0] + own[0, x, 0]) * a0
                + (photo_point[a, x, 1] + own[0, x, 1]) * a1
                + (photo_point[a, x, 2] + own[0, x, 2]) * a2
            )
            to_motion = (
                (motion_point[a, x, 0] + motion[a, x, 0]) * a0
                + (motion_point[a, x, 1] + motion[a, x, 1]) * a1
                + (motion_point[a, x, 2] + motion[a, x, 2]) * a2
            )
            for f in range(free):
                j = by_camera[a, s, f]
                to_point += shared_point[column + f, x] * j
                to_photo += photo_shared[at + x, first + f] * j
                to_motion += motion_shared[a, column + f, x] * j
            total += (to_point + to_motion) * by_point[a, s, x]
            on_point[i, s, x] = weights[a, s] * to_point
            on_photo[i, s, x] = weights[a, s] * to_photo
        for f in range(free):
            value = (
                (shared_point[column + f, 0] + motion_shared[a, column + f, 0]) * a0
                + (shared_point[column + f, 1] + motion_shared[a, column + f, 1]) * a1
                + (shared_point[column + f, 2] + motion_shared[a, column + f, 2]) * a2
            )
            for g in range(free):
                value += shared[first + f, first + g] * by_camera[a, s, g]
            total += value * by_camera[a, s, f]
        computed[i, s] = total


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
    camera: Indices,
    model: Indices,
    packed: Array,
    entries: Indices,
    derivatives: Array,
    first: Indices,
    free: Indices,
    camera_start: Indices,
    camera_of: Indices,
    width: float,
    information: Array,
    by_border: Array,
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

    `inverse` holds the covariance of photographs that share a point (stored as in `normal`, zero for what is
    held), `photo_shared` (6 n, q) and `shared` (q, q) those with the shared unknowns. Written:
    `point_covariance` (p, 6; xx xy xz yy yz zz), `computed` (m, 2): variance of the computed coordinates,
    also of observations of weight 0, `on_point` and `on_photo` (m, 2, 3): effect of one pixel of error
    of the observation on its own point and projection centre, `photo_point` (m, 6, 3) or (0, 6, 3):
    covariance of photograph and point.
    """
    longest = most = 1
    for j in range(start.shape[0] - 1):
        longest = max(longest, start[j + 1] - start[j])
        most = max(most, camera_start[j + 1] - camera_start[j])
    wide = by_border.shape[1]
    rows = 6 if photo_point.shape[0] > 0 else 3
    by_point, by_camera = np.empty((longest, 2, 3)), np.empty((longest, 2, wide))
    scratch, parameters = np.zeros((3, packed.shape[1])), packed.reshape(packed.size)
    d, u, weights = np.empty((longest, 3)), np.empty((longest, 3, 3)), np.empty((longest, 2))
    mine, row = np.empty(longest, np.int64), np.empty(longest, np.int64)
    with_point, motion_point = np.empty((longest, 6, 3)), np.empty((longest, 3, 3))
    motion, motion_shared = np.empty((longest, 3, 3)), np.empty((longest, most * wide, 3))
    columns, s, shared_point = (
        np.empty(most * wide, np.int64),
        np.empty((most * wide, 3)),
        np.empty((most * wide, 3)),
    )
    qx, block = np.empty((3, 3)), np.empty((6, 6))
    own, other, square = np.empty((1, 6, 3)), np.empty((1, 6, 3)), np.empty((1, 3, 3))
    flat, stride = inverse.reshape(inverse.size), np.uint64(inverse.shape[1] - skew)
    for j in range(start.shape[0] - 1):
        v, point = six_of(v_inverse, j), three_of(points, j)
        rays = 0
        for i in range(start[j], start[j + 1]):
            k = photo[i]
            c = camera[k]
            seen, lens = (three_of(centres, k), nine_of(rotations, k), point), lens_of(parameters, c)
            if model[c] <= BROWN:
                observed, inner = observe(model[c], lens, *seen)
                if free[c] > 0:
                    by_entries(lens, inner, scratch)
            else:
                observed = observe_general(model[c], parameters, c, *seen, scratch)
            column, line, ok, ax, ay = observed
            if not ok:
                continue
            by_unknowns(c, free[c], entries, derivatives, scratch, rays, by_camera)
            by_point[rays, 0, 0], by_point[rays, 0, 1], by_point[rays, 0, 2] = ax
            by_point[rays, 1, 0], by_point[rays, 1, 1], by_point[rays, 1, 2] = ay
            rx, ry = xy[i, 0] - column, xy[i, 1] - line
            factor, _ = loss_factor(weight[i, 0] * rx * rx + weight[i, 1] * ry * ry, width)
            weights[rays, 0], weights[rays, 1] = weight[i, 0] * factor, weight[i, 1] * factor
            mine[rays], row[rays] = k, i
            d[rays, 0], d[rays, 1], d[rays, 2] = seen_at(point, centres, k)
            w = times_symmetric(v, six_of(information, i))
            u[rays, 0, 0], u[rays, 0, 1], u[rays, 0, 2] = w[:3]
            u[rays, 1, 0], u[rays, 1, 1], u[rays, 1, 2] = w[3:6]
            u[rays, 2, 0], u[rays, 2, 1], u[rays, 2, 2] = w[6:]
            rays += 1
        count = 0
        for t in range(camera_start[j], camera_start[j + 1]):
            c = camera_of[t]
            for f in range(free[c]):
                columns[count] = first[c] + f
                s[count, 0], s[count, 1], s[count, 2] = symmetric_vector(
                    v, by_border[t, f, 0], by_border[t, f, 1], by_border[t, f, 2]
                )
                count += 1
        photos_of_point(
            rows, rays, mine, place, d, u, stride, flat, block, own, other, square, with_point,
            motion_point, motion,
        )  # fmt: skip
        _shared_of_point(
            rows, rays, mine, place, d, u, count, columns, s, photo_shared, shared, with_point,
            motion_point, motion_shared, shared_point,
        )  # fmt: skip
        _point_covariance(rays, count, v, u, motion_point, s, shared_point, qx)
        set_six(point_covariance, j, (qx[0, 0], qx[0, 1], qx[0, 2], qx[1, 1], qx[1, 2], qx[2, 2]))
        for a in range(rays):
            k, i = mine[a], row[a]
            c = camera[k]
            column = 0
            while free[c] > 0 and columns[column] != first[c]:
                column += 1
            seen_here = three_of(d, a)
            own_block(flat, stride, 6 * place[k], block)
            moved(block, seen_here, seen_here, own, other, 0, square)
            _of_observation(
                i, a, by_point, by_camera, weights, first[c], free[c], 6 * place[k], qx, motion,
                motion_point, with_point, own, motion_shared, shared_point, column, photo_shared, shared,
                computed, on_point, on_photo,
            )  # fmt: skip
            if photo_point.shape[0] > 0:
                photo_point[i] = with_point[a]
