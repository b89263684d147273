"""Contents that were made lately, so that many clients of one place cost what one does."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from concurrent.futures import CancelledError, Future
from typing import Final, Generic, TypeVar

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")

# Tiles of some hundred kilobytes: those of a few views.
_BYTES: Final = 96 << 20
# A content that is larger than this part of all is not kept.
_LARGEST: Final = 8


class Kept(Generic[K, V]):
    """Contents by name, the least recently asked for given up first; one that is being made is waited for.

    Safe to use from any number of threads.

    Parameters
    ----------
    size_of : function
        Bytes of a content.
    capacity : int
        Bytes of all.
    """

    def __init__(self, size_of: Callable[[V], int], capacity: int = _BYTES) -> None:
        self._size_of, self._capacity = size_of, capacity
        self._lock = threading.Lock()
        self._kept: OrderedDict[K, V] = OrderedDict()
        self._making: dict[K, Future[V]] = {}
        self._size = 0

    def get(self, name: K, make: Callable[[K], V]) -> V:
        """A content, made by `make` where it is not kept; what `make` raises is raised."""
        made: Future[V] = Future()
        with self._lock:
            if name in self._kept:
                self._kept.move_to_end(name)
                return self._kept[name]
            first = self._making.setdefault(name, made)
        if first is not made:
            try:
                return first.result()
            except CancelledError:
                # it could not be made: whoever waited is told why, too
                return make(name)
        try:
            content = make(name)
            made.set_result(content)
            self._keep(name, content)
            return content
        finally:
            with self._lock:
                del self._making[name]
            made.cancel()

    def _keep(self, name: K, content: V) -> None:
        size = self._size_of(content)
        if size * _LARGEST > self._capacity:
            return
        with self._lock:
            self._kept[name] = content
            self._size += size
            while self._size > self._capacity:
                _, old = self._kept.popitem(last=False)
                self._size -= self._size_of(old)
