"""Figures of homogeneity: error vectors over a model (Fig. 2 of the paper), maps, laws compared."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from numpy.typing import NDArray

from stereomate.parallax.choice import LawChoice
from stereomate.parallax.homogeneity import (
    BASE_SHARE,
    PAPER_SLOPES_DEG,
    RelativeLaw,
    TableCase,
    error_vectors_mm,
)
from stereomate.report.overcorrection_style import INK, MM_PER_INCH, figure_style

Floats = NDArray[np.float64]

_STEREO: Final = "#1f5fa8"
_PAIR: Final = "#d1600a"
_LEVELS: Final = (-0.5, -0.2, -0.1, -0.05, -0.02, 0.02, 0.05, 0.1, 0.2, 0.5)
_LAW_COLOURS: Final = {
    "linear": "#1a7044",
    "logarithmic": "#1f5fa8",
    "natural": "#d1600a",
    "table": "#7b3f9e",
}


def draw_error_vectors(
    cameras: Sequence[tuple[float, float]] = ((152.0, 230.0), (210.0, 180.0)),
    object_height: float = 0.05,
    slopes_deg: tuple[float, float] = PAPER_SLOPES_DEG,
    law: RelativeLaw = "logarithmic",
    flying_height_m: float = 1500.0,
    map_scale: float = 1000.0,
    reduction: float = 8.0,
) -> Figure:
    """Errors of residual parallaxes as vectors over the stereo model, to scale.

    Parameters
    ----------
    cameras : sequence of (principal distance, format), mm
        One panel each.
    object_height : float
        Over the flying height.
    slopes_deg : (float, float)
        Along and across the base.
    law : str
        Of the stereomate.
    flying_height_m, map_scale : float
        They make the vectors millimetres of a map of this scale.
    reduction : float
        The model is drawn this many times smaller than in the map; vectors are as in the map.
    """
    with figure_style():
        figure = Figure(figsize=(2.0 * 92.0 / MM_PER_INCH, 128.0 / MM_PER_INCH), layout="constrained")
        panels = np.atleast_1d(figure.subplots(1, len(cameras), sharex=True, sharey=True))
        for axes, (principal_distance, size) in zip(panels, cameras, strict=True):
            case = TableCase(principal_distance, size, 0.0, object_height)
            enlargement = 1e3 * flying_height_m / (principal_distance * map_scale)
            _draw_vectors(axes, case, slopes_deg, law, enlargement, reduction)
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=2)
        figure.suptitle(
            f"Errors of the residual parallax of objects of {object_height:.0%} of the flying height "
            f"({flying_height_m * object_height:g} m at {flying_height_m:g} m),\n"
            f"slopes {slopes_deg[0]:g}° along, {slopes_deg[1]:g}° across the base, "
            f"vectors in mm of 1:{map_scale:g}",
            fontsize=8.5,
            color=INK,
        )
    return figure


def _draw_vectors(
    axes: Axes,
    case: TableCase,
    slopes_deg: tuple[float, float],
    law: RelativeLaw,
    enlargement: float,
    reduction: float,
) -> None:
    half = 0.35 * case.format_mm
    x, y = np.meshgrid(np.linspace(0.0, case.base_mm, 5), np.linspace(-half, half, 7))
    points = np.stack([x, y], axis=-1).reshape(-1, 2)
    at = points * enlargement / reduction
    kinds: tuple[tuple[RelativeLaw, str, str], ...] = (
        ("none", _PAIR, "pair of orthophotos"),
        (law, _STEREO, f"stereo-orthophoto, {law}"),
    )
    for kind, colour, label in kinds:
        vectors = error_vectors_mm(case, points, slopes_deg, kind, enlargement)
        known = np.isfinite(vectors).all(axis=1)
        axes.quiver(
            *at[known].T, *vectors[known].T, color=colour, angles="xy", scale_units="xy", scale=1.0,
            width=0.004, headwidth=4.0, headlength=5.0, label=label, zorder=3,
        )  # fmt: skip
    axes.plot(*at.T, "o", color=INK, markersize=2.0, zorder=4)
    axes.plot([0.0, case.base_mm * enlargement / reduction], [0.0, 0.0], color=INK, linewidth=0.5)
    for centre, name in ((0.0, "left"), (case.base_mm, "right")):
        axes.annotate(
            name,
            (centre * enlargement / reduction, 0.0),
            xytext=(2, -9),
            textcoords="offset points",
            fontsize=6.5,
        )
    axes.set_aspect("equal")
    axes.margins(0.18)
    axes.set_title(
        f"c {case.principal_distance_mm:g} mm, {case.format_mm:g} mm format, base {BASE_SHARE:.0%}",
        fontsize=8.0,
    )
    axes.set_xlabel(f"vectors: mm in the map; model 1:{reduction:g} of the map")


def draw_homogeneity_map(
    values: Floats, extent: tuple[float, float, float, float], object_height_m: float, law: str
) -> Figure:
    """t_x, t_y and the error of the height read, side by side.

    Parameters
    ----------
    values : (rows, cols, 4)
        As `stereomate.stereo.homogeneity.BANDS`, reduced to the size of a figure.
    extent : (left, right, bottom, top)
        Kilometres along the product's axes.
    """
    with figure_style():
        figure = Figure(figsize=(11.5, 4.4), layout="constrained")
        panels = figure.subplots(1, 3, sharex=True, sharey=True)
        norm = BoundaryNorm(_LEVELS, 256, extend="both")
        images = []
        for axes, band, title in zip(panels[:2], (0, 1), ("t_x, along the rows", "t_y, across"), strict=True):
            images.append(_picture(axes, values[..., band], extent, norm, title))
        figure.colorbar(
            images[0],
            ax=list(panels[:2]),
            shrink=0.8,
            ticks=_LEVELS,
            format="%+.2f",
            label="of the ideal parallax",
        )
        metres = BoundaryNorm([level * object_height_m for level in _LEVELS], 256, extend="both")
        image = _picture(panels[2], values[..., 2], extent, metres, f"height read ({law}) minus true")
        figure.colorbar(image, ax=panels[2], shrink=0.8, format="%+.2f", label="metres")
        seen = values[..., 3]
        served = np.isfinite(seen)
        share = float((seen[served] == 3.0).mean()) if served.any() else float("nan")
        figure.suptitle(
            f"Objects of {object_height_m:g} m; seen in both photographs on {share:.1%} of the area "
            "(grey: not seen by both, or no model)",
            fontsize=10.0,
            color=INK,
        )
    return figure


def _picture(
    axes: Axes, values: Floats, extent: tuple[float, float, float, float], norm: BoundaryNorm, title: str
) -> AxesImage:
    axes.set_facecolor("#d9d9d9")
    image = axes.imshow(values, extent=extent, cmap="RdBu_r", norm=norm, interpolation="nearest")
    axes.set_title(title, fontsize=9.0)
    axes.set_xlabel("km along the rows")
    return image


def draw_laws(
    choice: LawChoice,
    height_range: tuple[float, float],
    fold: Floats,
    extent: tuple[float, float, float, float],
) -> Figure:
    """Laws compared: reading errors, parallaxes over height, and where the recommended one comes to fold.

    Parameters
    ----------
    height_range : (low, high)
        Of the ground.
    fold : (rows, cols)
        q' dh/du of the recommended law over the product; 1 and more folds.
    extent : (left, right, bottom, top)
        Kilometres.
    """
    with figure_style():
        figure = Figure(figsize=(11.5, 3.8), layout="constrained")
        errors, parallaxes, folds = figure.subplots(1, 3)
        names = [a.law.kind for a in choice.assessments]
        colours = [_LAW_COLOURS[name] for name in names]
        errors.bar(names, [100.0 * a.error_rms for a in choice.assessments], color=colours)
        errors.set_ylabel("rms error of object heights, %")
        errors.set_title(f"recommended: {choice.recommended.law.kind}", fontsize=9.0)
        for assessment, colour in zip(choice.assessments, colours, strict=True):
            heights = np.linspace(*height_range, 60)
            parallaxes.plot(assessment.law.q(heights), heights, color=colour, label=assessment.law.kind)
        parallaxes.set_xlabel("q, metres on the ground")
        parallaxes.set_ylabel("height, m")
        parallaxes.legend()
        image = folds.imshow(fold, extent=extent, cmap="magma", vmin=-1.0, vmax=1.0, interpolation="nearest")
        folds.set_facecolor("#d9d9d9")
        folds.set_title("q' dh/du: folds at 1", fontsize=9.0)
        folds.set_xlabel("km")
        folds.set_ylabel("km")
        figure.colorbar(image, ax=folds, shrink=0.8)
    return figure
