"""Least-squares matching: positions to a few hundredths of a pixel, with their covariance.

The template is a window of whole pixels of the left image (no interpolation there); the right image is moved,
deformed by an affine transformation and fitted in brightness and contrast until the grey value differences
are smallest (F. Ackermann 1984, A. Grün 1985).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import ImageError, InputError
from stereomate.measurement.kernels import least_squares as kernels

Array = NDArray[np.float64]

# Neighbours on either side in the filter for spline coefficients: the next ones weigh less than 1e-6.
_SPLINE_REACH: Final = 10
# Taps smaller than this part of the largest one carry no noise that counts.
_LEAST_TAP: Final = 2e-3

STATES: Final = {
    kernels.CONVERGED: "converged",
    kernels.OUTSIDE: "the window leaves a photograph",
    kernels.NO_TEXTURE: "no texture",
    kernels.NOT_CONVERGED: "not converged",
    kernels.WANDERED: "wandered off",
    kernels.DEFORMED: "deformed",
    kernels.UNLIKE: "the windows are not alike",
}


@dataclass(frozen=True)
class LeastSquaresOptions:
    """Window, iteration and what counts as a match.

    Parameters
    ----------
    radius_px : int
        Of the window: its side is twice this plus one.
    smoothing_px : float
        Standard deviation of the Gaussian both images are smoothed with first, against noise and aliasing.
    max_iterations : int
        Steps at most.
    last_step_px : float
        Smaller steps end the iteration.
    largest_way_px : float
        From the start; farther away it is another point.
    largest_deformation : float
        Change of an affine coefficient.
    least_correlation : float
        Of the windows after matching.
    least_contrast : float
        Standard deviation of grey values in the window.
    """

    radius_px: int = 7
    smoothing_px: float = 0.7
    max_iterations: int = 30
    last_step_px: float = 0.005
    largest_way_px: float = 4.0
    largest_deformation: float = 0.4
    least_correlation: float = 0.7
    least_contrast: float = 2.0

    def __post_init__(self) -> None:
        if not 2 <= self.radius_px <= 100:
            raise InputError("must lie between 2 and 100", field="radius_px", value=self.radius_px)
        if self.max_iterations < 1:
            raise InputError("must be at least 1", field="max_iterations", value=self.max_iterations)
        if not 0.0 <= self.smoothing_px <= 10.0:
            raise InputError("must lie between 0 and 10", field="smoothing_px", value=self.smoothing_px)
        numbers = (self.last_step_px, self.largest_way_px, self.largest_deformation)
        if not all(np.isfinite(v) and v > 0.0 for v in numbers):
            raise InputError("must be positive", field="last_step_px, largest_way_px, largest_deformation")


@dataclass(frozen=True)
class LeastSquaresMatches:
    """Result for n points.

    Parameters
    ----------
    left_px, right_px : ndarray, shape (n, 2)
        Column and row. The left ones are the centres of the pixels in which the given points lie.
    covariance_px : ndarray, shape (n, 3)
        Of the right position (xx, xy, yy) from the grey value residuals; NaN where not matched. The noise of
        the pixels is taken as white and the same in both images; that smoothing correlates it and that
        interpolation takes part of it away is propagated rigorously (`measurement.kernels.noise`).
    affine : ndarray, shape (n, 2, 2)
        Right from left pixel differences.
    correlation, grey_deviation : ndarray, shape (n,)
        Correlation coefficient of the windows, standard deviation of a grey value difference.
    state : ndarray of int, shape (n,)
        Key of `STATES`; 0 is a match.
    """

    left_px: Array
    right_px: Array
    covariance_px: Array
    affine: Array
    correlation: Array
    grey_deviation: Array
    state: NDArray[np.int64]

    @property
    def matched(self) -> NDArray[np.bool_]:
        """Which points were matched, shape (n,)."""
        matched: NDArray[np.bool_] = self.state == kernels.CONVERGED
        return matched

    def failures(self) -> dict[str, int]:
        """How many points failed, by reason."""
        counts = {text: int(np.count_nonzero(self.state == code)) for code, text in STATES.items() if code}
        return {text: count for text, count in counts.items() if count}


def match_least_squares(
    left: NDArray[Any],
    right: NDArray[Any],
    left_px: ArrayLike,
    right_px: ArrayLike,
    affine: ArrayLike | None = None,
    options: LeastSquaresOptions | None = None,
) -> LeastSquaresMatches:
    """Refine approximate matches.

    Parameters
    ----------
    left, right : ndarray, shape (rows, cols)
        Grey images of any number type.
    left_px, right_px : array_like, shape (n, 2)
        Approximate matches, to a few pixels; NaN on the right: not expected there.
    affine : array_like, shape (2, 2) or (n, 2, 2), optional
        Right from left pixel differences, approximately (a turn of 180° is too much to find by itself).
    options : LeastSquaresOptions, optional

    Raises
    ------
    ImageError
        If an image is not grey.
    InputError
        If shapes differ or a left position is not finite.
    """
    options = options or LeastSquaresOptions()
    for name, image in (("left", left), ("right", right)):
        if image.ndim != 2:
            raise ImageError("must be rows x columns of grey values", field=name, value=image.shape)
    here, there = np.asarray(left_px, dtype=np.float64), np.asarray(right_px, dtype=np.float64)
    if here.ndim != 2 or here.shape[1] != 2 or there.shape != here.shape:
        raise InputError("must both have the shape (n, 2)", field="left_px, right_px", value=there.shape)
    if not np.isfinite(here).all():
        raise InputError("must be finite", field="left_px")
    n = len(here)
    matrix = np.broadcast_to(np.eye(2) if affine is None else np.asarray(affine, dtype=np.float64), (n, 2, 2))
    cells = np.floor(here)
    centres = cells + 0.5
    start = there + np.einsum("nij,nj->ni", matrix, centres - here)
    parameters = np.zeros((n, kernels.UNKNOWNS))
    parameters[:, 0], parameters[:, 3] = start[:, 0], start[:, 1]
    parameters[:, 1:3], parameters[:, 4:6] = matrix[:, 0], matrix[:, 1]
    smoothing = _smoothing(options.smoothing_px)
    spline = _spline_filter(smoothing)
    covariance, out = np.full((n, 3), np.nan), np.full((n, 3), np.nan)
    state = np.zeros(n, dtype=np.int64)
    kernels.match_patches(
        _filtered(left, smoothing),
        _filtered(right, spline),
        cells[:, 0].astype(np.int64),
        cells[:, 1].astype(np.int64),
        parameters,
        np.array(
            [
                options.radius_px,
                options.max_iterations,
                options.last_step_px,
                options.largest_way_px,
                options.largest_deformation,
                options.least_correlation,
                options.least_contrast,
            ],
            dtype=np.float64,
        ),
        (_without_tails(smoothing), _without_tails(spline)),
        covariance,
        out,
        state,
    )
    failed = state != kernels.CONVERGED
    position = parameters[:, [0, 3]].copy()
    position[failed] = np.nan
    covariance[failed] = np.nan
    final = np.stack([parameters[:, 1:3], parameters[:, 4:6]], axis=1)
    return LeastSquaresMatches(centres, position, covariance, final, out[:, 0], out[:, 1], state)


def _smoothing(sigma: float) -> Array:
    """Gaussian along one direction."""
    if sigma <= 0.0:
        return np.ones(1)
    # Four standard deviations on either side.
    return np.asarray(cv2.getGaussianKernel(2 * math.ceil(4.0 * sigma) + 1, sigma, cv2.CV_64F)).ravel()


def _spline_filter(smoothing: Array) -> Array:
    """Smoothing and the inverse of the sampled cubic B-spline: √3 z^|k|, z = √3 - 2 (M. Unser 1999)."""
    powers = (math.sqrt(3.0) - 2.0) ** np.abs(np.arange(-_SPLINE_REACH, _SPLINE_REACH + 1))
    return np.convolve(smoothing, powers / powers.sum())


def _without_tails(taps: Array) -> Array:
    """The filter without what does not matter for the propagation of noise."""
    half = len(taps) // 2
    kept = int(np.abs(np.flatnonzero(np.abs(taps) > _LEAST_TAP * np.abs(taps).max()) - half).max())
    return np.ascontiguousarray(taps[half - kept : half + kept + 1])


def _filtered(image: NDArray[Any], taps: Array) -> NDArray[np.float32]:
    single = np.ascontiguousarray(image, dtype=np.float32)
    if len(taps) == 1:
        return single
    filtered: NDArray[np.float32] = cv2.sepFilter2D(single, -1, taps, taps)
    return filtered
