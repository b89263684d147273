"""Sizes of the overview levels and their tiles; the plan of the blocks as this folder sees it."""

from __future__ import annotations

from typing import Protocol

from stereomate.raster.windows import Window


class PlacedChunk(Protocol):
    """A chunk of the plan: its place in the ledger, in the grid of chunks, and its pixels."""

    @property
    def index(self) -> int: ...
    @property
    def col(self) -> int: ...
    @property
    def row(self) -> int: ...
    @property
    def window(self) -> Window: ...


class Layout(Protocol):
    """What is needed of `stereomate.tiles.TilePlan`."""

    @property
    def size(self) -> tuple[int, int]: ...
    @property
    def block(self) -> int: ...
    @property
    def chunk_tiles(self) -> int: ...
    @property
    def grid(self) -> tuple[int, int]: ...
    @property
    def chunks(self) -> tuple[PlacedChunk, ...]: ...
    def chunk_at(self, col: int, row: int) -> PlacedChunk: ...


class BlobSource(Protocol):
    """What is needed of `stereomate.tiles.Ledger`."""

    def read(self, index: int, name: str, offset: int, size: int) -> bytes: ...


def overview_count(layout: Layout) -> int:
    """Overview levels until the image fits one tile, each half of the one before."""
    count = 0
    while max(level_size(layout, count)) > layout.block:
        count += 1
    return count


def level_size(layout: Layout, level: int) -> tuple[int, int]:
    """Columns and rows of the image at a level; 0 is full resolution."""
    return _halved(layout.size, level)


def _halved(size: tuple[int, int], level: int) -> tuple[int, int]:
    step = 1 << level
    return (-(-size[0] // step), -(-size[1] // step))


def level_tiles(layout: Layout, level: int) -> tuple[int, int]:
    """Columns and rows of tiles at a level."""
    cols, rows = level_size(layout, level)
    return (-(-cols // layout.block), -(-rows // layout.block))


def chunk_levels(layout: Layout) -> int:
    """Overview levels whose tiles lie inside one chunk: the task that makes the chunk encodes them."""
    return min(layout.chunk_tiles.bit_length() - 1, overview_count(layout))


def tiles_of_window(window_size: tuple[int, int], block: int, level: int) -> tuple[int, int]:
    """Columns and rows of tiles of a chunk of (columns, rows) at a level."""
    cols, rows = _halved(window_size, level)
    return (-(-cols // block), -(-rows // block))
