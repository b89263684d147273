"""What photographs have to do with a point that they see: covariances of their motions.

The motion that a photograph gives to a point at d is m = -dX0 + d x θ: see `small`, and `covariance` for U.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.block.kernels.blocks import own_block
from stereomate.block.kernels.small import Three, three_of
from stereomate.jit import fused_inline_kernel as inline_kernel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@inline_kernel
def moved(
    block: Array, d: Three, e: Three, by_first: Array, by_second: Array, ray: int, motions: Array
) -> None:
    """Covariances of motions: of two photographs with the 6x6 covariance `block`, that see a point at d, e.

    `by_first` (1, 6, 3): unknowns of the first with the motion by the second; `by_second` (1, 6, 3): unknowns
    of the second with the motion by the first; ``motions[ray]`` (3, 3): of the two motions.
    """
    dx, dy, dz = d
    ex, ey, ez = e
    for r in range(6):
        b3, b4, b5 = block[r, 3], block[r, 4], block[r, 5]
        by_first[0, r, 0] = ey * b5 - ez * b4 - block[r, 0]
        by_first[0, r, 1] = ez * b3 - ex * b5 - block[r, 1]
        by_first[0, r, 2] = ex * b4 - ey * b3 - block[r, 2]
    for r in range(6):
        b3, b4, b5 = block[3, r], block[4, r], block[5, r]
        by_second[0, r, 0] = dy * b5 - dz * b4 - block[0, r]
        by_second[0, r, 1] = dz * b3 - dx * b5 - block[1, r]
        by_second[0, r, 2] = dx * b4 - dy * b3 - block[2, r]
    for x in range(3):
        b3, b4, b5 = by_first[0, 3, x], by_first[0, 4, x], by_first[0, 5, x]
        motions[ray, 0, x] = dy * b5 - dz * b4 - by_first[0, 0, x]
        motions[ray, 1, x] = dz * b3 - dx * b5 - by_first[0, 1, x]
        motions[ray, 2, x] = dx * b4 - dy * b3 - by_first[0, 2, x]


@inline_kernel
def _minus(rows: int, left: Array, m: int, u: Array, a: int, ray: int, out: Array) -> None:
    """Subtract ``left[m] u[a]ᵀ`` of (rows, 3) and (3, 3) from ``out[ray]``."""
    for r in range(rows):
        x, y, z = left[m, r, 0], left[m, r, 1], left[m, r, 2]
        out[ray, r, 0] -= x * u[a, 0, 0] + y * u[a, 0, 1] + z * u[a, 0, 2]
        out[ray, r, 1] -= x * u[a, 1, 0] + y * u[a, 1, 1] + z * u[a, 1, 2]
        out[ray, r, 2] -= x * u[a, 2, 0] + y * u[a, 2, 1] + z * u[a, 2, 2]


@inline_kernel
def _minus_turned(motions: Array, u: Array, a: int, ray: int, out: Array) -> None:
    """Subtract ``motions[0]ᵀ u[a]ᵀ`` of 3x3 matrices from ``out[ray]``."""
    for r in range(3):
        x, y, z = motions[0, 0, r], motions[0, 1, r], motions[0, 2, r]
        out[ray, r, 0] -= x * u[a, 0, 0] + y * u[a, 0, 1] + z * u[a, 0, 2]
        out[ray, r, 1] -= x * u[a, 1, 0] + y * u[a, 1, 1] + z * u[a, 1, 2]
        out[ray, r, 2] -= x * u[a, 2, 0] + y * u[a, 2, 1] + z * u[a, 2, 2]


@inline_kernel
def photos_of_point(
    rows: int,
    rays: int,
    photo: Indices,
    place: Indices,
    d: Array,
    u: Array,
    stride: np.uint64,
    flat: Array,
    block: Array,
    by_first: Array,
    by_second: Array,
    motions: Array,
    photo_point: Array,
    motion_point: Array,
    motion: Array,
) -> None:
    """Part of the photographs in what they have to do with the point.

    `photo_point` (rays, 6, 3), of it the first `rows`: unknowns of a photograph with the point;
    `motion_point` (rays, 3, 3): its motion with the point; `motion` (rays, 3, 3): its motion. Entry (i, j),
    i >= j, of the covariance lies at ``flat[j * stride + i]``; `block`, `by_first`, `by_second` and `motions`
    are scratch.
    """
    for a in range(rays):
        at = 6 * place[photo[a]]
        seen = three_of(d, a)
        own_block(flat, stride, at, block)
        moved(block, seen, seen, by_first, by_second, a, motion)
        for x in range(3):
            for r in range(rows):
                photo_point[a, r, x] = 0.0
            for r in range(3):
                motion_point[a, r, x] = 0.0
        _minus(rows, by_first, 0, u, a, a, photo_point)
        _minus(3, motion, a, u, a, a, motion_point)
        for b in range(a):
            before = 6 * place[photo[b]]
            o = np.uint64(before) * stride + np.uint64(at)
            for e in range(6):
                for r in range(6):
                    block[r, e] = flat[o + np.uint64(r)]
                o += stride
            moved(block, seen, three_of(d, b), by_first, by_second, 0, motions)
            _minus(rows, by_first, 0, u, b, a, photo_point)
            _minus(rows, by_second, 0, u, a, b, photo_point)
            _minus(3, motions, 0, u, b, a, motion_point)
            _minus_turned(motions, u, a, b, motion_point)
