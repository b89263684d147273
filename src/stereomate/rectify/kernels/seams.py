"""Seams at the pixels: which polygon the ground of a pixel lies in, how near a seam it is, and the mixing."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import inline_kernel, kernel

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Ints = NDArray[np.int64]


@inline_kernel
def _sort_events(x: Floats, enters: NDArray[np.bool_], labels: Ints, n: int) -> None:
    """Insertion sort by position, leaving before entering."""
    for i in range(1, n):
        xi, ei, li = x[i], enters[i], labels[i]
        j = i - 1
        while j >= 0 and (x[j] > xi or (x[j] == xi and enters[j] and not ei)):
            x[j + 1], enters[j + 1], labels[j + 1] = x[j], enters[j], labels[j]
            j -= 1
        x[j + 1], enters[j + 1], labels[j + 1] = xi, ei, li


@kernel
def label_pixels(
    edges: Floats,
    edge_labels: Ints,
    columns: Floats32,
    col0: float,
    row0: float,
    out: NDArray[np.int16],
) -> None:
    """Label of the polygon under the ground of each pixel, -1 where there is none.

    Rows of orthophoto and stereomate are the same lines on the ground; on each, polygons are intervals. So
    both change from one model to the next at the same ground position, exactly.

    Parameters
    ----------
    edges : (n, 4)
        x0, y0, x1, y1 in product pixels; at an edge that runs towards larger y, the polygon lies at larger x.
    edge_labels : (n,)
    columns : (rows or 1, cols)
        Ground columns relative to `col0`; NaN where there is no ground.
    row0 : float
        First row.
    out : (rows, cols)
    """
    rows, cols = out.shape
    n = edges.shape[0]
    x = np.empty(n)
    enters = np.empty(n, np.bool_)
    labels = np.empty(n, np.int64)
    starts = np.empty(n + 1)
    found = np.empty(n + 1, np.int64)
    for r in range(rows):
        y = row0 + r + 0.5
        count = 0
        for e in range(n):
            y0, y1 = edges[e, 1], edges[e, 3]
            if (y0 <= y) == (y1 <= y):
                continue
            x[count] = edges[e, 0] + (y - y0) / (y1 - y0) * (edges[e, 2] - edges[e, 0])
            enters[count] = y1 > y0
            labels[count] = edge_labels[e]
            count += 1
        _sort_events(x, enters, labels, count)
        starts[0], found[0] = -math.inf, -1
        intervals = 1
        current = -1
        for e in range(count):
            if enters[e]:
                current = labels[e]
            elif current == labels[e]:
                current = -1
            starts[intervals], found[intervals] = x[e], current
            intervals += 1
        line = columns[0 if columns.shape[0] == 1 else r]
        i = 0
        for c in range(cols):
            at = line[c] + col0
            if at != at:
                out[r, c] = -1
                continue
            # Ground columns nearly always grow along a row: a step or two from the last interval.
            while i > 0 and starts[i] > at:
                i -= 1
            while i + 1 < intervals and starts[i + 1] <= at:
                i += 1
            out[r, c] = found[i]


@kernel
def feather_pixels(
    segments: Floats,
    sides: Ints,
    owner: NDArray[np.int16],
    columns: Floats32,
    col0: float,
    row0: float,
    out_partner: NDArray[np.int16],
    out_weight: Floats32,
) -> int:
    """The polygon across the nearest seam and its share in the pixel: half on the seam, none at its width.

    Parameters
    ----------
    segments : (n, 6)
        x0, y0, half width, x1, y1, half width; in product pixels.
    sides : (n, 2)
        Labels on both sides.
    owner : (rows, cols)
        Label of each pixel.

    Returns
    -------
    Number of pixels with a partner.
    """
    rows, cols = owner.shape
    n = segments.shape[0]
    near = np.empty(n, np.int64)
    total = 0
    for r in range(rows):
        y = row0 + r + 0.5
        count = 0
        for s in range(n):
            w = max(segments[s, 2], segments[s, 5])
            if min(segments[s, 1], segments[s, 4]) - w <= y <= max(segments[s, 1], segments[s, 4]) + w:
                near[count] = s
                count += 1
        line = columns[0 if columns.shape[0] == 1 else r]
        for c in range(cols):
            out_partner[r, c] = -1
            out_weight[r, c] = 0.0
            if count == 0 or owner[r, c] < 0:
                continue
            x = line[c] + col0
            best = 1.0
            for k in range(count):
                s = near[k]
                mine = sides[s, 0] == owner[r, c]
                if not mine and sides[s, 1] != owner[r, c]:
                    continue
                ax, ay, bx, by = segments[s, 0], segments[s, 1], segments[s, 3], segments[s, 4]
                w = max(segments[s, 2], segments[s, 5])
                if x < min(ax, bx) - w or x > max(ax, bx) + w:
                    continue
                dx, dy = bx - ax, by - ay
                length = dx * dx + dy * dy
                t = 0.0 if length == 0.0 else min(max(((x - ax) * dx + (y - ay) * dy) / length, 0.0), 1.0)
                w = segments[s, 2] + t * (segments[s, 5] - segments[s, 2])
                if w <= 0.0:
                    continue
                d = math.hypot(x - ax - t * dx, y - ay - t * dy) / w
                if d < best:
                    best = d
                    out_partner[r, c] = sides[s, 1] if mine else sides[s, 0]
            if best < 1.0:
                # smooth at the seam and at the end of the strip
                out_weight[r, c] = 0.5 * (1.0 - best * best * (3.0 - 2.0 * best))
                total += 1
    return total


@kernel
def mix(
    pixels: NDArray[Any], other: NDArray[Any], there: NDArray[np.uint8], weight: Floats32, integer: bool
) -> None:
    """``pixels`` becomes its weighted mean with `other` where `there`; integers are rounded."""
    rows, cols, bands = pixels.shape
    half = 0.5 if integer else 0.0
    for r in range(rows):
        for c in range(cols):
            if there[r, c] == 0:
                continue
            w = weight[r, c]
            for b in range(bands):
                value = (1.0 - w) * pixels[r, c, b] + w * other[r, c, b]
                if integer:
                    pixels[r, c, b] = math.floor(value + half)
                else:
                    pixels[r, c, b] = value


@kernel
def balance(
    pixels: NDArray[Any],
    valid: NDArray[np.uint8],
    map_x: Floats32,
    map_y: Floats32,
    offset_x: float,
    offset_y: float,
    table: Floats32,
    step_x: float,
    step_y: float,
    low: float,
    high: float,
) -> None:
    """Multiply pixels by a factor that varies over the photograph, in place.

    Parameters
    ----------
    map_x, map_y : (rows, cols)
        Positions in the photograph; `offset_x` and `offset_y` are added to count from its outer corner.
    table : (node rows, node cols, bands)
        Factors on a grid over the photograph, bilinear between.
    step_x, step_y : float
        Distance of its nodes.
    low, high : float
        Range of the type; integers are rounded. ``low > high``: floats, left as they are.
    """
    rows, cols, bands = pixels.shape
    last_x, last_y = table.shape[1] - 2, table.shape[0] - 2
    integer = low <= high
    for r in range(rows):
        for c in range(cols):
            if valid[r, c] == 0:
                continue
            x = (map_x[r, c] + offset_x) / step_x
            y = (map_y[r, c] + offset_y) / step_y
            i = min(max(int(x), 0), last_x)
            j = min(max(int(y), 0), last_y)
            fx, fy = x - i, y - j
            for b in range(bands):
                upper = table[j, i, b] + fx * (table[j, i + 1, b] - table[j, i, b])
                lower = table[j + 1, i, b] + fx * (table[j + 1, i + 1, b] - table[j + 1, i, b])
                value = pixels[r, c, b] * (upper + fy * (lower - upper))
                if integer:
                    pixels[r, c, b] = math.floor(min(max(value, low), high) + 0.5)
                else:
                    pixels[r, c, b] = value
