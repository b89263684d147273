"""Control and check points with their standard deviations: delimited text, CSV, vector files, ODM's list.

A table has a header: ``name``, ``x``, ``y``, ``z`` (or ``longitude``, ``latitude``, ``height``; an empty cell
is an axis that is not known), and perhaps ``sx``, ``sy``, ``sz`` (or ``sxy``), ``sigma`` and ``role``
(``control`` or ``check``; ``xy`` or ``z`` for control in some axes only). A vector file has the same names as
attributes of points. ODM's ``gcp_list.txt`` states its CRS in the first line and one image measurement in
every other: x y z column row photograph [name].
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely
from numpy.typing import NDArray

from stereomate.errors import FormatError
from stereomate.formats.image_points import ImageMeasurements
from stereomate.formats.text_files import read_text
from stereomate.formats.vector import read_features

Array = NDArray[np.float64]

_WORDS: Final = {
    "name": "name point pointname pointid id label gcp gcpname nom number nr punkt punktnummer",
    "x": "x e east easting geox rechts rechtswert",
    "y": "y n north northing geoy hoch hochwert",
    "z": "z h height alt altitude elevation hoehe geoz",
    "longitude": "longitude lon long lng",
    "latitude": "latitude lat",
    "sx": "sx sigmax stdx sigmae stde xaccuracy accuracyx sdx mx",
    "sy": "sy sigmay stdy sigman stdn yaccuracy accuracyy sdy my",
    "sz": "sz sigmaz stdz sigmah stdh zaccuracy accuracyz sdz mz",
    "sxy": "sxy sigmaxy stdxy horizontalaccuracy planaccuracy",
    "sigma": "sigma std accuracy stddev",
    "role": "role kind type use usage",
    "check": "check checkpoint ischeck",
}
_COLUMN_OF: Final = {word: column for column, words in _WORDS.items() for word in words.split()}
_CHECK: Final = {"check", "checkpoint", "cp", "chk", "kontroll", "true", "yes", "1"}
_PLAN_ONLY: Final = {"xy", "plan", "horizontal", "2d"}
_HEIGHT_ONLY: Final = {"z", "height", "vertical", "1d"}
_FULL: Final = {"", "control", "gcp", "full", "xyz", "3d", "false", "no", "0"}
_VECTOR: Final = {".gpkg", ".geojson", ".json", ".shp", ".fgb"}


@dataclass(frozen=True)
class ControlPoint:
    """A point known on the ground.

    Attributes
    ----------
    name : str
    xyz : (float, float, float)
        In the CRS and heights of the file; NaN for an axis that is not known.
    sigma_m : (float, float, float)
        Standard deviations; NaN where the file states none.
    check : bool
        Compared with the result only, never part of the adjustment.
    """

    name: str
    xyz: tuple[float, float, float]
    sigma_m: tuple[float, float, float] = (math.nan, math.nan, math.nan)
    check: bool = False


@dataclass(frozen=True, eq=False)
class ControlFile:
    """Points of a file, the CRS it states ("" if none), and the image measurements it holds, if any."""

    path: Path
    points: tuple[ControlPoint, ...]
    crs: str = ""
    geographic: bool = False
    measurements: ImageMeasurements | None = None


def read_control_points(
    path: Path, columns: Sequence[str] | None = None, separator: str | None = None
) -> ControlFile:
    """Read control and check points.

    Parameters
    ----------
    path : Path
    columns : sequence of str, optional
        Names of the columns of a table without a header.
    separator : str, optional
        Found out if absent: tab, semicolon, comma, else blanks.

    Raises
    ------
    FormatError
        Naming file, line, column and value: a value that is no number, a point twice, a standard deviation
        that is not positive, a point without any coordinate.
    """
    if path.suffix.lower() in _VECTOR:
        return _of_vector(path)
    text = read_text(path)
    if columns is None and _is_gcp_list(text):
        return _of_gcp_list(path, text)
    return _of_table(path, text, columns, separator)


def _of_table(path: Path, text: str, columns: Sequence[str] | None, separator: str | None) -> ControlFile:
    lines = [
        (number, line)
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not lines:
        raise FormatError("holds no point", file=path)
    separator = separator or next((s for s in "\t;," if s in lines[0][1]), " ")
    rows = [(number, _cells(line, separator)) for number, line in lines]
    names = list(columns) if columns is not None else rows.pop(0)[1]
    found = [_COLUMN_OF.get(re.sub(r"[^a-z]", "", re.sub(r"[\[(].*", "", name.lower()))) for name in names]
    _require_columns(path, names, found)
    points = []
    for number, cells in rows:
        if len(cells) > len(found):
            raise FormatError(
                f"has {len(cells)} values for {len(found)} columns", file=path, field=f"line {number}"
            )
        values = {c: cell for c, cell in zip(found, cells, strict=False) if c is not None}
        points.append(_point(path, f"line {number}", values))
    return _checked(path, points, "", "longitude" in found)


def _cells(line: str, separator: str) -> list[str]:
    if separator == " ":
        return [a or b for a, b in re.findall(r"\"([^\"]*)\"|(\S+)", line)]
    return [cell.strip() for cell in next(csv.reader(io.StringIO(line), delimiter=separator))]


def _require_columns(path: Path, names: Sequence[str], found: Sequence[str | None]) -> None:
    twice = sorted({c for c in found if c is not None and found.count(c) > 1})
    if twice:
        raise FormatError(f"has the column {twice[0]} twice", file=path, field="columns", value=list(names))
    has = set(found)
    plan = {"x", "y"} <= has or {"longitude", "latitude"} <= has
    if "name" not in has or not (plan or "z" in has):
        raise FormatError(
            "must have the columns name, x, y, z (or longitude, latitude, height)",
            file=path,
            field="columns",
            value=list(names),
            hint="control.columns names the columns of a file without a header",
        )


def _of_vector(path: Path) -> ControlFile:
    layer = read_features(path)
    points = []
    for number, feature in enumerate(layer.features, 1):
        values: dict[str, Any] = {}
        for name, value in feature.attributes.items():
            column = _COLUMN_OF.get(re.sub(r"[^a-z]", "", name.lower()))
            if column is not None and value is not None:
                values.setdefault(column, value)
        if not isinstance(feature.geometry, shapely.Point):
            raise FormatError(
                "must hold points", file=path, field=f"feature {number}", value=feature.geometry.geom_type
            )
        # The geometry is the position; an attribute may state the height of a flat one.
        values["x"], values["y"] = feature.geometry.x, feature.geometry.y
        if feature.geometry.has_z:
            values["z"] = feature.geometry.z
        values.setdefault("name", str(number))
        points.append(_point(path, f"feature {number}", values))
    return _checked(path, points, layer.crs, False)


def _point(path: Path, where: str, values: Mapping[str, Any]) -> ControlPoint:
    def number(column: str) -> float:
        return _number(path, where, column, values.get(column))

    geographic = "longitude" in values
    plan = ("longitude", "latitude") if geographic else ("x", "y")
    xyz = [number(plan[0]), number(plan[1]), number("z")]
    sigma = [number(column) for column in ("sx", "sy", "sz")]
    both, every = number("sxy"), number("sigma")
    sigma = [
        first if math.isfinite(first) else (both if axis < 2 and math.isfinite(both) else every)
        for axis, first in enumerate(sigma)
    ]
    for axis, value in zip("xyz", sigma, strict=True):
        if math.isfinite(value) and not value > 0.0:
            raise FormatError("must be positive", file=path, field=f"{where}: s{axis}", value=value)
    role = str(values.get("role") or "").strip().lower()
    check = role in _CHECK or str(values.get("check") or "").strip().lower() in _CHECK
    if role in _PLAN_ONLY:
        xyz[2] = math.nan
    elif role in _HEIGHT_ONLY:
        xyz[:2] = [math.nan, math.nan]
    elif role not in _FULL and not check:
        raise FormatError("must be control, check, xy or z", file=path, field=f"{where}: role", value=role)
    if math.isfinite(xyz[0]) != math.isfinite(xyz[1]):
        raise FormatError("must have both plan coordinates or none", file=path, field=where)
    if not any(math.isfinite(value) for value in xyz):
        raise FormatError("must have a coordinate", file=path, field=where)
    name = str(values.get("name") or "").strip()
    if not name:
        raise FormatError("must have a name", file=path, field=where)
    return ControlPoint(name, (xyz[0], xyz[1], xyz[2]), (sigma[0], sigma[1], sigma[2]), check)


def _number(path: Path, where: str, column: str, value: Any) -> float:
    """A number; NaN for an empty cell or a dash."""
    if value is None or str(value).strip() in ("", "-", "nan", "NaN"):
        return math.nan
    try:
        result = float(value)
    except (TypeError, ValueError):
        result = math.inf
    if math.isinf(result):
        raise FormatError("must be a number", file=path, field=f"{where}: {column}", value=value)
    return result


def _checked(path: Path, points: Sequence[ControlPoint], crs: str, geographic: bool) -> ControlFile:
    if not points:
        raise FormatError("holds no point", file=path)
    seen: set[str] = set()
    for point in points:
        if point.name in seen:
            raise FormatError("names a point twice", file=path, value=point.name)
        seen.add(point.name)
    return ControlFile(path, tuple(points), crs, geographic)


def _is_gcp_list(text: str) -> bool:
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if len(lines) < 2:
        return False
    head = lines[0].strip()
    is_crs = re.match(r"(?i)(epsg:\d+|\+proj=|wgs ?84|[A-Z]+CRS\[)", head) is not None
    cells = lines[1].split()
    return is_crs and len(cells) >= 6 and all(_is_number(cell) for cell in cells[:5])


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _of_gcp_list(path: Path, text: str) -> ControlFile:
    lines = [
        (number, line.strip())
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    crs = _crs_of_odm(path, lines[0][1])
    points: dict[str, ControlPoint] = {}
    of_place: dict[tuple[float, float, float], str] = {}
    rows: list[tuple[str, str, float, float]] = []
    for number, line in lines[1:]:
        cells = line.split()
        if len(cells) < 6:
            raise FormatError(
                "must hold x y z column row photograph [name]", file=path, field=f"line {number}", value=line
            )
        names = ("x", "y", "z", "column", "row")
        x, y, z, col, row = (
            _number(path, f"line {number}", name, cell) for name, cell in zip(names, cells[:5], strict=True)
        )
        name = cells[6] if len(cells) > 6 else of_place.setdefault((x, y, z), f"gcp{len(of_place) + 1}")
        point = points.setdefault(name, ControlPoint(name, (x, y, z)))
        if not np.array_equal(np.array(point.xyz), np.array((x, y, z)), equal_nan=True):
            raise FormatError(
                f"gives point {name} other coordinates than before",
                file=path,
                field=f"line {number}",
                value=(x, y, z),
            )
        rows.append((name, cells[5], col, row))
    measurements = ImageMeasurements.from_rows(path, rows)
    geographic = crs.upper() in ("EPSG:4326", "EPSG:4979") or "+proj=longlat" in crs
    return ControlFile(path, tuple(points.values()), crs, geographic, measurements)


def _crs_of_odm(path: Path, text: str) -> str:
    """``EPSG:n`` or a PROJ string as it is; ``WGS84 UTM 32N`` as its code."""
    found = re.fullmatch(r"(?i)wgs ?84\s+utm\s+(\d{1,2})\s*([NS])", text)
    if found:
        zone = int(found[1])
        if not 1 <= zone <= 60:
            raise FormatError("must be a UTM zone from 1 to 60", file=path, field="line 1", value=text)
        return f"EPSG:{(32600 if found[2].upper() == 'N' else 32700) + zone}"
    return text
