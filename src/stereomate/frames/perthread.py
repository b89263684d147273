"""PROJ objects, one set per thread, with the network off."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from typing import Any

import pyproj.network


class _ThreadState(threading.local):
    """PROJ objects of one thread: a PROJ context belongs to a thread, and so do the objects made in it."""

    def __init__(self) -> None:
        # Per thread, because PROJ keeps this switch in the context: a downloaded grid would change results
        # silently.
        pyproj.network.set_network_enabled(active=False)  # type: ignore[attr-defined]
        self.cache: dict[tuple[Any, ...], Any] = {}


@functools.lru_cache(maxsize=1)
def _thread_state() -> _ThreadState:
    return _ThreadState()


def per_thread(key: tuple[Any, ...], build: Callable[[], Any]) -> Any:
    """Value of `build()` made once per thread and `key`."""
    cache = _thread_state().cache
    if key not in cache:
        cache[key] = build()
    return cache[key]
