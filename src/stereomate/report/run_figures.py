"""Figures of a run: block layout, overlap, parallax law, measured parallaxes."""

from __future__ import annotations

import base64
import io
from typing import Any

import numpy as np
import shapely
from matplotlib.colors import LightSource
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from stereomate.coverage.summary import Coverage
from stereomate.coverage.survey import Survey
from stereomate.frames.transform import map_from_map
from stereomate.parallax.laws import LawKind, ParallaxLaw
from stereomate.rectify.job import RectifyJob
from stereomate.stereo.agreement import Agreement
from stereomate.terrain.model import HeightModel

Array = NDArray[np.float64]

INK = "#1d2326"
ACCENT = "#1f5fa8"
WARM = "#c1511b"
STYLE = {"linewidth": 0.9, "color": ACCENT}
_RELIEF_PX = 420
# Places of the map of overlap along each side.
_PLACES = 300


def svg_uri(figure: Figure) -> str:
    """A data URI of a figure as SVG (rasters inside stay PNG)."""
    data = io.BytesIO()
    figure.savefig(data, format="svg", bbox_inches="tight", metadata={"Date": None})
    return "data:image/svg+xml;base64," + base64.b64encode(data.getvalue()).decode()


def layout_figure(survey: Survey, coverage: Coverage, heights: HeightModel, jobs: list[RectifyJob]) -> Figure:
    """Footprints, centres, bases of the serving models and the product's outline on the height model."""
    figure = Figure(figsize=(7.2, 6.4), dpi=110)
    axes = figure.add_subplot()
    bounds = _bounds(coverage, survey, jobs)
    _relief(axes, survey, heights, bounds)
    for footprint in coverage.known:
        x, y = footprint.polygon.exterior.xy
        axes.plot(x, y, color=INK, linewidth=0.6, alpha=0.7)
    for job in jobs:
        corners = np.vstack([job.grid.corners(), job.grid.corners()[:1]])
        axes.plot(corners[:, 0], corners[:, 1], color=WARM, linewidth=1.3, linestyle="--")
        _bases(axes, survey, job)
    centres = survey.centres_map
    axes.plot(centres[:, 0], centres[:, 1], "o", color=ACCENT, markersize=3.5)
    if len(centres) <= 30:
        for photograph, (x, y, _) in zip(survey.photographs, centres, strict=True):
            axes.annotate(
                _short(photograph.name), (x, y), fontsize=6, xytext=(3, 3), textcoords="offset points"
            )
    _map_axes(axes, bounds)
    return figure


def _bases(axes: Any, survey: Survey, job: RectifyJob) -> None:
    where = {p.name: c for p, c in zip(survey.photographs, survey.centres_map, strict=True)}
    for model in job.models:
        if model.right >= 0 and model.penalty < 0.7:
            ends = np.array([where[job.photographs[i].name] for i in (model.left, model.right)])
            axes.plot(ends[:, 0], ends[:, 1], **STYLE)


def overlap_counts(
    coverage: Coverage, survey: Survey, jobs: list[RectifyJob]
) -> tuple[NDArray[np.int64], tuple[float, float, float, float]]:
    """How many photographs show each place of a grid over the block, and its bounds in the map."""
    bounds = x_min, y_min, x_max, y_max = _bounds(coverage, survey, jobs)
    x, y = np.meshgrid(np.linspace(x_min, x_max, _PLACES), np.linspace(y_min, y_max, _PLACES))
    count = np.zeros(x.shape, np.int64)
    for footprint in coverage.known:
        count += shapely.contains_xy(footprint.polygon, x.ravel(), y.ravel()).reshape(x.shape)
    return count, bounds


def overlap_figure(count: NDArray[np.int64], bounds: tuple[float, float, float, float]) -> Figure:
    """How many photographs show each place, as `overlap_counts` has it."""
    figure = Figure(figsize=(7.2, 5.6), dpi=110)
    axes = figure.add_subplot()
    x_min, y_min, x_max, y_max = bounds
    shown = np.ma.masked_equal(count, 0)
    image = axes.imshow(
        shown,
        origin="lower",
        extent=(x_min, x_max, y_min, y_max),
        cmap="viridis",
        vmin=1,
        vmax=max(2, count.max()),
    )
    figure.colorbar(image, ax=axes, label="photographs", shrink=0.8, ticks=MaxNLocator(integer=True))
    _map_axes(axes, bounds)
    return figure


def law_figure(job: RectifyJob) -> Figure:
    """The parallax law over the heights of the product, and the other laws beside it."""
    figure = Figure(figsize=(5.6, 3.6), dpi=110)
    axes = figure.add_subplot()
    low, high = job.height_range
    h = np.linspace(low, high, 200)
    law = job.law
    styles: dict[LawKind, str] = {"linear": ":", "logarithmic": "-", "natural": "--"}
    styles.setdefault(law.kind, "-")
    for kind, style in styles.items():
        mine = kind == law.kind
        curve = law if mine else ParallaxLaw(kind, law.base_m, law.w0_m, law.reference_m)
        label = f"{kind} (this product)" if mine else kind
        line = axes.plot(curve.q(h) / job.grid.gsd, h, style, label=label, color="#8a9398", linewidth=1.0)[0]
        if mine:
            line.set(color=WARM, linewidth=1.8)
    axes.set_xlabel("artificial parallax, pixels")
    axes.set_ylabel("height, m")
    axes.legend(frameon=False, fontsize=8)
    _plain(axes)
    return figure


def residual_figure(agreement: Agreement) -> Figure:
    """Measured parallax residuals as points with their histograms' limits."""
    figure = Figure(figsize=(5.6, 4.4), dpi=110)
    axes = figure.add_subplot()
    x, y = agreement.residuals[:, 0], agreement.residuals[:, 1]
    reach = max(0.3, 5.0 * max(agreement.ortho_mate.nmad_px))
    axes.plot(
        np.clip(x, -reach, reach), np.clip(y, -reach, reach), ".", color=ACCENT, markersize=3, alpha=0.5
    )
    axes.axhline(0.0, color=INK, linewidth=0.5)
    axes.axvline(0.0, color=INK, linewidth=0.5)
    axes.set_xlim(-1.05 * reach, 1.05 * reach)
    axes.set_ylim(-1.05 * reach, 1.05 * reach)
    axes.set_xlabel("x-parallax minus q(h), pixels")
    axes.set_ylabel("y-parallax, pixels")
    axes.set_aspect("equal")
    _plain(axes)
    return figure


def _relief(
    axes: Any, survey: Survey, heights: HeightModel, bounds: tuple[float, float, float, float]
) -> None:
    x_min, y_min, x_max, y_max = bounds
    x, y = np.meshgrid(np.linspace(x_min, x_max, _RELIEF_PX), np.linspace(y_max, y_min, _RELIEF_PX))
    points = np.stack([x, y, np.zeros_like(x)], axis=-1)
    there = map_from_map(heights.frame, survey.frame, points)
    z = heights.heights_at(there[..., :2])
    if not np.isfinite(z).any():
        return
    cell = (x_max - x_min) / _RELIEF_PX
    filled = np.where(np.isfinite(z), z, np.nanmean(z))
    shade = LightSource(315, 40).hillshade(filled, vert_exag=2.0, dx=cell, dy=cell)
    shade = np.where(np.isfinite(z), 0.45 + 0.55 * shade, 1.0)
    extent = (x_min, x_max, y_min, y_max)
    axes.imshow(shade, cmap="gray", vmin=0.0, vmax=1.0, extent=extent, interpolation="bilinear")


def _bounds(coverage: Coverage, survey: Survey, jobs: list[RectifyJob]) -> tuple[float, float, float, float]:
    points = [np.array(f.polygon.exterior.coords)[:, :2] for f in coverage.known]
    points += [survey.centres_map[:, :2]]
    points += [job.grid.corners() for job in jobs]
    every = np.vstack(points)
    low, high = every.min(axis=0), every.max(axis=0)
    margin = 0.04 * (high - low).max()
    return (float(low[0] - margin), float(low[1] - margin), float(high[0] + margin), float(high[1] + margin))


def _map_axes(axes: Any, bounds: tuple[float, float, float, float]) -> None:
    axes.set_xlim(bounds[0], bounds[2])
    axes.set_ylim(bounds[1], bounds[3])
    axes.set_aspect("equal")
    axes.ticklabel_format(style="plain", useOffset=False)
    axes.locator_params(nbins=5)
    axes.set_xlabel("first map axis, m")
    axes.set_ylabel("second map axis, m")
    axes.tick_params(labelsize=7)


def _plain(axes: Any) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=8)


def _short(name: str) -> str:
    return name if len(name) <= 14 else "…" + name[-12:]
