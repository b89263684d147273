"""Products of 3x3 blocks, and the motion that a photograph gives to a point as its camera sees it.

An observation of a point at d = X - X0 moves with ``dX + m``, ``m = -dX0 + d x θ = T (dX0, θ)``, T = [-1, K],
K = [d]x. With N = Aᵀ P A the information of the observation about its point (A: pixel by point, P: weights),
everything it adds to the normal equations is N seen through T: Tᵀ N T, Tᵀ N, N.
Symmetric matrices are six numbers: xx xy xz yy yz zz.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import inline_kernel

Array = NDArray[np.float64]
Nine = tuple[float, float, float, float, float, float, float, float, float]
Six = tuple[float, float, float, float, float, float]
Three = tuple[float, float, float]


@inline_kernel
def invert_symmetric(a: float, b: float, c: float, d: float, e: float, f: float, out: Array) -> bool:
    """Inverse of a symmetric positive definite 3x3 matrix into `out` (6); False (and zeros) if singular."""
    # Scaled to a unit diagonal, so that the threshold does not depend on units.
    out[:] = 0.0
    if not (a > 0.0 and d > 0.0 and f > 0.0):
        return False
    sa, sd, sf = 1.0 / math.sqrt(a), 1.0 / math.sqrt(d), 1.0 / math.sqrt(f)
    b, c, e = b * sa * sd, c * sa * sf, e * sd * sf
    m00, m01, m02 = 1.0 - e * e, c * e - b, b * e - c
    determinant = m00 + b * m01 + c * m02
    if not determinant > 1e-14:
        return False
    w = 1.0 / determinant
    out[0], out[3], out[5] = m00 * w * sa * sa, (1.0 - c * c) * w * sd * sd, (1.0 - b * b) * w * sf * sf
    out[1], out[2], out[4] = m01 * w * sa * sd, m02 * w * sa * sf, (b * c - e) * w * sd * sf
    return True


@inline_kernel
def times_symmetric(n: Array, m: Array) -> Nine:
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
def symmetric_vector(n: Array, x: float, y: float, z: float) -> Three:
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
def general_symmetric(u: Nine, n: Array) -> Nine:
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
def seen_at(point: Array, centre: Array) -> Three:
    """d = X - X0."""
    return point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]
