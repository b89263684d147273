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

from stereomate.jit import inline_kernel, kernel

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

# Rows of the array that holds a window: derivatives along and across the rows, grey value less that of the
# centre, weight, resampled right image.
_ALONG = 0
_ACROSS = 1
_GREY = 2
_WEIGHT = 3
_RIGHT = 4
_WINDOW = 5

# Unknowns: parallax, row parallax, gain, offset.
_UNKNOWNS = 4
# A pixel belongs to the surface of the window's centre if its parallax differs by less than this, plus so
# much per pixel of distance.
_SAME_PX = 1.0
_SAME_SLOPE = 0.4
# Inclinations of the plane below this count as none: at the edge of a window a tenth of a pixel.
_LEVEL = 0.02
# Steps end when the parallaxes change by less, pixels.
_CONVERGED = 0.02
# Normal matrices worse than this have no texture across some direction.
_PIVOT = 1e-6


@inline_kernel
def spline_weights(t: float) -> tuple[float, float, float, float]:
    """Weights of the four neighbouring coefficients of a cubic B-spline at fraction t (M. Unser 1999)."""
    u = 1.0 - t
    t2 = t * t
    u2 = u * u
    return (
        u2 * u / 6.0,
        (4.0 - 3.0 * t2 * (1.0 + u)) / 6.0,
        (4.0 - 3.0 * u2 * (1.0 + t)) / 6.0,
        t2 * t / 6.0,
    )


@kernel
def _support(
    initial: Floats32,
    labels: NDArray[np.uint16],
    row: int,
    col: int,
    radius: int,
    window: Floats,
    plane: Floats,
) -> int:
    """Pixels of the window that lie on the surface of its centre, and the plane of their parallaxes.

    `plane` gets (value at the centre, per column, per row). Returns how many pixels take part.
    """
    centre = initial[row, col]
    label = labels[row, col]
    n = 0
    sj = si = sjj = sij = sii = sd = sjd = sid = 0.0
    k = 0
    for i in range(-radius, radius + 1):
        for j in range(-radius, radius + 1):
            d = initial[row + i, col + j] - centre
            good = labels[row + i, col + j] == label and abs(d) <= _SAME_PX + _SAME_SLOPE * max(
                abs(i), abs(j)
            )
            window[_WEIGHT, k] = 1.0 if good else 0.0
            k += 1
            if good:
                n += 1
                sj += j
                si += i
                sjj += j * j
                sij += i * j
                sii += i * i
                sd += d
                sjd += j * d
                sid += i * d
    plane[0] = centre
    plane[1] = 0.0
    plane[2] = 0.0
    if n < 6:
        return n
    mj, mi, md = sj / n, si / n, sd / n
    jj, ij, ii = sjj - n * mj * mj, sij - n * mi * mj, sii - n * mi * mi
    jd, idd = sjd - n * mj * md, sid - n * mi * md
    determinant = jj * ii - ij * ij
    if determinant > 1e-3 * max(jj * ii, 1.0):
        along = (jd * ii - idd * ij) / determinant
        across = (idd * jj - jd * ij) / determinant
        # what the noise of the initial parallaxes makes of level ground is not resampled, which is dear
        if abs(along) > _LEVEL or abs(across) > _LEVEL:
            plane[1] = along
            plane[2] = across
    plane[0] = centre + md - plane[1] * mj - plane[2] * mi
    return n


@kernel
def _inverted(normal: Floats, inverse: Floats, work: Floats) -> bool:
    """Inverse of the symmetric normal matrix by Gauss-Jordan on its scaled form; False if it is singular."""
    n = normal.shape[0]
    scale = work[n]
    for i in range(n):
        if not normal[i, i] > 0.0:
            return False
        scale[i] = 1.0 / math.sqrt(normal[i, i])
    for i in range(n):
        for j in range(n):
            work[i, j] = normal[i, j] * scale[i] * scale[j]
            inverse[i, j] = 1.0 if i == j else 0.0
    for k in range(n):
        pivot = work[k, k]
        if not pivot > _PIVOT:
            return False
        for j in range(n):
            work[k, j] /= pivot
            inverse[k, j] /= pivot
        for i in range(n):
            if i != k:
                factor = work[i, k]
                for j in range(n):
                    work[i, j] -= factor * work[k, j]
                    inverse[i, j] -= factor * inverse[k, j]
    for i in range(n):
        for j in range(n):
            inverse[i, j] *= scale[i] * scale[j]
    return True


@kernel
def _resample(
    right: Floats32,
    row: int,
    col: int,
    radius: int,
    plane: Floats,
    shift: float,
    row_shift: float,
    strip: Floats,
    window: Floats,
) -> bool:
    """The right image over the window at (x - plane - shift, y - row_shift); False if it leaves the image."""
    size = 2 * radius + 1
    fall = math.floor(-row_shift)
    a, b, c, d = spline_weights(-row_shift - fall)
    top = row - radius + fall - 1
    if top < 0 or top + size + 3 > right.shape[0]:
        return False
    reach = radius * (abs(plane[1]) + abs(plane[2]))
    middle = col - plane[0] - shift
    first = math.floor(middle - radius - reach) - 1
    last = math.floor(middle + radius + reach) + 3
    if first < 0 or last > right.shape[1] or last - first > strip.size:
        return False
    pace = 1.0 - plane[1]
    for i in range(size):
        r = top + i
        for x in range(first, last):
            strip[x - first] = (
                a * right[r, x] + b * right[r + 1, x] + c * right[r + 2, x] + d * right[r + 3, x]
            )
        start = middle - radius * pace - plane[2] * (i - radius) - first
        if pace == 1.0:
            at = int(start)
            p, q, s, t = spline_weights(start - at)
            for j in range(size):
                window[_RIGHT, i * size + j] = (
                    p * strip[at + j - 1] + q * strip[at + j] + s * strip[at + j + 1] + t * strip[at + j + 2]
                )
            continue
        for j in range(size):
            x = start + j * pace
            at = int(x)
            p, q, s, t = spline_weights(x - at)
            window[_RIGHT, i * size + j] = (
                p * strip[at - 1] + q * strip[at] + s * strip[at + 1] + t * strip[at + 2]
            )
    return True


@kernel
def _left_window(left: Floats32, row: int, col: int, radius: int, window: Floats, normal: Floats) -> None:
    """Derivatives and grey values of the window, and the normal matrix over its support."""
    middle = left[row, col]
    n = sx = sy = sg = sxx = sxy = sxg = syy = syg = sgg = 0.0
    k = 0
    for r in range(row - radius, row + radius + 1):
        for c in range(col - radius, col + radius + 1):
            x = 0.5 * (left[r, c + 1] - left[r, c - 1])
            y = 0.5 * (left[r + 1, c] - left[r - 1, c])
            g = left[r, c] - middle
            w = window[_WEIGHT, k]
            window[_ALONG, k] = x
            window[_ACROSS, k] = y
            window[_GREY, k] = g
            k += 1
            n += w
            sx += w * x
            sy += w * y
            sg += w * g
            sxx += w * x * x
            sxy += w * x * y
            sxg += w * x * g
            syy += w * y * y
            syg += w * y * g
            sgg += w * g * g
    normal[0, 0] = sxx
    normal[0, 1] = normal[1, 0] = sxy
    normal[0, 2] = normal[2, 0] = sxg
    normal[0, 3] = normal[3, 0] = sx
    normal[1, 1] = syy
    normal[1, 2] = normal[2, 1] = syg
    normal[1, 3] = normal[3, 1] = sy
    normal[2, 2] = sgg
    normal[2, 3] = normal[3, 2] = sg
    normal[3, 3] = n


@kernel
def _step(window: Floats, middle: float, inverse: Floats, rhs: Floats, solution: Floats) -> float:
    """One step of the match: `rhs` and `solution`; returns the sum of squares before it."""
    rx = ry = rg = r1 = squares = 0.0
    for k in range(window.shape[1]):
        v = (window[_RIGHT, k] - middle - window[_GREY, k]) * window[_WEIGHT, k]
        squares += v * v
        rx += v * window[_ALONG, k]
        ry += v * window[_ACROSS, k]
        rg += v * window[_GREY, k]
        r1 += v
    rhs[0] = rx
    rhs[1] = ry
    rhs[2] = rg
    rhs[3] = r1
    for a in range(_UNKNOWNS):
        solution[a] = inverse[a, 0] * rx + inverse[a, 1] * ry + inverse[a, 2] * rg + inverse[a, 3] * r1
    return squares


@kernel
def _box_sums(values: Floats, size: int, padded: Floats, lines: Floats, out: Floats) -> None:
    """Sums over all 3 x 3 pixels of a window, those at its border included: `out` (size + 2, size + 2).

    `padded` (size + 4, size + 4) has a border of two zeros; `lines` (size + 4, size + 2) is scratch.
    """
    for i in range(size):
        for j in range(size):
            padded[i + 2, j + 2] = values[i * size + j]
    for i in range(size + 4):
        for j in range(size + 2):
            lines[i, j] = padded[i, j] + padded[i, j + 1] + padded[i, j + 2]
    for i in range(size + 2):
        for j in range(size + 2):
            out[i, j] = lines[i, j] + lines[i + 1, j] + lines[i + 2, j]


@kernel
def _spread(
    window: Floats,
    radius: int,
    middle: float,
    inverse: Floats,
    solution: Floats,
    contributions: Floats,
    sums: Floats,
    padded: Floats,
    lines: Floats,
    out: Floats,
) -> None:
    """Variances and covariance of both parallaxes under the correlation of neighbouring residuals.

    The estimate is a sum of residuals with weights: their contributions. Products of contributions up to two
    pixels apart are summed, tapered linearly along both axes: a ninth of the products of all sums over 3 x 3
    pixels. As all contributions together are zero, a part is lost: the share of the pairs that are summed.
    """
    size = 2 * radius + 1
    n = 0.0
    for k in range(window.shape[1]):
        w = window[_WEIGHT, k]
        x, y, g = window[_ALONG, k], window[_ACROSS, k], window[_GREY, k]
        v = window[_RIGHT, k] - middle - g
        v = w * (v - (solution[0] * x + solution[1] * y + solution[2] * g + solution[3]))
        n += w
        contributions[0, k] = v * (inverse[0, 0] * x + inverse[0, 1] * y + inverse[0, 2] * g + inverse[0, 3])
        contributions[1, k] = v * (inverse[1, 0] * x + inverse[1, 1] * y + inverse[1, 2] * g + inverse[1, 3])
    for a in range(2):
        _box_sums(contributions[a], size, padded, lines, sums[a])
    # pairs of each pixel, tapered; what is cut off at the border of the window is a few per cent
    pairs = 9.0 / n
    xx = xy = yy = 0.0
    for i in range(size + 2):
        for j in range(size + 2):
            xx += sums[0, i, j] * sums[0, i, j]
            xy += sums[0, i, j] * sums[1, i, j]
            yy += sums[1, i, j] * sums[1, i, j]
    kept = 9.0 * (1.0 - pairs) * (n - _UNKNOWNS) / n
    out[0] = xx / kept
    out[1] = xy / kept
    out[2] = yy / kept


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
    window = np.empty((_WINDOW, size * size))
    contributions = np.empty((2, size * size))
    sums = np.empty((2, size + 2, size + 2))
    padded = np.zeros((size + 4, size + 4))
    lines = np.empty((size + 4, size + 2))
    plane = np.empty(3)
    normal = np.empty((_UNKNOWNS, _UNKNOWNS))
    inverse = np.empty((_UNKNOWNS, _UNKNOWNS))
    work = np.empty((_UNKNOWNS + 1, _UNKNOWNS))
    strip = np.empty(4 * size + 8)
    rhs = np.empty(_UNKNOWNS)
    solution = np.empty(_UNKNOWNS)
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
            pixels = _support(initial, labels, row, col, radius, window, plane)
            if 2 * pixels < size * size:
                continue
            _left_window(left, row, col, radius, window, normal)
            if not _inverted(normal, inverse, work):
                continue
            middle = np.float64(left[row, col])
            # the neighbour's result is the best start, if it lies on the same surface
            shift = before - plane[0] if abs(before - plane[0]) < 0.5 else 0.0
            rise = fall
            good = False
            squares = 0.0
            for _ in range(iterations):
                if not _resample(right, row, col, radius, plane, shift, rise, strip, window):
                    break
                squares = _step(window, middle, inverse, rhs, solution)
                shift += solution[0]
                rise += solution[1]
                far = abs(plane[0] + shift - d0) > largest_change or abs(rise) > largest_row_parallax
                good = abs(solution[0]) < _CONVERGED and abs(solution[1]) < _CONVERGED
                if far or good or shift != shift:
                    good = good and not far
                    break
            if not good:
                continue
            for a in range(_UNKNOWNS):
                squares -= solution[a] * rhs[a]
            # share of the right window's variance that the left one explains
            gain = 1.0 + solution[2]
            signal = gain * gain * (normal[2, 2] - normal[2, 3] * normal[2, 3] / normal[3, 3])
            correlation = math.copysign(math.sqrt(signal / (signal + max(squares, 0.0))), gain)
            if not correlation >= least_correlation:
                continue
            _spread(window, radius, middle, inverse, solution, contributions, sums, padded, lines, spread)
            fall = rise
            before = plane[0] + shift
            # neighbouring residuals may happen to cancel: never below a quarter of the plain variance
            plain = 0.25 * max(squares, 0.0) / (pixels - _UNKNOWNS)
            out[PARALLAX, m, n] = before
            out[ROW_PARALLAX, m, n] = fall
            out[VARIANCE, m, n] = max(spread[0], plain * inverse[0, 0])
            out[COVARIANCE, m, n] = spread[1]
            out[ROW_VARIANCE, m, n] = max(spread[2], plain * inverse[1, 1])
            out[CORRELATION, m, n] = correlation
