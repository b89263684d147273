"""GDAL handles of one file, lent to one thread at a time, and the errors of damaged files."""

from __future__ import annotations

import contextlib
import threading
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.windows import Window as GdalWindow

from stereomate.errors import ImageError
from stereomate.raster import settings
from stereomate.raster.info import dtype_of
from stereomate.raster.windows import Window


class Handles:
    """GDAL handles of one file: each is lent to one thread at a time and taken back."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._idle: list[Any] = []
        self._lock = threading.Lock()
        self._closed = False

    @contextlib.contextmanager
    def lend(self) -> Iterator[Any]:
        """A handle for the duration of a ``with``: an idle one, else a new one."""
        with self._lock:
            if self._closed:
                raise ValueError(f"{self.path}: the reader is closed")
            handle = self._idle.pop() if self._idle else None
        if handle is None:
            handle = _open(self.path)
        try:
            yield handle
        finally:
            with self._lock:
                keep = not self._closed
                if keep:
                    self._idle.append(handle)
            if not keep:
                handle.close()

    def close(self) -> None:
        """Close the idle handles now, and each lent one when it comes back."""
        with self._lock:
            self._closed = True
            handles, self._idle = self._idle, []
        for handle in handles:
            handle.close()


def _open(path: Path) -> Any:
    settings.current()
    if not path.is_file():
        raise ImageError("no such file", file=path)
    with reading(path), warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        return rasterio.open(path)


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn what GDAL says about a damaged file into an error that names the file."""
    try:
        yield
    except (RasterioError, OSError) as error:
        cause = error.__cause__ or error
        raise ImageError(f"cannot be read: {cause}", file=path, hint="is the file complete?") from error


def read_pixels(path: Path, handle: Any, window: Window) -> NDArray[Any]:
    """All bands of a window, shape (rows, cols, bands), C-contiguous."""
    pixels = np.empty((window.rows, window.cols, handle.count), dtype_of(path, handle))
    with reading(path):
        # GDAL writes through the strides: interleaved by pixel without a second copy.
        handle.read(window=gdal_window(window), out=pixels.transpose(2, 0, 1))
    return pixels


def gdal_window(window: Window) -> Any:
    """A window as rasterio takes it."""
    return GdalWindow(window.col0, window.row0, window.cols, window.rows)
