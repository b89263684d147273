"""The lattice: its stated bound, measured on the ground and in the height model."""

import numpy as np
import pytest

from stereomate.errors import CrsError
from stereomate.frames.heights import HeightSystem
from stereomate.frames.lattice import TOLERANCE_PX, ground_lattice, lattice_step
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import map_from_map, tangent_from_map
from stereomate.raster import Window

ELLIPSOIDAL = HeightSystem.ellipsoidal()


def interpolate(nodes, lattice, col, row):
    u, v = (col - lattice.col0) / lattice.step, (row - lattice.row0) / lattice.step
    i, j = np.clip(u.astype(int), 0, nodes.shape[1] - 2), np.clip(v.astype(int), 0, nodes.shape[0] - 2)
    fu, fv = (u - i)[:, None], (v - j)[:, None]
    top = nodes[j, i] * (1 - fu) + nodes[j, i + 1] * fu
    bottom = nodes[j + 1, i] * (1 - fu) + nodes[j + 1, i + 1] * fu
    return top * (1 - fv) + bottom * fv


# Product map, a place in it, and a height model in another system with its pixel size in its own unit.
PLACES = [
    ("EPSG:25832", 0.10, (691_000.0, 5_820_000.0), "EPSG:4258", 2.0 / 111_000),
    ("EPSG:25832", 5.0, (500_000.0, 5_320_000.0), "EPSG:25833", 24.0),
    ("EPSG:2154", 0.02, (1_217_000.0, 6_075_000.0), "EPSG:4326", 1.0 / 3600),
    ("EPSG:2154", 20.0, (815_000.0, 6_285_000.0), "EPSG:25831", 90.0),
    ("EPSG:3031", 1.0, (900_000.0, -1_500_000.0), "EPSG:4326", 1.0 / 3600),
    ("EPSG:2053", 0.5, (94_952.0, 2_899_340.0), "EPSG:32735", 5.0),
    ("EPSG:2263", 0.5, (985_000.0, 200_000.0), "EPSG:26918", 1.0),
    ("EPSG:32633", 1.0, (700_000.0, 8_800_000.0), "EPSG:3413", 2.0),
]


@pytest.mark.parametrize(("crs", "gsd", "at", "dem_crs", "dem_pixel"), PLACES)
@pytest.mark.parametrize("rotation", [0.0, 0.7])
def test_interpolation_stays_below_a_hundredth_of_a_pixel(crs, gsd, at, dem_crs, dem_pixel, rotation):
    frame, dem_frame = MapFrame(crs, ELLIPSOIDAL), MapFrame(dem_crs, ELLIPSOIDAL)
    c, s = np.cos(rotation), np.sin(rotation)
    affine = (gsd * c, gsd * s, at[0], gsd * s, -gsd * c, at[1])
    dem_origin = map_from_map(dem_frame, frame, (*at, 0.0))
    dem_affine = (dem_pixel, 0.0, float(dem_origin[0]) - 3.0, 0.0, -dem_pixel, float(dem_origin[1]) + 3.0)
    tangent = TangentFrame.at_map(frame, (at[0] + 20_000.0, at[1] - 15_000.0, 0.0))
    window = Window(1500, 700, 1100, 900)
    lattice = ground_lattice(
        affine, window, frame, tangent, dem_frame, dem_affine, height_range=(0.0, 3000.0)
    )
    assert lattice.step == lattice_step(affine, frame, dem_frame, dem_affine)
    assert lattice.col0 <= window.col0
    assert lattice.col0 % lattice.step == 0
    assert lattice.col0 + (lattice.base.shape[1] - 1) * lattice.step >= window.col1
    assert lattice.row0 + (lattice.base.shape[0] - 1) * lattice.step >= window.row1

    rng = np.random.default_rng(5)
    col = rng.uniform(window.col0, window.col1, 4000)
    row = rng.uniform(window.row0, window.row1, 4000)
    h = rng.uniform(0.0, 3000.0, 4000)
    a, b, x0, d, e, y0 = affine
    xyz = np.column_stack([a * col + b * row + x0, d * col + e * row + y0, h])
    base, normal = (
        interpolate(lattice.base, lattice, col, row),
        interpolate(lattice.normal, lattice, col, row),
    )
    error = np.linalg.norm(base + h[:, None] * normal - tangent_from_map(tangent, frame, xyz), axis=1)
    worst = error.max() / (gsd * frame.unit_m)
    assert worst < TOLERANCE_PX
    # Not by a margin that would make the lattice needlessly dense, unless its step is capped.
    if lattice.step < 256 and dem_pixel > 10:
        assert worst > TOLERANCE_PX / 20

    dem = interpolate(lattice.dem, lattice, col, row)
    xyz[:, 2] = 1500.0
    truth = map_from_map(dem_frame, frame, xyz)
    # Geographic pixels are narrow in the east: the error is meant in the shorter edge on the ground.
    narrow = np.cos(np.deg2rad(truth[:, 1])) if dem_frame.is_geographic else 1.0
    assert np.abs(dem[:, 0] - (truth[:, 0] - dem_affine[2]) / dem_pixel).max() * np.min(narrow) < TOLERANCE_PX
    assert np.abs(dem[:, 1] - (dem_affine[5] - truth[:, 1]) / dem_pixel).max() < TOLERANCE_PX
    np.testing.assert_allclose(dem[:, 2], 1500.0 - truth[:, 2], rtol=0, atol=1e-3)


def test_neighbouring_windows_share_their_nodes():
    frame = MapFrame("EPSG:25832", ELLIPSOIDAL)
    affine = (0.1, 0.0, 600_000.0, 0.0, -0.1, 5_600_000.0)
    tangent = TangentFrame.at_map(frame, (600_000.0, 5_600_000.0, 0.0))
    first = ground_lattice(affine, Window(0, 0, 512, 512), frame, tangent)
    second = ground_lattice(affine, Window(512, 0, 512, 512), frame, tangent)
    shift = (second.col0 - first.col0) // first.step
    np.testing.assert_array_equal(first.base[:, shift:], second.base[:, : first.base.shape[1] - shift])


def test_without_a_height_model_positions_are_those_of_the_map():
    frame = MapFrame("EPSG:25832", HeightSystem.undeclared())
    affine = (0.5, 0.0, 600_000.0, 0.0, -0.5, 5_600_000.0)
    tangent = TangentFrame.at_map(frame, (600_000.0, 5_600_000.0, 0.0))
    lattice = ground_lattice(affine, Window(0, 0, 100, 100), frame, tangent)
    np.testing.assert_allclose(lattice.dem[0, 0], (600_000.0, 5_600_000.0, 0.0))
    same = MapFrame("EPSG:25832", HeightSystem.undeclared())
    lattice = ground_lattice(affine, Window(0, 0, 100, 100), frame, tangent, same, affine)
    i, j = 1, 1
    np.testing.assert_allclose(lattice.dem[j, i], (lattice.step, lattice.step, 0.0), atol=1e-6)


def test_heights_in_feet_become_a_scale():
    metres = MapFrame("EPSG:25832", ELLIPSOIDAL)
    feet = MapFrame("EPSG:25832", HeightSystem.ellipsoidal(0.3048))
    affine = (0.5, 0.0, 600_000.0, 0.0, -0.5, 5_600_000.0)
    tangent = TangentFrame.at_map(metres, (600_000.0, 5_600_000.0, 0.0))
    lattice = ground_lattice(
        affine, Window(0, 0, 100, 100), metres, tangent, feet, affine, height_range=(100.0, 300.0)
    )
    assert lattice.dem_scale == pytest.approx(0.3048, rel=1e-12)
    np.testing.assert_allclose(lattice.dem[..., 2], 0.0, atol=1e-9)


def test_pixels_too_large_are_refused():
    frame = MapFrame("EPSG:25832", ELLIPSOIDAL)
    affine = (1e6, 0.0, 600_000.0, 0.0, -1e6, 5_600_000.0)
    with pytest.raises(CrsError, match="too large"):
        lattice_step(affine, frame)
