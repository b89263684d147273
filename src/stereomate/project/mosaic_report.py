"""What the report says about seams and balance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from stereomate.rectify.job import RectifyJob
from stereomate.rectify.mosaic import MosaicSummary
from stereomate.rectify.seam_steps import SeamSteps
from stereomate.report.page import Table

SEAMS_CAPTION: Final = (
    "Ground of each model (left and right photograph), seams, and where photographs are mixed. The same "
    "lines are the seams of the stereomate, shifted by q. The polygons are in seams.gpkg, to be edited."
)

STEPS_CAPTION: Final = (
    "Steps of brightness in values of the product, medians over stretches of 16 pixels: across seams, across "
    "the same lines 13 pixels beside them, where there is none, and what the seams add. Two photographs of a "
    "crown or a wall never continue each other: seams that are cut there show it, and are not mixed."
)


def mosaic_texts(summary: MosaicSummary, job: RectifyJob) -> list[str]:
    """One paragraph on the seams, one on the balance; what was not done is not told."""
    texts = []
    if job.seams is not None:
        kind = "models" if job.is_stereo else "photographs"
        texts.append(
            f"{summary.models_used} {kind} serve the ground; their seams are {summary.seam_length:.0f} map "
            f"units long, found on cells of {summary.cell:g}; over {summary.mixed_length:.0f} of them "
            f"photographs are mixed, at most {job.options.feather_px:g} pixels to each side."
        )
    balance = summary.balance
    if balance is not None and balance.samples:
        texts.append(
            f"Brightness balanced over the block from {balance.samples} pairs of values of the same ground: "
            f"their differences in the median {_percent(balance.before)} % per band before, "
            f"{_percent(balance.after)} % after; gains of up to {balance.largest_gain:.2f}."
        )
    return texts


def seams_table(job: RectifyJob) -> Table:
    """Ground that each model serves."""
    assert job.seams is not None
    area: dict[int, float] = {}
    for model, polygon in job.seams.polygons:
        area[model] = area.get(model, 0.0) + polygon.area * (job.grid.gsd * job.frame.unit_m) ** 2
    total = sum(area.values()) or 1.0
    names = [photograph.name for photograph in job.photographs]
    rows = []
    for model, size in sorted(area.items(), key=lambda item: -item[1]):
        pair = job.models[model]
        label = names[pair.left] if pair.right < 0 else f"{names[pair.left]} – {names[pair.right]}"
        rows.append((label, f"{1e-4 * size:.2f}", f"{size / total:.1%}"))
    return Table(("model", "ground, ha", "share"), tuple(rows))


def seam_steps_table(steps: Sequence[SeamSteps]) -> Table:
    """Steps of brightness across seams, and across the same lines where there is none."""
    rows = [
        (
            s.product,
            "mixed (open ground)" if s.mixed else "cut (objects, walls)",
            str(s.places),
            f"{s.across:.1f}",
            f"{s.beside:.1f}",
            f"{s.net:+.1f}",
        )
        for s in steps
    ]
    return Table(("product", "seams", "stretches", "across", "beside", "net"), tuple(rows), STEPS_CAPTION)


def _percent(values: tuple[float, ...]) -> str:
    return ", ".join(f"{100.0 * value:.1f}" for value in values)
