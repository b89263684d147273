"""Seams as least-cost paths on the coarse grid.

The regions of the best models give the first seams: lines between cells, meeting at junctions. Junctions
move to where they cost least (`rectify.junctions`); then each line moves, between its ends, to the cheapest
path in its own strip of ground (the places nearer to it than to any other seam, not too far from it, which
both models show), so no two of them ever cross.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy  # its parts load when they are used
from numpy.typing import NDArray

from stereomate.raster import Window
from stereomate.rectify.arcs import Arc, cheapest, seam_arcs, step_graph, walk
from stereomate.rectify.disagreement import disagreement
from stereomate.rectify.junctions import moved_junctions
from stereomate.rectify.layout import StereoModel, of_one_kind
from stereomate.rectify.overviews import Overviews
from stereomate.tiles import Threads, map_items

Floats32 = NDArray[np.float32]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]
Labels = NDArray[np.int32]

# A seam moves by less than this share of the root of a median region's area.
REACH: Final = 0.35
# Junctions and seams move in turn so many times: a junction between short seams gets out step by step.
ROUNDS: Final = 3
# Cost of a step at the whole reach from the first seam, beside its own.
_AWAY: Final = 0.3


def improved_regions(
    overviews: Overviews,
    models: tuple[StereoModel, ...],
    label: Labels,
    scale: float,
    threads: Threads | None = None,
) -> Labels:
    """Regions with their seams on least-cost paths.

    Parameters
    ----------
    label : (rows, cols)
        A model in every cell.
    threads : Threads, optional
        What the lines are found on, each for itself; one thread without.
    """
    if (label == label[0, 0]).all():
        return label
    sizes = np.bincount(label.ravel())
    reach = max(4.0, REACH * float(np.sqrt(np.median(sizes[sizes > 0]))))
    for _ in range(ROUNDS):
        arcs = seam_arcs(label)
        zones, distance = _zones(arcs, label.shape, reach)
        label = _regions_between(moved_junctions(overviews, models, arcs, zones, reach, scale), label)
        arcs = seam_arcs(label)
        zones, distance = _zones(arcs, label.shape, reach)
        line = _Line(overviews, models, (zones, distance, reach), scale)
        label = _regions_between(map_items(line, list(enumerate(arcs)), threads), label)
    return label


def _zones(arcs: list[Arc], shape: tuple[int, int], reach: float) -> tuple[Labels, Floats32]:
    """Per corner the nearest seam (-1 beyond its reach), and the distance to it in cells."""
    nearest = np.full((shape[0] + 1, shape[1] + 1), -1, np.int32)
    for k, arc in enumerate(arcs):
        nearest[arc.vertices[:, 1], arc.vertices[:, 0]] = k
    distance, index = scipy.ndimage.distance_transform_edt(nearest < 0, return_indices=True)
    zones = nearest[index[0], index[1]]
    zones[distance > reach] = -1
    return np.ascontiguousarray(zones), distance.astype(np.float32)


@dataclass(frozen=True, eq=False)
class _Line:
    """Moves one seam between its ends."""

    overviews: Overviews
    models: tuple[StereoModel, ...]
    surroundings: tuple[Labels, Floats32, float]
    scale: float

    def __call__(self, numbered: tuple[int, Arc]) -> Arc:
        """The seam of this number on its least-cost path."""
        number, arc = numbered
        zones, distance, reach = self.surroundings
        models = self.models[arc.labels[0]], self.models[arc.labels[1]]
        ends = arc.vertices[0], arc.vertices[-1]
        if len(arc.vertices) < 3 or (ends[0] == ends[1]).all() or not of_one_kind(models):
            return arc
        rows, cols = self.overviews.shape
        pad = int(reach) + 2
        col0, row0 = np.maximum(arc.vertices.min(axis=0) - pad, 0).tolist()
        col1, row1 = np.minimum(arc.vertices.max(axis=0) + pad, (cols, rows)).tolist()
        window = Window(col0, row0, col1 - col0, row1 - row0)
        both = disagreement(self.overviews, *models, window, self.scale)
        passable = (both.first & both.second) | ~(both.first | both.second)
        corners = (slice(row0, row1 + 1), slice(col0, col1 + 1))
        mine = zones[corners] == number
        own = arc.vertices - [col0, row0]
        mine[own[:, 1], own[:, 0]] = True
        away = distance[corners] * np.float32(_AWAY / reach)
        graph = step_graph(both.cost, passable, mine, [own], away)
        width = window.cols + 1
        start, end = (int(v[1] * width + v[0]) for v in (own[0], own[-1]))
        total, before = cheapest(graph, start)
        if not np.isfinite(total[end]):
            return arc
        way = walk(before, start, end, width)
        return Arc(way + np.array([col0, row0]), arc.labels)


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
