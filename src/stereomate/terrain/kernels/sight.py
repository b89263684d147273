"""Whether the way to a projection centre is free over the bilinear surface, and bounds that save the search.

Rays as in ``rays``: cell by cell, each solved exactly.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import inline_kernel, kernel
from stereomate.terrain.kernels.rays import cell_of, clearance, clip_to_lattice

Floats = NDArray[np.float64]


@inline_kernel
def _dips_below(a: float, b: float, c: float, length: float, tolerance: float) -> bool:
    """Whether a + b s + c s^2 falls below -tolerance anywhere in [0, length]."""
    if a < -tolerance or a + (b + c * length) * length < -tolerance:
        return True
    if c > 0.0 and b < 0.0:
        s = -0.5 * b / c
        return s < length and a + 0.5 * b * s < -tolerance
    return False


@inline_kernel
def occluded(
    patch: Floats,
    col: float,
    row: float,
    h: float,
    dcol: float,
    drow: float,
    dh: float,
    h_max: float,
    tolerance: float,
) -> bool:
    """Whether the way from a surface point to a projection centre is blocked by the bilinear surface.

    Parameters
    ----------
    patch : (rows, cols) float64
        NaN = void: voids and the outside of the patch do not block.
    col, row, h : float
        The point on the surface.
    dcol, drow, dh : float
        Towards the projection centre, per unit of t; t = 1 is the end of the search, so the direction may be
        the whole way to the centre, or any part of it that ends above ``h_max``.
    h_max : float
        No surface is higher than this: the search ends there.
    tolerance : float
        How deep, in metres of height, the way must run below the surface to count as blocked. It must cover
        the distance of the start from the bilinear surface (bicubic heights, rounding).
    """
    rows, cols = patch.shape
    x0 = col - 0.5
    y0 = row - 0.5
    t_max = 1.0
    if dh > 0.0:
        t_max = min(t_max, (h_max - h) / dh)
    t, t_end = clip_to_lattice(x0, y0, dcol, drow, cols, rows, t_max)
    if rows < 2 or cols < 2 or not t < t_end:
        return False
    j = cell_of(x0 + t * dcol, dcol, cols)
    i = cell_of(y0 + t * drow, drow, rows)
    while True:
        t_x = (j + (1 if dcol > 0.0 else 0) - x0) / dcol if dcol != 0.0 else math.inf
        t_y = (i + (1 if drow > 0.0 else 0) - y0) / drow if drow != 0.0 else math.inf
        t_next = max(t, min(t_x, t_y, t_end))
        a, b, c = clearance(patch, i, j, x0 + t * dcol - j, y0 + t * drow - i, h + t * dh, dcol, drow, dh)
        if _dips_below(a, b, c, t_next - t, tolerance):
            return True
        if t_next >= t_end:
            return False
        t = t_next
        if t_x <= t_y:
            j += 1 if dcol > 0.0 else -1
            if j < 0 or j > cols - 2:
                return False
        if t_y <= t_x:
            i += 1 if drow > 0.0 else -1
            if i < 0 or i > rows - 2:
                return False


@kernel
def block_maxima(patch: Floats, block: int) -> Floats:
    """Highest node of every block of ``block`` x ``block`` cells.

    The nodes on the border belong to the blocks on both sides, so that no surface over a block is higher
    than its value. Blocks without heights are -inf.
    """
    rows, cols = patch.shape
    count_rows = max(1, (rows - 2) // block + 1)
    count_cols = max(1, (cols - 2) // block + 1)
    maxima = np.full((count_rows, count_cols), -math.inf)
    for m in range(count_rows):
        for n in range(count_cols):
            highest = -math.inf
            for i in range(m * block, min((m + 1) * block + 1, rows)):
                for j in range(n * block, min((n + 1) * block + 1, cols)):
                    highest = max(highest, patch[i, j]) if patch[i, j] == patch[i, j] else highest
            maxima[m, n] = highest
    return maxima


@inline_kernel
def occluded_blockwise(
    patch: Floats,
    maxima: Floats,
    block: int,
    col: float,
    row: float,
    h: float,
    dcol: float,
    drow: float,
    dh: float,
    h_max: float,
    tolerance: float,
) -> bool:
    """``occluded`` with blocks skipped over which the way runs higher than anything in them.

    ``maxima`` is ``block_maxima(patch, block)``; the answer is the same, sooner where ways are long. Only for
    ways that do not descend (dh >= 0).
    """
    rows, cols = patch.shape
    x0 = col - 0.5
    y0 = row - 0.5
    t_max = 1.0
    if dh > 0.0:
        t_max = min(t_max, (h_max - h) / dh)
    t, t_end = clip_to_lattice(x0, y0, dcol, drow, cols, rows, t_max)
    if rows < 2 or cols < 2 or not t < t_end:
        return False
    m = cell_of(y0 + t * drow, drow, rows) // block
    n = cell_of(x0 + t * dcol, dcol, cols) // block
    while True:
        t_x = (min((n + (1 if dcol > 0.0 else 0)) * block, cols - 1) - x0) / dcol if dcol != 0.0 else math.inf
        t_y = (min((m + (1 if drow > 0.0 else 0)) * block, rows - 1) - y0) / drow if drow != 0.0 else math.inf
        t_next = max(t, min(t_x, t_y, t_end))
        if h + t * dh < maxima[m, n] and occluded(
            patch,
            col + t * dcol,
            row + t * drow,
            h + t * dh,
            (t_next - t) * dcol,
            (t_next - t) * drow,
            (t_next - t) * dh,
            maxima[m, n],
            tolerance,
        ):
            return True
        if t_next >= t_end:
            return False
        t = t_next
        if t_x <= t_y:
            n += 1 if dcol > 0.0 else -1
            if n < 0 or n >= maxima.shape[1]:
                return False
        if t_y <= t_x:
            m += 1 if drow > 0.0 else -1
            if m < 0 or m >= maxima.shape[0]:
                return False


@inline_kernel
def _obliquity(patch: Floats, i: int, j: int, col: float, row: float, h: float) -> float:
    """Horizontal distance (pixels) over height difference from a centre to the steepest corner of a cell.

    Along lines parallel to the axes distance is convex and height linear, so their ratio is quasiconvex: the
    largest value over a bilinear cell is at a corner. -inf for cells with a void.
    """
    largest = -math.inf
    for m in range(i, i + 2):
        for n in range(j, j + 2):
            drop = h - patch[m, n]
            if drop != drop:
                return -math.inf
            x = n + 0.5 - col
            y = m + 0.5 - row
            largest = max(largest, math.sqrt(x * x + y * y) / drop if drop > 0.0 else math.inf)
    return largest


@kernel
def sight_bounds(patch: Floats, col: float, row: float, h: float) -> Floats:
    """Upper bounds, per cell, of what can block the sight from a projection centre, (rows - 1, cols - 1).

    The tangent of the angle between plumb line and ray (in pixels over metres) that no surface in the cell,
    or between it and the nadir, exceeds. A ray with at least this tangent is free from the cell on.

    Parameters
    ----------
    patch : (rows, cols) float64
    col, row, h : float
        The projection centre; its nadir may lie outside the patch.
    """
    rows, cols = patch.shape
    bounds = np.full((max(rows - 1, 0), max(cols - 1, 0)), -math.inf)
    if rows < 2 or cols < 2:
        return bounds
    nadir_i = int(min(max(math.floor(row - 0.5), -1.0), float(rows - 1)))
    nadir_j = int(min(max(math.floor(col - 0.5), -1.0), float(cols - 1)))
    # outwards from the nadir: upwards and downwards of it, to its left and to its right
    for step_i in (-1, 1):
        i = min(nadir_i, rows - 2) if step_i < 0 else max(nadir_i + 1, 0)
        while 0 <= i < rows - 1:
            inner_i = i if i == nadir_i else i - step_i
            for step_j in (-1, 1):
                j = min(nadir_j, cols - 2) if step_j < 0 else max(nadir_j + 1, 0)
                while 0 <= j < cols - 1:
                    bound = _obliquity(patch, i, j, col, row, h)
                    if inner_i != i and 0 <= inner_i < rows - 1:
                        bound = max(bound, bounds[inner_i, j])
                    inner_j = j if j == nadir_j else j - step_j
                    if inner_j != j and 0 <= inner_j < cols - 1:
                        bound = max(bound, bounds[i, inner_j])
                    bounds[i, j] = bound
                    j += step_j
            i += step_i
    return bounds


@inline_kernel
def occluded_bounded(
    patch: Floats,
    bounds: Floats,
    col: float,
    row: float,
    h: float,
    centre_col: float,
    centre_row: float,
    centre_h: float,
    tolerance: float,
) -> bool:
    """``occluded`` for the whole way to a projection centre, ended as soon as nothing can block any more.

    ``bounds`` is ``sight_bounds`` of the same patch and centre: the answer is the same after a few cells.
    """
    rows, cols = patch.shape
    x0 = col - 0.5
    y0 = row - 0.5
    dcol = centre_col - col
    drow = centre_row - row
    dh = centre_h - h
    t, t_end = clip_to_lattice(x0, y0, dcol, drow, cols, rows, 1.0)
    if rows < 2 or cols < 2 or not t < t_end or not dh > 0.0:
        return False
    tangent = math.sqrt(dcol * dcol + drow * drow) / dh
    j = cell_of(x0 + t * dcol, dcol, cols)
    i = cell_of(y0 + t * drow, drow, rows)
    while bounds[i, j] > tangent:
        t_x = (j + (1 if dcol > 0.0 else 0) - x0) / dcol if dcol != 0.0 else math.inf
        t_y = (i + (1 if drow > 0.0 else 0) - y0) / drow if drow != 0.0 else math.inf
        t_next = max(t, min(t_x, t_y, t_end))
        a, b, c = clearance(patch, i, j, x0 + t * dcol - j, y0 + t * drow - i, h + t * dh, dcol, drow, dh)
        if _dips_below(a, b, c, t_next - t, tolerance):
            return True
        if t_next >= t_end:
            return False
        t = t_next
        if t_x <= t_y:
            j += 1 if dcol > 0.0 else -1
            if j < 0 or j > cols - 2:
                return False
        if t_y <= t_x:
            i += 1 if drow > 0.0 else -1
            if i < 0 or i > rows - 2:
                return False
    return False


@kernel
def steepest_slope(patch: Floats, cell_width: float, cell_height: float) -> float:
    """Steepest slope (rise over run) of the bilinear surface of a patch; 0 where there is no surface.

    A ray that rises more steeply than this everywhere cannot be occluded: one test instead of one per pixel.
    The gradient of a bilinear cell is largest at a corner. Cells with a void are not part of the surface.
    """
    rows, cols = patch.shape
    steepest = 0.0
    for i in range(rows - 1):
        for j in range(cols - 1):
            top = patch[i, j + 1] - patch[i, j]
            bottom = patch[i + 1, j + 1] - patch[i + 1, j]
            left = patch[i + 1, j] - patch[i, j]
            right = patch[i + 1, j + 1] - patch[i, j + 1]
            x = max(abs(top), abs(bottom)) / cell_width
            y = max(abs(left), abs(right)) / cell_height
            square = x * x + y * y
            if square > steepest and math.isfinite(square):
                steepest = square
    return math.sqrt(steepest)
