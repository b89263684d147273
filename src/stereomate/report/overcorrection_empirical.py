"""What the instrument's runs look like: residual y-parallaxes over the model and their course by cycles."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from stereomate.relative.empirical.projectors import model_points
from stereomate.relative.empirical.record import EmpiricalRun
from stereomate.report.overcorrection_style import CIRCLE, INK, PERPENDICULAR, RAY, figure_style

FloatArray = NDArray[np.float64]
_RULE_COLOURS: Final = ("#1f5fa8", "#d1600a", "#1a7044", "#7a3b9a", "#b3261e", "#555555")
_MOST_NAMES: Final = 12
_MARKERS: Final = ("o", "s", "^", "D", "v", "P")


def residual_parallaxes(run: EmpiricalRun, title: str = "") -> Figure:
    """The model in plan at the start and after each cycle, its y-parallaxes as arrows across the strip.

    Each panel has its own arrow scale, written in it, for the parallaxes shrink by orders of magnitude.

    Parameters
    ----------
    run : EmpiricalRun
    title : str
    """
    count = len(run.parallaxes)
    columns = min(count, 5)
    rows = -(-count // columns)
    places = model_points(run.model, run.settings[0])[:, :2]
    extent = _extent(places)
    aspect = (extent[3] - extent[2]) / (extent[1] - extent[0])
    panel = 36.0
    height = min(max(panel * aspect, 30.0), 95.0)
    with figure_style():
        size = ((panel + 3.0) * columns / 25.4, ((height + 14.0) * rows + 14.0) / 25.4)
        figure = Figure(figsize=size, layout="constrained")
        panels = figure.subplots(rows, columns, squeeze=False)
        for number, axes in enumerate(panels.flat):
            if number >= count:
                axes.set_visible(False)
                continue
            _panel(axes, run, places, extent, number)
        figure.suptitle(title or f"residual y-parallaxes: {run.outcome}", fontsize=9)
    return figure


def parallax_course(
    runs: Mapping[str, EmpiricalRun], title: str = "", decimals_shown: float = 1e-8
) -> Figure:
    """Largest y-parallax at the procedure's points against cycles, one line per rule, logarithmic.

    Parameters
    ----------
    runs : mapping of str to EmpiricalRun
        Runs by the name of their rule.
    title : str
    decimals_shown : float
        Parallaxes below this part of the flying height are drawn at it: they are rounding.
    """
    with figure_style():
        figure = Figure(figsize=(120.0 / 25.4, 80.0 / 25.4), layout="constrained")
        axes = figure.add_subplot()
        depth = 1.0
        most = 1
        for place, (name, run) in enumerate(runs.items()):
            depth = float(-np.nanmean(model_points(run.model, run.settings[0])[:, 2]))
            values = np.maximum(np.array(run.largest), decimals_shown * depth)
            most = max(most, len(values) - 1)
            # Several rules share their first points: different sizes keep all visible.
            colour, marker = _RULE_COLOURS[place % 6], _MARKERS[place % 6]
            label = f"{name}: {run.outcome}"
            axes.semilogy(
                values, color=colour, marker=marker, ms=7.0 - place, mfc="white", lw=1.2, label=label
            )
        cleared = 1e-5 * depth
        axes.axhline(cleared, color=INK, lw=0.6, ls=(0, (4, 3)))
        note = "1.5 µm\nin a 15 cm\nphotograph"
        axes.text(
            1.015, cleared, note, transform=axes.get_yaxis_transform(), va="center", fontsize=6.5, color=INK
        )
        axes.set_xticks(range(most + 1), labels=["start", *(str(c) for c in range(1, most + 1))])
        axes.set_xlabel("cycle")
        axes.set_ylabel("largest |y-parallax| in the model, m")
        axes.grid(axis="y", lw=0.3, alpha=0.6)
        axes.legend(loc="best", fontsize=7, frameon=True, framealpha=1.0, edgecolor="none")
        axes.set_title(title, fontsize=9)
    return figure


def _extent(places: FloatArray) -> tuple[float, float, float, float]:
    (x0, y0), (x1, y1) = places.min(axis=0), places.max(axis=0)
    margin = 0.14 * max(x1 - x0, y1 - y0)
    return float(x0 - margin), float(x1 + margin), float(y0 - margin), float(y1 + margin)


def _panel(
    axes: Any, run: EmpiricalRun, places: FloatArray, extent: tuple[float, float, float, float], number: int
) -> None:
    parallaxes = run.parallaxes[number]
    largest = float(np.abs(parallaxes).max())
    # The largest arrow stays within the margin.
    factor = 0.1 * (extent[3] - extent[2]) / largest if largest > 0.0 else 0.0
    used = [run.model.index(name) for name in run.procedure.points]
    axes.vlines(places[:, 0], places[:, 1], places[:, 1] + factor * parallaxes, color=PERPENDICULAR, lw=0.9)
    axes.plot(*places.T, ".", ms=2.0, color=RAY)
    axes.plot(*places[used].T, "o", ms=3.4, mfc="white", mec=INK, mew=0.7)
    up = parallaxes >= 0.0
    for mask, marker in ((up, "^"), (~up, "v")):
        tips = places[mask, 1] + factor * parallaxes[mask]
        axes.plot(places[mask, 0], tips, marker, ms=2.4, color=PERPENDICULAR, mew=0)
    # Points of many profiles lie side by side: then only those that are cleared have room for a name.
    cleared = {step.point for step in run.procedure.clearing}
    named = [row for row in used if len(used) <= _MOST_NAMES or run.model.names[row] in cleared]
    for row in named:
        side = -1.0 if places[row, 0] < 0.5 * (extent[0] + extent[1]) else 1.0
        shift = 0.05 * (extent[1] - extent[0]) * side
        axes.text(
            places[row, 0] + shift,
            places[row, 1],
            run.model.names[row],
            ha="right" if side < 0 else "left",
            va="center",
            fontsize=6.5,
            color=CIRCLE,
        )
    axes.set_xlim(extent[0], extent[1])
    axes.set_ylim(extent[2], extent[3])
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)
    heading = "start" if number == 0 else f"after cycle {number}"
    axes.set_title(f"{heading}\nlargest {largest:.2g} m", fontsize=7.5)
