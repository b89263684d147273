"""A terrain model from a surface: cells of the ground, interpolated below what stands on it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from stereomate.dense.fusion import filled, holes
from stereomate.dense.ground_filter import GroundOptions, ground_cells
from stereomate.errors import InputError

Floats32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Part of the cells of a square that lie below its reference height.
_LOW_PERCENT = 20.0


@dataclass(frozen=True)
class TerrainOptions:
    """How a terrain model is made of a surface.

    Attributes
    ----------
    factor : int
        Edge of a cell of the terrain model in cells of the surface.
    ground : GroundOptions
        Its lengths in map units.
    gap : float
        Widest gap of the ground that is bridged, in widths of the largest object.

    Raises
    ------
    InputError
        Naming the field, the rule and the value.
    """

    factor: int = 4
    ground: GroundOptions = field(default_factory=GroundOptions)
    gap: float = 2.0

    def __post_init__(self) -> None:
        if self.factor < 1:
            raise InputError("must be 1 or more", field="factor", value=self.factor)
        if not (math.isfinite(self.gap) and self.gap > 0.0):
            raise InputError("must be positive", field="gap", value=self.gap)

    def reach(self, cell: float) -> int:
        """Half the width of gaps that are bridged, in cells of the terrain model."""
        return max(2, math.ceil(0.5 * self.gap * self.ground.largest_object_m / cell))

    def margin(self, cell: float) -> int:
        """Cells around a window that its terrain depends on."""
        return math.ceil(2.0 * self.ground.largest_object_m / cell) + 2 * self.reach(cell) + 4


def reduced(heights: Floats32, factor: int) -> Floats32:
    """Median of the known cells of squares of `factor` cells; NaN where fewer than a quarter are known."""
    rows, cols = (-(-n // factor) for n in heights.shape)
    wide = np.full((rows * factor, cols * factor), np.nan, np.float32)
    wide[: heights.shape[0], : heights.shape[1]] = heights
    squares = wide.reshape(rows, factor, cols, factor).swapaxes(1, 2).reshape(rows, cols, -1)
    squares = np.sort(squares, axis=-1)
    count = np.isfinite(squares).sum(axis=-1)
    middle = np.maximum((count - 1) // 2, 0)
    out = np.take_along_axis(squares, middle[..., None], axis=-1)[..., 0]
    out[count * 4 < factor * factor] = np.nan
    return np.asarray(out, np.float32)


def reference_heights(heights: Floats32, cells: int, fill: bool = True) -> Floats32:
    """Low heights of squares of `cells` cells: the level that objects stand above.

    With `fill` squares without height take those of the squares around.
    """
    rows, cols = (-(-n // cells) for n in heights.shape)
    out = np.full((rows, cols), np.nan, np.float32)
    for i in range(rows):
        for j in range(cols):
            part = heights[i * cells : (i + 1) * cells, j * cells : (j + 1) * cells]
            known = part[np.isfinite(part)]
            if known.size >= min(4, cells):
                out[i, j] = np.percentile(known, _LOW_PERCENT)
    if fill and np.isfinite(out).any():
        out = filled(out, np.isnan(out), max(out.shape))
    return out


def upsampled(reference: Floats32, cells: int, col0: int, row0: int, shape: tuple[int, int]) -> Floats32:
    """Bilinear heights of `reference_heights` for a window of the cells it was made of."""
    rows, cols = shape
    x = ((np.arange(col0, col0 + cols) + 0.5) / cells - 0.5).astype(np.float32)
    y = ((np.arange(row0, row0 + rows) + 0.5) / cells - 0.5).astype(np.float32)
    place = np.meshgrid(x, y)
    return np.asarray(
        cv2.remap(reference, place[0], place[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE),
        np.float32,
    )


def terrain_window(
    heights: Floats32, reference: Floats32, cell: float, options: TerrainOptions
) -> tuple[Floats32, Mask]:
    """Heights of the ground in a window, and which cells of the surface are ground.

    Parameters
    ----------
    heights, reference : ndarray of float32, shape (rows, cols)
        Surface (NaN where there is none) and the level below, in cells of the terrain model.
    cell : float
        Edge of a cell, map units.
    options : TerrainOptions

    Returns
    -------
    terrain : ndarray of float32
        NaN beyond what is bridged: nothing grows outwards.
    ground : ndarray of bool
    """
    above = heights - reference
    ground = ground_cells(above, cell, options.ground)
    rest = np.where(ground, above, np.float32(np.nan))
    reach = options.reach(cell)
    known = np.isfinite(heights)
    # Below objects at the edge of the surface too: there is a surface, only its ground is hidden.
    gap = (holes(known, reach) | known) & ~ground
    return filled(rest, gap, reach) + reference, ground
