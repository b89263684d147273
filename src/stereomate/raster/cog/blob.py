"""The blob of a chunk: its encoded tiles of all levels, one after the other, and a header that says where.

    "SMCB", length of the header (uint32), header (JSON), tiles

Tiles follow level by level from full resolution, row by row; a tile's mask follows the tile. Last comes what
the next level, above the chunk, needs of it: pixels and validity of the coarsest level, reduced once more.
"""

from __future__ import annotations

import json
import struct
from dataclasses import asdict, dataclass
from typing import Final, Self

from stereomate.errors import FormatError
from stereomate.raster.cog.layout import BlobSource
from stereomate.raster.cog.statistics import BandStatistics

_MAGIC: Final = b"SMCB"
_HEAD: Final = struct.Struct("<4sI")


@dataclass(frozen=True)
class BlobHeader:
    """What is in the blob of a chunk.

    Attributes
    ----------
    sizes : tuple of (int, int)
        Bytes of each tile and of its mask; 0 where a tile has no valid pixel, or there are no masks.
    reduced : (int, int)
        Bytes of the pixels and validity for the next level; 0 where there is none, or nothing is valid.
    statistics : tuple of BandStatistics
        Of each band; empty if they are not wanted.
    """

    sizes: tuple[tuple[int, int], ...]
    reduced: tuple[int, int]
    statistics: tuple[BandStatistics, ...]

    def to_bytes(self) -> bytes:
        """The beginning of the blob."""
        text = json.dumps(asdict(self), separators=(",", ":")).encode()
        return _HEAD.pack(_MAGIC, len(text)) + text

    @classmethod
    def read(cls, source: BlobSource, index: int, name: str) -> tuple[Self, int]:
        """Header of a chunk's blob, and where its first tile begins.

        Raises
        ------
        FormatError
            If the blob is none of this kind.
        """
        magic, length = _HEAD.unpack(source.read(index, name, 0, _HEAD.size))
        if magic != _MAGIC:
            raise FormatError("must be the blob of a chunk of tiles", field=f"{name} of chunk {index}")
        facts = json.loads(source.read(index, name, _HEAD.size, length))
        header = cls(
            tuple((data, mask) for data, mask in facts["sizes"]),
            (facts["reduced"][0], facts["reduced"][1]),
            tuple(BandStatistics(**band) for band in facts["statistics"]),
        )
        return header, _HEAD.size + length
