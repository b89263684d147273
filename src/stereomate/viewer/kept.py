"""Files of a page that were made lately, so that many clients of one place cost what one does."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from typing import Final

# Tiles of some hundred kilobytes: those of a few views.
_BYTES: Final = 96 << 20
# A file that is larger than this part of all is not kept.
_LARGEST: Final = 8


class KeptFiles:
    """Contents by name, the least recently asked for given up first; one that is being made is waited for.

    Safe to use from any number of threads.
    """

    def __init__(self, capacity: int = _BYTES) -> None:
        self._capacity = capacity
        self._lock = threading.Lock()
        self._kept: OrderedDict[str, bytes] = OrderedDict()
        self._making: dict[str, Future[bytes]] = {}
        self._size = 0

    def get(self, name: str, make: Callable[[str], bytes]) -> bytes:
        """A file, made by `make` where it is not kept; what `make` raises is raised."""
        made: Future[bytes] = Future()
        with self._lock:
            content = self._kept.get(name)
            if content is not None:
                self._kept.move_to_end(name)
                return content
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

    def _keep(self, name: str, content: bytes) -> None:
        if len(content) * _LARGEST > self._capacity:
            return
        with self._lock:
            self._kept[name] = content
            self._size += len(content)
            while self._size > self._capacity:
                _, old = self._kept.popitem(last=False)
                self._size -= len(old)
