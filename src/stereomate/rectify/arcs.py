"""Seams on the coarse grid: lines between cells, and cheapest ways along the edges of cells."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import scipy  # its parts load when they are used
import shapely
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]
Labels = NDArray[np.int32]

# Cost of a step between cells that both models do not show.
FORCED: Final = 40.0


@dataclass(frozen=True, eq=False)
class Arc:
    """A seam between two regions.

    Attributes
    ----------
    vertices : (n, 2) int
        Corners of cells (column, row), each one step from the next.
    labels : (int, int)
    """

    vertices: Ints
    labels: tuple[int, int]


def seam_arcs(label: Labels) -> list[Arc]:
    """The lines between regions, from junction to junction or to the border of the grid."""
    merged = shapely.line_merge(shapely.multilinestrings(_unit_steps(label)))
    if merged.is_empty:
        return []
    arcs = []
    for line in shapely.get_parts(merged):
        vertices = shapely.get_coordinates(line).astype(np.int64)
        arcs.append(Arc(vertices, _labels_beside(label, vertices[0], vertices[1])))
    return sorted(arcs, key=lambda arc: (*arc.vertices[0].tolist(), *arc.vertices[-1].tolist()))


def _unit_steps(label: Labels) -> Any:
    """Line strings of one step between cells of different labels."""
    row, col = np.nonzero(label[:, 1:] != label[:, :-1])
    upright = np.stack([np.stack([col + 1, row], -1), np.stack([col + 1, row + 1], -1)], axis=1)
    row, col = np.nonzero(label[1:] != label[:-1])
    level = np.stack([np.stack([col, row + 1], -1), np.stack([col + 1, row + 1], -1)], axis=1)
    return shapely.linestrings(np.concatenate([upright, level]).astype(np.float64))


def _labels_beside(label: Labels, a: Ints, b: Ints) -> tuple[int, int]:
    """Labels on both sides of the step from corner `a` to corner `b`, the smaller one first."""
    col, row = int(min(a[0], b[0])), int(min(a[1], b[1]))
    if a[0] == b[0]:
        sides = int(label[row, col - 1]), int(label[row, col])
    else:
        sides = int(label[row - 1, col]), int(label[row, col])
    return min(sides), max(sides)


def step_graph(
    cost: Floats32, passable: Bools, mine: Bools, chains: Sequence[Ints], extra: Floats32 | None = None
) -> Any:
    """Steps along the edges of cells as a sparse graph of their corners.

    Parameters
    ----------
    cost, passable : (rows, cols)
        Of the cells; a step costs the mean of the cells on both sides.
    mine : (rows + 1, cols + 1)
        Corners that may be used.
    chains : sequence of (n, 2) int
        Ways that are open whatever the others say, but for steps that do not lie between two of the cells.
    extra : (rows + 1, cols + 1), optional
        Added to the cost of a step, mean of its corners.
    """
    rows, cols = cost.shape
    number = np.arange((rows + 1) * (cols + 1)).reshape(rows + 1, cols + 1)
    mine = mine.copy()
    cost = np.where(passable, cost, np.float32(FORCED))
    more = np.zeros((rows + 1, cols + 1), np.float32) if extra is None else extra
    # Steps along a row lie between the cells above and below, along a column between left and right.
    level = 0.5 * (cost[1:] + cost[:-1] + more[1:-1, 1:] + more[1:-1, :-1])
    level_open = passable[1:] & passable[:-1] & mine[1:-1, 1:] & mine[1:-1, :-1]
    upright = 0.5 * (cost[:, 1:] + cost[:, :-1] + more[1:, 1:-1] + more[:-1, 1:-1])
    upright_open = passable[:, 1:] & passable[:, :-1] & mine[1:, 1:-1] & mine[:-1, 1:-1]
    for a, b in itertools.chain.from_iterable(itertools.pairwise(chain) for chain in chains):
        col, row = int(min(a[0], b[0])), int(min(a[1], b[1]))
        if a[0] == b[0] and 0 < col < cols and 0 <= row < rows:
            upright_open[row, col - 1] = True
        elif a[1] == b[1] and 0 < row < rows and 0 <= col < cols:
            level_open[row - 1, col] = True
    tails = np.concatenate([number[1:-1, :-1][level_open], number[:-1, 1:-1][upright_open]])
    heads = np.concatenate([number[1:-1, 1:][level_open], number[1:, 1:-1][upright_open]])
    weights = np.concatenate([level[level_open], upright[upright_open]]).astype(np.float64)
    return scipy.sparse.csr_matrix((weights, (tails, heads)), shape=(number.size, number.size))


def cheapest(graph: Any, start: int) -> tuple[Floats, NDArray[np.int32]]:
    """Cost of the cheapest way from `start` to every corner (inf: none), and the corner before each one."""
    dijkstra: Any = scipy.sparse.csgraph.dijkstra
    cost, before = dijkstra(graph, directed=False, indices=start, return_predecessors=True)
    return cost, before


def walk(before: NDArray[np.int32], start: int, end: int, width: int) -> Ints:
    """Corners (n, 2) as column, row of the cheapest way from `start` to `end`; `width` corners to a row.

    There must be a way: its cost is finite.
    """
    way = [end]
    while way[-1] != start:
        way.append(int(before[way[-1]]))
    at = np.array(way[::-1], np.int64)
    return np.stack([at % width, at // width], axis=1)
