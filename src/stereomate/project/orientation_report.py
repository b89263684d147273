"""How strongly pairs determine their relative orientation, for people: table, map, drawings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from stereomate import __version__
from stereomate.project.model import Project
from stereomate.project.orientation_sections import PairGeometry
from stereomate.relative.drawing import section_drawing
from stereomate.relative.sections import OrientationSection
from stereomate.report.overcorrection_interactive import interactive_fragment
from stereomate.report.overcorrection_map import strength_map
from stereomate.report.page import Picture, ReportContent, Section, Table, write_report
from stereomate.report.run_figures import svg_uri

# Drawings with points to drag, of the weakest pairs: more of them would only make the page slow.
_DRAWINGS = 4

EXPLANATION = (
    "The cross-section of the ground square to the base decides how well the lateral tilt ω follows from "
    "y-parallaxes. n is von Gruber's over-correction factor of a section (Kasper 1956); where it is "
    "infinite, the points and the projection centre lie on one circle and the tilt cannot be determined. "
    "Strength compares the standard deviation of ω from all sections of a pair with that of one section of "
    "flat ground under a normal-angle camera: 1 is as good, more is better, 0 is critical."
)


def strength_section(geometries: Sequence[PairGeometry]) -> Section:
    """The part of a report: every pair, the map, and drawings of the weakest pairs with points to drag."""
    weakest = sorted((g for g in geometries if g.points), key=lambda g: g.sections.strength)[:_DRAWINGS]
    picture = Picture(
        svg_uri(strength_map(geometries)),
        "Bases by how well the tilt is determined, with the orientation points of every section.",
        "Map of the pairs",
        _table(geometries),
        wide=True,
    )
    return Section(
        "Relative orientation",
        (EXPLANATION,),
        pictures=(picture,),
        fragments=tuple(_drawing(geometry, number) for number, geometry in enumerate(weakest, 1)),
    )


def write_strength_report(path: Path, project: Project, geometries: Sequence[PairGeometry]) -> None:
    """Write a page of its own.

    Raises
    ------
    StorageError
        If it cannot be written.
    """
    doubtful = sum(geometry.verdict != "good" for geometry in geometries)
    content = ReportContent(
        title=project.name,
        subtitle="Strength of the relative orientations",
        facts=[
            ("Map", project.frame.name),
            ("Pairs", f"{len(geometries)}, {doubtful} of them weak or near critical"),
        ],
        sections=[strength_section(geometries)],
        footer=f"stereomate {__version__}",
        meta={"software": f"stereomate {__version__}"},
    )
    write_report(path, content)


def _table(geometries: Sequence[PairGeometry]) -> Table:
    headings = (
        "pair",
        "base, m",
        "n near the centres",
        "n on flat ground",
        "strength",
        "sections",
        "from the model before",
        "geometry",
    )
    rows = []
    for geometry in geometries:
        ends, before = geometry.end_factors, geometry.from_previous
        sections = geometry.sections
        rows.append(
            (
                " – ".join(geometry.names),
                f"{geometry.base_m:.1f}",
                "–" if ends is None else " / ".join(_factor(n) for n in ends),
                f"{sections.flat_factor:.2f}",
                f"{sections.strength:.2f}" if geometry.points else "–",
                f"{len(sections.sections)} of {len(sections.sections) + len(sections.missing)}",
                "–" if before is None else f"n {_factor(before.strength.factor)}, with {geometry.previous}",
                geometry.verdict,
            )
        )
    return Table(headings, tuple(rows))


def _drawing(geometry: PairGeometry, number: int) -> str:
    """The section of a pair that determines the tilt least."""
    sections = geometry.sections.sections
    index = max(range(len(sections)), key=lambda k: sections[k].ratio)
    profile = geometry.profiles[index]
    profile = profile[np.isfinite(profile).all(axis=1)]
    drawing = section_drawing(sections[index].strength.section, profile=profile)
    heading = f"{' – '.join(geometry.names)}: {_place(sections[index])} ({geometry.verdict})."
    return interactive_fragment(drawing, f"section-{number}", heading)


def _place(section: OrientationSection) -> str:
    return f"its weakest section, at {section.place:.2f} of the base, strength {1.0 / section.ratio:.2f}"


def _factor(n: float) -> str:
    return "±∞" if math.isinf(n) else f"{n:.2f}"
