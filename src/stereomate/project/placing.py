"""Where photographs were and which way they looked; those that cannot be right are left out and say why."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stereomate.coverage.survey import Photograph
from stereomate.errors import CoverageError, InputError, OrientationError
from stereomate.formats.exif import read_camera_tags
from stereomate.frames.adjusted import GridAdjustment
from stereomate.frames.orientation import ExteriorOrientation
from stereomate.frames.tangent import TangentFrame
from stereomate.project.candidates import Candidate
from stereomate.project.ground import GroundUnderBlock, ground_under, looks_up
from stereomate.project.inputs import PhotoProblem
from stereomate.project.meaning import resolve_adjusted
from stereomate.project.orientations import Reading, WrittenOrientations
from stereomate.project.schema import ProjectFile
from stereomate.raster import RasterInfo
from stereomate.terrain.model import HeightModel

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Placed:
    photographs: list[Photograph]
    infos: list[RasterInfo | None]
    ground: GroundUnderBlock | None
    adjustment: GridAdjustment | None
    problems: list[PhotoProblem]


def place_photographs(
    file: ProjectFile,
    reading: Reading,
    written: WrittenOrientations,
    candidates: list[Candidate],
    tangent: TangentFrame,
    model: HeightModel | None,
    notes: list[str],
) -> Placed:
    """Photographs with their orientation in the tangent frame; those that cannot be right are left out."""
    problems: list[PhotoProblem] = []
    centres = written.centres(tangent)
    rotations = written.placed(tangent, centres)
    elevation = looks_up(centres, rotations, tangent)
    good = []
    for candidate in candidates:
        if elevation[candidate.index] >= 0.0:
            problems.append(_looks_at_the_sky(written, candidate, float(elevation[candidate.index])))
        else:
            good.append(candidate)
    if not good:
        return Placed([], [], None, None, problems)
    rows = np.array([candidate.index for candidate in good])
    cameras = [candidate.camera for candidate in good]
    ground = None
    if model is not None:
        ground = ground_under(centres[rows], rotations[rows], cameras, tangent, model)
    adjustment = resolve_adjusted(file, reading, written, rows, ground, notes)
    if adjustment is not None:
        written = replace(written, positions=adjustment.centres)
        centres = written.centres(tangent)
        rotations = written.placed(tangent, centres)
        if model is not None:
            ground = ground_under(centres[rows], rotations[rows], cameras, tangent, model)
    if ground is not None:
        problems += _off_the_ground(good, ground, model)
        keep = np.flatnonzero((ground.seen > 0.0) & (ground.flying_height_m > 0.0))
        good, ground = [good[k] for k in keep], ground.of(keep)
    photographs = [_photograph(c, centres[c.index], rotations[c.index]) for c in good]
    return Placed(photographs, [c.info for c in good], ground, adjustment, problems)


def _photograph(candidate: Candidate, centre: Array, rotation: Array) -> Photograph:
    x, y, z = (float(value) for value in centre)
    orientation = ExteriorOrientation((x, y, z), rotation)
    if candidate.info is None:
        return Photograph(candidate.name, None, candidate.camera, orientation, None)
    time = read_camera_tags(candidate.path).time
    return Photograph(candidate.name, candidate.path, candidate.camera, orientation, time)


def _looks_at_the_sky(written: WrittenOrientations, candidate: Candidate, elevation: float) -> PhotoProblem:
    error = OrientationError(
        f"looks at the sky, {elevation:.0f}° above the horizon: unit, order or axes of its angles are wrong",
        file=written.source,
        field=written.names[candidate.index],
        value=[round(float(angle), 4) for angle in np.ravel(written.attitudes[candidate.index])[:3]],
        hint="see photos.angles, photos.angle_unit and photos.angle_order",
    )
    return PhotoProblem(candidate.path.name, error)


def suspicious_angles(written: WrittenOrientations) -> list[str]:
    """Tilts that are all tiny and headings that all fit into ±π look like radians read as degrees."""
    angles = written.attitudes
    if angles.ndim != 2 or len(angles) < 2 or written.convention.unit != "deg":
        return []
    largest = np.abs(angles).max(axis=0)
    if not (1.0 < largest[2] <= math.pi and largest[:2].max() < 0.5):
        return []
    return [f"{written.source.name}: all angles lie within ±π: are they radians, not degrees?"]


def _off_the_ground(
    candidates: list[Candidate], ground: GroundUnderBlock, model: HeightModel | None
) -> list[PhotoProblem]:
    problems = []
    name = model.name if model is not None else ""
    for candidate, seen, above in zip(candidates, ground.seen, ground.flying_height_m, strict=True):
        error: InputError
        if above <= 0.0:
            rule = f"lies {-above:.1f} m below the ground of {name}: heights or their systems are wrong"
            error = OrientationError(rule, file=candidate.path)
        elif seen == 0.0:
            error = CoverageError(f"sees no part of the height model {name}", file=candidate.path)
        else:
            continue
        problems.append(PhotoProblem(candidate.path.name, error))
    return problems
