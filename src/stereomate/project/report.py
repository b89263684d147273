"""What the report of a run says: from the values of the run to sections, tables and pictures."""

from __future__ import annotations

import resource
import sys
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stereomate import __version__
from stereomate.project.accuracy_report import accuracy_section, judgements
from stereomate.project.adjustment_report import adjusted_check_points, adjustment_of, adjustment_section
from stereomate.project.check_points import check_points
from stereomate.project.grid_effects import effects_section, grid_effects
from stereomate.project.homogeneity_report import homogeneity_of
from stereomate.project.orientation_report import strength_section
from stereomate.project.orientation_sections import ProjectSectionOptions, sections_of_coverage
from stereomate.project.product_report import product_section
from stereomate.project.run import RunResult
from stereomate.project.run_record import Findings, left_and_right, run_record, write_run_record
from stereomate.report.page import Picture, ReportContent, Section, Table, write_report
from stereomate.report.run_figures import (
    layout_figure,
    overlap_counts,
    overlap_figure,
    svg_uri,
)
from stereomate.stereo.agreement import ParallaxStatistics

NOT_MODELLED = (
    "Atmospheric refraction is not applied to rays unless the camera or the orientation already contains it.",
    "The deflection of the vertical and the slope of the geoid inside a photograph are not modelled.",
    "Objects that are not in the height model (trees, buildings, bridges) lean in the orthophoto.",
    "Their heights read through the parallax law are wrong on slopes: residual parallaxes vary.",
    "Errors of orientation and height model are not separated here: the measured parallaxes hold both.",
)
_UNKNOWN_ORIENTATION = "The standard deviations of the orientation are not known to this run."


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
    write_run_record(record, run_record(result, found, made))
    return [page, record]


def _findings(result: RunResult) -> Findings:
    adjustment = adjustment_of(result.project)
    checked = check_points(result.project)
    if checked is None and adjustment is not None:
        checked = adjusted_check_points(adjustment)
    agreement = result.products[0].agreement
    judged = judgements(result.project, checked, None if agreement is None else agreement.ortho_mate)
    homogeneity = (homogeneity_of(made.product.job) for made in result.products)
    return Findings(
        checked=checked,
        judged=judged,
        effects=grid_effects(result.project, result.coverage),
        adjustment=adjustment,
        homogeneity=tuple(found for found in homogeneity if found is not None),
        not_modelled=NOT_MODELLED if adjustment is not None else (*NOT_MODELLED, _UNKNOWN_ORIENTATION),
    )


def run_content(result: RunResult, found: Findings, seconds: float) -> ReportContent:
    """Everything the report shows."""
    project = result.project
    sections = [accuracy_section(project, found.checked, found.judged), _layout(result)]
    sections += [adjustment_section(found.adjustment)] if found.adjustment is not None else []
    sections += [product_section(result.out, made) for made in result.products]
    sections += [part.section for part in found.homogeneity]
    sections += [_pairs(result), *_relative_orientation(result)]
    sections += [effects_section(found.effects)] if found.effects else []
    sections += [_given(result), Section("Not modelled", items=found.not_modelled)]
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
    count, bounds = overlap_counts(coverage, project.survey, jobs)
    overlap = svg_uri(overlap_figure(count, bounds))
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
            Picture(
                overlap,
                "Number of photographs that show each place.",
                "Map of the overlap",
                _overlap_table(count, bounds, project.frame.unit_m),
            ),
        ),
    )


def _overlap_table(
    count: NDArray[np.int64], bounds: tuple[float, float, float, float], unit_m: float
) -> Table:
    cell = (bounds[2] - bounds[0]) * (bounds[3] - bounds[1]) * unit_m**2 / count.size
    found = np.bincount(count.ravel())
    rows = tuple((str(n), f"{1e-4 * cell * number:.2f}") for n, number in enumerate(found) if n and number)
    return Table(("photographs", "area, ha"), rows)


def _pairs(result: RunResult) -> Section:
    serving = {
        frozenset((job.photographs[m.left].name, job.photographs[m.right].name))
        for job in (made.product.job for made in result.products)
        for m in job.models
        if m.right >= 0
    }
    rows = []
    for pair in result.coverage.pairs:
        names, azimuth = left_and_right(pair, result)
        figures = (f"{pair.overlap:.0%}", f"{pair.base_m:.2f}", f"{pair.base_height:.3f}", f"{azimuth:.2f}")
        rows.append((*names, *figures, "yes" if frozenset(names) in serving else ""))
    headings = ("left", "right", "overlap", "base, m", "base/height", "azimuth, °", "model")
    return Section("Pairs", tables=(Table(headings, tuple(rows)),))


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
