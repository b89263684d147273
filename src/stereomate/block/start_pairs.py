"""Which photographs of a block are compared with each other.

From footprints on level ground where positions and attitudes are known, from the reach of the photographs
where only positions are, each with each in a small block, and else by a first look at a few strong features.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import shapely
import shapely.affinity
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from stereomate.camera.model import Camera
from stereomate.errors import InputError
from stereomate.measurement.features import Features
from stereomate.measurement.matching import MatchOptions, match_features

Array = NDArray[np.float64]
Pair = tuple[int, int]

# A ray flatter than this to the horizon is cut: footprints of oblique photographs are finite.
_FLATTEST: Final = 0.17
_FEW: Final = 200
_FEW_MATCHES: Final = MatchOptions(ratio=0.85)


@dataclass(frozen=True)
class PairOptions:
    """How pairs are chosen.

    Parameters
    ----------
    exhaustive : int
        In blocks of up to so many photographs without positions each is compared with each.
    least_overlap : float
        Of the smaller footprint, from positions and attitudes as they are known beforehand.
    margin : float
        By what part footprints are made larger, for the errors of positions and attitudes.
    neighbours : int
        Nearest photographs compared where nothing tells how much ground one covers.
    least_matches : int
        Of the first look at a few features.
    """

    exhaustive: int = 40
    least_overlap: float = 0.1
    margin: float = 0.15
    neighbours: int = 14
    least_matches: int = 5

    def __post_init__(self) -> None:
        if self.neighbours < 2 or self.least_matches < 1:
            raise InputError("must be at least 2 neighbours and 1 match", field="neighbours, least_matches")
        if not (0.0 <= self.least_overlap < 1.0 and self.margin >= 0.0):
            raise InputError("must be 0 to 1, and margin not negative", field="least_overlap, margin")


@dataclass(frozen=True)
class Approximation:
    """What is known of the photographs of a block beforehand; NaN where nothing is.

    Parameters
    ----------
    centres : ndarray, shape (n, 3)
        In the tangent frame.
    object_from_camera : ndarray, shape (n, 3, 3)
    ground : float or None
        Height of the ground in the tangent frame.
    """

    centres: Array
    object_from_camera: Array
    ground: float | None = None

    @property
    def has_centre(self) -> NDArray[np.bool_]:
        """Photographs with a position, shape (n,)."""
        return np.asarray(np.isfinite(self.centres).all(axis=1))

    @property
    def has_attitude(self) -> NDArray[np.bool_]:
        """Photographs with an attitude, shape (n,)."""
        return np.asarray(np.isfinite(self.object_from_camera).all(axis=(1, 2)))


@dataclass(frozen=True)
class PairSelection:
    """Pairs to compare (each with the smaller index first, sorted), and in words how they were chosen."""

    pairs: tuple[Pair, ...]
    how: str


def select_pairs(
    cameras: Sequence[Camera],
    known: Approximation,
    options: PairOptions | None = None,
) -> PairSelection | None:
    """Choose pairs from what is known beforehand.

    Returns
    -------
    PairSelection or None
        None where only a first look at the photographs can tell: `pairs_by_first_look`.
    """
    options = options or PairOptions()
    n = len(cameras)
    everything = tuple(itertools.combinations(range(n), 2))
    placed = known.has_centre
    if placed.all() and known.has_attitude.all() and known.ground is not None:
        return _by_footprints(cameras, known, known.ground, options)
    if n <= options.exhaustive:
        return PairSelection(everything, f"each with each of {n} photographs")
    if not placed.any():
        return None
    pairs = _by_distance(cameras, known, options)
    # A photograph without position may lie anywhere.
    for k in np.flatnonzero(~placed).tolist():
        pairs |= {(min(k, other), max(k, other)) for other in range(n) if other != k}
    return PairSelection(tuple(sorted(pairs)), "by the distance of the projection centres")


def pairs_by_first_look(
    features: Sequence[Features],
    options: PairOptions | None = None,
    among: Collection[int] | None = None,
) -> PairSelection:
    """Pairs whose few largest features match in several places (C. Wu 2013, preemptive matching).

    With `among`, those alone that one of these photographs belongs to.
    """
    options = options or PairOptions()
    few = []
    for found in features:
        order = np.argsort(-found.size_px, kind="stable")[:_FEW]
        few.append(found.select(np.sort(order)))
    pairs = [
        (i, j)
        for i, j in itertools.combinations(range(len(few)), 2)
        if (among is None or i in among or j in among)
        and len(match_features(few[i], few[j], _FEW_MATCHES)) >= options.least_matches
    ]
    return PairSelection(tuple(pairs), f"by a first look at the {_FEW} largest features of each photograph")


def _by_footprints(
    cameras: Sequence[Camera], known: Approximation, ground: float, options: PairOptions
) -> PairSelection:
    prints = []
    for camera, centre, rotation in zip(cameras, known.centres, known.object_from_camera, strict=True):
        polygon = level_footprint(camera, centre, rotation, ground)
        prints.append(shapely.affinity.scale(polygon, 1.0 + options.margin, 1.0 + options.margin))
    areas = shapely.area(prints)
    tree = shapely.STRtree(prints)
    first, second = tree.query(prints, predicate="intersects")
    pairs = []
    for i, j in sorted(zip(first.tolist(), second.tolist(), strict=True)):
        if i >= j:
            continue
        smaller = min(areas[i], areas[j])
        shared = float(prints[i].intersection(prints[j]).area)
        if smaller > 0.0 and shared / smaller >= options.least_overlap:
            pairs.append((i, j))
    return PairSelection(
        tuple(pairs), f"footprints that overlap by {options.least_overlap:.0%} or more, of known orientations"
    )


def level_footprint(camera: Camera, centre: Array, rotation: Array, ground: float) -> shapely.Polygon:
    """What a photograph shows of level ground; rays near or above the horizon are cut short."""
    share = np.linspace(0.0, 1.0, 5)[:-1]
    zero, one = np.zeros(4), np.ones(4)
    border = np.concatenate(
        [np.column_stack(side) for side in ((share, zero), (one, share), (1 - share, one), (zero, 1 - share))]
    )
    rays = camera.rays_from_image(camera.picture_px(border))
    rays = np.where(np.isfinite(rays), rays, 0.0) @ rotation.T
    rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-12)
    height = max(float(centre[2]) - ground, 1e-6)
    distance = height / np.maximum(-rays[:, 2], _FLATTEST)
    return shapely.MultiPoint(centre[:2] + distance[:, None] * rays[:, :2]).convex_hull


def _by_distance(cameras: Sequence[Camera], known: Approximation, options: PairOptions) -> set[Pair]:
    rows = np.flatnonzero(known.has_centre)
    centres = known.centres[rows]
    if known.ground is None:
        count = min(options.neighbours + 1, len(rows))
        _, nearest = cKDTree(centres[:, :2]).query(centres[:, :2], count)
        lines = np.asarray(nearest).reshape(len(rows), -1).tolist()
        ends = [(int(rows[k]), int(rows[j])) for k, line in enumerate(lines) for j in line if j != k]
        return {(min(pair), max(pair)) for pair in ends}
    reach = np.array(
        [
            _half_angle_tangent(cameras[k]) * max(known.centres[k, 2] - known.ground, 0.0)
            for k in rows.tolist()
        ]
    )
    reach *= 1.0 + options.margin
    found = cKDTree(centres[:, :2]).query_pairs(2.0 * float(reach.max()), output_type="ndarray")
    apart = np.linalg.norm(centres[found[:, 0], :2] - centres[found[:, 1], :2], axis=1)
    near = found[apart <= reach[found[:, 0]] + reach[found[:, 1]]]
    return {(int(min(rows[a], rows[b])), int(max(rows[a], rows[b]))) for a, b in near}


def _half_angle_tangent(camera: Camera) -> float:
    """Tangent of half the field of view along the diagonal."""
    corners = camera.rays_from_image(camera.picture_px([[0, 0], [1, 0], [0, 1], [1, 1]]))
    radius = np.linalg.norm(corners[:, :2], axis=1)
    return float(np.nanmax(radius)) if np.isfinite(radius).any() else 1.0
