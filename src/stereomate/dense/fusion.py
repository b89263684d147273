"""One surface from those of many pairs: median of what agrees, outliers out, small holes filled."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from stereomate.errors import InputError

Floats32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

VOID, MEASURED, FILLED = 0, 1, 2
# In standard deviations: heights further from the median of the pairs are no matches of the same thing.
_FAR: Final = 4.0
_NOTHING: Final = -32768
# Of the median of a normal sample against the mean, and of the median deviation.
_MEDIAN: Final = 1.2533
_NMAD: Final = 1.4826
# Half width of the smallest kernel that fills.
_STEP: Final = 2


@dataclass(frozen=True)
class FusionOptions:
    """How the surfaces of pairs become one.

    Attributes
    ----------
    speckle_cells : int
        Smaller patches that stand apart from all around them are outliers.
    room : float
        Difference of neighbouring cells that does not set them apart, map heights.
    filled_cells : int
        Half the width of holes that are filled.

    Raises
    ------
    InputError
        Naming the field, the rule and the value.
    """

    speckle_cells: int = 40
    room: float = 1.0
    filled_cells: int = 6

    def __post_init__(self) -> None:
        if self.speckle_cells < 0 or self.filled_cells < 0:
            field = "speckle_cells" if self.speckle_cells < 0 else "filled_cells"
            raise InputError("must be 0 or more", field=field, value=getattr(self, field))
        if not (math.isfinite(self.room) and self.room > 0.0):
            raise InputError("must be positive", field="room", value=self.room)

    @property
    def margin(self) -> int:
        """Cells around a window that its result depends on."""
        return 4 * self.filled_cells + self.speckle_cells


@dataclass(frozen=True, eq=False)
class Fused:
    """A surface in cells.

    Attributes
    ----------
    heights, sigma : ndarray of float32, shape (rows, cols)
        NaN where there is none.
    pairs : ndarray of uint8
        Pairs that agree on the height.
    kind : ndarray of uint8
        `VOID`, `MEASURED` or `FILLED`.
    """

    heights: Floats32
    sigma: Floats32
    pairs: NDArray[np.uint8]
    kind: NDArray[np.uint8]


def fuse(heights: Floats32, sigma: Floats32, options: FusionOptions | None = None) -> Fused:
    """Fuse the surfaces of pairs.

    Parameters
    ----------
    heights, sigma : ndarray of float32, shape (pairs, rows, cols)
        NaN where a pair shows nothing.
    options : FusionOptions, optional
    """
    options = options or FusionOptions()
    middle = _median(heights)
    scatter = np.abs(heights - middle)
    with np.errstate(invalid="ignore"):
        # What pairs differ by where they agree, for this whole window: their orientations are not perfect.
        common = _NMAD * _median_of(scatter[:, np.isfinite(heights).sum(axis=0) >= 3])
        agree = scatter <= _FAR * np.hypot(sigma, np.float32(common))
    taken = np.where(agree, heights, np.float32(np.nan))
    count = np.isfinite(taken).sum(axis=0)
    # Of two that contradict each other neither can be trusted.
    lonely = (count * 2 <= np.isfinite(heights).sum(axis=0)) & (count > 0)
    taken[:, lonely] = np.nan
    count[lonely] = 0
    fused = _median(taken)
    stated = np.sqrt(_mean(np.where(np.isfinite(taken), sigma, np.nan) ** 2))
    found = _NMAD * _median(np.abs(taken - fused))
    with np.errstate(invalid="ignore", divide="ignore"):
        n = count.astype(np.float32)
        factor = np.where(count > 2, np.float32(_MEDIAN), np.float32(1.0)) / np.sqrt(np.maximum(n, 1.0))
        spread = np.where(count > 2, np.maximum(stated, found), np.hypot(stated, np.float32(common)))
        spread = (factor * spread).astype(np.float32)
    out = speckles(fused, options.room, options.speckle_cells)
    fused[out], spread[out], count[out] = np.nan, np.nan, 0
    measured = np.isfinite(fused)
    kind = np.where(measured, MEASURED, VOID).astype(np.uint8)
    if options.filled_cells:
        hole = holes(measured, options.filled_cells)
        fused = filled(fused, hole, options.filled_cells)
        # Filled cells are as uncertain as those beside them differ.
        rough = _roughness(fused, measured, options.filled_cells)
        spread = np.where(hole, rough, spread).astype(np.float32)
        kind[hole & np.isfinite(fused)] = FILLED
    return Fused(fused, spread, np.minimum(count, 255).astype(np.uint8), kind)


def speckles(heights: Floats32, room: float, cells: int) -> Mask:
    """Cells of patches up to a size that stand apart from all around them by more than the room."""
    known = np.isfinite(heights)
    if not known.any() or cells < 1:
        return np.zeros(heights.shape, np.bool_)
    # OpenCV looks at whole numbers: sixteenths of the room, about the middle; what leaves them is far anyway.
    middle = float(np.median(heights[known]))
    steps = np.clip(np.rint((np.where(known, heights, middle) - middle) * (16.0 / room)), -32000, 32000)
    whole = steps.astype(np.int16)
    whole[~known] = _NOTHING
    cv2.filterSpeckles(whole, _NOTHING, cells, 16)
    return np.asarray(known & (whole == _NOTHING), np.bool_)


def holes(known: Mask, reach: int) -> Mask:
    """Unknown cells among known ones: what a closing by `reach` cells closes. Nothing grows outwards."""
    size = 2 * reach + 1
    element = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    wide = cv2.copyMakeBorder(known.astype(np.uint8), *(reach,) * 4, cv2.BORDER_CONSTANT, value=0)
    closed = cv2.erode(cv2.dilate(wide, element), element, borderValue=1)
    return np.asarray(closed[reach:-reach, reach:-reach].astype(np.bool_) & ~known)


def filled(heights: Floats32, hole: Mask, reach: int) -> Floats32:
    """Heights with holes filled: weighted means of the known cells around, of the nearest first."""
    known = np.isfinite(heights)
    out = heights.copy()
    if not known.any() or not hole.any():
        return out
    middle = np.float32(np.median(heights[known]))
    weight = known.astype(np.float32)
    values = np.where(known, heights - middle, np.float32(0.0)).astype(np.float32)
    half = _STEP
    while True:
        half = min(half, 2 * reach)
        size = (2 * half + 1, 2 * half + 1)
        sigma = half / 2.5
        total = cv2.GaussianBlur(weight, size, sigma, borderType=cv2.BORDER_CONSTANT)
        moved = cv2.GaussianBlur(values, size, sigma, borderType=cv2.BORDER_CONSTANT)
        todo = hole & np.isnan(out) & (total > 1e-3)
        out[todo] = moved[todo] / total[todo] + middle
        if half >= 2 * reach or not (hole & np.isnan(out)).any():
            return out
        half *= 2


def _roughness(heights: Floats32, measured: Mask, reach: int) -> Floats32:
    """Standard deviation of the measured cells around every cell."""
    side = 4 * reach + 1
    known = measured & np.isfinite(heights)
    middle = np.float32(np.median(heights[known])) if known.any() else np.float32(0.0)
    values = np.where(known, heights - middle, np.float32(0.0)).astype(np.float64)
    box = (side, side)
    weight = np.maximum(cv2.blur(known.astype(np.float64), box, borderType=cv2.BORDER_CONSTANT), 1e-9)
    mean = cv2.blur(values, box, borderType=cv2.BORDER_CONSTANT) / weight
    square = cv2.blur(values * values, box, borderType=cv2.BORDER_CONSTANT) / weight
    return np.asarray(np.sqrt(np.maximum(square - mean * mean, 0.0)), np.float32)


def _median(values: Floats32) -> Floats32:
    """Median over the first axis of what is finite; NaN where nothing is."""
    ordered = np.sort(values, axis=0)
    count = np.isfinite(values).sum(axis=0)
    low = np.maximum((count - 1) // 2, 0)
    high = np.minimum(count // 2, len(values) - 1)
    one = np.take_along_axis(ordered, low[None], axis=0)[0]
    other = np.take_along_axis(ordered, high[None], axis=0)[0]
    out = (one + other) / np.float32(2.0)
    out[count == 0] = np.nan
    return np.asarray(out, np.float32)


def _median_of(values: Floats32) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else 0.0


def _mean(values: Floats32) -> Floats32:
    known = np.isfinite(values)
    total = np.where(known, values, np.float32(0.0)).sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(total / known.sum(axis=0), np.float32)


def stacked(layers: Sequence[Floats32], shape: tuple[int, int]) -> Floats32:
    """Layers as one array; a layer of NaN where there is none."""
    if not layers:
        return np.full((1, *shape), np.nan, np.float32)
    return np.stack(layers)
