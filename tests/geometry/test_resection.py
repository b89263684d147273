"""Space resection against a textbook, closed forms against the truth, covariances against simulation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from stereomate.errors import InputError, NotDeterminedError
from stereomate.geometry.adjustment import AdjustmentOptions
from stereomate.geometry.collinearity import camera_from_object, photo_from_object
from stereomate.geometry.resection import resect, resect_three_points
from stereomate.geometry.rotations import rotation_angle, rotation_from_opk


def _scene(seed: int, n: int):
    rng = np.random.default_rng(seed)
    points = rng.uniform([-800, -800, -80], [800, 800, 80], (n, 3)) + np.array([5e5, 4e6, 200])
    centre = np.array([5e5, 4e6, 1700]) + rng.uniform(-50, 50, 3)
    rotation = rotation_from_opk(rng.uniform([-0.2, -0.2, -3], [0.2, 0.2, 3]))
    return points, centre, rotation


@pytest.mark.real
def test_mikhails_textbook_resection(data_folder):
    rows = [line.split() for line in (data_folder / "mikhail_resection/resect.inp").read_text().splitlines()]
    numbers = np.array([[float(v) for v in row[1:]] for row in rows if row])
    result = resect(numbers[:, :2], numbers[:, 2:], principal_distance=152.222)
    assert result.summary.converged
    np.testing.assert_allclose(result.centre, [914260.422, 575441.836, 839.130], rtol=0, atol=5.1e-4)
    np.testing.assert_allclose(result.opk, [-0.0065075, -0.0085218, -1.5753221], rtol=0, atol=5.1e-8)
    assert result.summary.redundancy == 4
    assert result.summary.redundancy_numbers.sum() == pytest.approx(4.0, abs=1e-9)


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 10**6))
def test_three_points_give_the_truth_among_their_solutions(seed):
    points, centre, rotation = _scene(seed, 3)
    local = points - points.mean(axis=0)
    area = np.linalg.norm(np.cross(local[1] - local[0], local[2] - local[0]))
    if area < 2e4:
        return
    rays = camera_from_object(points, centre, rotation)
    solutions = resect_three_points(rays, points)
    assert 1 <= len(solutions) <= 4
    nearest = min(solutions, key=lambda s: np.linalg.norm(s[0] - centre))
    assert np.linalg.norm(nearest[0] - centre) < 0.01
    assert rotation_angle(nearest[1].T @ rotation) < 1e-5
    for found_centre, found_rotation in solutions:
        again = camera_from_object(points, found_centre, found_rotation)
        cosines = np.sum(again * rays, axis=1) / np.linalg.norm(again, axis=1) / np.linalg.norm(rays, axis=1)
        np.testing.assert_allclose(cosines, 1.0, atol=1e-8)


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 10**6), st.integers(5, 12))
def test_exact_observations_give_the_truth_from_nothing(seed, n):
    points, centre, rotation = _scene(seed, n)
    image = photo_from_object(points, centre, rotation, 152.0)
    result = resect(image, points, principal_distance=152.0)
    np.testing.assert_allclose(result.centre, centre, rtol=0, atol=1e-5)
    assert rotation_angle(result.object_from_camera.T @ rotation) < 1e-8


def test_many_points_are_no_burden():
    points, centre, rotation = _scene(40, 3000)
    image = photo_from_object(points, centre, rotation, 152.0)
    for loss in ("squared", "huber"):
        options = AdjustmentOptions(loss=loss)
        result = resect(image, points, principal_distance=152.0, sigma=0.005, options=options)
        np.testing.assert_allclose(result.centre, centre, rtol=0, atol=1e-5)


def test_least_squares_is_scipys():
    points, centre, rotation = _scene(4, 8)
    sigma = np.random.default_rng(1).uniform(0.003, 0.03, (8, 2))
    image = photo_from_object(points, centre, rotation, 152.0) + np.random.default_rng(2).normal(0, sigma)
    result = resect(image, points, principal_distance=152.0, sigma=sigma)
    origin = points.mean(axis=0)

    def residuals(p):
        computed = photo_from_object(points - origin, p[:3], rotation_from_opk(p[3:]), 152.0)
        return ((image - computed) / sigma).reshape(-1)

    start = [*(centre - origin), *result.opk + 0.01]
    scale = [1, 1, 1, 1e-3, 1e-3, 1e-3]
    other = least_squares(residuals, start, xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale=scale)
    np.testing.assert_allclose(result.centre - origin, other.x[:3], rtol=0, atol=1e-5)
    np.testing.assert_allclose(result.opk, other.x[3:], rtol=0, atol=1e-8)
    assert result.summary.sigma0**2 * 10 == pytest.approx(2 * other.cost, rel=1e-9)
    covariance = 2 * other.cost / 10 * np.linalg.inv(other.jac.T @ other.jac)
    deviations = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(np.sqrt(np.diag(result.covariance_opk)), deviations, rtol=1e-4)
    correlation = covariance / np.outer(deviations, deviations)
    ours = result.covariance_opk / np.outer(deviations, deviations)
    np.testing.assert_allclose(ours, correlation, atol=2e-4)


def test_stated_covariance_is_the_scatter_of_repeated_measurement():
    points, centre, rotation = _scene(7, 10)
    exact = photo_from_object(points, centre, rotation, 152.0)
    rng = np.random.default_rng(11)
    squares = []
    for _ in range(200):
        result = resect(
            exact + rng.normal(0, 0.005, exact.shape), points, principal_distance=152.0, sigma=0.005,
            start=(centre, rotation),
        )  # fmt: skip
        offset = result.centre - centre
        squares.append(offset @ np.linalg.solve(result.summary.cofactor[:3, :3], offset))
    # Sum of 200 chi-squares of 3 degrees of freedom: mean 600, within the 99 % interval.
    assert 513 < np.sum(squares) < 694


def test_gross_errors_are_survived_by_the_robust_loss():
    points, centre, rotation = _scene(9, 14)
    rng = np.random.default_rng(5)
    image = photo_from_object(points, centre, rotation, 152.0) + rng.normal(0, 0.005, (14, 2))
    image[3] += [4.0, -2.0]
    image[8] += [-30.0, 12.0]
    robust = resect(
        image, points, principal_distance=152.0, sigma=0.005, options=AdjustmentOptions(loss="huber")
    )
    plain = resect(image, points, principal_distance=152.0, sigma=0.005)
    assert np.linalg.norm(robust.centre - centre) < 0.5
    assert np.linalg.norm(plain.centre - centre) > 5.0
    misfit = np.linalg.norm(robust.residuals, axis=1)
    assert set(np.argsort(misfit)[-2:]) == {3, 8}


def test_what_does_not_determine_an_orientation_is_said():
    points, centre, rotation = _scene(3, 6)
    image = photo_from_object(points, centre, rotation, 152.0)
    with pytest.raises(NotDeterminedError, match="4 points"):
        resect(image[:3], points[:3], principal_distance=152.0)
    line = points[0] + np.arange(6)[:, None] * [100.0, 30.0, 2.0]
    with pytest.raises(NotDeterminedError):
        resect(photo_from_object(line, centre, rotation, 152.0), line, principal_distance=152.0)
    with pytest.raises(InputError, match="shapes"):
        resect(image[:5], points)
    with pytest.raises(InputError, match="finite"):
        resect(image * np.nan, points)
    with pytest.raises(InputError, match="principal_distance"):
        resect(image, points, principal_distance=0.0)


def test_three_points_with_a_start_are_enough_and_claim_no_accuracy():
    points, centre, rotation = _scene(21, 3)
    image = photo_from_object(points, centre, rotation, 152.0)
    result = resect(image, points, principal_distance=152.0, start=(centre + 3.0, rotation))
    np.testing.assert_allclose(result.centre, centre, rtol=0, atol=1e-5)
    assert np.isnan(result.summary.sigma0)
