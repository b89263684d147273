"""The report of an orientation: one self-contained page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from stereomate import __version__
from stereomate.frames.transform import map_from_tangent
from stereomate.project.adjustment_report import (
    block_pictures,
    cameras_table,
    control_sections,
    gross_section,
    groups_section,
    left_out_sections,
    orientation_facts,
    pairs_section,
    photographs_section,
)
from stereomate.project.compare_report import comparison_sections
from stereomate.project.navigation_report import navigation_sections
from stereomate.project.orient import OrientResult
from stereomate.report.orient_figures import residual_figure
from stereomate.report.page import Picture, ReportContent, Section, Table, write_report
from stereomate.report.run_figures import svg_uri

REPORT = "orient.html"


def write_orient_report(result: OrientResult) -> Path:
    """Write the page into the folder of the results; it tells no time, so that a run repeated is the same."""
    path = result.out / REPORT
    write_report(path, orient_content(result))
    return path


def orient_content(result: OrientResult) -> ReportContent:
    """Everything the report shows."""
    record = result.record
    sections = [
        Section("What to know first", items=tuple(record["findings"]) or ("Nothing out of the ordinary.",)),
        _block(result),
        _cameras(result),
        *control_sections(record),
        *navigation_sections(record),
        photographs_section(record),
        *groups_section(record),
        *_expected(record),
        *comparison_sections(record),
        *left_out_sections(record),
        gross_section(record),
        pairs_section(record),
        _correlations(record),
        Section("What was given", items=tuple(record["notes"])),
    ]
    return ReportContent(
        title=str(record["project"]),
        subtitle="Orientation of the photographs",
        facts=orientation_facts(record),
        sections=sections,
        footer=f"stereomate {__version__} · key {record['key'][:16]}",
        meta={"software": f"stereomate {__version__}"},
    )


def _expected(record: dict[str, Any]) -> list[Section]:
    """What was expected before the flight, beside what was found."""
    expected = record.get("expected")
    if expected is None:
        return []
    names = {
        "centres_m": ("projection centres, m", "{:.4f}"),
        "rotations_deg": ("rotations, °", "{:.5f}"),
        "tie_points_m": ("tie points, m", "{:.4f}"),
        "check_points_m": ("check points, m", "{:.4f}"),
    }
    rows = tuple(
        (
            text,
            *(_text(v, form) for v in expected["expected"][name]),
            *(_text(v, form) for v in expected["found"][name]),
            *(_text(v, "{:.2f}") for v in expected["ratio"][name]),
        )
        for name, (text, form) in names.items()
        if any(v is not None for v in expected["expected"][name])
    )
    headings = (
        "median σ", "expected x", "y", "z", "found x", "y", "z", "found / expected x", "y", "z",
    )  # fmt: skip
    assumed = expected["assumed"]
    words = (
        "Expected: the flight as planned, cameras straight down over level ground, "
        f"{assumed['tie_points_per_photograph']} tie points to a photograph of "
        f"{assumed['image_sigma_px']:.2f} px, positions and control points as accurate as stated."
    )
    return [Section("Expected before the flight", (), (Table(headings, rows, words),))]


def _correlations(record: dict[str, Any]) -> Section:
    """Unknowns that the block hardly tells apart."""
    title = "Correlations over 95 %"
    found = sorted(record["correlations"], key=lambda c: -abs(c["value"]))
    if not found:
        return Section(title, ("None.",))
    rows = tuple((c["first"], c["second"], f"{c['value']:+.3f}", str(c["count"])) for c in found[:30])
    caption = f"{len(found)} pairs of unknowns; all are in adjustment.json." if len(found) > 30 else ""
    headings = ("unknown", "unknown", "largest correlation", "photographs")
    return Section(title, (), (Table(headings, rows, caption),))


def _text(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)


def _block(result: OrientResult) -> Section:
    adjusted, inputs = result.adjusted, result.inputs
    assert adjusted is not None  # a report is of a run that was made
    ties = adjusted.result.points[: len(adjusted.assembled.ties)]
    ties = ties[np.isfinite(ties[:, 0])]
    if adjusted.has_datum and inputs.tangent is not None:
        ties = map_from_tangent(inputs.tangent, inputs.frame, ties)
    return Section("The block", pictures=block_pictures(result.record, ties))


def _cameras(result: OrientResult) -> Section:
    adjusted = result.adjusted
    assert adjusted is not None  # a report is of a run that was made
    network, used = adjusted.result.network, adjusted.result.used
    pictures = []
    for k, camera in enumerate(adjusted.result.cameras):
        mine = used & (network.photographs.camera[network.image.photo] == k)
        if np.count_nonzero(mine) < 50:
            continue
        figure = residual_figure(network.image.xy[mine], adjusted.result.residuals[mine], camera.size_px)
        caption = f"{camera.name}: what its calibration leaves of the image residuals."
        pictures.append(Picture(svg_uri(figure), caption, "image residuals over the format"))
    return Section("Cameras", tables=(cameras_table(result.record),), pictures=tuple(pictures))
