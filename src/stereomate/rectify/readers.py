"""Open photographs of this process, shared by its threads."""

from __future__ import annotations

import threading

from stereomate.coverage.survey import Photograph
from stereomate.errors import ImageError
from stereomate.raster import PhotoReader, give_back_memory, open_photo

# More open files than this are closed again, oldest first.
LIMIT = 64

_OPEN: dict[str, PhotoReader] = {}
_LOCK = threading.Lock()


def reader_of(photograph: Photograph) -> PhotoReader:
    """The reader of a photograph's file, opened once per process.

    Raises
    ------
    ImageError
        If the photograph has no file, or the file cannot be read.
    """
    if photograph.path is None:
        raise ImageError("has no image file", field=photograph.name)
    key = str(photograph.path)
    with _LOCK:
        reader = _OPEN.pop(key, None) or open_photo(photograph.path)
        _OPEN[key] = reader
        while len(_OPEN) > LIMIT:
            # Another thread may still read it: it is closed when the last of them lets it go.
            _OPEN.pop(next(iter(_OPEN)))
        return reader


def close_readers() -> None:
    """Close all photographs of this process, and give their memory back."""
    with _LOCK:
        for reader in _OPEN.values():
            reader.close()
        _OPEN.clear()
    give_back_memory()
