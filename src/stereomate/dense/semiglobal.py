"""Semi-global matching along rows to about a quarter of a pixel, over any range (H. Hirschmüller 2008)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from stereomate.errors import InputError

Floats32 = NDArray[np.float32]
Bytes = NDArray[np.uint8]

# Parallaxes of OpenCV are counted in sixteenths, and their number is a multiple of 16.
_SIXTEENTHS: Final = 16
# Search on both sides of what a coarser level found, pixels.
_AROUND: Final = 8
# Smallest image of a pyramid.
_LEAST_PX: Final = 48


@dataclass(frozen=True)
class SemiglobalOptions:
    """How whole-pixel parallaxes are found.

    Attributes
    ----------
    block_px : int
        Edge of the window whose grey values are compared, odd.
    small_step, large_step : float
        Penalties of a parallax that changes by one, and by more, between neighbours, per pixel of the block.
    uniqueness_percent : int
        By how much the best cost must beat the second best.
    left_right_px : int
        Largest difference of the parallaxes found from left to right and from right to left.
    speckle_px : int
        Smaller patches of parallaxes unlike those around them are dropped.
    widest_px : int
        Wider ranges are searched from coarse to fine.

    Raises
    ------
    InputError
        Naming the field, the rule and the value.
    """

    block_px: int = 5
    small_step: float = 8.0
    large_step: float = 40.0
    uniqueness_percent: int = 8
    left_right_px: int = 1
    speckle_px: int = 60
    widest_px: int = 160

    def __post_init__(self) -> None:
        rules = {
            "block_px": (self.block_px >= 1 and self.block_px % 2 == 1, "must be odd and positive"),
            "large_step": (0.0 < self.small_step < self.large_step, "must exceed small_step, both positive"),
            "uniqueness_percent": (0 <= self.uniqueness_percent < 100, "must be 0 to 99"),
            "left_right_px": (self.left_right_px >= 0, "must be 0 or more"),
            "speckle_px": (self.speckle_px >= 0, "must be 0 or more"),
            "widest_px": (self.widest_px >= 32, "must be 32 or more"),
        }
        for name, (holds, rule) in rules.items():
            if not holds:
                raise InputError(rule, field=name, value=getattr(self, name))


def semiglobal_parallax(
    left: Bytes, right: Bytes, search_px: tuple[float, float], options: SemiglobalOptions | None = None
) -> Floats32:
    """Parallaxes left minus right (rows, cols) of two 8-bit images; NaN where none passes the checks.

    Parameters
    ----------
    left, right : (rows, cols) uint8
        A point at column x of the left image lies at x - p of the right one, in the same row to a pixel.
    search_px : (low, high)
        Range of parallaxes p. Wider than `options.widest_px` it is searched from coarse to fine.
    """
    options = options or SemiglobalOptions()
    low, high = search_px
    small = min(left.shape) < 2 * _LEAST_PX
    if high - low <= options.widest_px or small:
        return _semiglobal(left, right, math.floor(low), math.ceil(high), options)
    halves = [
        cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA) for image in (left, right)
    ]
    coarse = semiglobal_parallax(halves[0], halves[1], (0.5 * low, 0.5 * high), options)
    expected = _doubled(coarse, (left.shape[1], left.shape[0]))
    known = np.isfinite(expected)
    if not known.any():
        return np.full(left.shape, np.nan, np.float32)
    rest = _semiglobal(left, _shifted(right, expected), -_AROUND, _AROUND, options)
    return np.asarray(rest + expected, np.float32)


def _semiglobal(left: Bytes, right: Bytes, low: int, high: int, options: SemiglobalOptions) -> Floats32:
    """One level: OpenCV's matcher with all columns of the left image in reach."""
    count = max(16, 16 * math.ceil((high - low + 1) / 16))
    area = options.block_px**2
    matcher = cv2.StereoSGBM.create(
        minDisparity=low,
        numDisparities=count,
        blockSize=options.block_px,
        P1=round(options.small_step * area),
        P2=round(options.large_step * area),
        disp12MaxDiff=options.left_right_px,
        preFilterCap=31,
        uniquenessRatio=options.uniqueness_percent,
        speckleWindowSize=options.speckle_px,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_SGBM,
    )
    before, after = max(low + count, 0), max(-low, 0)
    padded = [cv2.copyMakeBorder(i, 0, 0, before, after, cv2.BORDER_REPLICATE) for i in (left, right)]
    found = matcher.compute(*padded)[:, before : before + left.shape[1]]
    out: Floats32 = found.astype(np.float32) / np.float32(_SIXTEENTHS)
    out[found < low * _SIXTEENTHS] = np.nan
    out[out > high] = np.nan
    return out


def _doubled(parallax: Floats32, size: tuple[int, int]) -> Floats32:
    """Parallaxes of a level of half the size, at this one; gaps take the nearest value."""
    known = np.isfinite(parallax)
    if not known.any():
        return np.full((size[1], size[0]), np.nan, np.float32)
    _, nearest = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    values = np.zeros(int(nearest.max()) + 1, np.float32)
    values[nearest[known]] = parallax[known]
    filled = cv2.medianBlur(values[nearest], 5)
    doubled: Any = cv2.resize(filled, size, interpolation=cv2.INTER_LINEAR)
    return np.asarray(2.0 * doubled, np.float32)


def _shifted(right: Bytes, expected: Floats32) -> Bytes:
    """The right image as it lies where the left one shows the expected parallaxes."""
    row, col = np.indices(expected.shape, np.float32)
    out: Any = cv2.remap(right, col - expected, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(out, np.uint8)
