"""A viewer as static files, for any web server: there whole or not at all."""

from __future__ import annotations

import json
import os
import secrets
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from stereomate.errors import InputError
from stereomate.raster.files import storing, write_whole
from stereomate.tiles import executor_of, map_items
from stereomate.viewer.site import Site

_MARK = "data/products.json"
_SHARE = 64


@dataclass(frozen=True)
class Published:
    """What was written."""

    folder: Path
    files: int
    size_bytes: int


def publish(
    site: Site, out: Path, threads: int = 1, progress: Callable[[int, int], None] | None = None
) -> Published:
    """Write a site into a folder that is new, empty, or holds an earlier one, which is replaced at the end.

    Raises
    ------
    InputError
        If the folder holds anything else.
    StorageError
        If it cannot be written; nothing is left then.
    """
    _require_ours(out)
    names = list(site.names())
    with storing(out):
        out.parent.mkdir(parents=True, exist_ok=True)
        unfinished = out.parent / f".{out.name}.{os.getpid()}-{secrets.token_hex(4)}.part"
        unfinished.mkdir()
        try:
            size = _write_all(site, names, unfinished, threads, progress)
            _exchange(unfinished, out)
        finally:
            shutil.rmtree(unfinished, ignore_errors=True)
    return Published(out, len(names), size)


def _write_all(
    site: Site, names: list[str], folder: Path, threads: int, progress: Callable[[int, int], None] | None
) -> int:
    for parent in {(folder / name).parent for name in names}:
        parent.mkdir(parents=True, exist_ok=True)

    def write(name: str) -> int:
        content = site.read(name)
        write_whole(folder / name, [content])
        return len(content)

    total = 0
    executor = executor_of(threads, None)
    for first in range(0, len(names), _SHARE):
        share = names[first : first + _SHARE]
        total += sum(map_items(write, share, executor))
        if progress is not None:
            progress(first + len(share), len(names))
    return total


def _require_ours(out: Path) -> None:
    if not out.exists():
        return
    if not out.is_dir() or out.is_symlink():
        raise InputError("must be a folder", field="--out", value=str(out))
    if any(out.iterdir()) and not is_site(out):
        raise InputError(
            "must be new, empty, or a site published before", field="--out", value=str(out),
            hint="name another folder",
        )  # fmt: skip


def is_site(folder: Path) -> bool:
    """Whether a folder is a site published before."""
    try:
        document = json.loads((folder / _MARK).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(document, dict) and "products" in document and (folder / "index.html").is_file()


def _exchange(new: Path, out: Path) -> None:
    if not out.exists():
        os.replace(new, out)
        return
    old = out.parent / f".{out.name}.{secrets.token_hex(4)}.old"
    os.replace(out, old)
    os.replace(new, out)
    shutil.rmtree(old)
