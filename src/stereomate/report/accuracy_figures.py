"""Figure of check points: where they lie, and their differences as vectors."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

Array = NDArray[np.float64]

INK = "#1d2326"
ACCENT = "#1f5fa8"
WARM = "#c1511b"
# The longest vector takes this share of the map's width.
_LONGEST = 0.12
_NAMED = 40


def check_point_figure(xy: Array, differences_m: Array, names: tuple[str, ...], outline: Array) -> Figure:
    """Differences of check points on a map: plan as arrows, height as upright bars beside them.

    Parameters
    ----------
    xy : ndarray (n, 2)
        Map positions.
    differences_m : ndarray (n, 3)
        East, north, up; NaN where not known.
    names : tuple of str
    outline : ndarray (k, 2)
        Positions that the map shall hold as well, as the projection centres.
    """
    figure = Figure(figsize=(7.2, 6.0), dpi=110)
    axes = figure.add_subplot()
    held = np.vstack([xy, outline])
    low, high = held.min(axis=0), held.max(axis=0)
    width = float(max((high - low).max(), 1.0))
    axes.plot(outline[:, 0], outline[:, 1], "+", color=INK, markersize=5, alpha=0.5)
    axes.plot(xy[:, 0], xy[:, 1], "o", color=INK, markersize=2.5)
    plan = np.hypot(differences_m[:, 0], differences_m[:, 1])
    for values, color, horizontal in ((plan, ACCENT, True), (np.abs(differences_m[:, 2]), WARM, False)):
        known = np.isfinite(values)
        if not known.any() or not values[known].max() > 0.0:
            continue
        scale = _LONGEST * width / float(values[known].max())
        ends = xy[known] + scale * (
            differences_m[known, :2] if horizontal else differences_m[known, 2:] * np.array([0.0, 1.0])
        )
        for start, end in zip(xy[known], ends, strict=True):
            arrow = {"arrowstyle": "-|>" if horizontal else "-", "color": color, "linewidth": 1.1}
            axes.annotate("", end, start, arrowprops=arrow | {"shrinkA": 0, "shrinkB": 0})
        label = "plan" if horizontal else "height (up is too high)"
        axes.plot([], [], color=color, label=f"{label}, longest {values[known].max():.3g} m")
    if len(names) <= _NAMED:
        for name, position in zip(names, xy, strict=True):
            axes.annotate(name, position, fontsize=6, xytext=(3, -7), textcoords="offset points")
    margin = (_LONGEST + 0.03) * width
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - margin, high[1] + margin)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=7)
    axes.ticklabel_format(style="plain", useOffset=False)
    axes.set_xlabel("easting", fontsize=8)
    axes.set_ylabel("northing", fontsize=8)
    axes.legend(fontsize=7, loc="upper right")
    return figure
