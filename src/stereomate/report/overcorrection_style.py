"""How the figures of the over-correction factor look, and how they are written."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
from matplotlib.figure import Figure

from stereomate.errors import InputError, StorageError

MM_PER_INCH: Final = 25.4

INK: Final = "#222222"
RAY: Final = "#555555"
PERPENDICULAR: Final = "#1f5fa8"
CIRCLE: Final = "#b3261e"
LENGTH_D: Final = "#1a7044"
LENGTH_A: Final = "#d1600a"
TERRAIN: Final = "#7b5b3a"
GROUND: Final = "#f1e9de"

_SUFFIXES: Final = (".svg", ".pdf", ".png")
_STYLE: Final[dict[str, Any]] = {
    "font.family": "DejaVu Sans",
    "font.size": 8.0,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "savefig.facecolor": "white",
    "svg.fonttype": "none",
    "svg.hashsalt": "stereomate",
    "pdf.fonttype": 42,
}


@contextmanager
def figure_style() -> Iterator[None]:
    """Settings of matplotlib for these figures, undone afterwards."""
    with mpl.rc_context(_STYLE):
        yield


def save_figure(figure: Figure, path: Path, dpi: int = 200) -> None:
    """Write a figure as SVG, PDF or PNG by its suffix, whole or not at all, the same bytes every time.

    Raises
    ------
    InputError
        If the suffix is none of these.
    StorageError
        If the file cannot be written.
    """
    suffix = path.suffix.lower()
    if suffix not in _SUFFIXES:
        raise InputError("must end in .svg, .pdf or .png", field="figure", value=str(path))
    metadata = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}, ".png": {}}[suffix]
    unfinished = path.with_name(f".{path.name}.part")
    try:
        with figure_style():
            figure.savefig(unfinished, format=suffix[1:], dpi=dpi, metadata=metadata)
        os.replace(unfinished, path)
    except OSError as error:
        unfinished.unlink(missing_ok=True) if path.parent.is_dir() else None
        raise StorageError(f"{path}: cannot write the figure ({error.strerror})") from error
