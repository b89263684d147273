"""Homogeneity in the report of a run: how wrongly objects are read through the law, on a coarse grid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.rectify.job import RectifyJob
from stereomate.report.page import Picture, Section, Table
from stereomate.report.run_figures import svg_uri
from stereomate.report.stereo_homogeneity import draw_homogeneity_map
from stereomate.stereo.homogeneity import overview
from stereomate.stereo.homogeneity_summary import HomogeneitySummary

# Columns and rows of the map of a report, at most; tables of other heights stand on a coarser one.
_LONGEST: Final = 128
_COARSE: Final = 64
_HEIGHTS_M: Final = (5.0, 10.0, 20.0)
_DRAWN_M: Final = 10.0


@dataclass(frozen=True, eq=False)
class Homogeneity:
    """What a report says of one product.

    Attributes
    ----------
    product : str
    summaries : tuple of HomogeneitySummary
        Of objects of several heights, the lowest first.
    section : Section
    """

    product: str
    summaries: tuple[HomogeneitySummary, ...]
    section: Section


def homogeneity_of(job: RectifyJob) -> Homogeneity | None:
    """Map and figures of a stereo product; None where objects of no usual height can be read in it."""
    heights = [h / job.frame.heights.metres_per_unit for h in _HEIGHTS_M]
    heights = [h for h in heights if h < 0.5 * job.law.w0_m]
    if not job.is_stereo or not heights:
        return None
    drawn = min(heights, key=lambda h: abs(h - _DRAWN_M / job.frame.heights.metres_per_unit))
    summaries, picture = [], None
    for height in heights:
        coarse, values, summary = overview(job, height, _LONGEST if height == drawn else _COARSE)
        summaries.append(summary)
        if height == drawn:
            picture = _picture(coarse, values, summary)
    assert picture is not None
    title = "Homogeneity" if not job.name else f"Homogeneity of {job.name}"
    said = (
        "Objects that are not in the height model show residual parallaxes. On sloping ground these are not "
        "quite those of the parallax law: t_x is the relative error with which a height is read through the "
        "law, t_y the y-parallax over the ideal parallax. Both rays of an object are traced to the height "
        f"model at every {coarse_text(job)}. Exact measuring has neither error."
    )
    section = Section(title, (said,), (_height_table(summaries), _law_table(summaries)), (picture,))
    return Homogeneity(job.name, tuple(summaries), section)


def coarse_text(job: RectifyJob) -> str:
    """Distance of the places of the map."""
    step = job.grid.gsd * max(1.0, max(job.grid.size) / _LONGEST) * job.frame.unit_m
    return f"{step:.3g} m"


def _picture(job: RectifyJob, values: NDArray[np.float32], summary: HomogeneitySummary) -> Picture:
    width, height = (n * job.grid.gsd * job.frame.unit_m * 1e-3 for n in job.grid.size)
    figure = draw_homogeneity_map(
        values.astype(np.float64), (0.0, width, 0.0, height), summary.object_height_m, job.law.kind
    )
    return Picture(
        svg_uri(figure),
        f"Predicted errors of objects {summary.object_height_m:g} high; grey: not seen by both photographs.",
        "Maps of homogeneity",
        _histogram_table(summary),
        wide=True,
    )


def _histogram_table(summary: HomogeneitySummary) -> Table:
    """Shares of the area by t_x in steps of a tenth."""
    tenths = summary.t_x_histogram.reshape(-1, 10).sum(axis=1)
    total = max(int(summary.t_x_histogram.sum()), 1)
    edges = np.linspace(-1.0, 1.0, len(tenths) + 1)
    rows = tuple(
        (f"{low:+.1f} to {high:+.1f}", f"{count / total:.1%}")
        for low, high, count in zip(edges, edges[1:], tenths.tolist(), strict=False)
        if count
    )
    return Table(("t_x", "share of the area seen by both"), rows)


def _height_table(summaries: list[HomogeneitySummary]) -> Table:
    rows = tuple(
        (
            f"{s.object_height_m:g}",
            f"{s.seen_by_both:.1%}",
            f"{s.within_5_percent:.1%}",
            f"{s.within_10_percent:.1%}",
            f"{s.t_y_within_5_percent:.1%}",
            f"{s.error_rms_m:.2f}",
        )
        for s in summaries
    )
    headings = (
        "object height",
        "seen by both",
        "|t_x| ≤ 5 %",
        "|t_x| ≤ 10 %",
        "|t_y| ≤ 5 %",
        "rms of the height read",
    )
    return Table(headings, rows, "Shares of the area that a model serves, and of what both photographs see")


def _law_table(summaries: list[HomogeneitySummary]) -> Table:
    rows = tuple(
        (
            f"{s.object_height_m:g}",
            law.kind,
            f"{law.within_5_percent:.1%}",
            f"{law.within_10_percent:.1%}",
            f"{law.mean:+.1%}",
            f"{law.rms:.1%}",
        )
        for s in summaries
        for law in s.laws
    )
    headings = ("object height", "law", "within 5 %", "within 10 %", "mean error", "rms error")
    return Table(
        headings, rows, "Object heights read through a law: that of the product first, others for comparison"
    )
