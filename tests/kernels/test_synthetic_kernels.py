"""Kernels of the synthetic world against plain numpy; also run with bounds checks."""

from __future__ import annotations

import math

import numpy as np
import pytest

from stereomate.synthetic.kernels.curve import (
    EXPONENTS,
    curve_of_ray,
    point_on_curve,
    shift_terms,
    velocity_on_curve,
)
from stereomate.synthetic.kernels.render import edge_pixels, rays_inside_pixels
from stereomate.synthetic.kernels.texture import cover, grid_sample, periodic_noise, road_distance
from stereomate.synthetic.kernels.trace import (
    height_and_slope,
    meet_building,
    meet_tree,
    nearest_object,
    terrain_from_guess,
    trace_terrain,
)
from stereomate.synthetic.layout import road_distances
from stereomate.synthetic.objects import Reach, object_arrays
from stereomate.synthetic.survey import make_survey


def monomials(points):
    return np.prod(points[:, None, :] ** EXPONENTS, axis=-1)


def line(px, py, ph, vx, vy, vh):
    curve = np.zeros((3, 5))
    curve[:, 0], curve[:, 1] = (px, py, ph), (vx, vy, vh)
    return curve


def test_shift_and_curve_are_the_polynomial_along_the_ray():
    rng = np.random.default_rng(0)
    terms, scale = rng.normal(size=(len(EXPONENTS), 3)), 700.0
    origin, direction = np.array([120.0, -40.0, 500.0]), np.array([0.3, -0.2, -0.93])
    shifted = shift_terms(EXPONENTS, terms, scale, *origin)
    curve = np.empty((3, 5))
    curve_of_ray(EXPONENTS, shifted, *direction, np.empty((3, 5)), curve)
    for s in (0.0, 17.0, 480.0):
        expected = monomials((origin + s * direction)[None] / scale) @ terms
        assert np.allclose(point_on_curve(curve, s), expected[0], rtol=1e-12, atol=1e-12)
        step = 1e-3
        slope = (np.array(point_on_curve(curve, s + step)) - point_on_curve(curve, s - step)) / (2.0 * step)
        assert np.allclose(velocity_on_curve(curve, s), slope, rtol=1e-7, atol=1e-10)


def test_height_and_slope_are_bilinear():
    heights = np.array([[1.0, 3.0, 4.0], [2.0, 8.0, 5.0]])
    h, east, north = height_and_slope(heights, 2.0, 1.0, -0.5)
    assert h == pytest.approx(0.75 * 2.0 + 0.25 * 5.0)
    assert east == pytest.approx((0.75 * 2.0 + 0.25 * 6.0) / 2.0)
    assert north == pytest.approx((2.0 - 5.0) / 2.0)
    assert height_and_slope(heights, 2.0, 4.0, -2.0)[0] == 5.0
    for x, y in ((-0.1, 0.0), (4.1, 0.0), (0.0, 0.1), (0.0, -2.1), (math.nan, 0.0)):
        assert math.isnan(height_and_slope(heights, 2.0, x, y)[0])


def test_first_of_several_crossings():
    """A flat ray over a row of ridges: the first ridge that is high enough, from either side."""
    x = np.arange(0.0, 200.0)
    heights = np.tile(4.0 * np.abs(np.sin(x / 12.0)) + 0.03 * x, (40, 1))
    steepest = np.abs(np.diff(heights, axis=1)).max()
    curve = line(2.0, -20.0, 6.5, 1.0, 0.0, -0.01)
    found = trace_terrain(curve, 0.0, heights, 1.0, steepest, 0.0)
    s = np.arange(0.0, 190.0, 1e-3)
    gap = 6.5 - 0.01 * s - np.interp(2.0 + s, x, heights[0])
    assert found == pytest.approx(s[np.argmax(gap < 0.0)], abs=2e-3)
    assert terrain_from_guess(curve, 0.0, 150.0, heights, 1.0, steepest) == pytest.approx(found, abs=1e-9)
    up = line(2.0, -20.0, 60.0, 1.0, 0.0, 1.0)
    assert math.isnan(trace_terrain(up, 0.0, heights, 1.0, steepest, 0.0))


def test_a_good_guess_and_none_find_the_same():
    rng = np.random.default_rng(4)
    heights = rng.uniform(0.0, 3.0, (30, 30))
    steepest = math.hypot(np.abs(np.diff(heights, axis=1)).max(), np.abs(np.diff(heights, axis=0)).max())
    for _ in range(50):
        vx, vy = rng.uniform(-0.2, 0.2, 2)
        curve = line(rng.uniform(10, 18), -rng.uniform(10, 18), 20.0, vx, vy, -1.0)
        plain = trace_terrain(curve, 0.0, heights, 1.0, steepest, 0.0)
        assert terrain_from_guess(curve, 0.0, 5.0, heights, 1.0, steepest) == pytest.approx(plain, abs=1e-9)


# cx, cy, cos, sin, half length, half width, base, eaves, slope
HOUSE = np.array([[10.0, -10.0, 1.0, 0.0, 5.0, 3.0, 0.0, 6.0, 0.5]])


@pytest.mark.parametrize(
    ("start", "way", "t", "face"),
    [
        (
            (10.0, -8.5, 20.0),
            (0.0, 0.0, -20.0),
            (20.0 - 6.75) / 20.0,
            0,
        ),  # roof, north side: 6 + 0.5 (3 - 1.5)
        ((10.0, -11.5, 20.0), (0.0, 0.0, -20.0), (20.0 - 6.75) / 20.0, 1),  # roof, south side
        ((20.0, -10.0, 3.0), (-20.0, 0.0, 0.0), 0.25, 2),  # gable wall in the east
        ((0.0, -10.0, 3.0), (20.0, 0.0, 0.0), 0.25, 3),
        ((10.0, 0.0, 3.0), (0.0, -20.0, 0.0), 0.35, 4),
        ((10.0, -20.0, 3.0), (0.0, 20.0, 0.0), 0.35, 5),
    ],
)
def test_faces_of_a_house(start, way, t, face):
    found = meet_building(HOUSE, 0, *start, *way)
    assert found[0] == pytest.approx(t)
    assert found[1] == face


@pytest.mark.parametrize(
    ("start", "way"),
    [
        ((20.0, -8.0, 7.6), (-20.0, 0.0, 0.0)),  # over the eaves, under the ridge, beside the roof
        ((16.0, -10.0, 20.0), (0.0, 0.0, -20.0)),  # past the gable
        ((10.0, -10.0, 30.0), (0.0, 0.0, -10.0)),  # too short
    ],
)
def test_past_a_house(start, way):
    assert meet_building(HOUSE, 0, *start, *way)[0] == 2.0


def test_crowns():
    cone = np.array([[0.0, 0.0, 2.0, 12.0, 3.0, 0.0]])
    assert meet_tree(cone, 0, 0.0, 0.0, 22.0, 0.0, 0.0, -20.0) == pytest.approx(0.5)
    # at height 7 the cone is 1.5 m wide
    assert meet_tree(cone, 0, -10.0, 0.0, 7.0, 20.0, 0.0, 0.0) == pytest.approx(8.5 / 20.0)
    assert meet_tree(cone, 0, -10.0, 1.6, 7.0, 20.0, 0.0, 0.0) == 2.0
    ball = np.array([[0.0, 0.0, 4.0, 12.0, 3.0, 1.0]])
    assert meet_tree(ball, 0, 0.0, 0.0, 22.0, 0.0, 0.0, -20.0) == pytest.approx(0.5)
    assert meet_tree(ball, 0, -10.0, 0.0, 8.0, 20.0, 0.0, 0.0) == pytest.approx(7.0 / 20.0)
    assert meet_tree(ball, 0, -10.0, 0.0, 12.1, 20.0, 0.0, 0.0) == 2.0


def test_search_grid_finds_what_trying_all_finds():
    rng = np.random.default_rng(1)
    xy = np.stack([rng.uniform(5.0, 95.0, 40), -rng.uniform(5.0, 95.0, 40)], axis=-1)
    trees = np.column_stack([xy, np.full(40, 1.0), rng.uniform(5.0, 15.0, 40), rng.uniform(1.0, 3.0, 40)])
    trees = np.column_stack([trees, rng.integers(0, 2, 40).astype(float)])
    objects = object_arrays(HOUSE, trees, np.zeros((51, 51)), 2.0, Reach(1.0, 1.0, (0.6, 0.8)), 8.0)
    hits = 0
    for _ in range(400):
        start = np.array([rng.uniform(-5.0, 105.0), -rng.uniform(-5.0, 105.0), rng.uniform(0.0, 25.0)])
        way = np.array([rng.uniform(0.0, 100.0), -rng.uniform(0.0, 100.0), 0.0]) - start
        t, surface = nearest_object(
            objects.buildings,
            objects.trees,
            objects.cell,
            objects.cell_first,
            objects.cell_items,
            objects.cell_top,
            *start,
            *way,
            False,
        )
        every = [meet_building(HOUSE, 0, *start, *way)[0]]
        every += [meet_tree(trees, i, *start, *way) for i in range(40)]
        assert t == pytest.approx(min(every), abs=1e-12)
        assert (surface == 0) == (min(every) == 2.0)
        hits += surface != 0
    assert hits > 100


def test_textures_at_known_places():
    tile = np.arange(16.0, dtype=np.float32).reshape(4, 4)
    assert periodic_noise(tile, 1.5, 2.25) == pytest.approx(0.5 * (9 + 10) + 0.25 * 4)
    assert periodic_noise(tile, -0.5, 0.0) == pytest.approx(0.5 * (0 + 3))
    assert periodic_noise(tile, 7.5, -8.0) == pytest.approx(0.5 * (3 + 0))
    assert grid_sample(tile, 100.0, -5.0) == pytest.approx(3.0, abs=0.01)
    assert [cover(d, 0.4) for d in (-0.3, 0.0, 0.1, 0.3)] == pytest.approx([0.0, 0.5, 0.75, 1.0])


def test_road_distance_as_in_the_layout():
    roads = np.array([[50.0, -40.0, math.cos(0.3), math.sin(0.3), 12.0, 0.02, 5.0, 0.05, 3.0]])
    rng = np.random.default_rng(2)
    points = np.stack([rng.uniform(0.0, 100.0, 200), -rng.uniform(0.0, 80.0, 200)], axis=-1)
    expected = road_distances(roads, points)[0][:, 0]
    found = np.array([road_distance(roads, 0, x, y) for x, y in points])
    near = expected < 20.0
    assert near.sum() > 50
    assert np.allclose(found[near], expected[near], rtol=0.0, atol=1e-9)


def test_edges_and_the_rays_inside_them():
    surfaces = np.zeros((5, 6), dtype=np.int64)
    surfaces[2, 3] = 2
    distances = np.full((5, 6), 100.0)
    distances[4, 0] = 90.0
    found = np.empty((30, 2), dtype=np.int64)
    count = edge_pixels(surfaces, distances, 0, 5, found)
    pixels = {tuple(p) for p in found[:count].tolist()}
    around = {(r, c) for r in (1, 2, 3) for c in (2, 3, 4)}
    assert pixels == around | {(4, 0), (4, 1), (3, 0), (3, 1)}
    row, col = np.mgrid[:5, :6]
    rays = np.stack([0.1 * col, -0.1 * row, -np.ones((5, 6))], axis=-1)
    inner = np.empty((4, 3))
    rays_inside_pixels(rays, np.array([[4, 5]]), 2, inner)
    expected = [(0.1 * (5 + u), -0.1 * (4 + v), -1.0) for v in (-0.25, 0.25) for u in (-0.25, 0.25)]
    assert np.allclose(inner, expected, rtol=0.0, atol=1e-12)


def test_a_whole_small_photograph_stays_in_bounds():
    """With bounds checks on, every array access of the renderer is tried; rays leave the world as well."""
    from stereomate.synthetic.options import SurveyOptions

    survey = make_survey(
        SurveyOptions(
            strips=1,
            photos_per_strip=2,
            size_px=(96, 64),
            gsd_m=2.0,
            flying_height_m=260.0,
            relief_m=60.0,
            pixel_pitch_mm=0.4,
            buildings=6,
            trees=40,
            terrain_step_m=4.0,
        )
    )
    assert survey.render(0).min() >= 1
    hits = survey.world.first_hit(
        np.array(survey.survey.photographs[0].orientation.centre),
        np.random.default_rng(0).normal(size=(2000, 3)),
    )
    assert {"nothing", "terrain"} <= set(hits.kind.ravel().tolist())
