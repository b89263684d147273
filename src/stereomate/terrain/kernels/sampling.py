"""Bilinear and bicubic interpolation of a height patch at points.

Rules, the same for all functions here and in ``lines``. Nodes are the pixel centres, (0.5, 0.5) the first.
There is no extrapolation: a position outside the lattice of centres is NaN. A void (NaN) among the nodes
that carry weight gives NaN; nodes outside the patch count as voids, so the value at a position does not
depend on how the patch was cut. The bicubic kernel (Catmull-Rom, Keys' a = -0.5) needs 4 x 4 nodes: its
domain ends one cell inside that of the bilinear one, except on the lattice lines themselves.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import inline_kernel, kernel

Floats = NDArray[np.float64]

BILINEAR = 1
CUBIC = 3


@inline_kernel
def _lerp_or_void(left: float, right: float, fraction: float) -> float:
    """Linear interpolation in which a node without weight may be void."""
    if fraction == 0.0:
        return left
    if fraction == 1.0:
        return right
    return left + fraction * (right - left)


@inline_kernel
def bilinear(patch: Floats, col: float, row: float) -> float:
    """Height at a pixel position by bilinear interpolation; NaN outside and next to voids.

    Parameters
    ----------
    patch : (rows, cols) float64
    col, row : float
        Pixel coordinates, centres at +0.5.
    """
    rows, cols = patch.shape
    x = col - 0.5
    y = row - 0.5
    if not (x >= 0.0 and y >= 0.0 and x <= cols - 1 and y <= rows - 1):
        return math.nan
    j = int(x)
    i = int(y)
    j1 = min(j + 1, cols - 1)
    i1 = min(i + 1, rows - 1)
    fx = x - j
    fy = y - i
    top = patch[i, j] + fx * (patch[i, j1] - patch[i, j])
    bottom = patch[i1, j] + fx * (patch[i1, j1] - patch[i1, j])
    value: float = top + fy * (bottom - top)
    if value == value:
        return value
    top = _lerp_or_void(patch[i, j], patch[i, j1], fx)
    bottom = _lerp_or_void(patch[i1, j], patch[i1, j1], fx)
    return _lerp_or_void(top, bottom, fy)


@inline_kernel
def bilinear_gradient(patch: Floats, col: float, row: float) -> tuple[float, float, float]:
    """Height and its derivatives (h, dh/dcol, dh/drow) of the bilinear surface; NaN next to voids.

    On a lattice line the derivative of the cell to the right and below is given (of the last cell at the
    end of the patch).
    """
    rows, cols = patch.shape
    x = col - 0.5
    y = row - 0.5
    if cols < 2 or rows < 2 or not (x >= 0.0 and y >= 0.0 and x <= cols - 1 and y <= rows - 1):
        return math.nan, math.nan, math.nan
    j = min(int(x), cols - 2)
    i = min(int(y), rows - 2)
    fx = x - j
    fy = y - i
    top_step = patch[i, j + 1] - patch[i, j]
    bottom_step = patch[i + 1, j + 1] - patch[i + 1, j]
    top = patch[i, j] + fx * top_step
    bottom = patch[i + 1, j] + fx * bottom_step
    return top + fy * (bottom - top), top_step + fy * (bottom_step - top_step), bottom - top


@inline_kernel
def cubic_weights(f: float) -> tuple[float, float, float, float]:
    """Catmull-Rom weights of the nodes at -1, 0, 1, 2 for a position f in [0, 1)."""
    return (
        ((1.0 - 0.5 * f) * f - 0.5) * f,
        (1.5 * f - 2.5) * f * f + 1.0,
        ((2.0 - 1.5 * f) * f + 0.5) * f,
        (0.5 * f - 0.5) * f * f,
    )


@inline_kernel
def _cubic_slopes(f: float) -> tuple[float, float, float, float]:
    """Derivatives of the Catmull-Rom weights."""
    return (
        (2.0 - 1.5 * f) * f - 0.5,
        (4.5 * f - 5.0) * f,
        (4.0 - 4.5 * f) * f + 0.5,
        (1.5 * f - 1.0) * f,
    )


@inline_kernel
def _cubic_or_void(patch: Floats, i: int, j: int, fx: float, fy: float) -> float:
    """Bicubic interpolation in which nodes without weight may be void or outside: the slow path."""
    rows, cols = patch.shape
    wx = cubic_weights(fx)
    wy = cubic_weights(fy)
    total = 0.0
    for k in range(4):
        if wy[k] == 0.0:
            continue
        r = i - 1 + k
        if r < 0 or r >= rows:
            return math.nan
        for m in range(4):
            if wx[m] == 0.0:
                continue
            c = j - 1 + m
            if c < 0 or c >= cols:
                return math.nan
            total += wy[k] * wx[m] * patch[r, c]
    return total


@inline_kernel
def cubic(patch: Floats, col: float, row: float) -> float:
    """Height at a pixel position by bicubic (Catmull-Rom) interpolation; NaN outside and near voids.

    Parameters
    ----------
    patch : (rows, cols) float64
    col, row : float
        Pixel coordinates, centres at +0.5.
    """
    rows, cols = patch.shape
    x = col - 0.5
    y = row - 0.5
    if not (x >= 0.0 and y >= 0.0 and x <= cols - 1 and y <= rows - 1):
        return math.nan
    j = int(x)
    i = int(y)
    fx = x - j
    fy = y - i
    if j < 1 or i < 1 or j > cols - 3 or i > rows - 3:
        return _cubic_or_void(patch, i, j, fx, fy)
    a, b, c, d = cubic_weights(fx)
    p, q, r, s = cubic_weights(fy)
    value: float = (
        p
        * (a * patch[i - 1, j - 1] + b * patch[i - 1, j] + c * patch[i - 1, j + 1] + d * patch[i - 1, j + 2])
        + q * (a * patch[i, j - 1] + b * patch[i, j] + c * patch[i, j + 1] + d * patch[i, j + 2])
        + r
        * (a * patch[i + 1, j - 1] + b * patch[i + 1, j] + c * patch[i + 1, j + 1] + d * patch[i + 1, j + 2])
        + s
        * (a * patch[i + 2, j - 1] + b * patch[i + 2, j] + c * patch[i + 2, j + 1] + d * patch[i + 2, j + 2])
    )
    if value == value:
        return value
    return _cubic_or_void(patch, i, j, fx, fy)


@inline_kernel
def cubic_gradient(patch: Floats, col: float, row: float) -> tuple[float, float, float]:
    """Height and derivatives (h, dh/dcol, dh/drow) of the bicubic surface; NaN without all 4 x 4 nodes."""
    rows, cols = patch.shape
    x = col - 0.5
    y = row - 0.5
    if not (x >= 1.0 and y >= 1.0 and x <= cols - 2 and y <= rows - 2) or cols < 4 or rows < 4:
        return math.nan, math.nan, math.nan
    j = min(int(x), cols - 3)
    i = min(int(y), rows - 3)
    wx = cubic_weights(x - j)
    sx = _cubic_slopes(x - j)
    wy = cubic_weights(y - i)
    sy = _cubic_slopes(y - i)
    h, h_col, h_row = 0.0, 0.0, 0.0
    for k in range(4):
        line, step = 0.0, 0.0
        for m in range(4):
            node = patch[i - 1 + k, j - 1 + m]
            line += wx[m] * node
            step += sx[m] * node
        h += wy[k] * line
        h_col += wy[k] * step
        h_row += sy[k] * line
    return h, h_col, h_row


@inline_kernel
def sample(method: int, patch: Floats, col: float, row: float) -> float:
    """Height at a position by the method BILINEAR (1) or CUBIC (3)."""
    if method == CUBIC:
        return cubic(patch, col, row)
    return bilinear(patch, col, row)


@kernel
def bilinear_points(patch: Floats, cols: Floats, rows: Floats, out: Floats) -> None:
    """Bilinear heights at scattered points; ``cols``, ``rows`` and ``out`` are flat and of one size."""
    for k in range(out.size):
        out[k] = bilinear(patch, cols[k], rows[k])


@kernel
def cubic_points(patch: Floats, cols: Floats, rows: Floats, out: Floats) -> None:
    """Bicubic heights at scattered points; ``cols``, ``rows`` and ``out`` are flat and of one size."""
    for k in range(out.size):
        out[k] = cubic(patch, cols[k], rows[k])
