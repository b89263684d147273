"""Figure of the seams of a product: the ground of each model, its seams, and where photographs are mixed."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import hsv_to_rgb
from matplotlib.figure import Figure
from numpy.typing import NDArray

from stereomate.frames.transform import map_from_tangent
from stereomate.rectify.job import RectifyJob
from stereomate.report.run_figures import ACCENT, INK, WARM

Array = NDArray[np.float64]

# Names of models are written as long as they stay legible.
_MOST_NAMES = 40


def seams_figure(job: RectifyJob, picture: NDArray[np.uint8]) -> Figure:
    """Ground of each model tinted over the orthophoto, seams, mixed stretches and projection centres.

    Parameters
    ----------
    picture : (rows, cols, 3)
        The orthophoto, of any size.
    """
    assert job.seams is not None
    cols, rows = job.grid.size
    figure = Figure(figsize=(7.6, 7.6 * min(max(rows / cols, 0.35), 1.4) + 0.5), dpi=110)
    axes = figure.add_subplot()
    axes.imshow(picture, extent=(0, cols, rows, 0), interpolation="antialiased")
    models = sorted({m for m, _ in job.seams.polygons})
    for model, polygon in job.seams.polygons:
        points = np.asarray(polygon.exterior.coords)
        axes.fill(points[:, 0], points[:, 1], color=_tint(models.index(model)), alpha=0.28, linewidth=0)
        axes.plot(points[:, 0], points[:, 1], color=INK, linewidth=0.8)
        if len(models) <= _MOST_NAMES:
            at = polygon.representative_point()
            axes.annotate(
                _name(job, model), (at.x, at.y), fontsize=5.5, ha="center", va="center", color=INK,
                bbox={"facecolor": "white", "alpha": 0.65, "edgecolor": "none", "pad": 1.0},
            )  # fmt: skip
    axes.add_collection(LineCollection(_mixed(job), colors=WARM, linewidths=1.6))
    axes.plot([], [], color=INK, linewidth=0.8, label="seam")
    axes.plot([], [], color=WARM, linewidth=1.6, label="photographs mixed")
    axes.plot([], [], "o", color=ACCENT, markersize=4, label="projection centre")
    centres = _centres(job)
    inside = ((centres > 0) & (centres < [cols, rows])).all(axis=1)
    axes.plot(centres[inside, 0], centres[inside, 1], "o", color=ACCENT, markersize=4)
    axes.set_xlim(0, cols)
    axes.set_ylim(rows, 0)
    axes.set_xlabel("column of the orthophoto")
    axes.set_ylabel("row")
    axes.tick_params(labelsize=7)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=3, frameon=False, fontsize=8)
    return figure


def _centres(job: RectifyJob) -> Array:
    """Projection centres in product pixels."""
    centres = map_from_tangent(job.tangent, job.frame, job.centres_tangent)
    return job.grid.pixel_from_map(centres[:, :2])


def _mixed(job: RectifyJob) -> list[Any]:
    assert job.seams is not None
    pieces = []
    for line in job.seams.lines:
        points = np.asarray(line.points)
        wide = (points[1:, 2] > 0.0) | (points[:-1, 2] > 0.0)
        pieces += [points[k : k + 2, :2] for k in np.flatnonzero(wide)]
    return pieces


def _tint(number: int) -> tuple[float, float, float]:
    """Colours that neighbours in number do not share: the golden angle around the circle of hues."""
    red, green, blue = hsv_to_rgb((number * 0.381966 % 1.0, 0.75, 0.95))
    return float(red), float(green), float(blue)


def _name(job: RectifyJob, model: int) -> str:
    m = job.models[model]
    left = job.photographs[m.left].name
    return _short(left) if m.right < 0 else f"{_short(left)}\n{_short(job.photographs[m.right].name)}"


def _short(name: str) -> str:
    return name if len(name) <= 12 else "…" + name[-10:]
