"""Ground among the cells of a surface: what stands on it with an edge is taken off.

The progressive morphological filter (K. Zhang et al. 2003, IEEE Trans. Geosci. Remote Sensing 41) on heights
above a height model: there, ground is level but for the errors of the model, so that objects stand out on any
slope, and a hill that the model misses rises gently while a house does not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from stereomate.errors import InputError

Floats32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

_FAR: Final = np.float32(1e6)


@dataclass(frozen=True)
class GroundOptions:
    """What counts as ground.

    Attributes
    ----------
    largest_object_m : float
        Width of the widest object; more extended rises are ground.
    least_object_m : float
        Lower objects are taken for ground.
    slope : float
        Steepest rise of ground above the height model, that is, of the model's own errors.

    Raises
    ------
    InputError
        Naming the field, the rule and the value.
    """

    largest_object_m: float = 40.0
    least_object_m: float = 0.5
    slope: float = 0.3

    def __post_init__(self) -> None:
        for name in ("largest_object_m", "least_object_m", "slope"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InputError("must be positive", field=name, value=value)


def ground_cells(heights: Floats32, cell_m: float, options: GroundOptions | None = None) -> Mask:
    """Which cells of a surface (rows, cols) are ground; cells without height (NaN) are not.

    Parameters
    ----------
    heights : (rows, cols) float32
        Above the height model, metres.
    cell_m : float
    options : GroundOptions, optional
    """
    options = options or GroundOptions()
    known = np.isfinite(heights)
    ground = known.copy()
    surface = np.where(known, heights, np.float32(0.0)).astype(np.float32)
    before = 1
    for width in window_widths(options.largest_object_m / cell_m):
        opened = _opened(surface, known, width)
        room = options.least_object_m + options.slope * (width - before) * cell_m
        ground &= ~(surface - opened > room)
        surface = np.where(known, opened, surface)
        before = width
    return ground


def window_widths(largest: float) -> list[int]:
    """Odd widths of the windows in cells, each about an eighth wider than the one before."""
    widths, width = [], 3
    while width < largest + 2:
        widths.append(width)
        width += 2 * max(1, width // 16)
    return widths or [3]


def _opened(surface: Floats32, known: Mask, width: int) -> Floats32:
    """Erosion and dilation by a square window, of the known cells alone."""
    element = np.ones((width, width), np.uint8)
    low = cv2.erode(np.where(known, surface, _FAR), element, borderValue=float(_FAR))
    high = cv2.dilate(np.where(known, low, -_FAR), element, borderValue=-float(_FAR))
    return np.asarray(high, np.float32)
