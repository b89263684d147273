"""Figures of an orientation: the block with residuals of its positions, image residuals over the format."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from stereomate.report.run_figures import ACCENT, INK, WARM

Array = NDArray[np.float64]

_CELLS = 12
# The longest arrow takes this share of the width of a plan.
_LONGEST = 0.12


def block_figure(names: Sequence[str], centres: Array, residuals: Array, points: Array) -> Figure:
    """Centres with the residuals of their observed positions, and the tie points.

    Parameters
    ----------
    names : sequence of str
    centres : ndarray, shape (n, 3)
        In metres, any frame.
    residuals : ndarray, shape (n, 3)
        Observed minus adjusted position; NaN for none.
    points : ndarray, shape (k, 3)
    """
    figure = Figure(figsize=(7.2, 6.0), dpi=110)
    axes = figure.add_subplot()
    origin = centres.mean(axis=0)
    known = points[np.isfinite(points[:, 0])] - origin
    axes.plot(known[:, 0], known[:, 1], ".", color=INK, markersize=1.2, alpha=0.35)
    at = centres - origin
    axes.plot(at[:, 0], at[:, 1], "o", color=ACCENT, markersize=4)
    moved = np.isfinite(residuals[:, 0])
    if moved.any():
        largest = float(np.hypot(*residuals[moved, :2].T).max())
        scale = 0.12 * float(np.ptp(at[:, :2], axis=0).max()) / max(largest, 1e-9)
        axes.quiver(
            at[moved, 0], at[moved, 1], residuals[moved, 0] * scale, residuals[moved, 1] * scale,
            angles="xy", scale_units="xy", scale=1.0, color=WARM, width=0.004,
        )  # fmt: skip
        axes.set_title(f"longest arrow: {largest:.2f} m", fontsize=9)
    if len(names) <= 40:
        for name, (x, y, _) in zip(names, at, strict=True):
            axes.annotate(name, (x, y), fontsize=6, xytext=(3, 3), textcoords="offset points")
    reach = 1.35 * np.abs(at[:, :2]).max(axis=0) + 0.1 * np.ptp(at[:, :2], axis=0).max()
    axes.set_xlim(-reach[0], reach[0])
    axes.set_ylim(-reach[1], reach[1])
    axes.set_aspect("equal")
    axes.set_xlabel("east, m from the middle of the block")
    axes.set_ylabel("north, m")
    return figure


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
    centres: Array, residuals: Array, points: Mapping[str, tuple[Array, Array]]
) -> Figure:
    """Plan of an adjusted block in the map: residuals of positions, control and check points as arrows.

    Parameters
    ----------
    centres : ndarray (n, 3)
    residuals : ndarray (n, 3)
        Of observed positions, metres; NaN for none.
    points : mapping of "control" and "check" to two ndarrays (k, 3)
        Map positions (NaN where not known) and residuals, metres.
    """
    figure = Figure(figsize=(7.2, 6.0), dpi=110)
    axes = figure.add_subplot()
    places = [centres[:, :2], *(at[:, :2] for at, _ in points.values())]
    held = np.vstack(places)
    held = held[np.isfinite(held).all(axis=1)]
    low, high = held.min(axis=0), held.max(axis=0)
    width = float(max((high - low).max(), 1.0))
    shown = (
        ("positions", centres, residuals, "o", ACCENT, 4.0),
        *(
            (f"{kind} points", *points[kind], marker, WARM if kind == "check" else INK, 6.0)
            for kind, marker in (("control", "^"), ("check", "s"))
            if kind in points
        ),
    )
    for label, at, moved, marker, colour, size in shown:
        known = np.isfinite(at[:, :2]).all(axis=1) & np.isfinite(moved[:, :2]).all(axis=1)
        plan = np.hypot(*moved[known, :2].T)
        largest = float(plan.max(initial=0.0))
        said = f"{label}, longest {largest:.3g} m" if known.any() else label
        axes.plot(at[:, 0], at[:, 1], marker, color=colour, markersize=size, fillstyle="none", label=said)
        if largest > 0.0:
            scale = _LONGEST * width / largest
            axes.quiver(
                *at[known, :2].T, *(scale * moved[known, :2].T), color=colour,
                angles="xy", scale_units="xy", scale=1.0, width=0.004,
            )  # fmt: skip
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


def centre_sigma_figure(names: Sequence[str], sigma: Array) -> Figure:
    """Standard deviations of projection centres (n, 3), metres, over the photographs."""
    figure = Figure(figsize=(7.2, 3.2), dpi=110)
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
    return figure
