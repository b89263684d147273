"""Tables of points for the instrument: image coordinates of both photographs, or points of a terrain."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import FormatError

FloatArray = NDArray[np.float64]

IMAGE_COLUMNS: Final = ("point", "x_left", "y_left", "x_right", "y_right")
TERRAIN_COLUMNS: Final = ("point", "x", "y", "h")


@dataclass(frozen=True)
class PointTable:
    """Points read from a table.

    Attributes
    ----------
    kind : {"image", "terrain"}
        Image coordinates in both photographs (x right, y up, in mm), or places in the model (x along the base
        from the left projection centre, y across, h height above the level of the flying height, metres).
    names : tuple of str
    values : ndarray (n, 4) or (n, 3)
    """

    kind: Literal["image", "terrain"]
    names: tuple[str, ...]
    values: FloatArray


def read_point_table(text: str, name: str) -> PointTable:
    """Read a table with a heading line, comma separated; lines beginning with # are skipped.

    Parameters
    ----------
    text : str
        Columns ``point, x_left, y_left, x_right, y_right`` or ``point, x, y, h``, in any order.
    name : str
        Of the file, for messages.

    Raises
    ------
    FormatError
        If columns are missing or unknown, a value is no finite number, a name comes twice, or there are fewer
        than five points.
    """
    lines = [
        line
        for line in text.lstrip("\ufeff").splitlines()
        if line.strip() and not line.lstrip().startswith("#")
    ]
    reader = csv.DictReader(io.StringIO("\n".join(lines)), skipinitialspace=True)
    columns = tuple(column.strip() for column in reader.fieldnames or ())
    reader.fieldnames = list(columns)
    kind: Literal["image", "terrain"]
    wanted: tuple[str, ...]
    if set(columns) == set(IMAGE_COLUMNS):
        kind, wanted = "image", IMAGE_COLUMNS
    elif set(columns) == set(TERRAIN_COLUMNS):
        kind, wanted = "terrain", TERRAIN_COLUMNS
    else:
        raise FormatError(
            f"must have the columns {', '.join(IMAGE_COLUMNS)} or {', '.join(TERRAIN_COLUMNS)}",
            file=name,
            field="heading",
            value=", ".join(columns),
        )
    rows = list(reader)
    names = tuple((row["point"] or "").strip() for row in rows)
    values = [
        [_number(row[column], name, point, column) for column in wanted[1:]]
        for point, row in zip(names, rows, strict=True)
    ]
    if len(rows) < 5:
        raise FormatError("must have five points or more", file=name, value=len(rows))
    for point in names:
        if not point or names.count(point) > 1:
            raise FormatError("must be names that come once", file=name, field="point", value=point)
    return PointTable(kind, names, np.array(values))


def _number(text: str | None, name: str, point: str, column: str) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise FormatError("must be a finite number", file=name, field=f"point {point}, {column}", value=text)
    return value
