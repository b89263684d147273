"""Other orientations that fit the same points: the second solution of a plane, critical surfaces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import kernel
from stereomate.relative.kernels.coplanarity import adjust
from stereomate.relative.kernels.five_point import MAX_SOLUTIONS, five_point
from stereomate.relative.kernels.mixture import square_distance
from stereomate.relative.kernels.pose import (
    choose_arrangement,
    essential_from_pose,
    pose_from_essential,
    share_behind,
)
from stereomate.relative.kernels.robust import MOST_BEHIND
from stereomate.relative.kernels.sampling import draw_five

Array = NDArray[np.float64]
Words = NDArray[np.uint64]

# Poses nearer than this (sine of the angle, about 1°) are one and the same minimum.
_SAME = 0.02
_CANDIDATES = 6
# Points that a start is first adjusted to.
_FIRST_LOOK = 60


@kernel
def pose_distance(base: Array, rotation: Array, other_base: Array, other_rotation: Array) -> float:
    """Largest difference of base components and rotation matrix elements."""
    largest = 0.0
    for i in range(3):
        largest = max(largest, abs(base[i] - other_base[i]))
        for j in range(3):
            largest = max(largest, abs(rotation[i, j] - other_rotation[i, j]))
    return largest


@kernel
def candidates(
    left: Array,
    right: Array,
    vl: float,
    vr: float,
    samples: int,
    state: Words,
    base: Array,
    rotation: Array,
    costs: Array,
    bases: Array,
    rotations: Array,
) -> None:
    """The best starts, other than `base` and `rotation`, among solutions of random five-point problems."""
    m = left.shape[0]
    five = np.empty(5, np.int64)
    l5, r5 = np.empty((5, 3)), np.empty((5, 3))
    essentials = np.empty((MAX_SOLUTIONS, 9))
    use5 = np.ones(5, np.bool_)
    b, first, second, rot = np.empty(3), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    e = np.empty(9)
    costs[:] = np.inf
    for _ in range(samples):
        draw_five(state, m, five)
        for k in range(5):
            j = five[k]
            l5[k, 0], l5[k, 1], l5[k, 2] = left[j, 0], left[j, 1], -1.0
            r5[k, 0], r5[k, 1], r5[k, 2] = right[j, 0], right[j, 1], -1.0
        for s in range(five_point(l5, r5, essentials)):
            if not pose_from_essential(essentials[s], b, first, second):
                continue
            if choose_arrangement(l5, r5, use5, b, first, second, rot) < 4:
                continue
            if pose_distance(b, rot, base, rotation) < _SAME:
                continue
            essential_from_pose(b, rot, e)
            worst = np.argmax(costs)
            cost = 0.0
            for i in range(m):
                # A logarithm: one bad point must not hide a start that suits the others.
                d2 = square_distance(e, vl, vr, left[i, 0], left[i, 1], right[i, 0], right[i, 1])
                cost += np.log1p(d2)
                if cost >= costs[worst]:
                    break
            if cost < costs[worst]:
                costs[worst] = cost
                bases[worst] = b
                rotations[worst] = rot


@kernel
def other_minimum(
    left: Array,
    right: Array,
    vl: float,
    vr: float,
    samples: int,
    state: Words,
    base: Array,
    rotation: Array,
    found_base: Array,
    found_rotation: Array,
) -> tuple[float, float]:
    """Best minimum of the square sum, other than `base` and `rotation`, with the points before the cameras.

    Returns (square sum in variances, share of the points not behind); (inf, 0) if every start leads to the
    known minimum.
    """
    m = left.shape[0]
    costs = np.empty(_CANDIDATES)
    bases, rotations = np.empty((_CANDIDATES, 3)), np.empty((_CANDIDATES, 3, 3))
    candidates(left, right, vl, vr, samples, state, base, rotation, costs, bases, rotations)
    b, first, second, rot = np.empty(3), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    e, use = np.empty(9), np.ones(m, np.bool_)
    cov_left, cov_right = np.array([[vl, 0.0, vl]]), np.array([[vr, 0.0, vr]])
    weight, residual, cofactor = np.ones(m), np.zeros((m, 4)), np.empty((5, 5))
    # A part of the points says whether a start leads anywhere.
    stride = max(1, m // _FIRST_LOOK)
    part_left, part_right = left[::stride].copy(), right[::stride].copy()
    part = part_left.shape[0]
    best, share = np.inf, 0.0
    for k in range(_CANDIDATES):
        if not np.isfinite(costs[k]):
            continue
        total, _iterations, _state = adjust(
            part_left,
            part_right,
            cov_left,
            cov_right,
            weight[:part],
            bases[k],
            rotations[k],
            residual[:part],
            cofactor,
            3,
        )
        # Three steps bring a start near a minimum; one far off the noise is no rival, and most have come to
        # the known one.
        if total > 20.0 * part or pose_distance(bases[k], rotations[k], base, rotation) < _SAME:
            continue
        total, _iterations, _state = adjust(
            left, right, cov_left, cov_right, weight, bases[k], rotations[k], residual, cofactor, 12
        )
        if not total < best or pose_distance(bases[k], rotations[k], base, rotation) < _SAME:
            continue
        # An arrangement with the points behind the cameras is no orientation.
        essential_from_pose(bases[k], rotations[k], e)
        pose_from_essential(e, b, first, second)
        choose_arrangement(left, right, use, b, first, second, rot)
        behind = share_behind(left, right, use, b, rot, vl + vr)
        if behind > MOST_BEHIND or pose_distance(b, rot, base, rotation) < _SAME:
            continue
        best, share = total, 1.0 - behind
        found_base[:] = b
        found_rotation[:] = rot
    return best, share
