"""A point taken out of the normal equations: of its photographs, of its cameras, and of what both share."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.block.kernels.small import (
    Nine,
    Six,
    Three,
    columns_cross,
    general_symmetric,
    rows_cross,
    seen_at,
    six_of,
    symmetric_vector,
    times_symmetric,
)
from stereomate.jit import fused_inline_kernel as inline_kernel

# Unsigned indices need no look at whether they count from the end.
U1, U2, U3, U4, U5 = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4), np.uint64(5)
Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@inline_kernel
def eliminate_cameras(
    w: Six,
    y: Three,
    low: int,
    high: int,
    cameras: Indices,
    first: Indices,
    free: Indices,
    by_border: Array,
    solved: Array,
    corner: Array,
    right_border: Array,
) -> None:
    """Take a point out of the unknowns of its cameras, ``cameras[low:high]``.

    `w`: V⁻¹ of the point, `y`: V⁻¹ b; written: `solved`, the cameras' unknowns with the point, times V⁻¹.
    """
    for t in range(low, high):
        c = cameras[t]
        for f in range(free[c]):
            b0, b1, b2 = by_border[t, f, 0], by_border[t, f, 1], by_border[t, f, 2]
            row = first[c] + f
            right_border[row] -= b0 * y[0] + b1 * y[1] + b2 * y[2]
            s0, s1, s2 = symmetric_vector(w, b0, b1, b2)
            solved[t - low, f, 0], solved[t - low, f, 1], solved[t - low, f, 2] = s0, s1, s2
            for t2 in range(low, t + 1):
                c2 = cameras[t2]
                for g in range(f + 1 if t2 == t else free[c2]):
                    corner[row, first[c2] + g] -= (
                        s0 * by_border[t2, g, 0] + s1 * by_border[t2, g, 1] + s2 * by_border[t2, g, 2]
                    )


@inline_kernel
def eliminate_photos(
    low: int,
    high: int,
    photo: Indices,
    point: Three,
    centres: Array,
    place: Indices,
    w: Six,
    y: Three,
    information: Array,
    stride: int,
    flat: Array,
    right: Array,
    diagonal: Array,
) -> None:
    """Add the photographs of a point with themselves and take the point out of all of them.

    Entry (i, j) of the lower part lies at ``flat[j * stride + i]``, in both forms.
    """
    for i in range(low, high):
        n = six_of(information, i)
        if n[0] + n[3] + n[5] == 0.0:
            continue
        k = photo[i]
        at = 6 * place[k]
        dx, dy, dz = seen_at(point, centres, k)
        g0, g1, g2 = symmetric_vector(n, y[0], y[1], y[2])
        right[at] += g0
        right[at + 1] += g1
        right[at + 2] += g2
        right[at + 3] -= g1 * dz - g2 * dy
        right[at + 4] -= g2 * dx - g0 * dz
        right[at + 5] -= g0 * dy - g1 * dx
        u = times_symmetric(n, w)
        # Itself: N - N V⁻¹ N.
        c = general_symmetric(u, n)
        own = (n[0] - c[0], n[1] - c[1], n[2] - c[2], n[1] - c[3], n[3] - c[4], n[4] - c[5],
               n[2] - c[6], n[4] - c[7], n[5] - c[8])  # fmt: skip
        e = rows_cross(own, dx, dy, dz)
        h = columns_cross(e, dx, dy, dz)
        _add_own(own, e, h, at * stride + at, stride, flat)
        diagonal[at] += n[0]
        diagonal[at + 1] += n[3]
        diagonal[at + 2] += n[5]
        diagonal[at + 3] += n[3] * dz * dz - 2.0 * n[4] * dy * dz + n[5] * dy * dy
        diagonal[at + 4] += n[5] * dx * dx - 2.0 * n[2] * dx * dz + n[0] * dz * dz
        diagonal[at + 5] += n[0] * dy * dy - 2.0 * n[1] * dx * dy + n[3] * dx * dx
        for i2 in range(low, i):
            n2 = six_of(information, i2)
            if n2[0] + n2[3] + n2[5] == 0.0:
                continue
            k2 = photo[i2]
            c = general_symmetric(u, n2)
            ex, ey, ez = seen_at(point, centres, k2)
            e = rows_cross(c, ex, ey, ez)
            _subtract(
                c,
                e,
                columns_cross(c, dx, dy, dz),
                columns_cross(e, dx, dy, dz),
                6 * place[k2] * stride + at,
                stride,
                flat,
            )


@inline_kernel
def _add_own(c: Nine, e: Nine, h: Nine, first: int, stride: int, flat: Array) -> None:
    """Tᵀ C T of one photograph, lower part: [[C, -E], [-Eᵀ, H]], E = C K, H = Kᵀ E."""
    o, w = np.uint64(first), np.uint64(stride)
    flat[o] += c[0]
    flat[o + U1] += c[3]
    flat[o + U2] += c[6]
    flat[o + U3] -= e[0]
    flat[o + U4] -= e[1]
    flat[o + U5] -= e[2]
    o += w
    flat[o + U1] += c[4]
    flat[o + U2] += c[7]
    flat[o + U3] -= e[3]
    flat[o + U4] -= e[4]
    flat[o + U5] -= e[5]
    o += w
    flat[o + U2] += c[8]
    flat[o + U3] -= e[6]
    flat[o + U4] -= e[7]
    flat[o + U5] -= e[8]
    o += w
    flat[o + U3] += h[0]
    flat[o + U4] += h[3]
    flat[o + U5] += h[6]
    o += w
    flat[o + U4] += h[4]
    flat[o + U5] += h[7]
    o += w
    flat[o + U5] += h[8]


@inline_kernel
def _subtract(c: Nine, e: Nine, g: Nine, h: Nine, first: int, stride: int, flat: Array) -> None:
    """Tᵀ C T₂ of two photographs: [[C, -E], [-G, H]], E = C K₂, G = Kᵀ C, H = Kᵀ C K₂."""
    o, w = np.uint64(first), np.uint64(stride)
    flat[o] -= c[0]
    flat[o + U1] -= c[3]
    flat[o + U2] -= c[6]
    flat[o + U3] += g[0]
    flat[o + U4] += g[3]
    flat[o + U5] += g[6]
    o += w
    flat[o] -= c[1]
    flat[o + U1] -= c[4]
    flat[o + U2] -= c[7]
    flat[o + U3] += g[1]
    flat[o + U4] += g[4]
    flat[o + U5] += g[7]
    o += w
    flat[o] -= c[2]
    flat[o + U1] -= c[5]
    flat[o + U2] -= c[8]
    flat[o + U3] += g[2]
    flat[o + U4] += g[5]
    flat[o + U5] += g[8]
    o += w
    flat[o] += e[0]
    flat[o + U1] += e[3]
    flat[o + U2] += e[6]
    flat[o + U3] -= h[0]
    flat[o + U4] -= h[3]
    flat[o + U5] -= h[6]
    o += w
    flat[o] += e[1]
    flat[o + U1] += e[4]
    flat[o + U2] += e[7]
    flat[o + U3] -= h[1]
    flat[o + U4] -= h[4]
    flat[o + U5] -= h[7]
    o += w
    flat[o] += e[2]
    flat[o + U1] += e[5]
    flat[o + U2] += e[8]
    flat[o + U3] -= h[2]
    flat[o + U4] -= h[5]
    flat[o + U5] -= h[8]


@inline_kernel
def eliminate_border(
    low: int,
    high: int,
    photo: Indices,
    point: Three,
    centres: Array,
    place: Indices,
    camera: Indices,
    first_camera: int,
    end_camera: int,
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
        n = six_of(information, i)
        if n[0] + n[3] + n[5] == 0.0:
            continue
        k = photo[i]
        at = 6 * place[k]
        dx, dy, dz = seen_at(point, centres, k)
        for t in range(end_camera - first_camera):
            c = cameras[first_camera + t]
            own = c == camera[k]
            for f in range(free[c]):
                g0, g1, g2 = symmetric_vector(n, solved[t, f, 0], solved[t, f, 1], solved[t, f, 2])
                if own:
                    g0 -= single[i - low, f, 0]
                    g1 -= single[i - low, f, 1]
                    g2 -= single[i - low, f, 2]
                row = first[c] + f
                border[row, at] += g0
                border[row, at + 1] += g1
                border[row, at + 2] += g2
                border[row, at + 3] -= g1 * dz - g2 * dy
                border[row, at + 4] -= g2 * dx - g0 * dz
                border[row, at + 5] -= g0 * dy - g1 * dx
