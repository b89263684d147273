"""Homogeneity by tracing: both rays of an object to the real surface, for every position of a window.

Around an object the product axes (u, v, h) are an affine picture of space: the ray from a projection
centre runs in them along (a, b, c + h), the position of the object relative to the centre, with a, b, c
interpolated over the lattice. In a Cartesian frame that is exact.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.kernels import image_from_camera_point
from stereomate.jit import kernel
from stereomate.parallax.kernels import height_of_q, q_of_height
from stereomate.rectify.kernels.surface import lattice_row
from stereomate.rectify.kernels.warp import camera_point
from stereomate.terrain.kernels.rays import first_hit
from stereomate.terrain.kernels.sight import occluded_bounded

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]

T_X = 0
T_Y = 1
ERROR = 2
SEEN = 3

# Columns of the statistics of a law.
COUNT = 0
WITHIN_5 = 1
WITHIN_10 = 2
SUM = 3
SQUARES = 4
LARGEST = 5
STATISTICS = 6


@kernel
def reading(
    code: int, parameters: Floats, du: float, h_right: float, h_ground: float, object_height: float
) -> tuple[float, float]:
    """Residual parallax along the row, and the error of the object height that the law reads from it."""
    q_ground = q_of_height(code, parameters, h_ground)
    shown = du + q_of_height(code, parameters, h_right)
    return shown - q_ground, height_of_q(code, parameters, shown) - h_ground - object_height


@kernel
def add_statistics(row: Floats, value: float) -> None:
    """Take a relative error into the statistics of a law."""
    size = abs(value)
    if size != size:
        return
    row[COUNT] += 1.0
    row[WITHIN_5] += size <= 0.05
    row[WITHIN_10] += size <= 0.10
    row[SUM] += value
    row[SQUARES] += value * value
    row[LARGEST] = max(row[LARGEST], size)


@kernel
def _tracks(
    nodes: Floats, x: float, y: float, step: float, place: Floats, by_col: Floats, by_row: Floats
) -> None:
    """Position in the patch and height offset at node coordinates, their changes per column and row."""
    i = min(max(int(x), 0), nodes.shape[1] - 2)
    j = min(max(int(y), 0), nodes.shape[0] - 2)
    f, g = x - i, y - j
    for k in range(3):
        a, b = nodes[j, i, k], nodes[j, i + 1, k]
        c, d = nodes[j + 1, i, k], nodes[j + 1, i + 1, k]
        place[k] = (a + f * (b - a)) + g * ((c + f * (d - c)) - (a + f * (b - a)))
        by_col[k] = ((b - a) + g * ((d - c) - (b - a))) / step
        by_row[k] = ((c - a) + f * ((d - b) - (c - a))) / step


@kernel
def _seen_ground(
    patch: Floats,
    bounds: Floats,
    place: Floats,
    by_col: Floats,
    by_row: Floats,
    gsd: float,
    top: float,
    ray: tuple[float, float, float],
    lowest: float,
    tolerance: float,
    hit: Floats,
) -> bool:
    """Where the ray through the top of an object meets the ground, relative to its foot, as (u, v, h).

    `ray` is the way from the centre to the top in product axes. False where the ground hides the top;
    `bounds` is empty where nothing can.
    """
    a, b, drop = ray
    dcol = (a * by_col[0] - b * by_row[0]) / gsd
    drow = (a * by_col[1] - b * by_row[1]) / gsd
    dh = drop - (a * by_col[2] - b * by_row[2]) / gsd
    top_dem = top - place[2]
    if bounds.size > 0 and occluded_bounded(
        patch, bounds, place[0], place[1], top_dem, place[0] - dcol, place[1] - drow, top_dem - dh, tolerance
    ):
        return False
    t = first_hit(patch, place[0], place[1], top_dem, dcol, drow, dh, (top_dem - lowest + 1.0) / -dh)
    hit[0] = t * a
    hit[1] = t * b
    hit[2] = top + t * drop
    return True


@kernel
def _lowest(patch: Floats) -> float:
    lowest = np.inf
    for i in range(patch.shape[0]):
        for j in range(patch.shape[1]):
            if patch[i, j] < lowest:
                lowest = patch[i, j]
    return lowest


@kernel
def trace_window(
    heights: Floats32,
    model: NDArray[np.int16],
    left_of_model: NDArray[np.int64],
    right_of_model: NDArray[np.int64],
    node_col: float,
    node_row: float,
    step: float,
    row0: float,
    gsd: float,
    ray_nodes: Floats,
    photo_nodes: Floats,
    camera_codes: NDArray[np.int64],
    camera_parameters: Floats,
    surface_nodes: Floats,
    patch: Floats,
    bounds: Floats,
    bounds_of: NDArray[np.int64],
    tolerance: float,
    object_height: float,
    base: float,
    w0: float,
    reference: float,
    codes: NDArray[np.int64],
    parameters: Floats,
    stride: int,
    out: Floats32,
    statistics: Floats,
) -> None:
    """t_x, t_y, error of the law's object height, and who sees the object, for every pixel of a window.

    Parameters
    ----------
    heights : (rows, cols)
        Of the ground below the objects.
    model : (rows, cols)
        Which model serves the ground; -1 for none.
    node_col, node_row, step, row0
        First node relative to the window's first column, in product rows, and the lattice's mesh; first row.
    ray_nodes : (photographs, node rows, node cols, 3)
        (a, b, c): position at height 0 relative to the centre along u, v and up.
    photo_nodes : (photographs, node rows, node cols, 6)
        Camera-frame points, as `rectify.serving.camera_nodes`.
    surface_nodes : (node rows, node cols, 3)
        Position in the patch and offset of its heights.
    bounds : (centres, rows - 1, cols - 1)
        `terrain.kernels.sight.sight_bounds` of the patch.
    bounds_of : (photographs,)
        Which of them belongs to a photograph; -1 where nothing in this window can be hidden from it.
    base, w0, reference : float
        Nominal values of the law: they make the ideal parallax.
    codes, parameters : (laws,), (laws, n)
        The law of the product first, then those to compare it with, on every `stride`-th row and column.
    out : (rows, cols, 4)
        NaN in all bands where no model serves; t and error NaN where the object is not seen by both.
    statistics : (laws, 6)
        Added to.
    """
    rows, cols = heights.shape
    node_cols = surface_nodes.shape[1]
    photographs = ray_nodes.shape[0]
    ray_lines = np.empty((photographs, node_cols, 3))
    photo_lines = np.empty((photographs, node_cols, 6))
    lowest = _lowest(patch)
    place, by_col, by_row = np.empty(3), np.empty(3), np.empty(3)
    hit = np.empty((2, 3))
    free = np.empty((0, 0))
    for r in range(rows):
        y = (row0 + r + 0.5 - node_row) / step
        for p in range(photographs):
            lattice_row(ray_nodes[p], y, ray_lines[p])
            lattice_row(photo_nodes[p], y, photo_lines[p])
        for c in range(cols):
            m = model[r, c]
            h = np.float64(heights[r, c])
            out[r, c, :] = np.nan
            if m < 0 or right_of_model[m] < 0 or h != h:
                continue
            x = (c + 0.5 - node_col) / step
            i = min(max(int(x), 0), node_cols - 2)
            f = x - i
            _tracks(surface_nodes, x, y, step, place, by_col, by_row)
            top = h + object_height
            seen = 0
            for side in range(2):
                p = left_of_model[m] if side == 0 else right_of_model[m]
                line = ray_lines[p]
                a = line[i, 0] + f * (line[i + 1, 0] - line[i, 0])
                b = line[i, 1] + f * (line[i + 1, 1] - line[i, 1])
                drop = line[i, 2] + f * (line[i + 1, 2] - line[i, 2]) + top
                px, py, pz = camera_point(photo_lines[p], x, top)
                _, _, inside = image_from_camera_point(camera_codes[p], camera_parameters[p], px, py, pz)
                if not inside or not drop < 0.0:
                    continue
                sight = bounds[bounds_of[p]] if bounds_of[p] >= 0 else free
                if _seen_ground(
                    patch, sight, place, by_col, by_row, gsd, top, (a, b, drop), lowest, tolerance, hit[side]
                ):
                    seen += 1 + side
            out[r, c, SEEN] = seen
            if seen != 3:
                continue
            du = hit[0, 0] - hit[1, 0]
            room = w0 - (h - reference) - object_height
            ideal = base * object_height / room if room > 0.0 else np.nan
            residual, error = reading(codes[0], parameters[0], du, hit[1, 2], h, object_height)
            out[r, c, T_X] = residual / ideal - 1.0
            out[r, c, T_Y] = (hit[0, 1] - hit[1, 1]) / ideal
            out[r, c, ERROR] = error
            if r % stride == 0 and c % stride == 0:
                for n in range(codes.size):
                    _, error = reading(codes[n], parameters[n], du, hit[1, 2], h, object_height)
                    add_statistics(statistics[n], error / object_height)
