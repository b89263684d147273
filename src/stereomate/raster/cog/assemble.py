"""Assembling a Cloud Optimized GeoTIFF from the blobs of its chunks.

The levels above the chunks are made here, from what the chunks left of themselves. Then everything is
written once, front to back: header, coarsest level, ..., full resolution. The bytes depend on the blobs only,
not on the order in which they were made.
"""

from __future__ import annotations

import glob
import os
import struct
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Final

import numpy as np
from numpy.typing import NDArray

from stereomate.raster.cog.blob import BlobHeader
from stereomate.raster.cog.codecs import bound_of
from stereomate.raster.cog.directories import ghost_area, image_directory, mask_directory
from stereomate.raster.cog.encode import Patch, encode_tile_of, halved, unpack_patch
from stereomate.raster.cog.georeference import Georeference, template_tags
from stereomate.raster.cog.layout import (
    BlobSource,
    Layout,
    PlacedChunk,
    chunk_levels,
    level_size,
    level_tiles,
    overview_count,
    tiles_of_window,
)
from stereomate.raster.cog.profile import CogProfile
from stereomate.raster.cog.statistics import BandStatistics, merged
from stereomate.raster.cog.tags import Directory, Tag, header_bytes, header_size
from stereomate.raster.files import replacing, storing, sweep, write_all
from stereomate.raster.scratch import SCRATCH

_CLASSIC_LIMIT: Final = 2**32 - 1
_SPOOL_BYTES: Final = 16 * 1024**2
# Size before a tile, last bytes after it.
_LEADER, _TRAILER = 4, 4
# The chunk number of tiles that are made here.
_HERE: Final = -1


@dataclass(frozen=True)
class _LevelIndex:
    """Where the tiles of a level are now: arrays (tile rows, tile columns)."""

    chunk: NDArray[np.int64]
    at: NDArray[np.int64]
    data: NDArray[np.uint64]
    mask: NDArray[np.uint64]

    @classmethod
    def empty(cls, tiles: tuple[int, int]) -> _LevelIndex:
        shape = (tiles[1], tiles[0])
        integers, sizes = np.int64, np.uint64
        return cls(
            np.full(shape, _HERE, integers),
            np.zeros(shape, integers),
            np.zeros(shape, sizes),
            np.zeros(shape, sizes),
        )

    def put(self, place: tuple[int, int], chunk: int, at: int, sizes: tuple[int, int]) -> None:
        """Note where the tile at (row, column) is, and how large it and its mask are."""
        self.chunk[place], self.at[place], self.data[place], self.mask[place] = chunk, at, *sizes

    def bytes_in_file(self) -> NDArray[np.uint64]:
        """Bytes each tile takes with its mask, and what stands around them."""
        return _in_file(self.data) + _in_file(self.mask)


def assemble_cog(
    path: str | os.PathLike[str],
    profile: CogProfile,
    layout: Layout,
    source: BlobSource,
    name: str,
    georeference: Georeference,
) -> tuple[BandStatistics, ...]:
    """Write a Cloud Optimized GeoTIFF, whole or not at all.

    Parameters
    ----------
    path : path
        The file; replaced when it is complete and on disk.
    profile : CogProfile
        What the chunks were encoded with.
    layout : TilePlan
        The plan they are from.
    source : Ledger
        Holds every chunk of the plan.
    name : str
        Of the blobs that `encode_chunk` made.
    georeference : Georeference
        Where the raster lies.

    Returns
    -------
    tuple of BandStatistics
        Of the valid pixels of each band; empty counts where the profile wants none.

    Raises
    ------
    StorageError
        If the file cannot be written.
    CrsError
        If the CRS is unknown.
    """
    target = Path(path)
    with storing(target), tempfile.SpooledTemporaryFile(_SPOOL_BYTES, dir=str(target.parent)) as spool:
        assembly = _Assembly(profile, layout, source, name, spool)
        statistics = assembly.index_chunks()
        assembly.make_upper_levels()
        tags = template_tags(profile, georeference, statistics)
        sweep(target.parent, glob.escape(target.name))
        with replacing(target, durable=True) as file:
            write_all(file, [assembly.header(tags)])
            for index in reversed(assembly.levels):
                write_all(file, assembly.tiles_of(index))
    return statistics


class _Assembly:
    """One file in the making: where all its tiles are, and those that are made here."""

    def __init__(
        self, profile: CogProfile, layout: Layout, source: BlobSource, name: str, spool: IO[bytes]
    ) -> None:
        self.profile, self.layout, self.source, self.name, self.spool = profile, layout, source, name, spool
        self.count = overview_count(layout)
        self.inside = chunk_levels(layout)
        self.levels = [_LevelIndex.empty(level_tiles(layout, level)) for level in range(self.count + 1)]
        self.reduced: dict[tuple[int, int], tuple[int, int, tuple[int, int]]] = {}

    def index_chunks(self) -> tuple[BandStatistics, ...]:
        """Find the tiles of every chunk; the statistics of all."""
        by_band: list[list[BandStatistics]] = [[] for _ in range(self.profile.bands)]
        for chunk in self.layout.chunks:
            header, start = BlobHeader.read(self.source, chunk.index, self.name)
            if header.sizes:
                end = self._index_tiles(chunk, header, start)
                if header.reduced[0]:
                    self.reduced[chunk.col, chunk.row] = (chunk.index, end, header.reduced)
            for parts, of_band in zip(by_band, header.statistics, strict=False):
                parts.append(of_band)
        return tuple(merged(parts) for parts in by_band)

    def _index_tiles(self, chunk: PlacedChunk, header: BlobHeader, at: int) -> int:
        sizes = iter(header.sizes)
        for level in range(self.inside + 1):
            index = self.levels[level]
            cols, rows = tiles_of_window((chunk.window.cols, chunk.window.rows), self.layout.block, level)
            per_side = self.layout.chunk_tiles >> level
            for row in range(chunk.row * per_side, chunk.row * per_side + rows):
                for col in range(chunk.col * per_side, chunk.col * per_side + cols):
                    data, mask = next(sizes)
                    index.put((row, col), chunk.index, at, (data, mask))
                    at += data + mask
        return at

    def make_upper_levels(self) -> None:
        """Encode the tiles of the levels above the chunks, into the spool."""
        if self.count > self.inside:
            self._reduced_tile(self.count, 0, 0)

    def _reduced_tile(self, level: int, col: int, row: int) -> Patch | None:
        """Half a tile of a level, after encoding it and all below it; None where nothing is valid.

        Depth first, so memory holds one tile of each level, however large the image.
        """
        if level == self.inside:
            return self._reduced_chunk(col, row)
        patch = self._mosaic(level, col, row)
        if patch is None:
            return None
        block, profile = self.layout.block, self.profile
        room = block * block * profile.bands * profile.numpy_dtype.itemsize
        out = SCRATCH.array("arena", (2 * bound_of(room),), np.uint8).data
        sizes = encode_tile_of(profile, block, patch, (0, 0), out)
        self.levels[level].put((row, col), _HERE, self.spool.seek(0, os.SEEK_END), sizes)
        self.spool.write(out[: sum(sizes)])
        if level == self.count:
            return None
        half = halved(profile, patch, "level 0")
        # The buffers serve the next tile: keep a copy.
        return Patch(half.pixels.copy(), None if half.valid is None else half.valid.copy())

    def _reduced_chunk(self, col: int, row: int) -> Patch | None:
        if (col, row) not in self.reduced:
            return None
        index, at, (pixels, valid) = self.reduced[col, row]
        window = self.layout.chunk_at(col, row).window
        step = 2 << self.inside
        size = (-(-window.cols // step), -(-window.rows // step))
        data = self.source.read(index, self.name, at, pixels + valid)
        return unpack_patch(self.profile, size, data[:pixels], data[pixels:])

    def _mosaic(self, level: int, col: int, row: int) -> Patch | None:
        """A tile of a level from the halves of the four below it."""
        block, half = self.layout.block, self.layout.block // 2
        level_cols, level_rows = level_size(self.layout, level)
        shape = (min(block, level_rows - row * block), min(block, level_cols - col * block))
        tiles_below = level_tiles(self.layout, level - 1)
        pixels = np.zeros((*shape, self.profile.bands), self.profile.numpy_dtype)
        valid = np.zeros(shape, np.uint8)
        for down, right in ((0, 0), (0, 1), (1, 0), (1, 1)):
            below = (2 * col + right, 2 * row + down)
            if below[0] >= tiles_below[0] or below[1] >= tiles_below[1]:
                continue
            part = self._reduced_tile(level - 1, *below)
            if part is not None:
                place = (
                    slice(down * half, down * half + part.pixels.shape[0]),
                    slice(right * half, right * half + part.pixels.shape[1]),
                )
                pixels[place] = part.pixels
                valid[place] = 1 if part.valid is None else part.valid
        if not valid.any():
            return None
        return Patch(pixels, None if valid.all() else valid)

    def header(self, tags: Mapping[int, Tag]) -> bytes:
        """Everything before the first tile."""
        ghost = ghost_area(self.profile.mask)
        total = sum(int(index.bytes_in_file().sum()) for index in self.levels)
        nowhere = [np.zeros_like(index.data) for index in self.levels]
        big = header_size(self._directories(tags, nowhere), False, ghost) + total > _CLASSIC_LIMIT
        at = header_size(self._directories(tags, nowhere), big, ghost)
        starts = list(nowhere)
        for level in reversed(range(len(self.levels))):
            in_file = self.levels[level].bytes_in_file()
            ends = at + np.cumsum(in_file, dtype=np.uint64).reshape(in_file.shape)
            starts[level] = ends - in_file
            at += int(in_file.sum())
        return header_bytes(self._directories(tags, starts), big, ghost)

    def _directories(self, tags: Mapping[int, Tag], starts: Sequence[NDArray[np.uint64]]) -> list[Directory]:
        directories = []
        for number, (index, start) in enumerate(zip(self.levels, starts, strict=True)):
            level = (number, level_size(self.layout, number))
            block = self.layout.block
            image = (np.where(index.data > 0, start + _LEADER, 0).astype(np.uint64), index.data)
            directories.append(image_directory(self.profile, block, level, tags, image))
            if self.profile.mask:
                after = start + _in_file(index.data)
                mask = (np.where(index.mask > 0, after + _LEADER, 0).astype(np.uint64), index.mask)
                directories.append(mask_directory(self.profile, block, level, mask))
        return directories

    def tiles_of(self, index: _LevelIndex) -> Iterator[bytes]:
        """The tiles of a level row by row, each with its mask, as they stand in the file."""
        facts = (index.chunk, index.at, index.data, index.mask)
        for chunk, at, data, mask in zip(*(a.ravel().tolist() for a in facts), strict=True):
            if not data:
                continue
            if chunk == _HERE:
                self.spool.seek(at)
                encoded = self.spool.read(data + mask)
            else:
                encoded = self.source.read(chunk, self.name, at, data + mask)
            yield b"".join(_framed(encoded[:data]) + (_framed(encoded[data:]) if mask else ()))


def _framed(data: bytes) -> tuple[bytes, bytes, bytes]:
    return (struct.pack("<I", len(data)), data, data[-_TRAILER:].rjust(_TRAILER, b"\0"))


def _in_file(sizes: NDArray[np.uint64]) -> NDArray[np.uint64]:
    return np.where(sizes > 0, sizes + _LEADER + _TRAILER, 0).astype(np.uint64)
