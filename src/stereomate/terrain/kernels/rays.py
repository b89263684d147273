"""Rays and the bilinear surface of a height patch: first hit, occlusion, and bounds that save the search.

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
def _clip_to_lattice(
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
def _cell_of(position: float, step: float, count: int) -> int:
    """Index of the cell entered at a position on the lattice when going on in the direction of ``step``."""
    cell = math.floor(position)
    if step < 0.0 and position == cell:
        cell -= 1
    return min(max(cell, 0), count - 2)


@inline_kernel
def _clearance(
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
    t, t_end = _clip_to_lattice(x0, y0, dcol, drow, cols, rows, t_max)
    if rows < 2 or cols < 2 or not t <= t_end:
        return math.nan
    j = _cell_of(x0 + t * dcol, dcol, cols)
    i = _cell_of(y0 + t * drow, drow, rows)
    above = False
    while True:
        t_x = (j + (1 if dcol > 0.0 else 0) - x0) / dcol if dcol != 0.0 else math.inf
        t_y = (i + (1 if drow > 0.0 else 0) - y0) / drow if drow != 0.0 else math.inf
        t_next = max(t, min(t_x, t_y, t_end))
        a, b, c = _clearance(patch, i, j, x0 + t * dcol - j, y0 + t * drow - i, h + t * dh, dcol, drow, dh)
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
    t, t_end = _clip_to_lattice(x0, y0, dcol, drow, cols, rows, t_max)
    if rows < 2 or cols < 2 or not t < t_end:
        return False
    j = _cell_of(x0 + t * dcol, dcol, cols)
    i = _cell_of(y0 + t * drow, drow, rows)
    while True:
        t_x = (j + (1 if dcol > 0.0 else 0) - x0) / dcol if dcol != 0.0 else math.inf
        t_y = (i + (1 if drow > 0.0 else 0) - y0) / drow if drow != 0.0 else math.inf
        t_next = max(t, min(t_x, t_y, t_end))
        a, b, c = _clearance(patch, i, j, x0 + t * dcol - j, y0 + t * drow - i, h + t * dh, dcol, drow, dh)
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
    t, t_end = _clip_to_lattice(x0, y0, dcol, drow, cols, rows, t_max)
    if rows < 2 or cols < 2 or not t < t_end:
        return False
    m = _cell_of(y0 + t * drow, drow, rows) // block
    n = _cell_of(x0 + t * dcol, dcol, cols) // block
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
    t, t_end = _clip_to_lattice(x0, y0, dcol, drow, cols, rows, 1.0)
    if rows < 2 or cols < 2 or not t < t_end or not dh > 0.0:
        return False
    tangent = math.sqrt(dcol * dcol + drow * drow) / dh
    j = _cell_of(x0 + t * dcol, dcol, cols)
    i = _cell_of(y0 + t * drow, drow, rows)
    while bounds[i, j] > tangent:
        t_x = (j + (1 if dcol > 0.0 else 0) - x0) / dcol if dcol != 0.0 else math.inf
        t_y = (i + (1 if drow > 0.0 else 0) - y0) / drow if drow != 0.0 else math.inf
        t_next = max(t, min(t_x, t_y, t_end))
        a, b, c = _clearance(patch, i, j, x0 + t * dcol - j, y0 + t * drow - i, h + t * dh, dcol, drow, dh)
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
