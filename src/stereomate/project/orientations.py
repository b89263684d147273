"""From written orientations to projection centres and rotations in the tangent frame of the project."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.model import Camera
from stereomate.errors import InputError, OrientationError, ProjectError
from stereomate.formats.opensfm import (
    OpenSfmReconstruction,
    frame_of,
    read_opensfm,
    reference_in_map,
    tangent_at,
)
from stereomate.formats.orientation_table import (
    GEOGRAPHIC_COLUMNS,
    MAP_COLUMNS,
    OPK_COLUMNS,
    RPY_COLUMNS,
    OrientationTable,
    read_orientation_table,
)
from stereomate.frames.attitude import AttitudeAxes, AttitudeConvention, AttitudeKind, object_from_camera
from stereomate.frames.checks import check_coordinates
from stereomate.frames.crs import WGS84
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import tangent_from_map
from stereomate.project.schema import UNDECLARED, OrientationSection
from stereomate.units import AngleUnit

Array = NDArray[np.float64]

GNSS_CRS: Final = "EPSG:4326"
_FULL_TURN: Final[dict[AngleUnit, float]] = {
    "deg": 360.0,
    "gon": 400.0,
    "rad": 2 * math.pi,
    "deg.mmss": 360.0,
}


@dataclass(frozen=True, eq=False)
class WrittenOrientations:
    """Orientations of a file with what their numbers mean, before any tangent frame exists.

    Attributes
    ----------
    source : Path
    names : tuple of str
        As the file writes them.
    frame : MapFrame
        CRS and heights of the positions.
    positions : ndarray (n, 3)
        In `frame`.
    attitudes : ndarray (n, 3) or (n, 3, 3)
        Angles as written, or matrices.
    convention : AttitudeConvention
    origin : TangentFrame or None
        Of angles about tangent axes.
    cameras : tuple of str or None
        Camera named in each row.
    camera_values : mapping of str to Camera
        Cameras that the file defines itself.
    in_grid : bool
        Positions are coordinates of a map grid, so that `adjusted_in` has a meaning.
    notes : tuple of str
        What was assumed or found out.
    """

    source: Path
    names: tuple[str, ...]
    frame: MapFrame
    positions: Array
    attitudes: Array
    convention: AttitudeConvention
    origin: TangentFrame | None
    cameras: tuple[str | None, ...]
    camera_values: Mapping[str, Camera]
    in_grid: bool
    notes: tuple[str, ...]

    def placed(self, tangent: TangentFrame, centres: Array) -> Array:
        """Rotations (n, 3, 3) from camera to tangent axes for true centres (n, 3) in the tangent frame."""
        grid = None if self.convention.axes == "tangent" else self.frame
        return object_from_camera(self.attitudes, self.convention, tangent, centres, grid, self.origin)

    def centres(self, tangent: TangentFrame) -> Array:
        """Positions as they are written, in the tangent frame (n, 3)."""
        return tangent_from_map(tangent, self.frame, self.positions)


@dataclass(frozen=True)
class Reading:
    """What reading orientations depends on besides their section."""

    project_file: Path
    field: str
    folder: Path
    crs: str
    heights: HeightSystem

    def error(self, key: str, rule: str, **more: object) -> ProjectError:
        """An error about a key of the section."""
        return ProjectError(rule, file=self.project_file, field=f"{self.field}.{key}", **more)  # type: ignore[arg-type]


def read_orientations(section: OrientationSection, reading: Reading) -> WrittenOrientations:
    """Read the orientations of a section.

    Raises
    ------
    ProjectError, FormatError, OrientationError, CrsError, HeightSystemError
        Naming the file, the key or column, the rule and the value.
    """
    if not section.orientation:
        raise reading.error(
            "orientation",
            "must be given",
            hint="the table of orientations, or reconstruction.json; stereomate orient makes one",
        )
    path = reading.folder / section.orientation
    kind = section.orientation_format
    if kind == "auto":
        kind = "opensfm" if path.suffix.lower() == ".json" else "table"
    if kind == "opensfm":
        written = _from_opensfm(section, reading, read_opensfm(path))
    else:
        table = read_orientation_table(path, section.columns, section.separator)
        written = _from_table(section, reading, table)
    # Strays are left out one by one later; a mistake in the declaration moves all.
    check_coordinates(written.frame, written.positions, "projection centres", path, tolerated=0.5)
    return written


def height_system(text: str | None, default: HeightSystem, reading: Reading, field: str) -> HeightSystem:
    """The height system a key declares, or the project's.

    Raises
    ------
    HeightSystemError, CrsError
        With file and key added to what the frames say about it.
    """
    if text is None or text == UNDECLARED:
        return default
    try:
        return HeightSystem.from_text(text, reading.folder)
    except InputError as error:
        raise named(error, reading.project_file, field) from error


def map_frame(crs: str, heights: HeightSystem, file: Path, field: str) -> MapFrame:
    """A map frame; an unknown CRS is reported with file and key."""
    try:
        return MapFrame(crs, heights)
    except InputError as error:
        raise named(error, file, field) from error


def named(error: InputError, file: Path, field: str) -> InputError:
    """The same error with the file and the key it came from."""
    # What the error was about first, if it said: the value, else the file (a missing geoid grid).
    value = error.value if error.value is not None else error.file
    more = {} if value is None else {"value": str(value) if value is error.file else value}
    return type(error)(error.rule, file=file, field=field, hint=error.hint, **more)


def _from_table(
    section: OrientationSection, reading: Reading, table: OrientationTable
) -> WrittenOrientations:
    notes: list[str] = []
    frame, columns = _position_frame(section, reading, table, notes)
    convention, angle_columns = _table_convention(section, reading, table, frame)
    attitudes = np.array([row.values(angle_columns) for row in table.rows])
    _require_possible_angles(table, attitudes, angle_columns, convention.unit)
    origin = None
    if convention.axes == "tangent" and section.origin is not None:
        origin = TangentFrame.at_geodetic(frame.geodetic, *section.origin)
    return WrittenOrientations(
        source=table.path,
        names=tuple(row.name for row in table.rows),
        frame=frame,
        positions=np.array([row.values(columns) for row in table.rows]),
        attitudes=attitudes,
        convention=convention,
        origin=origin,
        cameras=tuple(row.camera for row in table.rows),
        camera_values={},
        in_grid=not frame.is_geographic,
        notes=tuple(notes),
    )


def _position_frame(
    section: OrientationSection, reading: Reading, table: OrientationTable, notes: list[str]
) -> tuple[MapFrame, Sequence[str]]:
    heights = height_system(section.heights, reading.heights, reading, f"{reading.field}.heights")
    crs = section.crs
    if crs is None and not table.has(MAP_COLUMNS):
        crs = GNSS_CRS
        notes.append(f"{table.path.name}: longitude and latitude are taken as WGS 84 ({GNSS_CRS})")
    field = f"{reading.field}.crs" if section.crs else "project.crs"
    frame = map_frame(crs or reading.crs, heights, reading.project_file, field)
    columns = GEOGRAPHIC_COLUMNS if frame.is_geographic else MAP_COLUMNS
    if not table.has(columns):
        have = "x and y" if frame.is_geographic else "longitude and latitude"
        need = "longitude and latitude" if frame.is_geographic else "x and y"
        rule = f"needs {need}, but {table.path.name} has {have}"
        raise reading.error("crs", rule, value=crs or reading.crs)
    return frame, columns


def _table_convention(
    section: OrientationSection, reading: Reading, table: OrientationTable, frame: MapFrame
) -> tuple[AttitudeConvention, Sequence[str]]:
    opk, rpy = table.has(OPK_COLUMNS), table.has(RPY_COLUMNS)
    axes = section.angles
    if axes is None:
        if rpy and not opk:
            axes = "rph"
        else:
            hint = '"grid", "local" (east north up at each centre), "tangent" (with origin), or "rph"'
            raise reading.error("angles", "must say about which axes the angles are", hint=hint)
    wanted = RPY_COLUMNS if axes == "rph" else OPK_COLUMNS
    if not table.has(wanted):
        rule = f'is "{axes}", which needs the columns {", ".join(wanted)} in {table.path.name}'
        raise reading.error("angles", rule)
    if axes == "grid" or (axes == "rph" and section.north == "grid"):
        if frame.is_geographic:
            raise reading.error("angles", "cannot be about grid axes in a geographic CRS", value=frame.crs)
        frame.require_conformal()
    unit = _angle_unit(section, reading, table)
    if axes == "rph":
        omega, phi, kappa = section.boresight_deg or (0.0, 0.0, 0.0)
        boresight = (math.radians(omega), math.radians(phi), math.radians(kappa))
        north: AttitudeAxes = "grid_east_north" if section.north == "grid" else "local"
        return AttitudeConvention("rph", north, unit, section.mount, boresight), wanted
    kind: AttitudeKind = "opk" if section.angle_order == "omega-phi-kappa" else "pok"
    columns = wanted if kind == "opk" else ("phi", "omega", "kappa")
    return AttitudeConvention(kind, axes, unit), columns


def _angle_unit(section: OrientationSection, reading: Reading, table: OrientationTable) -> AngleUnit:
    written = table.angle_unit
    if written is None:
        return section.angle_unit
    if "angle_unit" in section.model_fields_set and section.angle_unit != written:
        rule = f'is "{section.angle_unit}", but the header of {table.path.name} says "{written}"'
        raise reading.error("angle_unit", rule)
    return written


def _require_possible_angles(
    table: OrientationTable, angles: Array, columns: Sequence[str], unit: AngleUnit
) -> None:
    turn = _FULL_TURN[unit]
    beyond = np.argwhere(np.abs(angles) > turn)
    if beyond.size:
        row, column = (int(index) for index in beyond[0])
        raise OrientationError(
            f"is beyond a full turn of {turn:g} {unit}: is the unit right?",
            file=table.path,
            field=f"line {table.rows[row].line}, {columns[column]}",
            value=float(angles[row, column]),
            hint='angle_unit = "deg", "gon", "rad" or "deg.mmss"',
        )


def _from_opensfm(
    section: OrientationSection, reading: Reading, model: OpenSfmReconstruction
) -> WrittenOrientations:
    for key in ("angles", "columns", "separator", "angle_unit", "angle_order", "origin"):
        if key in section.model_fields_set:
            raise reading.error(key, "has no meaning with a reconstruction.json: remove it")
    heights = height_system(section.heights, reading.heights, reading, f"{reading.field}.heights")
    field = f"{reading.field}.crs" if section.crs else "project.crs"
    grid = map_frame(section.crs or reading.crs, heights, reading.project_file, field)
    notes: list[str] = []
    frame_name = section.opensfm_frame
    if frame_name is None:
        evidence = frame_of(model, grid)
        frame_name = evidence.frame
        notes.append(f"{model.path.name}: {evidence.sentence}")
    local = np.array([shot.centre for shot in model.shots])
    if frame_name == "projected":
        grid.require_conformal()
        x, y = reference_in_map(model.reference, grid)
        frame, positions = grid, local + np.array([x, y, model.reference[2]])
        convention, origin = AttitudeConvention("matrix", "grid_east_north"), None
    else:
        origin = tangent_at(model.reference)
        frame = MapFrame(WGS84, heights)
        positions = origin.geodetic_from_tangent(local)
        convention = AttitudeConvention("matrix", "tangent")
    return WrittenOrientations(
        source=model.path,
        names=tuple(shot.name for shot in model.shots),
        frame=frame,
        positions=positions,
        attitudes=np.array([shot.object_from_camera for shot in model.shots]),
        convention=convention,
        origin=origin,
        cameras=tuple(shot.camera for shot in model.shots),
        camera_values=model.cameras,
        in_grid=frame_name == "projected",
        notes=tuple(notes),
    )


def tangent_frame_for(
    written: WrittenOrientations, frame: MapFrame, origin: tuple[float, float, float] | None
) -> TangentFrame:
    """The tangent frame of a block: at a stated origin, else below the middle of its centres."""
    if origin is not None:
        return TangentFrame.at_geodetic(frame.geodetic, *origin)
    lon, lat, _ = written.frame.geodetic_from_map(written.positions).mean(axis=0)
    # Rounded, so that the frame can be written down and does not move with a photograph more or less.
    return TangentFrame.at_geodetic(frame.geodetic, round(float(lon), 3), round(float(lat), 3), 0.0)
