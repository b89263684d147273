"""Memory, threads and network of the raster layer: one setting, from ``--memory`` and ``--threads``.

GDAL has a block cache, a thread pool and drivers that fetch from the network. All are governed here: tasks
run side by side, so GDAL itself runs one thread; its cache is a small part of the memory allowed; its
network drivers are not registered and PROJ fetches no grids.
"""

from __future__ import annotations

import ctypes
import os
import sys
import threading
from dataclasses import dataclass
from typing import Final

from rasterio.env import set_gdal_config

from stereomate.errors import InputError

THREADS_VARIABLE: Final = "STEREOMATE_THREADS"
MEMORY_VARIABLE: Final = "STEREOMATE_MEMORY"
DEFAULT_MEMORY_BYTES: Final = 400 * 1024**2

_MEBIBYTE: Final = 1024**2
_NETWORK_DRIVERS: Final = "HTTP WMS WCS WMTS EEDA EEDAI PLMOSAIC OGCAPI STACIT STACTA DAAS"

_lock = threading.Lock()
_current: Resources | None = None


@dataclass(frozen=True)
class Resources:
    """What rasters may take of the machine.

    Attributes
    ----------
    memory_bytes : int
        Memory of everything that grows with the work: block cache, decoded photographs, tiles in flight.
    threads : int
        Threads of the tile executor.
    """

    memory_bytes: int = DEFAULT_MEMORY_BYTES
    threads: int = 1

    def __post_init__(self) -> None:
        if self.memory_bytes < 1:
            raise InputError("must be a positive number of bytes", field="memory", value=self.memory_bytes)
        if self.threads < 1:
            raise InputError("must be 1 or more", field="threads", value=self.threads)

    @property
    def block_cache_bytes(self) -> int:
        """GDAL's block cache: a twelfth of the memory, 16 to 64 MiB.

        Source windows of neighbouring chunks overlap by little, a larger cache only takes memory.
        """
        return min(max(self.memory_bytes // 12, 16 * _MEBIBYTE), 64 * _MEBIBYTE)

    @property
    def decoded_cache_bytes(self) -> int:
        """Decoded photographs of formats without windows that stay in memory, not in temporary files."""
        return self.memory_bytes // 2

    @classmethod
    def from_environment(cls) -> Resources:
        """Resources from STEREOMATE_THREADS and STEREOMATE_MEMORY (bytes), else the defaults of the machine.

        Raises
        ------
        InputError
            If a variable is set to something that is not a whole number.
        """
        return cls(
            _number_of(MEMORY_VARIABLE, DEFAULT_MEMORY_BYTES), _number_of(THREADS_VARIABLE, usable_cpus())
        )


def usable_cpus() -> int:
    """The CPUs this process may use, which may be fewer than the machine has."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _number_of(variable: str, default: int) -> int:
    text = os.environ.get(variable)
    if not text:
        return default
    try:
        return int(text)
    except ValueError:
        raise InputError("must be a whole number", field=variable, value=text) from None


def configure(resources: Resources) -> None:
    """Set the limits of this process; every reader and writer opened later obeys them."""
    global _current
    with _lock:
        _apply(resources)
        _current = resources


def current() -> Resources:
    """The limits in force; taken from the environment when nobody configured any."""
    global _current
    with _lock:
        if _current is None:
            _current = Resources.from_environment()
            _apply(_current)
        return _current


def _apply(resources: Resources) -> None:
    # GDAL looks up options in the environment from any thread; rasterio's Env would reach one thread only.
    os.environ.update(
        GDAL_NUM_THREADS="1",
        GDAL_CACHEMAX=str(resources.block_cache_bytes // _MEBIBYTE),
        GDAL_SKIP=_NETWORK_DRIVERS,
        CPL_VSIL_CURL_ALLOWED_EXTENSIONS=".none",
        GDAL_PAM_ENABLED="YES",
        PROJ_NETWORK="OFF",
    )
    # The variable is read once, when the first block is cached; this call takes effect at any time.
    set_gdal_config("GDAL_CACHEMAX", resources.block_cache_bytes)


def give_back_memory() -> None:
    """Return freed memory to the system, where the C library keeps it for itself (glibc).

    After the tiles of a large product these are some 80 MB, which would stand below the peak of the report.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
    if trim is not None:
        trim(0)
