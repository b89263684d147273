"""Orthority's exterior parameters: CSV with x, y, z, omega, phi, kappa in degrees, and GeoJSON in radians.

Positions are in the world CRS and its heights; angles are about the axes of that CRS taken as Cartesian, R =
Rx(omega) Ry(phi) Rz(kappa) from camera axes (x right, y up, z backwards). The GeoJSON states the CRS in
``world_crs``; the CSV may have a ``.prj`` of the same name beside it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from stereomate.errors import FormatError
from stereomate.formats.declared import Declared
from stereomate.formats.orientation_set import OrientationSet
from stereomate.formats.orientation_table import MAP_COLUMNS, OPK_COLUMNS, read_orientation_table
from stereomate.formats.text_files import read_text, write_text
from stereomate.frames.attitude import AttitudeConvention, axes_from_camera, written_from_axes
from stereomate.frames.crs import WGS84
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.transform import map_from_map

_DEGREES: Final = AttitudeConvention("opk", "grid", "deg")
_RADIANS: Final = AttitudeConvention("opk", "grid", "rad")


def read_orthority_csv(path: Path, declared: Declared) -> OrientationSet:
    """Read a CSV of x, y, z, omega, phi, kappa.

    Parameters
    ----------
    path : Path
    declared : Declared
        The world CRS, unless a ``.prj`` lies beside the file; its heights.

    Raises
    ------
    FormatError
        If it is no such file. A CSV of latitude, longitude, roll, pitch, yaw is read as a table.
    """
    table = read_orientation_table(path)
    if not table.has((*MAP_COLUMNS, *OPK_COLUMNS)):
        rule = "must have the columns x, y, z, omega, phi, kappa"
        hint = "latitude, longitude, roll, pitch, yaw: read it as a table and declare the mount"
        raise FormatError(rule, file=path, value=list(table.columns), hint=hint)
    beside = path.with_suffix(".prj")
    default = read_text(beside).strip() if declared.crs is None and beside.is_file() else None
    place = declared.require_map(path, default)
    angles = np.array([row.values(OPK_COLUMNS) for row in table.rows])
    declared.require_unit(path, angles, table.angle_unit or "deg")
    notes = [
        f"{path.name}: angles are omega-phi-kappa in degrees about the axes of the map (orthority's format)"
    ]
    if default is not None:
        notes.append(f"{path.name}: its CRS is read from {beside.name}")
    return OrientationSet(
        tuple(row.name for row in table.rows),
        np.array([row.values(MAP_COLUMNS) for row in table.rows]) + declared.offset,
        axes_from_camera(angles, _DEGREES),
        place,
        declared.axes or "grid",
        tuple(row.camera for row in table.rows),
        notes=tuple(notes),
    )


def write_orthority_csv(path: Path, orientations: OrientationSet, declared: Declared) -> tuple[str, ...]:
    """Write the CSV and a ``.prj`` with its CRS beside it; returns notes."""
    angles = written_from_axes(orientations.rotations, _DEGREES)
    centres = orientations.positions - np.array(declared.offset)
    lines = ["filename,x,y,z,omega,phi,kappa,camera"]
    for name, centre, opk, camera in zip(
        orientations.names, centres, angles, orientations.cameras, strict=True
    ):
        numbers = (*(f"{v:.6f}" for v in centre), *(f"{v:.12f}" for v in opk))
        lines.append(",".join((_quoted(name), *numbers, _quoted(camera or ""))))
    write_text(path, "\n".join(lines) + "\n")
    if isinstance(orientations.place, MapFrame):
        write_text(path.with_suffix(".prj"), orientations.place.crs + "\n")
    return (f"the CRS is written beside it, into {path.with_suffix('.prj').name}",)


def read_orthority_geojson(path: Path, declared: Declared) -> OrientationSet:
    """Read a GeoJSON of exterior parameters.

    Parameters
    ----------
    path : Path
    declared : Declared
        Heights; the CRS only where the file states none.

    Raises
    ------
    FormatError
        If it is no such file; the feature and property are named.
    """
    try:
        document = json.loads(read_text(path))
    except json.JSONDecodeError as error:
        raise FormatError(f"must be JSON: {error.msg} at line {error.lineno}", file=path) from error
    features = document.get("features") if isinstance(document, dict) else None
    if not isinstance(features, list) or not features:
        raise FormatError("must be a FeatureCollection with features", file=path)
    world = document.get("world_crs")
    if world is not None and not isinstance(world, str):
        raise FormatError("must be text", file=path, field="world_crs", value=world)
    place = declared.require_map(path, world)
    names, xyz, opk, cameras = [], [], [], []
    for number, feature in enumerate(features):
        properties = feature.get("properties") if isinstance(feature, dict) else None
        field = f"features[{number}].properties"
        if not isinstance(properties, dict) or not isinstance(properties.get("filename"), str):
            raise FormatError("must have a filename", file=path, field=field)
        names.append(properties["filename"])
        xyz.append(_three(path, f"{field}.xyz", properties.get("xyz")))
        opk.append(_three(path, f"{field}.opk", properties.get("opk")))
        camera = properties.get("camera")
        cameras.append(None if camera is None else str(camera))
    angles = np.array(opk)
    declared.require_unit(path, angles, "rad")
    return OrientationSet(
        tuple(names),
        np.array(xyz) + declared.offset,
        axes_from_camera(angles, _RADIANS),
        place,
        declared.axes or "grid",
        tuple(cameras),
        notes=(f"{path.name}: angles are about the axes of world_crs (orthority's format)",),
    )


def write_orthority_geojson(path: Path, orientations: OrientationSet, declared: Declared) -> tuple[str, ...]:
    """Write the GeoJSON; returns notes.

    Raises
    ------
    FormatError
        If the positions are not map coordinates.
    """
    if not isinstance(orientations.place, MapFrame):
        raise FormatError("holds map coordinates only", file=path, field="crs")
    angles = written_from_axes(orientations.rotations, _RADIANS)
    centres = orientations.positions - np.array(declared.offset)
    # The points are for the eye: longitude and latitude, and the height as it is.
    world = MapFrame(orientations.place.crs, HeightSystem.undeclared())
    points = map_from_map(MapFrame(WGS84, HeightSystem.undeclared()), world, orientations.positions)
    features = [
        {
            "type": "Feature",
            "properties": {"filename": name, "camera": camera, "xyz": list(xyz), "opk": list(opk)},
            "geometry": {"type": "Point", "coordinates": list(point)},
        }
        for name, camera, xyz, opk, point in zip(
            orientations.names,
            orientations.cameras,
            centres.tolist(),
            angles.tolist(),
            points.tolist(),
            strict=True,
        )
    ]
    document: Mapping[str, Any] = {
        "type": "FeatureCollection",
        "world_crs": orientations.place.crs,
        "features": features,
    }
    write_text(path, json.dumps(document, indent=1, ensure_ascii=False) + "\n")
    return ()


def _three(path: Path, field: str, value: Any) -> list[float]:
    numbers = isinstance(value, list) and len(value) == 3
    if not numbers or not all(
        isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v) for v in value
    ):
        raise FormatError("must be 3 numbers", file=path, field=field, value=value)
    return [float(v) for v in value]


def _quoted(text: str) -> str:
    return '"' + text.replace('"', '""') + '"' if any(c in text for c in ",\"'") else text
