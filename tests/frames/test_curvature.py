"""Earth curvature and refraction of image coordinates."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stereomate.camera.refraction import ardc_constant
from stereomate.errors import InputError, OrientationError
from stereomate.frames.curvature import CurvatureOptions, curvature_corrected, curvature_restored
from stereomate.frames.refraction import refraction_corrected, refractive_index
from stereomate.geometry.rotations import rotation_from_opk

VARIANTS = [
    ("xy_classic", "classical", "ground"),
    ("xy_sphere_to_ellipsoid", "sphere", "ellipsoid"),
    ("xy_sphere_ground_level", "sphere", "ground"),
]


@pytest.mark.parametrize(("key", "method", "level"), VARIANTS)
def test_golden_vectors(golden, key, method, level):
    data = golden("georef_earth_curvature.json")
    assert data["tolerance_m"] == 1e-12
    assert len(data["cases"]) == 3
    for case in data["cases"]:
        assert case["H"] == case["h_camera"] - case["h_ground"]
        rotation = rotation_from_opk(case["opk_level"])
        options = CurvatureOptions(case["R_earth"], method, level)
        arguments = (case["c"], rotation, case["h_camera"], case["h_ground"], options)
        found = curvature_corrected(case["xy_obs"], *arguments)
        np.testing.assert_allclose(found, case[key], rtol=0, atol=1e-12)
        np.testing.assert_allclose(curvature_restored(found, *arguments), case["xy_obs"], rtol=0, atol=1e-14)


@settings(deadline=None, max_examples=100)
@given(
    st.tuples(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6), st.floats(-3.1, 3.1)),
    st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1)),
    st.floats(-400.0, 4000.0),
    st.floats(50.0, 9000.0),
    st.sampled_from(["classical", "sphere"]),
    st.sampled_from(["ground", "ellipsoid"]),
)
def test_there_and_back_is_the_identity(opk, xy, ground, height, method, level):
    rotation = rotation_from_opk(opk)
    options = CurvatureOptions(6_378_000.0, method, level)
    arguments = (0.15, rotation, ground + height, ground, options)
    np.testing.assert_allclose(
        curvature_restored(curvature_corrected(xy, *arguments), *arguments), xy, rtol=0, atol=2e-13
    )


def test_the_exact_correction_by_construction():
    """Points on a sphere, photographed by a tilted camera; corrected, they lie as on a flat Earth."""
    radius, h0, h, c = 6.37e6, 6500.0, 800.0, 0.1
    rotation = rotation_from_opk((0.2, -0.3, 0.5))
    level = np.array([[2000.0, -1500.0], [-900.0, 4000.0], [0.0, 1.0], [3000.0, 3000.0]])  # arcs at height h
    s = np.hypot(*level.T)
    theta = s / (radius + h)
    point = np.column_stack(
        [
            *((radius + h) * np.sin(theta) * level.T / s),
            (radius + h) * np.cos(theta) - (radius + h0),
        ]
    )
    camera = point @ rotation
    measured = -c * camera[:, :2] / camera[:, 2:]
    flat = np.column_stack([level, np.full(4, h - h0)]) @ rotation
    expected = -c * flat[:, :2] / flat[:, 2:]
    found = curvature_corrected(measured, c, rotation, h0, h, CurvatureOptions(radius))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)
    shorter = level * radius / (radius + h)
    flat = np.column_stack([shorter, np.full(4, h - h0)]) @ rotation
    found = curvature_corrected(measured, c, rotation, h0, h, CurvatureOptions(radius, level="ellipsoid"))
    np.testing.assert_allclose(found, -c * flat[:, :2] / flat[:, 2:], rtol=0, atol=1e-13)


def test_sizes_of_the_theory_page():
    """Radius 163 mm, c 150 mm: 1.5 to 90 µm at 0.1 to 6 km; a drone at 100 m 0.065 µm."""
    radius = np.hypot(0.115, 0.115)
    for height, micrometres in ((100, 1.5), (500, 7.5), (1500, 22.5), (3000, 45.0), (6000, 90.0)):
        options = CurvatureOptions(6.38e6, "classical")
        out = curvature_corrected((0.115, 0.115), 0.15, np.eye(3), height, 0.0, options)
        assert 1e6 * (np.hypot(*out) - radius) == pytest.approx(micrometres, rel=0.02)
    corner = np.array([0.018, 0.012])
    drone = curvature_corrected(corner, 0.035, np.eye(3), 100.0, 0.0, CurvatureOptions(6.38e6))
    assert 1e6 * (np.hypot(*drone) - np.hypot(*corner)) == pytest.approx(0.065, rel=0.03)


def test_the_point_below_the_camera_does_not_move():
    for method in ("classical", "sphere"):
        out = curvature_corrected((0.0, 0.0), 0.15, np.eye(3), 1000.0, 0.0, CurvatureOptions(6.37e6, method))
        np.testing.assert_array_equal(out, (0.0, 0.0))


def test_impossible_geometry_is_refused():
    options = CurvatureOptions(6.37e6)
    with pytest.raises(OrientationError, match="below"):
        curvature_corrected((0.0, 0.0), 0.15, np.eye(3), 100.0, 200.0, options)
    up = rotation_from_opk((np.pi, 0.0, 0.0))
    with pytest.raises(OrientationError, match="does not go down"):
        curvature_corrected((0.0, 0.0), 0.15, up, 200.0, 100.0, options)
    nearly_level = rotation_from_opk((np.deg2rad(89.9), 0.0, 0.0))
    with pytest.raises(OrientationError, match="horizon"):
        curvature_corrected((0.0, 0.0), 0.15, nearly_level, 9000.0, 0.0, options)
    with pytest.raises(InputError, match="Earth radius"):
        CurvatureOptions(6370.0)
    with pytest.raises(InputError, match="classical or sphere"):
        CurvatureOptions(6.37e6, "flat")
    with pytest.raises(InputError, match="icao, ardc or none"):
        refraction_corrected((0.0, 0.0), 0.15, np.eye(3), 100.0, 0.0, "maybe")


def test_refraction_by_integrating_the_ray():
    """Snell's law followed in thousands of thin layers, against the quadrature."""
    c, h0, h = 0.15, 6000.0, 300.0
    rotation = rotation_from_opk((0.3, 0.1, 1.0))
    xy = np.array([0.1, -0.1])
    ray = rotation @ np.array([*xy, -c])
    sine = np.hypot(ray[0], ray[1]) / np.linalg.norm(ray)
    heights = np.linspace(h0, h, 20_001)
    middle = 0.5 * (heights[1:] + heights[:-1])
    s = refractive_index(h0) * sine / refractive_index(middle)
    distance = np.sum(s / np.sqrt(1 - s * s)) * (h0 - h) / middle.size
    straight = np.array([*(ray[:2] / np.hypot(*ray[:2]) * distance), h - h0]) @ rotation
    found = refraction_corrected(xy, c, rotation, h0, h)
    np.testing.assert_allclose(found, -c * straight[:2] / straight[2], rtol=0, atol=1e-13)
    assert np.hypot(*(found - xy)) > 5e-6  # it is not nothing


def test_refractive_index_of_the_standard_atmosphere():
    # Edlén's dry air at 0.55 µm; density ratios of ISO 2533 at 5 and 15 km.
    assert refractive_index(0.0) - 1.0 == pytest.approx(2.7783e-4, rel=1e-4)
    assert (refractive_index(5000.0) - 1) / (refractive_index(0.0) - 1) == pytest.approx(
        0.7364 / 1.225, rel=1e-3
    )
    assert (refractive_index(15000.0) - 1) / (refractive_index(0.0) - 1) == pytest.approx(
        0.19476 / 1.225, rel=1e-3
    )


def test_the_two_atmospheres_agree_where_the_formula_was_made_for():
    for height in (4000.0, 6000.0, 9000.0):
        k = float(ardc_constant(height, 0.0))
        icao = refraction_corrected((0.15, 0.0), 0.15, np.eye(3), height, 0.0)
        ardc = refraction_corrected((0.15, 0.0), 0.15, np.eye(3), height, 0.0, "ardc")
        assert ardc[0] == pytest.approx(0.15 * (1 - 2 * k), rel=1e-12)
        assert (0.15 - icao[0]) == pytest.approx(0.15 - ardc[0], rel=0.1)
        assert icao[1] == ardc[1] == 0.0
    off = refraction_corrected((0.1, 0.05), 0.15, np.eye(3), 3000.0, 0.0, "none")
    np.testing.assert_array_equal(off, (0.1, 0.05))


@pytest.mark.real
def test_refraction_of_the_houston_photographs(data_folder):
    """The published corrected coordinates: principal point, distortion and the ARDC refraction."""
    folder = data_folder / "houston_film" / "photo-lab3" / "data"
    c, h0, h = 153.358, 1860.0, 1100.0
    for photo in ("27", "28"):
        fiducial = np.loadtxt(folder / f"image_{photo}_fid.txt")[:, 1:]
        published = np.loadtxt(folder / f"image_{photo}_corrected.txt")[:, 1:]
        x, y = (fiducial - (-0.006, 0.006)).T
        r2 = x * x + y * y
        radial = 0.8878e-4 - 0.1528e-7 * r2 + 0.5256e-12 * r2**2
        p1, p2 = 0.1346e-6, 0.1224e-7
        lens = np.column_stack(
            [
                -x * radial - (p1 * (r2 + 2 * x * x) + 2 * p2 * x * y),
                -y * radial - (p2 * (r2 + 2 * y * y) + 2 * p1 * x * y),
            ]
        )
        reduced = np.column_stack([x, y])
        refraction = refraction_corrected(reduced, c, np.eye(3), h0, h, "ardc") - reduced
        # Printed to 1e-5 mm; the refraction is up to 2.6e-3 mm.
        np.testing.assert_allclose(reduced + lens + refraction, published, rtol=0, atol=1.1e-5)
        assert np.abs(refraction).max() > 1.5e-3
