"""Orientations as delimited text: columns in any order, any usual separator, named by a header.

One row is one photograph: its name, its position (x, y, z of a map grid, or longitude, latitude, height) and
three angles (omega, phi, kappa or roll, pitch, yaw). What the numbers mean (CRS, height system, axes and unit
of the angles) is not in such a file and has to be declared by whoever reads it.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from stereomate.errors import FormatError, OrientationError
from stereomate.units import AngleUnit

NAME: Final = "filename"
MAP_COLUMNS: Final = ("x", "y", "z")
GEOGRAPHIC_COLUMNS: Final = ("longitude", "latitude", "z")
OPK_COLUMNS: Final = ("omega", "phi", "kappa")
RPY_COLUMNS: Final = ("roll", "pitch", "yaw")
CAMERA: Final = "camera"
OTHER: Final = "other"

# Written name (lower case, letters only, unit removed) -> column.
_SYNONYMS: Final = {
    NAME: "filename file name nom image imagename imageid photo photoid photoname label img point pointid",
    "x": "x easting east e x0 xl xeasting ox",
    "y": "y northing north n y0 yl ynorthing oy",
    "z": "z height h altitude alt elevation z0 zl zaltitude oz ellipsoidalheight",
    "longitude": "longitude lon long lng",
    "latitude": "latitude lat",
    "omega": "omega w om o ω",
    "phi": "phi p ph φ",
    "kappa": "kappa k kap κ",
    "roll": "roll r",
    "pitch": "pitch",
    "yaw": "yaw heading",
    CAMERA: "camera cameraid cameraname",
}
_COLUMN_OF: Final = {word: column for column, words in _SYNONYMS.items() for word in words.split()}
_UNITS: Final[dict[str, AngleUnit]] = {
    "deg": "deg",
    "degree": "deg",
    "degrees": "deg",
    "°": "deg",
    "gon": "gon",
    "grad": "gon",
    "gons": "gon",
    "rad": "rad",
    "radian": "rad",
    "radians": "rad",
}
_SEPARATORS: Final = ("\t", ";", ",", "|")
_TOKEN: Final = re.compile(r"'([^']*)'|\"([^\"]*)\"|(\S+)")
# r11 to r33 of a rotation matrix beside the angles (Metashape) are no roll.
_MATRIX_ELEMENT: Final = re.compile(r"[rm][1-3][1-3]\W*$", re.IGNORECASE)
_UNIT_IN_HEADER: Final = re.compile(r"[\[(]\s*([^\])]*?)\s*[\])]|[_ ](deg|gon|rad)\s*$", re.IGNORECASE)


@dataclass(frozen=True)
class OrientationRow:
    """One photograph of a table, as written.

    Attributes
    ----------
    name : str
        The photograph, as the file names it.
    numbers : mapping of str to float
        Values by column: x, y, z, longitude, latitude, omega, phi, kappa, roll, pitch, yaw.
    camera : str or None
        The camera, where the file has such a column.
    line : int
        Line in the file, from 1.
    """

    name: str
    numbers: Mapping[str, float]
    camera: str | None
    line: int

    def values(self, columns: Sequence[str]) -> tuple[float, float, float]:
        """Three of the numbers."""
        first, second, third = (self.numbers[column] for column in columns)
        return first, second, third


@dataclass(frozen=True)
class OrientationTable:
    """All rows of a file and what its header says."""

    path: Path
    columns: tuple[str, ...]
    rows: tuple[OrientationRow, ...]
    angle_unit: AngleUnit | None = None
    ignored: tuple[str, ...] = field(default=())

    def has(self, columns: Sequence[str]) -> bool:
        """Whether the file has all of these columns."""
        return all(column in self.columns for column in columns)


def read_orientation_table(
    path: Path, columns: Sequence[str] | None = None, separator: str | None = None
) -> OrientationTable:
    """Read a table of orientations.

    Parameters
    ----------
    path : Path
        The file, UTF-8. Lines that start with # and empty lines are passed over.
    columns : sequence of str, optional
        Names of the columns of a file without a header (or to overrule it): filename, x, y, z, longitude,
        latitude, omega, phi, kappa, roll, pitch, yaw, camera, or other for a column to pass over.
    separator : str, optional
        Separator of the columns; found out if absent (tab, semicolon, comma, bar, else blanks).

    Raises
    ------
    FormatError
        If the file is no such table: file, line and column are named.
    OrientationError
        If a photograph is named twice.
    """
    lines = _lines(path)
    separator = separator or _separator(lines)
    table = [(number, _split(text, separator)) for number, text in lines]
    header, body = _header_and_body(path, table)
    if columns is not None:
        names, unit = _declared(path, columns), None
    elif header is None:
        raise FormatError(
            "has no header line that names filename, x, y, z, omega, phi, kappa or the like",
            file=path,
            hint=f'name its {len(body[0][1])} columns: columns = ["filename", "x", "y", "z", ...]',
        )
    else:
        names, unit = _columns_of_header(path, header)
    _require_columns(path, names)
    rows = tuple(_rows(path, names, body, separator))
    _require_unique(path, rows)
    known = tuple(name for name in names if not name.startswith(OTHER))
    ignored = tuple(name.removeprefix(f"{OTHER}:") for name in names if name.startswith(f"{OTHER}:"))
    return OrientationTable(path, known, rows, unit, ignored)


def _lines(path: Path) -> list[tuple[int, str]]:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise FormatError("does not exist", file=path) from None
    except UnicodeDecodeError as error:
        raise FormatError(f"must be UTF-8 text: {error.reason} at byte {error.start}", file=path) from error
    except OSError as error:
        raise FormatError(f"cannot be read: {error.strerror}", file=path) from error
    numbered = [(number, line.strip()) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    # A header may hide behind a # (Metashape); further such lines are comments.
    header = next((line for line in numbered if line[1].startswith("#") and _is_header(line[1])), None)
    body = [line for line in numbered if not line[1].startswith("#")]
    if header is not None and body and not _is_header(body[0][1]):
        body.insert(0, (header[0], header[1].lstrip("# ")))
    if not body:
        raise FormatError("holds no orientation", file=path)
    return body


def _is_header(text: str) -> bool:
    tokens = re.split(r"[\t;,|]", text.lstrip("# "))
    tokens = tokens if len(tokens) > 1 else text.lstrip("# ").split()
    return sum(_column(token.strip("'\" "))[0] is not None for token in tokens) >= 4


def _separator(lines: Sequence[tuple[int, str]]) -> str:
    sample = [re.sub(r"'[^']*'|\"[^\"]*\"", "", text) for _, text in lines[:20]]
    for separator in _SEPARATORS:
        # The first line decides; a line with another number of columns is then reported as such.
        if sample[0].count(separator) >= 2 and all(separator in text for text in sample):
            return separator
    return " "


def _split(text: str, separator: str) -> list[str]:
    if separator == " ":
        return [a or b or c for a, b, c in _TOKEN.findall(text)]
    quote = "'" if "'" in text and '"' not in text else '"'
    cells = next(csv.reader([text], delimiter=separator, quotechar=quote, skipinitialspace=True))
    return [cell.strip() for cell in cells]


def _header_and_body(
    path: Path, table: list[tuple[int, list[str]]]
) -> tuple[list[str] | None, list[tuple[int, list[str]]]]:
    first = table[0][1]
    numeric = sum(_number(cell) is not None for cell in first)
    if numeric >= 3:
        return None, table
    if len(table) == 1:
        raise FormatError("holds a header but no orientation", file=path)
    return first, table[1:]


def _columns_of_header(path: Path, header: Sequence[str]) -> tuple[list[str], AngleUnit | None]:
    names: list[str] = []
    units: set[AngleUnit] = set()
    for cell in header:
        column, unit = _column(cell)
        names.append(column or f"{OTHER}:{cell}")
        if unit is not None and column in (*OPK_COLUMNS, *RPY_COLUMNS):
            units.add(unit)
    if len(units) > 1:
        raise FormatError("names several units of angles in its header", file=path, value=sorted(units))
    return names, next(iter(units), None)


def _column(cell: str) -> tuple[str | None, AngleUnit | None]:
    found = _UNIT_IN_HEADER.search(cell)
    word = (found[1] or found[2] or "").lower() if found else ""
    bare = _UNIT_IN_HEADER.sub("", cell) if found else cell
    key = "" if _MATRIX_ELEMENT.match(bare) else re.sub(r"[^a-zωφκ0]", "", bare.lower())
    return _COLUMN_OF.get(key), _UNITS.get(word)


def _declared(path: Path, columns: Sequence[str]) -> list[str]:
    known = {*_SYNONYMS, OTHER}
    names = []
    for cell in columns:
        name = cell if cell in known else _column(cell)[0]
        if name is None:
            rule = f"names an unknown column; known are {', '.join(sorted(known))}"
            raise FormatError(rule, file=path, field="columns", value=cell)
        names.append(name)
    return names


def _require_columns(path: Path, names: Sequence[str]) -> None:
    twice = {name for name in names if not name.startswith(OTHER) and names.count(name) > 1}
    if twice:
        raise FormatError("has a column twice", file=path, value=sorted(twice))
    missing = [] if NAME in names else [NAME]
    if not any(set(kind) <= set(names) for kind in (MAP_COLUMNS, GEOGRAPHIC_COLUMNS)):
        missing.append("x, y, z or longitude, latitude, height")
    if missing:
        raise FormatError(f"must have the columns {' and '.join(missing)}", file=path, value=list(names))


def _rows(
    path: Path, names: Sequence[str], body: Sequence[tuple[int, list[str]]], separator: str
) -> Iterator[OrientationRow]:
    for line, cells in body:
        if len(cells) != len(names):
            rule = f"must have {len(names)} columns like the rest"
            raise FormatError(rule, file=path, field=f"line {line}", value=len(cells))
        numbers = {}
        texts = {}
        for name, cell in zip(names, cells, strict=True):
            if name in (NAME, CAMERA):
                texts[name] = cell
            elif not name.startswith(OTHER):
                value = _number(cell, comma=separator != ",")
                if value is None or not math.isfinite(value):
                    raise FormatError("must be a number", file=path, field=f"line {line}, {name}", value=cell)
                numbers[name] = value
        yield OrientationRow(texts[NAME], numbers, texts.get(CAMERA), line)


def _number(cell: str, comma: bool = False) -> float | None:
    """A number; with `comma` also one with a decimal comma, which the separator then cannot be."""
    text = cell.replace(",", ".") if comma and "." not in cell and cell.count(",") == 1 else cell
    try:
        return float(text)
    except ValueError:
        return None


def _require_unique(path: Path, rows: Sequence[OrientationRow]) -> None:
    lines: dict[str, int] = {}
    for row in rows:
        if row.name in lines:
            raise OrientationError(
                f"is named twice, in lines {lines[row.name]} and {row.line}", file=path, field=row.name
            )
        lines[row.name] = row.line
