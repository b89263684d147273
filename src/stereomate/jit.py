"""The one place that configures numba.

Kernels live in files named ``kernels.py`` or in folders named ``kernels``: arrays in, arrays out. They run
without the GIL, never start threads of their own and use no fast-math, so that results do not depend on
the number of threads. With STEREOMATE_BOUNDSCHECK=1 they are compiled with bounds checks.

numba's disk cache does not see an edited callee in another file, and reuses code compiled without bounds
checks; so the cache folder of a kernel is named after a hash of its file, of every file that one imports
from this package, directly or not, and of the flags. An edited kernel recompiles what stands on it, and
nothing else.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import inspect
import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])

BOUNDSCHECK = os.environ.get("STEREOMATE_BOUNDSCHECK", "0") == "1"
_PACKAGE = Path(__file__).parent


def kernel(function: F) -> F:
    """Compile a kernel: nogil, cached, numpy division rules, no fast-math."""
    compile_it = numba.njit(nogil=True, cache=True, error_model="numpy", boundscheck=BOUNDSCHECK)
    if "NUMBA_CACHE_DIR" in os.environ:
        return cast(F, compile_it(function))
    # The folder is numba's to read while it sets up this one function, and nobody else's.
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(_cache_root() / cache_key(Path(inspect.getfile(function))))
    try:
        return cast(F, compile_it(function))
    finally:
        numba.config.CACHE_DIR = before


def inline_kernel(function: F) -> F:
    """Compile a small device function that numba may inline into its callers (LLVM decides)."""
    return kernel(function)


@functools.cache
def cache_key(source: Path) -> str:
    """Hash of a source file, of all it imports from this package, and of the flags."""
    digest = hashlib.sha256(f"{numba.__version__} {BOUNDSCHECK}".encode())
    for file in sorted(_closure(source) | {Path(__file__)}):
        digest.update(file.name.encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:16]


def _closure(source: Path) -> set[Path]:
    found, waiting = {source}, [source]
    while waiting:
        new = set(_imported(waiting.pop())) - found
        found |= new
        waiting.extend(new)
    return found


@functools.cache
def _imported(source: Path) -> tuple[Path, ...]:
    """Files of this package that a source file imports by name."""
    return tuple(
        file
        for node in ast.walk(ast.parse(source.read_bytes()))
        for module in _modules(node)
        if (file := _file(module)) is not None
    )


def _modules(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom) and node.module:
        yield node.module
        yield from (f"{node.module}.{alias.name}" for alias in node.names)


def _file(module: str) -> Path | None:
    package, *rest = module.split(".")
    if package != _PACKAGE.name or not rest:
        return None
    path = _PACKAGE.joinpath(*rest)
    return next((file for file in (path.with_suffix(".py"), path / "__init__.py") if file.is_file()), None)


@functools.cache
def _cache_root() -> Path:
    base = os.environ.get("STEREOMATE_CACHE") or os.environ.get("XDG_CACHE_HOME")
    folder = (Path(base) if base else Path.home() / ".cache") / "stereomate" / "numba"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError:
        return Path(tempfile.mkdtemp(prefix="stereomate-numba-"))
