"""A relative orientation for the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from stereomate.cli.output import console, table

if TYPE_CHECKING:
    from stereomate.relative.orientation import RelativeOrientation
    from stereomate.relative.pair import RelativePose

_MOST_POINTS = 40


def print_counts(title: str, counts: dict[str, int], notes: Sequence[str]) -> None:
    """How many points there were after each step, and what is to be known besides."""
    out = console()
    out.print(table(title, ("step", "number"), [(name, str(count)) for name, count in counts.items()]))
    for note in notes:
        out.print(note, highlight=False)


def print_orientation(orientation: RelativeOrientation, given: RelativePose | None = None) -> None:
    """Elements with standard deviations, noise, geometry; against a given orientation, if there is one."""
    from stereomate.relative.summary import available_elements, element_rows

    out = console()
    for kind, elements in available_elements(orientation).items():
        rows = [
            (*row, f"{elements.correlations[i][j]:+.2f} with {elements.names[j]}")
            for i, (row, j) in enumerate(
                zip(element_rows(elements), _most_correlated(elements.correlations), strict=True)
            )
        ]
        heads = ("element", "value", "standard deviation", "largest correlation")
        out.print(table(f"{kind} pair", heads, rows))
    unit = orientation.adjustment.correspondences.unit
    digits = 3 if unit == "px" else 4
    used, all_points = (
        f"{v:.{digits}f} {unit}" for v in (orientation.sampson_rms, orientation.sampson_robust)
    )
    out.print(
        f"Sampson distances {used} rms of the points used, {all_points} by the median of all points; "
        f"sigma0 {orientation.sigma0:.2f}, redundancy {orientation.adjustment.redundancy}",
        highlight=False,
    )
    diagnosis = orientation.diagnosis
    if diagnosis is not None:
        out.print(
            f"geometry: worst direction {diagnosis.largest_standard_deviation_deg:.4f}°; off the critical "
            f"cylinder by {100.0 * diagnosis.critical_cylinder.distance:.1f} % of the depth, "
            f"off a plane by {100.0 * diagnosis.flatness:.1f} %",
            highlight=False,
        )
    if given is not None:
        turn, tilt = orientation.pose.angles_to(given)
        out.print(
            f"against the orientation of the project: rotation {math.degrees(turn):.4f}°, "
            f"base {math.degrees(tilt):.4f}°",
            highlight=False,
        )


def print_points(orientation: RelativeOrientation, names: Sequence[str]) -> None:
    """Every point's y-parallax, redundancy number, test value and minimal detectable error."""
    statistics = orientation.points()
    unit = orientation.adjustment.correspondences.unit
    rows = []
    for row, name in list(enumerate(names))[:_MOST_POINTS]:
        used = bool(statistics.used[row])
        rows.append(
            (
                name,
                f"{statistics.y_parallax[row]:+.4f}",
                f"{statistics.redundancy[row]:.3f}" if used else "left out",
                f"{statistics.standardized[row]:+.2f}",
                f"{statistics.minimal_detectable[row]:.4f}" if used else "",
            )
        )
    heads = (
        "point",
        f"y-parallax ({unit})",
        "redundancy number",
        "standardized residual",
        f"minimal detectable ({unit})",
    )
    console().print(table("points", heads, rows, rest=len(names) - _MOST_POINTS))


def _most_correlated(correlations: Any) -> list[int]:
    import numpy as np

    others = np.abs(correlations - np.diag(np.diag(correlations)))
    return [int(j) for j in np.argmax(others, axis=1)]
