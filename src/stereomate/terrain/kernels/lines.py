"""Bilinear and bicubic interpolation of a height patch along lines: the values of ``sampling``, faster.

Within one cell the heights along a straight line are a polynomial.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import inline_kernel, kernel
from stereomate.terrain.kernels.sampling import CUBIC, bilinear, cubic, cubic_weights

Floats = NDArray[np.float64]

# A run that leaves its row by less than this part of a cell is taken as parallel to the rows.
_LEVEL_LINE = 1e-10
# Samples in a cell from which on its polynomial along the line pays.
_LONG_RUN = 16


@inline_kernel
def _steps_inside(f: float, step: float) -> int:
    """How many further steps a position f in [0, 1] takes before it leaves the cell."""
    if step > 0.0:
        return int(min((1.0 - f) / step, 1e9))
    if step < 0.0:
        return int(min(f / -step, 1e9))
    return 1_000_000_000


@kernel
def bilinear_line(patch: Floats, col: float, row: float, dcol: float, drow: float, out: Floats) -> None:
    """Bilinear heights at (col + k dcol, row + k drow), k = 0, 1, ...: a product row over the height model.

    Walks from cell to cell: within one cell the loop has no branch and no gather, which is what makes it
    several times faster than point by point when the product is finer than the model.
    """
    rows, cols = patch.shape
    k = 0
    while k < out.size:
        x = col + k * dcol - 0.5
        y = row + k * drow - 0.5
        if not (x >= 0.0 and y >= 0.0 and x < cols - 1 and y < rows - 1):
            out[k] = bilinear(patch, x + 0.5, y + 0.5)
            k += 1
            continue
        j = int(x)
        i = int(y)
        end = min(out.size, k + 1 + min(_steps_inside(x - j, dcol), _steps_inside(y - i, drow)))
        corner = patch[i, j]
        along = patch[i, j + 1] - corner
        across = patch[i + 1, j] - corner
        twist = (patch[i + 1, j + 1] - patch[i + 1, j]) - along
        if not math.isfinite(twist + across):
            for m in range(k, end):
                out[m] = bilinear(patch, col + m * dcol, row + m * drow)
        else:
            # along a line both positions in the cell are linear in the step t: a parabola remains
            fx = x - j
            fy = y - i
            c0 = corner + fx * along + fy * (across + fx * twist)
            c1 = dcol * (along + fy * twist) + drow * (across + fx * twist)
            c2 = dcol * drow * twist
            for m in range(k, end):
                t = float(m - k)
                out[m] = (c2 * t + c1) * t + c0
        k = end


@inline_kernel
def _cubic_coefficients(p0: float, p1: float, p2: float, p3: float) -> tuple[float, float, float, float]:
    """Polynomial coefficients of the Catmull-Rom segment between the nodes p1 and p2."""
    return (
        p1,
        0.5 * (p2 - p0),
        p0 - 2.5 * p1 + 2.0 * p2 - 0.5 * p3,
        1.5 * (p1 - p2) + 0.5 * (p3 - p0),
    )


@inline_kernel
def _shifted(
    p0: float, p1: float, p2: float, p3: float, at: float, step: float
) -> tuple[float, float, float, float]:
    """Coefficients in t of the cubic p at the position ``at + step t``."""
    return (
        ((p3 * at + p2) * at + p1) * at + p0,
        ((3.0 * p3 * at + 2.0 * p2) * at + p1) * step,
        (3.0 * p3 * at + p2) * step * step,
        p3 * step * step * step,
    )


@inline_kernel
def _cubic_run(
    patch: Floats,
    i: int,
    j: int,
    col: float,
    row: float,
    dcol: float,
    drow: float,
    start: int,
    end: int,
    out: Floats,
) -> None:
    """The samples start..end of a line that lie in one cell, in a general direction."""
    a0, a1, a2, a3 = _cubic_coefficients(
        patch[i - 1, j - 1], patch[i - 1, j], patch[i - 1, j + 1], patch[i - 1, j + 2]
    )
    b0, b1, b2, b3 = _cubic_coefficients(patch[i, j - 1], patch[i, j], patch[i, j + 1], patch[i, j + 2])
    c0, c1, c2, c3 = _cubic_coefficients(
        patch[i + 1, j - 1], patch[i + 1, j], patch[i + 1, j + 1], patch[i + 1, j + 2]
    )
    d0, d1, d2, d3 = _cubic_coefficients(
        patch[i + 2, j - 1], patch[i + 2, j], patch[i + 2, j + 1], patch[i + 2, j + 2]
    )
    if not math.isfinite(a3 + a2 + b3 + b2 + c3 + c2 + d3 + d2):
        for m in range(start, end):
            out[m] = cubic(patch, col + m * dcol, row + m * drow)
        return
    p00, p01, p02, p03 = _cubic_coefficients(a0, b0, c0, d0)
    p10, p11, p12, p13 = _cubic_coefficients(a1, b1, c1, d1)
    p20, p21, p22, p23 = _cubic_coefficients(a2, b2, c2, d2)
    p30, p31, p32, p33 = _cubic_coefficients(a3, b3, c3, d3)
    if end - start < _LONG_RUN:
        for m in range(start, end):
            fx = col + m * dcol - 0.5 - j
            fy = row + m * drow - 0.5 - i
            e0 = ((p03 * fy + p02) * fy + p01) * fy + p00
            e1 = ((p13 * fy + p12) * fy + p11) * fy + p10
            e2 = ((p23 * fy + p22) * fy + p21) * fy + p20
            e3 = ((p33 * fy + p32) * fy + p31) * fy + p30
            out[m] = ((e3 * fx + e2) * fx + e1) * fx + e0
        return
    # along a line both positions in the cell are linear in the step t: a polynomial of degree 6 remains
    a = col + start * dcol - 0.5 - j
    c = row + start * drow - 0.5 - i
    r0, r1, r2, r3 = _shifted(p30, p31, p32, p33, c, drow)
    e0, e1, e2, e3 = _shifted(p20, p21, p22, p23, c, drow)
    s0, s1, s2, s3 = a * r0 + e0, a * r1 + dcol * r0 + e1, a * r2 + dcol * r1 + e2, a * r3 + dcol * r2 + e3
    s4 = dcol * r3
    e0, e1, e2, e3 = _shifted(p10, p11, p12, p13, c, drow)
    r0, r1, r2, r3 = a * s0 + e0, a * s1 + dcol * s0 + e1, a * s2 + dcol * s1 + e2, a * s3 + dcol * s2 + e3
    r4, r5 = a * s4 + dcol * s3, dcol * s4
    e0, e1, e2, e3 = _shifted(p00, p01, p02, p03, c, drow)
    s0, s1, s2, s3 = a * r0 + e0, a * r1 + dcol * r0 + e1, a * r2 + dcol * r1 + e2, a * r3 + dcol * r2 + e3
    s4, s5, s6 = a * r4 + dcol * r3, a * r5 + dcol * r4, dcol * r5
    for m in range(start, end):
        t = float(m - start)
        out[m] = (((((s6 * t + s5) * t + s4) * t + s3) * t + s2) * t + s1) * t + s0


@kernel
def cubic_line(patch: Floats, col: float, row: float, dcol: float, drow: float, out: Floats) -> None:
    """Bicubic heights at (col + k dcol, row + k drow), k = 0, 1, ...: a product row over the height model.

    Within one cell the sixteen nodes become polynomial coefficients once; a line along the rows of the
    model (drow = 0) needs only four of them.
    """
    rows, cols = patch.shape
    k = 0
    while k < out.size:
        x = col + k * dcol - 0.5
        y = row + k * drow - 0.5
        if not (x >= 1.0 and y >= 1.0 and x < cols - 2 and y < rows - 2):
            out[k] = cubic(patch, x + 0.5, y + 0.5)
            k += 1
            continue
        j = int(x)
        i = int(y)
        end = min(out.size, k + 1 + min(_steps_inside(x - j, dcol), _steps_inside(y - i, drow)))
        if end - k < 4:
            for m in range(k, end):
                out[m] = cubic(patch, col + m * dcol, row + m * drow)
            k = end
            continue
        if abs(drow) * (end - k) < _LEVEL_LINE:
            p, q, r, s = cubic_weights(y - i)
            c0, c1, c2, c3 = _cubic_coefficients(
                p * patch[i - 1, j - 1]
                + q * patch[i, j - 1]
                + r * patch[i + 1, j - 1]
                + s * patch[i + 2, j - 1],
                p * patch[i - 1, j] + q * patch[i, j] + r * patch[i + 1, j] + s * patch[i + 2, j],
                p * patch[i - 1, j + 1]
                + q * patch[i, j + 1]
                + r * patch[i + 1, j + 1]
                + s * patch[i + 2, j + 1],
                p * patch[i - 1, j + 2]
                + q * patch[i, j + 2]
                + r * patch[i + 1, j + 2]
                + s * patch[i + 2, j + 2],
            )
            if math.isfinite(c3 + c2):
                for m in range(k, end):
                    fx = col + m * dcol - 0.5 - j
                    out[m] = ((c3 * fx + c2) * fx + c1) * fx + c0
            else:
                for m in range(k, end):
                    out[m] = cubic(patch, col + m * dcol, row)
            k = end
            continue
        _cubic_run(patch, i, j, col, row, dcol, drow, k, end, out)
        k = end


@kernel
def sample_line(
    method: int, patch: Floats, col: float, row: float, dcol: float, drow: float, out: Floats
) -> None:
    """Heights along a line by the method BILINEAR (1) or CUBIC (3)."""
    if method == CUBIC:
        cubic_line(patch, col, row, dcol, drow, out)
    else:
        bilinear_line(patch, col, row, dcol, drow, out)
