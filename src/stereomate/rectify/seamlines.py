"""Seams as least-cost paths on the coarse grid.

The regions of the best models give the first seams: lines between cells, meeting at junctions. Each line
then moves, between its ends, to the cheapest path in its own strip of ground (the places nearer to it than to
any other seam, not too far from it, which both models show), so no two of them ever cross.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import scipy.ndimage
import scipy.sparse
import scipy.sparse.csgraph
import shapely
from numpy.typing import NDArray

from stereomate.raster import Window
from stereomate.rectify.disagreement import disagreement
from stereomate.rectify.layout import StereoModel
from stereomate.rectify.overviews import Overviews

Floats32 = NDArray[np.float32]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]
Labels = NDArray[np.int32]

# A seam moves by less than this share of the root of a median region's area.
REACH: Final = 0.2
# Cost of a step that both models do not show, and of one that leaves the first seam by its whole reach.
_FORCED: Final = 40.0
_AWAY: Final = 0.3


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


def improved_regions(
    overviews: Overviews, models: tuple[StereoModel, ...], label: Labels, scale: float
) -> Labels:
    """Regions with their seams on least-cost paths.

    Parameters
    ----------
    label : (rows, cols)
        A model in every cell.
    """
    arcs = seam_arcs(label)
    if not arcs:
        return label
    sizes = np.bincount(label.ravel())
    reach = max(4.0, REACH * float(np.sqrt(np.median(sizes[sizes > 0]))))
    zones, distance = _zones(arcs, label.shape, reach)
    around = zones, distance, reach
    moved = [
        _least_cost(overviews, (models[arc.labels[0]], models[arc.labels[1]]), arc, k, around, scale)
        for k, arc in enumerate(arcs)
    ]
    return _regions_between(moved, label)


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


def _zones(arcs: list[Arc], shape: tuple[int, int], reach: float) -> tuple[Labels, Floats32]:
    """Per corner the nearest seam (-1 beyond its reach), and the distance to it in cells."""
    nearest = np.full((shape[0] + 1, shape[1] + 1), -1, np.int32)
    for k, arc in enumerate(arcs):
        nearest[arc.vertices[:, 1], arc.vertices[:, 0]] = k
    distance, index = scipy.ndimage.distance_transform_edt(nearest < 0, return_indices=True)
    zones = nearest[index[0], index[1]]
    zones[distance > reach] = -1
    return np.ascontiguousarray(zones), distance.astype(np.float32)


def _least_cost(
    overviews: Overviews,
    models: tuple[StereoModel, StereoModel],
    arc: Arc,
    number: int,
    surroundings: tuple[Labels, Floats32, float],
    scale: float,
) -> Arc:
    zones, distance, reach = surroundings
    ends = arc.vertices[0], arc.vertices[-1]
    if len(arc.vertices) < 3 or (ends[0] == ends[1]).all():
        return arc
    rows, cols = overviews.shape
    pad = int(reach) + 2
    col0, row0 = np.maximum(arc.vertices.min(axis=0) - pad, 0).tolist()
    col1, row1 = np.minimum(arc.vertices.max(axis=0) + pad, (cols, rows)).tolist()
    window = Window(col0, row0, col1 - col0, row1 - row0)
    both = disagreement(overviews, *models, window, scale)
    passable = (both.first & both.second) | ~(both.first | both.second)
    corners = (slice(row0, row1 + 1), slice(col0, col1 + 1))
    mine = zones[corners] == number
    own = arc.vertices - [col0, row0]
    mine[own[:, 1], own[:, 0]] = True
    graph = _graph(both.cost, passable, mine, own, distance[corners] / np.float32(reach))
    width = window.cols + 1
    start, end = (int(v[1] * width + v[0]) for v in (own[0], own[-1]))
    before = _predecessors(graph, start)
    path = [end]
    while path[-1] != start:
        path.append(int(before[path[-1]]))
    at = np.array(path[::-1])
    return Arc(np.stack([at % width + col0, at // width + row0], axis=1), arc.labels)


def _predecessors(graph: Any, start: int) -> NDArray[np.int32]:
    """Corner before each one on its cheapest path from `start`."""
    dijkstra: Any = scipy.sparse.csgraph.dijkstra
    before: NDArray[np.int32] = dijkstra(graph, directed=False, indices=start, return_predecessors=True)[1]
    return before


def _graph(cost: Floats32, passable: Bools, mine: Bools, own: Ints, away: Floats32) -> Any:
    """Steps along cell edges as a sparse graph of corners; the first seam itself is always open."""
    rows, cols = cost.shape
    number = np.arange((rows + 1) * (cols + 1)).reshape(rows + 1, cols + 1)
    cost = np.where(passable, cost, np.float32(_FORCED))
    # Steps along a row lie between the cells above and below, along a column between left and right.
    level = 0.5 * (cost[1:] + cost[:-1]) + 0.5 * _AWAY * (away[1:-1, 1:] + away[1:-1, :-1])
    level_open = passable[1:] & passable[:-1] & mine[1:-1, 1:] & mine[1:-1, :-1]
    upright = 0.5 * (cost[:, 1:] + cost[:, :-1]) + 0.5 * _AWAY * (away[1:, 1:-1] + away[:-1, 1:-1])
    upright_open = passable[:, 1:] & passable[:, :-1] & mine[1:, 1:-1] & mine[:-1, 1:-1]
    for a, b in itertools.pairwise(own):
        col, row = int(min(a[0], b[0])), int(min(a[1], b[1]))
        if a[0] == b[0]:
            upright_open[row, col - 1] = True
        else:
            level_open[row - 1, col] = True
    tails = np.concatenate([number[1:-1, :-1][level_open], number[:-1, 1:-1][upright_open]])
    heads = np.concatenate([number[1:-1, 1:][level_open], number[1:, 1:-1][upright_open]])
    weights = np.concatenate([level[level_open], upright[upright_open]]).astype(np.float64)
    return scipy.sparse.csr_matrix((weights, (tails, heads)), shape=(number.size, number.size))


def _regions_between(arcs: list[Arc], label: Labels) -> Labels:
    """Regions that the arcs cut the grid into; each keeps the label of most of its cells."""
    rows, cols = label.shape
    free = np.zeros((2 * rows - 1, 2 * cols - 1), np.bool_)
    free[::2, ::2] = free[1::2, ::2] = free[::2, 1::2] = True
    for arc in arcs:
        a, b = arc.vertices[:-1], arc.vertices[1:]
        col, row = np.minimum(a[:, 0], b[:, 0]), np.minimum(a[:, 1], b[:, 1])
        upright = a[:, 0] == b[:, 0]
        free[2 * row[upright], 2 * col[upright] - 1] = False
        free[2 * row[~upright] - 1, 2 * col[~upright]] = False
    regions = scipy.ndimage.label(free)[0][::2, ::2].astype(np.int64)
    models = int(label.max()) + 1
    key, count = np.unique(regions * models + label, return_counts=True)
    region, model = key // models, key % models
    order = np.lexsort((model, -count, region))
    first = np.unique(region[order], return_index=True)[1]
    table = np.zeros(int(regions.max()) + 1, np.int32)
    table[region[order][first]] = model[order][first]
    return table[regions]
