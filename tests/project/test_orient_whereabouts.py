"""Positions and control that lie elsewhere, photographs that show one picture: found before they do harm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stereomate.block.tie_points import TiePointOptions, shows_same_picture
from stereomate.camera.model import Camera
from stereomate.errors import CrsError
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.measurement.features import Features
from stereomate.project.orient_whereabouts import check_control_place, far_positions
from stereomate.relative.feature_pairs import FeaturePair
from stereomate.units import FOOT

NAMES = [f"p{k}" for k in range(6)]
PLACES = np.array([-91.994, 46.842]) + 1e-4 * np.arange(12).reshape(6, 2)
UTM = MapFrame("EPSG:32615", HeightSystem.undeclared())
POINTS = UTM.map_from_geodetic(np.column_stack([PLACES, np.full(6, 160.0)]))


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ((91.994, 46.842), "sign of its longitude"),
        ((-91.994, -46.842), "sign of its latitude"),
        ((46.842, -91.994), "longitude and latitude are exchanged"),
        ((0.0, 0.0), "the receiver had no fix"),
        ((-80.0, 46.0), "km from the others and is not used"),
    ],
)
def test_a_position_elsewhere_is_named_with_what_explains_it(place, words):
    lon_lat = PLACES.copy()
    lon_lat[3] = place
    found = far_positions(lon_lat, NAMES)
    assert list(found) == [3]
    assert words in found[3]
    assert "p3" in found[3]


def test_positions_of_one_block_are_none_of_them_far():
    assert far_positions(PLACES, NAMES) == {}
    # Around the date line, over a whole country, and where there is no majority.
    assert far_positions(np.array([[179.999, 0.0], [-179.999, 0.0], [-179.998, 0.0]]), NAMES) == {}
    assert far_positions(np.array([[6.0 + k, 48.0 + k] for k in range(6)]), NAMES) == {}
    assert far_positions(np.vstack([PLACES[:3], PLACES[:3] + 20.0]), NAMES) == {}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda p: p / [1000.0, 1000.0, 1.0], "coordinates in kilometres"),
        (lambda p: np.column_stack([PLACES, p[:, 2]]), "longitude and latitude in degrees"),
        (lambda p: np.column_stack([PLACES[:, ::-1], p[:, 2]]), "latitude and longitude in degrees"),
        (lambda p: p / FOOT, "coordinates in feet"),
        (lambda p: p[:, [1, 0, 2]], "x and y exchanged"),
        (lambda p: p - np.array([0.0, 300_000.0, 0.0]), "lie 300 km from the positions"),
    ],
)
def test_control_far_from_the_photographs_is_refused(tmp_path, change, words):
    with pytest.raises(CrsError, match=rf"gcp\.csv: crs: .*{words}"):
        check_control_place(UTM, change(POINTS), PLACES, tmp_path / "gcp.csv")


def test_control_among_the_photographs_may_hold_a_stray(tmp_path):
    points = POINTS.copy()
    points[0] = points[0, [1, 0, 2]]
    points[1, 2] = np.nan
    check_control_place(UTM, points, PLACES, tmp_path / "gcp.csv")
    nowhere = np.full((3, 2), np.nan)
    check_control_place(UTM, points, nowhere, tmp_path / "gcp.csv")
    with pytest.raises(CrsError, match="look like degrees"):
        check_control_place(UTM, np.column_stack([PLACES, POINTS[:, 2]]), nowhere, tmp_path / "gcp.csv")


def test_copies_are_told_from_neighbours():
    """A copy saved anew has its features at the same pixels; a neighbour of the same texture has not."""
    rng = np.random.default_rng(4)
    n = 300
    size, angle, response = rng.uniform(2.0, 20.0, n), rng.uniform(0.0, 6.0, n), rng.uniform(0.0, 1.0, n)
    one = Features(
        rng.uniform(0, 900, (n, 2)), size, angle, response, rng.random((n, 128)).astype(np.float32)
    )
    camera = Camera.from_pixel_pitch("c", (1000, 1000), 10.0, 0.01)
    noise = rng.normal(0, 0.05, (n, 128)).astype(np.float32)
    kept = np.flatnonzero(rng.random(n) < 0.8)
    copy = replace(one, pixels=one.pixels + rng.normal(0, 0.2, (n, 2)), descriptors=one.descriptors + noise)
    options = TiePointOptions().automatic
    assert shows_same_picture(FeaturePair(camera, camera, one, copy.select(kept), options))
    moved = replace(copy, pixels=copy.pixels + 30.0)
    assert not shows_same_picture(FeaturePair(camera, camera, one, moved, options))
    # A dense photograph has some feature near any place: it is another one.
    other = replace(copy, descriptors=rng.permutation(one.descriptors) - 0.5)
    assert not shows_same_picture(FeaturePair(camera, camera, one, other, options))
