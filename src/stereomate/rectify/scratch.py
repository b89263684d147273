"""Buffers that a thread uses again for every chunk; names are those of this folder alone."""

from __future__ import annotations

from typing import Any

from numpy.typing import DTypeLike, NDArray

from stereomate.raster.scratch import Scratch

_BUFFERS = Scratch()


def scratch(name: str, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """An array of this thread, uninitialised, valid until the same name is asked for again."""
    return _BUFFERS.array(name, shape, dtype)
