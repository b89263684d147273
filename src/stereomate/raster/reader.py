"""Reading photographs by windows, from any number of threads.

GDAL's handles serve one thread at a time: a reader keeps a stock of handles and lends one per call, so that
windows are read side by side. Formats without windows are decoded once into a shared, bounded cache.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self, cast

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import ImageError
from stereomate.raster.decoded import DECODED, Decoder
from stereomate.raster.handles import LARGEST_SLAB_BYTES, Handles, gdal_window, read_pixels, reading, slabs_of
from stereomate.raster.info import info_of
from stereomate.raster.scratch import SCRATCH
from stereomate.raster.windows import Window


class PhotoReader:
    """A photograph read by windows; made by `open_photo`, closed by ``with`` or `close`.

    Safe to use from any number of threads. Pickles as its path, so tasks may carry it to other processes.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._handles = Handles(Path(path))
        with self._handles.lend() as handle:
            self.info = info_of(self._handles.path, handle)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __reduce__(self) -> tuple[type[PhotoReader], tuple[str]]:
        return (type(self), (str(self.info.path),))

    @property
    def path(self) -> Path:
        """The file."""
        return self.info.path

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows."""
        return self.info.size

    @property
    def bands(self) -> int:
        """Bands, an alpha band included."""
        return self.info.bands

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the pixels."""
        return self.info.dtype

    @property
    def nodata(self) -> float | None:
        """Value that means no data."""
        return self.info.nodata

    @property
    def is_windowed(self) -> bool:
        """Whether a window can be read without decoding the rest."""
        return self.info.is_windowed

    def read_window(
        self, col0: int, row0: int, cols: int, rows: int, out: NDArray[Any] | None = None
    ) -> tuple[NDArray[Any], Window]:
        """Pixels of a window, clamped to the image.

        Parameters
        ----------
        col0, row0, cols, rows : int
            The window wanted; may reach beyond the image.
        out : ndarray, optional
            A one-dimensional buffer of the photograph's type, to be used again from call to call. If it
            is large enough, the pixels are a view of its beginning.

        Returns
        -------
        pixels : ndarray, shape (rows, cols, bands)
            C-contiguous. Empty where nothing is inside.
        window : Window
            The window that was read.

        Raises
        ------
        ImageError
            If the file is damaged there.
        """
        window = Window(col0, row0, cols, rows).clamped(self.size)
        shape = (window.rows, window.cols, self.bands)
        count = math.prod(shape)
        if out is not None and out.size >= count and out.dtype == self.dtype:
            pixels = out[:count].reshape(shape)
        else:
            pixels = np.empty(shape, self.dtype)
        if window.is_empty:
            return pixels, window
        if self.is_windowed:
            with self._handles.lend() as handle:
                read_pixels(self.path, handle, window, pixels)
        else:
            decoder = Decoder((self.size[1], self.size[0], self.bands), self.dtype, self._slabs)
            DECODED.get(_cache_key(self.path), decoder).read(window, pixels)
        return pixels, window

    def read_mask(self, col0: int, row0: int, cols: int, rows: int) -> tuple[NDArray[np.bool_], Window]:
        """Which pixels of a window are valid: from the mask, alpha or nodata of the file, else all.

        A pixel is valid if any of its bands is (GDAL's dataset mask).

        Returns
        -------
        valid : ndarray of bool, shape (rows, cols)
        window : Window
            The window that was read, clamped to the image.
        """
        window = Window(col0, row0, cols, rows).clamped(self.size)
        if window.is_empty or not (self.info.has_mask or self.info.nodata is not None):
            return np.ones((window.rows, window.cols), np.bool_), window
        if not self.is_windowed and (self.info.alpha_band is not None or not self.info.has_mask):
            return self._mask_of_pixels(window), window
        with self._handles.lend() as handle, reading(self.path):
            mask = handle.dataset_mask(window=gdal_window(window))
        return cast(NDArray[np.bool_], mask != 0), window

    def _mask_of_pixels(self, window: Window) -> NDArray[np.bool_]:
        """The mask of a format without windows from its decoded pixels: GDAL would decode them again."""
        pixels, _ = self.read_window(*window)
        if self.info.alpha_band is not None:
            return cast(NDArray[np.bool_], pixels[..., self.info.alpha_band] != 0)
        return cast(NDArray[np.bool_], (pixels != self.info.nodata).any(axis=2))

    def require_complete(self) -> None:
        """Find out, without decoding pixels where the format allows it, whether the file was cut off.

        Raises
        ------
        ImageError
            If blocks of a TIFF lie beyond its end, or another format cannot be decoded to its last row.
        """
        with self._handles.lend() as handle:
            if self.info.driver == "GTiff":
                _require_blocks_inside(self.path, handle)
                return
        self.read_window(0, self.size[1] - 1, self.size[0], 1)

    def close(self) -> None:
        """Close all handles and forget the decoded image."""
        DECODED.discard(_cache_key(self.path))
        self._handles.close()

    def _slabs(self) -> Iterator[NDArray[Any]]:
        """The whole image, top down, decoded once."""
        if self.info.driver == "PNG":
            _require_png_end(self.path)
        with self._handles.lend() as handle:
            for window in slabs_of(handle, Window(0, 0, *self.size), self.dtype.itemsize):
                slab = self._slab_buffer((window.rows, window.cols, self.bands))
                read_pixels(self.path, handle, window, slab)
                yield slab

    def _slab_buffer(self, shape: tuple[int, int, int]) -> NDArray[Any]:
        # An image that is one strip comes as one slab: too large to be kept by the thread.
        large = math.prod(shape) * self.dtype.itemsize > LARGEST_SLAB_BYTES
        return np.empty(shape, self.dtype) if large else SCRATCH.array("slab", shape, self.dtype)


def open_photo(path: str | os.PathLike[str]) -> PhotoReader:
    """Open a photograph.

    Raises
    ------
    ImageError
        If the file is missing, is no raster, or is cut off.
    """
    return PhotoReader(path)


def _cache_key(path: Path) -> tuple[str, int, int]:
    try:
        facts = path.stat()
    except OSError:
        return (str(path), 0, 0)
    return (str(path), facts.st_mtime_ns, facts.st_size)


def _require_blocks_inside(path: Path, handle: Any) -> None:
    size = path.stat().st_size
    rows, cols = handle.block_shapes[0]
    by_band = handle.interleaving is not None and handle.interleaving.value == "BAND"
    for band in range(1, (handle.count if by_band else 1) + 1):
        for row in range(-(-handle.height // rows)):
            for col in range(-(-handle.width // cols)):
                offset = handle.get_tag_item(f"BLOCK_OFFSET_{col}_{row}", "TIFF", bidx=band)
                length = handle.get_tag_item(f"BLOCK_SIZE_{col}_{row}", "TIFF", bidx=band)
                if offset is not None and int(offset) + int(length or 0) > size:
                    raise ImageError(
                        "is cut off: a block lies beyond its end", file=path, value=f"{size} bytes"
                    )


def _require_png_end(path: Path) -> None:
    # GDAL fills the rows of a PNG that is cut off with zeros and says nothing.
    with path.open("rb") as file:
        file.seek(max(path.stat().st_size - 65536, 0))
        if b"IEND" not in file.read():
            raise ImageError("is cut off: a PNG ends with IEND", file=path)
