"""IGN text files: image observations ``.mes`` and ground coordinates ``.app`` or ``.mes``, by blanks.

``.mes`` holds one image observation a line: point, photograph, column, row in pixels. Ground coordinates are
lines of point, (in ``.app``) a class, x, y, z. Names may be quoted. Orientations (``.OPK``: NOM X Y Z O P K
CAMERA) are tables that `orientation_table` reads. None of the files says its CRS, height system or unit.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import FormatError, StorageError

Array = NDArray[np.float64]

_TOKEN: Final = re.compile(r"\"([^\"]*)\"|'([^']*)'|([^\s,;]+)")


@dataclass(frozen=True, eq=False)
class ImageObservations:
    """Image observations in the order of the file.

    Attributes
    ----------
    points, photographs : tuple of str (m,)
    pixels : ndarray (m, 2)
        Column and row, as written.
    """

    points: tuple[str, ...]
    photographs: tuple[str, ...]
    pixels: Array


@dataclass(frozen=True, eq=False)
class GroundPoints:
    """Ground coordinates: names and (n, 3) x, y, z as written."""

    names: tuple[str, ...]
    xyz: Array


def read_mes(path: Path) -> ImageObservations:
    """Image observations of a ``.mes`` file.

    Raises
    ------
    FormatError
        If a line does not hold a point, a photograph and two numbers, or one is observed twice in a
        photograph.
    """
    points, photographs, pixels = [], [], []
    seen: dict[tuple[str, str], int] = {}
    for number, cells in _lines(path):
        if len(cells) != 4:
            raise FormatError(
                "must hold point, photograph, column, row",
                file=path,
                field=f"line {number}",
                value=len(cells),
            )
        if (cells[0], cells[1]) in seen:
            raise FormatError(
                f"observes point {cells[0]} in {cells[1]} again (first in line {seen[cells[0], cells[1]]})",
                file=path,
                field=f"line {number}",
            )
        seen[cells[0], cells[1]] = number
        points.append(cells[0])
        photographs.append(cells[1])
        pixels.append(_numbers(cells[2:], path, number))
    return ImageObservations(tuple(points), tuple(photographs), np.array(pixels))


def write_mes(path: Path, observations: ImageObservations) -> None:
    """Write a ``.mes`` file, pixels to 1e-6.

    Raises
    ------
    StorageError
        If it cannot be written.
    """
    lines = (
        f"{_quoted(point)} {_quoted(photo)} {col:.6f} {row:.6f}\n"
        for point, photo, (col, row) in zip(
            observations.points, observations.photographs, observations.pixels.tolist(), strict=True
        )
    )
    try:
        path.write_text("".join(lines), encoding="utf-8")
    except OSError as error:
        raise StorageError(f"{path}: cannot write the observations ({error.strerror})") from error


def read_ground_points(path: Path) -> GroundPoints:
    """Ground coordinates of an ``.app`` file (point, class, x, y, z) or a ``.mes`` (point, x, y, z).

    Raises
    ------
    FormatError
        If a line holds something else, or a point occurs twice.
    """
    names: list[str] = []
    xyz = []
    for number, cells in _lines(path):
        if len(cells) not in (4, 5):
            raise FormatError(
                "must hold point, (class,) x, y, z", file=path, field=f"line {number}", value=len(cells)
            )
        names.append(cells[0])
        xyz.append(_numbers(cells[-3:], path, number))
    twice = sorted({name for name in names if names.count(name) > 1}) if len(set(names)) < len(names) else []
    if twice:
        raise FormatError("holds a point twice", file=path, value=twice[:3])
    return GroundPoints(tuple(names), np.array(xyz))


def _lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise FormatError("does not exist", file=path) from None
    except (OSError, UnicodeDecodeError) as error:
        raise FormatError("must be a readable text file", file=path) from error
    found = False
    for number, line in enumerate(text.splitlines(), 1):
        if line.strip() and not line.lstrip().startswith("#"):
            found = True
            yield number, [a or b or c for a, b, c in _TOKEN.findall(line)]
    if not found:
        raise FormatError("holds no point", file=path)


def _numbers(cells: Sequence[str], path: Path, number: int) -> list[float]:
    values = []
    for cell in cells:
        try:
            value = float(cell)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise FormatError("must be a number", file=path, field=f"line {number}", value=cell)
        values.append(value)
    return values


def _quoted(name: str) -> str:
    return f'"{name}"' if re.search(r"[\s,;]", name) else name
