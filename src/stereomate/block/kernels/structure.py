"""Order of the observations by point, and which photographs share points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import kernel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@kernel
def order_by(key: Indices, count: int, order: Indices) -> Indices:
    """Stable counting sort: `order` re-sorted by ``key[order]`` in place; returns the start of each key."""
    start = np.zeros(count + 1, np.int64)
    for i in range(order.shape[0]):
        start[key[order[i]] + 1] += 1
    for i in range(count):
        start[i + 1] += start[i]
    place = start[:count].copy()
    sorted_order = np.empty_like(order)
    for i in range(order.shape[0]):
        k = key[order[i]]
        sorted_order[place[k]] = order[i]
        place[k] += 1
    order[:] = sorted_order
    return start


@kernel
def neighbours(
    photo: Indices, start: Indices, by_photo: Indices, photo_start: Indices, point: Indices
) -> tuple[Indices, Indices]:
    """Photographs that share a point with each photograph, as (starts, indices); itself is not among them.

    Observations are sorted by point (`start`), `by_photo` lists their rows by photograph.
    """
    n = photo_start.shape[0] - 1
    stamp = np.full(n, -1, np.int64)
    counts = np.zeros(n + 1, np.int64)
    found = np.empty(max(16, 8 * n), np.int64)
    total = 0
    for k in range(n):
        stamp[k] = k
        for i in range(photo_start[k], photo_start[k + 1]):
            j = point[by_photo[i]]
            for row in range(start[j], start[j + 1]):
                other = photo[row]
                if stamp[other] != k:
                    stamp[other] = k
                    if total == found.shape[0]:
                        larger = np.empty(2 * total, np.int64)
                        larger[:total] = found
                        found = larger
                    found[total] = other
                    total += 1
        counts[k + 1] = total
    return counts, found[:total].copy()


@kernel
def bandwidth(starts: Indices, others: Indices, place: Indices) -> int:
    """Largest distance of two neighbours in an order."""
    widest = 0
    for k in range(starts.shape[0] - 1):
        for i in range(starts[k], starts[k + 1]):
            distance = place[k] - place[others[i]]
            if distance > widest:
                widest = distance
    return widest


@kernel
def pivots(rows: Array, out: Indices) -> None:
    """Rows of (n, d) that span it best, one after the other, into `out` (d,): the longest of what is left.

    `rows` is written over.
    """
    n, d = rows.shape
    for t in range(out.shape[0]):
        best, longest = 0, -1.0
        for i in range(n):
            square = 0.0
            for a in range(d):
                square += rows[i, a] * rows[i, a]
            if square > longest:
                best, longest = i, square
        out[t] = best
        unit = rows[best].copy()
        for i in range(n):
            along = 0.0
            for a in range(d):
                along += rows[i, a] * unit[a]
            along /= max(longest, 1e-300)
            for a in range(d):
                rows[i, a] -= along * unit[a]
