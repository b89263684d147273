"""What the report says about seams and balance."""

from __future__ import annotations

from typing import Final

from stereomate.rectify.job import RectifyJob
from stereomate.rectify.mosaic import MosaicSummary

SEAMS_CAPTION: Final = (
    "Ground of each model (left and right photograph), seams, and where photographs are mixed. The same "
    "lines are the seams of the stereomate, shifted by q. The polygons are in seams.gpkg, to be edited."
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


def _percent(values: tuple[float, ...]) -> str:
    return ", ".join(f"{100.0 * value:.1f}" for value in values)
