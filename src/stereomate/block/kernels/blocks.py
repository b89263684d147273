"""Blocks of a symmetric matrix that is stored by columns of its lower part, as in `normal`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import fused_inline_kernel as inline_kernel
from stereomate.jit import fused_kernel as kernel

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
    flat, stride = inverse.reshape(inverse.size), np.uint64(inverse.shape[1] - skew)
    for k in range(place.shape[0]):
        own_block(flat, stride, 6 * place[k], out[k])


@inline_kernel
def own_block(flat: Array, stride: np.uint64, at: int, out: Array) -> None:
    """6x6 block on the diagonal into `out`; entry (i, j), i >= j, lies at ``flat[j * stride + i]``."""
    # Unsigned indices need no look at whether they count from the end.
    o = np.uint64(at) * stride + np.uint64(at)
    for b in range(6):
        for a in range(b, 6):
            out[a, b] = out[b, a] = flat[o + np.uint64(a)]
        o += stride


@kernel
def pair_block(inverse: Array, skew: int, first: int, second: int, out: Array) -> None:
    """6x6 covariance of the photographs at two places of the matrix into `out`, first by second."""
    for a in range(6):
        for b in range(6):
            out[a, b] = lower(inverse, skew, 6 * first + a, 6 * second + b)


@kernel
def add_product(inverse: Array, skew: int, left: Array, right: Array) -> None:
    """Add ``left right`` (symmetric; (n, q) and (q, n)) to the stored part of the symmetric matrix."""
    n, width = inverse.shape
    for j in range(n):
        # Band: column j from its diagonal on; dense: all of it.
        first = j if skew == 1 else 0
        row = inverse[j, : min(width, n - first)]
        for k in range(right.shape[0]):
            factor = left[j, k]
            other = right[k, first : first + row.shape[0]]
            for i in range(row.shape[0]):
                row[i] += factor * other[i]
