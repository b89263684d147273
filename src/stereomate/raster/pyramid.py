"""A raster at reduced resolutions: levels of half the size each, from its overviews where it has them."""

from __future__ import annotations

import math
import os
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from rasterio.enums import Resampling

from stereomate.errors import InputError
from stereomate.raster.handles import Handles, gdal_window, reading
from stereomate.raster.info import RasterInfo, info_of
from stereomate.raster.windows import Window


class PyramidReader:
    """Windows of a raster at any level; made by `open_pyramid`, closed by ``with`` or `close`.

    Level 0 is full resolution; pixel (col, row) of level n covers 2^n x 2^n pixels from (2^n col, 2^n row).
    Safe to use from any number of threads.
    """

    def __init__(self, path: str | os.PathLike[str], nearest: bool) -> None:
        self._full = Handles(Path(path))
        self._resampling = Resampling.nearest if nearest else Resampling.average
        self._overviews: dict[int, Handles] = {}
        self._fitting: dict[int, Handles | None] = {}
        with self._full.lend() as handle:
            self.info: RasterInfo = info_of(self._full.path, handle)
            factors = list(handle.overviews(1))
        for index, factor in enumerate(factors):
            level = factor.bit_length() - 1
            if factor == 1 << level:
                self._overviews[level] = Handles(self._full.path, index)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def size(self, level: int = 0) -> tuple[int, int]:
        """Columns and rows of a level."""
        cols, rows = self.info.size
        return -(-cols >> level), -(-rows >> level)

    def levels(self, tile: int) -> int:
        """How many levels there are until the raster fits one tile."""
        return 1 + max(0, math.ceil(math.log2(max(self.info.size) / tile)))

    def read(
        self, level: int, col0: int, row0: int, cols: int, rows: int
    ) -> tuple[NDArray[Any], NDArray[np.bool_], Window]:
        """Pixels of a window of a level, clamped to it.

        Returns
        -------
        pixels : (rows, cols, bands)
        valid : (rows, cols) bool
        window : Window
            What was read, in pixels of the level.

        Raises
        ------
        ImageError
            If the file is damaged there.
        InputError
            If the level is negative.
        """
        if level < 0:
            raise InputError("must be 0 or more", field="level", value=level)
        window = Window(col0, row0, cols, rows).clamped(self.size(level))
        shape = (window.rows, window.cols)
        if window.is_empty:
            return np.empty((*shape, self.info.bands), self.info.dtype), np.empty(shape, np.bool_), window
        handles = self._handles(level)
        if handles is not None:
            place, handles_used = gdal_window(window), handles
        else:
            full = Window(*(n << level for n in window)).clamped(self.info.size)
            place, handles_used = gdal_window(full), self._full
        with handles_used.lend() as handle, reading(self.info.path):
            bands = handle.read(
                window=place, out_shape=(self.info.bands, *shape), resampling=self._resampling
            )
            mask = handle.dataset_mask(window=place, out_shape=shape, resampling=Resampling.nearest)
        pixels = np.empty((*shape, self.info.bands), bands.dtype)
        # not by the kernel that interleaves: windows are small, and numba takes half a second to start
        for band, plane in enumerate(bands):
            pixels[..., band] = plane
        return pixels, np.asarray(mask != 0), window

    def _handles(self, level: int) -> Handles | None:
        """Those that show a level as it is: an overview is opened, to see its size, when it is wanted."""
        if level == 0 or level in self._fitting:
            return self._fitting.get(level, self._full)
        overview = self._overviews.get(level)
        if overview is None:
            return None
        with overview.lend() as handle:
            fits = (handle.width, handle.height) == self.size(level)
        self._fitting[level] = overview if fits else None
        return self._fitting[level]

    def close(self) -> None:
        """Close all handles."""
        for handles in (self._full, *self._overviews.values()):
            handles.close()


def open_pyramid(path: str | os.PathLike[str], *, nearest: bool = False) -> PyramidReader:
    """Open a raster to read it at reduced resolutions.

    Parameters
    ----------
    path : path
    nearest : bool
        Where there is no overview take single pixels (of classes, numbers of photographs), not averages.

    Raises
    ------
    ImageError
        If the file is missing, is no raster, or is cut off.
    """
    return PyramidReader(path, nearest)
