"""Camera kernels as the engines call them: point by point, row by row, with bounds checks on or off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stereomate.camera import kernels
from stereomate.camera.distortion import (
    BrownDistortion,
    EbnerDeformation,
    FisheyeDistortion,
    NoDistortion,
    OpenCVDistortion,
)
from stereomate.camera.model import Camera

_CERTIFICATE = BrownDistortion.from_certificate((1e-4, -2e-8, 1e-12), (1e-7, -2e-7), (0.02, -0.03))
_STRONG = BrownDistortion(k1=-0.35, k2=0.02, p1=1e-3, b1=1e-3, direction="measured_to_ideal")

CAMERAS = {
    "pinhole": Camera.from_pixel_pitch("p", (2300, 2200), 153.0, 0.1, (0.1, -0.2), NoDistortion()),
    "brown": Camera.from_pixel_pitch(
        "b", (2300, 2200), 153.0, 0.1, (0.1, -0.2), BrownDistortion(k1=-0.3, k2=0.1, p1=1e-3, p2=-2e-3)
    ),
    "film": Camera.from_pixel_pitch("f", (2300, 2200), 153.0, 0.1, (0.1, -0.2), _CERTIFICATE, 90, True),
    "strong": Camera.from_pixel_pitch("s", (2300, 2200), 153.0, 0.1, (0.1, -0.2), _STRONG),
    "opencv": Camera.from_pixel_pitch(
        "o", (2300, 2200), 153.0, 0.1, (0.1, -0.2),
        OpenCVDistortion(-0.2, 0.05, 1e-3, -2e-3, 0.01, 0.02, 0.01, 0, 1e-3, -1e-3, 2e-3, 5e-4, 0.02, -0.03),
    ),
    "fisheye": Camera.from_pixel_pitch("y", (2300, 2200), 153.0, 0.1, (0, 0), FisheyeDistortion(0.01, -5e-3)),
}  # fmt: skip
_TWELVE = EbnerDeformation(92.0, *(0.02 * (-1) ** i + 0.003 * i for i in range(12)))
for _name in ("pinhole", "brown", "film", "strong"):
    CAMERAS[f"ebner-{_name}"] = replace(
        CAMERAS[_name], deformation=_TWELVE, projective_per_mm=(2e-5, -1e-5), format_mm=(226.0, 224.0)
    )


def _points() -> np.ndarray:
    rng = np.random.default_rng(3)
    points = rng.uniform([-3, -3, -1.2], [3, 3, 0.1], (4000, 3))  # beyond the array, beyond the range, behind
    points[:7] = [
        [0, 0, -1],
        [0, 0, 0],
        [0, 0, -0.0],
        [1, 1, 1],
        [np.nan, 0, -1],
        [1e9, 0, -1],
        [np.inf, 0, -1],
    ]
    return points


@pytest.mark.parametrize("name", CAMERAS)
def test_row_kernel_says_what_the_point_kernel_says(name):
    model, parameters = CAMERAS[name].kernel_parameters()
    points = _points()
    one = [kernels.image_from_camera_point(model, parameters, *point) for point in points]
    column, row, inside = np.empty(4000), np.empty(4000), np.empty(4000, dtype=bool)
    kernels.image_from_camera_row(
        model, parameters, *(np.ascontiguousarray(c) for c in points.T), column, row, inside
    )
    expected = np.array([o[2] for o in one])
    np.testing.assert_array_equal(inside, expected)
    assert 50 < expected.sum() < 3000
    found = np.array([o[:2] for o in one])
    np.testing.assert_array_equal(np.isnan(column), np.isnan(found[:, 0]))
    np.testing.assert_allclose(np.stack([column, row], -1)[inside], found[inside], rtol=0, atol=1e-9)
    assert np.isnan(column[1:5]).all()
    assert not inside[1:7].any()


@pytest.mark.parametrize("name", CAMERAS)
def test_ray_of_the_pixel_of_a_point_goes_through_the_point(name):
    model, parameters = CAMERAS[name].kernel_parameters()
    seen = 0
    for x, y, z in _points():
        column, row, inside = kernels.image_from_camera_point(model, parameters, x, y, z)
        if inside:
            u, v, ok = kernels.ray_from_pixel(model, parameters, column, row)
            assert ok
            np.testing.assert_allclose([u, v], [x / -z, y / -z], rtol=1e-9, atol=1e-10)
            seen += 1
    assert seen > 50


@pytest.mark.parametrize("name", CAMERAS)
def test_jacobian_kernel_agrees_with_the_projection_and_survives_bad_points(name):
    camera = CAMERAS[name]
    points = _points()
    pixels, inside, d_points, d_interior = camera.image_jacobians(points)
    expected, expected_inside = camera.image_from_camera(points)
    np.testing.assert_array_equal(inside, expected_inside)
    np.testing.assert_allclose(pixels[inside], expected[inside], rtol=0, atol=1e-9)
    assert np.isfinite(d_points[inside]).all()
    assert np.isfinite(d_interior[inside]).all()
    assert np.isnan(d_points[np.isnan(pixels[:, 0])]).all()
    # Scale along the ray changes nothing.
    np.testing.assert_allclose(np.einsum("nij,nj->ni", d_points[inside], points[inside]), 0.0, atol=1e-7)
