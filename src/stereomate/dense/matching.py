"""Dense matching of two images with parallaxes along the rows: semi-global, then least squares per pixel.

The narrow-range matcher of the package: orthophoto against stereomate, where parallaxes are residuals
around zero, and epipolar images. Whole pixels come from semi-global matching with its left-right check; the
sub-pixel part, its standard deviation and the parallax across the rows from a least-squares match of the
window around each pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import spline_filter

from stereomate.dense.kernels import refine as kernels
from stereomate.dense.semiglobal import SemiglobalOptions, semiglobal_parallax
from stereomate.errors import InputError

Floats32 = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class DenseOptions:
    """How two images are matched densely.

    Attributes
    ----------
    window_px : int
        Edge of the window of the least-squares match, odd.
    step_px : int
        One match for every square of so many rows and columns, at its middle pixel.
    iterations : int
    largest_change_px : float
        A least-squares match that moves further from the semi-global one is given up.
    largest_row_parallax_px : float
        Across the rows: larger ones are no matches.
    least_correlation : float
        Of the two windows; it is returned as the confidence of the match.
    semiglobal : SemiglobalOptions

    Raises
    ------
    InputError
        Naming the field, the rule and the value.
    """

    window_px: int = 9
    step_px: int = 1
    iterations: int = 8
    largest_change_px: float = 1.5
    largest_row_parallax_px: float = 2.0
    least_correlation: float = 0.6
    semiglobal: SemiglobalOptions = field(default_factory=SemiglobalOptions)

    def __post_init__(self) -> None:
        rules = {
            "window_px": (self.window_px >= 5 and self.window_px % 2 == 1, "must be odd, 5 or more"),
            "step_px": (self.step_px >= 1, "must be 1 or more"),
            "iterations": (self.iterations >= 1, "must be 1 or more"),
            "largest_change_px": (self.largest_change_px > 0.0, "must be positive"),
            "largest_row_parallax_px": (self.largest_row_parallax_px > 0.0, "must be positive"),
            "least_correlation": (-1.0 <= self.least_correlation < 1.0, "must be at least -1, below 1"),
        }
        for name, (holds, rule) in rules.items():
            if not holds:
                raise InputError(rule, field=name, value=getattr(self, name))

    @property
    def margin_px(self) -> int:
        """Pixels around a window that its matches need, besides the search range."""
        return self.window_px // 2 + max(2 * self.semiglobal.block_px, 16)


@dataclass(frozen=True, eq=False)
class DenseMatch:
    """Parallaxes of the left image, left minus right, float32; NaN without match.

    With ``step_px = s`` element (i, j) belongs to pixel (i s + s // 2, j s + s // 2), else to its own.

    Attributes
    ----------
    parallax, row_parallax : ndarray
        Along and across the rows, pixels: left (x, y) shows what right (x - parallax, y - row_parallax) does.
    variance, covariance, row_variance : ndarray
        Of the two, pixels², from the residuals of the match.
    correlation : ndarray
        Of the two windows after matching: the confidence.
    """

    parallax: Floats32
    row_parallax: Floats32
    variance: Floats32
    covariance: Floats32
    row_variance: Floats32
    correlation: Floats32


def match_dense(
    left: NDArray[Any],
    right: NDArray[Any],
    search_px: tuple[float, float],
    options: DenseOptions | None = None,
    *,
    valid: tuple[Mask, Mask] | None = None,
    labels: NDArray[np.uint16] | None = None,
) -> DenseMatch:
    """Match every pixel of the left image.

    Parameters
    ----------
    left, right : (rows, cols)
        Grey values of any type, same size. Epipolar: parallaxes across the rows stay within a pixel or two.
    search_px : (low, high)
        Range of parallaxes, left minus right.
    options : DenseOptions, optional
    valid : ((rows, cols), (rows, cols)) of bool, optional
        Where the left and the right image show anything.
    labels : (rows, cols) uint16, optional
        Pixels of different labels (photographs behind the left image) are not matched in one window.

    Raises
    ------
    InputError
        If the sizes differ, or the range is empty.
    """
    options = options or DenseOptions()
    if left.ndim != 2 or left.shape != right.shape:
        raise InputError(
            "must be two grey images of one size", field="right", value=(left.shape, right.shape)
        )
    if not search_px[0] < search_px[1]:
        raise InputError("must be (low, high) with low below high", field="search_px", value=search_px)
    everywhere = np.ones(left.shape, np.bool_)
    left_valid, right_valid = valid if valid is not None else (everywhere, everywhere)
    bytes_of = byte_scale(left, left_valid, right, right_valid)
    initial = semiglobal_parallax(
        bytes_of(left, left_valid), bytes_of(right, right_valid), search_px, options.semiglobal
    )
    initial[~eroded(left_valid, options.semiglobal.block_px // 2)] = np.nan
    step = options.step_px
    out = np.empty((kernels.LAYERS, *(-(-n // step) for n in left.shape)), np.float32)
    kernels.refine_window(
        np.ascontiguousarray(left, np.float32),
        spline_filter(np.where(right_valid, right, _level(right, right_valid)), order=3, output=np.float32),
        initial,
        np.zeros(left.shape, np.uint16) if labels is None else np.ascontiguousarray(labels),
        eroded(right_valid, options.window_px // 2 + 3).astype(np.uint8),
        options.window_px // 2,
        step,
        options.iterations,
        options.largest_change_px,
        options.largest_row_parallax_px,
        options.least_correlation,
        out,
    )
    return DenseMatch(*out)


def byte_scale(left: NDArray[Any], left_valid: Mask, right: NDArray[Any], right_valid: Mask) -> Any:
    """A function (image, valid) -> uint8 that stretches both images alike; invalid pixels become 0."""
    both = np.concatenate([left[left_valid].ravel(), right[right_valid].ravel()])
    plain = left.dtype == np.uint8 and right.dtype == np.uint8
    low, high = (0.0, 255.0) if plain or both.size == 0 else np.percentile(both, (0.5, 99.5))

    def scaled(image: NDArray[Any], valid: Mask) -> NDArray[np.uint8]:
        stretched = (image.astype(np.float32) - np.float32(low)) * np.float32(255.0 / max(high - low, 1e-6))
        stretched[~valid] = 0.0
        return np.asarray(np.clip(np.rint(stretched), 0, 255), np.uint8)

    return scaled


def _level(image: NDArray[Any], valid: Mask) -> float:
    """A grey value for invalid pixels that makes the spline ring little beside them."""
    return float(image[valid].mean()) if valid.any() else 0.0


def eroded(mask: Mask, radius: int) -> Mask:
    """Where a whole square around the pixel is true; outside the image counts as true."""
    kernel = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
    return np.asarray(cv2.erode(mask.astype(np.uint8), kernel, borderValue=1), np.bool_)
