"""How the noise of the pixels goes into a least-squares match.

Residuals of a match are not white: both images were smoothed, which correlates the noise of neighbouring
pixels, and the right one was interpolated, which smooths it once more, by an amount that depends on the
fraction of a pixel. So ``(A'A)^-1 A'`` is applied to the noise as it is. A position is a linear combination
``c`` of the window's differences ``t - g s``; t and s are linear in the raw grey values, so c is carried back
to them, by the transposed interpolation and the transposed smoothing. There the noise is white, and the
variance is the sum of the squares of what arrives. The same sum over all pixels and unknowns says how much
noise the residuals keep: ``E(v'v) = sigma^2 (tr S - tr H S)`` with S the covariance of the differences for
unit noise and H = A (A'A)^-1 A'.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import kernel
from stereomate.measurement.kernels.splines import spline_weights

Array = NDArray[np.float64]


@kernel
def _smoothed_products(field: Array, taps: Array, out: Array) -> None:
    """Add the sums xx, xy, yy of two fields (2, rows, cols) after smoothing with symmetric taps to `out`."""
    _, rows, cols = field.shape
    half = taps.shape[0] // 2
    across = np.zeros((2, rows, cols + 2 * half))
    for k in range(2):
        for j in range(rows):
            for i in range(cols):
                value = field[k, j, i]
                for m in range(taps.shape[0]):
                    across[k, j, i + m] += value * taps[m]
    column = np.empty((2, rows + 2 * half))
    for i in range(cols + 2 * half):
        column[:] = 0.0
        for k in range(2):
            for j in range(rows):
                value = across[k, j, i]
                for m in range(taps.shape[0]):
                    column[k, j + m] += value * taps[m]
        for j in range(rows + 2 * half):
            out[0] += column[0, j] * column[0, j]
            out[1] += column[0, j] * column[1, j]
            out[2] += column[1, j] * column[1, j]


@kernel
def _autocorrelation(taps: Array, r: Array) -> None:
    """Covariance of smoothed unit noise at lags 0 to 3, r (4,), in one direction."""
    for lag in range(4):
        r[lag] = 0.0
        for m in range(taps.shape[0] - lag):
            r[lag] += taps[m] * taps[m + lag]


@kernel
def _kept(w: Array, r: Array) -> float:
    """Variance that interpolation with weights w (4,) leaves of noise with the covariance r (4,)."""
    kept = 0.0
    for a in range(4):
        for b in range(4):
            kept += w[a] * w[b] * r[abs(a - b)]
    return kept


@kernel
def unit_noise(
    coefficients: Array, radius: int, p: Array, left_taps: Array, right_taps: Array, out: Array
) -> None:
    """What white noise of standard deviation 1 in every raw pixel of both images does.

    `coefficients` (2, side, side): of x and y by the grey value differences. `p` (8,): parameters of the
    match. Taps: filters, odd and symmetric, that the left image and the spline coefficients of the right one
    went through, in each direction. `out` (4,): variance of x, covariance, variance of y, and the trace of
    the differences' covariance.
    """
    side = 2 * radius + 1
    gain = p[6]
    out[:] = 0.0
    _smoothed_products(coefficients, left_taps, out)
    low_x = low_y = np.inf
    high_x = high_y = -np.inf
    for v in (-float(radius), float(radius)):
        for u in (-float(radius), float(radius)):
            x, y = p[0] + p[1] * u + p[2] * v, p[3] + p[4] * u + p[5] * v
            low_x, high_x = min(low_x, x), max(high_x, x)
            low_y, high_y = min(low_y, y), max(high_y, y)
    left, top = int(np.floor(low_x - 0.5)) - 1, int(np.floor(low_y - 0.5)) - 1
    right, bottom = int(np.floor(high_x - 0.5)) + 2, int(np.floor(high_y - 0.5)) + 2
    field = np.zeros((2, bottom - top + 1, right - left + 1))
    wx, wy, r = np.empty(4), np.empty(4), np.empty(4)
    _autocorrelation(left_taps, r)
    trace = side * side * r[0] * r[0]
    _autocorrelation(right_taps, r)
    for j in range(side):
        v = float(j - radius)
        for i in range(side):
            u = float(i - radius)
            x, y = p[0] + p[1] * u + p[2] * v - 0.5, p[3] + p[4] * u + p[5] * v - 0.5
            col, row = int(np.floor(x)), int(np.floor(y))
            wx[0], wx[1], wx[2], wx[3] = spline_weights(x - col)
            wy[0], wy[1], wy[2], wy[3] = spline_weights(y - row)
            trace += gain * gain * _kept(wx, r) * _kept(wy, r)
            by_x, by_y = gain * coefficients[0, j, i], gain * coefficients[1, j, i]
            for m in range(4):
                for k in range(4):
                    w = wy[m] * wx[k]
                    field[0, row - 1 - top + m, col - 1 - left + k] += w * by_x
                    field[1, row - 1 - top + m, col - 1 - left + k] += w * by_y
    _smoothed_products(field, right_taps, out)
    out[3] = trace
