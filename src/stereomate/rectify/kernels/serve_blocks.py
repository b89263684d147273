"""Blocks of pixels that one model serves as a whole, decided at their corners."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.kernels import image_from_camera_point
from stereomate.jit import inline_kernel, kernel

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Ints = NDArray[np.int64]

# Side of the blocks of pixels for which one model is decided on at once, where it is plain.
BLOCK = 16
# Scores closer than this are not told apart at the corners of a block, positions closer than this (pixels) to
# the border of a photograph not taken as inside for a whole block.
_SCORE_MARGIN = 1e-9
_BORDER_PX = 2.0
UNDECIDED = -2


@inline_kernel
def _bilinear_node(nodes: Floats, i: int, j: int, u: float, v: float, k: int) -> float:
    upper = nodes[i, j, k] + u * (nodes[i, j + 1, k] - nodes[i, j, k])
    lower = nodes[i + 1, j, k] + u * (nodes[i + 1, j + 1, k] - nodes[i + 1, j, k])
    value: float = upper + v * (lower - upper)
    return value


@inline_kernel
def _box_in_photograph(
    nodes: Floats,
    cell: tuple[int, int],
    u: tuple[float, float],
    v: tuple[float, float],
    h: tuple[float, float],
    code: int,
    parameters: Floats,
    field: Floats,
) -> int:
    """1 where a box of ground lies inside a photograph, off its border; -1 where outside it; else 0."""
    i, j = cell
    inside = True
    west = east = south = north = True
    for a in v:
        for b in u:
            for height in h:
                px = _bilinear_node(nodes, i, j, b, a, 0) + height * _bilinear_node(nodes, i, j, b, a, 3)
                py = _bilinear_node(nodes, i, j, b, a, 1) + height * _bilinear_node(nodes, i, j, b, a, 4)
                pz = _bilinear_node(nodes, i, j, b, a, 2) + height * _bilinear_node(nodes, i, j, b, a, 5)
                if pz >= 0.0:
                    return 0
                x, y = px / -pz, py / -pz
                west, east = west and x < field[0], east and x > field[1]
                south, north = south and y < field[2], north and y > field[3]
                if inside:
                    col, row, inside = image_from_camera_point(code, parameters, px, py, pz)
                    inside &= col > _BORDER_PX and row > _BORDER_PX
                    inside &= col < field[4] - _BORDER_PX and row < field[5] - _BORDER_PX
    if inside:
        return 1
    return -1 if west or east or south or north else 0


@inline_kernel
def _plain_winner(
    score_nodes: Floats,
    cell: tuple[int, int],
    u: tuple[float, float],
    v: tuple[float, float],
    excluded: NDArray[np.bool_],
) -> int:
    """The model with the lowest score all over a box in one cell of the lattice; UNDECIDED if there is none.

    Scores are bilinear there, and so are their differences: what holds at the corners holds inside.
    """
    i, j = cell
    winner, lowest = UNDECIDED, np.inf
    models = score_nodes.shape[2]
    for m in range(models):
        if not excluded[m]:
            score = _bilinear_node(score_nodes, i, j, u[0], v[0], m)
            if score < lowest:
                winner, lowest = m, score
    if winner == UNDECIDED:
        return -1
    for a in v:
        for b in u:
            mine = _bilinear_node(score_nodes, i, j, b, a, winner) + _SCORE_MARGIN
            for m in range(models):
                if m != winner and not excluded[m] and _bilinear_node(score_nodes, i, j, b, a, m) <= mine:
                    return UNDECIDED
    return winner


@inline_kernel
def _range_of_block(
    columns: Floats32, heights: Floats32, preferred: NDArray[np.int16], block: tuple[int, int, int, int]
) -> tuple[float, float, float, float, bool]:
    """Least and greatest ground column and height of a block of pixels; whether it prefers one model."""
    r0, r1, c0, c1 = block
    x0, x1, low, high = np.inf, -np.inf, np.inf, -np.inf
    has_preferred = preferred.shape[0] > 0
    same = True
    for r in range(r0, r1):
        column = columns[0 if columns.shape[0] == 1 else r]
        for c in range(c0, c1):
            h = heights[r, c]
            if h == h:
                low, high = min(low, h), max(high, h)
                x0, x1 = min(x0, column[c]), max(x1, column[c])
            if has_preferred and preferred[r, c] != preferred[r0, c0]:
                same = False
    return x0, x1, low, high, same


@kernel
def decide_blocks(
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
    bounds_of_photo: Ints,
    preferred: NDArray[np.int16],
    decided: NDArray[np.int16],
) -> None:
    """The model that serves all of a block, seen by both photographs; UNDECIDED where that is not plain.

    Fills `decided` (block rows, block cols): -1 where there is no ground or no model shows it. Arguments
    as of `kernels.serve.serve`.
    """
    rows, cols = heights.shape
    node_rows, node_cols = score_nodes.shape[:2]
    excluded = np.empty(score_nodes.shape[2], np.bool_)
    for k in range(decided.shape[0]):
        r0, r1 = k * BLOCK, min((k + 1) * BLOCK, rows)
        y0, y1 = (row0 + r0 + 0.5 - node_row) / step, (row0 + r1 - 0.5 - node_row) / step
        i = min(max(int(y0), 0), node_rows - 2)
        for n in range(decided.shape[1]):
            c0, c1 = n * BLOCK, min((n + 1) * BLOCK, cols)
            x0, x1, low, high, same = _range_of_block(columns, heights, preferred, (r0, r1, c0, c1))
            first = int(preferred[r0, c0]) if preferred.shape[0] > 0 else -1
            decided[k, n] = -1
            if low > high:
                continue
            decided[k, n] = UNDECIDED
            x0, x1 = (x0 - node_col) / step, (x1 - node_col) / step
            j = min(max(int(x0), 0), node_cols - 2)
            if not same or y1 > i + 1 or x1 > j + 1:
                continue
            u, v = (x0 - j, x1 - j), (y0 - i, y1 - i)
            excluded[:] = False
            m = first
            while decided[k, n] == UNDECIDED:
                if m < 0:
                    m = _plain_winner(score_nodes, (i, j), u, v, excluded)
                if m < 0:
                    decided[k, n] = m
                    break
                shows, hides = 1, False
                for p in (left_of_model[m], right_of_model[m]):
                    if p >= 0 and shows != -1:
                        hides |= bounds_of_photo[p] >= 0
                        box = _box_in_photograph(
                            photo_nodes[p], (i, j), u, v, (low, high),
                            camera_codes[p], camera_parameters[p], camera_fields[p],
                        )  # fmt: skip
                        shows = min(shows, box)
                if shows == 1 and not hides:
                    decided[k, n] = m
                if shows != -1:
                    break
                excluded[m] = True
                m = -1
