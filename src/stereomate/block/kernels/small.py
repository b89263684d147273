"""Products of 3x3 blocks, and the motion that a photograph gives to a point as its camera sees it.

An observation of a point at d = X - X0 moves with ``dX + m``, ``m = -dX0 + d x θ = T (dX0, θ)``, T = [-1, K],
K = [d]x. With N = Aᵀ P A the information of the observation about its point (A: pixel by point, P: weights),
everything it adds to the normal equations is N seen through T: Tᵀ N T, Tᵀ N, N.
Symmetric matrices are six numbers: xx xy xz yy yz zz.

Matrices and vectors travel as numbers, not as rows of arrays: a view of a row counts references, which costs
more than the arithmetic on it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import fused_inline_kernel as inline_kernel

Array = NDArray[np.float64]
Nine = tuple[float, float, float, float, float, float, float, float, float]
Six = tuple[float, float, float, float, float, float]
Three = tuple[float, float, float]

NO_SIX = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@inline_kernel
def three_of(a: Array, i: int) -> Three:
    """Row of an array (n, 3)."""
    return a[i, 0], a[i, 1], a[i, 2]


@inline_kernel
def six_of(a: Array, i: int) -> Six:
    """Row of an array (n, 6)."""
    return a[i, 0], a[i, 1], a[i, 2], a[i, 3], a[i, 4], a[i, 5]


@inline_kernel
def set_six(a: Array, i: int, n: Six) -> None:
    """Write a row of an array (n, 6)."""
    a[i, 0], a[i, 1], a[i, 2], a[i, 3], a[i, 4], a[i, 5] = n


@inline_kernel
def nine_of(a: Array, i: int) -> Nine:
    """Matrix of an array (n, 3, 3), row by row."""
    return (
        a[i, 0, 0], a[i, 0, 1], a[i, 0, 2],
        a[i, 1, 0], a[i, 1, 1], a[i, 1, 2],
        a[i, 2, 0], a[i, 2, 1], a[i, 2, 2],
    )  # fmt: skip


@inline_kernel
def invert_symmetric(a: float, b: float, c: float, d: float, e: float, f: float) -> tuple[bool, Six]:
    """Whether a symmetric 3x3 matrix is positive definite, and its inverse (zeros if it is not)."""
    # Scaled to a unit diagonal, so that the threshold does not depend on units.
    if not (a > 0.0 and d > 0.0 and f > 0.0):
        return False, NO_SIX
    sa, sd, sf = 1.0 / math.sqrt(a), 1.0 / math.sqrt(d), 1.0 / math.sqrt(f)
    b, c, e = b * sa * sd, c * sa * sf, e * sd * sf
    m00, m01, m02 = 1.0 - e * e, c * e - b, b * e - c
    determinant = m00 + b * m01 + c * m02
    if not determinant > 1e-14:
        return False, NO_SIX
    w = 1.0 / determinant
    return True, (
        m00 * w * sa * sa, m01 * w * sa * sd, m02 * w * sa * sf,
        (1.0 - c * c) * w * sd * sd, (b * c - e) * w * sd * sf, (1.0 - b * b) * w * sf * sf,
    )  # fmt: skip


@inline_kernel
def times_symmetric(n: Six, m: Six) -> Nine:
    """``N M`` of two symmetric matrices, row by row."""
    return (
        n[0] * m[0] + n[1] * m[1] + n[2] * m[2],
        n[0] * m[1] + n[1] * m[3] + n[2] * m[4],
        n[0] * m[2] + n[1] * m[4] + n[2] * m[5],
        n[1] * m[0] + n[3] * m[1] + n[4] * m[2],
        n[1] * m[1] + n[3] * m[3] + n[4] * m[4],
        n[1] * m[2] + n[3] * m[4] + n[4] * m[5],
        n[2] * m[0] + n[4] * m[1] + n[5] * m[2],
        n[2] * m[1] + n[4] * m[3] + n[5] * m[4],
        n[2] * m[2] + n[4] * m[4] + n[5] * m[5],
    )


@inline_kernel
def symmetric_vector(n: Six, x: float, y: float, z: float) -> Three:
    """``N x`` of a symmetric matrix."""
    return (
        n[0] * x + n[1] * y + n[2] * z,
        n[1] * x + n[3] * y + n[4] * z,
        n[2] * x + n[4] * y + n[5] * z,
    )


@inline_kernel
def rows_cross(c: Nine, x: float, y: float, z: float) -> Nine:
    """``C K``: each row of C crossed with d = (x, y, z)."""
    return (
        c[1] * z - c[2] * y, c[2] * x - c[0] * z, c[0] * y - c[1] * x,
        c[4] * z - c[5] * y, c[5] * x - c[3] * z, c[3] * y - c[4] * x,
        c[7] * z - c[8] * y, c[8] * x - c[6] * z, c[6] * y - c[7] * x,
    )  # fmt: skip


@inline_kernel
def columns_cross(c: Nine, x: float, y: float, z: float) -> Nine:
    """``Kᵀ C``: each column of C crossed with d = (x, y, z)."""
    return (
        c[3] * z - c[6] * y, c[4] * z - c[7] * y, c[5] * z - c[8] * y,
        c[6] * x - c[0] * z, c[7] * x - c[1] * z, c[8] * x - c[2] * z,
        c[0] * y - c[3] * x, c[1] * y - c[4] * x, c[2] * y - c[5] * x,
    )  # fmt: skip


@inline_kernel
def general_symmetric(u: Nine, n: Six) -> Nine:
    """``U N`` of a general and a symmetric matrix."""
    return (
        u[0] * n[0] + u[1] * n[1] + u[2] * n[2],
        u[0] * n[1] + u[1] * n[3] + u[2] * n[4],
        u[0] * n[2] + u[1] * n[4] + u[2] * n[5],
        u[3] * n[0] + u[4] * n[1] + u[5] * n[2],
        u[3] * n[1] + u[4] * n[3] + u[5] * n[4],
        u[3] * n[2] + u[4] * n[4] + u[5] * n[5],
        u[6] * n[0] + u[7] * n[1] + u[8] * n[2],
        u[6] * n[1] + u[7] * n[3] + u[8] * n[4],
        u[6] * n[2] + u[7] * n[4] + u[8] * n[5],
    )


@inline_kernel
def seen_at(point: Three, centres: Array, k: int) -> Three:
    """d = X - X0."""
    return point[0] - centres[k, 0], point[1] - centres[k, 1], point[2] - centres[k, 2]
