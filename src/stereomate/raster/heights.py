"""Reading height models: one band as floating-point heights, voids as NaN, by windows."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self, cast

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import ImageError
from stereomate.raster.handles import Handles, gdal_window, reading
from stereomate.raster.info import RasterInfo, info_of
from stereomate.raster.windows import Window


@dataclass(frozen=True)
class HeightScale:
    """How stored numbers become heights: height = scale * stored + offset, in `units`.

    Attributes
    ----------
    scale, offset : float
        As the file states them, else 1 and 0.
    units : str
        As the file writes them ("metre", "m", "ft", ...), "" where it does not; not applied.
    """

    scale: float = 1.0
    offset: float = 0.0
    units: str = ""


class HeightReader:
    """A height model read by windows; made by `open_heights`, closed by ``with`` or `close`.

    Safe to use from any number of threads. Pickles as its path, so tasks may carry it to other processes.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._handles = Handles(Path(path))
        with self._handles.lend() as handle:
            if handle.count != 1:
                raise ImageError(
                    "must have one band to be a height model", file=self._handles.path, value=handle.count
                )
            self.info: RasterInfo = info_of(self._handles.path, handle)
            self.scale = _scale_of(handle)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __reduce__(self) -> tuple[type[HeightReader], tuple[str]]:
        return (type(self), (str(self.info.path),))

    @property
    def path(self) -> Path:
        """The file."""
        return self.info.path

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows."""
        return self.info.size

    def read_window(self, col0: int, row0: int, cols: int, rows: int) -> tuple[NDArray[np.float64], Window]:
        """Heights of a window, clamped to the raster.

        Returns
        -------
        heights : ndarray of float64, shape (rows, cols)
            In the file's units, scale and offset applied; NaN where the file has nodata, a mask or a
            value that is not finite.
        window : Window
            The window that was read.

        Raises
        ------
        ImageError
            If the file is damaged there.
        """
        window = Window(col0, row0, cols, rows).clamped(self.size)
        if window.is_empty:
            return np.empty((window.rows, window.cols)), window
        with self._handles.lend() as handle, reading(self.path):
            stored = handle.read(1, window=gdal_window(window))
            invalid = _invalid(handle, self.info, stored, window)
        heights = stored.astype(np.float64)
        if self.scale.scale != 1.0:
            heights *= self.scale.scale
        if self.scale.offset != 0.0:
            heights += self.scale.offset
        heights[invalid] = np.nan
        return heights, window

    def close(self) -> None:
        """Close all handles."""
        self._handles.close()


def open_heights(path: str | os.PathLike[str]) -> HeightReader:
    """Open a height model of one band.

    Raises
    ------
    ImageError
        If the file is missing, cut off, no raster, or has more than one band.
    """
    return HeightReader(path)


def _scale_of(handle: Any) -> HeightScale:
    return HeightScale(float(handle.scales[0]), float(handle.offsets[0]), handle.units[0] or "")


def _invalid(handle: Any, info: RasterInfo, stored: NDArray[Any], window: Window) -> NDArray[np.bool_]:
    if info.has_mask:
        invalid = cast(NDArray[np.bool_], handle.read_masks(1, window=gdal_window(window)) == 0)
    else:
        invalid = np.zeros(stored.shape, np.bool_)
    if stored.dtype.kind == "f":
        invalid |= ~np.isfinite(stored)
    if info.nodata is not None and not np.isnan(info.nodata):
        # A float32 file's nodata -3.4e38 is written as text: compare in the type of the pixels.
        with np.errstate(over="ignore"):
            invalid |= stored == np.asarray(info.nodata).astype(stored.dtype)
    return invalid
