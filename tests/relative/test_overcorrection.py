"""The over-correction factor against linear algebra, the paper's special forms, and numeric derivatives."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import stereomate
from stereomate.errors import InputError, NotDeterminedError
from stereomate.relative.critical import critical_circle, side_of_circle
from stereomate.relative.overcorrection import (
    corrected_overcorrection_factor,
    factor_change_per_metre,
    flat_overcorrection_factor,
    overcorrection_factor,
    overcorrection_factors,
    tilt_coefficients,
    tilt_from_parallaxes,
    tilt_standard_deviation,
)

FLAT = [[0.0, 1500.0], [-500.0, 1500.0], [500.0, 1500.0]]
MOUNTAIN = [[40.0, 1500.0], [-480.0, 1290.0], [530.0, 1610.0]]


@st.composite
def sections(draw, least_angle=0.05):
    """Three points below O on rays at least `least_angle` apart in y/z: a terrain any aircraft may meet."""
    t1 = draw(st.floats(-0.3, 0.3))
    t3 = t1 - draw(st.floats(least_angle, 1.5))
    t5 = t1 + draw(st.floats(least_angle, 1.5))
    z = [draw(st.floats(200.0, 9000.0)) for _ in range(3)]
    points = np.array([[t * depth, depth] for t, depth in zip((t1, t3, t5), z, strict=True)])
    return points if draw(st.booleans()) else points[[0, 2, 1]]


def factor_by_linear_algebra(section, corrected=5):
    """n as the procedure defines it: clear two points, see what dω* = p*/K takes, compare with dω."""
    t = section[:, 0] / section[:, 1]
    k = (section**2).sum(axis=1) / section[:, 1]
    last = (corrected - 1) // 2
    cleared = [row for row in range(3) if row != last]
    tilt = 1e-3
    p = k * tilt
    # Parallax-free at the two cleared points by a change of A + t C.
    a, c = np.linalg.solve(np.column_stack((np.ones(2), t[cleared])), -p[cleared])
    remaining = p[last] + a + c * t[last]
    return tilt / (remaining / k[last])


def test_public_name():
    assert stereomate.overcorrection_factor(FLAT) == pytest.approx(5.0, abs=1e-12)
    assert isinstance(stereomate.overcorrection_factor(FLAT), float)


@settings(deadline=None, max_examples=200)
@given(sections(), st.sampled_from([1, 3, 5]))
def test_agrees_with_the_procedure_itself(section, corrected):
    n = overcorrection_factor(section, corrected)
    assume(abs(n) < 1e4)
    assert n == pytest.approx(factor_by_linear_algebra(section, corrected), rel=1e-9)


@settings(deadline=None)
@given(st.floats(300, 5000), st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(0.1, 1), st.floats(0.1, 1))
def test_formula_8_with_point_1_at_the_nadir(z1, h3, h5, t3, t5):
    z3, z5 = z1 * (1 - h3), z1 * (1 - h5)
    y3, y5 = -t3 * z3, t5 * z5
    denominator = y5 - y3 - (z5 / y5 * (h5 * z1) - z3 / y3 * (h3 * z1))
    assume(abs(denominator) > 1e-3 * z1)
    paper = y5 * (1 + z5**2 / y5**2) / denominator
    assert overcorrection_factor([[0, z1], [y3, z3], [y5, z5]]) == pytest.approx(paper, rel=1e-9)


@pytest.mark.parametrize(("f", "y"), [(150.0, 50.0), (150.0, 100.0), (1.0, 1.0)])
def test_flat_terrain_is_formula_1(f, y):
    expected = 0.5 * (1 + f**2 / y**2)
    assert flat_overcorrection_factor(f, y) == pytest.approx(expected, rel=1e-15)
    section = [[0, 10 * f], [-10 * y, 10 * f], [10 * y, 10 * f]]
    assert overcorrection_factor(section) == pytest.approx(expected, rel=1e-13)


def test_flat_factor_is_vectorised():
    np.testing.assert_allclose(flat_overcorrection_factor(3.0, [1.0, 3.0]), [5.0, 1.0])


@settings(deadline=None)
@given(sections(), st.floats(-3, 3), st.floats(1.1, 30))
def test_formula_2_finds_the_true_factor_from_any_first_one(section, tilt, first_factor):
    n = overcorrection_factor(section)
    assume(abs(n) < 1e3 and abs(tilt) > 0.01)
    k5 = (section[2] ** 2).sum() / section[2, 1]
    first = tilt * k5 / n
    second = (tilt - first_factor * first / k5) * k5 / n
    assume(abs(first - second) > 1e-3 * abs(first))
    assert corrected_overcorrection_factor(first_factor, first, second) == pytest.approx(n, rel=1e-8)


def test_formula_2_of_a_pass_without_effect_is_infinite():
    assert math.isinf(corrected_overcorrection_factor(5.0, 0.01, 0.01))


@pytest.mark.parametrize("values", [(5.0, 0.0, 0.1), (math.nan, 1.0, 0.1), (5.0, 1.0, math.inf)])
def test_formula_2_refuses(values):
    with pytest.raises(InputError):
        corrected_overcorrection_factor(*values)


@settings(deadline=None)
@given(sections(), st.floats(-0.05, 0.05), st.floats(-30, 30), st.floats(-30, 30))
def test_tilt_from_three_parallaxes(section, tilt, a, c):
    assume(abs(overcorrection_factor(section)) < 1e3)
    t = section[:, 0] / section[:, 1]
    k = (section**2).sum(axis=1) / section[:, 1]
    assert tilt_from_parallaxes(section, a + k * tilt + t * c) == pytest.approx(tilt, abs=1e-9)


def test_tilt_is_formula_4_with_point_1_at_the_nadir():
    z1, (y3, z3), (y5, z5) = 1500.0, (-480.0, 1290.0), (530.0, 1610.0)
    h3, h5 = z1 - z3, z1 - z5
    p1, p3, p5 = 1.2, -0.4, 2.6
    paper = ((p5 - p1) * z5 / y5 - (p3 - p1) * z3 / y3) / (y5 - y3 - (z5 / y5 * h5 - z3 / y3 * h3))
    assert tilt_from_parallaxes([[0, z1], [y3, z3], [y5, z5]], [p1, p3, p5]) == pytest.approx(
        paper, rel=1e-12
    )


def test_two_points_on_one_ray_give_a_tilt_but_no_factor():
    section = np.array([[300.0, 1500.0], [200.0, 1000.0], [-400.0, 1200.0]])
    assert math.isnan(overcorrection_factor(section, 5))
    assert np.isfinite(overcorrection_factors(section)[:2]).all()
    t = section[:, 0] / section[:, 1]
    k = (section**2).sum(axis=1) / section[:, 1]
    assert tilt_from_parallaxes(section, 3.0 + 0.01 * k - 7.0 * t) == pytest.approx(0.01, rel=1e-10)
    with pytest.raises(NotDeterminedError, match="one ray"):
        critical_circle(section)
    with pytest.raises(NotDeterminedError, match="one ray"):
        side_of_circle(section)


@settings(deadline=None, max_examples=200)
@given(
    st.floats(100, 5000),
    st.floats(-0.4, 0.4),
    st.lists(st.floats(0.7, 2.2), min_size=3, max_size=3, unique_by=lambda v: round(v, 2)),
)
def test_circle_through_the_centre_is_critical(radius, turn, angles):
    # Points by their direction from the centre of the circle, which a turn puts beside the nadir.
    assume(min(abs(a - b) for i, a in enumerate(angles) for b in angles[:i]) > 0.02)
    centre = radius * np.array([math.sin(turn), math.cos(turn)])
    section = centre + radius * np.stack((np.cos(angles), np.sin(angles)), axis=-1)
    assume((section[:, 1] > 0.05 * radius).all())
    assert math.isinf(overcorrection_factor(section))
    assert np.isinf(overcorrection_factors(section)).all()
    assert side_of_circle(section) == "on"
    assert math.isnan(tilt_from_parallaxes(section, [1.0, 2.0, 3.0]))
    assert math.isinf(tilt_standard_deviation(section))
    assert np.isnan(factor_change_per_metre(section)).all()
    circle = critical_circle(section)
    np.testing.assert_allclose((circle.centre_y, circle.centre_z), centre, rtol=1e-9, atol=1e-9 * radius)
    assert circle.signed_distance(section[2]) == pytest.approx(0.0, abs=1e-9 * radius)


@settings(deadline=None)
@given(sections())
def test_negative_inside_the_circle_and_positive_outside(section):
    circle = critical_circle(section)
    distance = circle.signed_distance(section[2])
    assume(abs(distance) > 1e-6 * circle.radius)
    assert (overcorrection_factor(section) < 0) == (distance < 0)
    assert side_of_circle(section) == ("inside" if distance < 0 else "outside")
    outline = circle.outline(37)
    np.testing.assert_allclose(outline[[0, -1]], 0.0, atol=1e-9 * circle.radius)


def test_depths_of_the_circle_are_critical_for_point_5():
    section = np.array(MOUNTAIN)
    circle = critical_circle(section)
    for z in circle.depths_at(section[2, 0]):
        moved = section.copy()
        moved[2, 1] = z
        assert abs(overcorrection_factor(moved)) > 1e10
    assert circle.depths_at(circle.centre_y + 1.01 * circle.radius) is None


@settings(deadline=None)
@given(sections(), st.sampled_from([1, 3, 5]))
def test_change_per_metre_of_height_is_the_derivative(section, corrected):
    assume(abs(overcorrection_factor(section, corrected)) < 100)
    change = factor_change_per_metre(section, corrected)
    for row in range(3):
        up, down = section.copy(), section.copy()
        up[row, 1] -= 0.01
        down[row, 1] += 0.01
        numeric = (overcorrection_factor(up, corrected) - overcorrection_factor(down, corrected)) / 0.02
        assert change[row] == pytest.approx(numeric, rel=1e-4, abs=1e-8)


def test_standard_deviation_of_the_tilt_is_that_of_simulated_parallaxes():
    rng = np.random.default_rng(5)
    section = np.array(MOUNTAIN)
    errors = rng.normal(size=(200_000, 3)) * [0.02, 0.05, 0.03]
    tilts = tilt_from_parallaxes(section, errors)
    # 200 000 draws know a standard deviation to 0.16 %; four times that is allowed.
    assert tilt_standard_deviation(section, [0.02, 0.05, 0.03]) == pytest.approx(tilts.std(), rel=0.0064)


def test_coefficients_are_factors_over_k():
    section = np.array(MOUNTAIN)
    k = (section**2).sum(axis=1) / section[:, 1]
    np.testing.assert_allclose(tilt_coefficients(section) * k, overcorrection_factors(section), rtol=1e-13)


@pytest.mark.parametrize(("left", "right"), [(1, 2), (3, 4), (5, 6)])
def test_points_of_both_sections(left, right):
    assert overcorrection_factor(MOUNTAIN, left) == overcorrection_factor(MOUNTAIN, right)
    row = (left - 1) // 2
    assert overcorrection_factors(MOUNTAIN)[row] == overcorrection_factor(MOUNTAIN, left)


def test_vectorised_over_leading_axes():
    rng = np.random.default_rng(3)
    many = np.stack((rng.uniform(-900, 900, (4, 5, 3)), rng.uniform(500, 2000, (4, 5, 3))), axis=-1)
    values = overcorrection_factor(many)
    assert values.shape == (4, 5)
    assert values[2, 3] == overcorrection_factor(many[2, 3])
    assert overcorrection_factors(many).shape == (4, 5, 3)
    assert factor_change_per_metre(many).shape == (4, 5, 3)
    assert tilt_standard_deviation(many, 0.1).shape == (4, 5)
    assert overcorrection_factor(many[:, ::2, :, :]).shape == (4, 3)
    assert overcorrection_factor(np.empty((0, 3, 2))).shape == (0,)


def test_scale_and_mirror():
    section = np.array(MOUNTAIN)
    n = overcorrection_factor(section)
    assert overcorrection_factor(section * 1e-3) == pytest.approx(n, rel=1e-13)
    assert overcorrection_factor(section * [-1, 1]) == pytest.approx(n, rel=1e-13)


@pytest.mark.parametrize(
    "section",
    [
        [[0, 1500], [-500, 1500]],
        [0.0, 1.0],
        [["a", "b"]] * 3,
        [[0, math.nan], [-500, 1500], [500, 1500]],
        [[math.inf, 1500], [-500, 1500], [500, 1500]],
        [[0, 1500], [-500, -1500], [500, 1500]],
        [[0, 0], [-500, 1500], [500, 1500]],
        [[0, 1500], [-1e300, 1e-200], [500, 1500]],
    ],
)
def test_wrong_sections_are_refused(section):
    with pytest.raises(InputError, match="section"):
        overcorrection_factor(section)


def test_the_wrong_one_of_many_is_named():
    many = np.array([FLAT] * 7)
    many[4, 1, 1] = np.nan
    with pytest.raises(InputError, match="section 4"):
        overcorrection_factor(many)


@pytest.mark.parametrize("corrected", [0, 7, -1])
def test_points_are_1_to_6(corrected):
    with pytest.raises(InputError, match="corrected"):
        overcorrection_factor(FLAT, corrected)


def test_other_wrong_arguments():
    with pytest.raises(InputError, match="ordinate"):
        flat_overcorrection_factor(150.0, 0.0)
    with pytest.raises(InputError, match="principal_distance"):
        flat_overcorrection_factor(-150.0, 50.0)
    with pytest.raises(InputError, match="parallaxes"):
        tilt_from_parallaxes(FLAT, [1.0, 2.0])
    with pytest.raises(InputError, match="parallaxes"):
        tilt_from_parallaxes(FLAT, [1.0, 2.0, math.nan])
    with pytest.raises(InputError, match="parallax_std"):
        tilt_standard_deviation(FLAT, -1.0)


def test_a_million_sections_take_less_than_a_tenth_of_a_second():
    rng = np.random.default_rng(0)
    many = np.stack((rng.uniform(-900, 900, (10**6, 3)), rng.uniform(500, 2000, (10**6, 3))), axis=-1)
    overcorrection_factor(many[:10])
    # The best of a few runs: other work on the machine is not what is measured.
    times = []
    for _ in range(5):
        start = time.perf_counter()
        overcorrection_factor(many)
        times.append(time.perf_counter() - start)
    assert min(times) < 0.1
