"""Pictures of a relative orientation: the matches, the y-parallaxes, the six-point picture."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from stereomate.errors import InputError
from stereomate.relative.automatic import AutomaticOrientation
from stereomate.relative.model import model_points
from stereomate.relative.orientation import RelativeOrientation
from stereomate.relative.sixpoints import OrientationPoint, six_points
from stereomate.report.overcorrection_style import CIRCLE, INK, PERPENDICULAR, RAY, figure_style

Array = NDArray[np.float64]

_LEFT_OUT: Final = CIRCLE
_WIDTH_IN: Final = 6.7
_MOST_NAMES: Final = 60


def match_picture(
    left: NDArray[np.uint8],
    right: NDArray[np.uint8],
    result: AutomaticOrientation,
    names: tuple[str, str],
    reduction: int = 1,
) -> Figure:
    """Both photographs side by side with their orientation points, coloured by x-parallax.

    Parameters
    ----------
    left, right : ndarray of uint8, shape (rows, cols)
        Grey photographs, perhaps reduced.
    result : AutomaticOrientation
    names : (str, str)
        Of the photographs, for the titles.
    reduction : int
        Pixels of the photographs per pixel of the pictures.
    """
    used = _used(result)
    shift = np.linalg.norm(result.right_px - result.left_px, axis=1)
    with figure_style():
        ratio = max(left.shape[0] / left.shape[1], right.shape[0] / right.shape[1])
        figure = Figure(figsize=(_WIDTH_IN, 0.47 * _WIDTH_IN * ratio + 0.75), layout="constrained")
        panels = figure.subplots(1, 2)
        colours = _order(shift[used])
        for axes, image, pixels, name in zip(
            panels, (left, right), (result.left_px, result.right_px), names, strict=True
        ):
            axes.imshow(_bright(image), cmap="gray", vmin=0, vmax=255, interpolation="antialiased")
            bad = pixels[~used] / reduction
            axes.plot(bad[:, 0], bad[:, 1], "x", color=_LEFT_OUT, markersize=2.2, markeredgewidth=0.5)
            good = pixels[used] / reduction
            axes.scatter(good[:, 0], good[:, 1], s=4.0, c=colours, cmap="turbo", linewidths=0.0)
            axes.set_title(name, fontsize=8)
            axes.set_axis_off()
        figure.suptitle(_match_title(result, used), fontsize=8.5)
    return figure


def parallax_picture(
    left: NDArray[np.uint8],
    result: AutomaticOrientation,
    name: str,
    reduction: int = 1,
    arrow_px: float | None = None,
) -> Figure:
    """The left photograph with the y-parallax of every orientation point as an arrow across the base.

    Parameters
    ----------
    reduction : int
        Pixels of the photograph per pixel of the picture.
    arrow_px : float, optional
        The y-parallax that is drawn as long as a twentieth of the photograph; three times the root mean
        square by default.
    """
    orientation = _orientation(result)
    statistics = orientation.points()
    used = statistics.used
    rms = float(np.sqrt(np.mean(statistics.y_parallax[used] ** 2))) if used.any() else 0.0
    unit = arrow_px or max(3.0 * rms, 1e-9)
    across = _across(orientation.pose.base)
    with figure_style():
        ratio = left.shape[0] / left.shape[1]
        width = min(_WIDTH_IN, 7.5 / ratio)
        figure = Figure(figsize=(width, width * ratio + 0.9), layout="constrained")
        axes = figure.subplots()
        axes.imshow(_bright(left), cmap="gray", vmin=0, vmax=255, alpha=0.55, interpolation="antialiased")
        length = 0.05 * max(left.shape) / unit
        places = result.left_px / reduction
        for rows, colour in ((~used, _LEFT_OUT), (used, PERPENDICULAR)):
            # Left-out points may be anywhere: their arrows end at twice the unit.
            size = np.clip(statistics.y_parallax[rows], -2.0 * unit, 2.0 * unit) * length
            axes.quiver(
                *places[rows].T,
                *(size[:, None] * across).T,
                angles="xy",
                scale_units="xy",
                scale=1.0,
                color=colour,
                width=0.0016,
                headwidth=4.0,
                headlength=5.0,
                headaxislength=4.5,
            )
            axes.plot(*places[rows].T, ".", color=colour, markersize=1.2)
        _arrow_key(axes, left.shape, unit)
        axes.set_axis_off()
        kept, out = int(used.sum()), int((~used).sum())
        name = name if result.determined else f"{name} (NOT ORIENTED)"
        figure.suptitle(
            f"{name}\ny-parallaxes of {kept} points, {rms:.3f} px rms; {out} left out (red)", fontsize=8.5
        )
    return figure


def point_picture(
    orientation: RelativeOrientation, names: Sequence[str], title: str, determined: bool = True
) -> Figure:
    """Measured points where they lie in the left photograph, with their y-parallaxes as arrows.

    Parameters
    ----------
    orientation : RelativeOrientation
    names : sequence of str
        Of the points; written beside them where they are not too many.
    title : str
    determined : bool
        Otherwise the title says that there is no orientation.
    """
    statistics = orientation.points()
    used = statistics.used
    c = orientation.adjustment.correspondences
    places = c.left * c.principal_distances[0]
    rms = float(np.sqrt(np.mean(statistics.y_parallax[used] ** 2)))
    unit = max(3.0 * rms, 1e-9)
    across = _across(orientation.pose.base) * np.array([1.0, -1.0])
    extent = np.maximum(np.ptp(places, axis=0), 1e-9)
    length = 0.07 * float(extent.max()) / unit
    with figure_style():
        ratio = float(np.clip(extent[1] / extent[0], 0.3, 1.4))
        figure = Figure(figsize=(5.2, 5.2 * ratio + 1.1), layout="constrained")
        axes = figure.subplots()
        for rows, colour in ((~used, _LEFT_OUT), (used, PERPENDICULAR)):
            size = np.clip(statistics.y_parallax[rows], -2.0 * unit, 2.0 * unit) * length
            axes.plot(*places[rows].T, ".", color=colour, markersize=4.0)
            axes.quiver(
                *places[rows].T,
                *(size[:, None] * across).T,
                angles="xy",
                scale_units="xy",
                scale=1.0,
                color=colour,
                width=0.003,
            )
        if len(names) <= _MOST_NAMES:
            for name, place in zip(names, places, strict=True):
                axes.annotate(name, place, (4, 3), textcoords="offset points", fontsize=7, color=RAY)
        axes.plot(0.0, 0.0, "+", color=INK, markersize=8)
        axes.set_aspect("equal")
        axes.margins(0.12)
        axes.set_xlabel(f"x in the left photograph ({c.unit})")
        axes.set_ylabel(f"y ({c.unit})")
        out = int((~used).sum())
        title = title if determined else f"{title} (NOT ORIENTED)"
        figure.suptitle(
            f"{title}\ny-parallaxes of {int(used.sum())} points, "
            f"{rms:.4f} {c.unit} rms; {out} left out (red)",
            fontsize=8.5,
        )
        _scale_arrow(axes, 0.07 * float(extent.max()), f"{unit:.4f} {c.unit}")
    return figure


def _scale_arrow(axes: Any, length: float, text: str) -> None:
    """The length of a y-parallax, in the lower left corner of the plot."""
    x, y = axes.get_xlim()[0], axes.get_ylim()[0]
    pad = 0.03 * (axes.get_xlim()[1] - x)
    axes.annotate(
        "",
        (x + pad + length, y + pad),
        (x + pad, y + pad),
        arrowprops={"arrowstyle": "-|>", "color": PERPENDICULAR, "shrinkA": 0, "shrinkB": 0},
    )
    axes.text(x + 1.6 * pad + length, y + pad, text, fontsize=7, va="center", color=INK)


def six_point_picture(orientation: RelativeOrientation, title: str) -> Figure:
    """The model in plan along the base, and the mean y-parallax around von Gruber's six points."""
    statistics = orientation.points()
    correspondences = orientation.adjustment.correspondences
    places = model_points(orientation.pose, correspondences)[:, :2]
    used = statistics.used
    zones = six_points(orientation.pose, correspondences, statistics)
    with figure_style():
        low, high = np.percentile(places[used], [0.5, 99.5], axis=0)
        low, high = np.minimum(low, [-0.08, -0.1]), np.maximum(high, [1.08, 0.1])
        size = high - low
        # Room for the labels on both sides of the model, whatever its shape.
        tall = min(6.0, 4.2 * size[1] / size[0])
        wide = tall * size[0] / size[1] + 3.0
        # The centres are named on the side of the base where points 1 and 2 are not (text stands above).
        above = zones[0].place[1] * tall * 72.0 / size[1] < -12.0
        figure = Figure(figsize=(wide, tall + 1.1), layout="constrained")
        axes = figure.subplots()
        dot = 1.8 if np.count_nonzero(used) > _MOST_NAMES else 5.0
        axes.plot(*places[used].T, ".", color="#b9c6d6", markersize=dot, zorder=1)
        axes.plot([0.0, 1.0], [0.0, 0.0], color=INK, linewidth=0.8, zorder=2)
        for x, label in ((0.0, "left centre"), (1.0, "right centre")):
            axes.plot(x, 0.0, "+", color=INK, markersize=9, zorder=3)
            axes.annotate(
                label,
                (x, 0.0),
                (0, 7 if above else -13),
                textcoords="offset points",
                ha="center",
                fontsize=6.5,
                color=RAY,
            )
        for point in zones:
            _six_point(axes, point, 3 if correspondences.unit == "px" else 4)
        pad = np.array([1.3 * size[0] / (tall * size[0] / size[1]), 0.06 * size[1]])
        axes.set_xlim(low[0] - pad[0], high[0] + pad[0])
        axes.set_ylim(low[1] - pad[1], high[1] + pad[1])
        axes.set_aspect("equal")
        axes.set_xlabel("along the base (bases)")
        axes.set_ylabel("across (bases)")
        figure.suptitle(
            f"{title}\nmean y-parallax ({correspondences.unit}) around the six orientation points",
            fontsize=8.5,
        )
    return figure


def _six_point(axes: Any, point: OrientationPoint, digits: int) -> None:
    x, y = point.place
    axes.plot(x, y, "o", color="white", markeredgecolor=PERPENDICULAR, markersize=13, zorder=4)
    axes.annotate(
        str(point.number), (x, y), ha="center", va="center", fontsize=8, color=PERPENDICULAR, zorder=5
    )
    if point.points == 0:
        text = "no points"
    elif math.isnan(point.standard_deviation):
        text = f"{point.y_parallax:+.{digits}f}\n1 point"
    else:
        text = (
            f"{point.y_parallax:+.{digits}f} ± {point.standard_deviation:.{digits}f}\n{point.points} points"
        )
    # Outwards: odd numbers stand at the left end of the overlap.
    outwards = -1 if point.number % 2 else 1
    axes.annotate(
        text,
        (x, y),
        (11 * outwards, 0 if point.number > 2 else 3),
        textcoords="offset points",
        ha="left" if outwards > 0 else "right",
        va="center" if point.number > 2 else "bottom",
        fontsize=7,
        color=INK,
        zorder=5,
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.8},
    )


def _arrow_key(axes: Any, shape: tuple[int, ...], unit: float) -> None:
    """An arrow of one unit below the picture, with its size in pixels."""
    length = 0.05 * max(shape)
    y = shape[0] * 1.03
    axes.annotate(
        "",
        (length, y),
        (0.0, y),
        arrowprops={
            "arrowstyle": "-|>",
            "color": PERPENDICULAR,
            "linewidth": 0.9,
            "shrinkA": 0,
            "shrinkB": 0,
        },
        annotation_clip=False,
    )
    axes.text(length * 1.2, y, f"y-parallax {unit:.2f} px", fontsize=7.5, va="center", color=INK)
    axes.set_ylim(shape[0] * 1.05, 0)


def _used(result: AutomaticOrientation) -> NDArray[np.bool_]:
    return _orientation(result).used


def _orientation(result: AutomaticOrientation) -> RelativeOrientation:
    if result.orientation is None:
        raise InputError("must have points to draw", field="result", value=result.reasons)
    return result.orientation


def _across(base: Array) -> Array:
    """Direction across the base in the picture (column, row), up for a base along the columns."""
    direction = np.array([-base[1], -base[0]])
    length = float(np.hypot(*direction))
    return direction / length if length > 1e-9 else np.array([0.0, -1.0])


def _bright(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    low, high = np.percentile(image[::4, ::4], [1.0, 99.0])
    stretched = (image.astype(np.float64) - low) * (235.0 / max(high - low, 1.0)) + 15.0
    return np.asarray(np.clip(stretched, 0, 255), dtype=np.uint8)


def _order(values: Array) -> Array:
    """Ranks 0 to 1: colours that use the whole map whatever the distribution."""
    ranks = np.empty(len(values))
    ranks[np.argsort(values, kind="stable")] = np.linspace(0.0, 1.0, len(values)) if len(values) else []
    return ranks


def _match_title(result: AutomaticOrientation, used: NDArray[np.bool_]) -> str:
    text = f"{int(used.sum())} points, coloured by their parallax; {int((~used).sum())} left out (red)"
    if result.determined:
        return text
    return f"{textwrap.fill(f'NOT ORIENTED: {result.reasons[0]}', 95)}\n{text}"
