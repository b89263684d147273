"""How to run a project, besides what it says itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

# stage, done, total
ProgressSink = Callable[[str, int, int], None]


@dataclass(frozen=True)
class RunOptions:
    """How to run, besides what the project says.

    Attributes
    ----------
    threads : int
    scheduler : str or None
        Address of a Dask scheduler; threads of this process without.
    pairs : tuple of (str, str) or None
        Models to use instead of those of the project.
    stereo : bool
        False: an orthophoto alone.
    agreement : bool
        Measure the agreement of left and right by matching.
    chunk_tiles : int
        Tiles per side of a chunk.
    fresh : bool
        Forget what an earlier run left, and make everything anew.
    seams : Path or None
        Seams edited by the user; those of the project without.
    strict : bool
        A photograph that turns out unreadable stops the run instead of being left out.
    """

    threads: int = 1
    scheduler: str | None = None
    pairs: tuple[tuple[str, str], ...] | None = None
    stereo: bool = True
    agreement: bool = True
    chunk_tiles: int = 2
    fresh: bool = False
    seams: Path | None = None
    strict: bool = False
