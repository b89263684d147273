"""Image measurements of points from text, IGN's ``.mes``, OpenSfM's tracks and COLMAP's database.

A text file has one measurement a line: point, photograph, column, row and perhaps a standard deviation in
pixels, with or without a header. Pixels count from the outer corner of the first one.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import FormatError
from stereomate.formats.ign import read_mes
from stereomate.formats.text_files import read_text
from stereomate.measurement.database import MeasurementDatabase
from stereomate.measurement.tracks import PairMatches, join_matches

Array = NDArray[np.float64]
Row = tuple[str, str, float, float]

_OPENSFM: Final = "OPENSFM_TRACKS_VERSION"
_DATABASES: Final = {".db", ".sqlite", ".sqlite3"}


@dataclass(frozen=True, eq=False)
class ImageMeasurements:
    """Image measurements in the order of the file.

    Attributes
    ----------
    path : Path
    points, photographs : tuple of str (m,)
    pixels : ndarray (m, 2)
        Column and row.
    sigma_px : ndarray (m,)
        NaN where the file states none.
    """

    path: Path
    points: tuple[str, ...]
    photographs: tuple[str, ...]
    pixels: Array
    sigma_px: Array

    @classmethod
    def from_rows(
        cls, path: Path, rows: Sequence[Row], sigma_px: Sequence[float] | None = None
    ) -> ImageMeasurements:
        """From (point, photograph, column, row).

        Raises
        ------
        FormatError
            If a point is measured twice in a photograph, or a pixel is not a finite number.
        """
        seen: set[tuple[str, str]] = set()
        for point, photograph, col, row in rows:
            if (point, photograph) in seen:
                raise FormatError(
                    f"measures point {point} in {photograph} twice", file=path, field="measurements"
                )
            seen.add((point, photograph))
            if not (math.isfinite(col) and math.isfinite(row)):
                raise FormatError("must have a column and a row", file=path, field=f"{point} in {photograph}")
        deviations = np.full(len(rows), np.nan) if sigma_px is None else np.array(sigma_px, dtype=np.float64)
        return cls(
            path,
            tuple(row[0] for row in rows),
            tuple(row[1] for row in rows),
            np.array([row[2:] for row in rows], dtype=np.float64).reshape(-1, 2),
            deviations,
        )


SizeOf = Callable[[str], tuple[int, int] | None]


def read_image_points(path: Path, size_of: SizeOf | None = None) -> ImageMeasurements:
    """Read image measurements; the kind of file is found out.

    Parameters
    ----------
    path : Path
    size_of : callable, optional
        Columns and rows of the photograph of a name, None if it is not known; OpenSfM's tracks need them.

    Raises
    ------
    FormatError
        Naming file, line, rule and value.
    """
    if is_database(path):
        return read_colmap_tracks(path)
    if path.suffix.lower() == ".mes":
        found = read_mes(path)
        nothing = np.full(len(found.points), np.nan)
        return ImageMeasurements(path, found.points, found.photographs, found.pixels, nothing)
    text = read_text(path)
    if text.startswith(_OPENSFM) or _looks_like_tracks(text):
        return _opensfm_tracks(path, text, size_of or (lambda name: None))
    return _table(path, text)


def is_database(path: Path) -> bool:
    """Whether a file is a COLMAP database by its name."""
    return path.suffix.lower() in _DATABASES


def read_colmap_tracks(path: Path) -> ImageMeasurements:
    """Tie points of a COLMAP database: its verified matches joined, without contradictions.

    Raises
    ------
    FormatError
        If it is no such database or holds no verified matches.
    """
    with MeasurementDatabase.open(path, read_only=True) as database:
        names = {row.image_id: row.name for row in database.images()}
        pairs = [
            PairMatches(pair.first, pair.second, pair.rows, np.zeros(len(pair.rows)))
            for pair in database.pairs()
            if len(pair.rows) and pair.first in names and pair.second in names
        ]
        if not pairs:
            raise FormatError("holds no verified matches", file=path, field="two_view_geometries")
        tracks = join_matches(pairs)
        pixels = np.empty((len(tracks.point), 2))
        for number in np.unique(tracks.photo).tolist():
            mine = tracks.photo == number
            pixels[mine] = database.keypoints(number)[0][tracks.feature[mine]]
    return ImageMeasurements(
        path,
        tuple(str(point) for point in tracks.point.tolist()),
        tuple(names[photo] for photo in tracks.photo.tolist()),
        pixels,
        np.full(len(pixels), np.nan),
    )


def _looks_like_tracks(text: str) -> bool:
    """Tracks of old versions have no header: image, track, feature, x, y, r, g, b by tabs."""
    cells = text.split("\n", 1)[0].split("\t")
    return len(cells) >= 8 and cells[1].isdigit() and cells[2].isdigit()


def _opensfm_tracks(path: Path, text: str, size_of: SizeOf) -> ImageMeasurements:
    """OpenSfM counts from the middle of the photograph in units of its longer side."""
    rows: list[Row] = []
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip() or line.startswith(_OPENSFM):
            continue
        cells = line.split("\t")
        if len(cells) < 5:
            raise FormatError(
                "must hold image, track, feature, x, y", file=path, field=f"line {number}", value=line
            )
        size = size_of(cells[0])
        if size is None:
            raise FormatError(
                "names a photograph whose size is not known",
                file=path,
                field=f"line {number}",
                value=cells[0],
            )
        columns, height = size
        x, y = (_number(path, number, cell) for cell in cells[3:5])
        longer = max(columns, height)
        rows.append((cells[1], cells[0], x * longer + columns / 2.0, y * longer + height / 2.0))
    return ImageMeasurements.from_rows(path, rows)


def _table(path: Path, text: str) -> ImageMeasurements:
    rows: list[Row] = []
    deviations = []
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        cells = _cells(line)
        if len(cells) < 4:
            raise FormatError(
                "must hold point, photograph, column, row", file=path, field=f"line {number}", value=line
            )
        if not rows and not any(_is_number(cell) for cell in cells[2:4]):
            continue  # the header
        col, row = (_number(path, number, cell) for cell in cells[2:4])
        deviation = _number(path, number, cells[4]) if len(cells) > 4 and cells[4] else math.nan
        if math.isfinite(deviation) and not deviation > 0.0:
            raise FormatError(
                "must be a positive standard deviation",
                file=path,
                field=f"line {number}",
                value=cells[4],
            )
        rows.append((cells[0], cells[1], col, row))
        deviations.append(deviation)
    if not rows:
        raise FormatError("holds no measurement", file=path)
    return ImageMeasurements.from_rows(path, rows, deviations)


def _cells(line: str) -> list[str]:
    separator = next((s for s in "\t;," if s in line), None)
    if separator is None:
        return [a or b for a, b in re.findall(r"\"([^\"]*)\"|(\S+)", line)]
    return [cell.strip() for cell in next(csv.reader(io.StringIO(line), delimiter=separator))]


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _number(path: Path, number: int, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise FormatError("must be a number", file=path, field=f"line {number}", value=cell)
    return value
