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
from stereomate.terrain.kernels.rays import first_hit, occluded_blockwise

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
    maxima: Floats,
    block: int,
    tolerance: float,
    check_hidden: NDArray[np.uint8],
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
    check_hidden : (photographs,)
        Whether anything in this window can be hidden from the photograph.
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
    surface_line = np.empty((node_cols, 3))
    surface_down = np.empty((node_cols, 3))
    ray_lines = np.empty((photographs, node_cols, 3))
    photo_lines = np.empty((photographs, node_cols, 6))
    highest = np.max(maxima)
    lowest = np.inf
    for i in range(patch.shape[0]):
        for j in range(patch.shape[1]):
            if patch[i, j] < lowest:
                lowest = patch[i, j]
    place = np.empty(3)
    by_col = np.empty(3)
    by_row = np.empty(3)
    hit = np.empty((2, 3))
    for r in range(rows):
        y = (row0 + r + 0.5 - node_row) / step
        lattice_row(surface_nodes, y, surface_line)
        above = min(max(int(y), 0), surface_nodes.shape[0] - 2)
        for i in range(node_cols):
            for k in range(3):
                surface_down[i, k] = surface_nodes[above + 1, i, k] - surface_nodes[above, i, k]
        for p in range(photographs):
            lattice_row(ray_nodes[p], y, ray_lines[p])
            lattice_row(photo_nodes[p], y, photo_lines[p])
        for c in range(cols):
            m = model[r, c]
            h = np.float64(heights[r, c])
            if m < 0 or right_of_model[m] < 0 or h != h:
                out[r, c, T_X] = np.nan
                out[r, c, T_Y] = np.nan
                out[r, c, ERROR] = np.nan
                out[r, c, SEEN] = np.nan
                continue
            x = (c + 0.5 - node_col) / step
            i = min(max(int(x), 0), node_cols - 2)
            f = x - i
            for k in range(3):
                place[k] = surface_line[i, k] + f * (surface_line[i + 1, k] - surface_line[i, k])
                by_col[k] = (surface_line[i + 1, k] - surface_line[i, k]) / step
                by_row[k] = (surface_down[i, k] + f * (surface_down[i + 1, k] - surface_down[i, k])) / step
            top = h + object_height
            top_dem = top - place[2]
            seen = 0
            met = True
            for side in range(2):
                p = left_of_model[m] if side == 0 else right_of_model[m]
                line = ray_lines[p]
                a = line[i, 0] + f * (line[i + 1, 0] - line[i, 0])
                b = line[i, 1] + f * (line[i + 1, 1] - line[i, 1])
                drop = line[i, 2] + f * (line[i + 1, 2] - line[i, 2]) + top
                px, py, pz = camera_point(photo_lines[p], x, top)
                _, _, inside = image_from_camera_point(camera_codes[p], camera_parameters[p], px, py, pz)
                if not inside or not drop < 0.0:
                    met = False
                    continue
                dcol = (a * by_col[0] - b * by_row[0]) / gsd
                drow = (a * by_col[1] - b * by_row[1]) / gsd
                dh = drop - (a * by_col[2] - b * by_row[2]) / gsd
                if check_hidden[p] and occluded_blockwise(
                    patch, maxima, block, place[0], place[1], top_dem, -dcol, -drow, -dh, highest, tolerance
                ):
                    met = False
                    continue
                seen += 1 + side
                t = first_hit(
                    patch, place[0], place[1], top_dem, dcol, drow, dh, (top_dem - lowest + 1.0) / -dh
                )
                hit[side, 0] = t * a
                hit[side, 1] = t * b
                hit[side, 2] = top + t * drop
            out[r, c, SEEN] = seen
            if not met:
                out[r, c, T_X] = np.nan
                out[r, c, T_Y] = np.nan
                out[r, c, ERROR] = np.nan
                continue
            du = hit[0, 0] - hit[1, 0]
            level = h - reference
            ideal = (
                base * object_height / (w0 - level - object_height) if w0 - level > object_height else np.nan
            )
            residual, error = reading(codes[0], parameters[0], du, hit[1, 2], h, object_height)
            out[r, c, T_X] = residual / ideal - 1.0
            out[r, c, T_Y] = (hit[0, 1] - hit[1, 1]) / ideal
            out[r, c, ERROR] = error
            if r % stride == 0 and c % stride == 0:
                for n in range(codes.size):
                    _, error = reading(codes[n], parameters[n], du, hit[1, 2], h, object_height)
                    add_statistics(statistics[n], error / object_height)
