"""GDAL handles of one file, lent to one thread at a time, and the errors of damaged files."""

from __future__ import annotations

import contextlib
import threading
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import rasterio
from numpy.typing import NDArray
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.windows import Window as GdalWindow

from stereomate.errors import ImageError
from stereomate.raster import settings
from stereomate.raster.kernels import interleave
from stereomate.raster.scratch import SCRATCH
from stereomate.raster.windows import Window

_SLAB_BYTES: Final = 2 * 1024**2
LARGEST_SLAB_BYTES: Final = 32 * 1024**2


class Handles:
    """GDAL handles of one file: each is lent to one thread at a time and taken back.

    With `overview` they show that overview (0 is the first one) as if it were the file.
    """

    def __init__(self, path: Path, overview: int | None = None) -> None:
        self.path = path
        self._overview = overview
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
            handle = _open(self.path, self._overview)
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


def _open(path: Path, overview: int | None) -> Any:
    settings.current()
    if not path.is_file():
        raise ImageError("no such file", file=path)
    _photographs_have_no_georeference()
    with reading(path):
        return rasterio.open(path) if overview is None else rasterio.open(path, overview_level=overview)


def _photographs_have_no_georeference() -> None:
    """Ignore the warning about it. For the whole process: `catch_warnings` is not safe among threads."""
    if not any(entry[2] is NotGeoreferencedWarning for entry in warnings.filters):
        warnings.simplefilter("ignore", NotGeoreferencedWarning)


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn what GDAL says about a damaged file into an error that names the file."""
    try:
        yield
    except (RasterioError, OSError) as error:
        cause = error.__cause__ or error
        raise ImageError(f"cannot be read: {cause}", file=path, hint="is the file complete?") from error


def read_pixels(path: Path, handle: Any, window: Window, out: NDArray[Any]) -> None:
    """All bands of a window, into `out` of shape (rows, cols, bands), C-contiguous."""
    block_bytes = min(handle.block_shapes[0][0], handle.height) * window.cols * handle.count * out.itemsize
    if handle.count == 1 or block_bytes > LARGEST_SLAB_BYTES:
        with reading(path):
            handle.read(window=gdal_window(window), out=out.transpose(2, 0, 1))
        return
    # GDAL interleaves bands four times slower than the kernel does; in slabs the planes stay in the cache.
    for slab in slabs_of(handle, window, out.itemsize):
        planes = SCRATCH.array("planes", (handle.count, slab.rows, slab.cols), out.dtype)
        with reading(path):
            handle.read(window=gdal_window(slab), out=planes)
        interleave(planes, out[slab.row0 - window.row0 : slab.row1 - window.row0])


def slabs_of(handle: Any, window: Window, itemsize: int) -> Iterator[Window]:
    """Parts of a window, from left to right edge, that end where blocks do: no block is decoded twice."""
    block_rows = min(handle.block_shapes[0][0], handle.height)
    block_bytes = block_rows * window.cols * handle.count * itemsize
    step = block_rows * max(1, _SLAB_BYTES // block_bytes)
    row = window.row0
    while row < window.row1:
        end = min((row // step + 1) * step, window.row1)
        yield Window(window.col0, row, window.cols, end - row)
        row = end


def gdal_window(window: Window) -> Any:
    """A window as rasterio takes it."""
    return GdalWindow(window.col0, window.row0, window.cols, window.rows)
