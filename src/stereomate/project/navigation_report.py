"""What a report says of strips, lever arms and boresights, from the record alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from stereomate.project.adjustment_report import number_text
from stereomate.report.page import Section, Table


def navigation_sections(record: Mapping[str, Any]) -> list[Section]:
    """Unknowns of navigation and the tests of shifts of strips; nothing where there is neither."""
    navigation = record.get("navigation")
    if not navigation or not (navigation["unknowns"] or navigation["shift_tests"]):
        return []
    tables = []
    if navigation["unknowns"]:
        tables.append(_unknowns(navigation["unknowns"]))
    if navigation["shift_tests"]:
        tables.append(_tests(navigation))
    return [Section("Navigation", tables=tuple(tables))]


def _unknowns(entries: list[dict[str, Any]]) -> Table:
    rows = []
    for entry in entries:
        deviations = entry["standard_deviation"] or [None] * 3
        form = "{:+.6f}" if entry["unit"] == "rad" else "{:+.3f}"
        others = sorted({other["other"] for other in entry["not_separable_from"]})
        rows.append(
            (
                f"{entry['what']}, {entry['unit']}",
                *(
                    f"{number_text(v, form)} ± {number_text(s, form.replace('+', ''))}"
                    for v, s in zip(entry["value"], deviations, strict=True)
                ),
                {True: "significant", False: "not significant", None: "-"}[entry["significant"]],
                ", ".join(others) or "-",
            )
        )
    headings = ("unknown", "x", "y", "z", "against zero", "correlated over 95 % with")
    words = "Shifts and drifts along the tangent axes (east, north, up), the others in camera axes."
    return Table(headings, tuple(rows), words)


def _tests(navigation: Mapping[str, Any]) -> Table:
    members = {entry["name"]: entry["photographs"] for entry in navigation["strips"]}
    rows = []
    for test in navigation["shift_tests"]:
        name = "all positions"
        if test["kind"] == "strip":
            photos = members[test["strip"]]
            name = f"{test['strip']}: {photos[0]} to {photos[-1]}"
        elif test["kind"] == "mount":
            name = f"all of {test['strip']}, along the camera's axes x, y, z"
        word = "significant" if test["significant"] else "no"
        if test["statistic"] is None:
            word = "cannot show"
        if test["not_told_from"]:
            word += f", or strip {', '.join(test['not_told_from'])}"
        rows.append(
            (
                name,
                str(test["positions"]),
                *(
                    f"{number_text(v, '{:+.3f}')} ± {number_text(s, '{:.3f}')}"
                    for v, s in zip(test["shift_m"], test["standard_deviation_m"], strict=True)
                ),
                f"{number_text(test['statistic'], '{:.1f}')} ({number_text(test['limit'], '{:.1f}')})",
                word,
                *("any" if v is None else f"{v:.2f}" for v in test["detectable_m"]),
            )
        )
    headings = (
        "strip", "positions", "shift east, m", "north", "up", "test (limit)", "shifted?",
        "least that is seen, east, m", "north", "up",
    )  # fmt: skip
    words = (
        "A shift of all positions of a strip as an alternative hypothesis, tested by all their residuals. "
        "The last columns: the smallest shift that this block would have shown with the power of the tests; "
        "'any': none shows, however large."
    )
    return Table(headings, tuple(rows), words)
