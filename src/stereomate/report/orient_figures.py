"""Figures of an orientation: the block with its residuals, image residuals over the format, statistics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from stereomate.report.run_figures import ACCENT, INK, WARM

Array = NDArray[np.float64]

_CELLS = 12
# The longest arrow takes this share of the width of a plan.
_LONGEST = 0.12
_MOST_NAMES = 60
_IMAGES = (".tif", ".tiff", ".jpg", ".jpeg", ".png", ".jp2")


def residual_figure(pixels: Array, residuals: Array, size_px: tuple[int, int]) -> Figure:
    """Mean image residuals in the cells of the format: what the camera's calibration leaves."""
    figure = Figure(figsize=(7.2, 4.8), dpi=110)
    axes = figure.add_subplot()
    side = max(size_px) / _CELLS
    number = (pixels / side).astype(np.int64)
    cells: list[tuple[float, ...]] = []
    for col, row in np.unique(number, axis=0).tolist():
        mine = (number == (col, row)).all(axis=1)
        if np.count_nonzero(mine) >= 5:
            dx, dy = residuals[mine].mean(axis=0)
            cells.append(((col + 0.5) * side, (row + 0.5) * side, dx, dy))
    if cells:
        table = np.array(cells)
        largest = float(np.hypot(table[:, 2], table[:, 3]).max())
        scale = 0.9 * side / max(largest, 1e-9)
        axes.quiver(
            table[:, 0], table[:, 1], table[:, 2] * scale, table[:, 3] * scale,
            angles="xy", scale_units="xy", scale=1.0, color=ACCENT, width=0.003,
        )  # fmt: skip
        axes.set_title(f"means over cells; longest arrow: {largest:.2f} px", fontsize=9)
    axes.set_xlim(0, size_px[0])
    axes.set_ylim(size_px[1], 0)
    axes.set_aspect("equal")
    axes.set_xlabel("column")
    axes.set_ylabel("row")
    return figure


def adjusted_block_figure(
    centres: Array,
    residuals: Array,
    points: Mapping[str, tuple[Array, Array]],
    names: Sequence[str] = (),
    ties: Array | None = None,
) -> Figure:
    """Plan of an adjusted block in the map: residuals of positions, control and check points.

    Arrows show them in plan, bars upwards and downwards in height, each kind to a scale of its own.

    Parameters
    ----------
    centres : ndarray (n, 3)
    residuals : ndarray (n, 3)
        Of observed positions, metres; NaN for none.
    points : mapping of "control" and "check" to two ndarrays (k, 3)
        Map positions (NaN where not known) and residuals, metres.
    names : sequence of str
        Of the centres; what all begin with is left out.
    ties : ndarray (k, 3), optional
        Tie points in the map.
    """
    held = np.vstack([centres[:, :2], *(at[:, :2] for at, _ in points.values())])
    if ties is not None:
        held = np.vstack([held, ties[:, :2]])
    held = held[np.isfinite(held).all(axis=1)]
    origin = np.round(held.mean(axis=0), -2)
    low, high = held.min(axis=0) - origin, held.max(axis=0) - origin
    width = float(max((high - low).max(), 1.0))
    figure = Figure(figsize=_size_of(high - low), dpi=110)
    axes = figure.add_subplot()
    if ties is not None:
        axes.plot(*(ties[:, :2] - origin).T, ".", color=INK, markersize=1.0, alpha=0.3)
    kinds = [("positions", centres, residuals, "o", ACCENT, 4.0)]
    for kind, marker, colour in (("control", "^", INK), ("check", "s", WARM)):
        if kind in points:
            kinds.append((f"{kind} points", *points[kind], marker, colour, 6.0))
    for label, at, moved, marker, colour, size in kinds:
        plan = at[:, :2] - origin
        axes.plot(
            *plan.T, marker, color=colour, markersize=size, fillstyle="none",
            label=_arrows(axes, plan, moved, label, colour, width),
        )  # fmt: skip
    if 0 < len(names) <= _MOST_NAMES:
        for text, (x, y) in zip(_without_common(names), centres[:, :2] - origin, strict=True):
            axes.annotate(text, (x, y), fontsize=6, xytext=(4, 3), textcoords="offset points", color="#555")
    margin = (_LONGEST + 0.02) * width
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - margin, high[1] + margin)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=7)
    axes.set_xlabel(f"easting - {origin[0]:.0f}", fontsize=8)
    axes.set_ylabel(f"northing - {origin[1]:.0f}", fontsize=8)
    figure.legend(fontsize=7, loc="outside lower left", frameon=False)
    figure.set_layout_engine("constrained")
    return figure


def _arrows(axes: Axes, plan: Array, moved: Array, label: str, colour: str, width: float) -> str:
    """Draw residuals of one kind; its label with the longest of them."""
    known = np.isfinite(plan).all(axis=1)
    flat, up = known & np.isfinite(moved[:, :2]).all(axis=1), known & np.isfinite(moved[:, 2])
    if not (flat.any() or up.any()):
        return label
    lengths = (
        float(np.hypot(*moved[flat, :2].T).max(initial=0.0)),
        float(np.abs(moved[up, 2]).max(initial=0.0)),
    )
    scale = _LONGEST * width / max(*lengths, 1e-12)
    axes.quiver(
        *plan[flat].T, *(scale * moved[flat, :2].T), color=colour,
        angles="xy", scale_units="xy", scale=1.0, width=0.0035,
    )  # fmt: skip
    foot = plan[up, 1]
    axes.vlines(plan[up, 0], foot, foot + scale * moved[up, 2], color=colour, linewidth=2.5, alpha=0.45)
    return f"{label}, longest {lengths[0]:.3g} m in plan, {lengths[1]:.3g} m in height"


def _size_of(extent: Array) -> tuple[float, float]:
    """Inches of a figure that is filled by its plan."""
    ratio = float((extent[1] + _LONGEST) / max(extent[0] + _LONGEST, 1e-9))
    return 5.6, float(np.clip(5.6 * ratio, 2.6, 7.0)) + 0.6


def _without_common(names: Sequence[str]) -> list[str]:
    """Names without extension and without what all of them begin with, but for digits."""
    stems = [name.rsplit(".", 1)[0] if name.lower().endswith(_IMAGES) else name for name in names]
    alike = 0
    while all(alike < len(stem) and stem[alike] == stems[0][alike] for stem in stems):
        alike += 1
    alike = len(stems[0][:alike].rstrip("0123456789"))
    return [stem[alike:] for stem in stems]


def standardized_figure(counts: Sequence[int]) -> Figure:
    """Histogram of standardized residuals from -5 to 5, and the normal distribution of as many."""
    figure = Figure(figsize=(7.2, 2.8), dpi=110)
    axes = figure.add_subplot()
    edges = np.linspace(-5.0, 5.0, len(counts) + 1)
    axes.bar(edges[:-1], counts, np.diff(edges), align="edge", color=ACCENT, alpha=0.55)
    x = np.linspace(-5.0, 5.0, 201)
    normal = np.exp(-x * x / 2.0) / np.sqrt(2.0 * np.pi)
    axes.plot(x, normal * float(sum(counts)) * (edges[1] - edges[0]), color=INK, linewidth=1.0)
    axes.set_xlim(-5.0, 5.0)
    axes.set_xlabel("standardized residual", fontsize=8)
    axes.set_ylabel("image coordinates", fontsize=8)
    axes.tick_params(labelsize=7)
    figure.set_layout_engine("constrained")
    return figure


def centre_sigma_figure(names: Sequence[str], sigma: Array) -> Figure:
    """Standard deviations of projection centres (n, 3), metres, over the photographs."""
    figure = Figure(figsize=(5.6, 3.2), dpi=110)
    axes = figure.add_subplot()
    at = np.arange(len(names))
    for axis, (label, colour) in enumerate((("east", ACCENT), ("north", INK), ("up", WARM))):
        axes.plot(at, sigma[:, axis], "o-", color=colour, markersize=3, linewidth=0.8, label=label)
    if len(names) <= 30:
        axes.set_xticks(at, names, rotation=60, ha="right", fontsize=6)
    else:
        axes.set_xlabel("photographs in their order")
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel("σ, m")
    axes.legend(fontsize=7)
    figure.set_layout_engine("constrained")
    return figure
