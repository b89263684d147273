"""Photographs of formats without windows (JPEG, PNG): decoded once, then read by windows like any other.

As long as they fit, decoded photographs are kept in memory; all others in temporary files without a name,
which disappear with the process. Only where the disk has no room for them either, one is decoded again.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
import threading
import weakref
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from stereomate.raster.settings import current
from stereomate.raster.windows import Window

Image = NDArray[Any]

# Left free on the disk of temporary files, for whoever else needs it.
_DISK_RESERVE_BYTES: Final = 2 * 1024**3


@dataclass(frozen=True)
class Decoder:
    """How to decode a photograph.

    Attributes
    ----------
    shape : (int, int, int)
        Rows, columns, bands.
    dtype : numpy dtype
    slabs : callable
        Yields the image as arrays (some rows, columns, bands), top down; each may be overwritten by the next.
    """

    shape: tuple[int, int, int]
    dtype: np.dtype[Any]
    slabs: Callable[[], Iterator[Image]]

    @property
    def nbytes(self) -> int:
        """Bytes of the decoded image."""
        return int(np.prod(self.shape, dtype=np.int64)) * self.dtype.itemsize


class Decoded(Protocol):
    """A decoded photograph, wherever it is."""

    nbytes: int
    in_memory: bool

    def read(self, window: Window, out: Image) -> None:
        """Copy a window that lies inside the image to `out`, C-contiguous (rows, columns, bands)."""


class _InMemory:
    in_memory = True

    def __init__(self, decoder: Decoder) -> None:
        self.nbytes = decoder.nbytes
        self._image = np.empty(decoder.shape, decoder.dtype)
        row = 0
        for slab in decoder.slabs():
            self._image[row : row + slab.shape[0]] = slab
            row += slab.shape[0]

    def read(self, window: Window, out: Image) -> None:
        out[...] = self._image[window.row0 : window.row1, window.col0 : window.col1]


class _OnDisk:
    in_memory = False

    def __init__(self, decoder: Decoder) -> None:
        self.nbytes = decoder.nbytes
        self._pixel = decoder.shape[2] * decoder.dtype.itemsize
        self._row = decoder.shape[1] * self._pixel
        with tempfile.TemporaryFile() as file:
            for slab in decoder.slabs():
                file.write(np.ascontiguousarray(slab).data)
            file.flush()
            # A handle of its own: it is closed when the last reader lets go, not when the cache does.
            self._handle = os.dup(file.fileno())
        weakref.finalize(self, os.close, self._handle)

    def read(self, window: Window, out: Image) -> None:
        start = window.row0 * self._row + window.col0 * self._pixel
        rows = out.reshape(window.rows, -1).view(np.uint8)
        if rows.shape[1] == self._row:
            rows = rows.reshape(1, -1)
        for number in range(rows.shape[0]):
            view, at = rows[number].data, start + number * self._row
            while view:
                count = os.preadv(self._handle, [view], at)
                if count == 0:
                    raise OSError(f"a temporary file in {tempfile.gettempdir()} became shorter")
                view, at = view[count:], at + count


class DecodedCache:
    """Decoded photographs of this process. Two threads that ask for the same one decode it once.

    Parameters
    ----------
    memory_limit, disk_room : callable
        Bytes that may be in memory in all, and bytes that a temporary file may take now.
    """

    def __init__(self, memory_limit: Callable[[], int], disk_room: Callable[[], int]) -> None:
        self._memory_limit, self._disk_room = memory_limit, disk_room
        self._images: OrderedDict[Hashable, Decoded] = OrderedDict()
        self._decoding: dict[Hashable, threading.Lock] = {}
        self._lock = threading.Lock()

    def get(self, key: Hashable, decoder: Decoder) -> Decoded:
        """The photograph of a key, decoded now if it is not there. Errors of the decoder pass through."""
        with self._lock:
            if key in self._images:
                self._images.move_to_end(key)
                return self._images[key]
            turn = self._decoding.setdefault(key, threading.Lock())
        with turn:
            with self._lock:
                if key in self._images:
                    return self._images[key]
            try:
                image = self._decode(decoder)
                with self._lock:
                    self._images[key] = image
            finally:
                with self._lock:
                    self._decoding.pop(key, None)
        return image

    def discard(self, key: Hashable) -> None:
        """Forget a photograph; its memory or file goes when the last reader lets it go."""
        with self._lock:
            self._images.pop(key, None)

    def held_bytes(self, in_memory: bool) -> int:
        """Bytes held now, in memory or on disk."""
        with self._lock:
            return self._held(in_memory)

    def _held(self, in_memory: bool) -> int:
        return sum(image.nbytes for image in self._images.values() if image.in_memory == in_memory)

    def _decode(self, decoder: Decoder) -> Decoded:
        with self._lock:
            fits = self._held(in_memory=True) + decoder.nbytes <= self._memory_limit()
        if fits:
            return _InMemory(decoder)
        self._make_room(decoder.nbytes, in_memory=False, room=self._disk_room)
        if decoder.nbytes <= self._disk_room():
            # Somebody else may fill the disk meanwhile.
            with contextlib.suppress(OSError):
                return _OnDisk(decoder)
        self._make_room(decoder.nbytes, in_memory=True, room=self._memory_room)
        return _InMemory(decoder)

    def _memory_room(self) -> int:
        return self._memory_limit() - self.held_bytes(in_memory=True)

    def _make_room(self, size: int, in_memory: bool, room: Callable[[], int]) -> None:
        """Forget photographs, those not used for longest first, until there is room for `size` bytes."""
        while room() < size:
            with self._lock:
                old = next((k for k, i in self._images.items() if i.in_memory == in_memory), None)
                if old is None:
                    return
                del self._images[old]


def _free_disk_bytes() -> int:
    return shutil.disk_usage(tempfile.gettempdir()).free - _DISK_RESERVE_BYTES


DECODED = DecodedCache(lambda: current().decoded_cache_bytes, _free_disk_bytes)
