"""The plan of the blocks as a value: which pixels each task makes, computed without reading any.

A raster is cut into square tiles of `block` pixels (as stored in the file) and square chunks of
`chunk_tiles` x `chunk_tiles` tiles (as worked on by one task). With a power of two tiles per side every tile
of the first overview levels lies inside one chunk. Chunks follow each other in quad-tree (Morton) order, so
that tasks that run at the same time look at the same part of the photographs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from stereomate.errors import InputError
from stereomate.raster.windows import Window


@dataclass(frozen=True)
class Chunk:
    """What one task makes.

    Attributes
    ----------
    index : int
        Place in quad-tree order, from 0; names the chunk in the ledger.
    col, row : int
        Place in the grid of chunks.
    window : Window
        Its pixels in the raster; smaller than a whole chunk at the right and lower edge only.
    """

    index: int
    col: int
    row: int
    window: Window


@dataclass(frozen=True)
class TilePlan:
    """Tiles and chunks of a raster.

    Parameters
    ----------
    size : (int, int)
        Columns and rows of the raster.
    block : int
        Edge of a tile in pixels, a multiple of 16 (as TIFF demands).
    chunk_tiles : int
        Tiles per side of a chunk, a power of two.

    Raises
    ------
    InputError
        If a number is not positive, or breaks the rule above.
    """

    size: tuple[int, int]
    block: int = 512
    chunk_tiles: int = 4

    def __post_init__(self) -> None:
        if min(self.size) < 1:
            raise InputError("must be two positive integers", field="size", value=self.size)
        if self.block < 16 or self.block % 16:
            raise InputError("must be a positive multiple of 16", field="block", value=self.block)
        if self.chunk_tiles < 1 or self.chunk_tiles & (self.chunk_tiles - 1):
            raise InputError("must be a power of two", field="chunk_tiles", value=self.chunk_tiles)

    @property
    def chunk_px(self) -> int:
        """Edge of a chunk in pixels."""
        return self.block * self.chunk_tiles

    @property
    def grid(self) -> tuple[int, int]:
        """Columns and rows of chunks."""
        return (-(-self.size[0] // self.chunk_px), -(-self.size[1] // self.chunk_px))

    @cached_property
    def chunks(self) -> tuple[Chunk, ...]:
        """All chunks in quad-tree order."""
        cols, rows = self.grid
        places = sorted(((c, r) for r in range(rows) for c in range(cols)), key=lambda p: morton_code(*p))
        return tuple(Chunk(i, c, r, self.window_of(c, r)) for i, (c, r) in enumerate(places))

    @cached_property
    def _index_of_place(self) -> dict[tuple[int, int], int]:
        return {(chunk.col, chunk.row): chunk.index for chunk in self.chunks}

    def chunk_at(self, col: int, row: int) -> Chunk:
        """The chunk at a place of the grid of chunks."""
        return self.chunks[self._index_of_place[col, row]]

    def window_of(self, col: int, row: int) -> Window:
        """Pixels of the chunk at a place of the grid of chunks."""
        edge = self.chunk_px
        return Window(col * edge, row * edge, edge, edge).clamped(self.size)


def morton_code(col: int, row: int) -> int:
    """Rank along the Z-order curve: bits of column and row interleaved, the column's lowest first.

    >>> [morton_code(c, r) for r in (0, 1) for c in (0, 1, 2)]
    [0, 1, 4, 2, 3, 6]
    """
    code = 0
    for bit in range(max(col, row).bit_length()):
        code |= ((col >> bit) & 1) << (2 * bit) | ((row >> bit) & 1) << (2 * bit + 1)
    return code
