"""Collinearity and forward intersection: derivatives, two rays, many rays, statistics."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from stereomate.errors import InputError
from stereomate.geometry import collinearity as col
from stereomate.geometry.intersection import Rays, intersect_linear, intersect_rays, intersect_two_rays
from stereomate.geometry.rotations import rotation_from_opk, rotation_from_vector

ORIGIN = np.array([6e5, 5e6, 300.0])


def _numeric(function, n, step):
    columns = []
    for i in range(n):
        h = np.zeros(n)
        h[i] = step
        columns.append((function(h) - function(-h)) / (2 * step))
    return np.stack(columns, axis=-1)


def test_collinearity_is_the_equation_of_the_books():
    rng = np.random.default_rng(1)
    r = rotation_from_opk([0.05, -0.1, 2.0])
    centre, point = np.array([100.0, 200.0, 1500.0]), rng.uniform(-200, 500, 3)
    d = point - centre
    down = r[:, 2] @ d
    expected = [-152.0 * (r[:, 0] @ d) / down, -152.0 * (r[:, 1] @ d) / down]
    photo = col.photo_from_object(point, centre, r, 152.0)
    np.testing.assert_allclose(photo, expected, rtol=1e-14)
    # and backwards: object = X0 + s R (x, y, -c)
    s = np.linalg.norm(d) / np.linalg.norm([*photo, 152.0])
    again = col.object_from_camera_points(s * np.array([*photo, -152.0]), centre, r)
    np.testing.assert_allclose(again, point, atol=1e-9)


def test_points_behind_the_camera_have_no_image():
    photo = col.photo_from_object([[0, 0, 5.0], [0, 0, 0], [0, 0, -5]], [0, 0, 0], np.eye(3), 1.0)
    np.testing.assert_array_equal(np.isnan(photo[:, 0]), [True, True, False])


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10**6))
def test_collinearity_jacobians_are_the_central_differences(seed):
    rng = np.random.default_rng(seed)
    opk = rng.uniform([-0.5, -0.5, -3], [0.5, 0.5, 3])
    r = rotation_from_opk(opk)
    centre = np.array([0.0, 0.0, 1500.0])
    point = col.object_from_camera_points(
        [rng.uniform(-900, 900), rng.uniform(-900, 900), -1500.0], centre, r
    )
    photo, by_point, by_centre, by_rotation = col.photo_jacobians(point, centre, r, 152.0)

    def at(p, x0, rotation):
        return col.photo_from_object(p, x0, rotation, 152.0)

    np.testing.assert_array_equal(photo, at(point, centre, r))
    options = {"rtol": 1e-6, "atol": 1e-7}
    np.testing.assert_allclose(by_point, _numeric(lambda h: at(point + h, centre, r), 3, 0.1), **options)
    np.testing.assert_allclose(by_centre, _numeric(lambda h: at(point, centre + h, r), 3, 0.1), **options)
    turned = _numeric(lambda h: at(point, centre, rotation_from_vector(h) @ r), 3, 1e-4)
    np.testing.assert_allclose(by_rotation, turned, rtol=1e-6, atol=1e-5)
    angles = _numeric(lambda h: at(point, centre, rotation_from_opk(opk + h)), 3, 1e-4)
    np.testing.assert_allclose(by_rotation @ col.perturbation_from_opk(opk), angles, rtol=1e-6, atol=1e-5)


def test_jacobians_are_vectorised():
    points = np.random.default_rng(0).uniform(-1, 1, (5, 4, 3)) - [0, 0, 5]
    photo, by_point, by_centre, by_rotation = col.photo_jacobians(points, [0, 0, 0], np.eye(3), 1.0)
    assert photo.shape == (5, 4, 2)
    assert by_point.shape == by_centre.shape == by_rotation.shape == (5, 4, 2, 3)
    one = col.photo_jacobians(points[2, 3], [0, 0, 0], np.eye(3), 1.0)[3]
    np.testing.assert_allclose(by_rotation[2, 3], one, rtol=1e-15)


def test_two_rays_and_their_miss():
    # Along x at height 0 and along y at height 2: they pass each other at (3, 4).
    found = intersect_two_rays([0, 4, 0], [2, 0, 0], [3, 0, 2], [0, 1, 0])
    np.testing.assert_allclose(found.points, [3, 4, 1])
    np.testing.assert_allclose(found.miss, [0, 0, -2])
    np.testing.assert_allclose(found.depths, [1.5, 4.0])
    assert found.miss_distance == pytest.approx(2.0)
    parallel = intersect_two_rays(
        [[0, 0, 0], [0, 0, 0]], [1, 1, 0], [[1, 0, 0], [1, 0, 0]], [[1, 1, 0], [0, 1, 0]]
    )
    np.testing.assert_array_equal(np.isnan(parallel.points[:, 0]), [True, False])
    np.testing.assert_allclose(parallel.points[1], [1, 1, 0])


def _block(seed: int, count: int = 40, noise: float = 0.0):
    """Points in two to six photographs each, of a strip 1500 m above ground, far from the origin."""
    rng = np.random.default_rng(seed)
    points = rng.uniform([-500, -500, -50], [500, 500, 50], (count, 3)) + ORIGIN
    centres = np.array([[x, 30.0 * (-1) ** i, 1500] for i, x in enumerate(np.linspace(-700, 700, 6))])
    centres = centres + ORIGIN
    rotations = rotation_from_opk(rng.uniform([-0.05, -0.05, -3], [0.05, 0.05, 3], (6, 3)))
    seen = [np.sort(rng.choice(6, rng.integers(2, 7), replace=False)) for _ in range(count)]
    index = np.repeat(np.arange(count), [len(s) for s in seen])
    photo = np.concatenate(seen)
    exact = col.photo_from_object(points[index], centres[photo], rotations[photo], 1.0)
    sigma = rng.uniform(0.5, 2.0, len(index)) * (noise or 1e-5)
    image = exact + (rng.normal(0, sigma, (2, len(index))).T if noise else 0.0)
    return points, Rays(index, centres[photo], rotations[photo], image, sigma)


def test_exact_rays_meet_in_the_points():
    points, rays = _block(1)
    np.testing.assert_allclose(intersect_linear(rays, 40), points, rtol=0, atol=1e-5)
    found = intersect_rays(rays)
    np.testing.assert_allclose(found.points, points, rtol=0, atol=1e-6)
    assert found.converged.all()
    np.testing.assert_array_equal(found.redundancy, 2 * np.bincount(rays.point) - 3)


def test_intersection_is_the_least_squares_of_image_residuals():
    _, rays = _block(2, noise=2e-5)
    found = intersect_rays(rays)
    assert found.converged.all()
    for k in (0, 7, 23):
        mine = rays.point == k

        def residuals(offset, mine=mine, k=k):
            computed = col.photo_from_object(
                found.points[k] - ORIGIN + offset,
                rays.centres[mine] - ORIGIN,
                rays.object_from_camera[mine],
                1.0,
            )
            return ((rays.image[mine] - computed) / rays.sigma[mine, None]).reshape(-1)

        other = least_squares(residuals, [0.3, -0.2, 0.5], "3-point", xtol=1e-15, ftol=1e-15, gtol=1e-15)
        np.testing.assert_allclose(other.x, 0.0, atol=2e-6)
        np.testing.assert_allclose(found.cofactors[k], np.linalg.inv(other.jac.T @ other.jac), rtol=1e-5)
        assert found.sigma0[k] ** 2 * found.redundancy[k] == pytest.approx(2 * other.cost, rel=1e-9)
        np.testing.assert_allclose(
            (found.residuals[mine] / rays.sigma[mine, None]).reshape(-1), residuals(np.zeros(3)), atol=1e-6
        )


def test_stated_covariance_is_the_scatter_of_repeated_measurement():
    total = unit = degrees = 0.0
    for seed in range(20):
        points, rays = _block(seed, noise=1e-5)
        found = intersect_rays(rays)
        offset = found.points - points
        total += np.einsum("ki,kij,kj->", offset, np.linalg.inv(found.cofactors), offset)
        unit += np.sum(found.sigma0**2 * found.redundancy)
        degrees += found.redundancy.sum()
    assert abs(total - 2400) < 2.6 * np.sqrt(4800)
    assert abs(unit - degrees) < 2.6 * np.sqrt(2 * degrees)


def test_what_rays_do_not_determine_is_nan_and_does_not_spoil_the_rest():
    _, rays = _block(5, noise=1e-5)
    image, centres, rotations = rays.image.copy(), rays.centres.copy(), rays.object_from_camera.copy()
    keep = np.ones(len(image), dtype=bool)
    keep[np.flatnonzero(rays.point == 0)[1:]] = False  # point 0: one ray
    parallel = np.flatnonzero(rays.point == 1)
    image[parallel] = 0.1  # point 1: parallel rays
    rotations[parallel] = rotations[parallel[0]]
    behind = np.flatnonzero(rays.point == 2)
    rotations[behind] = rotations[behind] @ np.diag([1.0, -1.0, -1.0])  # point 2: cameras look at the sky
    image[behind, 0] *= -1.0
    changed = Rays(rays.point[keep], centres[keep], rotations[keep], image[keep], rays.sigma[keep])
    found = intersect_rays(changed, count=41)  # point 40: never seen
    assert np.isnan(found.points[[0, 1, 2, 40]]).all()
    assert not found.converged[[0, 1, 2, 40]].any()
    assert found.redundancy[0] == -1
    alone = intersect_rays(rays)
    np.testing.assert_allclose(found.points[3:40], alone.points[3:], rtol=0, atol=1e-6)
    assert found.converged[3:40].all()


def test_intersection_from_a_poor_start_converges():
    points, rays = _block(6, noise=1e-5)
    start = points + np.random.default_rng(0).uniform(-100, 100, points.shape)
    np.testing.assert_allclose(
        intersect_rays(rays, start=start).points, intersect_rays(rays).points, rtol=0, atol=1e-6
    )


def test_wrong_rays_are_refused_by_field():
    _, rays = _block(7)
    good = {
        name: getattr(rays, name) for name in ("point", "centres", "object_from_camera", "image", "sigma")
    }
    for name, value in [
        ("centres", rays.centres[:3]),
        ("image", rays.image * np.nan),
        ("sigma", -rays.sigma),
        ("point", rays.point - 1),
    ]:
        with pytest.raises(InputError, match=f"rays.{name}"):
            Rays(**(good | {name: value}))
    empty = intersect_rays(
        Rays(np.empty(0, int), np.empty((0, 3)), np.empty((0, 3, 3)), np.empty((0, 2)), np.empty(0))
    )
    assert empty.points.shape == (0, 3)
