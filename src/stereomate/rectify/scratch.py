"""Buffers that a thread uses again for every chunk: the first touch of fresh memory is slow."""

from __future__ import annotations

import math
import threading
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

_BUFFERS = threading.local()


def scratch(name: str, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """An array of this thread, uninitialised, valid until the same name is asked for again."""
    size = math.prod(shape)
    store: dict[str, NDArray[np.uint8]] = _BUFFERS.__dict__
    kind = np.dtype(dtype)
    buffer = store.get(name)
    if buffer is None or buffer.nbytes < size * kind.itemsize:
        buffer = np.empty(size * kind.itemsize, np.uint8)
        store[name] = buffer
    return buffer[: size * kind.itemsize].view(kind).reshape(shape)
