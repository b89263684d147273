"""Figures of an orientation: the block with residuals of its positions, image residuals over the format."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from stereomate.report.run_figures import ACCENT, INK, WARM

Array = NDArray[np.float64]

_CELLS = 12


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
