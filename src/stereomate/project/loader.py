"""From a project file to a `Project`: reads what it names, checks it, leaves out what cannot take part."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.model import Camera
from stereomate.coverage.survey import Photograph, Survey
from stereomate.errors import CoverageError, ImageError, InputError, OrientationError, ProjectError
from stereomate.formats.exif import read_camera_tags
from stereomate.frames.adjusted import GridAdjustment
from stereomate.frames.crs import datum_note
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.orientation import ExteriorOrientation
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import map_from_map
from stereomate.project.cameras import camera_from_section
from stereomate.project.compare import Comparison, compare_orientations
from stereomate.project.ground import GroundUnderBlock, ground_under, looks_up
from stereomate.project.inputs import InputFile, PhotoProblem, file_digest, photo_fingerprint
from stereomate.project.meaning import resolve_adjusted
from stereomate.project.model import Project
from stereomate.project.orientations import (
    Reading,
    WrittenOrientations,
    map_frame,
    named,
    read_orientations,
    tangent_frame_for,
)
from stereomate.project.photos import match_names, photo_files, read_photo_info
from stereomate.project.reading import read_project_file
from stereomate.project.schema import UNDECLARED, ProductsSection, ProjectFile
from stereomate.project.surface import open_terrain, read_area, read_sheets, with_breaklines
from stereomate.raster import RasterInfo
from stereomate.rectify.options import RectifyOptions
from stereomate.terrain.model import HeightModel

Array = NDArray[np.float64]
LOG = logging.getLogger(__name__)

_FILES_OF_PRODUCTS = {"area", "sheets", "breaklines", "pairs"}


@dataclass(frozen=True)
class _Candidate:
    """A photograph with an orientation, on its way into the survey."""

    index: int
    path: Path
    info: RasterInfo
    camera: Camera


def load(path: str | Path, *, strict: bool | None = None) -> Project:
    """Read a project file and everything it names, but for pixels.

    Parameters
    ----------
    path : path
        The project file.
    strict : bool, optional
        Whether one photograph that cannot take part is an error; ``products.strict`` if absent.

    Raises
    ------
    StereomateError
        One of its classes for each kind of wrong input, see ``docs/errors.md``; file, key, rule and value are
        named.
    """
    path = Path(path)
    file = read_project_file(path)
    options = _options(file.products, path)
    frame = _project_frame(file, path)
    reading = Reading(path, "photos", path.parent, file.project.crs, frame.heights)
    notes = _height_notes(frame)
    cameras = _cameras(file, path, notes)
    written = read_orientations(file.photos, reading)
    notes += written.notes
    candidates, problems = _candidates(file, path, written, cameras)
    tangent = tangent_frame_for(written, frame, file.project.tangent_origin)
    centres = map_from_map(frame, written.frame, written.positions)
    model = open_terrain(file, reading, centres, frame, notes)
    placed = _place(file, reading, written, candidates, tangent, model, options, notes)
    problems += placed.problems
    _require_enough(placed, problems, options.strict if strict is None else strict, path)
    survey = Survey(frame, tangent, tuple(placed.photographs))
    if model is not None:
        _note_datum(frame, model.frame, "the height model", notes)
        model = with_breaklines(model, file, reading, notes)
    _note_datum(frame, written.frame, "the orientations", notes)
    notes += [f"left out: {problem.error}" for problem in problems]
    for note in notes:
        LOG.info("%s", note)
    return Project(
        path=path,
        name=file.project.name or path.stem,
        survey=survey,
        infos={photo.name: info for photo, info in zip(placed.photographs, placed.infos, strict=True)},
        heights=model,
        ground=placed.ground,
        options=options,
        area=read_area(file, reading, frame),
        sheets=read_sheets(file, reading, frame),
        pairs=_pairs(file.products, survey, path),
        grid_adjustment=placed.adjustment,
        inputs=_inputs(path, written, survey, file),
        comparison=_comparison(file, reading, survey),
        problems=tuple(problems),
        warnings=tuple(_suspicious_angles(written)),
        notes=tuple(notes),
        document=file.model_dump(mode="json"),
    )


def _options(section: ProductsSection, path: Path) -> RectifyOptions:
    values = section.model_dump(exclude=_FILES_OF_PRODUCTS)
    try:
        return RectifyOptions(**values)
    except ProjectError as error:
        raise named(error, path, error.field or "products") from error


def _project_frame(file: ProjectFile, path: Path) -> MapFrame:
    try:
        heights = HeightSystem.from_text(file.project.heights, path.parent)
    except InputError as error:
        raise named(error, path, "project.heights") from error
    frame = map_frame(file.project.crs, heights, path, "project.crs")
    try:
        frame.require_conformal()
    except InputError as error:
        raise named(error, path, "project.crs") from error
    return frame


def _height_notes(frame: MapFrame) -> list[str]:
    notes = [f"heights: {frame.heights.description}"]
    if frame.vertical_name is not None:
        notes.append(f"project.crs has a vertical part, {frame.vertical_name}: noted, not applied")
    return notes


def _cameras(file: ProjectFile, path: Path, notes: list[str]) -> dict[str, Camera]:
    cameras: dict[str, Camera] = {}
    for number, section in enumerate(file.camera, 1):
        camera, remarks = camera_from_section(section, path, f"camera[{number}]")
        if camera.name in cameras:
            rule = "names two cameras alike"
            raise ProjectError(rule, file=path, field=f"camera[{number}].name", value=camera.name)
        cameras[camera.name] = camera
        notes += remarks
    return cameras


def _candidates(
    file: ProjectFile, path: Path, written: WrittenOrientations, cameras: Mapping[str, Camera]
) -> tuple[list[_Candidate], list[PhotoProblem]]:
    files = photo_files(file.photos.files, file.photos.exclude, path.parent, path)
    matched, problems = match_names(written.names, files, written.source)
    candidates = []
    for index, name in enumerate(written.names):
        if name not in matched:
            continue
        photo = matched[name]
        try:
            info = read_photo_info(photo)
            camera = _camera_of(index, file, path, written, cameras, info)
        except (ImageError, OrientationError) as error:
            problems.append(PhotoProblem(photo.name, error))
            continue
        candidates.append(_Candidate(index, photo, info, camera))
    return sorted(candidates, key=lambda candidate: candidate.path.name), problems


def _camera_of(
    index: int,
    file: ProjectFile,
    path: Path,
    written: WrittenOrientations,
    cameras: Mapping[str, Camera],
    info: RasterInfo,
) -> Camera:
    known = cameras or written.camera_values
    if not known:
        rule = "must be given: no camera is described"
        raise ProjectError(rule, file=path, field="camera", hint="[[camera]] with its principal distance")
    wanted = file.photos.camera or written.cameras[index]
    if file.photos.camera is not None and wanted not in known:
        rule = f"must be one of {', '.join(known)}"
        raise ProjectError(rule, file=path, field="photos.camera", value=wanted)
    if len(known) == 1:
        camera = next(iter(known.values()))
    elif wanted is not None and wanted in known:
        camera = known[wanted]
    else:
        # Without a name the size decides, where only one camera has it.
        sized = [camera for camera in known.values() if camera.size_px == info.size]
        if len(sized) != 1:
            rule = f"must name its camera, one of {', '.join(known)}"
            raise OrientationError(rule, file=written.source, field=written.names[index], value=wanted)
        camera = sized[0]
    if info.size != camera.size_px:
        raise ImageError(
            f"must have the {camera.size_px[0]} x {camera.size_px[1]} pixels of camera {camera.name}",
            file=info.path,
            value=f"{info.size[0]} x {info.size[1]}",
        )
    return camera


@dataclass(frozen=True, eq=False)
class _Placed:
    photographs: list[Photograph]
    infos: list[RasterInfo]
    ground: GroundUnderBlock | None
    adjustment: GridAdjustment | None
    problems: list[PhotoProblem]


def _place(
    file: ProjectFile,
    reading: Reading,
    written: WrittenOrientations,
    candidates: list[_Candidate],
    tangent: TangentFrame,
    model: HeightModel | None,
    options: RectifyOptions,
    notes: list[str],
) -> _Placed:
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
        return _Placed([], [], None, None, problems)
    rows = np.array([candidate.index for candidate in good])
    cameras = [candidate.camera for candidate in good]
    ground = None
    if model is not None:
        ground = ground_under(centres[rows], rotations[rows], cameras, tangent, model)
    adjustment = resolve_adjusted(file, reading, written, rows, ground, options, notes)
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
    return _Placed(photographs, [c.info for c in good], ground, adjustment, problems)


def _photograph(candidate: _Candidate, centre: Array, rotation: Array) -> Photograph:
    x, y, z = (float(value) for value in centre)
    orientation = ExteriorOrientation((x, y, z), rotation)
    time = read_camera_tags(candidate.path).time
    return Photograph(candidate.path.stem, candidate.path, candidate.camera, orientation, time)


def _looks_at_the_sky(written: WrittenOrientations, candidate: _Candidate, elevation: float) -> PhotoProblem:
    error = OrientationError(
        f"looks at the sky, {elevation:.0f}° above the horizon: unit, order or axes of its angles are wrong",
        file=written.source,
        field=written.names[candidate.index],
        value=[round(float(angle), 4) for angle in np.ravel(written.attitudes[candidate.index])[:3]],
        hint="see photos.angles, photos.angle_unit and photos.angle_order",
    )
    return PhotoProblem(candidate.path.name, error)


def _suspicious_angles(written: WrittenOrientations) -> list[str]:
    """Tilts that are all tiny and headings that all fit into ±π look like radians read as degrees."""
    angles = written.attitudes
    if angles.ndim != 2 or len(angles) < 2 or written.convention.unit != "deg":
        return []
    largest = np.abs(angles).max(axis=0)
    if not (1.0 < largest[2] <= math.pi and largest[:2].max() < 0.5):
        return []
    return [f"{written.source.name}: all angles lie within ±π: are they radians, not degrees?"]


def _off_the_ground(
    candidates: list[_Candidate], ground: GroundUnderBlock, model: HeightModel | None
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


def _require_enough(placed: _Placed, problems: list[PhotoProblem], strict: bool, path: Path) -> None:
    if placed.photographs and not (strict and problems):
        for problem in problems:
            LOG.warning("left out: %s", problem.error)
        return
    if not problems:
        raise ProjectError("names no photograph with an orientation", file=path, field="photos.files")
    error = problems[0].error
    rest = len(problems) - 1
    if rest:
        hint = f"{error.hint}; " if error.hint else ""
        hint += f"and {rest} more photograph{'s' if rest > 1 else ''} cannot take part"
        more = {} if error.value is None else {"value": error.value}
        error = type(error)(error.rule, file=error.file, field=error.field, hint=hint, **more)
    raise error


def _note_datum(project: MapFrame, other: MapFrame, what: str, notes: list[str]) -> None:
    note = datum_note(project.geodetic, other.geodetic)
    if note is not None:
        notes.append(f"{what}: {note}")
    if other.vertical_name is not None:
        applied = (
            "heights are undeclared" if project.heights.kind == UNDECLARED else "the declared heights rule"
        )
        notes.append(f"{what}: has a vertical CRS, {other.vertical_name}: noted, not applied ({applied})")


def _pairs(section: ProductsSection, survey: Survey, path: Path) -> tuple[tuple[str, str], ...] | None:
    if section.pairs is None:
        return None
    names = {photo.name: photo.name for photo in survey.photographs}
    names |= {photo.path.name: photo.name for photo in survey.photographs if photo.path is not None}
    pairs = []
    for number, pair in enumerate(section.pairs, 1):
        field = f"products.pairs[{number}]"
        unknown = [name for name in pair if name not in names]
        if unknown:
            rule = "must name photographs of the survey"
            raise ProjectError(rule, file=path, field=field, value=unknown[0])
        left, right = (names[name] for name in pair)
        if left == right:
            raise ProjectError("must name two photographs", file=path, field=field, value=list(pair))
        pairs.append((left, right))
    return tuple(pairs)


def _comparison(file: ProjectFile, reading: Reading, survey: Survey) -> Comparison | None:
    section = file.photos.compare
    if section is None:
        return None
    return compare_orientations(section, replace(reading, field="photos.compare"), survey)


def _inputs(
    path: Path, written: WrittenOrientations, survey: Survey, file: ProjectFile
) -> tuple[InputFile, ...]:
    inputs = [
        InputFile("project", path, file_digest(path)),
        InputFile("orientation", written.source, file_digest(written.source)),
    ]
    for key in ("area", "sheets", "breaklines"):
        name = getattr(file.products, key)
        if name is not None:
            inputs.append(InputFile(key, path.parent / name, file_digest(path.parent / name)))
    inputs += [
        InputFile("photograph", photo.path, photo_fingerprint(photo.path))
        for photo in survey.photographs
        if photo.path is not None
    ]
    return tuple(inputs)


__all__ = ["load"]
