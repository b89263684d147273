"""Least-squares matching of one patch: geometric affine and linear radiometric model (F. Ackermann 1984).

Grey values of the template, a square window on the pixel grid of the left image, are explained by the right
image: ``left(i, j) = offset + gain * right(position + affine (i, j))``. The right image is interpolated by
cubic splines (M. Unser 1999), whose analytical derivatives linearise it. Cubic convolution, as cheap, drags
positions towards half pixels by up to 0.01 px on fine texture; splines by a tenth of that.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereomate.geometry.kernels import solve_symmetric
from stereomate.jit import kernel
from stereomate.measurement.kernels.noise import unit_noise
from stereomate.measurement.kernels.splines import spline_weights

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Image = NDArray[Any]

UNKNOWNS = 8
# Smallest square pivot of the scaled normal equations.
_SINGULAR = 1e-9
# States of a match.
CONVERGED = 0
OUTSIDE = 1
NO_TEXTURE = 2
NOT_CONVERGED = 3
WANDERED = 4
DEFORMED = 5
UNLIKE = 6


@kernel
def _weights(t: float, w: Array, d: Array) -> None:
    """Weights of the four coefficients at fraction t, and their derivatives."""
    w[0], w[1], w[2], w[3] = spline_weights(t)
    rest = 1.0 - t
    d[0] = -0.5 * rest * rest
    d[1] = 1.5 * t * t - 2.0 * t
    d[2] = -1.5 * t * t + t + 0.5
    d[3] = 0.5 * t * t


@kernel
def spline_with_gradient(
    image: Image, x: float, y: float, wx: Array, dx: Array, wy: Array, dy: Array
) -> tuple[float, float, float, bool]:
    """(value, d/dx, d/dy, inside) at pixel (x, y), centres at +0.5, from spline coefficients.

    The four arrays (4,) are scratch.
    """
    u, v = x - 0.5, y - 0.5
    c, r = int(np.floor(u)), int(np.floor(v))
    if not (c >= 1 and r >= 1 and c + 2 < image.shape[1] and r + 2 < image.shape[0]):
        return 0.0, 0.0, 0.0, False
    _weights(u - c, wx, dx)
    _weights(v - r, wy, dy)
    value = by_x = by_y = 0.0
    for j in range(4):
        row = slope = 0.0
        for i in range(4):
            g = float(image[r - 1 + j, c - 1 + i])
            row += wx[i] * g
            slope += dx[i] * g
        value += wy[j] * row
        by_x += wy[j] * slope
        by_y += dy[j] * row
    return value, by_x, by_y, True


@kernel
def _template(image: Image, column: int, row: int, radius: int, patch: Array) -> tuple[bool, float]:
    """Copy the window around a pixel into `patch`; (inside, its standard deviation)."""
    if not (
        column >= radius
        and row >= radius
        and column + radius < image.shape[1]
        and row + radius < image.shape[0]
    ):
        return False, 0.0
    total = squares = 0.0
    side = 2 * radius + 1
    for j in range(side):
        for i in range(side):
            g = float(image[row - radius + j, column - radius + i])
            patch[j, i] = g
            total += g
            squares += g * g
    mean = total / (side * side)
    return True, np.sqrt(max(squares / (side * side) - mean * mean, 0.0))


@kernel
def _normal_equations(
    patch: Array, right: Image, radius: int, p: Array, normal: Array, rhs: Array, sums: Array
) -> bool:
    """Equations of one step at parameters p (x, a, b, y, c, d, gain, offset); sums for the correlation.

    Returns False where the window leaves the right image.
    """
    wx, dx, wy, dy = np.empty(4), np.empty(4), np.empty(4), np.empty(4)
    a = np.empty(UNKNOWNS)
    normal[:] = 0.0
    rhs[:] = 0.0
    sums[:] = 0.0
    gain = p[6]
    for j in range(2 * radius + 1):
        v = float(j - radius)
        for i in range(2 * radius + 1):
            u = float(i - radius)
            g, gx, gy, inside = spline_with_gradient(
                right, p[0] + p[1] * u + p[2] * v, p[3] + p[4] * u + p[5] * v, wx, dx, wy, dy
            )
            if not inside:
                return False
            a[0], a[1], a[2] = gain * gx, gain * gx * u, gain * gx * v
            a[3], a[4], a[5] = gain * gy, gain * gy * u, gain * gy * v
            a[6], a[7] = g, 1.0
            t = patch[j, i]
            w = t - gain * g - p[7]
            for m in range(UNKNOWNS):
                for k in range(m + 1):
                    normal[m, k] += a[m] * a[k]
                rhs[m] += a[m] * w
            sums[0] += w * w
            sums[1] += t
            sums[2] += t * t
            sums[3] += g
            sums[4] += g * g
            sums[5] += t * g
    for m in range(UNKNOWNS):
        for k in range(m):
            normal[k, m] = normal[m, k]
    return True


@kernel
def _correlation(sums: Array, count: int) -> float:
    st = sums[2] - sums[1] * sums[1] / count
    sg = sums[4] - sums[3] * sums[3] / count
    if st <= 0.0 or sg <= 0.0:
        return 0.0
    correlation: float = (sums[5] - sums[1] * sums[3] / count) / np.sqrt(st * sg)
    return correlation


@kernel
def _position_covariance(
    right: Image,
    radius: int,
    p: Array,
    inverse: Array,
    squares: float,
    taps: tuple[Array, Array],
    covariance: Array,
) -> None:
    """Covariance (3,) of the position from the square sum of the residuals; noise as `kernels.noise` says."""
    side = 2 * radius + 1
    count = side * side
    wx, dx, wy, dy = np.empty(4), np.empty(4), np.empty(4), np.empty(4)
    coefficients = np.empty((2, side, side))
    gain = p[6]
    for j in range(side):
        v = float(j - radius)
        for i in range(side):
            u = float(i - radius)
            g, gx, gy, _ = spline_with_gradient(
                right, p[0] + p[1] * u + p[2] * v, p[3] + p[4] * u + p[5] * v, wx, dx, wy, dy
            )
            gx, gy = gain * gx, gain * gy
            for k in range(2):
                q = inverse[3 * k]
                coefficients[k, j, i] = (
                    gx * (q[0] + q[1] * u + q[2] * v) + gy * (q[3] + q[4] * u + q[5] * v) + q[6] * g + q[7]
                )
    noise = np.empty(4)
    unit_noise(coefficients, radius, p, taps[0], taps[1], noise)
    # tr HS: every unknown takes as much of the noise as the two of the position do on average, for all but
    # gain and offset are gradients times a position in the window.
    taken = 0.5 * UNKNOWNS * (noise[0] / inverse[0, 0] + noise[2] / inverse[3, 3])
    variance = squares / max(noise[3] - taken, (count - UNKNOWNS) / count * 0.1 * noise[3])
    covariance[0], covariance[1], covariance[2] = (
        variance * noise[0],
        variance * noise[1],
        variance * noise[2],
    )


@kernel
def match_patch(
    left: Image,
    right: Image,
    column: int,
    row: int,
    p: Array,
    numbers: Array,
    taps: tuple[Array, Array],
    covariance: Array,
    out: Array,
) -> int:
    """Match the window around a left pixel; parameters `p` (8,) start at the prediction and are improved.

    `numbers`: radius, most iterations, last step (px), largest way (px), largest change of the affine part,
    least correlation, least standard deviation of the window. `right` holds the coefficients of a cubic
    spline. `taps`: filters that made `left` and `right` from the raw images. `covariance` (3,): position
    (xx, xy, yy).
    `out` (3,): correlation, standard deviation of a grey value, iterations. Returns the state.
    """
    radius = int(numbers[0])
    side = 2 * radius + 1
    patch = np.empty((side, side))
    inside, deviation = _template(left, column, row, radius, patch)
    if not inside:
        return OUTSIDE
    if deviation < numbers[6]:
        return NO_TEXTURE
    start = p.copy()
    normal, inverse = np.empty((UNKNOWNS, UNKNOWNS)), np.empty((UNKNOWNS, UNKNOWNS))
    rhs, step, sums = np.empty(UNKNOWNS), np.empty(UNKNOWNS), np.empty(6)
    # Gain and offset of the start: by mean and standard deviation.
    p[6], p[7] = 1.0, 0.0
    if not _normal_equations(patch, right, radius, p, normal, rhs, sums):
        return OUTSIDE
    count = side * side
    spread = np.sqrt(max(sums[4] / count - (sums[3] / count) ** 2, 0.0))
    if spread < numbers[6]:
        return NO_TEXTURE
    p[6] = max(deviation / spread, 0.1)
    p[7] = sums[1] / count - p[6] * sums[3] / count
    state = NOT_CONVERGED
    for iteration in range(int(numbers[1])):
        out[2] = iteration + 1
        if not _normal_equations(patch, right, radius, p, normal, rhs, sums):
            return OUTSIDE
        if not solve_symmetric(normal, rhs, step, inverse, _SINGULAR):
            return NO_TEXTURE
        way = max(abs(step[0]), abs(step[3]))
        turn = 0.0
        for k in (1, 2, 4, 5):
            turn = max(turn, abs(step[k]))
        # Beyond a pixel the linearisation says no more than the direction.
        shrink = min(1.0, 1.0 / max(way, 1e-12), 0.1 / max(turn, 1e-12))
        for k in range(UNKNOWNS):
            p[k] += step[k] * shrink
        if np.hypot(p[0] - start[0], p[3] - start[3]) > numbers[3]:
            return WANDERED
        for k in (1, 2, 4, 5):
            if abs(p[k] - start[k]) > numbers[4]:
                return DEFORMED
        if way < numbers[2] and turn * radius < 10.0 * numbers[2]:
            state = CONVERGED
            break
    if not _normal_equations(patch, right, radius, p, normal, rhs, sums):
        return OUTSIDE
    if not solve_symmetric(normal, rhs, step, inverse, _SINGULAR):
        return NO_TEXTURE
    variance = sums[0] / (count - UNKNOWNS)
    out[0] = _correlation(sums, count)
    out[1] = np.sqrt(variance)
    _position_covariance(right, radius, p, inverse, sums[0], taps, covariance)
    if state == CONVERGED and (out[0] < numbers[5] or p[6] <= 0.0):
        return UNLIKE
    return state


@kernel
def match_patches(
    left: Image,
    right: Image,
    columns: Ints,
    rows: Ints,
    parameters: Array,
    numbers: Array,
    taps: tuple[Array, Array],
    covariance: Array,
    out: Array,
    state: Ints,
) -> None:
    """`match_patch` for n points."""
    for k in range(columns.shape[0]):
        if np.isfinite(parameters[k, 0]) and np.isfinite(parameters[k, 3]):
            state[k] = match_patch(
                left, right, columns[k], rows[k], parameters[k], numbers, taps, covariance[k], out[k]
            )
        else:
            state[k] = OUTSIDE
