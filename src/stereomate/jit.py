"""The one place that configures numba.

Kernels live in files named ``kernels.py`` or in folders named ``kernels``: arrays in, arrays out. They run
without the GIL, never start threads of their own and use no fast-math, so that results do not depend on
the number of threads. The block's may fuse a product and a sum, as its LAPACK does: their last digits depend
on the processor. With STEREOMATE_BOUNDSCHECK=1 they are compiled with bounds checks.

numba's disk cache does not see an edited callee in another file, and reuses code compiled without bounds
checks; so the cache folder of a kernel is named after a hash of its file, of every file that one imports
from this package, directly or not, and of the flags. An edited kernel recompiles what stands on it, and
nothing else.
"""

from __future__ import annotations

import functools
import hashlib
import inspect
import os
import re
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])

BOUNDSCHECK = os.environ.get("STEREOMATE_BOUNDSCHECK", "0") == "1"
_PACKAGE = Path(__file__).parent
# `import package.module`, or `from package.module import names`, in one line or in parentheses.
_IMPORT = re.compile(
    rf"^[ \t]*(?:from|import)[ \t]+(?P<module>{_PACKAGE.name}[\w.]*)"
    r"(?:[ \t]+import[ \t]+(?P<names>\([^)]*\)|[^\n]*))?",
    re.MULTILINE,
)


def kernel(function: F) -> F:
    """Compile a kernel: nogil, cached, numpy division rules, no fast-math."""
    return _compiled(function, forced=False)


def fused_kernel(function: F) -> F:
    """As `kernel`; a product and a sum may be rounded once."""
    return _compiled(function, forced=False, fused=True)


def fused_inline_kernel(function: F) -> F:
    """As `inline_kernel`; a product and a sum may be rounded once."""
    return _compiled(function, forced=True, fused=True)


def _compiled(function: F, forced: bool, fused: bool = False) -> F:
    compile_it = numba.njit(
        nogil=True,
        cache=True,
        error_model="numpy",
        boundscheck=BOUNDSCHECK,
        forceinline=forced,
        fastmath={"contract"} if fused else False,
    )
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
    """Compile a small function that is always inlined: a call that passes arrays costs more than it does."""
    return _compiled(function, forced=True)


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
    # Reading statements is ten times as fast as parsing the file, and this is done at every start.
    found = []
    for statement in _IMPORT.finditer(source.read_text(encoding="utf-8")):
        module = statement["module"]
        names = re.sub(r"#.*", "", statement["names"] or "").strip("()")
        members = [name.split()[0] for name in names.split(",") if name.strip()]
        found += [_file(name) for name in (module, *(f"{module}.{member}" for member in members))]
    return tuple(file for file in found if file is not None)


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
