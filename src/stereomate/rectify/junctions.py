"""Where seams meet: each junction moves to where the ways to it cost least together.

In a square around a junction, the cost of a step is that of the worst pair of its models. From the places
where the seams enter, the cheapest ways to every corner are found; the corner with the least sum is the new
junction. Three ways cannot share a step: else their fork would have a smaller sum. Two junctions close to
each other move as one with four ways; two of these may share their first steps, which then are the seam
between the other two models.
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
from stereomate.rectify.layout import StereoModel, of_one_kind
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


@dataclass(frozen=True)
class _Junction:
    """Ends that meet, and the short seam between two places that are taken for one."""

    ends: tuple[_End, ...]
    inner: int | None


def moved_junctions(
    overviews: Overviews,
    models: tuple[StereoModel, ...],
    arcs: list[Arc],
    zones: Labels,
    reach: float,
    scale: float,
) -> list[Arc]:
    """The seams with their junctions moved, one junction after the other; some may share steps, or have none.

    Parameters
    ----------
    zones : (rows + 1, cols + 1)
        Per corner of cells the number of the nearest seam.
    reach : float
        What a seam may move, cells.
    """
    radius = int(_REACH_SHARE * reach)
    arcs = list(arcs)
    taken = np.zeros(zones.shape, np.bool_)
    for arc in arcs:
        taken[arc.vertices[:, 1], arc.vertices[:, 0]] = True
    for junction in _junctions(arcs, radius):
        meeting = [models[label] for end in junction.ends for label in arcs[end.arc].labels]
        distinct = len({end.arc for end in junction.ends}) == len(junction.ends)
        if 3 <= len(junction.ends) <= 4 and distinct and of_one_kind(meeting):
            _move(overviews, models, arcs, (zones, taken), (junction, radius), scale)
    return arcs


def _junctions(arcs: list[Arc], radius: int) -> list[_Junction]:
    """Places where seams meet; two of them with a seam shorter than `radius` between them are one."""
    ends: dict[tuple[int, int], list[_End]] = {}
    for k, arc in enumerate(arcs):
        for is_last in (False, True):
            col, row = arc.vertices[-1 if is_last else 0].tolist()
            ends.setdefault((row, col), []).append(_End(k, is_last))
    ends = {place: found for place, found in ends.items() if len(found) >= 3}
    joined: dict[tuple[int, int], tuple[int, int]] = {}
    inner: dict[tuple[int, int], int] = {}
    for k in sorted(range(len(arcs)), key=lambda k: len(arcs[k].vertices)):
        (c0, r0), (c1, r1) = arcs[k].vertices[0].tolist(), arcs[k].vertices[-1].tolist()
        a, b = (r0, c0), (r1, c1)
        free = a in ends and b in ends and a != b and not ({a, b} & (joined.keys() | inner.keys()))
        if free and len(arcs[k].vertices) - 1 < radius:
            joined[b], inner[a] = a, k
    found = []
    for place in sorted(ends):
        if place in joined:
            continue
        others = [b for b, a in joined.items() if a == place]
        meeting = [end for at in (place, *others) for end in ends[at] if end.arc != inner.get(place)]
        found.append(_Junction(tuple(meeting), inner.get(place)))
    return found


def _move(
    overviews: Overviews,
    models: tuple[StereoModel, ...],
    arcs: list[Arc],
    corners: tuple[Labels, Bools],
    what: tuple[_Junction, int],
    scale: float,
) -> None:
    junction, radius = what
    meeting = junction.ends
    zones, taken = corners
    rows, cols = overviews.shape
    chains = [arcs[e.arc].vertices[::-1] if e.is_last else arcs[e.arc].vertices for e in meeting]
    # Near ends belong to this junction, far ones to the next.
    lengths = [min(radius, (len(chain) - 1) // 2) for chain in chains]
    if min(lengths) < 1:
        return
    near = [chain[: n + 1] for chain, n in zip(chains, lengths, strict=True)]
    way_between = [] if junction.inner is None else [arcs[junction.inner].vertices]
    window = _window(np.concatenate(near + way_between), radius, chains[0][0], (rows, cols))
    labels = sorted({label for e in meeting for label in arcs[e.arc].labels})
    cost, passable = np.zeros((window.rows, window.cols), np.float32), None
    for a, b in itertools.combinations(labels, 2):
        both = disagreement(overviews, models[a], models[b], window, scale)
        cost = np.maximum(cost, both.cost)
        shown = both.first & both.second
        passable = shown if passable is None else passable & shown
    assert passable is not None
    first = np.array([window.col0, window.row0])
    for way in near + way_between:
        taken[way[:, 1], way[:, 0]] = False
    at = (slice(window.row0, window.row1 + 1), slice(window.col0, window.col1 + 1))
    # Corners of other seams, and of the rest of these, stay theirs: nothing crosses.
    mine = np.isin(zones[at], [e.arc for e in meeting]) & ~taken[at]
    graph = step_graph(cost, passable, mine, [chain - first for chain in near + way_between])
    number = [int(v[1] * (window.cols + 1) + v[0]) for v in (chain[-1] - first for chain in near)]
    total = np.sum([cheapest(graph, start)[0] for start in number], axis=0)
    best = int(np.argmin(total))
    if not np.isfinite(total[best]):
        for way in near + way_between:
            taken[way[:, 1], way[:, 0]] = True
        return
    before = cheapest(graph, best)[1]
    for end, chain, n, start in zip(meeting, chains, lengths, number, strict=True):
        way = walk(before, best, start, window.cols + 1) + first
        taken[way[:, 1], way[:, 0]] = True
        whole = np.concatenate([way, chain[n + 1 :]])
        arcs[end.arc] = replace(arcs[end.arc], vertices=whole[::-1] if end.is_last else whole)
    if junction.inner is not None:
        middle = np.array([[best % (window.cols + 1), best // (window.cols + 1)]]) + first
        arcs[junction.inner] = replace(arcs[junction.inner], vertices=middle)


def _window(vertices: Ints, radius: int, place: Ints, shape: tuple[int, int]) -> Window:
    """The square around a junction, widened to hold the ways to it with the cells on both sides of them.

    Of two junctions that move as one, the ways to the second may run along the edge of what holds their
    corners alone, where a step has no cell on one side.
    """
    low = np.minimum(vertices.min(axis=0) - 1, place - radius)
    high = np.maximum(vertices.max(axis=0) + 1, place + radius)
    col0, row0 = np.maximum(low, 0).tolist()
    col1, row1 = np.minimum(high, [shape[1], shape[0]]).tolist()
    return Window(col0, row0, col1 - col0, row1 - row0)
