"""A real pair on the instrument: orientation points of a project, measured in both photographs."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stereomate.coverage.survey import Photograph
from stereomate.errors import NotDeterminedError
from stereomate.geometry.rotations import rotation_z
from stereomate.measurement.features import grey_image
from stereomate.project.model import Project
from stereomate.project.orientation_sections import PairGeometry, ProjectSectionOptions, project_sections
from stereomate.raster import open_photo
from stereomate.relative.automatic import orient_photographs
from stereomate.relative.empirical.measured import (
    MeasuredPair,
    dependent_setting,
    pixel_angle,
    require_six,
    section_labels,
)
from stereomate.relative.empirical.projectors import PlotterModel, Setting
from stereomate.terrain.sections import section_axes

FloatArray = NDArray[np.float64]

# Part of the left photograph's diagonal within which a match stands for a chosen point.
_REACH = 0.12


def measured_pair(
    project: Project, names: tuple[str, str], options: ProjectSectionOptions | None = None
) -> MeasuredPair:
    """Choose orientation points of a pair from its cross-sections and measure them by image matching.

    A point is measured at the match nearest to it: features matched, then refined by least-squares matching.

    Parameters
    ----------
    project : Project
    names : (str, str)
        The two photographs, left one first.
    options : ProjectSectionOptions, optional

    Raises
    ------
    InputError
        If they are no pair.
    NotDeterminedError
        If there are not two sections, the photographs cannot be matched, or one of the six points has no
        match near it.
    """
    (geometry,) = project_sections(project, options, names)
    if len(geometry.points) < 2:
        raise NotDeterminedError(
            f"{names[0]} and {names[1]}: {len(geometry.points)} cross-sections with three usable points, "
            "two are needed for six orientation points"
        )
    labels, profiles = section_labels(len(geometry.points))
    points = _sections_from_left(geometry, flipped=geometry.names[0] != names[0])
    left, right = (project.survey.photographs[project.survey.index(name)] for name in names)
    left_px, right_px = _match(left, right, points)
    matched: NDArray[np.bool_] = np.asarray(np.isfinite(right_px).all(axis=1))
    missing = [label for label, good in zip(labels, matched, strict=True) if not good]
    require_six(names, missing)
    kept = [label for label, good in zip(labels, matched, strict=True) if good]
    turns = [_laid_in(project, left, right, photo) for photo in (left, right)]
    vectors = [
        photo.camera.rays_from_image(pixels[matched]) @ turn.T
        for photo, pixels, (turn, _) in zip((left, right), (left_px, right_px), turns, strict=True)
    ]
    base = float(np.linalg.norm(np.subtract(right.orientation.centre, left.orientation.centre)))
    return MeasuredPair(
        names=names,
        model=PlotterModel(tuple(kept), vectors[0], vectors[1]),
        profiles=tuple(profile for profile in profiles if set(profile) <= set(kept)),
        start=Setting(base),
        given=dependent_setting(base, turns[0][1], turns[1][1]),
        failed=tuple(missing),
        pixel=max(pixel_angle(photo.camera) for photo in (left, right)),
    )


def _sections_from_left(geometry: PairGeometry, flipped: bool) -> FloatArray:
    """Places of the points of all sections, from the left to the right photograph, shape (3 k, 3)."""
    sections = list(geometry.points)
    if flipped:
        # Seen from the other end the base is turned, and 3 and 5 change sides.
        sections = [points[[0, 2, 1]] for points in reversed(sections)]
    return np.concatenate(sections)


def _match(left: Photograph, right: Photograph, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Pixels (n, 2) of the match nearest to each point in both photographs; nan on the right without one."""
    images = []
    for photo in (left, right):
        if photo.path is None:
            raise NotDeterminedError(f"{photo.name} has no image: nothing can be measured in it")
        with open_photo(photo.path) as reader:
            pixels, _ = reader.read_window(0, 0, *reader.size)
        images.append(grey_image(pixels))
    result = orient_photographs(images[0], images[1], left.camera, right.camera)
    if result.orientation is None:
        raise NotDeterminedError(f"{left.name} and {right.name}: {'; '.join(result.reasons)}")
    good = result.orientation.points().used
    one, two = result.left_px[good], result.right_px[good]
    wanted, _ = left.camera.image_from_camera(left.orientation.camera_from_tangent(points))
    found = np.full((2, len(points), 2), np.nan)
    found[0] = wanted
    free = np.ones(len(one), dtype=bool)
    reach = _REACH * math.hypot(*left.camera.size_px)
    for row, place in enumerate(wanted):
        distance = np.where(free, np.linalg.norm(one - place, axis=1), np.inf)
        nearest = int(np.argmin(distance))
        if distance[nearest] <= reach:
            found[:, row] = one[nearest], two[nearest]
            free[nearest] = False
    return found[0], found[1]


def _laid_in(
    project: Project, left: Photograph, right: Photograph, photo: Photograph
) -> tuple[FloatArray, FloatArray]:
    """The turn by whole degrees with which a photograph is laid in, and what its rotation is then."""
    start = np.array(left.orientation.centre)
    along, aside, down = section_axes(project.tangent, start, np.array(right.orientation.centre) - start)
    base_from_camera = np.stack((along, aside, -down)) @ photo.orientation.object_from_camera
    swing = math.degrees(math.atan2(base_from_camera[1, 0], base_from_camera[0, 0]))
    turn = rotation_z(math.radians(round(swing)))
    return turn, base_from_camera @ turn.T
