"""Tables of positions measured in orthophoto and stereomate, and of the points that come of them."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyogrio
import shapely
from numpy.typing import NDArray

from stereomate.errors import FormatError, StorageError
from stereomate.formats.vector import read_features
from stereomate.raster.files import storing, write_whole

Floats = NDArray[np.float64]

COLUMNS: Final = ("left_x", "left_y", "right_x", "right_y")


@dataclass(frozen=True, eq=False)
class MeasuredPairs:
    """Names and map positions (n, 2) on the orthophoto (left) and on the stereomate (right)."""

    names: tuple[str, ...]
    left: Floats
    right: Floats


def read_measured_pairs(path: Path) -> MeasuredPairs:
    """Read a CSV or GeoPackage with the columns left_x, left_y, right_x, right_y and perhaps name.

    Raises
    ------
    FormatError
        If a column is missing or a value is no number, with its row.
    """
    if path.suffix.lower() == ".csv":
        rows = _csv_rows(path)
    else:
        rows = [dict(feature.attributes) for feature in read_features(path).features]
    if not rows:
        raise FormatError("holds no row", file=path)
    missing = [name for name in COLUMNS if name not in rows[0]]
    if missing:
        raise FormatError(
            f"must have the columns {', '.join(COLUMNS)}", file=path, field="columns", value=list(rows[0])
        )
    values = np.array([[_number(path, k, name, row) for name in COLUMNS] for k, row in enumerate(rows)])
    names = tuple(str(row.get("name") or k + 1) for k, row in enumerate(rows))
    return MeasuredPairs(names, values[:, :2], values[:, 2:])


def _csv_rows(path: Path) -> list[dict[str, Any]]:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as error:
        raise FormatError("does not exist", file=path) from error
    except UnicodeDecodeError as error:
        raise FormatError("must be text in UTF-8", file=path) from error
    delimiter = ";" if text.split("\n", 1)[0].count(";") >= len(COLUMNS) - 1 else ","
    rows = csv.DictReader(io.StringIO(text), delimiter=delimiter)
    return [{str(key).strip().lower(): value for key, value in row.items()} for row in rows]


def _number(path: Path, index: int, name: str, row: Mapping[str, Any]) -> float:
    try:
        value = float(row[name])
    except (TypeError, ValueError):
        value = math.nan
    if not math.isfinite(value):
        raise FormatError("must be a number", file=path, field=f"row {index + 1}: {name}", value=row[name])
    return value


def write_points(
    path: Path, columns: Mapping[str, Sequence[Any]], points: Floats, crs: str, layer: str = "measured"
) -> None:
    """Write measured points as CSV or GeoPackage by the suffix, whole or not at all.

    Parameters
    ----------
    columns : mapping
        All columns, the coordinates among them; NaN is written as an empty value.
    points : (n, 3)
        Geometry of the GeoPackage.

    Raises
    ------
    FormatError
        If the suffix is neither .csv nor .gpkg.
    StorageError
        If the file cannot be written.
    """
    suffix = path.suffix.lower()
    with storing(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
    if suffix == ".csv":
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(columns)
        for row in zip(*columns.values(), strict=True):
            writer.writerow([_text(value) for value in row])
        write_whole(path, [out.getvalue().encode()])
    elif suffix == ".gpkg":
        _write_geopackage(path, columns, points, crs, layer)
    else:
        raise FormatError("must end in .csv or .gpkg", file=path)


def _text(value: Any) -> str:
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{value:.4f}"
    return str(value)


def _write_geopackage(
    path: Path, columns: Mapping[str, Sequence[Any]], points: Floats, crs: str, layer: str
) -> None:
    shapes = [shapely.Point(p) if np.isfinite(p).all() else None for p in points]
    data = [
        np.array(values, np.object_) if isinstance(values[0], str) else np.array(values)
        for values in map(list, columns.values())
    ]
    unfinished = path.with_name(f".{path.name}.part.gpkg")
    try:
        pyogrio.raw.write(
            unfinished, shapely.to_wkb(shapes, output_dimension=3), data, list(columns), layer=layer,
            driver="GPKG", geometry_type="Point Z", crs=crs,
        )  # fmt: skip
        os.replace(unfinished, path)
    except OSError as error:
        raise StorageError(f"{path}: cannot be written ({error.strerror})") from error
    finally:
        unfinished.unlink(missing_ok=True)
