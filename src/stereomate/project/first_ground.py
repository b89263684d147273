"""A first, coarse ground of oriented photographs without a height model: tie points, intersected."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from stereomate.block.photos import BlockPhoto
from stereomate.block.start_pairs import Approximation
from stereomate.block.tie_points import (
    TiePointOptions,
    choose_pairs,
    find_features,
    match_pairs,
    tie_points,
)
from stereomate.errors import NotDeterminedError
from stereomate.frames.transform import map_from_tangent
from stereomate.geometry.intersection import Rays, intersect_rays
from stereomate.measurement.database import CameraRow, ImageRow, MeasurementDatabase
from stereomate.measurement.tracks import TiePoints
from stereomate.project.inputs import photo_fingerprint
from stereomate.project.model import Project
from stereomate.project.orient_surface import fits_neighbours, interpolated
from stereomate.terrain.model import HeightModel
from stereomate.tiles import Executor

DATABASE: Final = "measurements.db"
_PINHOLE: Final = 1
_LEAST_POINTS: Final = 20


def first_ground(
    path: Path,
    project: Project,
    out: Path,
    executor: Executor | None,
    progress: Callable[[str, int, int], None],
) -> HeightModel:
    """Surface through tie points of photographs whose orientation is known.

    Measurements are kept in a database in `out`, as those of `stereomate orient`.

    Raises
    ------
    NotDeterminedError
        If the photographs share too few points.
    """
    survey, options = project.survey, TiePointOptions()
    photos = tuple(
        BlockPhoto(k + 1, p.path.name, p.path, p.camera, photo_fingerprint(p.path))
        for k, p in enumerate(survey.photographs)
        if p.path is not None
    )
    with MeasurementDatabase.open(out / DATABASE) as database:
        numbers = {name: k + 1 for k, name in enumerate(dict.fromkeys(p.camera.name for p in photos))}
        cameras = {numbers[p.camera.name]: CameraRow(_PINHOLE, p.camera.size_px, (1.0,) * 4) for p in photos}
        database.set_photographs(
            cameras, [ImageRow(p.number, p.name, numbers[p.camera.name]) for p in photos]
        )
        find_features(database, photos, options, executor, lambda d, n: progress("features", d, n))
        turns = np.array([p.orientation.object_from_camera for p in survey.photographs])
        known = Approximation(survey.centres_tangent, turns, None)
        selection = choose_pairs(database, photos, known, options)
        match_pairs(database, photos, selection, options, executor, lambda d, n: progress("pairs", d, n))
        ties, _ = tie_points(database, photos, selection, options)
    points = _intersected(project, ties)
    if len(points) < _LEAST_POINTS:
        raise NotDeterminedError(
            f"surface: only {len(points)} tie points agree with the orientation of {path}"
        )
    xyz = map_from_tangent(survey.tangent, survey.frame, points)
    (west, north), step, heights = interpolated(xyz[fits_neighbours(xyz)])
    return HeightModel.from_array(heights, (step, 0.0, west, 0.0, -step, north), survey.frame)


def _intersected(project: Project, ties: TiePoints) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Tie points (n, 3) in the tangent frame; those of rays that miss each other are left out."""
    photographs = project.survey.photographs
    image = np.full((len(ties), 2), np.nan)
    for k, photo in enumerate(photographs):
        mine = ties.photo == k
        image[mine] = photo.camera.rays_from_image(ties.pixels[mine])[:, :2]
    centres = project.survey.centres_tangent
    turns = np.array([p.orientation.object_from_camera for p in photographs])
    good = np.isfinite(image).all(axis=1)
    photo, point = ties.photo[good], ties.point[good]
    rays = Rays(point, centres[photo], turns[photo], image[good], np.ones(len(point)))
    found = intersect_rays(rays, int(ties.point.max()) + 1 if len(ties) else 0).points
    return np.asarray(found[np.isfinite(found).all(axis=1)])
