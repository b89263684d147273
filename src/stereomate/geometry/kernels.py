"""Small dense systems inside kernels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import kernel

Array = NDArray[np.float64]


@kernel
def solve_symmetric(normal: Array, rhs: Array, solution: Array, inverse: Array, least: float) -> bool:
    """Solve and invert a symmetric positive system (n, n) by Cholesky; False if it is singular.

    Scaled by its diagonal first, so that "singular", a square pivot below `least`, does not depend on units.
    """
    n = normal.shape[0]
    scale = np.empty(n)
    for i in range(n):
        if not normal[i, i] > 0.0:
            return False
        scale[i] = 1.0 / np.sqrt(normal[i, i])
    lower = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            s = normal[i, j] * scale[i] * scale[j]
            for k in range(j):
                s -= lower[i, k] * lower[j, k]
            if i == j:
                if not s > least:
                    return False
                lower[i, i] = np.sqrt(s)
            else:
                lower[i, j] = s / lower[j, j]
    column = np.empty(n)
    for c in range(n + 1):
        for i in range(n):
            s = rhs[i] * scale[i] if c == n else (1.0 if i == c else 0.0)
            for k in range(i):
                s -= lower[i, k] * column[k]
            column[i] = s / lower[i, i]
        for i in range(n - 1, -1, -1):
            s = column[i]
            for k in range(i + 1, n):
                s -= lower[k, i] * column[k]
            column[i] = s / lower[i, i]
        for i in range(n):
            if c == n:
                solution[i] = column[i] * scale[i]
            else:
                inverse[i, c] = column[i] * scale[i] * scale[c]
    return True
