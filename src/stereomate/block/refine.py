"""Tie points measured again by least-squares matching in the full photographs.

Every point has one reference photograph, where its window lies on whole pixels; in all others it is measured
against that window, deformed as the oriented photographs say. So the measurements of one point agree, however
many photographs see it. Work goes photograph by photograph, and what is finished is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from stereomate.block.photos import BlockPhoto, grey_of_photo
from stereomate.measurement.database import MeasurementDatabase
from stereomate.measurement.least_squares_matching import LeastSquaresOptions, match_least_squares
from stereomate.measurement.tracks import TiePoints
from stereomate.tiles import Executor, map_items
from stereomate.tiles.ledger import run_key

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

# What least-squares matching does not know of its own errors: relief in the window, aliasing, the lens.
_FLOOR_PX: Final = 0.08
_REFERENCE_SIGMA_PX: Final = 0.08


@dataclass(frozen=True)
class RefineOptions:
    """How points are measured again.

    Parameters
    ----------
    least_squares : LeastSquaresOptions
    kept : int
        Photographs held in memory at a time.
    """

    least_squares: LeastSquaresOptions = field(
        default_factory=lambda: LeastSquaresOptions(radius_px=8, largest_way_px=6.0, least_correlation=0.75)
    )
    kept: int = 8


@dataclass(frozen=True)
class OrientedPoints:
    """Orientation of the photographs and the tie points in one frame, as far as they are known.

    Parameters
    ----------
    centres, rotations : ndarray, shape (n, 3) and (n, 3, 3)
    points : ndarray, shape (k, 3)
    """

    centres: Array
    rotations: Array
    points: Array


def measure_again(
    database: MeasurementDatabase,
    photos: Sequence[BlockPhoto],
    points: TiePoints,
    oriented: OrientedPoints,
    options: RefineOptions | None = None,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[TiePoints, dict[str, int]]:
    """Tie points with refined positions; observations that could not be measured are left out.

    Returns
    -------
    points : TiePoints
        Points of two rays or more, numbered as before.
    counts : dict
        Observations measured, and failures by reason.
    """
    options = options or RefineOptions()
    reference = _references(points, photos, oriented)
    groups = _groups(points, reference)
    done = database.done("measured")
    key = run_key(
        options=repr(options.least_squares),
        points=_digest(points),
        oriented=_rounded(oriented),
    )
    todo = [group for group in groups if done.get(str(group), ("", {}))[0] != key]
    images = _Images(photos, options.kept)
    count = len(groups) - len(todo)

    def work(first: int) -> None:
        nonlocal count
        record = _measure_group(first, groups[first], points, reference, photos, oriented, images, options)
        database.set_done("measured", str(first), key, record)
        count += 1
        if progress is not None:
            progress(count, len(groups))

    if progress is not None:
        progress(count, len(groups))
    map_items(work, todo, executor)
    return _collected(points, reference, groups, database.done("measured"))


def _digest(points: TiePoints) -> str:
    return run_key(point=points.point.tolist(), photo=points.photo.tolist(), pixels=points.pixels.tolist())


def _rounded(oriented: OrientedPoints) -> str:
    """Differences of rounding between machines do not make measured points stale."""
    return run_key(
        centres=np.round(np.nan_to_num(oriented.centres), 2).tolist(),
        rotations=np.round(np.nan_to_num(oriented.rotations), 3).tolist(),
    )


def _references(points: TiePoints, photos: Sequence[BlockPhoto], oriented: OrientedPoints) -> Integers:
    """Row of the reference observation of every point: the one nearest to its photograph's middle."""
    sizes = np.array([photo.camera.size_px for photo in photos], dtype=np.float64)
    away = np.linalg.norm(points.pixels / sizes[points.photo] - 0.5, axis=1)
    away[~np.isfinite(oriented.centres[points.photo, 0])] = np.inf
    order = np.lexsort((points.photo, np.round(away, 6), points.point))
    count = int(points.point.max()) + 1 if len(points) else 0
    reference = np.full(count, -1, dtype=np.int64)
    numbers, first = np.unique(points.point[order], return_index=True)
    reference[numbers] = order[first]
    # Points that are not determined have no depth to deform a window with.
    known = np.isfinite(oriented.points[:count, 0]) & (reference >= 0)
    reference[~known] = -1
    return reference


def _groups(points: TiePoints, reference: Integers) -> dict[int, Integers]:
    """Rows to measure, by the photograph of their reference."""
    of_row = reference[points.point]
    rows = np.flatnonzero((of_row >= 0) & (of_row != np.arange(len(points))))
    photo = points.photo[of_row[rows]]
    return {int(k): rows[photo == k] for k in np.unique(photo)}


def _measure_group(
    first: int,
    rows: Integers,
    points: TiePoints,
    reference: Integers,
    photos: Sequence[BlockPhoto],
    oriented: OrientedPoints,
    images: _Images,
    options: RefineOptions,
) -> dict[str, Any]:
    """Measure all points whose reference lies in one photograph."""
    record: dict[str, Any] = {"rows": [], "left": [], "right": [], "sigma": [], "failures": {}}
    for other in np.unique(points.photo[rows]).tolist():
        mine = rows[points.photo[rows] == other]
        if not np.isfinite(oriented.centres[other, 0]):
            continue
        here = points.pixels[reference[points.point[mine]]]
        there, affine = _predicted(photos, oriented, first, other, here, points.point[mine])
        start = np.where(np.isfinite(there), points.pixels[mine], np.nan)
        found = match_least_squares(
            images.of(first), images.of(other), here, start, affine, options.least_squares
        )
        good = np.flatnonzero(found.matched)
        variance = 0.5 * (found.covariance_px[good, 0] + found.covariance_px[good, 2])
        record["rows"] += mine[good].tolist()
        record["left"] += np.round(found.left_px[good], 1).tolist()
        record["right"] += np.round(found.right_px[good], 5).tolist()
        record["sigma"] += np.round(np.sqrt(variance + _FLOOR_PX**2), 4).tolist()
        for reason, count in found.failures().items():
            record["failures"][reason] = record["failures"].get(reason, 0) + count
    return record


def _predicted(
    photos: Sequence[BlockPhoto],
    oriented: OrientedPoints,
    first: int,
    other: int,
    pixels: Array,
    point: Integers,
) -> tuple[Array, Array]:
    """Where points of one photograph lie in another, and how small windows are deformed between them.

    The ground is taken as level around each point: three rays of neighbouring pixels meet it and are seen
    from the other photograph.
    """
    camera, second = photos[first].camera, photos[other].camera
    height = oriented.points[point, 2]
    centre, turn = oriented.centres[first], oriented.rotations[first]
    step = 4.0
    seen = []
    for shift in ((0.0, 0.0), (step, 0.0), (0.0, step)):
        rays = camera.rays_from_image(pixels + np.array(shift)) @ turn.T
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (height - centre[2]) / rays[:, 2]
        ground = centre + distance[:, None] * rays
        local = (ground - oriented.centres[other]) @ oriented.rotations[other]
        there, inside = second.image_from_camera(np.nan_to_num(local))
        known = inside & np.isfinite(local).all(axis=1)
        seen.append(np.where(known[:, None], there, np.nan))
    affine = np.stack([(seen[1] - seen[0]) / step, (seen[2] - seen[0]) / step], axis=-1)
    bad = np.asarray(~np.isfinite(affine).all(axis=(1, 2)))
    affine[bad] = np.eye(2)
    return np.where(bad[:, None], np.nan, seen[0]), affine


def _collected(
    points: TiePoints,
    reference: Integers,
    groups: dict[int, Integers],
    done: dict[str, tuple[str, dict[str, Any]]],
) -> tuple[TiePoints, dict[str, int]]:
    pixels, sigma = points.pixels.copy(), points.sigma_px.copy()
    measured = np.zeros(len(points), dtype=np.bool_)
    counts: dict[str, int] = {}
    for group in groups:
        record = done[str(group)][1]
        rows = np.array(record["rows"], dtype=np.int64)
        for reason, count in record["failures"].items():
            counts[reason] = counts.get(reason, 0) + count
        if not len(rows):
            continue
        pixels[rows] = record["right"]
        sigma[rows] = record["sigma"]
        measured[rows] = True
        here = reference[points.point[rows]]
        pixels[here] = record["left"]
        sigma[here] = _REFERENCE_SIGMA_PX
        measured[here] = True
    result = TiePoints(points.photographs, points.point, points.photo, pixels, sigma, points.feature).select(
        measured
    )
    counts = {"measured": len(result), **dict(sorted(counts.items()))}
    return result.with_rays(2), counts


class _Images:
    """Grey photographs, the last ones kept."""

    def __init__(self, photos: Sequence[BlockPhoto], kept: int) -> None:
        self._photos = photos
        self._kept = kept
        self._known: dict[int, NDArray[np.uint8]] = {}

    def of(self, k: int) -> NDArray[np.uint8]:
        image = self._known.get(k)
        if image is None:
            image = grey_of_photo(self._photos[k])
            while len(self._known) >= self._kept:
                # Another thread may have taken the oldest away in the meantime.
                self._known.pop(next(iter(list(self._known)), -1), None)
            self._known[k] = image
        return image
