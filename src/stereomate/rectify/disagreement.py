"""How differently two models show the same ground: what a seam between them would make visible.

For each eye, the photographs of both models are compared on the coarse grid: their difference in colour, and
the parallax between them, which is 0 on the surface of the height model and grows with what stands on it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from stereomate.raster import Window
from stereomate.rectify.layout import StereoModel
from stereomate.rectify.overviews import Overviews, intersection, slices_within

Floats32 = NDArray[np.float32]
Bools = NDArray[np.bool_]

# Path costs per cell: length, digital numbers (of 255) per unit and at most, parallax in cells likewise.
LENGTH_COST: Final = 0.5
_COLOUR_STEP_DN: Final = 4.0
_MOST_COLOUR: Final = 24.0
_PARALLAX_FREE: Final = 0.3
_PARALLAX_STEP: Final = 0.25
_MOST_PARALLAX: Final = 16.0
# A surface as steep as this is the wall of something; its cost, and how far around it.
_STEEP: Final = 1.0
_STEEP_COST: Final = 8.0

# Photographs are mixed where they differ by less than this in colour (after smoothing) and in parallax.
MIXED_COLOUR_DN: Final = 20.0
MIXED_PARALLAX: Final = 0.5
_SMOOTHING: Final = 3


@dataclass(frozen=True, eq=False)
class Disagreement:
    """Two models over a window of the coarse grid.

    Attributes
    ----------
    colour : (rows, cols) float32
        Difference in digital numbers of 0 to 255, the greater of both eyes.
    parallax : (rows, cols) float32
        Between the photographs of an eye, cells, the greater of both eyes.
    steep : (rows, cols) bool
        The height model has a wall here.
    first, second : (rows, cols) bool
        Where each model shows the ground.
    """

    colour: Floats32
    parallax: Floats32
    steep: Bools
    first: Bools
    second: Bools

    @property
    def cost(self) -> Floats32:
        """What a seam costs per cell."""
        colour = np.minimum(self.colour / _COLOUR_STEP_DN, _MOST_COLOUR)
        parallax = np.clip((self.parallax - _PARALLAX_FREE) / _PARALLAX_STEP, 0.0, _MOST_PARALLAX)
        return np.asarray(LENGTH_COST + colour + parallax + _STEEP_COST * self.steep, np.float32)

    @property
    def agrees(self) -> Bools:
        """Open ground that both models show alike: photographs may be mixed."""
        alike = (self.colour < MIXED_COLOUR_DN) & (self.parallax < MIXED_PARALLAX) & ~self.steep
        return np.asarray(alike & self.first & self.second)


def grey_scale(overviews: Overviews) -> float:
    """Factor from pixel values to digital numbers of 0 to 255; for other types by their 99th percentile."""
    if overviews.job.dtype == np.uint8:
        return 1.0
    tops = [
        float(np.percentile(o.pixels[o.valid], 99.0))
        for o in overviews.photographs
        if o is not None and o.valid.any()
    ]
    top = max(tops, default=1.0)
    return 255.0 / top if top > 0.0 else 1.0


def disagreement(
    overviews: Overviews, first: StereoModel, second: StereoModel, window: Window, scale: float
) -> Disagreement:
    """Compare two models over a window of cells.

    Parameters
    ----------
    scale : float
        From `grey_scale`.
    """
    shape = (window.rows, window.cols)
    colour, parallax = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    shown = [np.ones(shape, np.bool_), np.ones(shape, np.bool_)]
    for eye in ("left", "right"):
        numbers = getattr(first, eye), getattr(second, eye)
        if min(numbers) < 0:
            continue
        for seen, p in zip(shown, numbers, strict=True):
            overview = overviews.photographs[p]
            seen &= False if overview is None else overview.shows(window)
        if numbers[0] != numbers[1]:
            box, *compared = _compared(overviews, (min(numbers), max(numbers)), scale)
            common = intersection(box, window)
            if not common.is_empty:
                here, there = slices_within(common, window), slices_within(common, box)
                for greatest, values in zip((colour, parallax), compared, strict=True):
                    np.maximum(greatest[here], values[there], out=greatest[here])
    return Disagreement(colour, parallax, _walls(overviews, window), shown[0], shown[1])


def photograph_of(overviews: Overviews, p: int, window: Window) -> tuple[NDArray[Any], Bools]:
    """Pixels of a photograph as floats over a window of cells, and where it shows it."""
    overview = overviews.photographs[p]
    if overview is None:
        shape = (window.rows, window.cols)
        return np.zeros((*shape, len(overviews.job.bands)), np.float32), np.zeros(shape, np.bool_)
    pixels, valid = overview.within(window)
    return pixels.astype(np.float32), valid


def _compared(overviews: Overviews, pair: tuple[int, int], scale: float) -> tuple[Window, Floats32, Floats32]:
    """Difference in colour and parallax of two photographs over the cells that both may show.

    Kept: a seam is looked for several times, and each time asks about another part of them.
    """
    found = overviews.compared.get(pair)
    if found is None:
        a, b = (overviews.photographs[p] for p in pair)
        empty = np.zeros((0, 0), np.float32)
        found = Window(0, 0, 0, 0), empty, empty
        if a is not None and b is not None:
            box = intersection(a.window, b.window)
            if not box.is_empty:
                found = box, *_compared_pixels(a.within(box), b.within(box), scale)
        overviews.compared[pair] = found
    return found


def _compared_pixels(
    first: tuple[NDArray[Any], Bools], second: tuple[NDArray[Any], Bools], scale: float
) -> tuple[Floats32, Floats32]:
    a, b = (pixels.astype(np.float32) * np.float32(scale) for pixels, _ in (first, second))
    both = first[1] & second[1]
    difference = np.abs(a - b).max(axis=2)
    difference[~both] = 0.0
    share = cv2.blur(both.astype(np.float32), (_SMOOTHING, _SMOOTHING))
    colour = cv2.blur(difference, (_SMOOTHING, _SMOOTHING)) / np.maximum(share, 1e-6)
    # Where only one has a picture, it stands in for the other: no parallax is made up at the edge.
    grey = [np.where(both, image.mean(axis=2), 0.0) for image in (a, b)]
    byte = [np.clip(np.rint(g), 0, 255).astype(np.uint8) for g in grey]
    flow = cv2.calcOpticalFlowFarneback(byte[0], byte[1], None, 0.5, 3, 9, 3, 5, 1.1, 0)
    parallax = np.hypot(flow[..., 0], flow[..., 1])
    inner = cv2.erode(both.astype(np.uint8), np.ones((5, 5), np.uint8), borderValue=1) > 0
    parallax[~inner] = 0.0
    # Beside a roof its parallax reaches the ground by the width of the window that measured it.
    return np.asarray(colour, np.float32), np.asarray(cv2.dilate(parallax, np.ones((3, 3))), np.float32)


def _walls(overviews: Overviews, window: Window) -> Bools:
    at = (slice(window.row0, window.row1), slice(window.col0, window.col1))
    heights = overviews.heights[at]
    known = np.isfinite(heights)
    if not known.any() or min(heights.shape) < 2:
        return np.zeros(heights.shape, np.bool_)
    filled = np.where(known, heights, np.float32(heights[known].mean()))
    ring = np.ones((3, 3), np.uint8)
    rise = cv2.dilate(filled, ring) - cv2.erode(filled, ring)
    # the range over 3 x 3 cells of a plane is twice its slope
    steep = rise > 2.0 * _STEEP * overviews.job.grid.gsd * overviews.job.frame.unit_m
    return np.asarray(cv2.dilate(steep.astype(np.uint8), ring) > 0)
