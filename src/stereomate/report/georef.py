"""Figures of georeferencing in a map grid: errors of a planned flight, audit of an orientation."""

from __future__ import annotations

from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, Colormap, Normalize
from matplotlib.figure import Figure

from stereomate.frames.audit.findings import Audit
from stereomate.frames.audit.readings import WORK_WORDS
from stereomate.frames.prediction.predict import ErrorMap, Prediction
from stereomate.frames.prediction.simulate import METHODS, Outcome
from stereomate.report.overcorrection_style import INK, figure_style

_COLOURS: Final = "RdBu_r"
_GOOD: Final = "#1a7044"
_BAD: Final = "#b3261e"
# What each way of working is, below its bar.
METHOD_WORDS: Final = {
    "nothing": "nothing",
    "P1": "curvature\nonly",
    "M2": "M2 heights\nscaled",
    "M3": "M3 c\nscaled",
    "M3i": "M3 c per\nphoto",
    "M4": "M4 image\ncorrected",
    "M1": "M1 tangent\nframe",
}


def draw_prediction(prediction: Prediction, chart: ErrorMap) -> Figure:
    """Worst height errors of every way of working, and the map of errors over the area of the projection.

    Parameters
    ----------
    prediction : Prediction
    chart : ErrorMap
        Of the same plan.
    """
    plan = prediction.plan
    with figure_style():
        figure = Figure(figsize=(11.0, 5.2), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
        _draw_bars(left, prediction)
        _draw_map(figure, right, prediction, chart)
        figure.suptitle(
            f"{plan.frame.name}: flying height {plan.flying_height_m:g} m above ground at "
            f"{plan.ground_m:g} m, relief {plan.relief_m:g} m, c {plan.principal_distance_mm:g} mm",
            fontsize=10.0,
            color=INK,
        )
    return figure


def _draw_bars(axes: Axes, prediction: Prediction) -> None:
    groups = (
        ("direct", False, "direct, true orientation", "#1f5fa8"),
        ("indirect", False, "triangulation, c fixed", "#d1600a"),
        ("indirect", True, "triangulation, c free, GNSS", "#e2a566"),
    )
    width = 0.26
    floor = 1e-4
    for index, (mode, free, label, colour) in enumerate(groups):
        at = np.arange(len(METHODS)) + (index - 1) * width
        outcomes = [prediction.outcome(mode, method, free=free) for method in METHODS]  # type: ignore[arg-type]
        worst = [abs(outcome.worst_height_m) for outcome in outcomes]
        axes.bar(at, np.maximum(worst, floor), width * 0.92, bottom=0.0, color=colour, label=label)
        for x, outcome in zip(at, outcomes, strict=True):
            size = max(abs(outcome.worst_height_m), floor)
            axes.text(
                x,
                size * 1.12,
                _height_label(outcome),
                ha="center",
                va="bottom",
                fontsize=6.0,
                rotation=90,
                zorder=3,
                bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6},
            )
    axes.axhline(prediction.expected_m, color=_BAD, linewidth=1.0)
    axes.text(
        len(METHODS) - 0.5,
        prediction.expected_m * 1.06,
        f"expected: {prediction.expected_m:.3g} m",
        color=_BAD,
        ha="right",
        va="bottom",
        fontsize=7.0,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.4},
    )
    axes.axhline(prediction.expected_m / 3.0, color=_GOOD, linewidth=0.8, linestyle=(0, (4, 3)))
    axes.text(
        len(METHODS) - 0.5,
        prediction.expected_m / 3.0 * 1.06,
        "harmless: a third",
        color=_GOOD,
        ha="right",
        va="bottom",
        fontsize=7.0,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.4},
    )
    axes.set_yscale("log")
    top = max(max(abs(o.worst_height_m) for o in prediction.outcomes), prediction.expected_m)
    axes.set_ylim(floor, top * 6.0)
    axes.set_xticks(range(len(METHODS)), [METHOD_WORDS[method] for method in METHODS])
    axes.set_ylabel("largest height error, m (logarithmic)")
    axes.legend(loc="upper center", ncols=3, fontsize=7.0)


def _height_label(outcome: Outcome) -> str:
    value = outcome.worst_height_m
    return "< 0.1 mm" if abs(value) < 1e-4 else f"{value:+.3f}"


def _draw_map(figure: Figure, axes: Axes, prediction: Prediction, chart: ErrorMap) -> None:
    plan = prediction.plan
    error = chart.height_error_m
    largest = float(np.nanmax(np.abs(error)))
    levels = _levels(largest)
    colours: Colormap = _colormap()
    drawn = axes.contourf(
        chart.longitude_deg,
        chart.latitude_deg,
        error,
        levels=levels,
        cmap=colours,
        norm=BoundaryNorm(levels, colours.N),
        extend="both",
    )
    zero = [
        v for v in (-prediction.expected_m, prediction.expected_m) if np.nanmin(error) < v < np.nanmax(error)
    ]
    if zero:
        axes.contour(
            chart.longitude_deg,
            chart.latitude_deg,
            error,
            levels=zero,
            colors=_GOOD,
            linewidths=1.2,
            linestyles="solid",
        )
    axes.plot(
        plan.tangent.longitude_deg,
        plan.tangent.latitude_deg,
        "o",
        color=INK,
        markersize=5,
        markerfacecolor="w",
    )
    axes.annotate(
        "the block",
        (plan.tangent.longitude_deg, plan.tangent.latitude_deg),
        xytext=(0, 6),
        textcoords="offset points",
        ha="center",
        fontsize=7.5,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8, "alpha": 0.7},
    )
    bar = figure.colorbar(drawn, ax=axes, shrink=0.85, ticks=levels)
    bar.set_label("height error of points, m")
    axes.set_title(
        "Direct georeferencing in the grid, curvature corrected\n"
        f"(equation 4; ground at {plan.ground_m:g} m; green: ±{prediction.expected_m:.3g} m expected)",
        fontsize=8.5,
    )
    # Zones are strips: drawn at most 1.5 times as high as wide, or they could not be read.
    middle = np.deg2rad(float(np.mean(chart.latitude_deg)))
    shape = np.ptp(chart.latitude_deg) / (np.ptp(chart.longitude_deg) * max(float(np.cos(middle)), 0.15))
    axes.set_box_aspect(float(np.clip(shape, 0.5, 1.5)))
    axes.set_xlabel("longitude, °")
    axes.set_ylabel("latitude, °")


def _levels(largest: float) -> Any:
    """Round limits from minus to plus the largest error."""
    step = largest / 5.0
    power = 10.0 ** np.floor(np.log10(step))
    step = next(m for m in (1.0, 2.0, 2.5, 5.0, 10.0) if m * power >= step) * power
    return step * np.arange(-5, 6)


def _colormap() -> Colormap:
    return mpl.colormaps[_COLOURS]


def draw_audit(result: Audit) -> Figure:
    """Height differences of known points over the block, and the ranking of hypotheses.

    Parameters
    ----------
    result : Audit
    """
    best = result.best
    with figure_style():
        figure = Figure(figsize=(11.0, 4.8), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.25))
        known = np.isfinite(best.differences).all(axis=1)
        if known.any():
            _draw_differences(figure, left, result, known)
        else:
            left.axis("off")
            left.text(0.5, 0.5, "no points of known ground", ha="center", transform=left.transAxes)
        _draw_scores(right, result)
    return figure


def _draw_differences(figure: Figure, axes: Axes, result: Audit, known: Any) -> None:
    best, obs = result.best, result.observations
    places = obs.reference[known, :2]
    up = best.differences[known, 2]
    middle = places.mean(axis=0)
    limit = max(float(np.percentile(np.abs(up), 98)), 1e-3)
    x, y = (1e-3 * (places - middle)).T
    scale = Normalize(-limit, limit)
    control = obs.control[known]
    drawn = axes.scatter(
        x[~control], y[~control], c=up[~control], s=7.0, linewidths=0.0, norm=scale, cmap=_COLOURS
    )
    axes.scatter(
        x[control], y[control], c=up[control], s=60.0, marker="^", edgecolors=INK, norm=scale, cmap=_COLOURS
    )
    figure.colorbar(drawn, ax=axes, shrink=0.85).set_label("computed minus known height, m")
    axes.set_aspect("equal")
    axes.set_xlabel("x, km from the middle of the block")
    axes.set_ylabel("y, km")
    axes.set_title(
        f"Best hypothesis: {WORK_WORDS[best.work]}\n"
        f"mean {up.mean():+.3f} m, standard deviation {up.std():.3f} m; triangles: control",
        fontsize=8.5,
    )


def _draw_scores(axes: Axes, result: Audit) -> None:
    shown = result.ranked[:8]
    behind = [max(h.score - result.best.score, 0.1) for h in shown]
    at = np.arange(len(shown))[::-1]
    limits = ((4.0, "undecided"), (9.0, "likely"), (25.0, "very likely"), (np.inf, "excluded"))
    colours = ("#1a7044", "#8aa83a", "#d1a60a", "#b9b9b9")
    names = [next(k for k, (limit, _) in enumerate(limits) if value < limit) for value in behind]
    axes.barh(at, behind, color=[colours[k] for k in names], height=0.26)
    for y, h, value in zip(at, shown, behind, strict=True):
        part = h.points or h.control
        height = "" if part is None else f", height {part.mean[2]:+.3f} m"
        text = (
            f"{WORK_WORDS[h.work]}\n{h.heights.label} / "
            f"{h.reference_heights.label}{height}, {np.hypot(*h.image_rms_px):.3f} px"
        )
        if h.attitude != result.best.attitude:
            text += f", {h.attitude.name}"
        axes.text(0.115, y + 0.16, text, va="bottom", fontsize=6.5, color=INK)
        axes.text(value * 1.1, y, f"{h.score - result.best.score:.1f}", va="center", fontsize=6.5)
    for limit, name in limits[:3]:
        axes.axvline(limit, color="#999999", linewidth=0.6, linestyle=(0, (3, 3)))
        axes.text(limit, -0.75, name, rotation=90, va="bottom", ha="right", fontsize=6.0, color="#777777")
    axes.set_xscale("log")
    axes.set_xlim(0.1, max(behind) * 6.0)
    axes.set_ylim(-0.8, len(shown) - 0.2)
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)
    axes.set_xlabel("score behind the best (logarithmic)")
    axes.set_title("Hypotheses: heights of the orientation / of known points", fontsize=8.5)
