"""What the report of a run says: from the values of the run to sections, tables and pictures."""

from __future__ import annotations

import math
import resource
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stereomate import __version__
from stereomate.project.accuracy_report import Judgement, accuracy_section, judgements
from stereomate.project.check_points import CheckPoints, check_points
from stereomate.project.grid_effects import GridEffect, effects_section, grid_effects
from stereomate.project.mosaic_report import SEAMS_CAPTION, mosaic_texts
from stereomate.project.orientation_report import strength_section
from stereomate.project.orientation_sections import ProjectSectionOptions, sections_of_coverage
from stereomate.project.run import ProductResult, RunResult
from stereomate.project.run_record import run_record, write_run_record
from stereomate.rectify.job import RectifyJob
from stereomate.rectify.layout import StereoModel
from stereomate.report.page import Picture, ReportContent, Section, Table, write_report
from stereomate.report.run_figures import (
    law_figure,
    layout_figure,
    overlap_figure,
    residual_figure,
    svg_uri,
)
from stereomate.report.seams import seams_figure
from stereomate.report.stereo_pictures import detail_anaglyph, jpeg_uri, product_pictures
from stereomate.stereo.agreement import Agreement, ParallaxStatistics
from stereomate.stereo.model_quality import quality_of_agreement
from stereomate.stereo.product import StereoProduct

NOT_MODELLED = (
    "Atmospheric refraction is not applied to rays unless the camera or the orientation already contains it.",
    "The deflection of the vertical and the slope of the geoid inside a photograph are not modelled.",
    "Objects that are not in the height model (trees, buildings, bridges) lean in the orthophoto.",
    "Their heights read through the parallax law are wrong on slopes: residual parallaxes vary.",
    "Errors of orientation and height model are not separated here: the measured parallaxes hold both.",
    "The standard deviations of the orientation are not known to this run, so none are propagated.",
)


def write_run_report(folder: Path, result: RunResult, started: float) -> list[Path]:
    """Write the report of a run, as a page and for programs.

    Parameters
    ----------
    folder : Path
        Gets ``report.html`` and ``report.json``.
    started : float
        `time.monotonic` at the start of the command.

    Returns
    -------
    list of Path
    """
    found = _findings(result)
    content = run_content(result, found, time.monotonic() - started)
    page, record = folder / "report.html", folder / "report.json"
    write_report(page, content)
    made = {
        "command": " ".join(sys.argv),
        "seconds": time.monotonic() - started,
        "peak_memory_mb": _peak_memory_mb(),
    }
    write_run_record(
        record, run_record(result, found.checked, found.judged, found.effects, made, NOT_MODELLED)
    )
    return [page, record]


@dataclass(frozen=True)
class _Findings:
    """What is computed for the report alone."""

    checked: CheckPoints | None
    judged: tuple[Judgement, ...]
    effects: tuple[GridEffect, ...]


def _findings(result: RunResult) -> _Findings:
    checked = check_points(result.project)
    agreement = result.products[0].agreement
    judged = judgements(result.project, checked, None if agreement is None else agreement.ortho_mate)
    return _Findings(checked, judged, grid_effects(result.project, result.coverage))


def run_content(result: RunResult, found: _Findings, seconds: float) -> ReportContent:
    """Everything the report shows."""
    project = result.project
    sections = [accuracy_section(project, found.checked, found.judged), _layout(result)]
    sections += [_product(result.out, made) for made in result.products]
    sections += [_pairs(result), *_relative_orientation(result)]
    sections += [effects_section(found.effects)] if found.effects else []
    sections += [_given(result), Section("Not modelled", items=NOT_MODELLED)]
    memory = _peak_memory_mb()
    return ReportContent(
        title=project.name or project.path.stem,
        subtitle="Orthophoto and stereomate" if result.products[0].product.job.is_stereo else "Orthophoto",
        facts=[*_facts(result), *((j.requirement, j.text) for j in found.judged)],
        sections=sections,
        footer=(
            f"stereomate {__version__} · {' '.join(sys.argv)} · {seconds:.0f} s · "
            f"peak memory {memory:.0f} MB · key {result.key[:16]}"
        ),
        meta={"software": f"stereomate {__version__}"},
    )


def _facts(result: RunResult) -> list[tuple[str, str]]:
    project, coverage = result.project, result.coverage
    first = result.products[0]
    grid = first.product.job.grid
    facts = [
        ("Map", f"{project.frame.name}"),
        ("Heights", project.frame.heights.description),
        ("Photographs", f"{len(project.survey.photographs)} used, {len(project.problems)} left out"),
        ("GSD of the photographs", f"{coverage.gsd_m:.3g} m"),
        ("Product", f"{grid.size[0]} x {grid.size[1]} pixels of {grid.gsd:g} m"),
    ]
    if first.agreement is not None:
        facts.append(("Orthophoto against orthophoto", _statistics(first.agreement.ortho_ortho)))
        facts.append(("x-parallax minus q(h), y-parallax", _statistics(first.agreement.ortho_mate)))
    return facts


def _statistics(s: ParallaxStatistics) -> str:
    if not s.count:
        return "no matches"
    (mx, my), (nx, ny) = s.median_px, s.nmad_px
    return f"median {mx:+.3f} / {my:+.3f} px, nmad {nx:.3f} / {ny:.3f} px ({s.count} matches)"


def _layout(result: RunResult) -> Section:
    project, coverage = result.project, result.coverage
    jobs = [made.product.job for made in result.products]
    rows = tuple(
        (f.name, f"{f.gsd_m:.3f}", f"{f.height_above_ground_m:.1f}", f"{f.tilt_deg:.2f}", f"{f.covered:.0%}")
        for f in coverage.known
    )
    headings = ("photograph", "GSD, m", "height above ground, m", "tilt, °", "covered by height model")
    layout = svg_uri(layout_figure(project.survey, coverage, project.require_heights(), jobs))
    overlap = svg_uri(overlap_figure(coverage, project.survey, jobs))
    return Section(
        "Block",
        pictures=(
            Picture(
                layout,
                "Projection centres, footprints and bases of the models on the shaded height model; dashed: "
                "outline of the products.",
                "Map of the block",
                Table(headings, rows),
            ),
            Picture(overlap, "Number of photographs that show each place.", "Map of the overlap"),
        ),
    )


def _product(out: Path, made: ProductResult) -> Section:
    job, files = made.product.job, made.product.files
    middle = float(job.law.q(0.5 * sum(job.height_range))) / job.grid.gsd
    pictures = product_pictures(out, files.ortho, files.mate, middle)
    shown = [Picture(jpeg_uri(pictures["ortho"]), f"{files.ortho}: for the left eye.", "Orthophoto")]
    paragraphs = [_grid_text(job)]
    tables = []
    if files.mate is not None:
        shown.append(Picture(jpeg_uri(pictures["mate"]), f"{files.mate}: for the right eye.", "Stereomate"))
        shown.append(
            Picture(
                jpeg_uri(pictures["anaglyph"]),
                "Anaglyph of the whole product, middle heights at the screen: red glass left, cyan right.",
                "Anaglyph of the product",
                wide=True,
            )
        )
        paragraphs.append(_law_text(job))
        shown.append(
            Picture(svg_uri(law_figure(job)), "Parallax laws over the heights of the product.", "Laws")
        )
    if made.mosaic is not None:
        paragraphs += mosaic_texts(made.mosaic, job)
        if job.seams is not None:
            shown.append(Picture(svg_uri(seams_figure(job, pictures["ortho"])), SEAMS_CAPTION, "Seams"))
    if made.agreement is not None and files.mate is not None:
        tables.append(_agreement_table(made.agreement))
        tables += _model_tables(made.product, made.agreement)
        shown += _agreement_pictures(out, made, made.agreement)
    title = "Product" if not job.name else f"Product {job.name}"
    return Section(title, tuple(paragraphs), tuple(tables), tuple(shown))


def _grid_text(job: RectifyJob) -> str:
    turned = math.degrees(job.grid.rotation)
    direction = "north-up" if turned == 0.0 else f"rows turned by {-turned:+.3f}° along the base"
    text = f"Grid {direction}, origin on whole GSDs; {job.options.resampling} resampling, "
    return text + f"{job.options.heights_interpolation} heights, hidden ground: {job.options.hidden}."


def _law_text(job: RectifyJob) -> str:
    law = job.law
    y = max((_object_y_parallax(job, m) for m in job.models if m.right >= 0 and m.penalty < 0.7), default=0.0)
    q_low, q_high = (float(q) / job.grid.gsd for q in law.q(list(job.height_range)))
    return (
        f"{law.kind.capitalize()} law with nominal base {law.base_m:.2f} m, w0 {law.w0_m:.2f} m above the "
        f"reference level {law.reference_m:.2f} m: parallaxes of {q_low:.1f} to {q_high:.1f} pixels. "
        f"An object {job.options.object_height_m:g} m high shows at most {y:.2f} pixels of y-parallax."
    )


def _object_y_parallax(job: RectifyJob, model: StereoModel) -> float:
    """y-parallax in pixels that an object of the declared height shows in a model (`rectify.layout`)."""
    height = job.options.object_height_m
    depth = model.height_above_ground_m - height
    if depth <= 0.0:
        return math.inf
    return abs(model.base_v_m) * height / depth / job.frame.unit_m / job.grid.gsd


def _agreement_table(agreement: Agreement) -> Table:
    rows = []
    for name, s in (
        ("orthophoto left against orthophoto right", agreement.ortho_ortho),
        ("orthophoto against stereomate, minus q(h)", agreement.ortho_mate),
    ):
        if s.count:
            cells = [_with_error(*v) for v in zip(s.median_px, s.standard_error_px, strict=True)]
            cells += [f"{v:.3f}" for v in s.nmad_px]
            cells += [f"{v:.2f}" for v in s.largest_px]
        else:
            cells = ["–"] * 6
        rows.append((name, str(s.count), *cells))
    headings = ("pixels", "matches", "median x", "median y", "nmad x", "nmad y", "largest x", "largest y")
    said = (
        "Measured by image matching on a sample of windows; left minus right. ± is the standard error of the "
        "median: neighbours share the error of the height model, so whole blocks are drawn anew for it."
    )
    return Table(headings, tuple(rows), said)


# Models with fewer matches are not judged.
_FEW_MATCHES = 10


def _model_tables(product: StereoProduct, agreement: Agreement) -> list[Table]:
    """How well the rays of each model meet."""
    rows = [
        (
            f"{m.left} – {m.right}",
            str(m.count),
            *(f"{v:+.3f}" for v in (m.miss_median_m, m.y_median_m)),
            *(f"{v:.3f}" for v in (m.miss_rms_m, m.y_rms_m)),
        )
        for m in quality_of_agreement(product, agreement)
        if m.count >= _FEW_MATCHES
    ]
    headings = ("model, metres", "matches", "median miss", "median y", "rms miss", "rms y")
    said = (
        "Shortest distance of the rays of matched points after lineage: the quality of the orientation, "
        "whatever the height model. The y-parallax in the product beside it also holds the error of the "
        "height model."
    )
    return [Table(headings, tuple(rows), said)] if rows else []


def _with_error(median: float, error: float) -> str:
    return f"{median:+.3f}" if math.isnan(error) else f"{median:+.3f} ± {error:.3f}"


def _agreement_pictures(out: Path, made: ProductResult, agreement: Agreement) -> list[Picture]:
    if not len(agreement.residuals):
        return []
    job, files = made.product.job, made.product.files
    assert files.mate is not None
    figure = svg_uri(residual_figure(agreement))
    pixels = job.grid.pixel_from_map(agreement.points)
    middle = int(np.argmin(np.hypot(*(pixels - np.median(pixels, axis=0)).T)))
    detail = detail_anaglyph(
        out,
        files.ortho,
        files.mate,
        (float(pixels[middle, 0]), float(pixels[middle, 1])),
        agreement.parallaxes[middle],
    )
    return [
        Picture(
            figure, "Measured parallaxes of the matches, the law's share taken off.", "Residual parallaxes"
        ),
        Picture(jpeg_uri(detail), "Anaglyph of a detail at full resolution.", "Anaglyph of a detail"),
    ]


def _pairs(result: RunResult) -> Section:
    serving = {
        frozenset((job.photographs[m.left].name, job.photographs[m.right].name))
        for job in (made.product.job for made in result.products)
        for m in job.models
        if m.right >= 0
    }
    rows = tuple(
        (
            *pair.names,
            f"{pair.overlap:.0%}",
            f"{pair.base_m:.2f}",
            f"{pair.base_height:.3f}",
            f"{pair.azimuth_deg:.2f}",
            "yes" if frozenset(pair.names) in serving else "",
        )
        for pair in result.coverage.pairs
    )
    headings = ("photograph", "photograph", "overlap", "base, m", "base/height", "azimuth, °", "model")
    return Section("Pairs", tables=(Table(headings, rows),))


def _relative_orientation(result: RunResult) -> list[Section]:
    """How strongly the pairs determine their relative orientation, from the height model alone."""
    options = ProjectSectionOptions(least_contrast=0.0)
    geometries = sections_of_coverage(result.project, result.coverage, options)
    return [strength_section(geometries)] if geometries else []


def _given(result: RunResult) -> Section:
    project = result.project
    rows = tuple((item.role, item.path.name, item.digest[:16]) for item in project.inputs)
    model = project.require_heights()
    rows += (("height model", Path(model.name).name, model.content_hash[:16]),)
    items = tuple(project.notes) + tuple(f"left out: {problem.error}" for problem in project.problems)
    tables = (Table(("role", "file", "SHA-256"), rows, "Files that were read"),)
    return Section("Given and assumed", items=items, tables=tables)


def _peak_memory_mb() -> float:
    """Largest resident memory of this process.

    Linux says it in /proc; ``ru_maxrss``, elsewhere, begins with the memory of whoever started the process.
    """
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return float(line.split()[1]) / 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
