"""Selected inversion: the entries of an inverse that lie within the band of its Cholesky factor.

Takahashi's recursion by blocks of columns, from the last to the first: with K the rows below block J,
Y = L_KJ L_JJ⁻¹, Z_KJ = -Z_KK Y, Z_JJ = (L_JJ L_JJᵀ)⁻¹ + Yᵀ Z_KK Y. All entries it needs lie within the band.
"""

from __future__ import annotations

import functools
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray
from scipy.linalg.blas import dsymm, dtrsm
from scipy.linalg.lapack import dpotri, dtrtri

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_BLOCK: Final = 48


def _rows(band: Array, first: int, rows: int, columns: int) -> Array:
    """View of stored columns `first` ... as rows of the upper part: [r, c] is entry (first + c, first + r).

    Right only where ``r <= c < r + width``.
    """
    width = band.shape[1]
    item = band.itemsize
    flat = band.reshape(-1)[first * width :]
    return as_strided(flat, (rows, columns), ((width - 1) * item, item))


@functools.lru_cache(maxsize=4)
def _within(rows: int, columns: int, width: int) -> Mask:
    """What of a block lies within the band; all blocks but those at the end are of one size."""
    distance = np.arange(columns) - np.arange(rows)[:, None]
    inside = np.asarray((distance >= 0) & (distance < width))
    inside.flags.writeable = False
    return inside


def selected_inverse(factor: Array, skew: int) -> Array:
    """Inverse within the band of a factor stored as in `kernels.normal`, stored in the same way."""
    if skew == 0:
        inverse, _ = dpotri(factor.T, lower=1)
        return np.ascontiguousarray(inverse.T)
    n, width = factor.shape
    inverse = np.zeros_like(factor)
    block = min(n, max(_BLOCK, width // 4))
    first = ((n - 1) // block) * block
    space = np.empty(width * width)
    while first >= 0:
        size = min(block, n - first)
        below = min(n - first - size, width - 1)
        inside = _within(size, size + below, width)
        stored, own = _rows(factor, first, size, size + below), inside[:, :size]
        upper = np.where(own, stored[:, :size], 0.0)
        root, _ = dtrtri(upper.T, lower=1)
        corner = root.T @ root
        if below:
            # As LAPACK lays matrices out: transposed, so that nothing is copied on the way.
            y = dtrsm(
                1.0, upper.T, np.where(inside[:, size:], stored[:, size:], 0.0).T, side=1, lower=1,
                overwrite_b=1,
            )  # fmt: skip
            # Only the upper triangle is right, and only that is read.
            window = space[: below * below].reshape(below, below)
            window[:] = _rows(inverse, first + size, below, below)
            across = dsymm(-1.0, window.T, y, side=0, lower=1)
            corner -= across.T @ y
            np.copyto(_rows(inverse, first, size, size + below)[:, size:], across.T, where=inside[:, size:])
        np.copyto(_rows(inverse, first, size, size), corner, where=own)
        first -= block
    return inverse
