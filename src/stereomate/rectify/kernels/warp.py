"""From ground positions of a product window to positions in a photograph.

A photograph's lattice holds, per node, the camera-frame point of the ground at height 0 and its change per
metre of height: the camera-frame point of a pixel is exactly linear in its height, bilinear in its position.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.kernels import image_from_camera_row
from stereomate.jit import inline_kernel, kernel
from stereomate.rectify.kernels.surface import lattice_row

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]

# Positions of pixels that are not in the photograph: outside any window, and finite for the resampler.
OUTSIDE = -30000.0


@inline_kernel
def camera_point(line: Floats, x: float, height: float) -> tuple[float, float, float]:
    """Camera-frame point at lattice column coordinate `x` of a row and a height."""
    i = min(max(int(x), 0), line.shape[0] - 2)
    f = x - i
    a = line[i]
    b = line[i + 1]
    px = a[0] + f * (b[0] - a[0]) + height * (a[3] + f * (b[3] - a[3]))
    py = a[1] + f * (b[1] - a[1]) + height * (a[4] + f * (b[4] - a[4]))
    pz = a[2] + f * (b[2] - a[2]) + height * (a[5] + f * (b[5] - a[5]))
    return px, py, pz


@inline_kernel
def _run_end(column: Floats32, start: int, last: int, low: float, high: float) -> int:
    """First pixel after `start` whose ground column leaves [low, high); pixels without ground stay inside."""
    end = start + 1
    while end < last and not (column[end] < low or column[end] >= high):
        end += 1
    return end


@inline_kernel
def _bilinear_run(
    terms: tuple[float, float, float, float], start: float, column: Floats32, height: Floats32, out: Floats
) -> None:
    """``base + t base_slope + h (rise + t rise_slope)`` over a run of pixels; written to be vectorised."""
    base, base_slope, rise, rise_slope = terms
    for m in range(out.shape[0]):
        t = column[m] - start
        out[m] = base + t * base_slope + height[m] * (rise + t * rise_slope)


@inline_kernel
def _camera_points(
    line: Floats, node_col: float, step: float, column: Floats32, height: Floats32, out: Floats
) -> None:
    """Camera-frame points (3, cols) of a row: within a cell linear in column, height and their product."""
    cols = column.shape[0]
    last_cell = line.shape[0] - 2
    c = 0
    while c < cols:
        if column[c] != column[c]:  # NaN: no ground
            out[:, c] = np.nan
            c += 1
            continue
        i = min(max(int((column[c] - node_col) / step), 0), last_cell)
        low = node_col + i * step if i > 0 else -math.inf
        high = node_col + (i + 1) * step if i < last_cell else math.inf
        end = _run_end(column, c, cols, low, high)
        for k in range(3):
            base, rise = line[i, k], line[i, k + 3]
            slopes = (line[i + 1, k] - base) / step, (line[i + 1, k + 3] - rise) / step
            terms = (base, slopes[0], rise, slopes[1])
            _bilinear_run(terms, node_col + i * step, column[c:end], height[c:end], out[k, c:end])
        c = end


@kernel
def warp(
    columns: Floats32,
    heights: Floats32,
    photo_of_pixel: NDArray[np.uint16],
    wanted: int,
    nodes: Floats,
    node_col: float,
    node_row: float,
    step: float,
    row0: float,
    model: int,
    parameters: Floats,
    reduction: float,
    shift_col: float,
    shift_row: float,
    map_x: Floats32,
    map_y: Floats32,
    valid: NDArray[np.uint8],
) -> int:
    """Photograph positions of the pixels of a window, ready for a resampler.

    Parameters
    ----------
    columns : (rows or 1, cols)
        Ground column of each pixel, in the units of `node_col`; one row serves all rows.
    heights : (rows, cols)
        NaN where there is no ground.
    photo_of_pixel : (rows, cols) or (0, 0)
        Which photograph serves each pixel; only those equal to `wanted` are valid. Empty: all are.
    reduction : float
        Pixels of the photograph per pixel of the reduced photograph that is resampled.
    shift_col, shift_row : float
        Subtracted from the positions, so that float32 keeps its precision far from the first pixel.

    Returns
    -------
    Number of positions written; the others are OUTSIDE. Positions are counted from the centre of the first
    pixel, as resamplers do.
    """
    rows, cols = heights.shape
    line = np.empty((nodes.shape[1], 6))
    points = np.empty((3, cols))
    image_col = np.empty(cols)
    image_row = np.empty(cols)
    inside = np.empty(cols, np.bool_)
    every = photo_of_pixel.shape[0] == 0
    scale = 1.0 / reduction
    offset_col = 0.5 + shift_col
    offset_row = 0.5 + shift_row
    count = 0
    for r in range(rows):
        lattice_row(nodes, (row0 + r + 0.5 - node_row) / step, line)
        column = columns[0 if columns.shape[0] == 1 else r]
        _camera_points(line, node_col, step, column, heights[r], points)
        image_from_camera_row(
            model, parameters, points[0], points[1], points[2], image_col, image_row, inside
        )
        if not every:
            for c in range(cols):
                inside[c] &= photo_of_pixel[r, c] == wanted
        x, y, v = map_x[r], map_y[r], valid[r]
        for c in range(cols):
            x[c] = image_col[c] * scale - offset_col if inside[c] else OUTSIDE
            y[c] = image_row[c] * scale - offset_row if inside[c] else OUTSIDE
            v[c] = 255 if inside[c] else 0
            count += inside[c]
    return count


@kernel
def move(map_x: Floats32, map_y: Floats32, dx: float, dy: float) -> None:
    """Add a shift to all positions, in place."""
    rows, cols = map_x.shape
    for r in range(rows):
        for c in range(cols):
            map_x[r, c] += dx
            map_y[r, c] += dy


@kernel
def clear_invalid(pixels: NDArray[Any], valid: NDArray[np.uint8]) -> None:
    """Set the bands of pixels (rows, cols, bands) to 0 where valid (rows, cols) is 0, in one pass."""
    rows, cols, bands = pixels.shape
    for i in range(rows):
        for j in range(cols):
            if valid[i, j] == 0:
                for band in range(bands):
                    pixels[i, j, band] = 0


@kernel
def take_valid(
    values: NDArray[Any],
    there: NDArray[np.uint8],
    number: int,
    pixels: NDArray[Any],
    valid: NDArray[np.uint8],
    photograph: NDArray[np.uint16],
) -> None:
    """Copy the pixels that a photograph serves, with its number, in one pass; `valid` becomes 255 there."""
    rows, cols, bands = pixels.shape
    for i in range(rows):
        for j in range(cols):
            if there[i, j] != 0:
                for band in range(bands):
                    pixels[i, j, band] = values[i, j, band]
                valid[i, j] = 255
                photograph[i, j] = number
