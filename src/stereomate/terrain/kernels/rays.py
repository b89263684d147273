"""Rays and the bilinear surface of a height patch: the first hit.

A ray is straight in (col, row, height): position (col + t dcol, row + t drow, h + t dh). The surface is
the bilinear one of ``sampling.bilinear``; within one cell its height along the ray is a quadratic in t,
which is solved exactly, so no step length has to be chosen.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import inline_kernel, kernel

Floats = NDArray[np.float64]


@inline_kernel
def clip_to_lattice(
    x: float, y: float, dx: float, dy: float, cols: int, rows: int, t_max: float
) -> tuple[float, float]:
    """The part (t_in, t_out) of the ray over the lattice of centres; empty where t_in > t_out."""
    t_in = 0.0
    t_out = t_max
    if dx > 0.0:
        t_in = max(t_in, -x / dx)
        t_out = min(t_out, (cols - 1 - x) / dx)
    elif dx < 0.0:
        t_in = max(t_in, (cols - 1 - x) / dx)
        t_out = min(t_out, -x / dx)
    elif x < 0.0 or x > cols - 1:
        return 1.0, 0.0
    if dy > 0.0:
        t_in = max(t_in, -y / dy)
        t_out = min(t_out, (rows - 1 - y) / dy)
    elif dy < 0.0:
        t_in = max(t_in, (rows - 1 - y) / dy)
        t_out = min(t_out, -y / dy)
    elif y < 0.0 or y > rows - 1:
        return 1.0, 0.0
    return t_in, t_out


@inline_kernel
def cell_of(position: float, step: float, count: int) -> int:
    """Index of the cell entered at a position on the lattice when going on in the direction of ``step``."""
    cell = math.floor(position)
    if step < 0.0 and position == cell:
        cell -= 1
    return min(max(cell, 0), count - 2)


@inline_kernel
def clearance(
    patch: Floats, i: int, j: int, x: float, y: float, h: float, dx: float, dy: float, dh: float
) -> tuple[float, float, float]:
    """Height of the ray above the surface of cell (i, j): quadratic (a, b, c) in the distance from (x, y, h).

    x, y are cell coordinates 0..1; NaN where the cell has a void corner.
    """
    corner = patch[i, j]
    along = patch[i, j + 1] - corner
    across = patch[i + 1, j] - corner
    twist = (patch[i + 1, j + 1] - patch[i + 1, j]) - along
    return (
        h - (corner + x * along + y * (across + x * twist)),
        dh - (dx * (along + y * twist) + dy * (across + x * twist)),
        -twist * dx * dy,
    )


@inline_kernel
def _first_root(a: float, b: float, c: float, length: float) -> float:
    """Smallest s in (0, length] with a + b s + c s^2 = 0 for a > 0; NaN if there is none."""
    discriminant = b * b - 4.0 * a * c
    if discriminant < 0.0:
        return math.nan
    q = -0.5 * (b + math.copysign(math.sqrt(discriminant), b))
    best = math.inf
    if q != 0.0:
        s = a / q
        if s > 0.0:
            best = s
    if c != 0.0:
        s = q / c
        if 0.0 < s < best:
            best = s
    return best if best <= length else math.nan


@inline_kernel
def first_hit(
    patch: Floats, col: float, row: float, h: float, dcol: float, drow: float, dh: float, t_max: float
) -> float:
    """The first t in [0, t_max] at which a ray from above meets the bilinear surface; NaN if it does not.

    Voids are passed through; a ray that comes out of a void, or over the edge of the patch, below the
    surface has met it where nothing is known: NaN.

    Parameters
    ----------
    patch : (rows, cols) float64
        NaN = void.
    col, row, h : float
        Start of the ray, pixel coordinates and height. A start on the surface is a hit at t = 0; one below
        it gives NaN.
    dcol, drow, dh : float
        Direction per unit of t.
    t_max : float
        End of the search; may be infinite if the ray is not vertical.
    """
    rows, cols = patch.shape
    x0 = col - 0.5
    y0 = row - 0.5
    t, t_end = clip_to_lattice(x0, y0, dcol, drow, cols, rows, t_max)
    if rows < 2 or cols < 2 or not t <= t_end:
        return math.nan
    j = cell_of(x0 + t * dcol, dcol, cols)
    i = cell_of(y0 + t * drow, drow, rows)
    above = False
    while True:
        t_x = (j + (1 if dcol > 0.0 else 0) - x0) / dcol if dcol != 0.0 else math.inf
        t_y = (i + (1 if drow > 0.0 else 0) - y0) / drow if drow != 0.0 else math.inf
        t_next = max(t, min(t_x, t_y, t_end))
        a, b, c = clearance(patch, i, j, x0 + t * dcol - j, y0 + t * drow - i, h + t * dh, dcol, drow, dh)
        if not math.isfinite(b + c):
            above = False
        elif a <= 0.0:
            return t if above or a == 0.0 else math.nan
        else:
            above = True
            s = _first_root(a, b, c, t_next - t)
            if s == s:
                return t + s
        if t_next >= t_end:
            return math.nan
        t = t_next
        if t_x <= t_y:
            j += 1 if dcol > 0.0 else -1
            if j < 0 or j > cols - 2:
                return math.nan
        if t_y <= t_x:
            i += 1 if drow > 0.0 else -1
            if i < 0 or i > rows - 2:
                return math.nan


@kernel
def first_hits(patch: Floats, starts: Floats, directions: Floats, t_max: Floats, out: Floats) -> None:
    """``first_hit`` for many rays: starts and directions (n, 3) as (col, row, h), t_max and out (n,)."""
    for k in range(out.size):
        out[k] = first_hit(
            patch,
            starts[k, 0],
            starts[k, 1],
            starts[k, 2],
            directions[k, 0],
            directions[k, 1],
            directions[k, 2],
            t_max[k],
        )
