"""The window of a dense least-squares match: its support, its plane of parallaxes, and both its images."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import kernel
from stereomate.measurement.kernels.splines import spline_weights

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]

# Rows of the array that holds a window: derivatives along and across the rows, grey value less that of the
# centre, weight, resampled right image.
ALONG = 0
ACROSS = 1
GREY = 2
WEIGHT = 3
RIGHT = 4
WINDOW_ROWS = 5

# Unknowns: parallax, row parallax, gain, offset.
UNKNOWNS = 4
# A pixel belongs to the surface of the window's centre if its parallax differs by less than this, plus so
# much per pixel of distance.
_SAME_PX = 1.0
_SAME_SLOPE = 0.4
# Inclinations of the plane below this count as none: at the edge of a window a tenth of a pixel.
_LEVEL = 0.02
# Normal matrices worse than this have no texture across some direction.
_PIVOT = 1e-6


@kernel
def support(
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
            window[WEIGHT, k] = 1.0 if good else 0.0
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
def inverted(normal: Floats, inverse: Floats, work: Floats) -> bool:
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
def resample(
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
                window[RIGHT, i * size + j] = (
                    p * strip[at + j - 1] + q * strip[at + j] + s * strip[at + j + 1] + t * strip[at + j + 2]
                )
            continue
        for j in range(size):
            x = start + j * pace
            at = int(x)
            p, q, s, t = spline_weights(x - at)
            window[RIGHT, i * size + j] = (
                p * strip[at - 1] + q * strip[at] + s * strip[at + 1] + t * strip[at + 2]
            )
    return True


@kernel
def left_window(left: Floats32, row: int, col: int, radius: int, window: Floats, normal: Floats) -> None:
    """Derivatives and grey values of the window, and the normal matrix over its support."""
    middle = left[row, col]
    n = sx = sy = sg = sxx = sxy = sxg = syy = syg = sgg = 0.0
    k = 0
    for r in range(row - radius, row + radius + 1):
        for c in range(col - radius, col + radius + 1):
            x = 0.5 * (left[r, c + 1] - left[r, c - 1])
            y = 0.5 * (left[r + 1, c] - left[r - 1, c])
            g = left[r, c] - middle
            w = window[WEIGHT, k]
            window[ALONG, k] = x
            window[ACROSS, k] = y
            window[GREY, k] = g
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
