"""Brightness beside seams: the nearest seam of every pixel, and what brings both of its sides together."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import inline_kernel, kernel

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Ints = NDArray[np.int64]

# Pixels of a side for which the segments that may be nearest are found at once.
BLOCK: Final = 16


@inline_kernel
def _along(segments: Floats, s: int, x: float, y: float) -> tuple[float, float]:
    """Where on a segment it comes nearest to a point, 0 to 1, and the square of their distance."""
    ax, ay = segments[s, 0], segments[s, 1]
    dx, dy = segments[s, 3] - ax, segments[s, 4] - ay
    length = dx * dx + dy * dy
    t = 0.0 if length == 0.0 else min(max(((x - ax) * dx + (y - ay) * dy) / length, 0.0), 1.0)
    across, along = x - ax - t * dx, y - ay - t * dy
    return t, across * across + along * along


@inline_kernel
def _is_about(segments: Floats, s: int, x: float, y: float) -> bool:
    """Whether a point lies in the box around a segment and its width."""
    w = max(segments[s, 2], segments[s, 5])
    if x < min(segments[s, 0], segments[s, 3]) - w or x > max(segments[s, 0], segments[s, 3]) + w:
        return False
    above, below = min(segments[s, 1], segments[s, 4]) - w, max(segments[s, 1], segments[s, 4]) + w
    return bool(above <= y <= below)


@inline_kernel
def _nearest_segment(
    segments: Floats, sides: Ints, near: Ints, count: int, owner: int, x: float, y: float
) -> tuple[int, float, float]:
    """The nearest segment that has the owner of a point on a side: which, where on it, distance in widths."""
    nearest, found, place = np.inf, -1, 0.0
    for k in range(count):
        s = near[k]
        if sides[s, 0] != owner and sides[s, 1] != owner:
            continue
        if not _is_about(segments, s, x, y):
            continue
        t, d2 = _along(segments, s, x, y)
        if d2 < nearest:
            nearest, found, place = d2, s, t
    if found < 0:
        return -1, 0.0, 1.0
    w = segments[found, 2] + place * (segments[found, 5] - segments[found, 2])
    return found, place, math.sqrt(nearest) / w if w > 0.0 else 1.0


@kernel
def _segments_of_block(
    segments: Floats,
    sides: Ints,
    columns: Floats32,
    col0: float,
    row0: float,
    first: int,
    last: int,
    left: int,
    right: int,
    near: Ints,
    low: Floats,
    bound: Floats,
) -> int:
    """Fill `near` with the segments that may be a pixel's nearest in rows first..last, columns left..right.

    Left out are those that are farther from all of the block than another one of the same label, whose box
    holds the whole block, is from any of it. `low` (n) and `bound` (labels) are scratch space.
    """
    west, east = np.inf, -np.inf
    above, below = (first, last) if columns.shape[0] > 1 else (0, 1)
    for r in range(above, below):
        for c in range(left, right):
            x = columns[r, c] + col0
            # not a number, where there is no ground, is neither
            if x < west:
                west = x
            if x > east:
                east = x
    if not west <= east:
        return 0
    south, north = row0 + first + 0.5, row0 + last - 0.5
    x, y = 0.5 * (west + east), 0.5 * (south + north)
    # a little more than half the diagonal, for what rounding takes away
    radius = 0.5 * math.hypot(east - west, north - south) + 1e-6
    bound[:] = np.inf
    count = 0
    for s in range(segments.shape[0]):
        w = max(segments[s, 2], segments[s, 5])
        if (
            min(segments[s, 0], segments[s, 3]) - w > east
            or max(segments[s, 0], segments[s, 3]) + w < west
            or min(segments[s, 1], segments[s, 4]) - w > north
            or max(segments[s, 1], segments[s, 4]) + w < south
        ):
            continue
        _, d2 = _along(segments, s, x, y)
        d = math.sqrt(d2)
        near[count], low[count] = s, d - radius
        count += 1
        if _is_about(segments, s, west, south) and _is_about(segments, s, east, north):
            for side in range(2):
                bound[sides[s, side]] = min(bound[sides[s, side]], d + radius)
    kept = 0
    for k in range(count):
        s = near[k]
        if low[k] <= bound[sides[s, 0]] or low[k] <= bound[sides[s, 1]]:
            near[kept] = s
            kept += 1
    return kept


@kernel
def level_pixels(
    segments: Floats,
    sides: Ints,
    levels: Floats,
    owner: NDArray[np.int16],
    columns: Floats32,
    col0: float,
    row0: float,
    out: Floats32,
) -> int:
    """Half the logarithm by which the other side of the nearest seam is brighter, falling off to its reach.

    Parameters
    ----------
    segments : (n, 6)
        x0, y0, reach, x1, y1, reach; in product pixels.
    sides : (n, 2)
        Labels on both sides.
    levels : (n, 2, bands)
        Logarithm of the brightness of the second side over that of the first, at both ends.
    owner : (rows, cols)
        Label of each pixel.
    out : (rows, cols, bands)

    Returns
    -------
    Number of pixels within reach.
    """
    rows, cols, bands = out.shape
    n = segments.shape[0]
    near = np.empty(n, np.int64)
    low = np.empty(n)
    bound = np.empty(max(0, sides.max()) + 1 if n else 1)
    total = 0
    out[:] = 0.0
    for first in range(0, rows, BLOCK):
        last = min(first + BLOCK, rows)
        for left in range(0, cols, BLOCK):
            right = min(left + BLOCK, cols)
            count = _segments_of_block(
                segments, sides, columns, col0, row0, first, last, left, right, near, low, bound
            )
            if count == 0:
                continue
            for r in range(first, last):
                line = columns[0 if columns.shape[0] == 1 else r]
                for c in range(left, right):
                    x, y = line[c] + col0, row0 + r + 0.5
                    found, place, share = _nearest_segment(segments, sides, near, count, owner[r, c], x, y)
                    if found < 0 or not share < 1.0:
                        continue
                    total += 1
                    half = 0.5 * (1.0 - share * share * (3.0 - 2.0 * share))
                    if sides[found, 0] != owner[r, c]:
                        half = -half
                    for b in range(bands):
                        difference = levels[found, 0, b] + place * (levels[found, 1, b] - levels[found, 0, b])
                        out[r, c, b] = half * difference
    return total


@kernel
def lift(
    pixels: NDArray[Any], valid: NDArray[np.uint8], level: Floats32, mixed: Floats32, low: float, high: float
) -> None:
    """Multiply pixels by exp(level), in place; less by twice the share that comes from across the seam.

    Parameters
    ----------
    level : (rows, cols, bands)
    mixed : (rows, cols)
        Share of the other side; (0, 0) for none anywhere.
    low, high : float
        As of `balance`.
    """
    rows, cols, bands = pixels.shape
    integer = low <= high
    for r in range(rows):
        for c in range(cols):
            if valid[r, c] == 0:
                continue
            own = 1.0 if mixed.shape[0] == 0 else 1.0 - 2.0 * mixed[r, c]
            for b in range(bands):
                if level[r, c, b] == 0.0:
                    continue
                value = pixels[r, c, b] * math.exp(own * level[r, c, b])
                if integer:
                    pixels[r, c, b] = math.floor(min(max(value, low), high) + 0.5)
                else:
                    pixels[r, c, b] = value
