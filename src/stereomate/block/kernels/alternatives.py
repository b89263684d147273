"""Which observations of a point explain a contradiction: every small set of them left out in turn.

The photographs stay as they are; a point has a few rays, and the coordinates that control gives it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.block.kernels.projection import lens_of, observe, observe_general
from stereomate.block.kernels.small import invert_symmetric, nine_of, symmetric_vector, three_of
from stereomate.camera.kernels.layout import BROWN
from stereomate.jit import fused_inline_kernel as inline_kernel
from stereomate.jit import fused_kernel as kernel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]

_STEPS = 12
# Sets of two and of three are tried for points of no more observations than this.
_UNITS = (10_000, 40, 16)


@kernel
def _cost_without(
    a: int,
    b: int,
    c: int,
    rows: Indices,
    photo: Indices,
    xy: Array,
    weight: Array,
    camera: Indices,
    model: Indices,
    packed: Array,
    centres: Array,
    rotations: Array,
    place: Array,
    known: Array,
    known_weight: Array,
) -> tuple[float, int]:
    """Least weighted sum of squares of a point without the units a, b, c, and its redundancy.

    -1 if there is no solution. Units: its rays in order, then its axes. `known_weight` (3,) is 0 for an
    axis that control does not give.
    """
    rays = rows.shape[0]
    parameters, scratch = packed.reshape(packed.size), np.zeros((3, packed.shape[1]))
    x, v, right = (place[0], place[1], place[2]), np.empty(6), np.empty(3)
    cost, left = 0.0, 0
    for _ in range(_STEPS):
        v[:] = 0.0
        right[:] = 0.0
        cost, left = 0.0, -3
        for t in range(rays):
            i = rows[t]
            wx, wy = weight[i, 0], weight[i, 1]
            if t in (a, b, c) or wx == 0.0:
                continue
            k = photo[i]
            m = camera[k]
            seen = three_of(centres, k), nine_of(rotations, k), x
            if model[m] <= BROWN:
                observed, _ = observe(model[m], lens_of(parameters, m), *seen)
            else:
                observed = observe_general(model[m], parameters, m, *seen, scratch)
            column, line, ok, ax, ay = observed
            if not ok:
                return 0.0, -1
            left += 2
            rx, ry = xy[i, 0] - column, xy[i, 1] - line
            cost += wx * rx * rx + wy * ry * ry
            at = 0
            for p in range(3):
                right[p] += wx * ax[p] * rx + wy * ay[p] * ry
                for q in range(p, 3):
                    v[at] += wx * ax[p] * ax[q] + wy * ay[p] * ay[q]
                    at += 1
        for p in range(3):
            unit = rays + p
            if unit in (a, b, c) or known_weight[p] == 0.0:
                continue
            left += 1
            difference = known[p] - x[p]
            cost += known_weight[p] * difference * difference
            right[p] += known_weight[p] * difference
            v[3 * p - p * (p - 1) // 2] += known_weight[p]
        ok, inverse = invert_symmetric(v[0], v[1], v[2], v[3], v[4], v[5])
        if left < 0 or not ok:
            return 0.0, -1
        s0, s1, s2 = symmetric_vector(inverse, right[0], right[1], right[2])
        x = (x[0] + s0, x[1] + s1, x[2] + s2)
        gain = right[0] * s0 + right[1] * s1 + right[2] * s2
        if gain <= 1e-6 * cost + 1e-9:
            return max(cost - gain, 0.0), left
    return cost, left


@inline_kernel
def _next(units: int, size: int, chosen: Indices) -> bool:
    """The next set of `size` of the `units`, in `chosen`; False after the last."""
    at = size - 1
    while at >= 0 and chosen[at] == units - size + at:
        at -= 1
    if at < 0:
        return False
    chosen[at] += 1
    for t in range(at + 1, size):
        chosen[t] = chosen[t - 1] + 1
    return True


@kernel
def _best_set(
    size: int,
    within: float,
    rows: Indices,
    photo: Indices,
    xy: Array,
    weight: Array,
    camera: Indices,
    model: Indices,
    packed: Array,
    centres: Array,
    rotations: Array,
    place: Array,
    known: Array,
    known_weight: Array,
    removable: Flags,
    limits: Array,
    member: Flags,
) -> float:
    """Least sum of squares that a set of `size` units leaves, infinite if none is under its limit.

    `member` (units,): what belongs to sets that leave no more than `within`.
    """
    rays = rows.shape[0]
    chosen, spare = np.arange(3), np.full(3, -1, np.int64)
    best, more = np.inf, True
    while more:
        allowed = True
        for i in range(size):
            unit = spare[i] = chosen[i]
            allowed &= weight[rows[unit], 0] > 0.0 if unit < rays else removable[unit - rays]
        if allowed:
            cost, left = _cost_without(
                spare[0], spare[1], spare[2], rows, photo, xy, weight, camera, model, packed, centres,
                rotations, place, known, known_weight,
            )  # fmt: skip
            if left >= 0 and cost <= limits[min(left, limits.shape[0] - 1)]:
                best = min(best, cost)
                if cost <= within:
                    for i in range(size):
                        member[chosen[i]] = True
        more = _next(rays + 3, size, chosen)
    return best


@kernel
def explain(
    points: Indices,
    most: Indices,
    start: Indices,
    order: Indices,
    photo: Indices,
    xy: Array,
    weight: Array,
    camera: Indices,
    model: Indices,
    packed: Array,
    centres: Array,
    rotations: Array,
    places: Array,
    control: Indices,
    known: Array,
    known_weight: Array,
    removable: Flags,
    limits: Array,
    doubt: float,
    ray_out: Flags,
    axis_out: Flags,
    found: Indices,
) -> None:
    """The smallest sets of observations without which each of some points is free of contradictions.

    `points` (t,) with the size of the largest set to try, `most` (t,), up to 3. Rays of point j are
    ``order[start[j] : start[j + 1]]``, rows of `photo`, `xy`, `weight` (0: takes no part). `control` (p,):
    row in `known` (k, 3), `known_weight` (k, 3) and `removable` (k, 3), or -1. `limits` (d,): largest sum
    of squares for each redundancy. Sets whose sum is within `doubt` of the least one's are as likely.

    Written: `found` (t,): size of the sets, 0 for none; `ray_out`, `axis_out`: what belongs to any of them.
    """
    none, nothing = np.zeros(3), np.zeros(3, np.bool_)
    for t in range(points.shape[0]):
        j = points[t]
        rows = order[start[j] : start[j + 1]]
        rays, row = rows.shape[0], control[j]
        given, weights, free = none, none, nothing
        if row >= 0:
            given, weights, free = known[row], known_weight[row], removable[row]
        member = np.zeros(rays + 3, np.bool_)
        found[t] = 0
        for size in range(1, most[t] + 1):
            if rays + 3 > _UNITS[size - 1] or found[t] > 0:
                break
            within = -1.0
            # First the least sum of all sets of this size, then all that come near it.
            for _ in range(2):
                best = _best_set(
                    size, within, rows, photo, xy, weight, camera, model, packed, centres, rotations,
                    places[j], given, weights, free, limits, member,
                )  # fmt: skip
                if not np.isfinite(best):
                    break
                within = best + doubt
                found[t] = size
        for unit in range(rays + 3):
            if member[unit]:
                if unit < rays:
                    ray_out[rows[unit]] = True
                else:
                    axis_out[row, unit - rays] = True
