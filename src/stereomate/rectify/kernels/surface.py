"""Heights under the rows of a product, and the inversion of x - q(h(x)) along them.

The lattice is an array of nodes (node rows, node cols, values) every `step` pixels; between nodes all values
are bilinear. Columns are product pixel coordinates relative to the first column of the window in hand.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import inline_kernel, kernel
from stereomate.parallax.kernels import q_of_height
from stereomate.terrain.kernels.lines import sample_line
from stereomate.terrain.kernels.sampling import sample

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]

# A surface sampled at pixel centres counts as straight between them below this second difference of u (px).
STRAIGHT_PX = 0.004
# Roots on the true surface are found to this accuracy in u (px).
ROOT_PX = 2e-4


@inline_kernel
def lattice_row(nodes: Floats, y: float, line: Floats) -> None:
    """Values of all node columns at the lattice row coordinate `y`, written to `line` (node cols, values)."""
    node_rows, node_cols, values = nodes.shape
    j = min(max(int(y), 0), node_rows - 2)
    f = y - j
    for i in range(node_cols):
        for k in range(values):
            line[i, k] = nodes[j, i, k] + f * (nodes[j + 1, i, k] - nodes[j, i, k])


@kernel
def sample_surface(
    method: int,
    patch: Floats,
    nodes: Floats,
    node_col: float,
    node_row: float,
    step: float,
    col0: float,
    row0: float,
    out: Floats32,
) -> None:
    """Heights at the pixel centres of a window, in the height system of the law; NaN where there are none.

    `nodes` holds (column in the patch, row in the patch, offset to add to the heights). ``col0``, ``row0``
    are the window's first pixel, ``node_col``, ``node_row`` the first node, in product pixels.
    """
    rows, cols = out.shape
    node_cols = nodes.shape[1]
    line = np.empty((node_cols, 3))
    buffer = np.empty(cols)
    for r in range(rows):
        lattice_row(nodes, (row0 + r + 0.5 - node_row) / step, line)
        c = 0
        while c < cols:
            x = (col0 + c + 0.5 - node_col) / step
            i = min(max(int(x), 0), node_cols - 2)
            f = x - i
            end = cols
            if i < node_cols - 2:
                end = min(cols, c + max(1, math.ceil((1.0 - f) * step)))
            dcol = line[i + 1, 0] - line[i, 0]
            drow = line[i + 1, 1] - line[i, 1]
            doff = line[i + 1, 2] - line[i, 2]
            segment = buffer[c:end]
            sample_line(
                method,
                patch,
                line[i, 0] + f * dcol,
                line[i, 1] + f * drow,
                dcol / step,
                drow / step,
                segment,
            )
            offset = line[i, 2] + f * doff
            slope = doff / step
            for k in range(end - c):
                out[r, c + k] = segment[k] + (offset + k * slope)
            c = end


@inline_kernel
def height_at(method: int, patch: Floats, line: Floats, node_col: float, step: float, col: float) -> float:
    """Height of the surface at a fractional product column of a row whose lattice values are `line`."""
    x = (col - node_col) / step
    i = min(max(int(x), 0), line.shape[0] - 2)
    f = x - i
    dem_col = line[i, 0] + f * (line[i + 1, 0] - line[i, 0])
    dem_row = line[i, 1] + f * (line[i + 1, 1] - line[i, 1])
    offset = line[i, 2] + f * (line[i + 1, 2] - line[i, 2])
    height: float = sample(method, patch, dem_col, dem_row) + offset
    return height


@kernel
def tabulate_law(code: int, parameters: Floats, low: float, high: float, gsd: float, table: Floats) -> None:
    """Parallax in pixels at equidistant heights from `low` to `high`.

    Linear interpolation in it errs by q'' dh² / 8: with 4096 intervals over 3000 m of relief and a
    base/height of 0.6 at 3000 m that is 1e-5 m.
    """
    for k in range(table.size):
        h = low + (high - low) * k / (table.size - 1)
        table[k] = q_of_height(code, parameters, h) / gsd


@inline_kernel
def _tabulated(table: Floats, low: float, scale: float, h: float) -> float:
    t = (h - low) * scale
    k = min(max(int(t), 0), table.size - 2)
    value: float = table[k] + (t - k) * (table[k + 1] - table[k])
    return value


@inline_kernel
def _refine(
    method: int,
    patch: Floats,
    line: Floats,
    node_col: float,
    step: float,
    table: Floats,
    low: float,
    scale: float,
    left: float,
    f_left: float,
    f_right: float,
    target: float,
) -> tuple[float, float]:
    """Root of col - q(h(col)) = target in [left, left + 1] on the true surface: regula falsi (Illinois).

    ``f_left``, ``f_right`` are the known values of opposite sign at the ends. Returns (column, height); the
    height is NaN where the surface has a void inside.
    """
    a, fa, b, fb = left, f_left, left + 1.0, f_right
    col, h = left, math.nan
    for _ in range(40):
        col = a - fa * (b - a) / (fb - fa)
        h = height_at(method, patch, line, node_col, step, col)
        f = col - _tabulated(table, low, scale, h) - target
        if not abs(f) > ROOT_PX:
            break
        if f * fb < 0.0:
            a, fa = b, fb
        else:
            fa *= 0.5
        b, fb = col, f
    return col, h


@kernel
def invert_rows(
    method: int,
    patch: Floats,
    nodes: Floats,
    node_col: float,
    node_row: float,
    step: float,
    table: Floats,
    low: float,
    high: float,
    surface: Floats32,
    surface_col: float,
    col0: float,
    row0: float,
    out_columns: Floats32,
    out_heights: Floats32,
) -> int:
    """For each pixel of a stereomate window the ground column whose parallax brings it there.

    Solves ``x - q(h(x)) = u`` along every row. `surface` holds heights at pixel centres from column
    `surface_col` on, over at least all ground that can appear in the window. Where steep ground folds, the
    largest x (the highest ground) wins: segments are taken from left to right and later ones overwrite.
    ``out_columns`` are relative to `col0`, NaN (like ``out_heights``) where no ground appears.

    Returns the number of segments that fold (u decreasing with x).
    """
    rows, cols = out_columns.shape
    extent = surface.shape[1]
    u = np.empty(extent)
    line = np.empty((nodes.shape[1], 3))
    scale = (table.size - 1) / max(high - low, 1e-9)
    folds = 0
    for r in range(rows):
        for c in range(cols):
            out_columns[r, c] = np.nan
            out_heights[r, c] = np.nan
        for j in range(extent):
            h = surface[r, j]
            # Relative to col0; NaN propagates.
            u[j] = (surface_col - col0) + j + 0.5 - (_tabulated(table, low, scale, h) if h == h else math.nan)
        line_ready = False
        for j in range(extent - 1):
            a = u[j]
            b = u[j + 1]
            if not (a == a and b == b):
                continue
            folds += b < a
            first = math.ceil(min(a, b) - 0.5)
            last = math.floor(max(a, b) - 0.5)
            first = max(first, 0)
            last = min(last, cols - 1)
            if first > last:
                continue
            bend = 0.0
            if j > 0 and u[j - 1] == u[j - 1]:
                bend = abs(u[j - 1] - 2.0 * a + b)
            if j + 2 < extent and u[j + 2] == u[j + 2]:
                bend = max(bend, abs(a - 2.0 * b + u[j + 2]))
            base = (surface_col - col0) + j + 0.5
            for c in range(first, last + 1):
                t = (c + 0.5 - a) / (b - a) if b != a else 1.0
                col = base + t
                h = surface[r, j] + t * (surface[r, j + 1] - surface[r, j])
                if bend > STRAIGHT_PX:
                    if not line_ready:
                        lattice_row(nodes, (row0 + r + 0.5 - node_row) / step, line)
                        line_ready = True
                    true_col, true_h = _refine(
                        method,
                        patch,
                        line,
                        node_col - col0,
                        step,
                        table,
                        low,
                        scale,
                        base,
                        a - c - 0.5,
                        b - c - 0.5,
                        c + 0.5,
                    )
                    if true_h == true_h:
                        col, h = true_col, true_h
                out_columns[r, c] = col
                out_heights[r, c] = h
    return folds
