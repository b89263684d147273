"""Logging of the command line: to stderr by verbosity, and whole to one file per run."""

from __future__ import annotations

import logging
import platform
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from stereomate import __version__
from stereomate.errors import StorageError

LOGGER: Final = logging.getLogger("stereomate")
_LEVELS: Final = {-1: logging.ERROR, 0: logging.WARNING, 1: logging.INFO}


def log_to_stderr(verbosity: int) -> None:
    """Send the package's log to stderr: warnings, with -v progress, with -vv everything, with -q errors."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setLevel(_LEVELS.get(verbosity, logging.DEBUG))
    handler.setFormatter(logging.Formatter("%(levelname)s: %(message)s" if verbosity < 2 else _LONG))
    handler.set_name("stderr")
    for old in [h for h in LOGGER.handlers if h.get_name() == "stderr"]:
        LOGGER.removeHandler(old)
    LOGGER.addHandler(handler)
    LOGGER.setLevel(logging.DEBUG)
    LOGGER.propagate = False


@contextmanager
def log_to_file(path: Path) -> Iterator[None]:
    """Write everything the package logs inside the block to `path`, appended, times in UTC.

    Raises
    ------
    StorageError
        If the file cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handler = logging.FileHandler(path, encoding="utf-8")
    except OSError as error:
        raise StorageError(f"{path}: cannot write the log file ({error.strerror})") from error
    formatter = logging.Formatter(_LONG)
    formatter.converter = _utc
    handler.setFormatter(formatter)
    LOGGER.addHandler(handler)
    LOGGER.setLevel(logging.DEBUG)
    LOGGER.info("stereomate %s, Python %s, %s", __version__, platform.python_version(), platform.platform())
    LOGGER.info("command line: %s", " ".join(sys.argv))
    try:
        yield
    except BaseException as error:
        LOGGER.error("ended by %s: %s", type(error).__name__, error, exc_info=True)
        raise
    finally:
        LOGGER.removeHandler(handler)
        handler.close()


_LONG: Final = "%(asctime)s %(levelname)-7s %(name)s: %(message)s"


def _utc(seconds: float | None) -> time.struct_time:
    return time.gmtime(seconds)
