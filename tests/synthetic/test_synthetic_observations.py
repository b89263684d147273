"""Observations: exact where they say so, noisy as ordered, gross errors where they were planted."""

from __future__ import annotations

import numpy as np
import pytest

from stereomate.errors import InputError
from stereomate.synthetic.observations import (
    NoiseOptions,
    observe_ground,
    observe_navigation,
    observe_points,
    observe_signalised,
    observe_tie_points,
)


@pytest.fixture(scope="module")
def ties(small_survey):
    return observe_tie_points(small_survey, 1500, NoiseOptions(0.3, gross_share=0.05, seed=3))


def test_tie_points_are_seen_and_measured_twice(small_survey, ties):
    counts = np.bincount(ties.point, minlength=len(ties.points))
    assert counts.min() >= 2
    assert len(ties.points) > 900
    assert len(ties.names) == len(set(ties.names)) == len(ties.points)
    for number in range(len(small_survey.survey.photographs)):
        mine = ties.photograph == number
        exact, inside = small_survey.project(number, ties.points[ties.point[mine]])
        assert inside.all()
        assert np.abs(exact - ties.true_pixels[mine]).max() < 1e-9
    # some points are on objects, not on the ground
    above = ties.points[:, 2] - small_survey.world.height(ties.points[:, :2])
    assert (above > 2.0).sum() > 20
    assert above.min() > -1e-6


def test_noise_and_planted_errors_are_as_ordered(ties):
    planted = np.hypot(*ties.gross_px.T)
    noise = ties.pixels - ties.true_pixels - ties.gross_px
    n = noise.size
    # chi-square of the variance at 1 % (normal approximation, n > 4000)
    assert abs(noise.var() / 0.09 - 1.0) < 2.576 * np.sqrt(2.0 / n)
    assert abs(noise.mean()) < 2.576 * 0.3 / np.sqrt(n)
    hit = planted > 0.0
    expected = 0.05 * len(planted)
    assert abs(hit.sum() - expected) < 2.576 * np.sqrt(expected * 0.95)
    assert planted[hit].min() >= 5.0 - 1e-9
    assert planted[hit].max() <= 500.0 + 1e-9


def test_the_same_seed_gives_the_same_observations(small_survey, ties):
    again = observe_tie_points(small_survey, 1500, NoiseOptions(0.3, gross_share=0.05, seed=3))
    assert np.array_equal(again.pixels, ties.pixels)
    other = observe_tie_points(small_survey, 1500, NoiseOptions(0.3, gross_share=0.05, seed=4))
    assert not np.array_equal(other.pixels[:50], ties.pixels[:50])


def test_signalised_points(small_survey):
    found = observe_signalised(small_survey, NoiseOptions(0.0))
    assert found.names == ("C01", "C02", "C03", "K01", "K02", "K03", "K04", "K05")
    assert np.array_equal(found.pixels, found.true_pixels)
    heights = small_survey.world.height(found.points[:, :2])
    assert np.abs(heights - found.points[:, 2]).max() < 1e-9
    assert small_survey.world.is_open(found.points[:, :2]).all()


def test_hidden_points_are_not_observed(small_survey):
    house = max(small_survey.world.buildings, key=lambda b: b.ridge - b.base)
    under = np.array([[*house.centre, house.base]])
    top = np.array([[*house.centre, house.ridge + 0.01]])
    assert len(observe_points(small_survey, under, ("x",), NoiseOptions(0.0)).pixels) == 0
    assert len(observe_points(small_survey, top, ("x",), NoiseOptions(0.0)).pixels) >= 1


def test_navigation_and_ground(small_survey):
    navigation = observe_navigation(
        small_survey, NoiseOptions(0.05, 0.5, (1.0, 2.0), seed=9), NoiseOptions(0.01)
    )
    error = navigation.centres - navigation.true_centres - navigation.gross_m
    assert 0.02 < error.std() < 0.09
    size = np.linalg.norm(navigation.gross_m, axis=1)
    assert ((size == 0.0) | ((size > 0.999) & (size < 2.001))).all()
    assert 0 < (size > 0.0).sum() < len(size)
    assert not navigation.gross_deg.any()
    plan, _ = observe_ground(small_survey.check_points, NoiseOptions(0.02), "plan")
    assert np.isnan(plan[:, 2]).all()
    assert np.isfinite(plan[:, :2]).all()
    height, gross = observe_ground(small_survey.check_points, NoiseOptions(0.02), "height")
    assert np.isnan(height[:, :2]).all()
    assert not gross.any()


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"sigma": -1.0}, "sigma"),
        ({"sigma": 1.0, "gross_share": 1.5}, "gross_share"),
        ({"sigma": 1.0, "gross_range": (2.0, 1.0)}, "gross_range"),
    ],
)
def test_noise_that_cannot_be(arguments, field):
    with pytest.raises(InputError, match=field):
        NoiseOptions(**arguments)


def test_a_name_for_every_point(small_survey):
    with pytest.raises(InputError, match="names"):
        observe_points(small_survey, np.zeros((2, 3)), ("one",), NoiseOptions(0.0))
