"""Tie points of a block from matches of pairs: who is the same point, and which of them are kept.

Matches are joined best first; a match that would put one photograph's two points into one tie point
contradicts those before it and is left out (and counted). Of the joined points those are kept that serve the
geometry: first around the standard positions of von Gruber in every photograph, then evenly over the rest,
points in many photographs before those in few.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import InputError

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

# Half the distance between neighbouring standard positions, of the photograph's side.
_GRUBER_RADIUS: Final = 0.14
_GRUBER_PLACES: Final = (0.12, 0.5, 0.88)


@dataclass(frozen=True)
class TiePoints:
    """Image observations of tie points, sorted by point and photograph.

    Parameters
    ----------
    photographs : tuple of str
        Names; `photo` counts them from 0.
    point, photo : ndarray of int, shape (m,)
        Numbers of the tie point and of the photograph of every observation.
    pixels : ndarray, shape (m, 2)
        Column and row.
    sigma_px : ndarray, shape (m,)
        Standard deviation of a coordinate.
    feature : ndarray of int, shape (m,)
        Row of the feature it came from; -1 for none.
    """

    photographs: tuple[str, ...]
    point: Integers
    photo: Integers
    pixels: Array
    sigma_px: Array
    feature: Integers

    def __post_init__(self) -> None:
        m = len(self.point)
        for name, shape in (
            ("photo", (m,)),
            ("pixels", (m, 2)),
            ("sigma_px", (m,)),
            ("feature", (m,)),
        ):
            if np.shape(getattr(self, name)) != shape:
                raise InputError(f"must have shape {shape}", field=name, value=np.shape(getattr(self, name)))

    def __len__(self) -> int:
        return len(self.point)

    @property
    def count(self) -> int:
        """Number of different tie points."""
        return len(np.unique(self.point))

    def select(self, rows: NDArray[Any]) -> TiePoints:
        """Some of the observations (indices or a mask)."""
        return TiePoints(
            self.photographs,
            self.point[rows],
            self.photo[rows],
            self.pixels[rows],
            self.sigma_px[rows],
            self.feature[rows],
        )

    def numbered(self) -> TiePoints:
        """The same with points counted from 0 without gaps."""
        _, number = np.unique(self.point, return_inverse=True)
        return TiePoints(
            self.photographs,
            number.astype(np.int64),
            self.photo,
            self.pixels,
            self.sigma_px,
            self.feature,
        )

    def rays(self) -> Integers:
        """How many photographs see the point of each observation, shape (m,)."""
        _, number, counts = np.unique(self.point, return_inverse=True, return_counts=True)
        rays: Integers = counts[number].astype(np.int64)
        return rays

    def with_rays(self, least: int) -> TiePoints:
        """Without points seen in fewer photographs."""
        return self.select(self.rays() >= least)


@dataclass(frozen=True)
class PairMatches:
    """Agreeing matches of two photographs: rows of their features, and a quality (smaller is better)."""

    first: int
    second: int
    rows: Integers
    quality: Array


@dataclass(frozen=True)
class Tracks:
    """Joined matches, and how many contradicted others.

    Attributes
    ----------
    point, photo, feature : ndarray of int, shape (m,)
        Of every observation, sorted by point and photograph.
    contradictions : int
        Matches left out because they would put two points of one photograph into one.
    """

    point: Integers
    photo: Integers
    feature: Integers
    contradictions: int


def join_matches(pairs: Sequence[PairMatches]) -> Tracks:
    """Join the matches of all pairs into points, best first, without contradictions."""
    if not pairs:
        none = np.empty(0, dtype=np.int64)
        return Tracks(none, none, none, 0)
    photo = np.concatenate([np.repeat([[p.first, p.second]], len(p.rows), axis=0) for p in pairs])
    feature = np.concatenate([p.rows for p in pairs]).astype(np.int64).reshape(-1, 2)
    quality = np.concatenate([p.quality for p in pairs])
    order = np.lexsort((feature[:, 1], feature[:, 0], photo[:, 1], photo[:, 0], quality))
    largest = int(feature.max(initial=0)) + 1
    nodes, ends = np.unique((photo * largest + feature).reshape(-1), return_inverse=True)
    ends = ends.reshape(-1, 2)
    root, contradictions = _joined(nodes // largest, ends[order])
    point = np.unique(root, return_inverse=True)[1].astype(np.int64)
    rows = np.lexsort((nodes // largest, point))
    return Tracks(point[rows], nodes[rows] // largest, nodes[rows] % largest, contradictions)


def _joined(photo: Integers, ends: Integers) -> tuple[Integers, int]:
    """Union-find: the representative of every node, and the number of joins refused."""
    parent = list(range(len(photo)))
    members: list[set[int]] = [{int(p)} for p in photo]
    refused = 0

    def find(node: int) -> int:
        while parent[node] != node:
            parent[node] = parent[parent[node]]
            node = parent[node]
        return node

    for a, b in ends.tolist():
        one, other = find(a), find(b)
        if one == other:
            continue
        if len(members[one]) < len(members[other]):
            one, other = other, one
        if not members[one].isdisjoint(members[other]):
            refused += 1
            continue
        parent[other] = one
        members[one] |= members[other]
        members[other] = set()
    return np.array([find(node) for node in range(len(photo))], dtype=np.int64), refused


@dataclass(frozen=True)
class ThinningOptions:
    """How many tie points are kept.

    Parameters
    ----------
    per_photo : int
        Points wanted in every photograph.
    per_place : int
        Of these, at each of the nine standard positions first.
    cells : int
        Cells along the longer side of a photograph among which the rest is spread.
    """

    per_photo: int = 400
    per_place: int = 6
    cells: int = 12

    def __post_init__(self) -> None:
        if min(self.per_photo, self.per_place, self.cells) < 1:
            raise InputError("must be at least 1", field="per_photo, per_place, cells")


def thin(points: TiePoints, sizes_px: Mapping[int, tuple[int, int]], options: ThinningOptions) -> TiePoints:
    """Keep tie points that are well spread over every photograph.

    Parameters
    ----------
    points : TiePoints
    sizes_px : mapping
        Columns and rows of every photograph, by its number in `points`.
    options : ThinningOptions

    Returns
    -------
    TiePoints
        Whole points only, numbered anew from 0.
    """
    if not len(points):
        return points
    points = points.numbered()
    count = int(points.point[-1]) + 1
    starts = np.searchsorted(points.point, np.arange(count + 1))
    rays = np.diff(starts)
    sigma = np.add.reduceat(points.sigma_px, starts[:-1]) / rays
    # Many rays first, then the sharper; the number itself makes the order one and the same always.
    order = np.lexsort((np.arange(count), sigma, -rays))
    place = _gruber_place(points, sizes_px)
    cell, cells = _cell(points, sizes_px, options.cells)
    kept = np.zeros(count, dtype=np.bool_)
    _fill(order, starts, points.photo, place, 9, options.per_place, options.per_photo, kept)
    for quota in (1, 2, 4, 8, 16, 32, 64, 1 << 40):
        _fill(order, starts, points.photo, cell, cells, quota, options.per_photo, kept)
    return points.select(kept[points.point]).numbered()


def _gruber_place(points: TiePoints, sizes_px: Mapping[int, tuple[int, int]]) -> Integers:
    """Number (0-8) of the standard position a point of a photograph is near; -1 for none."""
    sizes = np.array([sizes_px[int(k)] for k in range(len(points.photographs))], dtype=np.float64)
    share = points.pixels / sizes[points.photo]
    places = np.array(_GRUBER_PLACES)
    distance = np.abs(share[:, :, None] - places)
    nearest = distance.argmin(axis=2)
    near = (distance.min(axis=2) <= _GRUBER_RADIUS).all(axis=1)
    return np.where(near, nearest[:, 1] * 3 + nearest[:, 0], -1).astype(np.int64)


def _cell(points: TiePoints, sizes_px: Mapping[int, tuple[int, int]], cells: int) -> tuple[Integers, int]:
    sizes = np.array([sizes_px[int(k)] for k in range(len(points.photographs))], dtype=np.float64)
    side = sizes.max(axis=1)[points.photo, None] / cells
    number = np.clip((points.pixels / side).astype(np.int64), 0, cells - 1)
    return number[:, 1] * cells + number[:, 0], cells * cells


def _fill(
    order: Integers,
    starts: Integers,
    photo: Integers,
    cell: Integers,
    cells: int,
    quota: int,
    per_photo: int,
    kept: NDArray[np.bool_],
) -> None:
    """Take points in order while one of their photographs has room in the cell, and overall."""
    photos = int(photo.max()) + 1
    in_cell = np.zeros((photos, cells), dtype=np.int64)
    in_photo = np.zeros(photos, dtype=np.int64)
    for point in np.flatnonzero(kept).tolist():
        for row in range(starts[point], starts[point + 1]):
            in_photo[photo[row]] += 1
            if cell[row] >= 0:
                in_cell[photo[row], cell[row]] += 1
    for point in order.tolist():
        if kept[point]:
            continue
        rows = range(starts[point], starts[point + 1])
        wanted = any(
            cell[row] >= 0 and in_cell[photo[row], cell[row]] < quota and in_photo[photo[row]] < per_photo
            for row in rows
        )
        if not wanted:
            continue
        kept[point] = True
        for row in rows:
            in_photo[photo[row]] += 1
            if cell[row] >= 0:
                in_cell[photo[row], cell[row]] += 1
