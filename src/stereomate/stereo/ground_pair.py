"""Orthophoto and stereomate brought over each other: what both show of the ground, pixel by pixel.

The stereomate shows ground x at U = x - q(h(x)). Taken from there, it lies over the orthophoto like an
orthophoto made from the right photographs: what is left between the two is the residual parallax, zero on
ground that the height model has right. A match at columns x and x - p names two ground points without
inverting a row.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import spline_filter1d

from stereomate.dense.matching import eroded
from stereomate.errors import InputError
from stereomate.raster import Window, open_photo
from stereomate.rectify.ground import Ground, ground_of, heights_of
from stereomate.stereo.kernels.dense_points import shift_rows
from stereomate.stereo.product import StereoProduct

Floats32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Columns around those that the stereomate shows, for the interpolation.
_AROUND = 4


@dataclass(frozen=True, eq=False)
class GroundPair:
    """A window of a product as both eyes' photographs show its ground.

    Attributes
    ----------
    ground : Ground
        Of the window.
    heights : (rows, cols) float32
        Of the height model at the pixels.
    left, right : (rows, cols) float32
        Grey values.
    left_valid, right_valid : (rows, cols) bool
        Where they show anything; the right one not where the law folds ground away.
    photographs : (2, rows, cols) uint16
        From 1; 0 = none.
    """

    ground: Ground
    heights: Floats32
    left: Floats32
    right: Floats32
    left_valid: Mask
    right_valid: Mask
    photographs: NDArray[np.uint16]


def require_rasters(product: StereoProduct) -> None:
    """Check that the product can be matched: it has a stereomate, and its rasters are there.

    Raises
    ------
    InputError
        Naming what is missing.
    """
    if not product.job.is_stereo or product.files.mate is None:
        raise InputError("must have a stereomate", field="product", value=product.job.name)
    for name in (product.files.ortho, product.files.mate, product.files.lineage):
        if not (product.folder / name).is_file():
            raise InputError("must be there to be matched", file=product.folder / name, field="product")


def ground_pair(product: StereoProduct, window: Window) -> GroundPair:
    """Both rasters of a product over a window of its pixels, which may reach beyond it."""
    job = product.job
    assert product.files.mate is not None
    ground = ground_of(job, window)
    heights = heights_of(job, ground, "pair heights").copy()
    left, left_valid = _grey(product, product.files.ortho, window)
    lineage = _read(product, product.files.lineage, window, 0)
    columns = np.arange(window.cols, dtype=np.float64) + 0.5
    with np.errstate(invalid="ignore"):
        shown = columns - job.law.q(heights) / job.grid.gsd
    known = np.isfinite(shown)
    shape = (window.rows, window.cols)
    if not known.any():
        nothing = np.zeros(shape, np.bool_)
        return GroundPair(
            ground, heights, left, np.zeros(shape, np.float32), left_valid, nothing, np.stack([lineage] * 2)
        )
    first = math.floor(float(shown[known].min())) - _AROUND
    last = math.ceil(float(shown[known].max())) + _AROUND
    there = Window(window.col0 + first, window.row0, last - first, window.rows)
    mate, mate_valid = _grey(product, product.files.mate, there)
    mate_lineage = _read(product, product.files.lineage, there, 1)
    # pixel centres at whole numbers
    at = shown - first - 0.5
    right = np.empty(shape, np.float32)
    shift_rows(spline_filter1d(mate, order=3, axis=1, output=np.float32), at, right)
    nearest = np.where(known, np.rint(at), 0).astype(np.intp)
    usable = np.take_along_axis(eroded(mate_valid, 2), nearest, axis=1)
    photograph = np.take_along_axis(mate_lineage, nearest, axis=1)
    usable = usable & known & (photograph > 0) & ~folded_away(shown)
    photograph[~usable] = 0
    return GroundPair(
        ground, heights, left, right, left_valid & (lineage > 0), usable, np.stack([lineage, photograph])
    )


def folded_away(shown: NDArray[np.float64]) -> Mask:
    """Whether ground does not appear in the stereomate: some beyond it has its column or a lower one.

    Parameters
    ----------
    shown : (rows, cols)
        Columns of the stereomate; NaN is no ground.
    """
    later = np.minimum.accumulate(np.where(np.isnan(shown), np.inf, shown)[:, ::-1], axis=1)[:, ::-1]
    hidden = np.zeros(shown.shape, np.bool_)
    hidden[:, :-1] = shown[:, :-1] >= later[:, 1:]
    return hidden


def _grey(product: StereoProduct, name: str, window: Window) -> tuple[Floats32, Mask]:
    """Mean of the bands over a window, 0 and not valid outside."""
    out = np.zeros((window.rows, window.cols), np.float32)
    valid = np.zeros(out.shape, np.bool_)
    with open_photo(product.folder / name) as raster:
        pixels, there = raster.read_window(*window)
        if not there.is_empty:
            inside = _inside(window, there)
            mask, _ = raster.read_mask(*window)
            colours = pixels[..., : len(product.job.bands)]
            out[inside] = np.where(mask, colours.mean(axis=2, dtype=np.float32), 0.0)
            valid[inside] = mask
    return out, valid


def _read(product: StereoProduct, name: str, window: Window, band: int) -> NDArray[np.uint16]:
    out = np.zeros((window.rows, window.cols), np.uint16)
    with open_photo(product.folder / name) as raster:
        pixels, there = raster.read_window(*window)
        if not there.is_empty:
            out[_inside(window, there)] = pixels[..., band]
    return out


def _inside(window: Window, there: Window) -> tuple[slice, slice]:
    row, col = there.row0 - window.row0, there.col0 - window.col0
    return slice(row, row + there.rows), slice(col, col + there.cols)
