"""Kernels of relative orientation and matching, small, also run with numba's bounds checks."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import spline_filter

from stereomate.measurement.kernels.least_squares import CONVERGED, OUTSIDE, match_patch
from stereomate.measurement.kernels.matching import two_largest
from stereomate.measurement.kernels.noise import unit_noise
from stereomate.measurement.kernels.splines import spline_weights
from stereomate.relative.kernels.coplanarity import adjust, closure_and_image_derivatives, coplanarity
from stereomate.relative.kernels.five_point import MAX_SOLUTIONS, five_point
from stereomate.relative.kernels.polynomial import real_roots
from stereomate.relative.kernels.pose import (
    choose_arrangement,
    essential_from_pose,
    move,
    pose_from_essential,
    solve_five,
    tangents,
)
from stereomate.relative.kernels.robust import robust_pose
from stereomate.relative.kernels.sampling import draw_five, draw_subset


def turned(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def points_of_a_pair(n: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    base, rotation = np.array([0.96, 0.0, -0.28]), turned(0.2)
    points = np.column_stack([rng.uniform(-0.5, 1.5, (n, 2)), -rng.uniform(1.5, 2.5, n)])
    seen = (points - base) @ rotation
    return points[:, :2] / -points[:, 2:], seen[:, :2] / -seen[:, 2:], base, rotation


@pytest.mark.parametrize("seed", range(5))
def test_real_roots_are_those_of_numpy(seed):
    rng = np.random.default_rng(seed)
    real = rng.uniform(-5.0, 5.0, 4)
    pairs = [np.array([1.0, -2.0 * re, re * re + im * im]) for re, im in rng.uniform(0.5, 2.0, (3, 2))]
    poly = np.poly(real)
    for pair in pairs:
        poly = np.polymul(poly, pair)
    roots = np.empty(MAX_SOLUTIONS)
    count = real_roots(np.ascontiguousarray(poly[::-1]), roots)
    np.testing.assert_allclose(np.sort(roots[:count]), np.sort(real), rtol=1e-7)


def test_derivatives_of_the_condition():
    left, right, base, rotation = points_of_a_pair(1, 3)
    x = np.array([*left[0], *right[0]]) + 0.01
    tangent = np.empty((2, 3))
    tangents(base, tangent)
    found = np.array(coplanarity(base, rotation, tangent, *x))
    np.testing.assert_allclose(found[:5], closure_and_image_derivatives(base, rotation, *x))
    step = 1e-6
    for k in range(4):
        ends = [
            coplanarity(base, rotation, tangent, *(x + sign * step * np.eye(4)[k]))[0] for sign in (1, -1)
        ]
        assert found[1 + k] == pytest.approx((ends[0] - ends[1]) / (2 * step), abs=1e-9)
    for k in range(5):
        ends = []
        for sign in (1, -1):
            b, r = base.copy(), rotation.copy()
            move(b, r, tangent, sign * step * np.eye(5)[k])
            ends.append(coplanarity(b, r, tangent, *x)[0])
        assert found[5 + k] == pytest.approx((ends[0] - ends[1]) / (2 * step), abs=1e-9)


def test_pose_and_essential_matrix_are_inverse():
    left, right, base, rotation = points_of_a_pair(20, 1)
    essential = np.empty(9)
    essential_from_pose(base, rotation, essential)
    b, first, second, chosen = np.empty(3), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    assert pose_from_essential(-3.0 * essential, b, first, second)
    assert choose_arrangement(left, right, np.ones(20, np.bool_), b, first, second, chosen) == 20
    np.testing.assert_allclose(b, base, atol=1e-12)
    np.testing.assert_allclose(chosen, rotation, atol=1e-12)


def test_five_point_and_adjustment():
    left, right, base, rotation = points_of_a_pair(9, 2)
    rays = [np.column_stack([p[:5], -np.ones(5)]) for p in (left, right)]
    essentials = np.empty((MAX_SOLUTIONS, 9))
    count = five_point(rays[0], rays[1], essentials)
    truth = np.empty(9)
    essential_from_pose(base, rotation, truth)
    distances = [min(np.abs(e - truth).max(), np.abs(e + truth).max()) for e in essentials[:count]]
    assert min(distances) < 1e-9
    cov = np.array([[1e-6, 0.0, 1e-6]])
    b, r = base.copy(), rotation.copy()
    move(b, r, np.array([[0.0, 1.0, 0.0], [0.28, 0.0, 0.96]]), np.full(5, 0.01))
    total, _, state = adjust(left, right, cov, cov, np.ones(9), b, r, np.zeros((9, 4)), np.empty((5, 5)), 20)
    assert state == 0
    assert total < 1e-15
    np.testing.assert_allclose(r, rotation, atol=1e-10)


def test_robust_search_finds_good_points():
    left, right, base, _ = points_of_a_pair(60, 4)
    rng = np.random.default_rng(0)
    right[:20] = rng.uniform(-1.0, 1.0, (20, 2))
    variance, inlier = np.array([1e-8]), np.zeros(60, np.bool_)
    numbers = np.array([3.5, 0.999, 8, 2000, 1000, 3, 0.0, 1e9, 4.0])
    b, r, out = base.copy(), np.eye(3), np.zeros(8)
    assert robust_pose(left, right, variance, variance, numbers, 1, b, r, inlier, np.empty((5, 5)), out)
    np.testing.assert_allclose(b, base, atol=1e-6)
    assert inlier[20:].all()


def test_random_choices_are_distinct():
    state = np.array([12345], dtype=np.uint64)
    for n, m in ((10, 10), (1000, 5), (50, 20)):
        chosen = np.empty(m, np.int64)
        draw_subset(state, n, chosen)
        assert len(set(chosen.tolist())) == m
        assert 0 <= chosen.min() <= chosen.max() < n
    five = np.empty(5, np.int64)
    draw_five(state, 5, five)
    assert sorted(five.tolist()) == [0, 1, 2, 3, 4]


def test_singular_equations_are_seen():
    normal = np.ones((5, 5))
    assert not solve_five(normal, np.ones(5), np.empty(5), np.empty((5, 5)))
    good = np.diag([1.0, 2.0, 3.0, 4.0, 5.0])
    solution, inverse = np.empty(5), np.empty((5, 5))
    assert solve_five(good, np.arange(1.0, 6.0), solution, inverse)
    np.testing.assert_allclose(solution, 1.0)
    np.testing.assert_allclose(inverse, np.linalg.inv(good))


TAPS = np.array([0.25, 0.5, 0.25])


def test_noise_is_carried_back_to_the_pixels():
    """The propagation against the matrices it stands for."""
    rng = np.random.default_rng(1)
    radius, side, size = 2, 5, 24
    p = np.array([11.3, 1.05, 0.1, 12.8, -0.07, 0.95, 1.2, 4.0])
    coefficients = rng.normal(size=(2, side, side))
    right_taps = np.array([-0.1, 0.2, 0.8, 0.2, -0.1])
    out = np.empty(4)
    unit_noise(coefficients, radius, p, TAPS, right_taps, out)
    smooth = [sum(w * np.eye(size, k=k - len(t) // 2) for k, w in enumerate(t)) for t in (TAPS, right_taps)]
    take_left, take_right = np.zeros((side**2, size**2)), np.zeros((side**2, size**2))
    for row in range(side):
        for col in range(side):
            u, v = col - radius, row - radius
            take_left[row * side + col, (12 + v) * size + 12 + u] = 1.0
            x, y = p[0] + p[1] * u + p[2] * v - 0.5, p[3] + p[4] * u + p[5] * v - 0.5
            weights = spline_weights(x - np.floor(x)), spline_weights(y - np.floor(y))
            for m, k in np.ndindex(4, 4):
                pixel = (int(np.floor(y)) - 1 + m) * size + int(np.floor(x)) - 1 + k
                take_right[row * side + col, pixel] = weights[1][m] * weights[0][k]
    raw = [take_left @ np.kron(smooth[0], smooth[0]), p[6] * take_right @ np.kron(smooth[1], smooth[1])]
    covariance = sum(part @ part.T for part in raw)
    c = coefficients.reshape(2, -1)
    expected = c @ covariance @ c.T
    np.testing.assert_allclose(out, [*expected[0], expected[1, 1], np.trace(covariance)], rtol=1e-12)


def test_patch_at_the_very_edge():
    rng = np.random.default_rng(0)
    image = rng.uniform(0.0, 255.0, (30, 34)).astype(np.float32)
    spline = spline_filter(image, mode="mirror").astype(np.float32)
    numbers = np.array([3.0, 10.0, 0.001, 3.0, 0.5, 0.5, 1.0])
    for column, row, state in ((3, 3, OUTSIDE), (5, 5, CONVERGED), (28, 24, CONVERGED), (31, 15, OUTSIDE)):
        p = np.array([column + 0.5, 1.0, 0.0, row + 0.5, 0.0, 1.0, 1.0, 0.0])
        found = match_patch(image, spline, column, row, p, numbers, (TAPS, TAPS), np.empty(3), np.empty(3))
        assert found == state


def test_two_largest():
    best, first, second = np.empty(2, np.int64), np.empty(2), np.empty(2)
    two_largest(np.array([[0.1, 0.9, 0.5], [0.3, 0.2, 0.3]], np.float32), best, first, second)
    assert best.tolist() == [1, 0]
    np.testing.assert_allclose(second, [0.5, 0.3], rtol=1e-6)
