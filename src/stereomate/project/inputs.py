"""Files a project reads, told apart by digests, and photographs that cannot take part."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from stereomate.errors import InputError


@dataclass(frozen=True)
class PhotoProblem:
    """A photograph that cannot take part, and why."""

    name: str
    error: InputError


@dataclass(frozen=True)
class InputFile:
    """A file the project reads. `digest` is the SHA-256 of it, of photographs that of their fingerprint."""

    role: str
    path: Path
    digest: str


def file_digest(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


_SAMPLE = 1 << 16


def photo_fingerprint(path: Path) -> str:
    """SHA-256 of the size and the first, middle and last 64 KiB: tells photographs apart at once."""
    size = path.stat().st_size
    digest = hashlib.sha256(str(size).encode())
    with path.open("rb") as file:
        for start in sorted({0, max(size // 2 - _SAMPLE // 2, 0), max(size - _SAMPLE, 0)}):
            file.seek(start)
            digest.update(file.read(_SAMPLE))
    return digest.hexdigest()
