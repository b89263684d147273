"""Triangular solutions with the factor of the photographs' matrix, by LAPACK, in place."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dtbtrs, dtrtrs

Array = NDArray[np.float64]


def forward(factor: Array, skew: int, rows: Array) -> None:
    """``L⁻¹ x`` of every row x of `rows` (s, n), in place; the factor is stored like the matrix."""
    _solve(factor, skew, rows, 0)


def backward(factor: Array, skew: int, rows: Array) -> None:
    """``L⁻ᵀ x`` of every row x of `rows` (s, n), in place."""
    _solve(factor, skew, rows, 1)


def _solve(factor: Array, skew: int, rows: Array, transposed: int) -> None:
    if not len(rows):
        return
    if skew:
        dtbtrs(factor.T, rows.T, uplo="L", trans="T" if transposed else "N", overwrite_b=1)
    else:
        dtrtrs(factor.T, rows.T, lower=1, trans=transposed, overwrite_b=1)
