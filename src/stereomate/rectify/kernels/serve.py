"""Which model serves which ground, and what of the ground its two photographs see."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.kernels import image_from_camera_point
from stereomate.jit import inline_kernel, kernel
from stereomate.rectify.kernels.serve_blocks import BLOCK, UNDECIDED, decide_blocks
from stereomate.rectify.kernels.surface import lattice_row
from stereomate.rectify.kernels.warp import camera_point
from stereomate.terrain.kernels.sampling import bilinear
from stereomate.terrain.kernels.sight import occluded_bounded

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Ints = NDArray[np.int64]

LEFT_SEES = 1
RIGHT_SEES = 2
BOTH_SEE = 3


# Ground of one pixel: lattice column, height, and column, row and height in the patch.
Place = tuple[float, float, float, float, float]


@inline_kernel
def _in_photograph(lines: Floats, p: int, place: Place, codes: Ints, parameters: Floats) -> bool:
    px, py, pz = camera_point(lines[p], place[0], place[1])
    _, _, inside = image_from_camera_point(codes[p], parameters[p], px, py, pz)
    return inside


@inline_kernel
def _is_hidden(
    p: int,
    place: Place,
    patch: Floats,
    bounds: Floats,
    bounds_of_photo: Ints,
    centres: Floats,
    tolerance: float,
) -> bool:
    k = bounds_of_photo[p]
    if k < 0:
        return False
    # Bicubic heights may lie below the bilinear surface that blocks: the way starts on the upper one.
    h = max(place[4], bilinear(patch, place[2], place[3]))
    # The ray is straight in the height model's grid to d²/2R: 7 mm over 300 m.
    return occluded_bounded(
        patch, bounds[k], place[2], place[3], h, centres[p, 0], centres[p, 1], centres[p, 2], tolerance
    )


@kernel
def _seeing_photograph(
    other: int,
    least: float,
    most: float,
    order: Ints,
    lines: Floats,
    place: Place,
    left_of_model: Ints,
    right_of_model: Ints,
    codes: Ints,
    parameters: Floats,
    patch: Floats,
    bounds: Floats,
    bounds_of_photo: Ints,
    centres: Floats,
    tolerance: float,
    along: Floats,
) -> int:
    """The first photograph of the models asked that sees the ground, -1 for none; never `other`.

    Its centre lies from `least` to `most` along the rows.
    """
    for m in order:
        for p in (left_of_model[m], right_of_model[m]):
            if p < 0 or p == other or not least <= along[p] <= most:
                continue
            if _in_photograph(lines, p, place, codes, parameters) and not _is_hidden(
                p, place, patch, bounds, bounds_of_photo, centres, tolerance
            ):
                return int(p)
    return -1


@kernel
def _fill_eyes(
    model: int,
    sees: int,
    order: Ints,
    lines: Floats,
    place: Place,
    left_of_model: Ints,
    right_of_model: Ints,
    codes: Ints,
    parameters: Floats,
    patch: Floats,
    bounds: Floats,
    bounds_of_photo: Ints,
    centres: Floats,
    tolerance: float,
    along: Floats,
    least_base: float,
    out: NDArray[np.int16],
) -> None:
    """Two photographs that see ground which no model sees with both: for the left and the right eye.

    One of `model` that sees it is kept. Another is found for it: if possible on its own side with a base,
    else with a base, else any. The one whose centre lies further along the rows is the right one. If a single
    photograph sees the ground, it is the orthophoto's: never do both eyes see one.
    """
    at_left = sees != RIGHT_SEES
    kept = left_of_model[model] if at_left else right_of_model[model]
    if sees == 0:
        kept = _seeing_photograph(
            -1, -np.inf, np.inf, order, lines, place, left_of_model, right_of_model, codes, parameters,
            patch, bounds, bounds_of_photo, centres, tolerance, along,
        )  # fmt: skip
    found = -1
    for side in range(3 if kept >= 0 else 0):
        least, most = -np.inf, np.inf
        if side < 2 and at_left == (side == 0):
            least = along[kept] + least_base
        elif side < 2:
            most = along[kept] - least_base
        if found < 0:
            found = _seeing_photograph(
                kept, least, most, order, lines, place, left_of_model, right_of_model, codes, parameters,
                patch, bounds, bounds_of_photo, centres, tolerance, along,
            )  # fmt: skip
    if found >= 0 and along[found] < along[kept]:
        kept, found = found, kept
    out[0] = kept if kept >= 0 else -2
    out[1] = found if found >= 0 else -2


@kernel
def _serve_row(
    column: Floats32,
    heights: Floats32,
    decided: NDArray[np.int16],
    node_col: float,
    step: float,
    score_line: Floats,
    surface_line: Floats,
    lines: Floats,
    left_of_model: Ints,
    right_of_model: Ints,
    codes: Ints,
    parameters: Floats,
    patch: Floats,
    bounds: Floats,
    bounds_of_photo: Ints,
    centres: Floats,
    tolerance: float,
    along: Floats,
    least_base: float,
    preferred: NDArray[np.int16],
    out_model: NDArray[np.int16],
    out_sees: NDArray[np.uint8],
    out_filled: NDArray[np.int16],
) -> None:
    """`serve` along a row. One function a row: passing arrays for every pixel would take as long again."""
    last_cell = score_line.shape[0] - 2
    models = score_line.shape[1]
    score = np.empty(models)
    order = np.empty(models, np.int64)
    fill = out_filled.shape[1] > 0
    for c in range(column.shape[0]):
        h = heights[c]
        plain = decided[c // BLOCK] if h == h else -1
        if plain != UNDECIDED:
            out_model[c] = plain
            out_sees[c] = BOTH_SEE if plain >= 0 else 0
            continue
        out_model[c], out_sees[c] = -1, 0
        x = (column[c] - node_col) / step
        i = min(max(int(x), 0), last_cell)
        f = x - i
        for m in range(models):
            score[m] = score_line[i, m] + f * (score_line[i + 1, m] - score_line[i, m])
        if preferred.shape[0] > 0 and preferred[c] >= 0:
            score[preferred[c]] = -1.0
        dem_col = surface_line[i, 0] + f * (surface_line[i + 1, 0] - surface_line[i, 0])
        dem_row = surface_line[i, 1] + f * (surface_line[i + 1, 1] - surface_line[i, 1])
        offset = surface_line[i, 2] + f * (surface_line[i + 1, 2] - surface_line[i, 2])
        place = (x, h, dem_col, dem_row, h - offset)
        sees, single, asked = 0, True, 0
        while asked < models:
            m = int(np.argmin(score))
            if score[m] == np.inf:
                break
            score[m] = np.inf
            order[asked] = m
            asked += 1
            left, right = left_of_model[m], right_of_model[m]
            # a single photograph takes no ground from a model: it may fill one of its eyes
            if not single and right < 0:
                continue
            if not _in_photograph(lines, left, place, codes, parameters):
                continue
            if right >= 0 and not _in_photograph(lines, right, place, codes, parameters):
                continue
            sees = BOTH_SEE
            if _is_hidden(left, place, patch, bounds, bounds_of_photo, centres, tolerance):
                sees -= LEFT_SEES
            if right >= 0 and _is_hidden(right, place, patch, bounds, bounds_of_photo, centres, tolerance):
                sees -= RIGHT_SEES
            if out_model[c] < 0 or sees == BOTH_SEE:
                out_model[c], out_sees[c], single = m, sees, right < 0
            if sees == BOTH_SEE or not fill:
                break
        if fill and not single and sees != BOTH_SEE:
            _fill_eyes(
                out_model[c], out_sees[c], order[:asked], lines, place, left_of_model, right_of_model,
                codes, parameters, patch, bounds, bounds_of_photo, centres, tolerance, along, least_base,
                out_filled[:, c],
            )  # fmt: skip


@kernel
def serve(
    columns: Floats32,
    heights: Floats32,
    node_col: float,
    node_row: float,
    step: float,
    row0: float,
    score_nodes: Floats,
    left_of_model: Ints,
    right_of_model: Ints,
    photo_nodes: Floats,
    camera_codes: Ints,
    camera_parameters: Floats,
    camera_fields: Floats,
    surface_nodes: Floats,
    patch: Floats,
    bounds: Floats,
    bounds_of_photo: Ints,
    tolerance: float,
    centres: Floats,
    along: Floats,
    least_base: float,
    preferred: NDArray[np.int16],
    out_model: NDArray[np.int16],
    out_sees: NDArray[np.uint8],
    out_filled: NDArray[np.int16],
) -> None:
    """Choose for every ground position the model with the lowest score among those that can serve it.

    A model can serve where the ground lies inside both its photographs. A model without a right photograph
    (index -1) serves where its left one does. Where hidden ground is to be filled, a model in which
    the ground is hidden gives way to the next one in which it is not; if there is none the first one stays,
    and each eye takes another photograph that sees the ground.

    Parameters
    ----------
    score_nodes : (node rows, node cols, models)
    photo_nodes : (photographs, node rows, node cols, 6)
    camera_fields : (photographs, 6)
        Least and greatest x/-z and y/-z of the photograph with a margin, columns and rows.
    surface_nodes : (node rows, node cols, 3)
        Position in `patch` and height offset, for the rays.
    bounds : (hiding photographs, patch rows - 1, patch cols - 1)
        Of the patch and each centre, as `terrain.kernels.sight.sight_bounds` makes them.
    bounds_of_photo : (photographs,)
        Index in `bounds`; -1 where ground in this window cannot be hidden from the photograph at all.
    tolerance : float
        How far (metres) the surface may rise above the ray before it hides the ground.
    centres : (photographs, 3)
        Projection centres in patch coordinates: column, row, height in the height model's system.
    along : (photographs,)
        Positions of the centres along the rows of the product, for filling.
    least_base : float
        Of two photographs that fill both eyes, if there are such.
    preferred : (rows, cols) or (0, 0)
        Index of the model that comes before all others at a pixel, -1 for none. Empty: nowhere.
    out_model : (rows, cols)
        Index of the model, -1 where none can serve.
    out_sees : (rows, cols)
        LEFT_SEES, RIGHT_SEES or both: which photographs of the model see the ground.
    out_filled : (2, rows, cols) or (2, 0, 0)
        Photographs that show left and right eye the ground in place of those of the model, -1 where these do;
        -2 where neither can. Empty: hidden ground is not filled.
    """
    rows, cols = heights.shape
    node_cols = score_nodes.shape[1]
    models = left_of_model.size
    photographs = photo_nodes.shape[0]
    score_line = np.empty((node_cols, models))
    surface_line = np.empty((node_cols, 3))
    photo_lines = np.empty((photographs, node_cols, 6))
    nothing = np.empty((2, 1, 0), np.int16)
    decided = np.empty((-(-rows // BLOCK), -(-cols // BLOCK)), np.int16)
    decide_blocks(
        columns, heights, node_col, node_row, step, row0, score_nodes, left_of_model, right_of_model,
        photo_nodes, camera_codes, camera_parameters, camera_fields, bounds_of_photo, preferred, decided,
    )  # fmt: skip
    for r in range(rows):
        y = (row0 + r + 0.5 - node_row) / step
        lattice_row(score_nodes, y, score_line)
        lattice_row(surface_nodes, y, surface_line)
        for p in range(photographs):
            lattice_row(photo_nodes[p], y, photo_lines[p])
        _serve_row(
            columns[0 if columns.shape[0] == 1 else r], heights[r], decided[r // BLOCK], node_col, step,
            score_line, surface_line, photo_lines, left_of_model, right_of_model, camera_codes,
            camera_parameters, patch, bounds, bounds_of_photo, centres, tolerance, along, least_base,
            preferred[r] if preferred.shape[0] > 0 else nothing[0, 0],
            out_model[r], out_sees[r], out_filled[:, r] if out_filled.shape[1] > 0 else nothing[:, 0],
        )  # fmt: skip
