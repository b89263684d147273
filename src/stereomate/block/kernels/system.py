"""The system of photographs and its border: observations of single photographs, triangular solutions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import kernel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@kernel
def add_group(
    photo: Indices,
    residual: Array,
    weight: Array,
    by_photo: Array,
    columns: Indices,
    by_shared: Array,
    place: Indices,
    free_photo: Array,
    skew: int,
    band: Array,
    border: Array,
    corner: Array,
    right: Array,
    right_border: Array,
    diagonal: Array,
    diagonal_border: Array,
) -> float:
    """Add observations of single photographs (`navigation.Group`) to the normal equations; their cost."""
    cost = 0.0
    s = columns.shape[1]
    for g in range(photo.shape[0]):
        k = photo[g]
        at = place[k] * 6
        for i in range(3):
            w, r = weight[g, i], residual[g, i]
            if w == 0.0:
                continue
            cost += w * r * r
            for a in range(6):
                ja = w * by_photo[g, i, a] * free_photo[k, a]
                if ja == 0.0:
                    continue
                right[at + a] += ja * r
                diagonal[at + a] += ja * by_photo[g, i, a]
                shift = at - skew * (at + a)
                for b in range(a, 6):
                    band[at + a, shift + b] += ja * by_photo[g, i, b] * free_photo[k, b]
                for b in range(s):
                    if columns[g, b] >= 0:
                        border[columns[g, b], at + a] += ja * by_shared[g, i, b]
            for a in range(s):
                c = columns[g, a]
                if c < 0 or by_shared[g, i, a] == 0.0:
                    continue
                ja = w * by_shared[g, i, a]
                right_border[c] += ja * r
                diagonal_border[c] += ja * by_shared[g, i, a]
                for b in range(s):
                    if columns[g, b] >= 0:
                        corner[c, columns[g, b]] += ja * by_shared[g, i, b]
    return cost


@kernel
def forward(factor: Array, skew: int, values: Array) -> None:
    """``L⁻¹ values`` in place; `values` (n, s), the factor stored like the matrix."""
    n, width = factor.shape
    for j in range(n):
        column = factor[j]
        shift = j - skew * j
        inverse = 1.0 / column[shift]
        for s in range(values.shape[1]):
            values[j, s] *= inverse
        for i in range(j + 1, min(n, j + width) if skew == 1 else n):
            f = column[i - skew * j]
            for s in range(values.shape[1]):
                values[i, s] -= f * values[j, s]


@kernel
def backward(factor: Array, skew: int, values: Array) -> None:
    """``L⁻ᵀ values`` in place; `values` (n, s)."""
    n, width = factor.shape
    for j in range(n - 1, -1, -1):
        column = factor[j]
        for i in range(j + 1, min(n, j + width) if skew == 1 else n):
            f = column[i - skew * j]
            for s in range(values.shape[1]):
                values[j, s] -= f * values[i, s]
        inverse = 1.0 / column[j - skew * j]
        for s in range(values.shape[1]):
            values[j, s] *= inverse
