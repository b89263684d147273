"""From ground positions of a product window to positions in a photograph.

A photograph's lattice holds, per node, the camera-frame point of the ground at height 0 and its change per
metre of height: the camera-frame point of a pixel is exactly linear in its height, bilinear in its position.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.kernels import image_from_camera_point
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
) -> tuple[float, float, float, float]:
    """Photograph positions of the pixels of a window, ready for a resampler.

    Parameters
    ----------
    columns : (rows or 1, cols)
        Ground column of each pixel, in the units of `node_col`; one row serves all rows.
    heights : (rows, cols)
        NaN where there is no ground.
    photo_of_pixel : (rows, cols) or (0, 0)
        Which photograph serves each pixel; only those equal to `wanted` are computed. Empty: all are.
    reduction : float
        Pixels of the photograph per pixel of the reduced photograph that is resampled.
    shift_col, shift_row : float
        Subtracted from the positions, so that float32 keeps its precision far from the first pixel.

    Returns
    -------
    (min_x, max_x, min_y, max_y) of the positions written; min > max when there are none. Positions are
    counted from the centre of the first pixel, as resamplers do.
    """
    rows, cols = heights.shape
    line = np.empty((nodes.shape[1], 6))
    one_row = columns.shape[0] == 1
    every = photo_of_pixel.shape[0] == 0
    per_step = 1.0 / step
    per_reduction = 1.0 / reduction
    min_x, max_x, min_y, max_y = math.inf, -math.inf, math.inf, -math.inf
    for r in range(rows):
        lattice_row(nodes, (row0 + r + 0.5 - node_row) * per_step, line)
        column = columns[0 if one_row else r]
        for c in range(cols):
            map_x[r, c] = OUTSIDE
            map_y[r, c] = OUTSIDE
            valid[r, c] = 0
            h = heights[r, c]
            if h != h or not (every or photo_of_pixel[r, c] == wanted):
                continue
            px, py, pz = camera_point(line, (column[c] - node_col) * per_step, h)
            col, row, inside = image_from_camera_point(model, parameters, px, py, pz)
            if not inside:
                continue
            x = col * per_reduction - 0.5 - shift_col
            y = row * per_reduction - 0.5 - shift_row
            map_x[r, c] = x
            map_y[r, c] = y
            valid[r, c] = 255
            min_x = min(min_x, x)
            max_x = max(max_x, x)
            min_y = min(min_y, y)
            max_y = max(max_y, y)
    return min_x, max_x, min_y, max_y


@kernel
def move(map_x: Floats32, map_y: Floats32, dx: float, dy: float) -> None:
    """Add a shift to all positions, in place."""
    rows, cols = map_x.shape
    for r in range(rows):
        for c in range(cols):
            map_x[r, c] += dx
            map_y[r, c] += dy
