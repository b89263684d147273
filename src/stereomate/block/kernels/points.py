"""What the solution does to points, points to photographs; unknowns of photographs that are held."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.block.kernels.small import seen_at, six_of, symmetric_vector, three_of
from stereomate.jit import fused_kernel as kernel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]


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
        point = three_of(points, j)
        b0, b1, b2 = three_of(v_right, j)
        for i in range(start[j], start[j + 1]):
            k = photo[i]
            dx, dy, dz = seen_at(point, centres, k)
            tx, ty, tz = step[k, 3], step[k, 4], step[k, 5]
            e0, e1, e2 = symmetric_vector(
                six_of(information, i),
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
        out[j, 0], out[j, 1], out[j, 2] = symmetric_vector(six_of(v_inverse, j), b0, b1, b2)


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
        point = three_of(points, j)
        x, y, z = three_of(values, j)
        for i in range(start[j], start[j + 1]):
            k = photo[i]
            at = 6 * place[k]
            dx, dy, dz = seen_at(point, centres, k)
            g0, g1, g2 = symmetric_vector(six_of(information, i), x, y, z)
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


@kernel
def outside(photo: Indices, xy: Array, camera: Indices, sizes: Array, edge: float, out: Flags) -> None:
    """Observations farther outside the pixel array than a part of its larger side, into `out` (m,)."""
    for i in range(photo.shape[0]):
        c = camera[photo[i]]
        columns, rows = sizes[c, 0], sizes[c, 1]
        far = edge * max(columns, rows)
        x, y = xy[i, 0], xy[i, 1]
        out[i] = (x < -far) | (x > columns + far) | (y < -far) | (y > rows + far)
