"""The tile ledger: what finished tasks made, kept in a folder with checksums; resume stands on it.

    ledger/
        manifest.json          format of the ledger, key of the run
        chunks/000000.chunk    one file per finished chunk, all its blobs inside

A chunk file is written under a temporary name and renamed, so it is there whole or not at all; its
checksums find what a power cut or a failing disk did to it. Such a chunk is as good as not made.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

from stereomate.errors import FormatError, StorageError
from stereomate.forms import LEDGER
from stereomate.raster.files import Buffer, storing, sweep, write_whole

_MAGIC: Final = b"SMCHUNK1"
# magic, length of the index, CRC-32 of the index
_HEAD: Final = struct.Struct("<8sII")


@dataclass(frozen=True)
class _Blob:
    offset: int
    size: int
    crc: int


def run_key(**definition: Any) -> str:
    """Hash of everything that defines a run: equal definitions, and only those, may share a ledger.

    Parameters
    ----------
    **definition
        Values that JSON can write (numbers, text, lists, dicts); floats count to their last bit.
    """
    text = json.dumps(definition, sort_keys=True, separators=(",", ":"), allow_nan=True)
    return hashlib.sha256(text.encode()).hexdigest()


class Ledger:
    """Blobs of finished chunks in a folder; made by `Ledger.open`. Safe to use from any number of threads."""

    def __init__(self, folder: Path, key: str) -> None:
        self.folder = folder
        self.key = key
        self._known: dict[int, dict[str, _Blob]] = {}

    @classmethod
    def open(cls, folder: str | os.PathLike[str], key: str) -> Self:
        """Go on with a ledger of the same key, or begin a new one.

        Parameters
        ----------
        folder : path
            Made if it is not there. A ledger of another run in it is emptied.
        key : str
            From `run_key`.

        Raises
        ------
        FormatError
            If the ledger was written by a newer version, or its manifest makes no sense.
        StorageError
            If the folder cannot be made or written, or holds files that are no ledger.
        """
        ledger = cls(Path(folder), key)
        with storing(ledger.folder):
            ledger.folder.mkdir(parents=True, exist_ok=True)
            manifest = ledger._manifest()
            if manifest is None and any(ledger._chunks_folder.glob("*.chunk")):
                raise StorageError(f"{ledger.folder}: holds chunk files without a manifest; is it a ledger?")
            if manifest is None or manifest.get("key") != key:
                ledger._empty()
                ledger._chunks_folder.mkdir(exist_ok=True)
                text = json.dumps({"format": LEDGER.version, "key": key}, indent=1) + "\n"
                write_whole(ledger._manifest_path, [text.encode()])
            ledger._chunks_folder.mkdir(exist_ok=True)
            sweep(ledger._chunks_folder)
        return ledger

    def has(self, index: int) -> bool:
        """Whether a chunk is there, complete and undamaged; checksums are verified the first time."""
        if index in self._known:
            return True
        blobs = _verified_index(self._path(index))
        if blobs is not None:
            self._known[index] = blobs
        return blobs is not None

    def put(self, index: int, blobs: Mapping[str, Buffer]) -> None:
        """Keep the blobs of a finished chunk.

        Raises
        ------
        StorageError
            If they cannot be written (disk full); no part of them stays behind.
        """
        entries, offset = [], 0
        for name, data in blobs.items():
            size = memoryview(data).nbytes
            entries.append((name, offset, size, zlib.crc32(data)))
            offset += size
        index_text = json.dumps(entries).encode()
        head = _HEAD.pack(_MAGIC, len(index_text), zlib.crc32(index_text))
        with storing(self.folder):
            write_whole(self._path(index), [head, index_text, *blobs.values()])
        start = len(head) + len(index_text)
        self._known[index] = {name: _Blob(start + at, size, crc) for name, at, size, crc in entries}

    def names(self, index: int) -> tuple[str, ...]:
        """Names of the blobs of a chunk that is there."""
        return tuple(self._blobs(index))

    def size(self, index: int, name: str) -> int:
        """Bytes of a blob."""
        return self._blobs(index)[name].size

    def get(self, index: int, name: str) -> bytes:
        """A whole blob."""
        return self.read(index, name, 0, self.size(index, name))

    def read(self, index: int, name: str, offset: int, size: int) -> bytes:
        """Part of a blob.

        Raises
        ------
        KeyError
            If the chunk is not there or has no such blob.
        StorageError
            If the file cannot be read, or became shorter since it was verified.
        """
        blob = self._blobs(index)[name]
        if offset < 0 or offset + size > blob.size:
            raise ValueError(f"{offset}+{size} is outside blob {name!r} of {blob.size} bytes")
        path = self._path(index)
        with storing(path), path.open("rb", buffering=0) as file:
            data = os.pread(file.fileno(), size, blob.offset + offset)
        if len(data) != size:
            raise StorageError(f"{path}: became shorter while it was in use")
        return data

    def remove(self) -> None:
        """Delete the ledger's files, and its folder if nothing else is in it."""
        with storing(self.folder):
            self._empty()
            self._manifest_path.unlink(missing_ok=True)
            with contextlib.suppress(OSError):
                self._chunks_folder.rmdir()
                self.folder.rmdir()

    @property
    def _manifest_path(self) -> Path:
        return self.folder / "manifest.json"

    @property
    def _chunks_folder(self) -> Path:
        return self.folder / "chunks"

    def _path(self, index: int) -> Path:
        return self._chunks_folder / f"{index:06d}.chunk"

    def _blobs(self, index: int) -> dict[str, _Blob]:
        if not self.has(index):
            raise KeyError(f"{self.folder}: chunk {index} is not in the ledger")
        return self._known[index]

    def _manifest(self) -> dict[str, Any] | None:
        path = self._manifest_path
        try:
            manifest: Any = json.loads(path.read_bytes())
        except FileNotFoundError:
            return None
        except ValueError as error:
            raise FormatError("must be the manifest of a ledger", file=path, value=str(error)) from error
        if not isinstance(manifest, dict):
            raise FormatError("must be the manifest of a ledger", file=path, value=manifest)
        return LEDGER.migrated(manifest, path)

    def _empty(self) -> None:
        # The manifest of the other run goes first: half an emptied ledger must not be taken for a whole one.
        self._manifest_path.unlink(missing_ok=True)
        for path in self._chunks_folder.glob("*.chunk"):
            path.unlink()
        sweep(self._chunks_folder)
        self._known.clear()


def _verified_index(path: Path) -> dict[str, _Blob] | None:
    """Blobs of a chunk file, or None if the file is missing or damaged anywhere."""
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD.size)
            if len(head) != _HEAD.size:
                return None
            magic, length, crc = _HEAD.unpack(head)
            text = file.read(length)
            if magic != _MAGIC or len(text) != length or zlib.crc32(text) != crc:
                return None
            start = _HEAD.size + length
            blobs = {name: _Blob(start + at, size, total) for name, at, size, total in json.loads(text)}
            if any(zlib.crc32(file.read(blob.size)) != blob.crc for blob in blobs.values()):
                return None
            return None if file.read(1) else blobs
    except OSError:
        return None
