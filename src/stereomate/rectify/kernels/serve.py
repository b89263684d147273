"""Which model serves which ground, and what of the ground its two photographs see."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.kernels import image_from_camera_point
from stereomate.jit import inline_kernel, kernel
from stereomate.rectify.kernels.surface import lattice_row
from stereomate.rectify.kernels.warp import camera_point
from stereomate.terrain.kernels.rays import occluded_bounded
from stereomate.terrain.kernels.sampling import bilinear

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]

LEFT_SEES = 1
RIGHT_SEES = 2
BOTH_SEE = 3


@inline_kernel
def _in_photograph(lines: Floats, p: int, x: float, h: float, code: int, parameters: Floats) -> bool:
    px, py, pz = camera_point(lines[p], x, h)
    _, _, inside = image_from_camera_point(code, parameters, px, py, pz)
    return inside


@inline_kernel
def _hidden(
    patch: Floats, bounds: Floats, tolerance: float, col: float, row: float, h: float, centre: Floats
) -> bool:
    # Bicubic heights may lie below the bilinear surface that blocks: the way starts on the upper one.
    start = bilinear(patch, col, row)
    if start > h:
        h = start
    # The ray is straight in the height model's grid to d²/2R: 7 mm over 300 m.
    return occluded_bounded(patch, bounds, col, row, h, centre[0], centre[1], centre[2], tolerance)


@kernel
def serve(
    columns: Floats32,
    heights: Floats32,
    node_col: float,
    node_row: float,
    step: float,
    row0: float,
    score_nodes: Floats,
    left_of_model: NDArray[np.int64],
    right_of_model: NDArray[np.int64],
    photo_nodes: Floats,
    camera_codes: NDArray[np.int64],
    camera_parameters: Floats,
    surface_nodes: Floats,
    patch: Floats,
    bounds: Floats,
    bounds_of_photo: NDArray[np.int64],
    tolerance: float,
    centres: Floats,
    fill: bool,
    preferred: NDArray[np.int16],
    out_model: NDArray[np.int16],
    out_sees: NDArray[np.uint8],
) -> None:
    """Choose for every ground position the model with the lowest score among those that can serve it.

    A model can serve where the ground lies inside both its photographs. With `fill`, a model in which
    the ground is hidden gives way to the next one in which it is not; if there is none the first one stays.
    A model without a right photograph (index -1) serves where its left one does.

    Parameters
    ----------
    score_nodes : (node rows, node cols, models)
    photo_nodes : (photographs, node rows, node cols, 6)
    surface_nodes : (node rows, node cols, 3)
        Position in `patch` and height offset, for the rays.
    bounds : (hiding photographs, patch rows - 1, patch cols - 1)
        Of the patch and each centre, as `terrain.kernels.rays.sight_bounds` makes them.
    bounds_of_photo : (photographs,)
        Index in `bounds`; -1 where ground in this window cannot be hidden from the photograph at all.
    tolerance : float
        How far (metres) the surface may rise above the ray before it hides the ground.
    centres : (photographs, 3)
        Projection centres in patch coordinates: column, row, height in the height model's system.
    preferred : (rows, cols) or (0, 0)
        Index of the model that comes before all others at a pixel, -1 for none. Empty: nowhere.
    out_model : (rows, cols)
        Index of the model, -1 where none can serve.
    out_sees : (rows, cols)
        LEFT_SEES, RIGHT_SEES or both: which photographs see the ground.
    """
    rows, cols = heights.shape
    node_cols = score_nodes.shape[1]
    models = left_of_model.size
    photographs = photo_nodes.shape[0]
    score_line = np.empty((node_cols, models))
    surface_line = np.empty((node_cols, 3))
    photo_lines = np.empty((photographs, node_cols, 6))
    score = np.empty(models)
    one_row = columns.shape[0] == 1
    has_preferred = preferred.shape[0] > 0
    for r in range(rows):
        y = (row0 + r + 0.5 - node_row) / step
        lattice_row(score_nodes, y, score_line)
        lattice_row(surface_nodes, y, surface_line)
        for p in range(photographs):
            lattice_row(photo_nodes[p], y, photo_lines[p])
        column = columns[0 if one_row else r]
        for c in range(cols):
            out_model[r, c] = -1
            out_sees[r, c] = 0
            h = heights[r, c]
            if h != h:
                continue
            x = (column[c] - node_col) / step
            i = min(max(int(x), 0), node_cols - 2)
            f = x - i
            for m in range(models):
                score[m] = score_line[i, m] + f * (score_line[i + 1, m] - score_line[i, m])
            if has_preferred and preferred[r, c] >= 0:
                score[preferred[r, c]] = -1.0
            dem_col = surface_line[i, 0] + f * (surface_line[i + 1, 0] - surface_line[i, 0])
            dem_row = surface_line[i, 1] + f * (surface_line[i + 1, 1] - surface_line[i, 1])
            dem_h = h - surface_line[i, 2] - f * (surface_line[i + 1, 2] - surface_line[i, 2])
            for _ in range(models):
                m = int(np.argmin(score))
                if score[m] == np.inf:
                    break
                score[m] = np.inf
                left = left_of_model[m]
                right = right_of_model[m]
                if not _in_photograph(photo_lines, left, x, h, camera_codes[left], camera_parameters[left]):
                    continue
                if right >= 0 and not _in_photograph(
                    photo_lines, right, x, h, camera_codes[right], camera_parameters[right]
                ):
                    continue
                sees = BOTH_SEE
                b = bounds_of_photo[left]
                if b >= 0 and _hidden(patch, bounds[b], tolerance, dem_col, dem_row, dem_h, centres[left]):
                    sees -= LEFT_SEES
                b = bounds_of_photo[right] if right >= 0 else -1
                if b >= 0 and _hidden(patch, bounds[b], tolerance, dem_col, dem_row, dem_h, centres[right]):
                    sees -= RIGHT_SEES
                if out_model[r, c] < 0 or sees == BOTH_SEE:
                    out_model[r, c] = m
                    out_sees[r, c] = sees
                if sees == BOTH_SEE or not fill:
                    break
