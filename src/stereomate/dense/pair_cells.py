"""Cells of a pair as bytes: what a ledger keeps of it, by chunks of the grid."""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

from stereomate.dense.pair_surface import PairCells
from stereomate.raster.windows import Window

Floats32 = NDArray[np.float32]


def packed(cells: PairCells, window: Window) -> bytes | None:
    """A pair's cells in a window of the grid; None where it has none there."""
    shared = common(cells.window, window)
    if shared.is_empty:
        return None
    row, col = shared.row0 - cells.window.row0, shared.col0 - cells.window.col0
    part = (slice(row, row + shared.rows), slice(col, col + shared.cols))
    if not np.isfinite(cells.heights[part]).any():
        return None
    head = np.array([*shared], dtype=np.int64).tobytes()
    body = np.stack([cells.heights[part], cells.sigma[part]]).tobytes()
    return head + zlib.compress(body, 1)


def unpacked(parts: list[bytes], window: Window) -> tuple[Floats32, Floats32]:
    """Cells of a pair in a window."""
    out = np.full((2, window.rows, window.cols), np.nan, np.float32)
    for blob in parts:
        place = Window(*np.frombuffer(blob[:32], np.int64).tolist())
        values = np.frombuffer(zlib.decompress(blob[32:]), np.float32).reshape(2, place.rows, place.cols)
        shared = common(place, window)
        if shared.is_empty:
            continue
        there = (
            slice(None),
            slice(shared.row0 - window.row0, shared.row1 - window.row0),
            slice(shared.col0 - window.col0, shared.col1 - window.col0),
        )
        here = (
            slice(None),
            slice(shared.row0 - place.row0, shared.row1 - place.row0),
            slice(shared.col0 - place.col0, shared.col1 - place.col0),
        )
        out[there] = values[here]
    return out[0], out[1]


def common(one: Window, other: Window) -> Window:
    col0, row0 = max(one.col0, other.col0), max(one.row0, other.row0)
    col1, row1 = min(one.col1, other.col1), min(one.row1, other.row1)
    return Window(col0, row0, max(0, col1 - col0), max(0, row1 - row0))
