"""Nearest descriptors, with or without a predicted place: arrays in, arrays out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import kernel

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Ints = NDArray[np.int64]


@kernel
def two_largest(similarity: Floats, best: Ints, first: Array, second: Array) -> None:
    """Per row of `similarity` (n, m): column of the largest, its value, and the next largest value."""
    for i in range(similarity.shape[0]):
        a, b, index = -2.0, -2.0, -1
        for j in range(similarity.shape[1]):
            s = similarity[i, j]
            if s > a:
                b = a
                a = s
                index = j
            elif s > b:
                b = s
        best[i], first[i], second[i] = index, a, b


@kernel
def match_near(
    left: Floats,
    right: Floats,
    predicted: Array,
    search: Array,
    right_pixels: Array,
    order: Ints,
    starts: Ints,
    columns: int,
    rows: int,
    cell: float,
    best: Ints,
    first: Array,
    second: Array,
) -> None:
    """Nearest descriptors among the right points within `search` (n,) pixels of the `predicted` place (n, 2).

    The right points are binned: those of cell k are ``order[starts[k]:starts[k + 1]]``.
    """
    dimensions = left.shape[1]
    for i in range(left.shape[0]):
        a, b, index = -2.0, -2.0, -1
        x, y, reach = predicted[i, 0], predicted[i, 1], search[i]
        if not (np.isfinite(x) and np.isfinite(y)):
            best[i], first[i], second[i] = index, a, b
            continue
        c0 = int(min(max((x - reach) / cell, 0.0), columns - 1.0))
        c1 = int(min(max((x + reach) / cell, 0.0), columns - 1.0))
        r0 = int(min(max((y - reach) / cell, 0.0), rows - 1.0))
        r1 = int(min(max((y + reach) / cell, 0.0), rows - 1.0))
        for r in range(r0, r1 + 1):
            for k in range(starts[r * columns + c0], starts[r * columns + c1 + 1]):
                j = order[k]
                dx, dy = right_pixels[j, 0] - x, right_pixels[j, 1] - y
                if dx * dx + dy * dy > reach * reach:
                    continue
                s0 = s1 = s2 = s3 = 0.0
                for d in range(0, dimensions, 4):
                    s0 += left[i, d] * right[j, d]
                    s1 += left[i, d + 1] * right[j, d + 1]
                    s2 += left[i, d + 2] * right[j, d + 2]
                    s3 += left[i, d + 3] * right[j, d + 3]
                s = s0 + s1 + s2 + s3
                if s > a:
                    b = a
                    a = s
                    index = j
                elif s > b:
                    b = s
        best[i], first[i], second[i] = index, a, b
