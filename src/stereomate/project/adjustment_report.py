"""What a report says of a block adjustment, from its record alone: statistics, residuals, gross errors.

The page of `stereomate orient` and the report of a run that stands on the orientation say the same.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import FormatError
from stereomate.forms import ORIENTATION
from stereomate.project.check_points import CheckPoints
from stereomate.project.model import Project
from stereomate.report.orient_figures import (
    adjusted_block_figure,
    centre_sigma_figure,
    standardized_figure,
)
from stereomate.report.page import Picture, Section, Table
from stereomate.report.run_figures import svg_uri

Array = NDArray[np.float64]

_ADJUSTMENT = "adjustment.json"
# The orientation that a run reads is the adjusted one as far as a table writes it.
_SAME_M = 0.02
_MDE = "MDE: minimal detectable error of the observation, by the power of the tests; -: not controlled."


def adjustment_of(project: Project) -> dict[str, Any] | None:
    """The record of the adjustment that made the orientation of a project, from beside it; None without one.

    An adjustment of other positions than those the project uses is passed over.

    Raises
    ------
    FormatError
        If the record was written by a newer stereomate.
    """
    source = next((item.path for item in project.inputs if item.role == "orientation"), None)
    path = None if source is None else source.parent / _ADJUSTMENT
    if path is None or not path.is_file():
        return None
    try:
        document = json.loads(path.read_bytes())
    except ValueError as error:
        raise FormatError(f"is not JSON ({error})", file=path) from error
    record = ORIENTATION.migrated(document, path)
    adjusted = {Path(photo["name"]).stem: photo["position"] for photo in record["photographs"]}
    centres = project.survey.centres_map * [1.0, 1.0, 1.0]
    for photograph, centre in zip(project.survey.photographs, centres, strict=True):
        position = adjusted.get(Path(photograph.name).stem)
        if position is None or None in position:
            return None
        away = np.hypot(*(np.array(position[:2]) - centre[:2])) * project.frame.unit_m
        if not away < _SAME_M:
            return None
    return record


def adjusted_check_points(record: Mapping[str, Any]) -> CheckPoints | None:
    """The check points of an adjustment, which took no part in it; None where it has none."""
    found = ((record["control"] or {}).get("check") or {}).get("points", [])
    # What contradicts the block is named beside the others, not counted with them.
    points = [point for point in found if not point.get("apart")]
    if not found:
        return None

    def values(key: str) -> Array:
        rows = [point.get(key) or [None] * 3 for point in points]
        return np.array([[math.nan if v is None else v for v in row] for row in rows], np.float64).reshape(
            -1, 3
        )

    rms = record["summary"]["image_rms_px"]
    known = [v for v in rms.values() if v is not None]
    return CheckPoints(
        names=tuple(point["name"] for point in points),
        map_xy=values("given")[:, :2],
        # the record has given minus adjusted
        differences_m=-values("residual_m"),
        sigma_m=values("sigma_m"),
        measured_sigma_m=values("standard_deviation_m"),
        rays=np.array([point["rays"] for point in points]),
        image_rms_px=float(np.sqrt(np.mean(np.square(known)))) if known else math.nan,
        left_out=tuple(point["name"] for point in found if point.get("apart")),
        independent=True,
    )


def adjustment_section(record: Mapping[str, Any]) -> Section:
    """The orientation and its statistics as one part of the report of a run."""
    facts = Table(("adjustment", "result"), tuple(orientation_facts(record)))
    tables = [facts, cameras_table(record)]
    for part in (
        *control_sections(record),
        *left_out_sections(record),
        gross_section(record),
        pairs_section(record),
    ):
        tables += part.tables
    gross = gross_section(record)
    paragraphs = (
        f"From the block adjustment of adjustment.json, key {record['key'][:16]}.",
        *(f"Gross errors: {text}" for text in gross.paragraphs),
        *pairs_section(record).paragraphs,
    )
    return Section(
        "Orientation",
        paragraphs,
        tuple(tables),
        block_pictures(record),
        tuple(record["findings"]),
    )


def block_pictures(record: Mapping[str, Any], ties: Array | None = None) -> tuple[Picture, ...]:
    """Plan of the block with residuals, and standard deviations of its centres.

    `ties`: map coordinates (k, 3) of tie points to show as dots.
    """
    photographs = record["photographs"]
    names = [photo["name"] for photo in photographs]
    centres = _array(photo["position"] for photo in photographs)
    sigma = _array(photo["standard_deviation_m"] for photo in photographs)
    residuals = np.full((len(names), 3), math.nan)
    place = {Path(name).stem: k for k, name in enumerate(names)}
    for entry in (record["positions"] or {}).get("residuals", []):
        if (k := place.get(Path(entry["name"]).stem)) is not None:
            residuals[k] = _array([entry["residual_m"]])[0]
    points = {
        kind: (
            _array(point.get("given") for point in values["points"]),
            _array(point["residual_m"] for point in values["points"]),
        )
        for kind, values in (record["control"] or {}).items()
        if values["points"]
    }
    plan = adjusted_block_figure(centres, residuals, points, names, ties)
    caption = (
        "Projection centres with the residuals of their observed positions, control points (triangles) and "
        "check points (squares) with theirs: given minus adjusted; arrows in plan, bars in height."
        + ("" if ties is None else " Dots are tie points.")
    )
    pictures = [Picture(svg_uri(plan), caption, "Plan of the adjusted block", _residual_table(record))]
    if np.isfinite(sigma).any():
        _, table = photographs_section(record).tables
        words = "Standard deviations of the projection centres along the tangent axes."
        figure = svg_uri(centre_sigma_figure(names, sigma))
        pictures.append(Picture(figure, words, "Standard deviations of the centres", table))
    return tuple(pictures)


def _residual_table(record: Mapping[str, Any]) -> Table:
    entries = [
        (f"position of {entry['name']}", entry) for entry in (record["positions"] or {}).get("residuals", [])
    ]
    for kind, values in (record["control"] or {}).items():
        entries += [(f"{kind} point {point['name']}", point) for point in values["points"]]
    rows = tuple(
        (name, *(number_text(v, "{:+.3f}") for v in entry["residual_m"]), *_detectable(entry))
        for name, entry in entries
    )
    headings = ("given minus adjusted, m", "east", "north", "up", "MDE east, m", "MDE north", "MDE up")
    return Table(headings, rows, _MDE)


def _detectable(entry: Mapping[str, Any]) -> tuple[str, ...]:
    """Minimal detectable errors; records of earlier versions have none."""
    return tuple(number_text(v, "{:.3f}") for v in entry.get("detectable_m") or [None] * 3)


def _array(rows: Any) -> Array:
    found = [[math.nan if v is None else v for v in row or [None] * 3] for row in rows]
    return np.array(found, np.float64).reshape(-1, 3)


def _image_text(rms: dict[str, float | None]) -> str:
    columns, rows = (number_text(rms[key], "{:.2f}") for key in ("columns", "rows"))
    return f"{columns} px in columns, {rows} px in rows"


def cameras_table(record: Mapping[str, Any]) -> Table:
    """Parameters of the cameras, found and held."""
    rows = [
        (
            camera["name"],
            name,
            number_text(value["value"], "{:.6g}"),
            number_text(value["standard_deviation"], "{:.2g}") if value["found"] else "held",
            number_text(value["prior"], "{:.2g}"),
            # Adjustments of earlier versions were not tested.
            number_text(value.get("t"), "{:.1f}") + (" (no)" if value.get("significant") is False else ""),
        )
        for camera in record["cameras"]
        for name, value in camera["parameters"].items()
        if value["found"] or value["value"] != 0.0 or name.startswith("principal")
    ]
    headings = (
        "camera", "parameter", "value", "standard deviation", "standard deviation before", "t of its change",
    )  # fmt: skip
    words = "t: what the observations say of the change over its standard deviation; (no): not significant."
    return Table(headings, tuple(rows), words)


def orientation_facts(record: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What an adjustment comes to, in a few lines."""
    summary, frame = record["summary"], record["frame"]
    rms = summary["image_rms_px"]
    test = summary["global_test"]
    facts = [
        ("Photographs", f"{summary['oriented']} of {summary['photographs']} oriented"),
        ("Datum", frame["datum"] if "crs" not in frame else f"{frame['datum']}, {frame['crs'][:60]}"),
        ("Heights", frame.get("heights", "arbitrary")),
        ("Tie points", f"{summary['tie_points']} in {summary['image_points']} image points"),
        ("Image residuals, rms", _image_text(rms)),
        ("σ0", f"{number_text(summary['sigma0'], '{:.3f}')}, redundancy {summary['redundancy']}"),
    ]
    if test is not None:
        better = test["statistic"] < test["lower"]
        word = (
            "passed"
            if test["passed"]
            else f"failed, observations {'better' if better else 'worse'} than stated"
        )
        facts.append(
            ("Global test", f"{word}: {test['statistic']:.0f} in {test['lower']:.0f} to {test['upper']:.0f}")
        )
    positions = record["positions"]
    if positions is not None:
        values = ", ".join(number_text(v, "{:.2f}") for v in positions["rms_m"])
        facts.append(("Residuals of positions, rms", f"{values} m (east, north, up)"))
    for kind, entry in (record["control"] or {}).items():
        if entry["count"]:
            values = ", ".join(number_text(v, "{:.3f}") for v in entry["rms_m"])
            facts.append((f"{entry['count']} {kind} points, rms", f"{values} m (east, north, up)"))
    for judged in record.get("accuracy", []):
        verdict = {True: "met", False: "NOT met", None: "not known: no check points"}[judged["met"]]
        found = number_text(judged["found_m"], "{:.3f} m")
        facts.append((f"Asked: {judged['what']} {judged['asked_m']:g} m", f"{found}, {verdict}"))
    gross, observations = summary["gross_errors"], summary["observations"]
    facts.append(("Gross errors taken out", f"{gross} of {observations + gross} observations"))
    return facts


def groups_section(record: Mapping[str, Any]) -> list[Section]:
    """How well each kind of observations is controlled, and their standardized residuals."""
    groups = record.get("observations") or []
    if not groups:
        return []
    rows = tuple(
        (
            group["kind"],
            str(group["observations"]),
            f"{number_text(group['residual_rms'], '{:.3g}')} {group['unit']}",
            number_text(group["redundancy_mean"], "{:.2f}"),
            number_text(group["redundancy_least"], "{:.2f}"),
            number_text(group["largest_standardized"], "{:.1f}"),
            f"{number_text(group['detectable_median'], '{:.3g}')} {group['unit']}",
            str(group["gross_errors"]),
        )
        for group in groups
    )
    headings = (
        "observations", "number", "residuals, rms", "redundancy number, mean", "least",
        "largest standardized residual", "minimal detectable error, median", "gross errors taken out",
    )  # fmt: skip
    image = next((group for group in groups if group["kind"] == "image"), None)
    pictures: tuple[Picture, ...] = ()
    if image is not None:
        figure = standardized_figure(image["standardized_histogram"])
        words = "Standardized residuals of the image points that took part, and the normal distribution."
        pictures = (Picture(svg_uri(figure), words, "Histogram of standardized residuals"),)
    return [Section("Observations", tables=(Table(headings, rows),), pictures=pictures)]


def control_sections(record: Mapping[str, Any]) -> list[Section]:
    """Residuals of control and check points, where there are any."""
    tables = []
    for kind, values in (record["control"] or {}).items():
        if not values["points"]:
            continue
        rows = [
            (
                point["name"] + (" *" if point.get("apart") else ""),
                *(number_text(v, "{:+.3f}") for v in point["residual_m"]),
                *(number_text(v, "{:.3f}") for v in point["sigma_m"]),
                *(_detectable(point) if kind == "control" else ()),
                str(point["rays"]),
            )
            for point in values["points"]
        ]
        sizes = ("MDE x m", "MDE y m", "MDE z m") if kind == "control" else ()
        headings = ("point", "dx m", "dy m", "dz m", "σx m", "σy m", "σz m", *sizes, "rays")
        rms = [number_text(v, "{:.3f}") for v in values["rms_m"]]
        rows.append(("rms", *rms, *[""] * (len(headings) - 4)))
        words = "Given minus adjusted, in the tangent frame."
        if kind == "control":
            words += f" {_MDE}"
        if kind == "check":
            words += " Check points took no part in the adjustment."
        if values.get("apart"):
            words += " *: contradicts the others, not counted in the rms."
        tables.append(Table(headings, tuple(rows), f"{kind.capitalize()} points. {words}"))
    return [Section("Control and check points", tables=tuple(tables))] if tables else []


def photographs_section(record: Mapping[str, Any]) -> Section:
    """Adjusted photographs, and how accurate they are."""
    oriented, accuracy = [], []
    for photo in record["photographs"]:
        oriented.append(
            (
                photo["name"],
                *(f"{v:.3f}" for v in photo["position"]),
                *(f"{v:.4f}" for v in photo["omega_phi_kappa_deg"]),
                str(photo["image_points"]),
                number_text(photo.get("image_rms_px"), "{:.2f}"),
            )
        )
        accuracy.append(
            (
                photo["name"],
                *(number_text(v, "{:.3f}") for v in photo["standard_deviation_m"]),
                *(number_text(v, "{:.4f}") for v in photo["standard_deviation_deg"]),
            )
        )
    headings = ("photograph", "x", "y", "z", "ω°", "φ°", "κ°", "image points", "rms px")
    caption = record["frame"].get("angles", record["frame"].get("axes", "")) + "."
    sigmas = ("photograph", "σx m", "σy m", "σz m", "σ° about x", "about y", "about z")
    words = "Standard deviations along and about the axes of the tangent frame."
    tables = (Table(headings, tuple(oriented), caption), Table(sigmas, tuple(accuracy), words))
    return Section("Photographs", tables=tables)


def left_out_sections(record: Mapping[str, Any]) -> list[Section]:
    """Photographs that could not be oriented, and why."""
    left = record["not_oriented"]
    if not left:
        return []
    rows = tuple((entry["name"], entry["reason"]) for entry in left)
    return [Section("Not oriented", tables=(Table(("photograph", "reason"), rows),))]


def gross_section(record: Mapping[str, Any]) -> Section:
    """Gross errors that were taken out."""
    errors = record["gross_errors"]
    rows = tuple(
        (
            error["kind"],
            error["place"],
            ", ".join(number_text(v, "{:.2f}") for v in error["size"]),
            number_text(error["standardized"], "{:.1f}"),
        )
        for error in errors[:20]
    )
    caption = (
        f"Gross errors taken out: the {len(rows)} largest of {len(errors)}, all are in image_points.parquet."
        if rows
        else ""
    )
    headings = ("kind", "where", "size (px, m or rad)", "standardized")
    tables = (Table(headings, rows, caption),) if rows else ()
    return Section("Gross errors taken out", ("None were found.",) if not rows else (), tables)


def pairs_section(record: Mapping[str, Any]) -> Section:
    """y-parallaxes that remain between photographs."""
    pairs = record["y_parallaxes"]
    values = [pair["rms_px"] for pair in pairs if pair["rms_px"] is not None]
    words = "No pair shares tie points."
    if values:
        words = (
            f"y-parallaxes that the orientation leaves, over {len(values)} pairs: median "
            f"{np.median(values):.2f} px rms, largest {max(values):.2f} px."
        )
    worst = sorted(pairs, key=lambda p: -(p["rms_px"] or 0.0))[:15]
    rows = tuple((p["left"], p["right"], str(p["points"]), number_text(p["rms_px"], "{:.2f}")) for p in worst)
    table = Table(
        ("left", "right", "points", "rms px"),
        rows,
        "y-parallaxes that remain: the largest, all are in adjustment.json.",
    )
    return Section("Pairs", (words,), (table,) if rows else ())


def number_text(value: float | None, form: str) -> str:
    """A number in a form, a dash for none."""
    return "-" if value is None else form.format(value)
