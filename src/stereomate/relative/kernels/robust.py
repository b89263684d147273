"""Random sampling for relative orientation: five-point hypotheses, scored on a subset, refined on all points.

Hypotheses are drawn from a random subset and tested on it point by point until it is clear that they lose
(a sequential test against the best so far, binomial bound of four standard deviations); each new best is
refined by reweighted Gauss-Newton (O. Chum, J. Matas, J. Kittler 2003, "Locally optimized RANSAC"). Only the
last steps see all points. Distances are closures over their standard deviations: Sampson distances in sigmas.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import kernel
from stereomate.relative.kernels.five_point import MAX_SOLUTIONS, five_point
from stereomate.relative.kernels.mixture import (
    BINS,
    IMPOSSIBLE,
    mark_inliers,
    refine,
    square_distance,
    typical_distance,
)
from stereomate.relative.kernels.pose import (
    choose_arrangement,
    count_in_front,
    essential_from_pose,
    pose_from_essential,
    share_behind,
)
from stereomate.relative.kernels.sampling import draw_five, draw_subset, next_random

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]
Words = NDArray[np.uint64]

_BLOCK = 64
# Largest share of good points behind a camera: wrong ones that happen to lie near their epipolar lines.
MOST_BEHIND = 0.1


@kernel
def score(
    e: Array,
    left: Array,
    right: Array,
    vl: float,
    vr: float,
    limit2: float,
    best_inliers: float,
    best_cost: float,
) -> tuple[float, int]:
    """(cost, inliers) on the subset; cost is the truncated square sum; (inf, 0) as soon as it cannot win."""
    m = left.shape[0]
    cost, inliers = 0.0, 0
    share = best_inliers / m
    i = 0
    while i < m:
        stop = min(i + _BLOCK, m)
        while i < stop:
            d2 = square_distance(e, vl, vr, left[i, 0], left[i, 1], right[i, 0], right[i, 1])
            if d2 < limit2:
                cost += d2 / limit2
                inliers += 1
            else:
                cost += 1.0
            i += 1
        if cost >= best_cost:
            return np.inf, 0
        if inliers < share * i - 4.0 * np.sqrt(i * share * (1.0 - share)) - 2.0:
            return np.inf, 0
    return cost, inliers


@kernel
def improve(
    left: Array, right: Array, vl: float, vr: float, limit: float, base: Array, rotation: Array, best: Array
) -> None:
    """Refine a new best orientation with a wide and with the right limit; `best` (cost, inliers, ...) too."""
    b, rot, e = np.empty(3), np.empty((3, 3)), np.empty(9)
    mix, odds, cofactor = np.empty(3), np.zeros(BINS), np.empty((5, 5))
    var_l, var_r = np.array([vl]), np.array([vr])
    for limit_factor in (2.0, 1.0):
        b[:] = base
        rot[:] = rotation
        mix[0], mix[1], mix[2] = limit * limit_factor, limit / 3.0, 0.0
        odds[0] = 0.0
        if not refine(left, right, var_l, var_r, b, rot, mix, odds, 2, limit, cofactor):
            continue
        essential_from_pose(b, rot, e)
        cost, inliers = score(e, left, right, vl, vr, limit * limit, 0.0, best[0])
        if cost < best[0]:
            best[0], best[1] = cost, inliers
            base[:] = b
            rotation[:] = rot


@kernel
def search(
    left: Array,
    right: Array,
    vl: float,
    vr: float,
    limit: float,
    confidence: float,
    least: int,
    most: int,
    state: Words,
    base: Array,
    rotation: Array,
    best: Array,
) -> bool:
    """Best orientation of the subset; (cost, inliers, samples) into `best`."""
    m = left.shape[0]
    limit2 = limit * limit
    five = np.empty(5, np.int64)
    l5, r5 = np.empty((5, 3)), np.empty((5, 3))
    essentials = np.empty((MAX_SOLUTIONS, 9))
    all_five, use = np.ones(5, np.bool_), np.empty(m, np.bool_)
    b, first, second, rot = np.empty(3), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    best_cost, best_inliers = np.inf, 0.0
    needed = most
    sample = 0
    while sample < most and (sample < least or sample < needed):
        sample += 1
        draw_five(state, m, five)
        for k in range(5):
            j = five[k]
            l5[k, 0], l5[k, 1], l5[k, 2] = left[j, 0], left[j, 1], -1.0
            r5[k, 0], r5[k, 1], r5[k, 2] = right[j, 0], right[j, 1], -1.0
        found = five_point(l5, r5, essentials)
        for s in range(found):
            e = essentials[s]
            if not pose_from_essential(e, b, first, second):
                continue
            # One of the five may be so far away that noise turns its sign.
            if choose_arrangement(l5, r5, all_five, b, first, second, rot) < 4:
                continue
            cost, inliers = score(e, left, right, vl, vr, limit2, best_inliers, best_cost)
            if not cost < best_cost:
                continue
            for i in range(m):
                use[i] = square_distance(e, vl, vr, left[i, 0], left[i, 1], right[i, 0], right[i, 1]) < limit2
            # The second solution of a plane has some of it behind a camera.
            if share_behind(left, right, use, b, rot, vl + vr) > MOST_BEHIND:
                continue
            base[:] = b
            rotation[:] = rot
            best[0], best[1] = cost, inliers
            improve(left, right, vl, vr, limit, base, rotation, best)
            best_cost, best_inliers = best[0], best[1]
            good = (best_inliers / m) ** 5
            if good >= 1.0 - 1e-12:
                needed = 0
            elif good > 1e-12:
                needed = min(most, int(np.log(1.0 - confidence) / np.log(1.0 - good)) + 1)
    best[0], best[1], best[2] = best_cost, best_inliers, sample
    return best_inliers >= 5.0


@kernel
def choose_subset(
    left: Array,
    right: Array,
    var_left: Array,
    var_right: Array,
    state: Words,
    sub_left: Array,
    sub_right: Array,
) -> tuple[float, float]:
    """Random points into `sub_left` and `sub_right`; their mean variances left and right."""
    m = sub_left.shape[0]
    chosen = np.empty(m, np.int64)
    draw_subset(state, left.shape[0], chosen)
    vl = vr = 0.0
    for i in range(m):
        j = chosen[i]
        for k in range(2):
            sub_left[i, k], sub_right[i, k] = left[j, k], right[j, k]
        vl += var_left[j if var_left.shape[0] > 1 else 0] / m
        vr += var_right[j if var_right.shape[0] > 1 else 0] / m
    return vl, vr


@kernel
def settle(
    left: Array,
    right: Array,
    var_left: Array,
    var_right: Array,
    numbers: Array,
    base: Array,
    rotation: Array,
    mix: Array,
    odds: Array,
    cofactor: Array,
) -> bool:
    """Refine what the search found on its subset: the noise, the arrangement, the depths of the terrain.

    `base` and `rotation` are those of the right arrangement even where False is returned, because the last
    steps failed.
    """
    limit, widest = numbers[0], numbers[8] * numbers[0]
    kept_base, kept_rotation = base.copy(), rotation.copy()
    fine = refine(left, right, var_left, var_right, base, rotation, mix, odds, 2, widest, cofactor)
    while fine and mix[0] > limit * 1.02 and mix[0] < widest:
        # The noise is larger than stated: widen until the limit has found its place.
        limit = mix[0]
        fine = refine(left, right, var_left, var_right, base, rotation, mix, odds, 1, widest, cofactor)
    if not fine:
        base[:] = kept_base
        rotation[:] = kept_rotation
    inlier = np.ones(left.shape[0], np.bool_)
    mark_inliers(left, right, var_left, var_right, base, rotation, mix, odds, numbers[6:8], inlier)
    e, first, second = np.empty(9), np.empty((3, 3)), np.empty((3, 3))
    essential_from_pose(base, rotation, e)
    pose_from_essential(e, base, first, second)
    choose_arrangement(left, right, inlier, base, first, second, rotation)
    kept_base[:] = base
    kept_rotation[:] = rotation
    mix[2] = typical_distance(left, right, inlier, base, rotation)
    odds[:] = odds[0]
    if mix[2] > 0.0:
        odds[0] = IMPOSSIBLE
    if refine(left, right, var_left, var_right, base, rotation, mix, odds, 3, widest, cofactor):
        return True
    base[:] = kept_base
    rotation[:] = kept_rotation
    return False


@kernel
def robust_pose(
    left: Array,
    right: Array,
    var_left: Array,
    var_right: Array,
    numbers: Array,
    seed: int,
    base: Array,
    rotation: Array,
    inlier: Mask,
    cofactor: Array,
    out: Array,
) -> bool:
    """Search on a subset, then reweighted least squares over all points.

    `numbers`: limit in sigmas, confidence, least samples, most samples, subset size, last steps, smallest
    and largest limit for the final inliers, factor by which the limit may grow. `out` gets: samples, subset
    size, subset inliers, inliers, scale, typical distance in bases, points in front. Returns False if
    nothing was found.
    """
    n = left.shape[0]
    m = min(n, int(numbers[4]))
    limit, last = numbers[0], int(numbers[5])
    state = np.empty(1, np.uint64)
    state[0] = np.uint64(seed) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(0xD1B54A32D192ED03)
    for _ in range(8):
        next_random(state)
    sub_left, sub_right, best = np.empty((m, 2)), np.empty((m, 2)), np.zeros(3)
    vl, vr = choose_subset(left, right, var_left, var_right, state, sub_left, sub_right)
    confidence, least, most = numbers[1], int(numbers[2]), int(numbers[3])
    found = search(sub_left, sub_right, vl, vr, limit, confidence, least, most, state, base, rotation, best)
    out[0], out[1], out[2] = best[2], m, best[1]
    if not found:
        return False
    start_base, start_rotation = base.copy(), rotation.copy()
    mix, odds = np.array([limit, limit / 3.0, 0.0]), np.zeros(BINS)
    var_l, var_r = np.array([vl]), np.array([vr])
    fine = settle(sub_left, sub_right, var_l, var_r, numbers, base, rotation, mix, odds, cofactor)
    if fine and n > m:
        kept_base, kept_rotation = base.copy(), rotation.copy()
        widest = numbers[8] * limit
        if not refine(left, right, var_left, var_right, base, rotation, mix, odds, last, widest, cofactor):
            base[:] = kept_base
            rotation[:] = kept_rotation
    bounds = numbers[6:8]
    out[3] = mark_inliers(left, right, var_left, var_right, base, rotation, mix, odds, bounds, inlier)
    if out[3] < 0.5 * n * best[1] / m:
        # The steps ran away from what most points agree on, as they do along the valley of critical points.
        base[:] = start_base
        rotation[:] = start_rotation
        mix[0], mix[1], mix[2] = limit, limit / 3.0, 0.0
        odds[:] = 0.0
        out[3] = mark_inliers(left, right, var_left, var_right, base, rotation, mix, odds, bounds, inlier)
    out[4], out[5] = mix[1], mix[2]
    front, _behind = count_in_front(left, right, inlier, base, rotation)
    out[6] = front
    return True
