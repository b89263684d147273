"""Turned photographs: simulated offsets with known turns and many wrong matches."""

from __future__ import annotations

import numpy as np
import pytest

from stereomate.geometry.rotations import rotation_from_opk, rotation_z
from stereomate.relative.turns import PairTurns, ground_offsets, pair_turns, photo_turns

HEIGHT, BASE = 100.0, 30.0 + 10.0j


def offsets(turn_left, turn_right, wrong=0.4, seed=1):
    """Offsets of level ground as attitudes wrong by two turns see it, with a share of wrong matches."""
    random = np.random.default_rng(seed)
    ground = random.uniform(-60, 60, 200) + 1j * random.uniform(-60, 60, 200)
    left = ground / HEIGHT * np.exp(-1j * np.deg2rad(turn_left))
    right = (ground - BASE) / HEIGHT * np.exp(-1j * np.deg2rad(turn_right))
    lost = random.random(200) < wrong
    right[lost] = random.permutation(right[lost])
    return left, right


@pytest.mark.parametrize(("left", "right"), [(0, 0), (0, 180), (180, 180), (-90, 5), (33, -120)])
def test_both_turns_of_a_pair(left, right):
    found = pair_turns(0, 1, *offsets(left, right), BASE)
    for turn, true in ((found.turn_left_deg, left), (found.turn_right_deg, right)):
        assert abs((turn - true + 180) % 360 - 180) < 1.0
    assert found.scale == pytest.approx(1.0, abs=0.01)
    assert found.matches > 100


def test_pairs_that_say_nothing():
    random = np.random.default_rng(2)
    noise = random.normal(size=60) + 1j * random.normal(size=60)
    assert pair_turns(0, 1, noise, np.roll(noise, 7), BASE) is None
    left, right = offsets(0, 0)
    assert pair_turns(0, 1, left[:5], right[:5], BASE) is None
    assert pair_turns(0, 1, left, right, 0j) is None
    assert pair_turns(0, 1, left, left, BASE) is None  # no base in the images: no direction
    assert pair_turns(0, 1, np.zeros(50, complex), np.zeros(50, complex), BASE) is None


def test_most_pairs_decide():
    pairs = [PairTurns(0, 1, 1.0, 179.0, 50, 1.0), PairTurns(1, 2, -178.0, 2.0, 50, 1.0),
             PairTurns(1, 3, 181.0 - 360.0, -1.0, 50, 1.0), PairTurns(0, 2, 90.0, 3.0, 50, 1.0)]  # fmt: skip
    turns = {turn.photo: turn for turn in photo_turns(pairs, 5)}
    assert set(turns) == {0, 1, 2, 3}
    assert abs(turns[1].turn_deg) == pytest.approx(180.0, abs=1.0)
    assert turns[1].is_turned
    assert turns[1].agreeing == 3
    assert turns[1].spread_deg < 2.0
    assert not any(turns[k].is_turned for k in (0, 2, 3))


def test_offsets_of_rays():
    rays = np.array([[0.1, 0.2, -1.0], [0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
    z = ground_offsets(rays, rotation_z(np.pi / 2))
    assert z[0] == pytest.approx(-0.2 + 0.1j)
    assert z[1] == 0.0
    assert np.isnan(z[2])
    tilted = ground_offsets(rays, rotation_from_opk((0.0, np.deg2rad(45.0), 0.0)))
    assert tilted[1] == pytest.approx(-1.0)
