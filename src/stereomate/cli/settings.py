"""The global options: what `-v`, `-q`, `--threads`, `--memory` and `--debug` say, as one value.

They may stand anywhere on the command line. This module imports nothing heavy: it is read before numpy.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from typing import Final

from stereomate.errors import InputError

THREADS_VARIABLE: Final = "STEREOMATE_THREADS"
MEMORY_VARIABLE: Final = "STEREOMATE_MEMORY"

_SIZE: Final = re.compile(r"(?i)^\s*(\d+(?:\.\d+)?)\s*([kmgt]?)(i?b?)\s*$")
_POWERS: Final = {"": 0, "k": 1, "m": 2, "g": 3, "t": 4}
_LEAST_MEMORY: Final = 64 * 1024**2


@dataclass(frozen=True)
class Settings:
    """Global options of one run.

    Attributes
    ----------
    threads : int
        Threads of the tile executor; BLAS and OpenCV stay at one inside tasks.
    memory_bytes : int or None
        Memory the working buffers may take; None leaves the choice to the executor.
    verbosity : int
        -1 quiet, 0 normal, 1 verbose, 2 everything.
    debug : bool
        Show tracebacks.
    """

    threads: int
    memory_bytes: int | None = None
    verbosity: int = 0
    debug: bool = False

    @classmethod
    def from_options(cls, threads: int | None, memory: str | None, verbosity: int, debug: bool) -> Settings:
        """Settings from the options, else from the environment, else from the machine."""
        count = threads if threads is not None else _threads_of_environment()
        if count < 1:
            raise InputError("must be 1 or more", field="--threads", value=count)
        size = memory if memory is not None else os.environ.get(MEMORY_VARIABLE)
        return cls(count, None if size is None else bytes_from_text(size), verbosity, debug)

    def apply_to_environment(self) -> None:
        """Hand threads and memory to everything that is loaded later; numpy must not be loaded yet."""
        os.environ[THREADS_VARIABLE] = str(self.threads)
        if self.memory_bytes is not None:
            os.environ[MEMORY_VARIABLE] = str(self.memory_bytes)
        # Tasks run side by side; libraries that start threads of their own inside them only get in the way.
        for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
            os.environ.setdefault(name, "1")
        os.environ["PROJ_NETWORK"] = "OFF"


def bytes_from_text(text: str) -> int:
    """Bytes from ``"500MB"``, ``"2G"``, ``"1.5GiB"`` or a plain number; k, M, G, T are powers of 1024.

    Raises
    ------
    InputError
        If the text is no size, or less than 64 MiB.
    """
    found = _SIZE.match(text)
    if not found:
        raise InputError("must be a size such as 500MB or 2G", field="--memory", value=text)
    size = int(float(found[1]) * 1024 ** _POWERS[found[2].lower()])
    if size < _LEAST_MEMORY:
        raise InputError("must be 64MB or more", field="--memory", value=text)
    return size


def _threads_of_environment() -> int:
    text = os.environ.get(THREADS_VARIABLE)
    if text is None:
        # Honour the CPUs this process may use, not those the machine has.
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    try:
        return int(text)
    except ValueError:
        raise InputError("must be a whole number", field=THREADS_VARIABLE, value=text) from None
