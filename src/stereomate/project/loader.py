"""From a project file to a `Project`: reads what it names, checks it, leaves out what cannot take part."""

from __future__ import annotations

import difflib
import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.model import Camera
from stereomate.coverage.covariance import OrientationCovariance
from stereomate.coverage.survey import Survey
from stereomate.errors import InputError, ProjectError
from stereomate.formats.law_table import read_law_table
from stereomate.frames.crs import datum_note
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.transform import map_from_map
from stereomate.project.cameras import camera_from_section
from stereomate.project.candidates import Candidate, find_candidates, planned_candidates
from stereomate.project.compare import Comparison, compare_orientations
from stereomate.project.covariance_file import read_covariance
from stereomate.project.inputs import InputFile, PhotoProblem, file_digest, photo_fingerprint
from stereomate.project.model import Project
from stereomate.project.orient_control import check_control_units
from stereomate.project.orientations import (
    Reading,
    WrittenOrientations,
    map_frame,
    named,
    read_orientations,
    tangent_frame_for,
)
from stereomate.project.photos import any_photo_there
from stereomate.project.placing import Placed, place_photographs, suspicious_angles
from stereomate.project.reading import read_project_file
from stereomate.project.schema import UNDECLARED, ProductsSection, ProjectFile
from stereomate.project.surface import open_terrain, read_area, read_sheets, read_water, with_breaklines
from stereomate.rectify.options import RectifyOptions

Array = NDArray[np.float64]
LOG = logging.getLogger(__name__)

_FILES_WITH_DIGEST = ("area", "sheets", "breaklines", "seam_file", "law_table")
_FILES_OF_PRODUCTS = {*_FILES_WITH_DIGEST, "pairs"}


def load(path: str | Path, *, strict: bool | None = None, planned: bool = False) -> Project:
    """Read a project file and everything it names, but for pixels.

    Parameters
    ----------
    path : path
        The project file.
    strict : bool, optional
        Whether one photograph that cannot take part is an error; ``products.strict`` if absent.
    planned : bool
        Where no photograph is there yet, take the orientation table alone: a planned flight. What comes of it
        can be planned and judged, not made.

    Raises
    ------
    StereomateError
        One of its classes for each kind of wrong input, see ``docs/errors.md``; file, key, rule and value are
        named.
    """
    path = Path(path)
    file = read_project_file(path)
    options = _options(file.products, path)
    frame = project_frame(file, path)
    reading = Reading(path, "photos", path.parent, file.project.crs, frame.heights)
    notes = _height_notes(frame)
    cameras = cameras_of(file, path, notes)
    written = read_orientations(file.photos, reading)
    notes += written.notes
    candidates, problems = _candidates(file, path, written, cameras, planned, notes)
    _require_fitting(file.products, candidates, path)
    tangent = tangent_frame_for(written, frame, file.project.tangent_origin)
    centres = map_from_map(frame, written.frame, written.positions)
    model = open_terrain(file, reading, centres, frame, notes)
    if model is not None:
        check_control_units(file, path, frame, model)
    placed = place_photographs(file, reading, written, candidates, tangent, model, notes)
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
        infos={
            photo.name: info
            for photo, info in zip(placed.photographs, placed.infos, strict=True)
            if info is not None
        },
        heights=model,
        ground=placed.ground,
        options=options,
        area=read_area(file, reading, frame),
        sheets=read_sheets(file, reading, frame),
        water=read_water(file, reading, frame),
        pairs=_pairs(file.products, survey, path),
        seam_file=_seam_file(file.products, path),
        grid_adjustment=placed.adjustment,
        inputs=_inputs(path, written, survey, file),
        comparison=_comparison(file, reading, survey),
        orientation_covariance=_covariance(file, path, written, survey),
        problems=tuple(problems),
        warnings=tuple(suspicious_angles(written)),
        notes=tuple(notes),
        document=file.model_dump(mode="json"),
    )


def _candidates(
    file: ProjectFile,
    path: Path,
    written: WrittenOrientations,
    cameras: dict[str, Camera],
    planned: bool,
    notes: list[str],
) -> tuple[list[Candidate], list[PhotoProblem]]:
    if not planned or any_photo_there(file.photos.files, path.parent):
        return find_candidates(file, path, written, cameras)
    notes.append(f"no photograph is there: a flight planned by {written.source.name}")
    return planned_candidates(file, path, written, cameras), []


def _options(section: ProductsSection, path: Path) -> RectifyOptions:
    values = section.model_dump(exclude=_FILES_OF_PRODUCTS)
    if section.law_table is not None:
        heights, parallaxes = read_law_table(path.parent / section.law_table)
        values |= {"law_heights_m": heights, "law_parallaxes_m": parallaxes}
    try:
        return RectifyOptions(**values)
    except ProjectError as error:
        raise named(error, path, error.field or "products") from error


def _require_fitting(section: ProductsSection, candidates: Sequence[Candidate], path: Path) -> None:
    """Options that depend on the type of the pixels, where that is the one of the photographs."""
    kinds = [candidate.info.dtype.name for candidate in candidates if candidate.info is not None]
    if section.dtype is None and kinds:
        written = section.model_dump(exclude=_FILES_OF_PRODUCTS)
        try:
            # The law is none of this, and would ask for its table.
            RectifyOptions(**{**written, "law": "logarithmic", "dtype": kinds[0]})
        except ProjectError as error:
            rule = ProjectError(
                error.rule, field=error.field, value=error.value, hint=f"the photographs are {kinds[0]}"
            )
            raise named(rule, path, error.field or "products") from error


def project_frame(file: ProjectFile, path: Path) -> MapFrame:
    """CRS and height system of a project file."""
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


def cameras_of(file: ProjectFile, path: Path, notes: list[str]) -> dict[str, Camera]:
    """The cameras a project file describes, by name; `notes` gets what was assumed."""
    cameras: dict[str, Camera] = {}
    for number, section in enumerate(file.camera, 1):
        camera, remarks = camera_from_section(section, path, f"camera[{number}]")
        if camera.name in cameras:
            rule = "names two cameras alike"
            raise ProjectError(rule, file=path, field=f"camera[{number}].name", value=camera.name)
        cameras[camera.name] = camera
        notes += remarks
    return cameras


def _require_enough(placed: Placed, problems: list[PhotoProblem], strict: bool, path: Path) -> None:
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
    return tuple(
        named_pair(pair, survey, path, f"products.pairs[{number}]")
        for number, pair in enumerate(section.pairs, 1)
    )


def named_pair(pair: tuple[str, str], survey: Survey, path: Path, field: str) -> tuple[str, str]:
    """Names in the survey of two photographs, called by these names or by their files.

    Raises
    ------
    ProjectError
        If one is not in the survey, or both are the same.
    """
    names = {photo.name: photo.name for photo in survey.photographs}
    names |= {photo.path.name: photo.name for photo in survey.photographs if photo.path is not None}
    unknown = [name for name in pair if name not in names]
    if unknown:
        close = difflib.get_close_matches(unknown[0], names, 3) or [p.name for p in survey.photographs[:3]]
        rule, hint = "must name photographs of the survey", f"such as {', '.join(close)}"
        raise ProjectError(rule, file=path, field=field, value=unknown[0], hint=hint)
    left, right = (names[name] for name in pair)
    if left == right:
        raise ProjectError("must name two photographs", file=path, field=field, value=list(pair))
    return left, right


def _seam_file(section: ProductsSection, path: Path) -> Path | None:
    if section.seam_file is None:
        return None
    found = path.parent / section.seam_file
    if not found.is_file():
        rule = "must be a file of seams, as a run writes it"
        raise ProjectError(rule, file=path, field="products.seam_file", value=section.seam_file)
    return found


def _comparison(file: ProjectFile, reading: Reading, survey: Survey) -> Comparison | None:
    section = file.photos.compare
    if section is None:
        return None
    return compare_orientations(section, replace(reading, field="photos.compare"), survey)


def _covariance(
    file: ProjectFile, path: Path, written: WrittenOrientations, survey: Survey
) -> OrientationCovariance | None:
    """Of the photographs of the survey, which the file knows by the names of their files."""
    name = file.photos.orientation_covariance
    if name is None:
        return None
    known = read_covariance(path.parent / name, survey.tangent, written.source)
    return known.renamed({p.name if p.path is None else p.path.name: p.name for p in survey.photographs})


def _inputs(
    path: Path, written: WrittenOrientations, survey: Survey, file: ProjectFile
) -> tuple[InputFile, ...]:
    inputs = [
        InputFile("project", path, file_digest(path)),
        InputFile("orientation", written.source, file_digest(written.source)),
    ]
    if file.control is not None and (path.parent / file.control.file).is_file():
        control = path.parent / file.control.file
        inputs.append(InputFile("control", control, file_digest(control)))
    water = None if file.terrain is None else file.terrain.water
    named_files = [(key, getattr(file.products, key)) for key in _FILES_WITH_DIGEST]
    covariance = file.photos.orientation_covariance
    for key, name in (*named_files, ("water", water), ("orientation_covariance", covariance)):
        if name is not None:
            inputs.append(InputFile(key, path.parent / name, file_digest(path.parent / name)))
    inputs += [
        InputFile("photograph", photo.path, photo_fingerprint(photo.path))
        for photo in survey.photographs
        if photo.path is not None
    ]
    return tuple(inputs)


__all__ = ["load"]
