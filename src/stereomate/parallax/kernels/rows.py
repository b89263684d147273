"""Rows of a stereomate: the forward map u = x - q(h(x)) over a profile, and which of its branches is seen.

A profile is piecewise linear: heights at rising x along a row of the product, NaN where there is none. Where
the ground rises along the row more steeply than 1/q', the map folds: of all x with one u the largest is the
highest ground on its line and hides the others (theory: fold of the law).

What is seen of a profile is a set of pieces on which u rises with x and lies below every u further along:
one sweep from the far end finds them.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import inline_kernel, kernel
from stereomate.parallax.kernels.law import LINEAR, LOGARITHMIC, NATURAL, TABLE, q_of_height, slope

Floats = NDArray[np.float64]

_HEAD = 4
_MAX_ITERATIONS = 80


@inline_kernel
def u_at(code: int, parameters: Floats, x: float, x0: float, h0: float, rise: float) -> float:
    """u of the position x on a segment that passes (x0, h0) with a slope."""
    return x - q_of_height(code, parameters, h0 + rise * (x - x0))


@kernel
def _insert(values: Floats, count: int, value: float, low: float, high: float) -> int:
    """Insert a value between low and high into an ascending list; the new length."""
    if not low < value < high:
        return count
    k = count
    while k > 0 and values[k - 1] > value:
        values[k] = values[k - 1]
        k -= 1
    values[k] = value
    return count + 1


@kernel
def _breaks(
    code: int, parameters: Floats, x0: float, x1: float, h0: float, rise: float, breaks: Floats
) -> int:
    """Ends of the parts of a segment on which u is monotone, ascending; how many there are."""
    breaks[0] = x0
    breaks[1] = x1
    count = 2
    if rise == 0.0 or code == LINEAR:
        return count
    base = parameters[0]
    w0 = parameters[1]
    if code == LOGARITHMIC and rise > 0.0:
        critical = w0 - base * rise
        count = _insert(breaks, count, x0 + (critical + parameters[2] - h0) / rise, x0, x1)
    elif code == NATURAL and rise > 0.0:
        critical = w0 - math.sqrt(base * w0 * rise)
        count = _insert(breaks, count, x0 + (critical + parameters[2] - h0) / rise, x0, x1)
    elif code == TABLE:
        n = int(parameters[3])
        for k in range(n):
            place = x0 + (parameters[_HEAD + k] + parameters[2] - h0) / rise
            count = _insert(breaks, count, place, x0, x1)
        for k in range(n - 1 if rise > 0.0 else 0):
            count = _table_breaks(parameters, k, x0, x1, h0, rise, breaks, count)
    return count


@kernel
def _table_breaks(
    parameters: Floats, k: int, x0: float, x1: float, h0: float, rise: float, breaks: Floats, count: int
) -> int:
    """Positions in interval k of a table at which q' rise = 1: roots of a quadratic."""
    n = int(parameters[3])
    width = parameters[_HEAD + k + 1] - parameters[_HEAD + k]
    secant = (parameters[_HEAD + n + k + 1] - parameters[_HEAD + n + k]) / width
    m0 = parameters[_HEAD + 2 * n + k]
    m1 = parameters[_HEAD + 2 * n + k + 1]
    a = 3.0 * (m0 + m1 - 2.0 * secant)
    b = 2.0 * (3.0 * secant - 2.0 * m0 - m1)
    c = m0 - 1.0 / rise
    discriminant = b * b - 4.0 * a * c
    if discriminant < 0.0:
        return count
    z = -0.5 * (b + math.copysign(math.sqrt(discriminant), b))
    for first in (True, False):
        if first:
            s = c / z if z != 0.0 else -1.0
        else:
            s = z / a if a != 0.0 else -1.0
        if 0.0 < s < 1.0:
            height = parameters[_HEAD + k] + s * width + parameters[2]
            count = _insert(breaks, count, x0 + (height - h0) / rise, x0, x1)
    return count


@kernel
def _solve(
    code: int,
    parameters: Floats,
    u: float,
    low: float,
    high: float,
    x0: float,
    h0: float,
    rise: float,
) -> float:
    """The x between low and high, where u rises, that shows u: Newton's method kept inside by bisection."""
    x = low + (high - low) * 0.5
    start = u_at(code, parameters, low, x0, h0, rise)
    end = u_at(code, parameters, high, x0, h0, rise)
    if u <= start:
        return low
    if u >= end:
        return high
    x = low + (high - low) * (u - start) / (end - start)
    for _ in range(_MAX_ITERATIONS):
        height = h0 + rise * (x - x0)
        error = x - q_of_height(code, parameters, height) - u
        if error > 0.0:
            high = x
        else:
            low = x
        steepness = 1.0 - slope(code, parameters, height) * rise
        following = x - error / steepness if steepness > 0.0 else 0.5 * (low + high)
        if not low <= following <= high:
            following = 0.5 * (low + high)
        if abs(following - x) <= 4e-16 * (abs(x) + 1e-3) or high - low <= 4e-16 * (abs(x) + 1e-3):
            return following
        x = following
    return x


@kernel
def visible_pieces(code: int, parameters: Floats, x: Floats, heights: Floats) -> Floats:
    """What is seen of a profile: pieces (n, 5) of (x start, x end, u start, u end, segment), x descending.

    Parameters
    ----------
    x, heights : (m,) float64
        Profile, x rising; NaN heights are voids.
    """
    room = max(0, 2 * (len(x) - 1) + 4) + int(3 * parameters[3])
    pieces = np.empty((room, 5))
    breaks = np.empty(8 + 4 * int(parameters[3]))
    count = 0
    lowest = math.inf
    for i in range(len(x) - 2, -1, -1):
        rise = (heights[i + 1] - heights[i]) / (x[i + 1] - x[i])
        if not math.isfinite(rise):
            continue
        x0 = x[i]
        h0 = heights[i]
        parts = _breaks(code, parameters, x0, x[i + 1], h0, rise, breaks)
        for k in range(parts - 2, -1, -1):
            left = u_at(code, parameters, breaks[k], x0, h0, rise)
            right = u_at(code, parameters, breaks[k + 1], x0, h0, rise)
            limit = min(lowest, right)
            if left < limit:
                end = breaks[k + 1]
                if limit < right:
                    end = _solve(code, parameters, limit, breaks[k], end, x0, h0, rise)
                if count == room:
                    grown = np.empty((2 * room, 5))
                    grown[:room] = pieces
                    pieces = grown
                    room *= 2
                pieces[count, 0] = breaks[k]
                pieces[count, 1] = end
                pieces[count, 2] = left
                pieces[count, 3] = limit
                pieces[count, 4] = i
                count += 1
            lowest = min(lowest, min(left, right))
    return pieces[:count]


@inline_kernel
def _piece_of(pieces: Floats, column: int, value: float) -> int:
    """First of the descending pieces that starts (column 0: x, 2: u) at or below a value; -1 if none."""
    low = 0
    high = pieces.shape[0]
    while low < high:
        middle = (low + high) // 2
        if pieces[middle, column] <= value:
            high = middle
        else:
            low = middle + 1
    return low if low < pieces.shape[0] else -1


@kernel
def winners(
    code: int, parameters: Floats, x: Floats, heights: Floats, pieces: Floats, u: Floats, out: Floats
) -> None:
    """The x that is seen at each u: the inverse of the forward map; NaN outside the profile and in voids."""
    for k in range(out.size):
        out[k] = math.nan
        p = _piece_of(pieces, 2, u[k])
        if p >= 0 and u[k] <= pieces[p, 3]:
            i = int(pieces[p, 4])
            rise = (heights[i + 1] - heights[i]) / (x[i + 1] - x[i])
            out[k] = _solve(code, parameters, u[k], pieces[p, 0], pieces[p, 1], x[i], heights[i], rise)


@kernel
def hidden_positions(pieces: Floats, positions: Floats, out: NDArray[np.bool_]) -> None:
    """Whether positions along the row are hidden by the fold of the law (or not on the profile)."""
    for k in range(out.size):
        p = _piece_of(pieces, 0, positions[k])
        out[k] = not (p >= 0 and positions[k] <= pieces[p, 1])


@kernel
def highest_u(code: int, parameters: Floats, x: Floats, heights: Floats, start: float, end: float) -> float:
    """Largest u of the ground between two positions of a profile without voids."""
    breaks = np.empty(8 + 4 * int(parameters[3]))
    highest = -math.inf
    for i in range(len(x) - 1):
        if x[i + 1] <= start or x[i] >= end:
            continue
        rise = (heights[i + 1] - heights[i]) / (x[i + 1] - x[i])
        parts = _breaks(code, parameters, x[i], x[i + 1], heights[i], rise, breaks)
        for k in range(parts):
            place = min(max(breaks[k], start), end)
            highest = max(highest, u_at(code, parameters, place, x[i], heights[i], rise))
    return highest
