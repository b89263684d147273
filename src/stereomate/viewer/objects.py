"""Heights of objects over a product, from the surface that `stereomate heights` has written beside it."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import FormatError, ImageError
from stereomate.raster.pyramid import PyramidReader, open_pyramid
from stereomate.stereo.product import StereoProduct
from stereomate.stereo.surface_bands import ABOVE, BANDS, JUMP, ORTHO_TAG, SIGMA
from stereomate.viewer.layers import layer_size, layer_step

LOG = logging.getLogger(__name__)

Floats32 = NDArray[np.float32]

# Rows of the surface read at a time.
_ROWS = 256


def surface_of(product: StereoProduct, path: Path | None) -> Path | None:
    """The matched surface of a product; None where there is none.

    Parameters
    ----------
    path : Path or None
        Where it was written; None looks beside the product, and passes over a file that is not of it.

    Raises
    ------
    FormatError
        If the file named is no surface of this product.
    ImageError
        If it cannot be read.
    """
    if path is not None:
        _require_of_product(product, path)
        return path
    beside = product.raster_beside("surface")
    if not beside.is_file() or not beside.resolve().is_relative_to(product.folder.resolve()):
        return None
    try:
        _require_of_product(product, beside)
    except (FormatError, ImageError) as error:
        LOG.warning("no heights of objects are shown: %s", error)
        return None
    return beside


def _require_of_product(product: StereoProduct, path: Path) -> None:
    with open_pyramid(path, nearest=True) as raster:
        info = raster.info
    if info.descriptions != BANDS:
        raise FormatError("must be a surface of stereomate heights", file=path, field="bands")
    made_from = info.tags.get(ORTHO_TAG, "")
    if made_from != product.files.hashes.get(product.files.ortho, ""):
        raise FormatError(
            "must be the surface of these products: they were made anew since",
            file=path,
            field=ORTHO_TAG,
            value=made_from,
            hint="run stereomate heights again",
        )


def object_heights(product: StereoProduct, path: Path) -> Floats32:
    """Heights above the height model and their standard deviations on the layer's cells, (2, rows, cols).

    The highest of a cell counts, so that single trees do not vanish from a large product; NaN where nothing
    was matched.
    """
    cols, rows = layer_size(product.job.grid.size)
    out = np.full((2, rows * cols), np.nan, np.float32)
    with open_pyramid(path, nearest=True) as raster:
        cell = _cell_px(product, raster)
        step = layer_step(product.job.grid.size)
        if cell > step:
            return _repeated(raster, (cols, rows), cell, step)
        size_cols, size_rows = raster.info.size
        place_cols = _layer_index(np.arange(size_cols), cell, step, cols)
        for row0 in range(0, size_rows, _ROWS):
            pixels, _, window = raster.read(0, 0, row0, size_cols, _ROWS)
            place_rows = _layer_index(np.arange(window.row0, window.row1), cell, step, rows)
            place = (place_rows[:, None] * cols + place_cols).ravel()
            _keep_highest(out, place, pixels[..., ABOVE].ravel(), _sigma(pixels).ravel())
    return out.reshape(2, rows, cols)


def _cell_px(product: StereoProduct, raster: PyramidReader) -> int:
    """Pixels of the product along a cell of the surface."""
    a, _, _, d, _, _ = raster.info.transform or (product.job.grid.gsd, 0.0, 0.0, 0.0, 0.0, 0.0)
    return max(1, round(float(np.hypot(a, d)) / product.job.grid.gsd))


def _sigma(pixels: NDArray[np.float32]) -> Floats32:
    """Standard deviations; NaN beside jumps, where the surface may show either level."""
    return np.where(pixels[..., JUMP] > 0.0, np.float32(np.nan), pixels[..., SIGMA])


def _layer_index(index: NDArray[np.int64], cell: int, step: int, count: int) -> NDArray[np.int64]:
    # the middle of a cell is the middle of a pixel of the product
    return np.minimum((index * cell + cell // 2) // step, count - 1)


def _keep_highest(out: Floats32, place: NDArray[np.int64], above: Floats32, sigma: Floats32) -> None:
    known = np.flatnonzero(np.isfinite(above))
    # the last value written to a place stays: the highest
    known = known[np.argsort(above[known], kind="stable")]
    place = place[known]
    higher = ~(out[0, place] >= above[known])
    out[0, place[higher]] = above[known[higher]]
    out[1, place[higher]] = sigma[known[higher]]


def _repeated(raster: PyramidReader, size: tuple[int, int], cell: int, step: int) -> Floats32:
    """A surface with cells larger than those of the layer."""
    pixels, _, _ = raster.read(0, 0, 0, *raster.info.size)
    cols, rows = ((np.arange(n) * step + 0.5 * step) // cell for n in size)
    col = np.minimum(cols.astype(int), pixels.shape[1] - 1)
    row = np.minimum(rows.astype(int), pixels.shape[0] - 1)
    found = pixels[row[:, None], col]
    return np.ascontiguousarray(np.stack([found[..., ABOVE], _sigma(found)]), np.float32)
