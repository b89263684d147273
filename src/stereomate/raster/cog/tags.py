"""TIFF tags and image file directories as bytes (TIFF 6.0, section 2; BigTIFF: 8-byte counts and offsets)."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

BYTE, ASCII, SHORT, LONG, RATIONAL, DOUBLE, LONG8 = 1, 2, 3, 4, 5, 12, 16

_FORMATS: Final = {BYTE: "B", SHORT: "H", LONG: "I", RATIONAL: "II", DOUBLE: "d", LONG8: "Q"}


@dataclass(frozen=True)
class Tag:
    """A tag: number, type, how many values, and their little-endian bytes."""

    code: int
    dtype: int
    count: int
    data: bytes

    @classmethod
    def of_values(cls, code: int, dtype: int, values: Any) -> Self:
        """A tag of one value, a sequence, text, or an array of unsigned integers."""
        if isinstance(values, str):
            data = values.encode("utf-8") + b"\0"
            return cls(code, ASCII, len(data), data)
        if isinstance(values, bytes):
            return cls(code, dtype, len(values), values)
        if isinstance(values, np.ndarray):
            return cls(code, dtype, values.size, values.astype(f"<u{4 if dtype == LONG else 8}").tobytes())
        sequence = tuple(values) if isinstance(values, Iterable) else (values,)
        per_value = len(_FORMATS[dtype])
        return cls(
            code,
            dtype,
            len(sequence) // per_value,
            struct.pack("<" + _FORMATS[dtype] * (len(sequence) // per_value), *sequence),
        )


@dataclass(frozen=True)
class Directory:
    """One image of a file: its tags, and where its tiles are (0 bytes: there is none)."""

    tags: Sequence[Tag]
    offsets: NDArray[np.uint64]
    sizes: NDArray[np.uint64]


def header_size(directories: Sequence[Directory], big: bool, ghost: bytes) -> int:
    """Bytes before the first tile; does not depend on the offsets in the directories."""
    return len(header_bytes(directories, big, ghost))


def header_bytes(directories: Sequence[Directory], big: bool, ghost: bytes) -> bytes:
    """Everything before the first tile: TIFF header, `ghost` area, directories with their values behind each.

    Parameters
    ----------
    directories : sequence of Directory
        In the order of the file; the first is the main image.
    big : bool
        BigTIFF.
    ghost : bytes
        Bytes between the header and the first directory.
    """
    at = (16 if big else 8) + len(ghost)
    ghost += b"\0" * (at % 2)
    at += at % 2
    start = struct.pack("<2sHHHQ", b"II", 43, 8, 0, at) if big else struct.pack("<2sHI", b"II", 42, at)
    parts = [start, ghost]
    for number, directory in enumerate(directories):
        data = _directory_bytes(directory, at, big, last=number == len(directories) - 1)
        parts.append(data)
        at += len(data)
    return b"".join(parts)


def _directory_bytes(directory: Directory, at: int, big: bool, last: bool) -> bytes:
    offset_type = LONG8 if big else LONG
    tags = [
        *directory.tags,
        Tag.of_values(324, offset_type, directory.offsets),
        Tag.of_values(325, LONG, directory.sizes),
    ]
    tags.sort(key=lambda tag: tag.code)
    count_format, entry_format, offset_format = ("<Q", "<HHQ", "<Q") if big else ("<H", "<HHI", "<I")
    inline = struct.calcsize(offset_format)
    table_size = struct.calcsize(count_format) + len(tags) * (struct.calcsize(entry_format) + inline) + inline
    entries, values = [], b""
    for tag in tags:
        entries.append(struct.pack(entry_format, tag.code, tag.dtype, tag.count))
        if len(tag.data) <= inline:
            entries.append(tag.data.ljust(inline, b"\0"))
        else:
            entries.append(struct.pack(offset_format, at + table_size + len(values)))
            values += tag.data + b"\0" * (-len(tag.data) % 8)
    values += b"\0" * (-(table_size + len(values)) % 8)
    following = 0 if last else at + table_size + len(values)
    table = struct.pack(count_format, len(tags)) + b"".join(entries) + struct.pack(offset_format, following)
    return table + values
