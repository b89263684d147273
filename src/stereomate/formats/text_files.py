"""Small text files, read with errors that name them and written whole or not at all."""

from __future__ import annotations

from pathlib import Path

from stereomate.errors import FormatError
from stereomate.raster.files import write_whole


def read_text(path: Path) -> str:
    """The text of a UTF-8 file.

    Raises
    ------
    FormatError
        If it is not there, cannot be read or is not UTF-8.
    """
    return decoded(read_bytes(path), path)


def read_bytes(path: Path) -> bytes:
    """The bytes of a file; errors as `read_text`."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise FormatError("does not exist", file=path) from None
    except OSError as error:
        raise FormatError(f"cannot be read: {error.strerror}", file=path) from error


def decoded(data: bytes, path: Path) -> str:
    """UTF-8 text of bytes of a file."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FormatError(f"must be UTF-8 text: {error.reason} at byte {error.start}", file=path) from error


def write_text(path: Path, text: str) -> None:
    """Write a file whole or not at all.

    Raises
    ------
    StorageError
        If the place cannot be written.
    """
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: Path, data: bytes) -> None:
    """As `write_text`, for bytes."""
    write_whole(path, [data])
