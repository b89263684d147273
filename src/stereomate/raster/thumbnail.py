"""Small pictures of rasters of any size, from their overviews."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rasterio.enums import Resampling

from stereomate.raster.handles import Handles, gdal_window, reading
from stereomate.raster.windows import Window


def read_thumbnail(
    path: str | os.PathLike[str], longest_px: int, window: Window | None = None
) -> tuple[NDArray[Any], NDArray[np.bool_], float]:
    """A raster, or a window of it, reduced to at most `longest_px` columns and rows.

    Returns
    -------
    pixels : (rows, cols, bands)
    valid : (rows, cols) bool
    step : float
        Pixels of the raster per pixel of the thumbnail.

    Raises
    ------
    ImageError
        If the file is missing or damaged.
    """
    handles = Handles(Path(path))
    try:
        with handles.lend() as handle, reading(Path(path)):
            wanted = window or Window(0, 0, handle.width, handle.height)
            step = max(1.0, max(wanted.cols, wanted.rows) / longest_px)
            shape = (math.ceil(wanted.rows / step), math.ceil(wanted.cols / step))
            place = gdal_window(wanted)
            bands = handle.read(window=place, out_shape=(handle.count, *shape), resampling=Resampling.average)
            mask = handle.dataset_mask(window=place, out_shape=shape, resampling=Resampling.nearest)
    finally:
        handles.close()
    return np.ascontiguousarray(np.moveaxis(bands, 0, -1)), np.asarray(mask != 0), step
