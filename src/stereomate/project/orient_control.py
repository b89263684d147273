"""Control and check points of a block with their image measurements, in the tangent frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import ProjectError
from stereomate.formats.control_points import ControlFile, ControlPoint, read_control_points
from stereomate.formats.ign import read_ground_points
from stereomate.formats.image_points import ImageMeasurements, read_image_points
from stereomate.frames.checks import check_coordinates, check_height_units
from stereomate.frames.crs import WGS84
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import map_from_map, tangent_from_map
from stereomate.project.orientations import Reading, height_system, map_frame
from stereomate.project.schema import ProjectFile
from stereomate.terrain.model import HeightModel

Array = NDArray[np.float64]

DEFAULT_SIGMA_M: Final = (0.02, 0.02, 0.03)


@dataclass(frozen=True, eq=False)
class Control:
    """Control and check points of a block.

    Attributes
    ----------
    names : tuple of str
    frame : MapFrame
        CRS and heights of `xyz`.
    xyz : ndarray, shape (n, 3)
        As written; NaN for an axis that is not known.
    sigma_m : ndarray, shape (n, 3)
        East, north, up.
    check : ndarray of bool, shape (n,)
    measurements : ImageMeasurements or None
        Of these points in the photographs.
    measurement_sigma_px : float
        Of measurements for which the file states none.
    notes : tuple of str
    tangent_xyz : ndarray, shape (n, 3)
        In the tangent frame once `placed`; NaN for an axis that is not known.
    """

    names: tuple[str, ...]
    frame: MapFrame
    xyz: Array
    sigma_m: Array
    check: NDArray[np.bool_]
    measurements: ImageMeasurements | None
    measurement_sigma_px: float
    notes: tuple[str, ...]
    tangent_xyz: Array

    @property
    def is_placed(self) -> bool:
        """Whether `tangent_xyz` is known."""
        return bool(np.isfinite(self.tangent_xyz).any())

    def tangent(self, project: MapFrame) -> TangentFrame | None:
        """A tangent frame below the middle of the points that are known in plan.

        The median: a single point with swapped coordinates would carry a mean hundreds of kilometres away,
        where the axes of the frame are no longer east, north and up of the block.
        """
        plan = np.isfinite(self.xyz[:, :2]).all(axis=1)
        if not plan.any():
            return None
        points = np.nan_to_num(self.xyz[plan])
        lon, lat, _ = np.median(self.frame.geodetic_from_map(points), axis=0)
        return TangentFrame.at_geodetic(project.geodetic, round(float(lon), 3), round(float(lat), 3), 0.0)

    def placed(self, tangent: TangentFrame, project: MapFrame) -> Control:
        """The points in the tangent frame.

        An axis that is not known is filled in from the other points for the transformation and left out
        afterwards: within a block the vertical of the map and that of the tangent frame differ little.
        """
        known = np.isfinite(self.xyz)
        filled = self.xyz.copy()
        for axis in range(3):
            middle = float(np.median(self.xyz[known[:, axis], axis])) if known[:, axis].any() else 0.0
            filled[~known[:, axis], axis] = middle
        if not known[:, :2].any():
            # Heights alone: any place in the block will do.
            lon, lat, _ = tangent.geodetic_from_tangent(np.zeros(3))
            filled[:, :2] = self.frame.map_from_geodetic(np.array([lon, lat, 0.0]))[:2]
        placed = tangent_from_map(tangent, self.frame, filled)
        return replace(self, tangent_xyz=np.where(known, placed, np.nan))


def read_block_control(
    file: ProjectFile, path: Path, reading: Reading, photographs: Sequence[str]
) -> Control | None:
    """The control points of a project and their image measurements; None where it has none.

    Raises
    ------
    ProjectError
        If there are points but no image measurements of them, or a check point is none of them.
    FormatError, CrsError, HeightSystemError
        About the files.
    """
    section = file.control
    if section is None:
        return None
    source = path.parent / section.file
    table = control_table(source, section.columns, section.separator)
    notes: list[str] = []
    crs = section.crs or table.crs or (WGS84 if table.geographic else file.project.crs)
    if section.crs is None and table.crs:
        notes.append(f"{source.name}: CRS is {table.crs[:60]}, as the file states")
    heights = height_system(section.heights, reading.heights, reading, "control.heights")
    frame = map_frame(crs, heights, path, "control.crs" if section.crs else "project.crs")
    if frame.is_geographic != table.geographic and section.crs is None and not table.crs:
        raise ProjectError("must say the CRS of the points", file=path, field="control.crs")
    names = tuple(point.name for point in table.points)
    # A few wrong points are named once the photographs tell which; here only a file wrong as a whole.
    check_coordinates(frame, [point.xyz for point in table.points], "control points", source, tolerated=0.5)
    strange = sorted(set(section.check) - set(names))
    if strange:
        raise ProjectError("must name points of the file", file=path, field="control.check", value=strange[0])
    measurements = table.measurements
    if section.measurements is not None:
        measurements = read_image_points(path.parent / section.measurements)
    if measurements is None:
        raise ProjectError(
            "must be given: nothing says where the control points are in the photographs",
            file=path,
            field="control.measurements",
        )
    default = np.array(section.sigma_m or DEFAULT_SIGMA_M)
    stated = np.array([point.sigma_m for point in table.points])
    if section.sigma_m is None and not np.isfinite(stated).all():
        notes.append(
            "control points without a stated standard deviation get "
            f"{', '.join(f'{v:g}' for v in DEFAULT_SIGMA_M)} m (x, y, z)"
        )
    notes += _unused(measurements, names, photographs)
    return Control(
        names,
        frame,
        np.array([point.xyz for point in table.points]),
        np.where(np.isfinite(stated), stated, default),
        np.array([point.check or point.name in section.check for point in table.points]),
        measurements,
        section.measurement_sigma_px,
        tuple(notes),
        np.full((len(names), 3), math.nan),
    )


def check_control_units(file: ProjectFile, path: Path, frame: MapFrame, model: HeightModel) -> None:
    """Refuse control points whose heights are in another unit than the height model's.

    Raises
    ------
    HeightSystemError
        If most are 3.28 times the height model below them, or the reverse.
    ProjectError, FormatError, CrsError
        About the file of the points.
    """
    section = file.control
    if section is None:
        return
    source = path.parent / section.file
    table = control_table(source, section.columns, section.separator)
    reading = Reading(path, "control", path.parent, file.project.crs, frame.heights)
    crs = section.crs or table.crs or (WGS84 if table.geographic else file.project.crs)
    heights = height_system(section.heights, reading.heights, reading, "control.heights")
    own = map_frame(crs, heights, path, "control.crs" if section.crs else "project.crs")
    xyz = np.array([point.xyz for point in table.points])
    xyz = xyz[np.isfinite(xyz).all(axis=1)]
    if len(xyz):
        there = map_from_map(model.frame, own, xyz)
        check_height_units(there[:, 2], model.heights_at(there[:, :2]), "the control points", source)


def control_table(source: Path, columns: Sequence[str] | None, separator: str | None) -> ControlFile:
    """Points of a table, a vector file, a list of OpenDroneMap, or an IGN ``.app`` or ``.mes`` file."""
    if columns is None and source.suffix.lower() in (".app", ".mes"):
        points = read_ground_points(source)
        return ControlFile(
            source,
            tuple(
                ControlPoint(name, (float(x), float(y), float(z)))
                for name, (x, y, z) in zip(points.names, points.xyz, strict=True)
            ),
        )
    return read_control_points(source, columns, separator)


def _unused(measurements: ImageMeasurements, names: Sequence[str], photographs: Sequence[str]) -> list[str]:
    known = {*photographs, *(Path(name).stem for name in photographs)}
    strange = sorted({p for p in measurements.photographs if p not in known and Path(p).stem not in known})
    measured = set(measurements.points)
    notes = []
    if strange:
        notes.append(
            f"{measurements.path.name}: {len(strange)} photographs are not in the project: "
            + ", ".join(strange[:5])
        )
    missing = [name for name in names if name not in measured]
    if missing:
        notes.append(f"{len(missing)} control points are measured nowhere: {', '.join(missing[:5])}")
    return notes
