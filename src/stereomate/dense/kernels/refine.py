"""Sub-pixel refinement of dense parallaxes: least-squares matching of a plane of parallaxes per pixel.

Around every pixel the left window is explained by the right image: right(x - d, y - e) = gain left + offset,
with d a plane over the window whose inclination comes from the parallaxes found before. The derivatives are
those of the left window (inverse compositional, Baker & Matthews 2004): the normal matrix is made once.
Pixels of the window on other surfaces (parallax too far from the plane, or of another label) take no part.
The right image is a cubic B-spline: cubic convolution shifts fine texture by up to 0.03 px.

The noise of resampled images is correlated between neighbours. Variances are those of the estimate under the
correlation that the residuals themselves show (Newey & West 1987, in two dimensions).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stereomate.dense.kernels.spread import spread_of_residuals
from stereomate.dense.kernels.window import (
    ACROSS,
    ALONG,
    GREY,
    RIGHT,
    UNKNOWNS,
    WEIGHT,
    WINDOW_ROWS,
    inverted,
    left_window,
    resample,
    support,
)
from stereomate.jit import kernel

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]

# Layers of the result.
PARALLAX = 0
ROW_PARALLAX = 1
VARIANCE = 2
COVARIANCE = 3
ROW_VARIANCE = 4
CORRELATION = 5
LAYERS = 6

# Steps end when the parallaxes change by less, pixels.
_CONVERGED = 0.02


@kernel
def _step(window: Floats, middle: float, inverse: Floats, rhs: Floats, solution: Floats) -> float:
    """One step of the match: `rhs` and `solution`; returns the sum of squares before it."""
    rx = ry = rg = r1 = squares = 0.0
    for k in range(window.shape[1]):
        v = (window[RIGHT, k] - middle - window[GREY, k]) * window[WEIGHT, k]
        squares += v * v
        rx += v * window[ALONG, k]
        ry += v * window[ACROSS, k]
        rg += v * window[GREY, k]
        r1 += v
    rhs[0] = rx
    rhs[1] = ry
    rhs[2] = rg
    rhs[3] = r1
    for a in range(UNKNOWNS):
        solution[a] = inverse[a, 0] * rx + inverse[a, 1] * ry + inverse[a, 2] * rg + inverse[a, 3] * r1
    return squares


@kernel
def _matched(
    right: Floats32,
    place: tuple[int, int, int],
    plane: Floats,
    start: tuple[float, float],
    strip: Floats,
    window: Floats,
    how: tuple[float, int],
    limits: tuple[float, float, float],
    inverse: Floats,
    rhs: Floats,
    solution: Floats,
) -> tuple[float, float, float]:
    """Iterate one match: shift to the plane, row parallax, sum of squares before the last step.

    Parameters
    ----------
    place : (row, col, radius)
    start : (shift, row parallax)
    how : (grey value of the centre, iterations)
    limits : (largest change, largest row parallax, change of the plane from the initial parallax)

    Returns
    -------
    NaN first where it does not converge, or wanders off.
    """
    row, col, radius = place
    shift, rise = start
    middle, iterations = how
    squares = 0.0
    for _ in range(iterations):
        if not resample(right, row, col, radius, plane, shift, rise, strip, window):
            break
        squares = _step(window, middle, inverse, rhs, solution)
        shift += solution[0]
        rise += solution[1]
        if abs(limits[2] + shift) > limits[0] or abs(rise) > limits[1] or shift != shift:
            break
        if abs(solution[0]) < _CONVERGED and abs(solution[1]) < _CONVERGED:
            return shift, rise, squares
    return math.nan, math.nan, squares


@kernel
def refine_window(
    left: Floats32,
    right: Floats32,
    initial: Floats32,
    labels: NDArray[np.uint16],
    right_free: NDArray[np.uint8],
    radius: int,
    step: int,
    iterations: int,
    largest_change: float,
    largest_row_parallax: float,
    least_correlation: float,
    out: Floats32,
) -> None:
    """Refine parallaxes of a whole window.

    Parameters
    ----------
    left : (rows, cols)
        Grey values.
    right : (rows, cols)
        Coefficients of the cubic B-spline through those of the right image.
    initial : (rows, cols)
        Parallaxes left minus right to whole pixels or better; NaN where there are none.
    labels : (rows, cols)
        Pixels of different labels are not matched together.
    right_free : (rows, cols)
        1 where a window of the right image around the pixel is valid.
    radius : int
        Half of the window's edge.
    step : int
        Every so many rows and columns, beginning in the middle of the first mesh.
    iterations : int
    largest_change, largest_row_parallax : float
        A pixel that wanders further from its initial parallax, or across the rows, is given up.
    least_correlation : float
    out : (LAYERS, (rows + step - 1) // step, (cols + step - 1) // step)
        NaN where nothing was found.
    """
    rows, cols = left.shape
    size = 2 * radius + 1
    window = np.empty((WINDOW_ROWS, size * size))
    contributions = np.empty((2, size * size))
    sums = np.empty((2, size + 2, size + 2))
    padded = np.zeros((size + 4, size + 4))
    lines = np.empty((size + 4, size + 2))
    plane = np.empty(3)
    normal = np.empty((UNKNOWNS, UNKNOWNS))
    inverse = np.empty((UNKNOWNS, UNKNOWNS))
    work = np.empty((UNKNOWNS + 1, UNKNOWNS))
    strip = np.empty(4 * size + 8)
    rhs = np.empty(UNKNOWNS)
    solution = np.empty(UNKNOWNS)
    spread = np.empty(3)
    out[:] = np.nan
    for m in range(out.shape[1]):
        row = m * step + step // 2
        if row < radius + 1 or row >= rows - radius - 1:
            continue
        fall = 0.0
        before = np.nan
        for n in range(out.shape[2]):
            col = n * step + step // 2
            if col < radius + 1 or col >= cols - radius - 1:
                continue
            d0 = initial[row, col]
            if d0 != d0:
                continue
            place = round(col - d0)
            if place < 0 or place >= cols or not right_free[row, place]:
                continue
            pixels = support(initial, labels, row, col, radius, window, plane)
            if 2 * pixels < size * size:
                continue
            left_window(left, row, col, radius, window, normal)
            if not inverted(normal, inverse, work):
                continue
            middle = np.float64(left[row, col])
            # the neighbour's result is the best start, if it lies on the same surface
            shift = before - plane[0] if abs(before - plane[0]) < 0.5 else 0.0
            limits = largest_change, largest_row_parallax, plane[0] - d0
            shift, rise, squares = _matched(
                right, (row, col, radius), plane, (shift, fall), strip, window, (middle, iterations), limits,
                inverse, rhs, solution,
            )  # fmt: skip
            if shift != shift:
                continue
            for a in range(UNKNOWNS):
                squares -= solution[a] * rhs[a]
            # share of the right window's variance that the left one explains
            gain = 1.0 + solution[2]
            signal = gain * gain * (normal[2, 2] - normal[2, 3] * normal[2, 3] / normal[3, 3])
            correlation = math.copysign(math.sqrt(signal / (signal + max(squares, 0.0))), gain)
            if not correlation >= least_correlation:
                continue
            spread_of_residuals(
                window, radius, middle, inverse, solution, contributions, sums, padded, lines, spread
            )
            fall = rise
            before = plane[0] + shift
            # neighbouring residuals may happen to cancel: never below a quarter of the plain variance
            plain = 0.25 * max(squares, 0.0) / (pixels - UNKNOWNS)
            out[PARALLAX, m, n] = before
            out[ROW_PARALLAX, m, n] = fall
            out[VARIANCE, m, n] = max(spread[0], plain * inverse[0, 0])
            out[COVARIANCE, m, n] = spread[1]
            out[ROW_VARIANCE, m, n] = max(spread[2], plain * inverse[1, 1])
            out[CORRELATION, m, n] = correlation
