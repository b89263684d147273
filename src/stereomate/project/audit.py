"""Audit of a project: its files read without believing what it declares, and what they say themselves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import InputError, ProjectError
from stereomate.formats.orientation_table import read_orientation_table
from stereomate.frames.audit.findings import Audit, audit
from stereomate.frames.audit.observations import AuditObservations, WrittenBlock
from stereomate.frames.audit.readings import HeightCandidate
from stereomate.frames.audit.vertical import grid_file_candidate, vertical_names, world_geoids
from stereomate.frames.checks import check_coordinates
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.project.loader import load, project_frame
from stereomate.project.observations import project_observations
from stereomate.project.orientations import Reading, WrittenOrientations, read_orientations
from stereomate.project.reading import read_project_file
from stereomate.project.schema import UNDECLARED, OrientationSection, ProjectFile
from stereomate.project.turned import TurnAudit, audit_turns
from stereomate.raster import open_photo
from stereomate.units import FOOT

Array = NDArray[np.float64]

_GRID_SUFFIXES: Final = (".tif", ".tiff", ".gtx", ".byn")
# Geoid grids are small; larger rasters are photographs and products.
_LARGEST_GRID_BYTES: Final = 64 << 20


@dataclass(frozen=True, eq=False)
class ProjectAudit:
    """What the audit of a project found.

    Attributes
    ----------
    path : Path
    audit : Audit or None
        From tie and control observations, where the project has some.
    turns : TurnAudit or None
        From matched photographs, where they were looked at.
    candidates : tuple of HeightCandidate
        Height systems that were tried.
    registered : tuple of str
        Height systems registered for the place, named where none that was tried explains the heights.
    notes : tuple of str
        What was assumed or left out.
    """

    path: Path
    audit: Audit | None
    turns: TurnAudit | None
    candidates: tuple[HeightCandidate, ...]
    registered: tuple[str, ...]
    notes: tuple[str, ...]


def audit_project(path: str | Path, photographs: bool | None = None) -> ProjectAudit:
    """Which frame the orientation of a project was really made in.

    Parameters
    ----------
    path : path
        The project file.
    photographs : bool, optional
        Whether neighbouring photographs are matched to find turned ones; if absent, where the project has no
        observations.

    Raises
    ------
    ProjectError
        If the project has neither observations nor photographs to match.
    StereomateError
        Of its classes, naming the file that is wrong.
    """
    path = Path(path)
    file = read_project_file(path)
    match = file.observations is None if photographs is None else photographs
    if file.observations is None and not match:
        raise ProjectError(
            "must be given: the audit needs tie or control points, or photographs to match",
            file=path,
            field="observations",
            hint='[observations] with files = ["ties.mes"]',
        )
    turns = audit_turns(load(path)) if match else None
    if file.observations is None:
        return ProjectAudit(path, None, turns, (), (), ())
    notes: list[str] = []
    result, candidates, registered = _audit_points(file, path, notes)
    return ProjectAudit(path, result, turns, tuple(candidates), registered, tuple(notes))


def _audit_points(
    file: ProjectFile, path: Path, notes: list[str]
) -> tuple[Audit, list[HeightCandidate], tuple[str, ...]]:
    """The audit by points, the height systems tried, and those registered where none explains the heights."""
    written, frame = written_orientations(file, path, notes)
    if written.frame.is_geographic:
        raise ProjectError("must be coordinates of a map grid to be audited", file=path, field="photos.crs")
    block = WrittenBlock(
        written.frame.crs, written.positions, written.attitudes, written.convention, written.origin
    )
    observations = project_observations(file, path, written, notes)
    plain = MapFrame(written.frame.crs, HeightSystem.ellipsoidal())
    check_coordinates(plain, observations.reference, "known points", path, tolerated=0.5)
    candidates = height_candidates(file, path, frame, written.positions, written.frame.crs)
    return audit_block(file, frame, block, observations, candidates)


def audit_block(
    file: ProjectFile,
    frame: MapFrame,
    block: WrittenBlock,
    observations: AuditObservations,
    candidates: list[HeightCandidate],
    own: Sequence[HeightCandidate] = (),
) -> tuple[Audit, list[HeightCandidate], tuple[str, ...]]:
    """The audit of a block: heights in feet and above the world's geoids are tried where nothing else fits.

    Parameters
    ----------
    frame : MapFrame
        Of the project.
    candidates : list of HeightCandidate
        Height systems to try for orientation and known points.
    own : sequence of HeightCandidate
        Those of the orientation, where they are known.

    Returns
    -------
    (Audit, list of HeightCandidate, tuple of str)
        The systems that were tried, and the names of those registered for the place if none explains the
        heights.

    Raises
    ------
    InputError
        If no reading makes rays meet.
    """
    lon, lat = _middle(block.crs, block.positions)
    result: Audit | None = None
    refused: InputError | None = None
    for more in (_no_more, world_geoids, _in_feet):
        wider = [*candidates, *more(frame, lon, lat, candidates)]
        if result is not None and len(wider) == len(candidates):
            continue
        try:
            found = _audited(file, block, observations, wider, own)
        except InputError as error:
            refused = refused or error
            continue
        if found.explained or not observations.known.any():
            return found, wider, ()
        # Feet that explain nothing are no better than metres that do not.
        if more is not _in_feet or result is None:
            result, candidates = found, wider
    if result is None:
        raise refused or InputError("cannot be read in any way", field="orientation")
    return result, candidates, tuple(vertical_names(lon, lat))


def _no_more(*_: object) -> list[HeightCandidate]:
    return []


def _in_feet(
    frame: MapFrame, lon: float, lat: float, candidates: Sequence[HeightCandidate]
) -> list[HeightCandidate]:
    return [candidate.in_unit(FOOT, "feet") for candidate in candidates]


def _audited(
    file: ProjectFile,
    block: WrittenBlock,
    observations: AuditObservations,
    candidates: Sequence[HeightCandidate],
    own: Sequence[HeightCandidate],
) -> Audit:
    """The audit with the declared systems first."""

    def first(text: str | None) -> list[HeightCandidate]:
        declared = text or file.project.heights
        return sorted(candidates, key=lambda c: (c.text != declared, c.unit != ""))

    control = file.control.heights if file.control else None
    return audit(block, observations, own or first(file.photos.heights), first(control))


def written_orientations(
    file: ProjectFile, path: Path, notes: list[str]
) -> tuple[WrittenOrientations, MapFrame]:
    """Orientations as written, and the frame of the project; angles that are not declared are guessed."""
    frame = project_frame(file, path)
    reading = Reading(path, "photos", path.parent, file.project.crs, frame.heights)
    section: OrientationSection = file.photos
    if section.angles is None and section.orientation_format != "opensfm":
        table_path = path.parent / section.orientation
        if table_path.suffix.lower() != ".json":
            table = read_orientation_table(table_path, section.columns, section.separator)
            axes = "grid" if "omega" in table.columns else "rph"
            section = section.model_copy(update={"angles": axes})
            notes.append(f'photos.angles is not declared: "{axes}" is where the audit starts from')
    return read_orientations(section, reading), frame


def _middle(crs: str, positions: Array) -> tuple[float, float]:
    """Longitude and latitude of the middle of a block."""
    plain = MapFrame(crs, HeightSystem.ellipsoidal())
    lon, lat, _ = plain.geodetic_from_map([*positions[:, :2].mean(axis=0), 0.0])
    return float(lon), float(lat)


def height_candidates(
    file: ProjectFile, path: Path, frame: MapFrame, positions: Array, crs: str | None = None
) -> list[HeightCandidate]:
    """Ellipsoidal heights, what the project declares, and the geoid grids that lie beside its files.

    Parameters
    ----------
    frame : MapFrame
        Of the project.
    positions : ndarray (n, 3)
        Projection centres in `crs`, or in the CRS of the project.
    """
    lon, lat = _middle(crs or frame.crs, positions)
    found = {"ellipsoidal": HeightCandidate("ellipsoidal", "ellipsoidal heights", HeightSystem.ellipsoidal())}
    if file.project.heights == UNDECLARED:
        found[UNDECLARED] = replace(found["ellipsoidal"], text=UNDECLARED, name="undeclared heights")
    declared = (file.project.heights, file.photos.heights, file.control.heights if file.control else None)
    for text in declared:
        if text is not None and text not in found and text != UNDECLARED:
            system = HeightSystem.from_text(text, path.parent)
            found[text] = HeightCandidate(text, system.description, system)
    for grid in _grid_files(file, path):
        text = _relative(grid, path.parent)
        same = any(c.system.reference == str(grid.absolute()) for c in found.values())
        candidate = None if text in found or same else grid_file_candidate(grid, text, frame, lon, lat)
        if candidate is not None:
            found[text] = candidate
    return list(found.values())


def _relative(path: Path, folder: Path) -> str:
    try:
        return path.relative_to(folder.resolve()).as_posix()
    except ValueError:
        return str(path)


def _grid_files(file: ProjectFile, path: Path) -> list[Path]:
    """Small rasters in the folders of the project, its orientation and its control."""
    names = [path, path.parent / file.photos.orientation]
    if file.control is not None:
        names.append(path.parent / file.control.file)
    folders = dict.fromkeys(name.parent.resolve() for name in names)
    found = []
    for folder in folders:
        for entry in sorted(folder.iterdir()) if folder.is_dir() else ():
            small = entry.suffix.lower() in _GRID_SUFFIXES and entry.stat().st_size <= _LARGEST_GRID_BYTES
            if small and _may_be_geoid(entry):
                found.append(entry)
    return found


def _may_be_geoid(path: Path) -> bool:
    """Whether a raster has one band of decimal numbers, without reading them."""
    if path.suffix.lower() not in (".tif", ".tiff"):
        return True
    try:
        with open_photo(path) as raster:
            return raster.info.bands == 1 and raster.info.dtype.kind == "f"
    except InputError:
        return False
