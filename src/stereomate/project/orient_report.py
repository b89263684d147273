"""The report of an orientation: one self-contained page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from stereomate import __version__
from stereomate.project.orient import OrientResult
from stereomate.report.orient_figures import block_figure, residual_figure
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
        *_control(record),
        _photographs(record),
        *_left_out(record),
        _gross(record),
        _pairs(record),
        Section("What was given", items=tuple(record["notes"])),
    ]
    return ReportContent(
        title=str(record["project"]),
        subtitle="Orientation of the photographs",
        facts=_facts(record),
        sections=sections,
        footer=f"stereomate {__version__} · key {record['key'][:16]}",
        meta={"software": f"stereomate {__version__}"},
    )


def _facts(record: dict[str, Any]) -> list[tuple[str, str]]:
    summary, frame = record["summary"], record["frame"]
    rms = summary["image_rms_px"]
    test = summary["global_test"]
    facts = [
        ("Photographs", f"{summary['oriented']} of {summary['photographs']} oriented"),
        ("Datum", frame["datum"] if "crs" not in frame else f"{frame['datum']}, {frame['crs'][:60]}"),
        ("Heights", frame.get("heights", "arbitrary")),
        ("Tie points", f"{summary['tie_points']} in {summary['image_points']} image points"),
        ("Image residuals, rms", f"{rms['columns']:.2f} px in columns, {rms['rows']:.2f} px in rows"),
        ("σ0", f"{summary['sigma0']:.3f}, redundancy {summary['redundancy']}"),
    ]
    if test is not None:
        facts.append(("Global test", "passed" if test["passed"] else "σ0 differs from 1 significantly"))
    positions = record["positions"]
    if positions is not None:
        x, y, z = positions["rms_m"]
        facts.append(("Residuals of positions, rms", f"{x:.2f}, {y:.2f}, {z:.2f} m (east, north, up)"))
    return facts


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
    rows = [
        (
            camera["name"],
            name,
            _text(value["value"], "{:.6g}"),
            _text(value["standard_deviation"], "{:.2g}") if value["found"] else "held",
            _text(value["prior"], "{:.2g}"),
        )
        for camera in result.record["cameras"]
        for name, value in camera["parameters"].items()
        if value["found"] or value["value"] != 0.0
    ]
    headings = ("camera", "parameter", "value", "standard deviation", "standard deviation before")
    network, used = adjusted.result.network, adjusted.result.used
    pictures = []
    for k, camera in enumerate(adjusted.result.cameras):
        mine = used & (network.photographs.camera[network.image.photo] == k)
        if np.count_nonzero(mine) < 50:
            continue
        figure = residual_figure(network.image.xy[mine], adjusted.result.residuals[mine], camera.size_px)
        caption = f"{camera.name}: what its calibration leaves of the image residuals."
        pictures.append(Picture(svg_uri(figure), caption, "image residuals over the format"))
    return Section("Cameras", tables=(Table(headings, tuple(rows)),), pictures=tuple(pictures))


def _control(record: dict[str, Any]) -> list[Section]:
    tables = []
    for kind, values in (record["control"] or {}).items():
        if not values["count"]:
            continue
        rows = [
            (
                point["name"],
                *(_text(v, "{:+.3f}") for v in point["residual_m"]),
                *(_text(v, "{:.3f}") for v in point["sigma_m"]),
                str(point["rays"]),
            )
            for point in values["points"]
        ]
        rows.append(("rms", *(_text(v, "{:.3f}") for v in values["rms_m"]), "", "", "", ""))
        headings = ("point", "dx m", "dy m", "dz m", "σx m", "σy m", "σz m", "rays")
        words = "Given minus adjusted, in the tangent frame."
        if kind == "check":
            words += " Check points took no part in the adjustment."
        tables.append(Table(headings, tuple(rows), f"{kind.capitalize()} points. {words}"))
    return [Section("Control and check points", tables=tuple(tables))] if tables else []


def _photographs(record: dict[str, Any]) -> Section:
    rows = []
    for photo in record["photographs"]:
        position, angles = photo["position"], photo["omega_phi_kappa_deg"]
        rows.append(
            (
                photo["name"],
                *(f"{v:.3f}" for v in position),
                *(f"{v:.4f}" for v in angles),
                *(_text(v, "{:.3f}") for v in photo["standard_deviation_m"]),
                *(_text(v, "{:.4f}") for v in photo["standard_deviation_deg"]),
                str(photo["image_points"]),
            )
        )
    headings = (
        "photograph", "x", "y", "z", "ω°", "φ°", "κ°", "σx m", "σy m", "σz m",
        "σ° x", "σ° y", "σ° z", "points",
    )  # fmt: skip
    caption = record["frame"].get("angles", "") + "; standard deviations along and about the tangent axes."
    return Section("Photographs", tables=(Table(headings, tuple(rows), caption),))


def _left_out(record: dict[str, Any]) -> list[Section]:
    left = record["not_oriented"]
    if not left:
        return []
    rows = tuple((entry["name"], entry["reason"]) for entry in left)
    return [Section("Not oriented", tables=(Table(("photograph", "reason"), rows),))]


def _gross(record: dict[str, Any]) -> Section:
    errors = record["gross_errors"]
    rows = tuple(
        (
            error["kind"],
            error["place"],
            ", ".join(_text(v, "{:.2f}") for v in error["size"]),
            _text(error["standardized"], "{:.1f}"),
        )
        for error in errors[:20]
    )
    caption = f"The {len(rows)} largest of {len(errors)}; all are in image_points.parquet." if rows else ""
    headings = ("kind", "where", "size (px, m or rad)", "standardized")
    tables = (Table(headings, rows, caption),) if rows else ()
    return Section("Gross errors taken out", ("None were found.",) if not rows else (), tables)


def _pairs(record: dict[str, Any]) -> Section:
    pairs = record["y_parallaxes"]
    values = [pair["rms_px"] for pair in pairs if pair["rms_px"] is not None]
    words = "No pair shares tie points."
    if values:
        words = (
            f"y-parallaxes that the orientation leaves, over {len(values)} pairs: median "
            f"{np.median(values):.2f} px rms, largest {max(values):.2f} px."
        )
    worst = sorted(pairs, key=lambda p: -(p["rms_px"] or 0.0))[:15]
    rows = tuple((p["left"], p["right"], str(p["points"]), _text(p["rms_px"], "{:.2f}")) for p in worst)
    table = Table(("left", "right", "points", "rms px"), rows, "The largest; all are in adjustment.json.")
    return Section("Pairs", (words,), (table,) if rows else ())


def _text(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)
