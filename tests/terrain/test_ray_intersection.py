"""Rays in the tangent frame against a height model in a map projection."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import map_from_tangent, tangent_from_map
from stereomate.terrain import intersection
from stereomate.terrain.intersection import distances_to_level, ground_distances
from stereomate.terrain.model import HeightModel

FRAME = MapFrame("EPSG:32631", HeightSystem.ellipsoidal())
X0, Y0 = 640000.0, 4900000.0
TANGENT = TangentFrame.at_map(FRAME, (X0, Y0, 0.0))


def terrain(cell: float = 20.0, size: int = 400) -> HeightModel:
    x, y = np.meshgrid(np.arange(size), np.arange(size))
    heights = 400.0 + 120.0 * np.sin(x / 23.0) * np.cos(y / 31.0) + 15.0 * np.sin(x / 3.0 + y / 4.0)
    half = 0.5 * size * cell
    return HeightModel.from_array(heights, (cell, 0.0, X0 - half, 0.0, -cell, Y0 + half), FRAME)


def rays(count: int, seed: int, tilt: float = 0.9) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    centres = tangent_from_map(
        TANGENT,
        FRAME,
        np.column_stack(
            [
                X0 + rng.uniform(-1500, 1500, count),
                Y0 + rng.uniform(-1500, 1500, count),
                rng.uniform(1500, 2500, count),
            ]
        ),
    )
    directions = np.column_stack([rng.uniform(-tilt, tilt, (count, 2)), np.full(count, -1.0)])
    return centres, directions / np.linalg.norm(directions, axis=1)[:, None]


def clearance(model: HeightModel, start: np.ndarray, direction: np.ndarray, s: np.ndarray) -> np.ndarray:
    mapped = map_from_tangent(TANGENT, model.frame, start + np.atleast_1d(s)[:, None] * direction)
    return mapped[:, 2] - model.heights_at(mapped[:, :2])


def test_level_is_reached_to_a_micrometre() -> None:
    starts, directions = rays(60, 1)
    distance = distances_to_level(FRAME, TANGENT, starts, directions, 350.0)
    mapped = map_from_tangent(TANGENT, FRAME, starts + distance[:, None] * directions)
    assert np.abs(mapped[:, 2] - 350.0).max() < 1e-6
    assert (distance > 0).all()


def test_rays_that_do_not_come_down() -> None:
    starts = np.array([[0.0, 0.0, 5000.0]] * 4 + [[0.0, 0.0, 100.0]])
    # 5 km up, the horizon is 2.27 degrees below the horizontal
    angles = np.radians([10.0, -0.5, -2.0, -2.6, -45.0])
    directions = np.column_stack([np.cos(angles), np.zeros(5), np.sin(angles)])
    distance = distances_to_level(FRAME, TANGENT, starts, directions, 300.0)
    np.testing.assert_array_equal(np.isnan(distance), [True, True, True, False, False])
    assert distance[4] == 0.0


def test_hits_lie_on_the_surface_and_are_the_first() -> None:
    model = terrain()
    starts, directions = rays(80, 2)
    found = ground_distances(model, TANGENT, starts, directions)
    assert np.isfinite(found).all()
    for start, direction, s in zip(starts, directions, found, strict=True):
        assert abs(clearance(model, start, direction, s)[0]) < 1e-6
        before = clearance(model, start, direction, np.linspace(s - 900.0, s - 0.01, 2000))
        assert before.min() > -1e-6


def test_against_dense_steps_and_brent() -> None:
    model = terrain()
    starts, directions = rays(12, 3, tilt=1.6)
    found = ground_distances(model, TANGENT, starts, directions)
    for start, direction, s in zip(starts, directions, found, strict=True):
        steps = np.linspace(900.0, 5500.0, 6000)
        above = clearance(model, start, direction, steps)
        if np.isnan(s):
            assert not (above <= 0).any() or np.isnan(above[: np.argmax(above <= 0)]).any()
            continue
        k = int(np.argmax(above <= 0))
        expected = brentq(
            lambda t, a=start, b=direction: clearance(model, a, b, t)[0], steps[k - 1], steps[k], xtol=1e-9
        )
        assert s == pytest.approx(expected, abs=1e-6)


def test_small_patches_give_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    model = terrain()
    starts, directions = rays(40, 4, tilt=1.2)
    whole = ground_distances(model, TANGENT, starts, directions)
    monkeypatch.setattr(intersection, "_PATCH_CELLS", 300)
    np.testing.assert_allclose(ground_distances(model, TANGENT, starts, directions), whole, rtol=0, atol=1e-7)


def test_voids_and_the_outside_give_none() -> None:
    model = terrain()
    heights = model.patch(0, 0, 400, 400).heights
    heights[:, :210] = np.nan
    holed = HeightModel.from_array(heights, model.affine, FRAME)
    down = np.array([[0.0, 0.0, -1.0]])
    places = np.array([[X0 - 1000.0, Y0, 2000.0], [X0 + 1000.0, Y0, 2000.0], [X0 + 90000.0, Y0, 2000.0]])
    found = ground_distances(holed, TANGENT, tangent_from_map(TANGENT, FRAME, places), np.repeat(down, 3, 0))
    np.testing.assert_array_equal(np.isnan(found), [True, False, True])


def test_other_crs_and_heights() -> None:
    """The same surface as a model in degrees, with heights shifted by a geoid file's constant."""
    lon = np.arange(4.7, 4.8, 0.0005)
    lat = np.arange(44.3, 44.2, -0.0005)
    heights = 500.0 + 80.0 * np.sin(lon * 900)[None, :] * np.cos(lat * 700)[:, None]
    frame = MapFrame("EPSG:4326", HeightSystem.ellipsoidal())
    model = HeightModel.from_array(heights, (0.0005, 0.0, 4.7 - 0.00025, 0.0, -0.0005, 44.3 + 0.00025), frame)
    tangent = TangentFrame.at_map(frame, (4.75, 44.25, 0.0))
    start = tangent_from_map(tangent, frame, (4.75, 44.25, 3000.0))[None]
    direction = np.array([[0.3, -0.4, -1.0]]) / np.sqrt(1.25)
    s = ground_distances(model, tangent, start, direction)[0]
    mapped = map_from_tangent(tangent, frame, start + s * direction)
    assert mapped[0, 2] == pytest.approx(float(model.heights_at(mapped[0, :2])), abs=1e-6)


@pytest.mark.parametrize("depth", [-300.0, -700.0, -9000.0])
def test_deep_ground_is_reached(depth: float) -> None:
    """Below sea level, where the search for the part of the model under the rays has to go deeper."""
    base = terrain()
    heights = base.patch(0, 0, 400, 400).heights
    deep = HeightModel.from_array(heights - 400.0 + depth, base.affine, FRAME)
    starts, directions = rays(20, 6, tilt=0.2)
    found = ground_distances(deep, TANGENT, starts, directions)
    assert np.isfinite(found).all()
    for start, direction, s in zip(starts, directions, found, strict=True):
        assert abs(clearance(deep, start, direction, s)[0]) < 1e-6


def test_only_the_part_under_the_rays_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stereomate.terrain.model._BLOCK", 40)
    model = terrain()
    read: list[tuple[int, int, int, int]] = []
    patch = HeightModel.patch

    def counted(self: HeightModel, *window: int):
        read.append(window)
        return patch(self, *window)

    monkeypatch.setattr(HeightModel, "patch", counted)
    starts = tangent_from_map(TANGENT, FRAME, [(X0 - 1500.0, Y0 + 1500.0, 1500.0)])
    found = ground_distances(model, TANGENT, starts, np.array([[0.1, 0.05, -1.0]]) / np.sqrt(1.0125))
    assert np.isfinite(found[0])
    # pixel 125, 125 of 400: nothing of the far half is touched, and the same blocks are not read again
    assert max(col0 + cols for col0, _, cols, _ in read) <= 200
    before = len(read)
    ground_distances(model, TANGENT, starts, np.array([[0.1, 0.05, -1.0]]) / np.sqrt(1.0125))
    assert len(read) - before == 3


@pytest.mark.real
def test_real_relief(data_folder: Path) -> None:
    """SRTM around Mont Ventoux: 2.7 km of relief, oblique rays, chords of several kilometres."""
    model = HeightModel.open(data_folder / "dem/srtm90_ventoux_utm31.tif", HeightSystem.ellipsoidal())
    middle = model.map_from_pixel((461.0, 631.0))
    tangent = TangentFrame.at_map(model.frame, (*middle, 0.0))
    rng = np.random.default_rng(5)
    starts = np.tile(tangent_from_map(tangent, model.frame, (*middle, 7000.0)), (60, 1))
    directions = np.column_stack([rng.uniform(-2.5, 2.5, (60, 2)), np.full(60, -1.0)])
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    found = ground_distances(model, tangent, starts, directions)
    assert np.isfinite(found).sum() > 50
    for start, direction, s in zip(starts, directions, found, strict=True):
        if np.isfinite(s):
            steps = np.append(np.linspace(4000.0, s - 0.1, 4000), s)
            mapped = map_from_tangent(tangent, model.frame, start + steps[:, None] * direction)
            above = mapped[:, 2] - model.heights_at(mapped[:, :2])
            assert abs(above[-1]) < 1e-6
            assert np.nanmin(above[:-1]) > -1e-6
