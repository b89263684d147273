"""Photographs of formats without windows (JPEG, PNG): decoded once, shared, and bounded in memory."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereomate.raster.settings import current

Image = NDArray[Any]


class DecodedCache:
    """Least recently used images, at most as many bytes as allowed, but always the newest one.

    Two threads that ask for the same image decode it once: the second waits for the first.
    """

    def __init__(self, limit_bytes: Callable[[], int]) -> None:
        self._limit_bytes = limit_bytes
        self._images: OrderedDict[Hashable, Image] = OrderedDict()
        self._decoding: dict[Hashable, threading.Lock] = {}
        self._lock = threading.Lock()

    def get(self, key: Hashable, decode: Callable[[], Image]) -> Image:
        """The image of a key, decoded now if it is not there. Errors of `decode` pass through."""
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
                image = decode()
                image.setflags(write=False)
                self._keep(key, image)
            finally:
                with self._lock:
                    self._decoding.pop(key, None)
        return image

    def discard(self, key: Hashable) -> None:
        """Forget an image; its memory goes when the last user lets it go."""
        with self._lock:
            self._images.pop(key, None)

    @property
    def held_bytes(self) -> int:
        """Bytes of the images held now."""
        with self._lock:
            return sum(image.nbytes for image in self._images.values())

    def _keep(self, key: Hashable, image: Image) -> None:
        with self._lock:
            self._images[key] = image
            held = sum(np.asarray(other).nbytes for other in self._images.values())
            while held > self._limit_bytes() and len(self._images) > 1:
                _, old = self._images.popitem(last=False)
                held -= old.nbytes


DECODED = DecodedCache(lambda: current().decoded_cache_bytes)
