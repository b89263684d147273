"""Logging of the command line: to stderr by verbosity, and whole to one file per run."""

from __future__ import annotations

import logging
import platform
import sys
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from stereomate import __version__
from stereomate.errors import StorageError

LOGGER: Final = logging.getLogger("stereomate")
_LEVELS: Final = {-1: logging.ERROR, 0: logging.WARNING, 1: logging.INFO}
_LONG: Final = "%(asctime)s %(levelname)-7s %(name)s: %(message)s"
# What is logged before the file is open (the project is read first, it says where) waits here.
_EARLY_RECORDS: Final = 10_000


class _Waiting(logging.Handler):
    """Keeps records until a log file is there to take them."""

    def __init__(self) -> None:
        super().__init__(logging.DEBUG)
        self.records: deque[logging.LogRecord] = deque(maxlen=_EARLY_RECORDS)

    def emit(self, record: logging.LogRecord) -> None:
        self.records.append(record)


def log_to_stderr(verbosity: int) -> None:
    """Send the package's log to stderr: warnings, with -v progress, with -vv everything, with -q errors."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setLevel(_LEVELS.get(verbosity, logging.DEBUG))
    handler.setFormatter(logging.Formatter("%(levelname)s: %(message)s" if verbosity < 2 else _LONG))
    for old in list(LOGGER.handlers):
        LOGGER.removeHandler(old)
    LOGGER.addHandler(handler)
    LOGGER.addHandler(_Waiting())
    LOGGER.setLevel(logging.DEBUG)
    LOGGER.propagate = False


@contextmanager
def log_to_file(path: Path) -> Iterator[None]:
    """Write everything the package logs to `path`, appended, times in UTC: also what it logged before.

    An exception that ends the block is written with its traceback, to the file only.

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
    LOGGER.setLevel(logging.DEBUG)
    _write(
        handler, "stereomate %s, Python %s, %s", __version__, platform.python_version(), platform.platform()
    )
    _write(handler, "command line: %s", " ".join(sys.argv))
    for waiting in [h for h in LOGGER.handlers if isinstance(h, _Waiting)]:
        while waiting.records:
            handler.handle(waiting.records.popleft())
    LOGGER.addHandler(handler)
    try:
        yield
    except BaseException as error:
        _write(handler, "ended by %s: %s", type(error).__name__, error, failed=True)
        raise
    finally:
        LOGGER.removeHandler(handler)
        handler.close()


def _write(handler: logging.Handler, text: str, *values: object, failed: bool = False) -> None:
    level = logging.ERROR if failed else logging.INFO
    trace = sys.exc_info() if failed else None
    handler.handle(LOGGER.makeRecord(LOGGER.name, level, __file__, 0, text, values, trace))


def _utc(seconds: float | None) -> time.struct_time:
    return time.gmtime(seconds)
