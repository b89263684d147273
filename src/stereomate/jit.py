"""The one place that configures numba.

Kernels live in files named ``kernels.py`` or in folders named ``kernels``: arrays in, arrays out. They run
without the GIL, never start threads of their own and use no fast-math, so that results do not depend on
the number of threads. With STEREOMATE_BOUNDSCHECK=1 they are compiled with bounds checks.

numba's disk cache does not see an edited callee in another file, and reuses code compiled without bounds
checks; so the cache folder is named after a hash of all kernel sources and flags.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])

BOUNDSCHECK = os.environ.get("STEREOMATE_BOUNDSCHECK", "0") == "1"


def kernel(function: F) -> F:
    """Compile a kernel: nogil, cached, numpy division rules, no fast-math."""
    compiled = numba.njit(nogil=True, cache=True, error_model="numpy", boundscheck=BOUNDSCHECK)(function)
    return cast(F, compiled)


def inline_kernel(function: F) -> F:
    """Compile a small device function that numba may inline into its callers (LLVM decides)."""
    return kernel(function)


def _source_hash() -> str:
    package = Path(__file__).parent
    digest = hashlib.sha256(f"{numba.__version__} {BOUNDSCHECK}".encode())
    sources = sorted({*package.rglob("kernels.py"), *package.rglob("kernels/*.py")})
    for source in [Path(__file__), *sources]:
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


def _writable_cache_folder() -> Path:
    base = os.environ.get("STEREOMATE_CACHE") or os.environ.get("XDG_CACHE_HOME")
    root = Path(base) if base else Path.home() / ".cache"
    folder = root / "stereomate" / "numba" / _source_hash()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError:
        return Path(tempfile.mkdtemp(prefix="stereomate-numba-"))


if "NUMBA_CACHE_DIR" not in os.environ:
    numba.config.CACHE_DIR = str(_writable_cache_folder())
