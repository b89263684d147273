"""Height sampling, ray intersection and occlusion against slow and independent ways of doing the same."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator
from scipy.optimize import brentq

from stereomate.terrain import kernels


def rough(seed: int, rows: int = 23, cols: int = 31, relief: float = 40.0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(100.0, 100.0 + relief, (rows, cols))


def sampled(function, patch: np.ndarray, cols, rows) -> np.ndarray:
    cols, rows = (np.ascontiguousarray(a, float).ravel() for a in np.broadcast_arrays(cols, rows))
    out = np.empty(cols.size)
    function(patch, cols, rows, out)
    return out


def test_bilinear_agrees_with_scipy() -> None:
    patch = rough(1)
    rng = np.random.default_rng(2)
    cols, rows = rng.uniform(0.5, 30.5, 500), rng.uniform(0.5, 22.5, 500)
    reference = RegularGridInterpolator((np.arange(23) + 0.5, np.arange(31) + 0.5), patch)
    np.testing.assert_allclose(
        sampled(kernels.bilinear_points, patch, cols, rows), reference(np.c_[rows, cols]), rtol=0, atol=1e-11
    )


def test_cubic_agrees_with_keys_convolution() -> None:
    """Keys' kernel as printed in his paper, summed over all nodes."""

    def keys(s: np.ndarray) -> np.ndarray:
        s, a = np.abs(s), -0.5
        near = (a + 2) * s**3 - (a + 3) * s**2 + 1
        far = a * s**3 - 5 * a * s**2 + 8 * a * s - 4 * a
        return np.where(s <= 1, near, np.where(s < 2, far, 0.0))

    patch = rough(3)
    rng = np.random.default_rng(4)
    cols, rows = rng.uniform(1.5, 29.5, 300), rng.uniform(1.5, 21.5, 300)
    weight_x = keys(cols[:, None] - (np.arange(31) + 0.5))
    weight_y = keys(rows[:, None] - (np.arange(23) + 0.5))
    reference = np.einsum("ki,ij,kj->k", weight_y, patch, weight_x)
    np.testing.assert_allclose(
        sampled(kernels.cubic_points, patch, cols, rows), reference, rtol=0, atol=1e-11
    )


def test_cubic_reproduces_a_quadratic_surface() -> None:
    x, y = np.meshgrid(np.arange(12) + 0.5, np.arange(10) + 0.5)

    def surface(x, y):
        return 3.0 + 0.7 * x - 0.2 * y + 0.05 * x * y + 0.11 * x * x - 0.06 * y * y

    cols, rows = np.random.default_rng(0).uniform(2.5, 7.5, (2, 100))
    np.testing.assert_allclose(
        sampled(kernels.cubic_points, surface(x, y), cols, rows), surface(cols, rows), rtol=0, atol=1e-12
    )


@pytest.mark.parametrize("points, margin", [(kernels.bilinear_points, 0.5), (kernels.cubic_points, 1.5)])
def test_outside_is_void_and_the_edge_is_not(points, margin: float) -> None:
    patch = rough(5)
    inside_cols = [margin, 31 - margin, margin, 31 - margin]
    inside_rows = [margin, margin, 23 - margin, 23 - margin]
    nodes = sampled(points, patch, inside_cols, inside_rows)
    k = int(margin - 0.5)
    np.testing.assert_array_equal(nodes, patch[[k, k, -1 - k, -1 - k], [k, -1 - k, k, -1 - k]])
    away = 1e-6  # nearer, the weights of the missing nodes round to zero
    outside = sampled(
        points,
        patch,
        [margin - away, 31 - margin + away, 12.3, 12.3, np.nan, 1e300, -1e300],
        [7.7, 7.7, margin - away, 23 - margin + away, 7.7, 7.7, 7.7],
    )
    assert np.isnan(outside).all()


@given(st.integers(0, 2**32 - 1), st.booleans())
@settings(deadline=None, max_examples=60)
def test_voids_count_only_with_weight(seed: int, on_lattice: bool) -> None:
    rng = np.random.default_rng(seed)
    patch = rough(seed, 9, 10)
    patch[rng.uniform(size=patch.shape) < 0.15] = np.nan
    col, row = rng.uniform(0.5, 9.5), rng.uniform(0.5, 8.5)
    if on_lattice:
        col = math.floor(col) + 0.5
    for points, reach in ((kernels.bilinear_points, 1), (kernels.cubic_points, 2)):
        value = sampled(points, patch, col, row)[0]
        filled = np.where(np.isnan(patch), 0.0, patch)
        padded_filled, padded_void = np.pad(filled, 3), np.pad(np.isnan(patch), 3, constant_values=True)
        needed = False
        for i in range(math.floor(row - 0.5) + 1 - reach, math.floor(row - 0.5) + 1 + reach):
            for j in range(math.floor(col - 0.5) + 1 - reach, math.floor(col - 0.5) + 1 + reach):
                weighs = (col - 0.5 != math.floor(col - 0.5) or j == math.floor(col - 0.5)) and (
                    row - 0.5 != math.floor(row - 0.5) or i == math.floor(row - 0.5)
                )
                needed |= bool(weighs and padded_void[i + 3, j + 3])
        assert math.isnan(value) == needed
        if not needed:
            expected = sampled(points, padded_filled, col + 3, row + 3)[0]
            assert value == pytest.approx(expected, abs=1e-10)


@pytest.mark.parametrize(
    "gradient, margin", [(kernels.bilinear_gradient, 0.6), (kernels.cubic_gradient, 1.6)]
)
def test_gradients_against_central_differences(gradient, margin: float) -> None:
    patch = rough(6)
    value = kernels.bilinear if gradient is kernels.bilinear_gradient else kernels.cubic
    rng = np.random.default_rng(7)
    step = 1e-4
    for _ in range(100):
        col = rng.integers(2, 28) + rng.uniform(0.51, 1.49)
        row = rng.integers(2, 20) + rng.uniform(0.51, 1.49)
        h, h_col, h_row = gradient(patch, col, row)
        assert h == pytest.approx(value(patch, col, row), abs=1e-11)
        assert h_col == pytest.approx(
            (value(patch, col + step, row) - value(patch, col - step, row)) / (2 * step), abs=3e-5
        )
        assert h_row == pytest.approx(
            (value(patch, col, row + step) - value(patch, col, row - step)) / (2 * step), abs=3e-5
        )
    assert math.isnan(gradient(patch, margin - 0.2, 5.0)[0])


@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.0, 0.013, -0.013, 0.31, -0.31, 1.0, 2.7]),
    st.sampled_from([0.0, 0.007, -0.02, 0.5, -1.0]),
)
@settings(deadline=None, max_examples=120)
def test_lines_are_the_points_along_them(seed: int, dcol: float, drow: float) -> None:
    rng = np.random.default_rng(seed)
    patch = rough(seed, 14, 17)
    patch[rng.uniform(size=patch.shape) < 0.03] = np.nan
    col, row = rng.uniform(-1, 18), rng.uniform(-1, 15)
    if seed % 3 == 0:
        col, row = math.floor(col) + 0.5, math.floor(row) + 0.5
    out = np.empty(400)
    steps = np.arange(400)
    for method, points in ((1, kernels.bilinear_points), (3, kernels.cubic_points)):
        kernels.sample_line(method, patch, col, row, dcol, drow, out)
        expected = sampled(points, patch, col + steps * dcol, row + steps * drow)
        np.testing.assert_allclose(out, expected, rtol=0, atol=1e-10)


def clearance(patch, start, direction, t) -> float:
    col, row, h = (start[k] + t * direction[k] for k in range(3))
    return h - kernels.bilinear(patch, col, row)


def brute_first_hit(patch, start, direction, t_max) -> float:
    ts = np.linspace(0.0, t_max, 20001)
    heights = sampled(
        kernels.bilinear_points, patch, start[0] + ts * direction[0], start[1] + ts * direction[1]
    )
    above = start[2] + ts * direction[2] - heights
    if not above[np.isfinite(above)].size or not above[np.isfinite(above)][0] > 0:
        return math.nan
    for k in np.flatnonzero(above <= 0):
        if above[k - 1] > 0:
            return brentq(lambda t: clearance(patch, start, direction, t), ts[k - 1], ts[k], xtol=1e-15)
        return math.nan
    return math.nan


@given(st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=60)
def test_first_hit_against_dense_steps(seed: int) -> None:
    rng = np.random.default_rng(seed)
    patch = rough(seed, 12, 15, relief=8.0)
    start = np.array([rng.uniform(-3, 18), rng.uniform(-3, 15), 109.0])
    target = np.array([rng.uniform(1, 14), rng.uniform(1, 11), 99.0])
    direction = target - start
    found = kernels.first_hit(patch, *start, *direction, 1.0)
    expected = brute_first_hit(patch, start, direction, 1.0)
    if math.isnan(expected):
        assert math.isnan(found) or abs(clearance(patch, start, direction, found)) < 1e-9
    else:
        # a grazing hit may slip between the dense steps: then the found one is earlier, and on the surface
        assert abs(clearance(patch, start, direction, found)) < 1e-9
        assert found < expected + 1e-12


def test_first_hit_vertical_level_and_missing() -> None:
    patch = np.full((6, 7), 50.0)
    assert kernels.first_hit(patch, 3.3, 2.2, 150.0, 0.0, 0.0, -1.0, 1e9) == pytest.approx(100.0, abs=1e-12)
    assert kernels.first_hit(patch, 3.3, 2.2, 50.0, 0.0, 0.0, -1.0, 1e9) == 0.0
    assert math.isnan(kernels.first_hit(patch, 3.3, 2.2, 49.0, 0.0, 0.0, -1.0, 1e9))
    assert math.isnan(kernels.first_hit(patch, 3.3, 2.2, 150.0, 0.0, 0.0, 1.0, 1e9))
    assert math.isnan(kernels.first_hit(patch, -3.0, 2.2, 50.5, 1.0, 0.0, 0.0, math.inf))
    patch[:, 3] = 60.0
    along = kernels.first_hit(patch, -3.0, 2.2, 55.0, 1.0, 0.0, 0.0, math.inf)
    assert along == pytest.approx(6.0, abs=1e-12)
    patch[:, 2] = np.nan
    assert math.isnan(kernels.first_hit(patch, -3.0, 2.2, 55.0, 1.0, 0.0, 0.0, math.inf))
    assert math.isnan(kernels.first_hit(patch[:1], 3.0, 0.5, 155.0, 0.0, 0.0, -1.0, 1e9))


def test_first_hits_is_first_hit() -> None:
    patch = rough(8, 12, 15, relief=8.0)
    rng = np.random.default_rng(9)
    starts = np.c_[rng.uniform(0, 15, 50), rng.uniform(0, 12, 50), np.full(50, 120.0)]
    directions = np.c_[rng.uniform(-2, 2, (50, 2)), np.full(50, -20.0)]
    out = np.empty(50)
    kernels.first_hits(patch, starts, directions, np.full(50, 2.0), out)
    one = [kernels.first_hit(patch, *s, *d, 2.0) for s, d in zip(starts, directions, strict=True)]
    np.testing.assert_array_equal(out, one)
    assert np.isfinite(out).sum() > 20


@given(st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=100)
def test_occlusion_against_dense_steps(seed: int) -> None:
    rng = np.random.default_rng(seed)
    patch = rough(seed, 20, 24, relief=6.0)
    if seed % 2:
        patch[rng.uniform(size=patch.shape) < 0.05] = np.nan
    col, row = rng.uniform(0.5, 23.5), rng.uniform(0.5, 19.5)
    if seed % 5 == 0:
        col = math.floor(col) + 0.5
    h = kernels.bilinear(patch, col, row)
    if math.isnan(h):
        return
    reach = rng.choice([5.0, 300.0])  # the nadir in the patch, or far outside
    direction = np.array([*rng.uniform(-reach, reach, 2), rng.uniform(0.1, 1.5) * reach])
    if seed % 7 == 0:
        direction[0] = 0.0
    h_max = np.nanmax(patch)
    ts = np.linspace(0.0, min(1.0, (h_max - h) / direction[2] + 1e-9), 4001)
    heights = sampled(kernels.bilinear_points, patch, col + ts * direction[0], row + ts * direction[1])
    depth = np.nanmax(np.append(heights - (h + ts * direction[2]), 0.0))
    maxima = kernels.block_maxima(patch, 4)
    centre = np.array([col, row, h]) + direction
    bounds = kernels.sight_bounds(patch, *centre)
    for tolerance in (1e-9, 0.05):
        found = kernels.occluded(patch, col, row, h, *direction, h_max, tolerance)
        assert found == kernels.occluded_bounded(patch, bounds, col, row, h, *centre, tolerance)
        assert found == kernels.occluded_blockwise(
            patch, maxima, 4, col, row, h, *direction, h_max, tolerance
        )
        if depth > tolerance + 1e-8:
            assert found
        elif depth < tolerance - 0.03:
            assert not found
    if direction[2] / math.hypot(*direction[:2]) > kernels.steepest_slope(patch, 1.0, 1.0) and not seed % 2:
        assert not kernels.occluded(patch, col, row, h, *direction, h_max, 1e-9)


def test_a_wall_hides_what_geometry_says() -> None:
    patch = np.zeros((5, 60))
    patch[:, 30] = 10.0
    hidden = [
        kernels.occluded(patch, col, 2.5, 0.0, -100.0, 0.0, 100.0, 10.0, 1e-6)
        for col in np.arange(31.5, 45, 0.25)
    ]
    # the crest is at col 30.5, 10 high: a way at 45 degrees over it meets the ground at 40.5
    expected = [col < 40.5 for col in np.arange(31.5, 45, 0.25)]
    assert hidden == expected
    assert kernels.occluded(patch, 31.0, 2.5, 5.0, -100.0, 0.0, 100.0, 10.0, 1e-6)
    assert not kernels.occluded(patch, 30.0, 2.5, 5.0, -100.0, 0.0, 100.0, 10.0, 1e-6)


def test_sight_bounds_hold_for_every_point_between() -> None:
    """Dense points of the surface on the way to the nadir never exceed the bound of the first cell."""
    patch = rough(12, 20, 24, relief=15.0)
    patch[5, 6] = np.nan
    rng = np.random.default_rng(13)
    for centre in ((11.3, 9.8, 180.0), (-40.0, 9.8, 200.0), (60.0, -35.0, 260.0), (12.5, 50.0, 150.0)):
        bounds = kernels.sight_bounds(patch, *centre)
        assert bounds.shape == (19, 23)
        for _ in range(200):
            col, row = rng.uniform(0.5, 23.5), rng.uniform(0.5, 19.5)
            t = np.linspace(0.0, 1.0, 400)
            cols, rows = col + t * (centre[0] - col), row + t * (centre[1] - row)
            heights = sampled(kernels.bilinear_points, patch, cols, rows)
            tangents = np.hypot(cols - centre[0], rows - centre[1]) / (centre[2] - heights)
            if np.isfinite(tangents).any():
                assert np.nanmax(tangents) <= bounds[int(row - 0.5), int(col - 0.5)] + 1e-12
    high = kernels.sight_bounds(patch, 11.3, 9.8, 105.0)
    assert np.isinf(high).any()


def test_block_maxima_and_steepest_slope() -> None:
    patch = rough(10, 19, 22)
    patch[3, 4] = np.nan
    maxima = kernels.block_maxima(patch, 5)
    assert maxima.shape == (4, 5)
    for m in range(4):
        for n in range(5):
            assert maxima[m, n] == np.nanmax(patch[m * 5 : m * 5 + 6, n * 5 : n * 5 + 6])
    plane = 0.3 * 2.0 * np.arange(9.0) + 0.4 * 5.0 * np.arange(7.0)[:, None]
    assert kernels.steepest_slope(plane, 2.0, 5.0) == pytest.approx(0.5, abs=1e-12)
    assert kernels.steepest_slope(np.full((4, 4), np.nan), 1.0, 1.0) == 0.0
