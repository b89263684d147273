"""Which photograph each pixel of a product shows: from the lineage raster, or by the serving rule."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import FormatError
from stereomate.raster import Window, open_photo
from stereomate.rectify.ground import ground_of, heights_of, mate_positions, shown_ground
from stereomate.rectify.job import RectifyJob
from stereomate.rectify.serving import Pixels, camera_nodes, models_of_window, serve_pixels

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Edge of the windows in which scattered positions are looked up.
_BLOCK = 256


class Lineage(Protocol):
    """Photographs by pixel of each product, counted from 1; 0 = nothing shown."""

    def photographs(self, side: int, pixels: Floats) -> Ints:
        """Photograph at pixel positions (n, 2) as (col, row); side 0 the orthophoto, 1 the stereomate."""
        ...


@dataclass(frozen=True)
class LineageRaster:
    """The lineage raster of a product, indexed by each product's own pixels."""

    path: Path

    def photographs(self, side: int, pixels: Floats) -> Ints:
        """As `Lineage.photographs`; 0 outside."""
        out = np.zeros(len(pixels), np.int64)
        with open_photo(self.path) as raster:
            if raster.bands < 2:
                raise FormatError("must have two bands, one for each eye", file=self.path, value=raster.bands)
            for members, window in _blocks(pixels, raster.size):
                values, _ = raster.read_window(*window)
                col = np.floor(pixels[members, 0]).astype(int) - window.col0
                row = np.floor(pixels[members, 1]).astype(int) - window.row0
                out[members] = values[row, col, side]
        return out


@dataclass(frozen=True, eq=False)
class LineageRule:
    """The serving rule that made the product, asked again for single pixels."""

    job: RectifyJob

    def photographs(self, side: int, pixels: Floats) -> Ints:
        """As `Lineage.photographs`; 0 outside."""
        out = np.zeros(len(pixels), np.int64)
        for members, window in _blocks(pixels, self.job.grid.size):
            col = np.floor(pixels[members, 0]).astype(int) - window.col0
            row = np.floor(pixels[members, 1]).astype(int) - window.row0
            out[members] = self._of_window(side, window)[row, col]
        return out

    def _of_window(self, side: int, window: Window) -> Ints:
        job, shape = self.job, (window.rows, window.cols)
        if side == 0:
            ground = ground_of(job, window)
            columns = np.arange(window.cols, dtype=np.float32)[None, :] + np.float32(0.5)
            heights = heights_of(job, ground, "lineage heights")
        else:
            ground = shown_ground(job, window)
            columns, heights, _ = mate_positions(job, window, ground)
        nothing = np.zeros(shape, np.int64)
        if ground.is_void:
            return nothing
        nodes = camera_nodes(job, ground)
        models = models_of_window(job, ground, nodes)
        if not models:
            return nothing
        serving = serve_pixels(job, ground, Pixels(window, columns, heights), models, nodes)
        shown = np.broadcast_to(serving.photographs(models, side, job.options.hidden), shape)
        return np.where(np.isfinite(heights), shown, 0).astype(np.int64)


def lineage_of(job: RectifyJob, path: Path | None) -> Lineage:
    """The lineage raster if it is there, else the rule."""
    return LineageRaster(path) if path is not None and path.is_file() else LineageRule(job)


def _blocks(pixels: Floats, size: tuple[int, int]) -> list[tuple[Ints, Window]]:
    """Positions inside a raster, grouped by windows of it."""
    inside = np.flatnonzero(((pixels >= 0.0) & (pixels < size)).all(axis=1))
    if inside.size == 0:
        return []
    block = pixels[inside].astype(np.int64) // _BLOCK
    key = block[:, 1] * (size[0] // _BLOCK + 1) + block[:, 0]
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    groups = []
    for members in np.split(inside[order], starts[1:]):
        low = pixels[members].min(axis=0).astype(int)
        high = pixels[members].max(axis=0).astype(int) + 1
        groups.append((members, Window(low[0], low[1], high[0] - low[0], high[1] - low[1])))
    return groups
