"""Tables of measured points: coordinates in both photographs (mm or pixels), or points of a terrain."""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import FormatError

FloatArray = NDArray[np.float64]
Kind = Literal["image", "pixels", "terrain"]

COLUMNS: Final[dict[Kind, tuple[str, ...]]] = {
    "image": ("point", "x_left", "y_left", "x_right", "y_right"),
    "pixels": ("point", "col_left", "row_left", "col_right", "row_right"),
    "terrain": ("point", "x", "y", "h"),
}
WEIGHT: Final = "weight"


@dataclass(frozen=True)
class PointTable:
    """Points read from a table.

    Attributes
    ----------
    kind : {"image", "pixels", "terrain"}
        Image coordinates in both photographs (x right, y up, in mm, from the principal point), pixels of both
        (column, row), or places in the model (x along the base from the left projection centre, y across,
        h height above the level of the flying height, metres).
    names : tuple of str
    values : ndarray (n, 4) or (n, 3)
    weights : ndarray (n,) or None
        From a column ``weight``, if there is one.
    """

    kind: Kind
    names: tuple[str, ...]
    values: FloatArray
    weights: FloatArray | None = None


def load_point_table(path: Path, kinds: tuple[Kind, ...] = get_args(Kind)) -> PointTable:
    """Read the table of a file; see `read_point_table`."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise FormatError("must be a readable text file", file=path) from error
    return read_point_table(text, str(path), kinds)


def read_point_table(text: str, name: str, kinds: tuple[Kind, ...] = get_args(Kind)) -> PointTable:
    """Read a table with a heading line, comma separated; lines beginning with # are skipped.

    Parameters
    ----------
    text : str
        Columns of one of the kinds, in any order, and perhaps ``weight``.
    name : str
        Of the file, for messages.
    kinds : tuple of str
        Kinds that can be used.

    Raises
    ------
    FormatError
        If columns are missing or unknown, a value is no finite number, a name comes twice, there are fewer
        than five points, or two points have the same coordinates.
    """
    lines = [
        line
        for line in text.lstrip("\ufeff").splitlines()
        if line.strip() and not line.lstrip().startswith("#")
    ]
    reader = csv.DictReader(io.StringIO("\n".join(lines)), skipinitialspace=True)
    columns = tuple(column.strip() for column in reader.fieldnames or ())
    reader.fieldnames = list(columns)
    kind = _kind(columns, name, kinds)
    rows = list(reader)
    names = tuple((row["point"] or "").strip() for row in rows)
    values = [
        [_number(row[column], name, point, column) for column in COLUMNS[kind][1:]]
        for point, row in zip(names, rows, strict=True)
    ]
    if len(rows) < 5:
        raise FormatError("must have five points or more", file=name, value=len(rows))
    times = Counter(names)
    for point in names:
        if not point or times[point] > 1:
            raise FormatError("must be names that come once", file=name, field="point", value=point)
    _require_different(names, values, name)
    weights = None
    if WEIGHT in columns:
        weights = np.array(
            [_number(row[WEIGHT], name, p, WEIGHT) for p, row in zip(names, rows, strict=True)]
        )
        if not (weights > 0.0).all():
            worst = int(np.argmin(weights))
            raise FormatError(
                "must be positive", file=name, field=f"point {names[worst]}, {WEIGHT}", value=weights[worst]
            )
    return PointTable(kind, names, np.array(values), weights)


def _kind(columns: tuple[str, ...], name: str, kinds: tuple[Kind, ...]) -> Kind:
    for kind in kinds:
        if len(set(columns)) == len(columns) and set(columns) - {WEIGHT} == set(COLUMNS[kind]):
            return kind
    choices = " or ".join(", ".join(COLUMNS[kind]) for kind in kinds)
    raise FormatError(
        f"must have the columns {choices}", file=name, field="heading", value=", ".join(columns)
    )


def _require_different(names: tuple[str, ...], values: list[list[float]], name: str) -> None:
    """A copy under another name is no second measurement: it would make everything look better known."""
    seen: dict[tuple[float, ...], str] = {}
    for point, row in zip(names, values, strict=True):
        first = seen.setdefault(tuple(row), point)
        if first != point:
            raise FormatError(
                "must be measured points, each once",
                file=name,
                field=f"point {point}",
                value=f"the coordinates of point {first}",
            )


def _number(text: str | None, name: str, point: str, column: str) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise FormatError("must be a finite number", file=name, field=f"point {point}, {column}", value=text)
    return value
