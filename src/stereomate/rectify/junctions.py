"""Where three seams meet: each junction moves to where the three ways to it cost least together.

In a square around a junction, the cost of a step is that of the worst of its three pairs of models. From
the places where the seams enter, the cheapest ways to every corner are found; the corner with the least sum
is the new junction. The ways to it cannot share a step: else their fork would have a smaller sum.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.raster import Window
from stereomate.rectify.arcs import Arc, cheapest, step_graph, walk
from stereomate.rectify.disagreement import disagreement
from stereomate.rectify.layout import StereoModel
from stereomate.rectify.overviews import Overviews

Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]
Labels = NDArray[np.int32]

# A junction moves by less than this share of what a seam may move.
_REACH_SHARE: Final = 1.0


@dataclass(frozen=True)
class _End:
    """An end of a seam at a junction."""

    arc: int
    is_last: bool


def moved_junctions(
    overviews: Overviews,
    models: tuple[StereoModel, ...],
    arcs: list[Arc],
    zones: Labels,
    reach: float,
    scale: float,
) -> list[Arc]:
    """The seams with their junctions moved, one junction after the other.

    Parameters
    ----------
    zones : (rows + 1, cols + 1)
        Per corner of cells the number of the nearest seam.
    reach : float
        What a seam may move, cells.
    """
    ends: dict[tuple[int, int], list[_End]] = {}
    for k, arc in enumerate(arcs):
        for is_last in (False, True):
            col, row = arc.vertices[-1 if is_last else 0].tolist()
            ends.setdefault((row, col), []).append(_End(k, is_last))
    arcs = list(arcs)
    radius = int(_REACH_SHARE * reach)
    taken = np.zeros(zones.shape, np.bool_)
    for arc in arcs:
        taken[arc.vertices[:, 1], arc.vertices[:, 0]] = True
    for place in sorted(ends):
        meeting = ends[place]
        if len(meeting) == 3 and len({end.arc for end in meeting}) == 3:
            _move(overviews, models, arcs, (zones, taken), (place, meeting, radius), scale)
    return arcs


def _move(
    overviews: Overviews,
    models: tuple[StereoModel, ...],
    arcs: list[Arc],
    corners: tuple[Labels, Bools],
    junction: tuple[tuple[int, int], list[_End], int],
    scale: float,
) -> None:
    (row, col), meeting, radius = junction
    zones, taken = corners
    rows, cols = overviews.shape
    chains = [arcs[e.arc].vertices[::-1] if e.is_last else arcs[e.arc].vertices for e in meeting]
    # Near ends belong to this junction, far ones to the next.
    lengths = [min(radius, (len(chain) - 1) // 2) for chain in chains]
    if min(lengths) < 1:
        return
    near = [chain[: n + 1] for chain, n in zip(chains, lengths, strict=True)]
    window = _window(np.concatenate(near), radius, (row, col), (rows, cols))
    labels = sorted({label for e in meeting for label in arcs[e.arc].labels})
    cost, passable = np.zeros((window.rows, window.cols), np.float32), None
    for a, b in itertools.combinations(labels, 2):
        both = disagreement(overviews, models[a], models[b], window, scale)
        cost = np.maximum(cost, both.cost)
        shown = both.first & both.second
        passable = shown if passable is None else passable & shown
    assert passable is not None
    first = np.array([window.col0, window.row0])
    for way in near:
        taken[way[:, 1], way[:, 0]] = False
    at = (slice(window.row0, window.row1 + 1), slice(window.col0, window.col1 + 1))
    # Corners of other seams, and of the rest of these, stay theirs: nothing crosses.
    mine = np.isin(zones[at], [e.arc for e in meeting]) & ~taken[at]
    graph = step_graph(cost, passable, mine, [chain - first for chain in near])
    number = [int(v[1] * (window.cols + 1) + v[0]) for v in (chain[-1] - first for chain in near)]
    total = np.sum([cheapest(graph, start)[0] for start in number], axis=0)
    best = int(np.argmin(total))
    before = cheapest(graph, best)[1]
    for end, chain, n, start in zip(meeting, chains, lengths, number, strict=True):
        way = walk(before, best, start, window.cols + 1) + first
        taken[way[:, 1], way[:, 0]] = True
        whole = np.concatenate([way, chain[n + 1 :]])
        arcs[end.arc] = replace(arcs[end.arc], vertices=whole[::-1] if end.is_last else whole)


def _window(vertices: Ints, radius: int, place: tuple[int, int], shape: tuple[int, int]) -> Window:
    """The square around a junction, widened to hold the ends of the ways to it."""
    low = np.minimum(vertices.min(axis=0), [place[1] - radius, place[0] - radius])
    high = np.maximum(vertices.max(axis=0), [place[1] + radius, place[0] + radius])
    col0, row0 = np.maximum(low, 0).tolist()
    col1, row1 = np.minimum(high, [shape[1], shape[0]]).tolist()
    return Window(col0, row0, col1 - col0, row1 - row0)
