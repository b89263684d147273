"""What a report says of the other ways to see an adjustment, from its record alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from stereomate.project.adjustment_report import number_text
from stereomate.report.page import Section, Table

_HEADINGS = (
    "in the grid with", "principal distance", "mm", "centres, mean east", "north", "height",
    "points, mean east", "north", "height", "points, rms height", "image rms px",
)  # fmt: skip


def comparison_sections(record: Mapping[str, Any]) -> list[Section]:
    """Variance components, the shift of the positions, and the block adjusted in the grid; or nothing."""
    comparison = record.get("comparison")
    if not comparison:
        return []
    paragraphs, tables = [], []
    if comparison["variance_components"]:
        tables.append(_components(comparison["variance_components"]))
    shift = comparison.get("positions_shift")
    if shift is not None:
        east, north, up = (
            f"{number_text(v, '{:+.3f}')} ± {number_text(s, '{:.3f}')} m"
            for v, s in zip(shift["east_north_up_m"], shift["sigma_m"], strict=True)
        )
        words = f"A shift common to all positions against control: east {east}, north {north}, up {up}"
        paragraphs.append(f"{words}; {shift['cause'] or 'not significant'}.")
    rows = comparison.get("in_grid")
    if rows:
        tables.append(_in_grid(rows))
    return [Section("Adjusted in other ways", tuple(paragraphs), tuple(tables))]


def _components(components: list[dict[str, Any]]) -> Table:
    rows = tuple(
        (c["group"], number_text(c["factor"], "{:.2f}"), number_text(c["redundancy"], "{:.1f}"))
        for c in components
    )
    words = "What the residuals of each kind of observations say of its standard deviation as it was stated."
    return Table(("observations", "factor of the standard deviation", "redundancy"), rows, words)


def _in_grid(entries: list[dict[str, Any]]) -> Table:
    rows = []
    for entry in entries:
        first = (entry["method"], entry["principal_distance"])
        if "failed" in entry:
            rows.append((*first, entry["failed"], *("-",) * (len(_HEADINGS) - 3)))
            continue
        numbers = (*entry["centres_mean_m"], *entry["points_mean_m"], entry["points_rms_m"][2])
        rows.append(
            (
                *first,
                number_text(entry["principal_distance_mm"], "{:.4f}"),
                *(number_text(v, "{:+.4f}") for v in numbers[:6]),
                number_text(numbers[6], "{:.4f}"),
                number_text(entry["image_rms_px"], "{:.3f}"),
            )
        )
    words = (
        "The same observations adjusted with the map grid taken as Cartesian, minus the rigorous adjustment, "
        "metres (Ressl 2002): P1 corrects image points for earth curvature, M2 scales heights too, M3 the "
        "principal distance. Nothing of this goes into products."
    )
    return Table(_HEADINGS, tuple(rows), words)
