"""Where the heights of a model come from: a file read by windows, or an array."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import HeightSystemError
from stereomate.raster import HeightReader, open_heights
from stereomate.units import FOOT, US_SURVEY_FOOT

Floats = NDArray[np.float64]

_HASH_CHUNK = 1 << 20

# Metres per unit, as GDAL's drivers and PROJ write units.
_UNITS = {
    **dict.fromkeys(("m", "metre", "meter", "metres", "meters"), 1.0),
    **dict.fromkeys(("ft", "foot", "feet", "international foot", "international feet"), FOOT),
    **dict.fromkeys(
        ("us survey foot", "us survey feet", "us_survey_foot", "us-survey-foot", "us-ft", "ftus", "ft_us"),
        US_SURVEY_FOOT,
    ),
    **dict.fromkeys(("cm", "centimetre", "centimeter"), 0.01),
    **dict.fromkeys(("dm", "decimetre", "decimeter"), 0.1),
    **dict.fromkeys(("mm", "millimetre", "millimeter"), 0.001),
    **dict.fromkeys(("km", "kilometre", "kilometer"), 1000.0),
}


def metres_per_unit(unit: str, *, file: object | None = None) -> float:
    """Metres per unit of height, from the unit as it is written.

    Raises
    ------
    HeightSystemError
        If the unit is not known: heights are never guessed to be metres.
    """
    factor = _UNITS.get(unit.strip().lower())
    if factor is None:
        raise HeightSystemError(
            "the unit of the heights must be metre, foot or US survey foot (or cm, dm, mm, km)",
            file=file,
            field="unit",
            value=unit,
        )
    return factor


class HeightSource(Protocol):
    """Stored heights by windows."""

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows."""
        ...

    @property
    def content_hash(self) -> str:
        """SHA-256 of the content, hexadecimal."""
        ...

    def read(self, col0: int, row0: int, cols: int, rows: int) -> Floats:
        """Heights (rows, cols) of a window inside the model; NaN = void."""
        ...


@dataclass(frozen=True)
class FileSource:
    """A raster file. Pickles as its path; safe to use from any number of threads.

    Attributes
    ----------
    path : Path
    nodata : float or None
        A value that means void besides what the file declares.
    factor : float
        Applied to the stored heights.
    """

    path: Path
    nodata: float | None = None
    factor: float = 1.0

    @cached_property
    def reader(self) -> HeightReader:
        """The open file."""
        return open_heights(self.path)

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows."""
        return self.reader.size

    @cached_property
    def content_hash(self) -> str:
        """SHA-256 of the file."""
        digest = hashlib.sha256()
        with self.path.open("rb") as file:
            while chunk := file.read(_HASH_CHUNK):
                digest.update(chunk)
        return digest.hexdigest()

    def read(self, col0: int, row0: int, cols: int, rows: int) -> Floats:
        """Heights (rows, cols) of a window inside the model; NaN = void."""
        heights = self.reader.read_window(col0, row0, cols, rows)[0]
        if self.nodata is not None:
            # float32 rasters hold the nearest float32 of the stated value
            stored = self.nodata * self.reader.scale.scale + self.reader.scale.offset
            nearest = float(np.float32(self.nodata)) * self.reader.scale.scale + self.reader.scale.offset
            heights[(heights == stored) | (heights == nearest)] = np.nan
        if self.factor != 1.0:
            heights *= self.factor
        return heights


@dataclass(frozen=True, eq=False)
class ArraySource:
    """Heights in memory, (rows, cols), NaN = void."""

    heights: Floats

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows."""
        return self.heights.shape[1], self.heights.shape[0]

    @cached_property
    def content_hash(self) -> str:
        """SHA-256 of the heights and their shape."""
        digest = hashlib.sha256(repr(self.heights.shape).encode())
        digest.update(np.ascontiguousarray(self.heights).tobytes())
        return digest.hexdigest()

    def read(self, col0: int, row0: int, cols: int, rows: int) -> Floats:
        """Heights (rows, cols) of a window inside the model; NaN = void."""
        return self.heights[row0 : row0 + rows, col0 : col0 + cols].astype(np.float64)
