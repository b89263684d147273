"""A table of over-correction factors as a heat map with its critical line."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from matplotlib.colors import LinearSegmentedColormap, TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from stereomate.relative.tables import OverCorrectionTable, overcorrection_table
from stereomate.report.overcorrection_style import CIRCLE, INK, figure_style

# a/d = 1/n goes through zero where n jumps from +∞ to -∞: a colour scale without a seam.
_COLOURS: Final = LinearSegmentedColormap.from_list(
    "strength", ["#3b4a8f", "#8b9bd1", "#f7f3ec", "#f1b26a", "#b5541c"][::-1]
)
_FINE: Final = 241
_LEVELS: Final = (-20.0, -10.0, -5.0, -3.0, 1.2, 1.5, 2.0, 3.0, 5.0, 10.0, 20.0)


def heat_map(table: OverCorrectionTable, title: str = "") -> Figure:
    """Draw the table: colour by a/d = 1/n, lines of equal n, the values, the critical line.

    Parameters
    ----------
    table : OverCorrectionTable
    title : str
    """
    h3, h5 = np.array(table.h3), np.array(table.h5)
    half3, half5 = _half_step(h3), _half_step(h5)
    rows = np.linspace(h3.min() - half3, min(h3.max() + half3, 0.999), _FINE)
    columns = np.linspace(h5.min() - half5, min(h5.max() + half5, 0.999), _FINE)
    with np.errstate(divide="ignore"):
        strength = 1.0 / overcorrection_table(table.tangent, rows, columns).factors
    limit = float(np.abs(strength).max())
    with figure_style():
        width = max(110.0, 16.0 + 14.0 * len(h5)) / 25.4
        height = max(80.0, 26.0 + 9.0 * len(h3)) / 25.4
        figure = Figure(figsize=(width, height), layout="constrained")
        axes = figure.add_subplot()
        mesh = axes.pcolormesh(
            columns,
            rows,
            strength,
            cmap=_COLOURS,
            norm=TwoSlopeNorm(0.0, -limit, limit),
            shading="gouraud",
            rasterized=True,
        )
        lines = axes.contour(
            columns,
            rows,
            strength,
            levels=sorted(1.0 / n for n in _LEVELS),
            colors=INK,
            linewidths=0.35,
            alpha=0.45,
        )
        lines.set_gid("equal-n")
        _critical_line(axes, table, columns, rows)
        _values(axes, table, limit)
        axes.set_xlim(columns[0], columns[-1])
        axes.set_ylim(rows[0], rows[-1])
        axes.set_xticks(h5)
        axes.set_yticks(h3)
        axes.set_xlabel("$h_5/z_1$")
        axes.set_ylabel("$h_3/z_1$")
        axes.set_title(title or f"over-correction factor n, y/z = {table.tangent:.4g}", fontsize=9)
        bar = figure.colorbar(mesh, ax=axes, pad=0.02, aspect=30)
        ticks = [
            n
            for n in (-2.0, -3.0, -5.0, -10.0, math.inf, 10.0, 5.0, 3.0, 2.0, 1.5, 1.2, 1.0)
            if abs(1.0 / n) <= limit
        ]
        bar.set_ticks([1.0 / n for n in ticks], labels=["±∞" if math.isinf(n) else f"{n:g}" for n in ticks])
        bar.set_label("n (colour by a/d = 1/n)")
        bar.outline.set_linewidth(0.4)
    return figure


def _half_step(values: Any) -> float:
    return 0.5 * float(np.diff(np.sort(values)).min()) if len(values) > 1 else 0.05


def _critical_line(axes: Any, table: OverCorrectionTable, columns: Any, rows: Any) -> None:
    total = table.critical_sum
    (line,) = axes.plot(columns, total - columns, color=CIRCLE, lw=1.8, ls=(0, (6, 2, 1.5, 2)), zorder=3)
    line.set_gid("critical-line")
    text = f"critical line $(h_3+h_5)/z_1$ = {total:.3g}"
    axes.plot([], [], label=text, color=CIRCLE, lw=1.8, ls=(0, (6, 2, 1.5, 2)))
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.16), fontsize=7.5, borderaxespad=0.0)


def _values(axes: Any, table: OverCorrectionTable, limit: float) -> None:
    for h3, row in zip(table.h3, table.factors, strict=True):
        for h5, n in zip(table.h5, row, strict=True):
            critical = math.isinf(n)
            text = "±∞" if critical else f"{n:.1f}"
            colour = "white" if abs(1.0 / n) > 0.55 * limit else INK
            halo = [withStroke(linewidth=2.2, foreground="white")] if critical or abs(n) > 8.0 else []
            axes.text(
                h5,
                h3,
                text,
                ha="center",
                va="center",
                fontsize=7.5,
                color=CIRCLE if critical else colour,
                fontweight="bold" if critical else "normal",
                path_effects=halo,
                zorder=4,
            )
