"""Cameras as values: conventions, both directions, turns, computer-vision cameras, and what they refuse."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from camera_zoo import DISTORTIONS, FILMS, camera
from hypothesis import given, settings
from hypothesis import strategies as st

from stereomate.camera.distortion import (
    BrownDistortion,
    EbnerDeformation,
    FisheyeDistortion,
    OpenCVDistortion,
)
from stereomate.camera.model import Camera
from stereomate.errors import InputError


@pytest.mark.parametrize("name", [*DISTORTIONS, *FILMS])
def test_both_directions_agree_to_1e_10_of_the_format(name):
    cam = camera(name)
    columns, rows = np.meshgrid(np.linspace(0, 3999.999, 81), np.linspace(0, 2999.999, 61))
    pixels = np.stack([columns, rows], axis=-1)
    rays = cam.rays_from_image(pixels)
    depth = np.linspace(0.1, 5000.0, pixels.size // 2).reshape(61, 81, 1)
    again, inside = cam.image_from_camera(rays * depth)
    assert np.abs(again - pixels).max() < 1e-10 * 4000
    # On the very border rounding decides; one millionth of a pixel inside it does not.
    assert inside[1:-1, 1:-1].all()
    assert cam.covers_whole_array()
    # and the distortion of this test is a real one
    if name != "pinhole" and name not in FILMS:
        straight = (cam.photo_from_image(pixels) - cam.principal_point_mm) / cam.principal_distance_mm
        assert np.abs(straight - rays[..., :2]).max() > 0.01


@settings(deadline=None, max_examples=80)
@given(
    st.tuples(*[st.floats(-0.4, 0.4)] * 3),
    st.tuples(*[st.floats(-5e-3, 5e-3)] * 2),
    st.sampled_from(["ideal_to_measured", "measured_to_ideal"]),
    st.tuples(st.floats(0.0, 4000.0), st.floats(0.0, 3000.0)),
)
def test_a_pixel_has_its_ray_or_none(k, p, direction, pixel):
    cam = Camera.from_pixel_pitch(
        "any", (4000, 3000), 24.0, 0.008, (0.1, -0.05),
        BrownDistortion(0.0, *k, 0.0, *p, direction=direction),
    )  # fmt: skip
    ray = cam.rays_from_image(pixel)
    if np.isfinite(ray).all():
        again, _ = cam.image_from_camera(ray)
        # Close to the limit two points of the one side have nearly the same point on the other.
        ideal = cam.image_jacobians([ray])[2][0, :, :2] / 3000.0
        stretch = np.linalg.cond(ideal)
        if stretch < 1e3:
            np.testing.assert_allclose(again, pixel, rtol=0, atol=4e-7)
    else:
        assert np.isfinite(cam.monotonic_radius)


def test_camera_axes_and_pixel_corner():
    cam = Camera.from_pixel_pitch("c", (100, 60), 50.0, 0.1, (1.0, 2.0))
    # On the optical axis: the principal point, 1 mm right and 2 mm above the centre of the array.
    pixel, inside = cam.image_from_camera([0.0, 0.0, -3.0])
    np.testing.assert_allclose(pixel, [50 + 10, 30 - 20], atol=1e-12)
    assert inside
    # x right is column right, y up is row up.
    np.testing.assert_allclose(cam.image_from_camera([1.0, 0.5, -50.0])[0], [60 + 10, 10 - 5], atol=1e-12)
    # The outer corner of the first pixel.
    np.testing.assert_allclose(cam.photo_from_image([0.0, 0.0]), [-5.0, 3.0], atol=1e-15)
    np.testing.assert_allclose(cam.image_from_photo([-5.0, 3.0]), [0.0, 0.0], atol=1e-12)


def test_inside_is_the_half_open_array_before_the_camera():
    cam = Camera.from_pixel_pitch("c", (100, 60), 50.0, 0.1)
    corners = cam.rays_from_image([[0, 0], [99.999999, 59.999999], [100.0, 30.0], [50, 60.0], [-1e-9, 30]])
    np.testing.assert_array_equal(cam.image_from_camera(corners)[1], [True, True, False, False, False])
    pixels, inside = cam.image_from_camera([[0, 0, 0], [0, 0, 1], [np.nan, 0, -1], [0, 0, np.nan]])
    assert not inside.any()
    assert np.isnan(pixels[:, 0]).all()


def _turned(image, rotation, mirrored):
    if mirrored:
        image = image[:, ::-1]
    return np.rot90(image, -rotation // 90)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("rotation", [0, 90, 180, 270])
def test_turned_and_mirrored_arrays_show_the_same_ray(rotation, mirrored):
    model = BrownDistortion(k1=-0.2, p1=1e-3, p2=2e-3, symmetry_mm=(0.2, 0.1))
    upright = Camera.from_pixel_pitch("u", (40, 30), 2.0, 0.1, (0.3, 0.2), model)
    names = np.arange(1200).reshape(30, 40)
    stored = _turned(names, rotation, mirrored)
    cam = Camera.from_pixel_pitch("t", stored.shape[::-1], 2.0, 0.1, (0.3, 0.2), model, rotation, mirrored)
    for name in (0, 17, 39, 600, 1190):
        (row,), (column,) = np.nonzero(names == name)
        (stored_row,), (stored_column,) = np.nonzero(stored == name)
        np.testing.assert_allclose(
            cam.rays_from_image([stored_column + 0.5, stored_row + 0.5]),
            upright.rays_from_image([column + 0.5, row + 0.5]),
            atol=1e-13,
        )


@pytest.mark.parametrize("name", ["opencv5", "opencv8", "opencv14"])
def test_opencv_models_are_opencvs(name):
    cam = camera(name)
    model = cam.distortion
    points = np.random.default_rng(1).uniform(-1, 1, (500, 3)) * [3, 2, 0.5] - [0, 0, 6]
    f = 24.0 / 0.008
    matrix = np.array([[f, 0, 2000 + 0.1 / 0.008 - 0.5], [0, f, 1500 + 0.05 / 0.008 - 0.5], [0, 0, 1.0]])
    vector = np.array([getattr(model, n) for n in model.coefficient_names])
    expected, _ = cv2.projectPoints(points * [1, -1, -1], np.zeros(3), np.zeros(3), matrix, vector)
    np.testing.assert_allclose(cam.image_from_camera(points)[0] - 0.5, expected[:, 0], atol=1e-9)


def test_fisheye_is_opencvs():
    cam = camera("fisheye")
    points = np.random.default_rng(1).uniform(-1, 1, (500, 3)) * [9, 9, 0.5] - [0, 0, 1]
    f = 24.0 / 0.008
    matrix = np.array([[f, 0, 2000 + 0.1 / 0.008], [0, f, 1500 + 0.05 / 0.008], [0, 0, 1.0]])
    vector = np.array([getattr(cam.distortion, n) for n in cam.distortion.coefficient_names])
    flipped = (points * [1, -1, -1])[:, None]
    expected, _ = cv2.fisheye.projectPoints(flipped, np.zeros(3), np.zeros(3), matrix, vector)
    np.testing.assert_allclose(cam.image_from_camera(points)[0], expected[:, 0], atol=1e-9)


def test_opencv_and_agisoft_exchange_p1_and_p2():
    points = np.random.default_rng(2).uniform(-1, 1, (50, 3)) - [0, 0, 4]
    numbers = {"k1": -0.1, "k2": 0.01, "b1": 1e-3, "b2": -2e-3}
    one = Camera.from_pixel_pitch(
        "a", (4000, 3000), 24.0, 0.008, (0, 0), BrownDistortion(**numbers, p1=1e-3, p2=-2e-3)
    )
    other = Camera.from_pixel_pitch(
        "b", (4000, 3000), 24.0, 0.008, (0, 0),
        BrownDistortion(**numbers, p1=-2e-3, p2=1e-3, convention="agisoft"),
    )  # fmt: skip
    np.testing.assert_array_equal(one.image_from_camera(points)[0], other.image_from_camera(points)[0])


def test_agisoft_formula_as_written_by_its_manual():
    # Agisoft Metashape user manual, appendix D: x right, y down, f, cx, cy, b1, b2 in pixels.
    f, cx, cy, b1, b2, k1, k2, k3, p1, p2 = 3000.0, 12.5, -6.0, 2.5, -1.5, -0.1, 0.05, 0.01, 1e-3, -7e-4
    points = np.random.default_rng(3).uniform(-1, 1, (50, 3)) - [0, 0, 4]
    x, y = points[:, 0] / -points[:, 2], -points[:, 1] / -points[:, 2]
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    xd = x * radial + p1 * (r2 + 2 * x * x) + 2 * p2 * x * y
    yd = y * radial + p2 * (r2 + 2 * y * y) + 2 * p1 * x * y
    u = 4000 * 0.5 + cx + xd * f + xd * b1 + yd * b2
    v = 3000 * 0.5 + cy + yd * f
    cam = Camera.from_focal_lengths(
        "metashape", (4000, 3000), (f, f), (2000 + cx, 1500 + cy),
        BrownDistortion(k1=k1, k2=k2, k3=k3, p1=p1, p2=p2, b1=b1 / f, b2=b2 / f, convention="agisoft"),
    )  # fmt: skip
    np.testing.assert_allclose(cam.image_from_camera(points)[0], np.stack([u, v], -1), atol=1e-9)
    assert cam.principal_distance_mm == pytest.approx(3000 * 36 / 4000)


def test_certificate_formula_in_photo_coordinates():
    # Corrections are subtracted, in mm, y up, about the point of best symmetry; c and principal point after.
    k0, k1, k2, p1, p2 = 1e-4, -2e-8, 5e-13, 1.3e-7, -2e-8
    symmetry, principal, c = np.array([0.02, -0.03]), np.array([-0.006, 0.006]), 153.358
    cam = Camera(
        "film", (2300, 2300), c, tuple(principal), ((10.0, 0.0, 1150.0), (0.0, -10.0, 1150.0)),
        BrownDistortion.from_certificate((k0, k1, k2), (p1, p2), tuple(symmetry)),
    )  # fmt: skip
    measured = np.random.default_rng(4).uniform(-110, 110, (50, 2))
    x, y = (measured - symmetry).T
    r2 = x * x + y * y
    radial = k0 + k1 * r2 + k2 * r2**2
    ideal = measured - np.stack(
        [
            x * radial + p1 * (r2 + 2 * x * x) + 2 * p2 * x * y,
            y * radial + p2 * (r2 + 2 * y * y) + 2 * p1 * x * y,
        ],
        axis=-1,
    )
    rays = cam.rays_from_image(cam.image_from_photo(measured))
    np.testing.assert_allclose(rays[:, :2] * c, ideal - principal, atol=1e-11)


def test_usgs_is_australis_with_the_signs_turned():
    numbers = {"k1": 2e-4, "k2": -1e-7, "p1": 3e-5, "p2": -1e-5, "b1": 1e-3, "b2": 5e-4}
    turned = {name: -value for name, value in numbers.items()}
    pixels = np.random.default_rng(5).uniform(0, 3000, (50, 2))
    rays = [
        Camera.from_pixel_pitch(
            "m", (4000, 3000), 24.0, 0.008, (0.1, 0.2),
            BrownDistortion(**n, convention=convention, direction="measured_to_ideal", units="mm"),
        ).rays_from_image(pixels)
        for n, convention in ((numbers, "australis"), (turned, "usgs"))
    ]  # fmt: skip
    np.testing.assert_array_equal(*rays)


def test_opensfm_brown_of_normalised_coordinates():
    # OpenSfM, src/bundle: normalised by max(width, height), y down, origin at the centre of the array.
    width, height, fx, fy, cx, cy = 1368, 912, 0.6664, 0.6671, -0.0015, 0.0047
    k1, k2, p1, p2, k3 = -0.264, 0.102, 7.3e-4, 2.6e-4, -0.0258
    points = np.random.default_rng(6).uniform(-1, 1, (50, 3)) - [0, 0, 3]
    x, y = points[:, 0] / -points[:, 2], -points[:, 1] / -points[:, 2]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    xd = radial * x + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = radial * y + 2 * p2 * x * y + p1 * (r2 + 2 * y * y)
    size = max(width, height)
    expected = np.stack([(fx * xd + cx) * size + width / 2, (fy * yd + cy) * size + height / 2], axis=-1)
    cam = Camera.from_focal_lengths(
        "p4", (width, height), (fx * size, fy * size), (cx * size + width / 2, cy * size + height / 2),
        BrownDistortion(k1=k1, k2=k2, p1=p1, p2=p2, k3=k3), sensor_width_mm=13.2,
    )  # fmt: skip
    np.testing.assert_allclose(cam.image_from_camera(points)[0], expected, atol=1e-9)


@pytest.mark.parametrize("direction", ["ideal_to_measured", "measured_to_ideal"])
def test_beyond_the_monotonic_range_is_outside_not_folded_back(direction):
    # f(r) = r - r³ rises to r = 1/√3, where it is 2/(3√3).
    model = BrownDistortion(k1=-1.0, direction=direction)
    cam = Camera.from_pixel_pitch("fold", (4000, 4000), 10.0, 0.01, (0, 0), model)
    limit, top = 1 / np.sqrt(3), 2 / (3 * np.sqrt(3))
    assert cam.monotonic_radius == pytest.approx(limit, rel=1e-12)
    assert not cam.covers_whole_array()
    end = limit if direction == "ideal_to_measured" else top
    points = np.array([[end * 0.999, 0, -1], [end * 1.001, 0, -1], [0.9, 0, -1], [0.999, 0, -1]])
    pixels, inside = cam.image_from_camera(points)
    np.testing.assert_array_equal(inside, [True, False, False, False])
    assert np.isnan(pixels[1:]).all()
    end = top if direction == "ideal_to_measured" else limit
    rays = cam.rays_from_image([[2000 + 1000 * end * 0.999, 2000], [2000 + 1000 * end * 1.001, 2000]])
    np.testing.assert_array_equal(np.isnan(rays[:, 0]), [False, True])


def test_decentring_that_folds_earlier_lowers_the_limit():
    radial = Camera.from_pixel_pitch("r", (4000, 4000), 10.0, 0.01, (0, 0), BrownDistortion(k1=-0.3))
    both = Camera.from_pixel_pitch("b", (4000, 4000), 10.0, 0.01, (0, 0), BrownDistortion(k1=-0.3, p2=-0.08))
    assert radial.monotonic_radius == pytest.approx(1 / np.sqrt(0.9), rel=1e-12)
    # Along +x the image is x - 0.3 x³ - 0.24 x²: stationary where 1 - 0.9 x² - 0.48 x = 0.
    stationary = (-0.48 + np.sqrt(0.48**2 + 3.6)) / 1.8
    assert both.monotonic_radius == pytest.approx(stationary, rel=1e-6)


def test_rational_pole_and_fisheye_limit():
    pole = Camera.from_pixel_pitch("p", (400, 400), 1.0, 0.01, (0, 0), OpenCVDistortion(k4=-0.25))
    assert pole.monotonic_radius == pytest.approx(2.0, rel=1e-9)
    fisheye = Camera.from_pixel_pitch("f", (400, 400), 1.0, 0.01, (0, 0), FisheyeDistortion(k1=-1 / 3))
    assert fisheye.monotonic_radius == pytest.approx(np.tan(1.0), rel=1e-9)  # θ - θ³/3 rises to θ = 1


def test_a_model_that_folds_everywhere_is_refused():
    cam = Camera.from_pixel_pitch("w", (400, 400), 1.0, 0.01, (0, 0), BrownDistortion(k0=-1.5))
    with pytest.raises(InputError, match="k0"):
        cam.image_from_camera([0.0, 0.0, -1.0])


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"name": ""}, "name"),
        ({"size_px": (0, 10)}, "size_px"),
        ({"size_px": (10.5, 10)}, "size_px"),
        ({"principal_distance_mm": -1.0}, "principal_distance_mm"),
        ({"principal_distance_mm": float("nan")}, "principal_distance_mm"),
        ({"principal_point_mm": (0.0, float("inf"))}, "principal_point_mm"),
        ({"pixel_from_photo": ((1.0, 2.0, 0.0), (2.0, 4.0, 0.0))}, "pixel_from_photo"),
        ({"pixel_from_photo": ((1.0, 2.0), (2.0, 4.0))}, "pixel_from_photo"),
    ],
)
def test_wrong_cameras_are_refused_by_field(change, field):
    good = {
        "name": "c",
        "size_px": (100, 100),
        "principal_distance_mm": 50.0,
        "principal_point_mm": (0.0, 0.0),
        "pixel_from_photo": ((10.0, 0.0, 50.0), (0.0, -10.0, 50.0)),
    }
    Camera(**good)
    with pytest.raises(InputError, match=field):
        Camera(**(good | change))


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: BrownDistortion(k1=float("nan")), "k1"),
        (lambda: BrownDistortion(convention="leica"), "convention"),
        (lambda: BrownDistortion(direction="back"), "direction"),
        (lambda: BrownDistortion(units="px"), "units"),
        (lambda: BrownDistortion(symmetry_mm=(1.0,)), "symmetry_mm"),
        (lambda: BrownDistortion.from_certificate((0.0,) * 6), "radial"),
        (lambda: OpenCVDistortion(taux=2.0), "taux"),
        (lambda: OpenCVDistortion.from_vector((0.1, 0.2, 0.3)), "terms"),
        (lambda: FisheyeDistortion(k3=float("inf")), "k3"),
        (lambda: Camera.from_pixel_pitch("c", (10, 10), 1.0, 0.1, rotation=45), "rotation"),
        (lambda: Camera.from_pixel_pitch("c", (10, 10), 1.0, -0.1), "pixel_pitch_mm"),
        (lambda: Camera.from_focal_lengths("c", (10, 10), (1.0, 0.0), (5, 5)), "focal"),
    ],
)
def test_wrong_distortions_are_refused_by_field(make, field):
    with pytest.raises(InputError, match=field):
        make()


def _central(function, at, steps):
    columns = []
    for i, step in enumerate(steps):
        shift = np.zeros(len(at))
        shift[i] = step
        # Fourth order: the differences are good to 1e-9 even for high powers of the radius.
        near = function(at + shift) - function(at - shift)
        far = function(at + 2 * shift) - function(at - 2 * shift)
        columns.append((8 * near - far) / (12 * step))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("name", [*DISTORTIONS, *FILMS])
def test_jacobians_are_the_central_differences(name):
    cam = camera(name)
    points = cam.rays_from_image(np.random.default_rng(8).uniform(100, 2900, (20, 2))) * 7.0
    pixels, inside, d_points, d_interior = cam.image_jacobians(points)
    np.testing.assert_allclose(pixels, cam.image_from_camera(points)[0], atol=1e-9)
    assert inside.all()
    for point, jacobian in zip(points, d_points, strict=True):
        numeric = _central(lambda at: cam.image_from_camera(at)[0], point, [1e-3] * 3)
        np.testing.assert_allclose(jacobian, numeric, rtol=1e-7, atol=1e-6)
    at = np.array(cam.parameters)
    # Steps that move the image by about a hundredth of a pixel each.
    steps = 1e-2 / np.maximum(np.abs(d_interior).max(axis=(0, 1)), 1e-6)
    numeric = _central(lambda v: cam.with_parameters(v).image_from_camera(points)[0], at, steps)
    scale = np.abs(d_interior).max(axis=(0, 1))
    assert d_interior.shape == (20, 2, len(cam.parameter_names))
    np.testing.assert_allclose(d_interior / scale, numeric / scale, rtol=0, atol=2e-7)


def test_parameters_go_round():
    for name in (*DISTORTIONS, *FILMS):
        cam = camera(name)
        assert len(cam.parameters) == len(cam.parameter_names)
        assert cam.with_parameters(cam.parameters) == cam
        named = dict(zip(cam.parameter_names, cam.parameters, strict=True))
        for field in cam.distortion.coefficient_names:
            assert named[field] == getattr(cam.distortion, field)
    with pytest.raises(InputError, match="interior parameters"):
        camera("pinhole").with_parameters([1.0])


def test_ebner_is_orthogonal_at_his_nine_points_and_to_the_exterior_orientation():
    b, c = 92.0, 153.0
    x, y = (v.ravel() for v in np.meshgrid(*[[-b, 0.0, b]] * 2))
    film = Camera.from_pixel_pitch("f", (2300, 2300), c, 0.1)
    columns = []
    for i in range(12):
        deformed = replace(film, deformation=EbnerDeformation(b, **{f"b{i + 1}": 1e-3}))
        pixels = deformed.image_from_camera(np.stack([x / c, y / c, -np.ones(9)], axis=-1))[0]
        moved = film.photo_from_image(pixels) - np.stack([x, y], axis=-1)
        columns.append(moved.ravel() / 1e-3)
    one, none = np.ones(9), np.zeros(9)
    exterior = [
        (one, none),
        (none, one),
        (x, y),
        (-y, x),
        (c + x * x / c, x * y / c),
        (x * y / c, c + y * y / c),
    ]
    columns += [np.stack(pair, axis=-1).ravel() for pair in exterior]
    normal = np.array(columns) @ np.array(columns).T
    cosines = normal / np.sqrt(np.outer(np.diag(normal), np.diag(normal)))
    # Shifts and tilts are the same within a vertical photograph: those four alone are not orthogonal.
    within = np.ones((18, 18), bool)
    within[12:, 12:] = False
    np.testing.assert_allclose(cosines[within], np.eye(18)[within], atol=1e-9)
    # Twelve and six are all that eighteen coordinates can show.
    assert np.linalg.matrix_rank(np.array(columns) / np.sqrt(np.diag(normal))[:, None]) == 18


def test_ebner_in_his_own_form():
    # H. Ebner (1976), coefficients of unscaled coordinates.
    b, own = (
        92.0,
        np.random.default_rng(4).uniform(-1, 1, 12) * 1e-3 / 92.0 ** np.repeat([0, 1, 2, 3], [2, 4, 4, 2]),
    )
    powers = np.repeat([1, 2, 3, 4], [2, 4, 4, 2])
    film = Camera.from_pixel_pitch("f", (2300, 2300), 153.0, 0.1)
    film = replace(film, deformation=EbnerDeformation(b, *(own * b**powers).tolist()))
    x, y = np.random.default_rng(5).uniform(-110, 110, (2, 50))
    pixels = film.image_from_camera(np.stack([x / 153.0, y / 153.0, -np.ones(50)], axis=-1))[0]
    b1, b2, b3, b4, b5, b6, b7, b8, b9, b10, b11, b12 = own
    n, m = x * x - 2 * b * b / 3, y * y - 2 * b * b / 3
    dx = (
        b1 * x
        + b2 * y
        - b3 * (2 * x * x - 4 * b * b / 3)
        + b4 * x * y
        + b5 * m
        + b7 * x * m
        + b9 * y * n
        + b11 * n * m
    )
    dy = (
        -b1 * y
        + b2 * x
        + b3 * x * y
        - b4 * (2 * y * y - 4 * b * b / 3)
        + b6 * n
        + b8 * y * n
        + b10 * x * m
        + b12 * n * m
    )
    np.testing.assert_allclose(film.photo_from_image(pixels), np.stack([x + dx, y + dy], -1), atol=1e-9)


def test_deformation_that_folds_the_film_is_nowhere_and_fisheyes_have_none():
    film = Camera.from_pixel_pitch("f", (2300, 2300), 153.0, 0.1)
    folded = replace(film, deformation=EbnerDeformation(92.0, b11=200.0))
    pixels, inside = folded.image_from_camera([[0.0, 0.0, -1.0], [-0.75, 0.75, -1.0], [9.0, 9.0, -1.0]])
    assert np.isfinite(pixels[0]).all()
    assert not inside[1:].any()
    assert np.isnan(pixels[1:]).all()
    with pytest.raises(InputError, match="distortion"):
        replace(film, distortion=FisheyeDistortion(), deformation=EbnerDeformation(92.0))
    with pytest.raises(InputError, match=r"b3"):
        EbnerDeformation(92.0, b3=float("nan"))
    with pytest.raises(InputError, match="spacing_mm"):
        EbnerDeformation(0.0)
    with pytest.raises(InputError, match="projective_per_mm"):
        replace(film, projective_per_mm=(float("inf"), 0.0))
