"""Parallax laws: values against formulas in high precision, inverses, slopes, tables, bad input."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from decimal import Decimal, getcontext

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import PchipInterpolator

from stereomate.errors import InputError
from stereomate.parallax.laws import ParallaxLaw, law_from_record, monotone_slopes

LINEAR = ParallaxLaw("linear", 900.0, 1500.0, 420.0)
LOGARITHMIC = ParallaxLaw("logarithmic", 900.0, 1500.0, 420.0)
NATURAL = ParallaxLaw("natural", 900.0, 1500.0, 420.0)
TABLE = ParallaxLaw.from_table(
    [-200.0, -50.0, 0.0, 120.0, 400.0],
    [-110.0, -28.0, 0.0, 75.0, 300.0],
    base_m=900.0,
    w0_m=1500.0,
    reference_m=420.0,
)
LAWS = [LINEAR, LOGARITHMIC, NATURAL, TABLE]
heights = st.floats(-800.0, 1700.0)


def test_values_against_forty_digits() -> None:
    getcontext().prec = 40
    for h in (-300.0, -1e-6, 0.0, 1e-6, 150.0, 1400.0):
        base, w0, height = Decimal(900), Decimal(1500), Decimal(h)
        expected = {
            "linear": base * height / w0,
            "logarithmic": base * (w0 / (w0 - height)).ln(),
            "natural": base * height / (w0 - height),
        }
        for law in (LINEAR, LOGARITHMIC, NATURAL):
            at_zero = replace(law, reference_m=0.0)
            assert float(at_zero.q(h)) == pytest.approx(float(expected[law.kind]), rel=1e-14, abs=1e-300)
            assert float(law.q(h + 420.0)) == pytest.approx(float(expected[law.kind]), rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.kind)
@given(height=heights)
@settings(deadline=None, max_examples=80)
def test_inverse_and_slope(law: ParallaxLaw, height: float) -> None:
    q = law.q(height)
    assert float(law.inverse(q)) == pytest.approx(height, abs=1e-9)
    step = 1e-3
    difference = (law.q(height + step) - law.q(height - step)) / (2 * step)
    assert float(law.slope(height)) == pytest.approx(float(difference), rel=2e-5)
    assert float(law.limit_slope(height) * law.slope(height)) == pytest.approx(1.0)
    assert float(law.height_per_pixel(height, 0.15)) == pytest.approx(0.15 / float(law.slope(height)))


def test_limit_slopes_as_published() -> None:
    """Along the row: linear w0/B, logarithmic (w0-h)/B, natural (w0-h)^2/(B w0)."""
    assert float(LINEAR.limit_slope(520.0)) == pytest.approx(1500 / 900)
    assert float(LOGARITHMIC.limit_slope(520.0)) == pytest.approx(1400 / 900)
    assert float(NATURAL.limit_slope(520.0)) == pytest.approx(1400**2 / (900 * 1500))
    assert math.isinf(ParallaxLaw("none", 900.0, 1500.0).limit_slope(3.0))


def test_above_the_flying_height_there_is_no_parallax() -> None:
    for law in (LOGARITHMIC, NATURAL):
        assert np.isnan(law.q([1920.0, 2500.0])).all()
        assert np.isnan(law.slope(1920.0))
    assert np.isnan(NATURAL.inverse(-900.0))
    assert np.isnan(LINEAR.q(np.nan))
    assert np.isnan(TABLE.q(np.nan))


def test_shapes_are_kept() -> None:
    assert LOGARITHMIC.q(np.full((2, 3), 430.0)).shape == (2, 3)
    assert LOGARITHMIC.q(430.0).shape == ()
    assert TABLE.inverse(np.zeros((4, 1, 2))).shape == (4, 1, 2)


def test_table_is_pchip_inside_and_straight_outside() -> None:
    reference = PchipInterpolator(TABLE.table_heights_m, TABLE.table_parallaxes_m)
    inside = np.linspace(-200.0, 400.0, 301)
    np.testing.assert_allclose(TABLE.q(inside + 420.0), reference(inside), rtol=0, atol=1e-11)
    below = TABLE.q(420.0 - np.array([200.0, 300.0, 400.0]))
    assert below[0] - below[1] == pytest.approx(below[1] - below[2])
    assert TABLE.slope(420.0 + 400.0) == pytest.approx(float(TABLE.slope(420.0 + 900.0)))


@given(st.lists(st.tuples(st.floats(0.1, 500), st.floats(0.01, 500)), min_size=1, max_size=8))
@settings(deadline=None, max_examples=100)
def test_any_rising_table_is_monotone_and_invertible(steps: list[tuple[float, float]]) -> None:
    knots = np.cumsum([(0.0, 0.0), *steps], axis=0)
    law = ParallaxLaw.from_table(list(knots[:, 0]), list(knots[:, 1]), base_m=900, w0_m=1500)
    dense = np.linspace(-50.0, knots[-1, 0] + 50.0, 400)
    q = law.q(dense)
    assert (np.diff(q) > 0).all()
    # where the law is nearly flat, rounding of q is magnified by 1/slope
    error = np.abs(law.inverse(q) - dense) * np.minimum(law.slope(dense), 1.0)
    assert error.max() < 1e-9
    assert (monotone_slopes(*knots.T.copy()) > 0).all()


def test_a_dense_table_of_the_logarithmic_law_is_that_law() -> None:
    knots = np.linspace(-200.0, 300.0, 101)
    law = ParallaxLaw.from_table(
        list(knots), list(LOGARITHMIC.q(knots + 420.0)), base_m=900, w0_m=1500, reference_m=420
    )
    inside = np.linspace(230.0, 710.0, 1000)
    np.testing.assert_allclose(law.q(inside), LOGARITHMIC.q(inside), rtol=0, atol=2e-5)


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.kind)
def test_record_and_back(law: ParallaxLaw) -> None:
    assert law_from_record(json.loads(json.dumps(law.as_record()))) == law


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: ParallaxLaw("cubic", 900.0, 1500.0), "law: must be one of linear"),
        (lambda: ParallaxLaw("linear", 0.0, 1500.0), "law.base_m: must be a positive number, got 0.0"),
        (lambda: ParallaxLaw("linear", 900.0, -1.0), "law.w0_m"),
        (lambda: ParallaxLaw("linear", math.nan, 1.0), "law.base_m"),
        (lambda: ParallaxLaw("linear", 900.0, 1500.0, math.inf), "law.reference_m"),
        (lambda: ParallaxLaw("table", 900.0, 1500.0), "two or more heights"),
        (lambda: ParallaxLaw("linear", 900.0, 1500.0, 0.0, (0.0, 1.0), (0.0, 1.0)), "table belongs"),
        (lambda: ParallaxLaw.from_table([0, 1], [1, 1], base_m=9, w0_m=9), "law.table_parallaxes_m"),
        (lambda: ParallaxLaw.from_table([1, 0], [0, 1], base_m=9, w0_m=9), "law.table_heights_m"),
        (lambda: law_from_record({"kind": "linear"}, file="stereo.json"), "stereo.json: law: must have"),
    ],
)
def test_bad_laws_are_refused(make, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()
