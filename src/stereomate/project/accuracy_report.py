"""What is said of the accuracy of a run: requested, found by check points, and what cannot be said."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stereomate.geometry.accuracy import ASPRS_LEAST_POINTS, Verdict
from stereomate.project.check_points import CheckPoints
from stereomate.project.model import Project
from stereomate.report.accuracy_figures import check_point_figure
from stereomate.report.page import Picture, Section, Table
from stereomate.report.run_figures import svg_uri
from stereomate.stereo.agreement import ParallaxStatistics


@dataclass(frozen=True)
class Judgement:
    """One requirement of ``[accuracy]`` and what became of it; `found` is None where nothing was measured."""

    requirement: str
    requested: float
    found: float | None
    unit: str
    verdict: Verdict
    reason: str = ""

    @property
    def text(self) -> str:
        """As the summary shows it."""
        found = "not measured" if self.found is None else f"{self.found:.3g} {self.unit}"
        reason = f" ({self.reason})" if self.reason else ""
        return f"{found}, requested {self.requested:g} {self.unit}: {self.verdict}{reason}"

    def as_record(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "requirement": self.requirement,
            "requested": self.requested,
            "found": self.found,
            "unit": self.unit,
            "verdict": self.verdict,
            "reason": self.reason,
        }


def judgements(
    project: Project, checked: CheckPoints | None, parallax: ParallaxStatistics | None
) -> tuple[Judgement, ...]:
    """The requirements of a project against what the run found.

    Parameters
    ----------
    parallax : ParallaxStatistics or None
        Of orthophoto against stereomate.
    """
    requested = project.document.get("accuracy") or {}
    out = []
    for part in ("horizontal", "vertical"):
        wanted = requested.get(f"{part}_m")
        if wanted is None:
            continue
        name = f"{part} accuracy (root mean square)"
        if checked is None:
            out.append(Judgement(name, wanted, None, "m", "not assessed", "no check points"))
            continue
        found = checked.accuracy
        value = found.horizontal_m if part == "horizontal" else found.vertical_m
        count = found.horizontal_points if part == "horizontal" else found.height.points
        verdict = found.verdict("horizontal" if part == "horizontal" else "vertical", wanted)
        reason = f"{count} check points"
        if verdict == "not assessed":
            reason += f", at least {ASPRS_LEAST_POINTS} are needed"
        out.append(Judgement(name, wanted, value if np.isfinite(value) else None, "m", verdict, reason))
    wanted = requested.get("y_parallax_px")
    if wanted is not None:
        name = "y-parallax of the stereo product (nmad)"
        if parallax is None or not parallax.count:
            out.append(Judgement(name, wanted, None, "px", "not assessed", "no matches"))
        else:
            y = float(parallax.nmad_px[1])
            reason = f"{parallax.count} matches"
            out.append(Judgement(name, wanted, y, "px", "pass" if y <= wanted else "fail", reason))
    return tuple(out)


def accuracy_section(project: Project, checked: CheckPoints | None, judged: tuple[Judgement, ...]) -> Section:
    """The section on accuracy: requirements, standards, and every check point."""
    tables = []
    if judged:
        rows = tuple((j.requirement, j.text) for j in judged)
        tables.append(Table(("requirement", "result"), rows, "Requested in the project file"))
    if checked is None or not checked.names:
        said = (
            "The project names no check points with image measurements ([control] with measurements), so the "
            "accuracy on the ground is not stated: neither ASPRS 2023 classes nor measures of ISO 19157."
        )
        return Section("Accuracy", (said,), tuple(tables))
    found = checked.accuracy
    origin = (
        "Check points of the block adjustment, which took no part in it, against their coordinates. "
        if checked.independent
        else "Rays of the points of [control] were intersected with the orientation as given, and compared "
        "with their coordinates. They are check points only if they took no part in that orientation. "
    )
    paragraphs = (
        f"{origin}Image residuals {checked.image_rms_px:.2f} px (root mean square).",
        f"{found.statement('horizontal')}. {found.statement('vertical')}.",
    )
    tables += [_component_table(checked), _standard_table(checked)]
    return Section("Accuracy", paragraphs, tuple(tables), (_picture(project, checked),))


def _component_table(checked: CheckPoints) -> Table:
    found = checked.accuracy
    rows = tuple(
        (name, str(c.points), *(f"{v:+.3f}" if k == 0 else f"{v:.3f}" for k, v in enumerate(values)))
        for name, c in (("east", found.east), ("north", found.north), ("height", found.height))
        for values in [(c.mean_m, c.std_m, c.rmse_m, c.survey_m, c.total_m)]
    )
    headings = ("metres", "points", "mean", "std", "rmse", "survey of the points", "together")
    return Table(headings, rows, "Intersection minus given coordinates")


def _standard_table(checked: CheckPoints) -> Table:
    rows = tuple(
        (str(m["measure"]), m["name"], f"{m['value_m']:.3f}", str(m["points"]))
        for m in checked.accuracy.iso19157()
    )
    return Table(("number", "measure", "value, m", "points"), rows, "Measures of ISO 19157")


def _picture(project: Project, checked: CheckPoints) -> Picture:
    known = np.flatnonzero(np.isfinite(checked.map_xy).all(axis=1))
    figure = check_point_figure(
        checked.map_xy[known],
        checked.differences_m[known],
        tuple(checked.names[k] for k in known),
        project.survey.centres_map[:, :2],
    )
    rows = tuple(
        (name, *(_signed(v) for v in d), *(f"{v:.3f}" for v in s), str(rays))
        for name, d, s, rays in zip(
            checked.names, checked.differences_m, checked.measured_sigma_m, checked.rays, strict=True
        )
    )
    headings = ("point", "east, m", "north, m", "up, m", "σ east", "σ north", "σ up", "rays")
    return Picture(
        svg_uri(figure),
        "Differences at the check points; crosses: projection centres. σ: from the image measurements alone.",
        "Map of the check points with vectors",
        Table(headings, rows),
        wide=True,
    )


def _signed(value: float) -> str:
    return "" if np.isnan(value) else f"{value:+.3f}"
