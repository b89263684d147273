"""Parallax laws as kernels: q(h), its inverse and its slope.

Parameters of a law: (base B, w0, reference level, n, then for a table n heights above the reference level,
n parallaxes and n slopes). Heights given to these functions are in the height system of the law's
reference level, which is subtracted here. Formulas: Jachimski 1980; Blachut & van Wijk 1970.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import inline_kernel, kernel

Floats = NDArray[np.float64]

NONE = 0
LINEAR = 1
LOGARITHMIC = 2
NATURAL = 3
TABLE = 4

_HEAD = 4
_MAX_ITERATIONS = 60


@inline_kernel
def _knot_below(values: Floats, first: int, count: int, value: float) -> int:
    """Index (0 .. count - 2) of the interval of ascending ``values[first:first+count]`` that holds value."""
    low = 0
    high = count - 1
    while high - low > 1:
        middle = (low + high) // 2
        if values[first + middle] <= value:
            low = middle
        else:
            high = middle
    return low


@inline_kernel
def _hermite(
    h0: float, h1: float, q0: float, q1: float, m0: float, m1: float, h: float
) -> tuple[float, float]:
    """Value and slope of the cubic with given values and slopes at the ends of an interval."""
    width = h1 - h0
    s = (h - h0) / width
    secant = (q1 - q0) / width
    c2 = 3.0 * secant - 2.0 * m0 - m1
    c3 = m0 + m1 - 2.0 * secant
    return q0 + width * s * (m0 + s * (c2 + s * c3)), m0 + s * (2.0 * c2 + s * 3.0 * c3)


@inline_kernel
def _table_q(parameters: Floats, h: float) -> tuple[float, float]:
    """Parallax and slope of a table law at h above the reference level; beyond the table straight on."""
    n = int(parameters[3])
    q = _HEAD + n
    m = _HEAD + 2 * n
    if h <= parameters[_HEAD]:
        return parameters[q] + parameters[m] * (h - parameters[_HEAD]), parameters[m]
    if h >= parameters[q - 1]:
        return parameters[m - 1] + parameters[m + n - 1] * (h - parameters[q - 1]), parameters[m + n - 1]
    k = _knot_below(parameters, _HEAD, n, h)
    return _hermite(
        parameters[_HEAD + k],
        parameters[_HEAD + k + 1],
        parameters[q + k],
        parameters[q + k + 1],
        parameters[m + k],
        parameters[m + k + 1],
        h,
    )


@inline_kernel
def _table_height(parameters: Floats, parallax: float) -> float:
    """Inverse of ``_table_q``: Newton's method kept inside the interval by bisection."""
    n = int(parameters[3])
    q = _HEAD + n
    m = _HEAD + 2 * n
    h: float
    if parallax <= parameters[q]:
        h = parameters[_HEAD] + (parallax - parameters[q]) / parameters[m]
        return h
    if parallax >= parameters[m - 1]:
        h = parameters[q - 1] + (parallax - parameters[m - 1]) / parameters[m + n - 1]
        return h
    k = _knot_below(parameters, q, n, parallax)
    low: float = parameters[_HEAD + k]
    high: float = parameters[_HEAD + k + 1]
    h0, h1, q0, q1 = low, high, parameters[q + k], parameters[q + k + 1]
    h = h0 + (h1 - h0) * (parallax - q0) / (q1 - q0)
    for _ in range(_MAX_ITERATIONS):
        value, steepness = _hermite(h0, h1, q0, q1, parameters[m + k], parameters[m + k + 1], h)
        if value > parallax:
            high = h
        else:
            low = h
        correction = (parallax - value) / steepness if steepness > 0.0 else math.inf
        following = h + correction
        if not low <= following <= high:
            following = 0.5 * (low + high)
        if abs(following - h) <= 1e-15 * (abs(h0) + abs(h1)):
            return following
        h = following
    return h


@inline_kernel
def q_of_height(code: int, parameters: Floats, height: float) -> float:
    """Artificial parallax q in ground metres of ground at ``height``; NaN at or above the flying height."""
    base: float = parameters[0]
    w0: float = parameters[1]
    h: float = height - parameters[2]
    if code == LINEAR:
        return base * h / w0
    if code == LOGARITHMIC:
        return -base * math.log1p(-h / w0) if h < w0 else math.nan
    if code == NATURAL:
        return base * h / (w0 - h) if h < w0 else math.nan
    if code == TABLE:
        return _table_q(parameters, h)[0]
    return 0.0 * h


@inline_kernel
def height_of_q(code: int, parameters: Floats, parallax: float) -> float:
    """Height (in the law's height system) that shows the artificial parallax; NaN where none does."""
    base: float = parameters[0]
    w0: float = parameters[1]
    reference: float = parameters[2]
    if code == LINEAR:
        h = w0 * parallax / base
    elif code == LOGARITHMIC:
        h = -w0 * math.expm1(-parallax / base)
    elif code == NATURAL:
        h = w0 * parallax / (base + parallax) if parallax > -base else math.nan
    elif code == TABLE:
        h = _table_height(parameters, parallax)
    else:
        h = math.nan
    return h + reference


@inline_kernel
def slope(code: int, parameters: Floats, height: float) -> float:
    """dq/dh at ``height``; NaN at or above the flying height."""
    base: float = parameters[0]
    w0: float = parameters[1]
    h: float = height - parameters[2]
    if code == LINEAR:
        return base / w0 + 0.0 * h
    if code == LOGARITHMIC:
        return base / (w0 - h) if h < w0 else math.nan
    if code == NATURAL:
        return base * w0 / ((w0 - h) * (w0 - h)) if h < w0 else math.nan
    if code == TABLE:
        return _table_q(parameters, h)[1]
    return 0.0 * h


@kernel
def q_of_heights(code: int, parameters: Floats, heights: Floats, out: Floats) -> None:
    """``q_of_height`` over flat arrays of one size."""
    for k in range(out.size):
        out[k] = q_of_height(code, parameters, heights[k])


@kernel
def heights_of_q(code: int, parameters: Floats, parallaxes: Floats, out: Floats) -> None:
    """``height_of_q`` over flat arrays of one size."""
    for k in range(out.size):
        out[k] = height_of_q(code, parameters, parallaxes[k])


@kernel
def slopes(code: int, parameters: Floats, heights: Floats, out: Floats) -> None:
    """``slope`` over flat arrays of one size."""
    for k in range(out.size):
        out[k] = slope(code, parameters, heights[k])
