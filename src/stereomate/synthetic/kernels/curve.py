"""A straight ray of the tangent frame, as the slightly curved line it is in map coordinates and heights.

Over a block the map position of a tangent-frame point is a polynomial of degree 3 or 4 in its coordinates to
better than a micrometre (the world states the figure). Along a ray it is therefore such a polynomial in the
distance, which the kernels below build and evaluate.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import inline_kernel, kernel

Array = NDArray[np.float64]
Index64 = NDArray[np.int64]

DEGREE = 4
# Exponents (i, j, k) of x^i y^j z^k, by rising degree.
EXPONENTS: Index64 = np.array(
    [
        (i, j, total - i - j)
        for total in range(DEGREE + 1)
        for i in range(total, -1, -1)
        for j in range(total - i, -1, -1)
    ]
)
TERMS = len(EXPONENTS)


@kernel
def shift_terms(exponents: Index64, terms: Array, scale: float, x: float, y: float, z: float) -> Array:
    """Terms (T, 3) in units of ``scale``, re-expanded about (x, y, z) and in metres (Taylor shift)."""
    count = exponents.shape[0]
    out = np.zeros((count, 3))
    for b in range(count):
        for a in range(count):
            di = exponents[a, 0] - exponents[b, 0]
            dj = exponents[a, 1] - exponents[b, 1]
            dk = exponents[a, 2] - exponents[b, 2]
            if di < 0 or dj < 0 or dk < 0:
                continue
            factor = (x / scale) ** di * (y / scale) ** dj * (z / scale) ** dk
            for axis in range(3):
                n, d = exponents[a, axis], exponents[b, axis]
                for step in range(d):
                    factor *= (n - step) / (step + 1.0)
            for axis in range(3):
                out[b, axis] += terms[a, axis] * factor
        degree = exponents[b, 0] + exponents[b, 1] + exponents[b, 2]
        for axis in range(3):
            out[b, axis] /= scale**degree
    return out


@inline_kernel
def curve_of_ray(
    exponents: Index64, terms: Array, dx: float, dy: float, dz: float, powers: Array, curve: Array
) -> None:
    """Fill ``curve`` (3, 5): coefficients of (x, y, h) in the distance from the expansion point.

    ``powers`` (3, 5) is scratch space.
    """
    powers[0, 0] = powers[1, 0] = powers[2, 0] = 1.0
    for k in range(1, powers.shape[1]):
        powers[0, k] = powers[0, k - 1] * dx
        powers[1, k] = powers[1, k - 1] * dy
        powers[2, k] = powers[2, k - 1] * dz
    for axis in range(3):
        for k in range(curve.shape[1]):
            curve[axis, k] = 0.0
    for t in range(exponents.shape[0]):
        i, j, k = exponents[t, 0], exponents[t, 1], exponents[t, 2]
        factor = powers[0, i] * powers[1, j] * powers[2, k]
        degree = i + j + k
        curve[0, degree] += terms[t, 0] * factor
        curve[1, degree] += terms[t, 1] * factor
        curve[2, degree] += terms[t, 2] * factor


@inline_kernel
def point_on_curve(curve: Array, s: float) -> tuple[float, float, float]:
    """(x, y, h) at distance s."""
    x = (((curve[0, 4] * s + curve[0, 3]) * s + curve[0, 2]) * s + curve[0, 1]) * s + curve[0, 0]
    y = (((curve[1, 4] * s + curve[1, 3]) * s + curve[1, 2]) * s + curve[1, 1]) * s + curve[1, 0]
    h = (((curve[2, 4] * s + curve[2, 3]) * s + curve[2, 2]) * s + curve[2, 1]) * s + curve[2, 0]
    return x, y, h


@inline_kernel
def velocity_on_curve(curve: Array, s: float) -> tuple[float, float, float]:
    """d(x, y, h)/ds at distance s."""
    vx = ((4.0 * curve[0, 4] * s + 3.0 * curve[0, 3]) * s + 2.0 * curve[0, 2]) * s + curve[0, 1]
    vy = ((4.0 * curve[1, 4] * s + 3.0 * curve[1, 3]) * s + 2.0 * curve[1, 2]) * s + curve[1, 1]
    vh = ((4.0 * curve[2, 4] * s + 3.0 * curve[2, 3]) * s + 2.0 * curve[2, 2]) * s + curve[2, 1]
    return vx, vy, vh
