"""Orientation points chosen in profiles of the ground, and what they say about a pair."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stereomate.errors import InputError
from stereomate.relative.overcorrection import overcorrection_factor, tilt_standard_deviation
from stereomate.relative.sections import (
    SectionOptions,
    orientation_section,
    pair_sections,
    reference_std,
    section_of_points,
    section_strength,
)

Y = np.linspace(-1500.0, 1500.0, 121)
FLAT = np.full(121, 1500.0)
EVERYWHERE = np.ones(121, dtype=bool)


def test_standard_points_on_flat_ground():
    found = orientation_section(Y, FLAT, EVERYWHERE, 2 / 3)
    assert found.choice == "standard"
    assert [Y[i] for i in found.indices] == [0.0, -1000.0, 1000.0]
    assert found.strength.factor == pytest.approx(1.625)
    assert not (found.near_critical)
    assert not (found.weak)
    # σ(ω) goes with 1/t² on flat ground.
    assert found.ratio == pytest.approx(0.25)


def test_reference():
    # Three parallax angles of one size at t = 0, ±1/3: σ² = (1 + ¼ + ¼)/t⁴.
    assert reference_std() == pytest.approx(math.sqrt(1.5) * 9.0)


def test_a_lake_moves_one_point():
    lake = (Y > 900.0) & (Y < 1100.0)
    found = orientation_section(Y, FLAT, ~lake, 2 / 3)
    assert found.choice == "moved"
    assert [Y[i] for i in found.indices[:2]] == [0.0, -1000.0]
    assert Y[found.indices[2]] in (900.0, 1100.0)


def test_a_void_counts_as_unusable():
    depth = np.where(np.abs(Y) < 60.0, np.nan, FLAT)
    found = orientation_section(Y, depth, EVERYWHERE, 2 / 3)
    assert found.choice == "moved"
    assert abs(Y[found.indices[0]]) == 75.0


def test_a_whole_side_of_water_gives_the_strongest_others():
    land = Y < 300.0
    found = orientation_section(Y, FLAT, land, 2 / 3)
    assert found.choice == "free"
    chosen = sorted(Y[list(found.indices)])
    assert chosen[0] == -1500.0
    assert chosen[2] == 275.0
    # No other triple of the usable places is stronger by more than the thinning of candidates allows.
    rng = np.random.default_rng(1)
    rows = np.sort(rng.choice(np.flatnonzero(land), (4000, 3)), axis=1)
    rows = rows[(np.diff(rows, axis=1) > 0).all(axis=1)]
    sections = np.stack((Y[rows], FLAT[rows]), axis=-1)
    best = tilt_standard_deviation(sections, sections[..., 1]).min()
    assert found.strength.tilt_std_per_angle < 1.05 * best


def test_a_critical_valley_is_left_for_stronger_points():
    # Ground on a circle through the projection centre between ±1000 m, a plateau outside it.
    circle = 750.0 + np.sqrt(np.maximum(750.0**2 - Y**2, 0.0))
    depth = np.where(np.abs(Y) < 700.0, circle, 1100.0)
    found = orientation_section(Y, depth, EVERYWHERE, 1 / 3)
    assert found.choice == "free"
    assert not found.near_critical
    only_valley = np.abs(Y) < 700.0
    valley = orientation_section(Y, depth, only_valley, 1 / 3)
    assert valley.near_critical
    assert valley.weak


def test_nothing_usable():
    assert orientation_section(Y, FLAT, ~EVERYWHERE, 2 / 3) is None
    two = np.zeros(121, dtype=bool)
    two[[10, 100]] = True
    assert orientation_section(Y, FLAT, two, 2 / 3) is None
    near = (Y > 0.0) & (Y < 100.0)
    assert orientation_section(Y, FLAT, near, 2 / 3) is None
    assert orientation_section(Y[:0], FLAT[:0], EVERYWHERE[:0], 2 / 3) is None


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10_000), st.floats(0.2, 0.8))
def test_chosen_points_are_usable_and_their_factor_is_the_formula(seed, nominal):
    rng = np.random.default_rng(seed)
    depth = 1500.0 + np.cumsum(rng.normal(0, 12.0, 121))
    usable = rng.random(121) < 0.5
    found = orientation_section(Y, depth, usable, nominal)
    if found is None:
        return
    assert usable[list(found.indices)].all()
    section = np.stack((Y, depth), axis=-1)[list(found.indices)]
    assert found.strength.factor == overcorrection_factor(section)
    assert found.strength.d / found.strength.a == pytest.approx(found.strength.factor, rel=1e-9)
    assert section[1, 0] < section[0, 0] < section[2, 0]


def test_strength_of_several_sections():
    profiles = [(place, np.stack((Y, FLAT), axis=-1), EVERYWHERE) for place in (1.0, 0.0, 0.5)]
    profiles.append((0.75, np.stack((Y, FLAT), axis=-1), ~EVERYWHERE))
    pair = pair_sections(profiles, 2 / 3)
    assert [section.place for section in pair.sections] == [0.0, 0.5, 1.0]
    assert pair.missing == (0.75,)
    assert pair.flat_factor == pytest.approx(1.625)
    assert pair.strength == pytest.approx(4.0 * math.sqrt(3.0))
    assert pair.under(0.0) is pair.sections[0]
    assert pair.under(0.25) is None
    assert not (pair.near_critical)
    assert not (pair.weak)


def test_pair_without_any_section():
    pair = pair_sections([(0.0, np.stack((Y, FLAT), axis=-1), ~EVERYWHERE)], 2 / 3)
    assert (pair.sections, pair.missing, pair.strength) == ((), (0.0,), 0.0)
    assert pair.near_critical


def test_section_from_points_of_the_previous_model():
    points = [[5.0, -10.0, 1500.0], [-20.0, -980.0, 1400.0], [12.0, 1010.0, 1600.0], [500.0, 0.0, 1490.0]]
    found = section_of_points(points, 0.0, 100.0, 2 / 3)
    assert found.indices == (0, 1, 2)
    assert found.strength.factor == pytest.approx(overcorrection_factor(np.array(points)[:3, 1:]))
    assert section_of_points(points, 500.0, 100.0, 2 / 3) is None


def test_strength_of_one_section():
    strength = section_strength([[0, 1500], [-450, 1350], [450, 1350]])
    assert math.isinf(strength.factor)
    assert (strength.side, strength.a) == ("on", 0.0)
    assert math.isnan(strength.change)
    assert math.isinf(strength.tilt_std_per_angle)
    regular = section_strength([[0, 1500], [-500, 1500], [500, 1500]])
    assert regular.tilt_std_per_angle == pytest.approx(reference_std())
    assert regular.tilt_std_per_metre == pytest.approx(reference_std() / 1500)


def test_wrong_input():
    with pytest.raises(InputError, match="usable"):
        orientation_section(Y, FLAT, EVERYWHERE[:5], 0.5)
    with pytest.raises(InputError, match="nominal"):
        orientation_section(Y, FLAT, EVERYWHERE, 0.0)
    with pytest.raises(InputError, match="points"):
        section_of_points([[1.0, 2.0]], 0.0, 1.0, 0.5)
    with pytest.raises(InputError, match="width"):
        section_of_points([[1.0, 2.0, 3.0]], 0.0, 0.0, 0.5)
    with pytest.raises(InputError, match="section options"):
        SectionOptions(tolerance=0.5, search=0.2)
