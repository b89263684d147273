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


# Photographs up to this size are hashed whole, larger ones by so many samples of so many bytes.
_WHOLE_BYTES = 8 << 20
_SAMPLES = 64
_SAMPLE_BYTES = 1 << 16


def photo_fingerprint(path: Path) -> str:
    """SHA-256 of a photograph up to 8 MiB; of a larger one, of its size and 64 samples of it.

    A block of thousands of photographs is told from another in seconds, at 4 MiB read of each.
    """
    size = path.stat().st_size
    digest = hashlib.sha256(str(size).encode())
    with path.open("rb") as file:
        if size <= _WHOLE_BYTES:
            digest.update(file.read())
        else:
            for k in range(_SAMPLES):
                file.seek(k * (size - _SAMPLE_BYTES) // (_SAMPLES - 1))
                digest.update(file.read(_SAMPLE_BYTES))
    return digest.hexdigest()
