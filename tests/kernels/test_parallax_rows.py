"""Rows of a stereomate: the golden cliff, brute force, voids; fold and occlusion are two things."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stereomate.errors import InputError
from stereomate.parallax.laws import ParallaxLaw
from stereomate.parallax.rows import RowProfile, fold_ratio
from stereomate.terrain import kernels as terrain_kernels

KINDS = ("linear", "logarithmic", "natural")


def profile_of(data: dict, terrain: str, kind: str) -> RowProfile:
    ground, law = data["terrain"][terrain], data["law"]
    x0, x1 = ground["ramp_x"]
    return RowProfile(
        ParallaxLaw(kind, law["base_m"], law["w0_m"], law["reference_level"]),
        np.array([-300.0, x0, x1, 300.0]),
        np.array([ground["h_before"], ground["h_before"], ground["h_after"], ground["h_after"]]),
    )


def test_golden_positions(golden) -> None:
    data = golden("stereo_fold.json")
    for case in data["cases"]:
        for kind in KINDS:
            profile, expected = profile_of(data, case["terrain"], kind), case["laws"][kind]
            u = float(profile.forward(case["x_m"]))
            assert u == pytest.approx(expected["u_m"], abs=1e-9)
            assert profile.inverse(u) == pytest.approx(expected["winner_x_m"], abs=1e-8)
            assert bool(profile.hidden(case["x_m"])) == expected["hidden_by_fold"]
            slope = float(profile.law.slope(case["h_m"]))
            assert 1.0 - slope * case["dh_dx"] == pytest.approx(expected["du_dx"], abs=1e-9)


def test_golden_folds(golden) -> None:
    data = golden("stereo_fold.json")
    for terrain, laws in data["fold"].items():
        for kind, expected in laws.items():
            profile = profile_of(data, terrain, kind)
            assert len(profile.folds) == int(expected["folds"])
            for fold in profile.folds:
                np.testing.assert_allclose(fold.hidden_x, expected["hidden_x"], rtol=0, atol=1e-8)
                np.testing.assert_allclose(fold.hiding_x, expected["hiding_x"], rtol=0, atol=1e-8)
                np.testing.assert_allclose(fold.u, expected["fold_u"], rtol=0, atol=1e-9)
                assert fold.width_m == pytest.approx(expected["fold_width_m"], abs=1e-9)
            heights = [data["terrain"][terrain][k] for k in ("h_before", "h_after")]
            ratio = profile.law.slope(heights) * data["terrain"][terrain]["slope_along_row"]
            steepest = expected["max_dq_dh_times_slope"]
            assert ratio[np.abs(ratio).argmax()] == pytest.approx(steepest, rel=1e-9)


def test_golden_occlusion_is_another_thing(golden) -> None:
    """Line of sight to the photographs, over the same profile as a height patch of two rows."""
    data = golden("stereo_fold.json")
    centres = data["photographs"]
    for terrain, ground in data["terrain"].items():
        step = (ground["ramp_x"][1] - ground["ramp_x"][0]) / 16
        nodes = np.arange(-300, 317) * step
        line = np.interp(nodes, ground["ramp_x"], [ground["h_before"], ground["h_after"]])
        patch = np.array([line, line])
        for case in (c for c in data["cases"] if c["terrain"] == terrain):
            col = (case["x_m"] - nodes[0]) / step + 0.5
            for side in ("left", "right"):
                x, z = centres[f"{side}_centre_xz"]
                hidden = terrain_kernels.occluded(
                    patch, col, 1.0, case["h_m"], (x - case["x_m"]) / step, 0.0, z - case["h_m"], 210.0, 1e-9
                )
                assert hidden != case[f"visible_in_{side}_photo"]


TABLE = ParallaxLaw.from_table(
    [-150.0, -20.0, 30.0, 180.0, 260.0],
    [-60.0, -22.0, 25.0, 70.0, 190.0],
    base_m=900,
    w0_m=1500,
    reference_m=100,
)
LAWS = [ParallaxLaw(kind, 900.0, 1500.0, 100.0) for kind in KINDS] + [TABLE]


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.kind)
@given(seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=50)
def test_against_brute_force(law: ParallaxLaw, seed: int) -> None:
    """Dense positions: the winner is the last to rise through the target; hidden is >= the least u beyond."""
    rng = np.random.default_rng(seed)
    x = np.cumsum(rng.uniform(4.0, 30.0, 14))
    heights = 100.0 + np.cumsum(rng.normal(0.0, 22.0, 14)).clip(-200, 300)
    profile = RowProfile(law, x, heights)
    # with the nodes: there u has its sharp minima, which decide what is hidden far away
    dense = np.union1d(np.linspace(x[0], x[-1], 40001), x)
    u = profile.forward(dense)
    beyond = np.minimum.accumulate(u[::-1])[::-1]
    least_beyond = np.append(beyond[1:], np.inf)
    hidden = u >= least_beyond
    step = (x[-1] - x[0]) / 40000
    # flags may differ within a step of an end of a hidden stretch, and where u hardly rises
    changes = np.flatnonzero(np.diff(hidden)) + 1
    clear = np.ones(dense.size, bool)
    for k in changes:
        clear[max(0, k - 3) : k + 3] = False
    clear &= np.abs(u - least_beyond) > 5e-3 * step
    np.testing.assert_array_equal(profile.hidden(dense)[clear], hidden[clear])
    targets = rng.uniform(u.min() - 3.0, u.max() + 3.0, 60)
    found = profile.inverse(targets)
    for target, place in zip(targets, found, strict=True):
        crossing = np.flatnonzero((u[:-1] <= target) & (u[1:] > target))
        if np.isnan(place):
            # not on the profile, or the profile ends in a fold: its end hides what lies behind
            assert crossing.size == 0 or (u[-1] < target and hidden[crossing[-1]])
        else:
            assert profile.forward(place) == pytest.approx(target, abs=1e-9)
            assert crossing.size
            assert place == pytest.approx(dense[crossing[-1]], abs=1.01 * step + 1e-9)
    for fold in profile.folds:
        assert fold.hidden_x[0] < fold.hidden_x[1] <= fold.hiding_x[1]
        inside = dense[(dense > fold.hidden_x[0] + step) & (dense < fold.hidden_x[1] - step)]
        assert profile.hidden(inside).all()
        if inside.size:
            assert profile.forward(inside).max() <= fold.u[1] + 1e-9


def test_voids_are_not_bridged() -> None:
    x = np.arange(0.0, 100.0, 10.0)
    heights = np.full(10, 20.0)
    heights[4:6] = np.nan
    profile = RowProfile(ParallaxLaw("linear", 900.0, 1500.0), x, heights)
    np.testing.assert_allclose(profile.inverse(np.array([5.0, 75.0]) - 12.0), [5.0, 75.0])
    assert np.isnan(profile.inverse(np.array([35.0, 45.0, 55.0]) - 12.0)).all()
    assert profile.folds == ()
    np.testing.assert_array_equal(profile.hidden([5.0, 35.0, 65.0, 200.0]), [False, True, False, True])
    assert np.isnan(profile.inverse(np.array([-30.0, 500.0]))).all()


def test_fold_ratio_on_a_grid() -> None:
    law = ParallaxLaw("logarithmic", 900.0, 1500.0)
    heights = np.array([[0.0, 0.0, 4.0, 4.0], [100.0, 101.0, 99.0, np.nan]])
    ratio = fold_ratio(law, heights, 2.0)
    assert ratio[0, 1] == pytest.approx(900 / 1500 * 2.0)
    assert ratio[0, 2] == pytest.approx(900 / 1496 * 2.0)
    assert ratio[0, 0] == 0.0
    assert ratio[1, 0] == pytest.approx(900 / 1400 * 0.5)
    assert np.isnan(ratio[1, 2:]).all()


@pytest.mark.parametrize(
    "x, heights, message",
    [
        ([0.0], [1.0], "2 or more"),
        ([0.0, 1.0], [1.0, 2.0, 3.0], "of one size"),
        ([0.0, 0.0], [1.0, 2.0], "positions must rise"),
        ([0.0, np.nan], [1.0, 2.0], "positions must rise"),
    ],
)
def test_bad_profiles(x, heights, message: str) -> None:
    with pytest.raises(InputError, match=message):
        RowProfile(LAWS[0], np.array(x), np.array(heights))
