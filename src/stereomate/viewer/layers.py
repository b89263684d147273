"""What lies over the pictures: relief, homogeneity and lineage on grids small enough to be one file each."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from stereomate.raster import Window
from stereomate.raster.pyramid import PyramidReader
from stereomate.rectify.ground import ground_of, heights_of
from stereomate.rectify.job import RectifyJob
from stereomate.stereo.homogeneity import coarse_job, homogeneity_window

Floats32 = NDArray[np.float32]

# Longest side of a layer: finer than a screen shows of a whole product, small enough to load at once.
LONGEST = 1024
_WINDOW = 256


def layer_step(size: tuple[int, int]) -> int:
    """Product pixels per node of a layer."""
    return max(1, math.ceil(max(size) / LONGEST))


def layer_size(size: tuple[int, int]) -> tuple[int, int]:
    """Columns and rows of a layer."""
    step = layer_step(size)
    return -(-size[0] // step), -(-size[1] // step)


def relief(job: RectifyJob) -> Floats32:
    """Heights of the ground at the middles of a layer's cells, (rows, cols); NaN = void."""
    coarse = coarse_job(job, job.grid.gsd * layer_step(job.grid.size))
    cols, rows = coarse.grid.size
    out = np.empty((rows, cols), np.float32)
    for window in _windows(cols, rows):
        found = heights_of(coarse, ground_of(coarse, window), "viewer relief")
        out[window.row0 : window.row1, window.col0 : window.col1] = found
    return out


def homogeneity(job: RectifyJob, object_height_m: float) -> Floats32:
    """t_x and t_y of objects of a height, (2, rows, cols); NaN where not both photographs see the object."""
    coarse = coarse_job(job, job.grid.gsd * layer_step(job.grid.size))
    cols, rows = coarse.grid.size
    out = np.empty((2, rows, cols), np.float32)
    for window in _windows(cols, rows):
        part = homogeneity_window(coarse, window, object_height_m)
        place = np.s_[window.row0 : window.row1, window.col0 : window.col1]
        out[0][place], out[1][place] = part.values[..., 0], part.values[..., 1]
    return out


def lineage(raster: PyramidReader) -> NDArray[np.uint16]:
    """Photographs, counted from 1, at the middles of a layer's cells, (eyes, rows, cols)."""
    size = raster.info.size
    step, (cols, rows) = layer_step(size), layer_size(size)
    level = step.bit_length() - 1
    pixels, valid, _ = raster.read(level, 0, 0, *raster.size(level))
    pixels[~valid] = 0
    at = (np.arange(max(cols, rows)) + 0.5) * step / (1 << level)
    col = np.minimum(at[:cols].astype(int), pixels.shape[1] - 1)
    row = np.minimum(at[:rows].astype(int), pixels.shape[0] - 1)
    return np.asarray(np.moveaxis(pixels[row[:, None], col], -1, 0), np.uint16)


def _windows(cols: int, rows: int) -> Iterator[Window]:
    for row0 in range(0, rows, _WINDOW):
        for col0 in range(0, cols, _WINDOW):
            yield Window(col0, row0, min(_WINDOW, cols - col0), min(_WINDOW, rows - row0))
