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
from stereomate.relative.kernels.coplanarity import coplanarity
from stereomate.relative.kernels.five_point import MAX_SOLUTIONS, five_point
from stereomate.relative.kernels.pose import (
    choose_arrangement,
    count_in_front,
    depths,
    essential_from_pose,
    move,
    pose_from_essential,
    share_behind,
    solve_five,
    tangents,
)

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]
Words = NDArray[np.uint64]

_BLOCK = 64
# Depth bins: inverse distance from -1 to 3 times the typical one in eighths, and two tails.
BINS = 34
_BINS_PER_UNIT = 8.0
# Largest share of good points behind a camera: wrong ones that happen to lie near their epipolar lines.
MOST_BEHIND = 0.1
# Odds of a point behind the cameras.
IMPOSSIBLE = 1e30


@kernel
def next_random(state: Words) -> int:
    """xorshift64*: the next of a reproducible sequence, state (1,) uint64."""
    x = state[0]
    x ^= x >> np.uint64(12)
    x ^= x << np.uint64(25)
    x ^= x >> np.uint64(27)
    state[0] = x
    number: int = (x * np.uint64(2685821657736338717)) >> np.uint64(32)
    return number


@kernel
def draw_subset(state: Words, n: int, chosen: Ints) -> None:
    """`chosen` gets distinct random indices below n in random order (Floyd's method, then a shuffle)."""
    m = chosen.shape[0]
    if m * 4 >= n:
        order = np.arange(n)
        for i in range(m):
            j = i + np.int64(next_random(state) % np.uint64(n - i))
            order[i], order[j] = order[j], order[i]
            chosen[i] = order[i]
        return
    taken = np.zeros(n, np.bool_)
    count = 0
    while count < m:
        j = np.int64(next_random(state) % np.uint64(n))
        if not taken[j]:
            taken[j] = True
            chosen[count] = j
            count += 1


@kernel
def draw_five(state: Words, n: int, five: Ints) -> None:
    count = 0
    while count < 5:
        j = np.int64(next_random(state) % np.uint64(n))
        fresh = True
        for k in range(count):
            if five[k] == j:
                fresh = False
        if fresh:
            five[count] = j
            count += 1


@kernel
def square_distance(e: Array, vl: float, vr: float, lx: float, ly: float, rx: float, ry: float) -> float:
    """Square of the Sampson distance in sigmas of one pair of points."""
    a0 = e[0] * rx + e[1] * ry - e[2]
    a1 = e[3] * rx + e[4] * ry - e[5]
    a2 = e[6] * rx + e[7] * ry - e[8]
    b0 = e[0] * lx + e[3] * ly - e[6]
    b1 = e[1] * lx + e[4] * ly - e[7]
    w = lx * a0 + ly * a1 - a2
    square: float = w * w / (vl * (a0 * a0 + a1 * a1) + vr * (b0 * b0 + b1 * b1) + 1e-300)
    return square


@kernel
def score(
    e: Array,
    left: Array,
    right: Array,
    vl: float,
    vr: float,
    limit2: float,
    best_inliers: int,
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
def depth_bin(
    base: Array, rotation: Array, mix: Array, variance: float, lx: float, ly: float, rx: float, ry: float
) -> int:
    """Bin of a point by its inverse distance relative to the typical one (`mix[2]`).

    Bad points have any distance, good ones share those of the terrain. The last bin is a tail; the first
    is for points behind a camera by more than their noise (`variance` of the angle between the rays).
    """
    near_left, near_right = depths(base, rotation, lx, ly, rx, ry)
    u = rotation[0, 0] * rx + rotation[0, 1] * ry - rotation[0, 2]
    v = rotation[1, 0] * rx + rotation[1, 1] * ry - rotation[1, 2]
    w = rotation[2, 0] * rx + rotation[2, 1] * ry - rotation[2, 2]
    a = lx * lx + ly * ly + 1.0
    c = u * u + v * v + w * w
    d = lx * u + ly * v - w
    sine2 = a * c - d * d
    # Parallax over base: the inverse of the distance along either ray, the smaller of both.
    parallax = sine2 / (abs(near_left) + abs(near_right) + 1e-300)
    if near_left < 0.0 or near_right < 0.0:
        if sine2 > 16.0 * variance * a * c:
            return 0
        parallax = -parallax
    position = (parallax * mix[2] + 1.0) * _BINS_PER_UNIT
    return int(min(max(position, 1.0), BINS - 1.0))


@kernel
def accumulate(
    left: Array,
    right: Array,
    var_left: Array,
    var_right: Array,
    base: Array,
    rotation: Array,
    mix: Array,
    odds: Array,
    normal: Array,
    rhs: Array,
    near: Array,
    band: Array,
) -> tuple[float, float]:
    """One reweighted Gauss-Newton pass: normal equations, right side, weight and square sums.

    `mix` = (limit in sigmas, scale, typical distance). Points weigh by their probability of being good: a
    normal distribution of that scale against a uniform one with the prior `odds` of their depth bin.
    `near` and `band` count the points inside the limit, and between one and three limits, per bin; without a
    typical distance (0) there is one bin.
    """
    limit2, inner = mix[0] * mix[0], 0.5 / (mix[1] * mix[1])
    tangent = np.empty((2, 3))
    tangents(base, tangent)
    step_l = 1 if var_left.shape[0] > 1 else 0
    step_r = 1 if var_right.shape[0] > 1 else 0
    near[:] = 0.0
    band[:] = 0.0
    n00 = n10 = n11 = n20 = n21 = n22 = n30 = n31 = n32 = n33 = 0.0
    n40 = n41 = n42 = n43 = n44 = 0.0
    h0 = h1 = h2 = h3 = h4 = 0.0
    weights = squares = 0.0
    for i in range(left.shape[0]):
        f, dlx, dly, drx, dry, a0, a1, a2, a3, a4 = coplanarity(
            base, rotation, tangent, left[i, 0], left[i, 1], right[i, 0], right[i, 1]
        )
        q = (
            var_left[i * step_l] * (dlx * dlx + dly * dly)
            + var_right[i * step_r] * (drx * drx + dry * dry)
            + 1e-300
        )
        d2 = f * f / q
        if d2 >= 9.0 * limit2:
            continue
        k = 0
        if mix[2] > 0.0:
            noise = (var_left[i * step_l] + var_right[i * step_r]) * mix[1] * mix[1]
            k = depth_bin(base, rotation, mix, noise, left[i, 0], left[i, 1], right[i, 0], right[i, 1])
        if d2 >= limit2:
            band[k] += 1.0
            continue
        near[k] += 1.0
        p = 1.0
        if odds[k] > 0.0:
            p = 1.0 / (1.0 + odds[k] * np.exp(d2 * inner))
        weights += p
        squares += p * d2
        p /= q
        n00 += p * a0 * a0
        n10 += p * a1 * a0
        n11 += p * a1 * a1
        n20 += p * a2 * a0
        n21 += p * a2 * a1
        n22 += p * a2 * a2
        n30 += p * a3 * a0
        n31 += p * a3 * a1
        n32 += p * a3 * a2
        n33 += p * a3 * a3
        n40 += p * a4 * a0
        n41 += p * a4 * a1
        n42 += p * a4 * a2
        n43 += p * a4 * a3
        n44 += p * a4 * a4
        p *= f
        h0 -= p * a0
        h1 -= p * a1
        h2 -= p * a2
        h3 -= p * a3
        h4 -= p * a4
    normal[0, 0], normal[1, 1], normal[2, 2], normal[3, 3], normal[4, 4] = n00, n11, n22, n33, n44
    normal[1, 0], normal[2, 0], normal[2, 1], normal[3, 0], normal[3, 1] = n10, n20, n21, n30, n31
    normal[3, 2], normal[4, 0], normal[4, 1], normal[4, 2], normal[4, 3] = n32, n40, n41, n42, n43
    for i in range(5):
        for j in range(i):
            normal[j, i] = normal[i, j]
    rhs[0], rhs[1], rhs[2], rhs[3], rhs[4] = h0, h1, h2, h3, h4
    return weights, squares


@kernel
def update_mixture(
    mix: Array, odds: Array, weights: float, squares: float, near: Array, band: Array, widest: float
) -> None:
    """Scale of the good points and odds of bad ones, per depth bin, from the sums of a pass."""
    if weights < 6.0:
        return
    limit = mix[0]
    mix[1] = max(np.sqrt(squares / weights), 1e-3)
    # A limit that cuts into the good points would make their scatter look too small.
    mix[0] = min(max(limit, 3.5 * mix[1]), widest)
    filled = BINS if mix[2] > 0.0 else 1
    bad = 0.0
    for k in range(filled):
        bad += band[k]
    for k in range(filled):
        # Bad points are as dense inside the limit as between one and three limits: half as many there.
        # An almost empty bin borrows from the average of all bins.
        expected = 0.5 * band[k] if filled == 1 else (band[k] + bad / filled) / 3.0
        good = max(near[k] - expected - np.sqrt(expected), 0.001 * near[k] + 1e-6)
        odds[k] = expected / (2.0 * limit) * mix[1] * np.sqrt(2.0 * np.pi) / good
    if filled > 1:
        odds[0] = IMPOSSIBLE


@kernel
def typical_distance(left: Array, right: Array, use: Mask, base: Array, rotation: Array) -> float:
    """Median over the used points of the mean distance along both rays, in bases; 0 if unclear."""
    values = np.empty(left.shape[0])
    count = 0
    for i in range(left.shape[0]):
        if use[i]:
            lx, ly, rx, ry = left[i, 0], left[i, 1], right[i, 0], right[i, 1]
            s, t = depths(base, rotation, lx, ly, rx, ry)
            u = rotation[0, 0] * rx + rotation[0, 1] * ry - rotation[0, 2]
            v = rotation[1, 0] * rx + rotation[1, 1] * ry - rotation[1, 2]
            w = rotation[2, 0] * rx + rotation[2, 1] * ry - rotation[2, 2]
            d = lx * u + ly * v - w
            sine2 = (lx * lx + ly * ly + 1.0) * (u * u + v * v + w * w) - d * d
            values[count] = sine2 / (s + t) if s > 0.0 and t > 0.0 else 0.0
            count += 1
    if count < 5:
        return 0.0
    middle = np.median(values[:count])
    return 1.0 / middle if middle > 1e-9 else 0.0


@kernel
def refine(
    left: Array,
    right: Array,
    var_left: Array,
    var_right: Array,
    base: Array,
    rotation: Array,
    mix: Array,
    odds: Array,
    steps: int,
    widest: float,
    cofactor: Array,
) -> bool:
    """Reweighted Gauss-Newton steps; updates `mix` and `odds`; False if singular."""
    normal, rhs, step = np.empty((5, 5)), np.empty(5), np.empty(5)
    near, band = np.empty(BINS), np.empty(BINS)
    tangent = np.empty((2, 3))
    for _ in range(steps):
        weights, squares = accumulate(
            left, right, var_left, var_right, base, rotation, mix, odds, normal, rhs, near, band
        )
        if weights < 5.0 or not solve_five(normal, rhs, step, cofactor):
            return False
        tangents(base, tangent)
        size = 0.0
        for k in range(5):
            size = max(size, abs(step[k]))
        if size > 0.5:
            return False
        move(base, rotation, tangent, step)
        update_mixture(mix, odds, weights, squares, near, band, widest)
    return True


@kernel
def mark_inliers(
    left: Array,
    right: Array,
    var_left: Array,
    var_right: Array,
    base: Array,
    rotation: Array,
    mix: Array,
    odds: Array,
    bounds: Array,
    inlier: Mask,
) -> int:
    """Points that are likelier good than bad and within 3.29 scales; returns how many.

    `bounds`: smallest and largest limit in sigmas, whatever the mixture says.
    """
    step_l = 1 if var_left.shape[0] > 1 else 0
    step_r = 1 if var_right.shape[0] > 1 else 0
    e = np.empty(9)
    essential_from_pose(base, rotation, e)
    limits2 = np.empty(BINS)
    widest = 0.0
    for k in range(BINS):
        limit2 = 10.8241 * mix[1] * mix[1]
        if odds[k] > 0.0:
            limit2 = min(limit2, 2.0 * mix[1] * mix[1] * max(-np.log(odds[k]), 0.0))
        limits2[k] = min(max(limit2, bounds[0] * bounds[0]), bounds[1] * bounds[1])
        widest = max(widest, limits2[k])
    count = 0
    for i in range(left.shape[0]):
        lx, ly, rx, ry = left[i, 0], left[i, 1], right[i, 0], right[i, 1]
        d2 = square_distance(e, var_left[i * step_l], var_right[i * step_r], lx, ly, rx, ry)
        inlier[i] = False
        if d2 < widest:
            k = 0
            if mix[2] > 0.0:
                noise = (var_left[i * step_l] + var_right[i * step_r]) * mix[1] * mix[1]
                k = depth_bin(base, rotation, mix, noise, lx, ly, rx, ry)
            if d2 < limits2[k]:
                inlier[i] = True
                count += 1
    return count


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
    b_try, rot_try, e_try = np.empty(3), np.empty((3, 3)), np.empty(9)
    mix, odds, cofactor = np.empty(3), np.zeros(BINS), np.empty((5, 5))
    var_l, var_r = np.array([vl]), np.array([vr])
    best_cost, best_inliers = np.inf, 0
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
            best_cost, best_inliers = cost, inliers
            base[:] = b
            rotation[:] = rot
            for limit_factor in (2.0, 1.0):
                b_try[:] = base
                rot_try[:] = rotation
                mix[0], mix[1], mix[2] = limit * limit_factor, limit / 3.0, 0.0
                odds[0] = 0.0
                if refine(left, right, var_l, var_r, b_try, rot_try, mix, odds, 2, limit, cofactor):
                    essential_from_pose(b_try, rot_try, e_try)
                    cost, inliers = score(e_try, left, right, vl, vr, limit2, 0, best_cost)
                    if cost < best_cost:
                        best_cost, best_inliers = cost, inliers
                        base[:] = b_try
                        rotation[:] = rot_try
            good = (best_inliers / m) ** 5
            if good >= 1.0 - 1e-12:
                needed = 0
            elif good > 1e-12:
                needed = min(most, int(np.log(1.0 - confidence) / np.log(1.0 - good)) + 1)
    best[0], best[1], best[2] = best_cost, best_inliers, sample
    return best_inliers >= 5


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
    limit = numbers[0]
    state = np.empty(1, np.uint64)
    state[0] = np.uint64(seed) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(0xD1B54A32D192ED03)
    for _ in range(8):
        next_random(state)
    m = min(n, int(numbers[4]))
    chosen = np.empty(m, np.int64)
    draw_subset(state, n, chosen)
    sub_left, sub_right = np.empty((m, 2)), np.empty((m, 2))
    vl = vr = 0.0
    for i in range(m):
        j = chosen[i]
        for k in range(2):
            sub_left[i, k], sub_right[i, k] = left[j, k], right[j, k]
        vl += var_left[j if var_left.shape[0] > 1 else 0] / m
        vr += var_right[j if var_right.shape[0] > 1 else 0] / m
    best = np.zeros(3)
    found = search(
        sub_left,
        sub_right,
        vl,
        vr,
        limit,
        numbers[1],
        numbers[2],
        numbers[3],
        state,
        base,
        rotation,
        best,
    )
    out[0], out[1], out[2] = best[2], m, best[1]
    if not found:
        return False
    kept_base, kept_rotation = base.copy(), rotation.copy()
    sub_inlier = np.ones(m, np.bool_)
    mix, odds, bounds = np.array([limit, limit / 3.0, 0.0]), np.zeros(BINS), numbers[6:8]
    var_l, var_r = np.array([vl]), np.array([vr])
    e = np.empty(9)
    first, second, rot = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    widest = numbers[8] * limit
    fine = refine(sub_left, sub_right, var_l, var_r, base, rotation, mix, odds, 2, widest, cofactor)
    while fine and mix[0] > limit * 1.02 and mix[0] < widest:
        # The noise is larger than stated: widen until the limit has found its place.
        limit = mix[0]
        fine = refine(sub_left, sub_right, var_l, var_r, base, rotation, mix, odds, 1, widest, cofactor)
    if not fine:
        base[:] = kept_base
        rotation[:] = kept_rotation
    mark_inliers(sub_left, sub_right, var_l, var_r, base, rotation, mix, odds, bounds, sub_inlier)
    essential_from_pose(base, rotation, e)
    pose_from_essential(e, base, first, second)
    choose_arrangement(sub_left, sub_right, sub_inlier, base, first, second, rot)
    rotation[:] = rot
    kept_base[:] = base
    kept_rotation[:] = rotation
    mix[2] = typical_distance(sub_left, sub_right, sub_inlier, base, rotation)
    odds[:] = odds[0]
    if mix[2] > 0.0:
        odds[0] = IMPOSSIBLE
    fine = refine(sub_left, sub_right, var_l, var_r, base, rotation, mix, odds, 3, widest, cofactor)
    last = int(numbers[5])
    if fine and n > m:
        fine = refine(left, right, var_left, var_right, base, rotation, mix, odds, last, widest, cofactor)
    if not fine:
        base[:] = kept_base
        rotation[:] = kept_rotation
    out[3] = mark_inliers(left, right, var_left, var_right, base, rotation, mix, odds, bounds, inlier)
    out[4], out[5] = mix[1], mix[2]
    front, _behind = count_in_front(left, right, inlier, base, rotation)
    out[6] = front
    return True
