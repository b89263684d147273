"""Map of the pairs of a project by how well their lateral tilt is determined."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, Protocol

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from stereomate.relative.sections import PairSections
from stereomate.report.overcorrection_style import INK, figure_style

FloatArray = NDArray[np.float64]
_COLOURS: Final = {"good": "#1a7044", "weak": "#d1600a", "near critical": "#b3261e", "no section": "#777777"}
_MARKERS: Final = {"standard": "o", "moved": "D", "free": "^"}
_CHOICES: Final = {
    "standard": "standard points",
    "moved": "points moved to usable ground",
    "free": "points chosen for strength",
}
# Figures on every base of a block would hide it: then only pairs that are not good have theirs.
_MOST_LABELS: Final = 8


class PairOnMap(Protocol):
    """What the map needs to know of a pair."""

    @property
    def names(self) -> tuple[str, str]: ...
    @property
    def verdict(self) -> str: ...
    @property
    def sections(self) -> PairSections: ...
    @property
    def points_map(self) -> tuple[FloatArray, ...]: ...
    @property
    def centres_map(self) -> FloatArray: ...


def strength_map(pairs: Sequence[PairOnMap], title: str = "") -> Figure:
    """Draw bases coloured by verdict, sections as lines through their points, n beside each base.

    Parameters
    ----------
    pairs : sequence
        In one map, metres or any unit.
    title : str
    """
    with figure_style():
        figure = Figure(figsize=(165.0 / 25.4, 150.0 / 25.4), layout="constrained")
        axes = figure.add_subplot()
        axes.set_aspect("equal", adjustable="datalim")
        crowded = len(pairs) > _MOST_LABELS
        _sections(axes, pairs, crowded)
        for pair in pairs:
            _base(axes, pair, with_label=not crowded or pair.verdict != "good")
        _names(axes, pairs)
        handles: list[Any] = []
        for verdict, colour in _COLOURS.items():
            if any(pair.verdict == verdict for pair in pairs):
                handles.append(Line2D([], [], color=colour, lw=2.4, label=verdict))
        used = {section.choice for pair in pairs for section in pair.sections.sections}
        for choice, marker in _MARKERS.items():
            if choice in used:
                style: dict[str, Any] = {"ls": "", "marker": marker, "ms": 4, "color": INK, "mfc": "white"}
                handles.append(Line2D([], [], label=_CHOICES[choice], **style))
        axes.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=3, fontsize=7)
        axes.ticklabel_format(style="plain", useOffset=False)
        axes.tick_params(labelsize=6.5)
        axes.set_title(f"{title}: relative orientation by cross-sections".lstrip(": "), fontsize=9)
    return figure


def _sections(axes: Any, pairs: Sequence[PairOnMap], crowded: bool) -> None:
    """Sections of all pairs, each look drawn at once: a line of its own for each takes most of the time."""
    lines: dict[str, list[FloatArray]] = {}
    points: dict[tuple[str, str], list[FloatArray]] = {}
    gap = np.full((1, 2), np.nan)
    for pair in pairs:
        for section, places in zip(pair.sections.sections, pair.points_map, strict=True):
            colour = _COLOURS[
                "near critical" if section.near_critical else "weak" if section.weak else "good"
            ]
            ordered = places[np.argsort(section.strength.section[:, 0]), :2]
            lines.setdefault(colour, []).extend([ordered, gap])
            points.setdefault((colour, _MARKERS[section.choice]), []).append(places[:, :2])
    for colour, parts in lines.items():
        x, y = np.concatenate(parts).T
        axes.plot(x, y, color=colour, lw=0.3 if crowded else 0.6, alpha=0.7, zorder=2)
    size = {"ms": 1.8, "mew": 0.4} if crowded else {"ms": 3.2, "mew": 0.8}
    for (colour, marker), parts in points.items():
        x, y = np.concatenate(parts).T
        axes.plot(x, y, marker, color=colour, mfc="white", zorder=3, **size)


def _base(axes: Any, pair: PairOnMap, with_label: bool) -> None:
    colour = _COLOURS[pair.verdict]
    x, y = pair.centres_map[:, 0], pair.centres_map[:, 1]
    axes.plot(x, y, color=colour, lw=2.4, solid_capstyle="round", zorder=4)
    axes.plot(x, y, "s", ms=4.5, color=INK, zorder=5)
    factors = [section.strength.factor for section in pair.sections.sections]
    if not with_label:
        return
    text = f"n {min(factors):.1f} to {max(factors):.1f}" if factors else "no section"
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.8}
    axes.annotate(
        f"{text}\nstrength {pair.sections.strength:.2f}" if factors else text,
        (float(x.mean()), float(y.mean())),
        xytext=(0, 5),
        textcoords="offset points",
        ha="center",
        va="bottom",
        fontsize=6.5,
        color=colour,
        bbox=box,
        zorder=6,
    )


def _names(axes: Any, pairs: Sequence[PairOnMap]) -> None:
    """Names of the photographs, each once."""
    places = {
        name: centre for pair in pairs for name, centre in zip(pair.names, pair.centres_map, strict=True)
    }
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 0.4}
    for name, centre in places.items():
        style = {"textcoords": "offset points", "ha": "center", "va": "top", "fontsize": 6, "bbox": box}
        axes.annotate(name, (centre[0], centre[1]), xytext=(0, -5), zorder=6, **style)
