"""Figures of what a stereo product tells by itself: heights of objects, errors of its height model."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from stereomate.report.overcorrection_style import INK, MM_PER_INCH, figure_style

Extent = tuple[float, float, float, float]

_WIDTH_MM: Final = 180.0


def draw_heights(above: NDArray[Any], sigma: NDArray[Any], extent_km: Extent, title: str) -> Figure:
    """Heights above the height model, and their standard deviations."""
    with figure_style():
        figure = _figure(extent_km, 2)
        known = above[np.isfinite(above)]
        high = float(np.quantile(known, 0.998)) if known.size else 1.0
        spread = sigma[np.isfinite(sigma)]
        most = float(np.quantile(spread, 0.9)) if spread.size else 1.0
        panels = (
            (above, "viridis", (0.0, max(high, 1.0)), "height above the height model, m"),
            (sigma, "magma", (0.0, max(most, 1e-3)), "standard deviation, m"),
        )
        for axes, (values, colours, limits, label) in zip(figure.subplots(1, 2), panels, strict=True):
            image = axes.imshow(
                values,
                cmap=colours,
                vmin=limits[0],
                vmax=limits[1],
                extent=extent_km,
                interpolation="nearest",
            )
            figure.colorbar(image, ax=axes, orientation="horizontal", pad=0.12, shrink=0.8, label=label)
            _frame(axes)
        figure.suptitle(title, fontsize=9.0, color=INK)
    return figure


def draw_terrain_check(correction: NDArray[Any], extent_km: Extent, figures: dict[str, Any]) -> Figure:
    """The corrections of a height model on open ground, and how they are distributed."""
    with figure_style():
        figure = _figure(extent_km, 2)
        left, right = figure.subplots(1, 2)
        known = correction[np.isfinite(correction)]
        size = float(np.quantile(np.abs(known), 0.98)) if known.size else 1.0
        size = max(size, 1e-3)
        image = left.imshow(
            correction, cmap="RdBu_r", vmin=-size, vmax=size, extent=extent_km, interpolation="nearest"
        )
        label = "ground minus height model, m"
        figure.colorbar(image, ax=left, orientation="horizontal", pad=0.12, shrink=0.8, label=label)
        _frame(left)
        right.hist(known, bins=np.linspace(-1.5 * size, 1.5 * size, 91).tolist(), color="#1f5fa8")
        right.axvline(0.0, color=INK, linewidth=0.6)
        right.set_xlabel(label)
        right.set_ylabel("cells of the figure")
        lines = [
            f"cells {figures['nodes']}",
            f"mean {figures['mean_m']:+.3f} m",
            f"median {figures['median_m']:+.3f} m",
            f"nmad {figures['nmad_m']:.3f} m",
            f"rms {figures['rms_m']:.3f} m",
            f"predicted σ {figures['sigma_m']:.3f} m",
            "tilt {:+.2f}, {:+.2f} ‰".format(*figures["tilt_per_mille"]),
        ]
        right.text(0.02, 0.98, "\n".join(lines), transform=right.transAxes, va="top", fontsize=7.0, color=INK)
        figure.suptitle("The height model on open ground, as the stereo-orthophoto shows it", fontsize=9.0)
    return figure


def _figure(extent_km: Extent, panels: int) -> Figure:
    width, height = extent_km[1] - extent_km[0], extent_km[3] - extent_km[2]
    inches = _WIDTH_MM / MM_PER_INCH
    tall = min(max(inches / panels * height / max(width, 1e-9), 1.6), 6.0) + 1.4
    return Figure(figsize=(inches, tall), layout="constrained")


def _frame(axes: Any) -> None:
    axes.set_xlabel("km")
    axes.set_ylabel("km")
    axes.tick_params(labelsize=7.0)
