"""Good and bad correspondences of an orientation: a mixture by distance and depth, and its refinement.

Distances are closures over their standard deviations: Sampson distances in sigmas. Good points are normally
distributed round zero and have the depths of the terrain, bad ones are spread evenly over both.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import kernel
from stereomate.relative.kernels.coplanarity import NO_SUMS, add_condition, coplanarity, write_normal
from stereomate.relative.kernels.pose import essential_from_pose, move, ray_geometry, solve_five, tangents

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Depth bins: inverse distance from -1 to 3 times the typical one in eighths, and two tails.
BINS = 34
_BINS_PER_UNIT = 8.0
# Odds of a point behind the cameras.
IMPOSSIBLE = 1e30


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
def depth_bin(
    base: Array, rotation: Array, mix: Array, variance: float, lx: float, ly: float, rx: float, ry: float
) -> int:
    """Bin of a point by its inverse distance relative to the typical one (`mix[2]`).

    Bad points have any distance, good ones share those of the terrain. The last bin is a tail; the first
    is for points behind a camera by more than their noise (`variance` of the angle between the rays).
    """
    near_left, near_right, sine2, squares = ray_geometry(base, rotation, lx, ly, rx, ry)
    # Parallax over base: the inverse of the distance along either ray, the smaller of both.
    parallax = sine2 / (abs(near_left) + abs(near_right) + 1e-300)
    if near_left < 0.0 or near_right < 0.0:
        if sine2 > 16.0 * variance * squares:
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
    sums = NO_SUMS
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
        sums = add_condition(sums, p, f, a0, a1, a2, a3, a4)
    write_normal(sums, normal, rhs)
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
            s, t, sine2, _ = ray_geometry(base, rotation, left[i, 0], left[i, 1], right[i, 0], right[i, 1])
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
