"""Points as delimited text, streamed: x, y, z are replaced, every other cell stays as it is."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import IO, Final

import numpy as np

from stereomate.errors import FormatError
from stereomate.formats.point_move import MovedPoints, PointMove
from stereomate.raster.files import replacing, write_all

_LINES: Final = 50_000
_SEPARATORS: Final = ("\t", ";", ",")
_NAMES: Final = {
    "x": {"x", "e", "east", "easting", "lon", "longitude"},
    "y": {"y", "n", "north", "northing", "lat", "latitude"},
    "z": {"z", "h", "height", "alt", "altitude", "elevation", "up", "u"},
}


def move_text(path: Path, target: Path, move: PointMove, columns: Sequence[int] | None = None) -> MovedPoints:
    """Move the points of a text file.

    Parameters
    ----------
    path, target : Path
    move : PointMove
    columns : three ints, optional
        Columns of x, y and z from 1. Absent: by the header; without a header the first three, if they are
        numbers.

    Raises
    ------
    FormatError
        If a line does not hold three numbers there: the line is named.
    """
    count = 0
    notes = list(move.notes())
    with _opened(path) as source, replacing(target) as out:
        numbered = enumerate((line.rstrip("\r\n") for line in source), 1)
        layout: _Layout | None = None
        while block := list(islice(numbered, _LINES)):
            if layout is None:
                layout, head = _layout(path, block, columns)
                write_all(out, ["".join(f"{line}\n" for line in head).encode()])
                block = block[len(head) :]
                if layout.guessed:
                    notes.append(f"{path.name}: the first three columns are taken as x, y, z")
            text, moved = _block(path, block, layout, move)
            count += moved
            write_all(out, [text.encode()])
        if count == 0:
            raise FormatError("holds no point", file=path)
    return MovedPoints(count, tuple(notes))


class _Layout:
    def __init__(self, separator: str, columns: Sequence[int], guessed: bool) -> None:
        self.separator, self.columns, self.guessed = separator, list(columns), guessed

    def split(self, line: str) -> list[str]:
        return line.split(self.separator) if self.separator != " " else line.split()


def _opened(path: Path) -> IO[str]:
    try:
        return path.open(encoding="utf-8-sig")
    except FileNotFoundError:
        raise FormatError("does not exist", file=path) from None
    except OSError as error:
        raise FormatError(f"cannot be read: {error.strerror}", file=path) from error


def _layout(
    path: Path, block: Sequence[tuple[int, str]], columns: Sequence[int] | None
) -> tuple[_Layout, list[str]]:
    """Where x, y, z are, and the lines before the first point."""
    head: list[str] = []
    names: list[int] | None = None
    for _, line in block:
        if line.strip() and not line.startswith(("#", "//")):
            separator = next((s for s in _SEPARATORS if line.count(s) >= 2), " ")
            cells = _Layout(separator, (), False).split(line)
            if columns is not None:
                if all(index - 1 < len(cells) and _is_number(cells[index - 1]) for index in columns):
                    return _Layout(separator, [index - 1 for index in columns], False), head
            elif names is not None:
                return _Layout(separator, names, False), head
            elif len(cells) >= 3 and all(_is_number(cell) for cell in cells[:3]):
                return _Layout(separator, (0, 1, 2), True), head
            elif not any(_is_number(cell) for cell in cells):
                names = _named(cells)
                if names is None:
                    break
        head.append(line)
    raise FormatError(
        "does not say where x, y, z are",
        file=path,
        hint="name their columns, counted from 1: --columns 2,3,4",
    )


def _named(cells: Sequence[str]) -> list[int] | None:
    words = [re.sub(r"[\[(].*", "", cell).strip("'\" ").lower() for cell in cells]
    found = [[k for k, word in enumerate(words) if word in _NAMES[axis]] for axis in "xyz"]
    return [hits[0] for hits in found] if all(len(hits) == 1 for hits in found) else None


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _block(path: Path, block: Sequence[tuple[int, str]], layout: _Layout, move: PointMove) -> tuple[str, int]:
    rows = [
        (number, layout.split(line)) if line.strip() and not line.startswith(("#", "//")) else (number, None)
        for number, line in block
    ]
    xyz = np.array(list(_coordinates(path, rows, layout.columns)), dtype=np.float64).reshape(-1, 3)
    moved = iter(move.points(xyz).tolist())
    out = []
    for (_, line), (_, cells) in zip(block, rows, strict=True):
        if cells is None:
            out.append(line)
            continue
        for column, value, digits in zip(layout.columns, next(moved), move.decimals, strict=True):
            cells[column] = f"{value:.{digits}f}"
        out.append(layout.separator.join(cells))
    return "".join(f"{line}\n" for line in out), len(xyz)


def _coordinates(
    path: Path, rows: Sequence[tuple[int, list[str] | None]], columns: Sequence[int]
) -> Iterator[list[float]]:
    for number, cells in rows:
        if cells is None:
            continue
        try:
            values = [float(cells[column]) for column in columns]
        except (ValueError, IndexError):
            where = ", ".join(str(column + 1) for column in columns)
            rule = f"must hold numbers in columns {where}"
            raise FormatError(rule, file=path, field=f"line {number}", value=" ".join(cells)) from None
        yield values
