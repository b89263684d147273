"""The report of an orientation: one self-contained page."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stereomate import __version__
from stereomate.project.adjustment_report import (
    cameras_table,
    control_sections,
    gross_section,
    left_out_sections,
    orientation_facts,
    pairs_section,
    photographs_section,
)
from stereomate.project.orient import OrientResult
from stereomate.report.orient_figures import block_figure, residual_figure
from stereomate.report.page import Picture, ReportContent, Section, write_report
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
        photographs_section(record),
        *left_out_sections(record),
        gross_section(record),
        pairs_section(record),
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


def _block(result: OrientResult) -> Section:
    adjusted = result.adjusted
    assert adjusted is not None  # a report is of a run that was made
    network = adjusted.result.network
    residuals = np.full((len(network.photographs.names), 3), np.nan)
    statistics = adjusted.result.statistics
    if network.positions is not None and statistics is not None and statistics.positions is not None:
        residuals[network.positions.photo] = statistics.positions.residuals
    figure = block_figure(
        network.photographs.names, adjusted.result.centres, residuals, adjusted.result.points
    )
    caption = "Projection centres, tie points (dots), and residuals of the observed positions (arrows)."
    return Section("The block", pictures=(Picture(svg_uri(figure), caption, "plan of the block"),))


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
