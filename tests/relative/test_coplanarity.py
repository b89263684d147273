"""The rigorous relative orientation: elements, covariance, statistics, Kasper's formula (4)."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from stereomate.errors import InputError, NotDeterminedError
from stereomate.geometry.rotations import rotation_from_opk
from stereomate.relative.coplanarity import CoplanarityOptions, adjust_coplanarity
from stereomate.relative.elements import (
    dependent_elements,
    independent_elements,
    pose_from_dependent,
    pose_from_independent,
)
from stereomate.relative.kernels.pose import move, tangents
from stereomate.relative.orientation import relative_orientation
from stereomate.relative.pair import Correspondences, RelativePose, correspondences_from_photo
from stereomate.relative.snooping import SnoopingOptions, snoop

C = 150.0


def made_pair(n: int, sigma_mm: float, seed: int, opk=(0.02, -0.03, 0.04), base=(1.0, 0.03, -0.02)):
    """Photo coordinates (mm) of n points of rugged terrain, with noise, and the true pose."""
    rng = np.random.default_rng(seed)
    direction = np.array(base) / np.linalg.norm(base)
    rotation = rotation_from_opk(opk)
    points = np.column_stack(
        [rng.uniform(-0.2, 1.2, n), rng.uniform(-1.0, 1.0, n), -rng.uniform(1.3, 1.9, n)]
    )
    left = points[:, :2] / -points[:, 2:] * C
    seen = (points - direction) @ rotation
    right = seen[:, :2] / -seen[:, 2:] * C
    noise = rng.normal(0.0, sigma_mm, (2, n, 2))
    return left + noise[0], right + noise[1], RelativePose(direction, rotation)


@settings(deadline=None, max_examples=40)
@given(st.lists(st.floats(-0.9, 0.9), min_size=5, max_size=5), st.floats(0.5, 200.0))
def test_elements_and_their_jacobians(values, bx):
    pose = pose_from_dependent(*values)
    moves = np.empty((2, 3))
    tangents(np.array(pose.base), moves)
    for elements in (lambda p, c: dependent_elements(p, c, bx), independent_elements):
        jacobian = np.empty((5, 5))
        for k in range(5):
            ends = []
            for sign in (1e-6, -1e-6):
                base, rotation = np.array(pose.base), np.array(pose.left_from_right)
                move(base, rotation, moves, np.eye(5)[k] * sign)
                ends.append(elements(RelativePose(base, rotation), np.eye(5)).values)
            jacobian[:, k] = (ends[0] - ends[1]) / 2e-6
        covariance = elements(pose, np.eye(5)).covariance
        np.testing.assert_allclose(covariance, jacobian @ jacobian.T, rtol=1e-6, atol=1e-8 * covariance.max())
    dependent = dependent_elements(pose, np.eye(5), bx)
    assert max(pose_from_dependent(*dependent.values, bx=bx).angles_to(pose)) < 1e-12
    independent = independent_elements(pose, np.eye(5))
    assert max(pose_from_independent(*independent.values).angles_to(pose)) < 1e-12


def test_a_base_backwards_keeps_its_sign():
    pose = pose_from_dependent(0.1, -0.2, 0.01, 0.02, 3.0, bx=-1.0)
    elements = dependent_elements(pose, np.eye(5), 92.0)
    np.testing.assert_allclose(elements.values[:2], [9.2, -18.4])
    np.testing.assert_allclose(elements.values[2:], [0.01, 0.02, 3.0])


def test_estimate_is_the_minimum_over_points_and_elements_together():
    """Against a bundle adjustment of the same pair: unknown points, all four coordinates, scipy."""
    left, right, truth = made_pair(12, 0.02, 1)
    result = adjust_coplanarity(correspondences_from_photo(left, right, C, 0.02), truth)

    def residuals(x):
        pose = pose_from_independent(*x[:5])
        points = x[5:].reshape(-1, 3)
        seen = (points - pose.base) @ pose.left_from_right
        return np.concatenate(
            [
                (left + points[:, :2] / points[:, 2:] * C).ravel(),
                (right + seen[:, :2] / seen[:, 2:] * C).ravel(),
            ]
        )

    rays = np.column_stack([left / C, -np.ones(len(left))])
    start = np.concatenate([independent_elements(truth, np.eye(5)).values, (rays * 1.6).ravel()])
    bundle = least_squares(residuals, start, method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    independent = result.independent()
    np.testing.assert_allclose(independent.values, bundle.x[:5], atol=1e-9)
    # Square sum and residuals of the coordinates are those of the bundle too.
    assert 2 * bundle.cost / 0.02**2 == pytest.approx(result.sigma0**2 * result.redundancy, rel=1e-7)
    ours = result.points().residuals
    np.testing.assert_allclose(
        np.abs(ours[:, :2]), np.abs(residuals(bundle.x)[: 2 * len(left)].reshape(-1, 2)), atol=1e-7
    )
    normal = bundle.jac.T @ bundle.jac / 0.02**2
    covariance = np.linalg.inv(normal)[:5, :5] * result.sigma0**2
    np.testing.assert_allclose(independent.covariance, covariance, rtol=2e-3)


def test_covariance_and_redundancy_against_simulation():
    estimates, sigmas, tests = [], [], []
    for seed in range(200):
        rng = np.random.default_rng(1000 + seed)
        clean_left, clean_right, truth = made_pair(30, 0.0, 5)
        left = clean_left + rng.normal(0.0, 0.01, clean_left.shape)
        right = clean_right + rng.normal(0.0, 0.01, clean_right.shape)
        result = adjust_coplanarity(correspondences_from_photo(left, right, C, 0.01), truth)
        estimates.append(result.independent().values)
        sigmas.append(result.sigma0**2)
        tests.append(result.points().standardized)
        assert result.points().redundancy.sum() == pytest.approx(25.0)
    predicted = np.sqrt(np.diag(result.independent().covariance)) / result.sigma0
    # 200 draws: the standard deviation of a standard deviation is 5 %.
    np.testing.assert_allclose(np.std(estimates, axis=0), predicted, rtol=0.18)
    assert np.mean(sigmas) == pytest.approx(1.0, abs=4.0 * math.sqrt(2.0 / 25.0 / 200.0))
    assert np.std(tests) == pytest.approx(1.0, abs=0.03)
    np.testing.assert_allclose(
        np.mean(estimates, axis=0) - independent_elements(truth, np.eye(5)).values,
        0.0,
        atol=4.0 * predicted.max() / math.sqrt(200.0),
    )


def test_coordinate_redundancies_add_up_to_those_of_the_points():
    left, right, truth = made_pair(20, 0.01, 3)
    points = adjust_coplanarity(correspondences_from_photo(left, right, C, 0.01), truth).points()
    np.testing.assert_allclose(points.coordinate_redundancy.sum(axis=1), points.redundancy)
    assert (points.redundancy > 0.0).all()
    assert (points.redundancy < 1.0).all()


def test_y_parallax_is_left_minus_right_and_found_at_its_size():
    left, right, truth = made_pair(40, 0.0, 4, opk=(0, 0, 0), base=(1, 0, 0))
    left[7, 1] += 0.1
    use = np.arange(40) != 7
    result = adjust_coplanarity(correspondences_from_photo(left, right, C, 0.005), truth, use=use)
    points = result.points()
    assert points.y_parallax[7] == pytest.approx(0.1, rel=1e-4)
    assert np.abs(points.y_parallax[use]).max() < 1e-9


def test_minimal_detectable_error_is_detected_with_its_power():
    """An error of that size in y moves the test value by delta0 = 4.13 on average."""
    clean_left, clean_right, truth = made_pair(15, 0.0, 6, opk=(0, 0, 0), base=(1, 0, 0))
    base_result = adjust_coplanarity(correspondences_from_photo(clean_left, clean_right, C, 0.01), truth)
    size = base_result.points().minimal_detectable[4]
    values = []
    for seed in range(300):
        rng = np.random.default_rng(seed)
        left = clean_left + rng.normal(0.0, 0.01, clean_left.shape)
        right = clean_right + rng.normal(0.0, 0.01, clean_right.shape)
        left[4, 1] += size
        result = adjust_coplanarity(correspondences_from_photo(left, right, C, 0.01), truth)
        values.append(result.points().standardized[4])
    options = CoplanarityOptions()
    assert options.noncentrality == pytest.approx(4.13, abs=0.005)
    assert np.mean(values) == pytest.approx(options.noncentrality, abs=0.25)
    found = np.mean(np.abs(values) > options.critical)
    assert found == pytest.approx(options.power, abs=0.08)


@pytest.mark.parametrize("variance", ["prior", "estimated"])
def test_snooping_finds_the_gross_errors_and_only_these(variance):
    false = 0
    for seed in range(8, 14):
        left, right, truth = made_pair(30, 0.01, seed)
        left[3, 1] += 0.3
        right[20, 1] -= 0.5
        adjusted = adjust_coplanarity(correspondences_from_photo(left, right, C, 0.01), truth)
        clean, rejected = snoop(adjusted, SnoopingOptions(variance=variance))
        points = {r.point for r in rejected}
        assert {3, 20} <= points
        assert rejected[0].point == 20
        assert clean.sigma0 < 1.6
        false += len(points) - 2
    # 168 good points at one in a thousand.
    assert false <= 1


@pytest.mark.parametrize("loss", ["huber", "tukey"])
def test_losses_lessen_the_pull_of_a_gross_error(loss):
    left, right, truth = made_pair(60, 0.01, 9)
    left[5, 1] += 1.0
    c = correspondences_from_photo(left, right, C, 0.01)
    plain = adjust_coplanarity(c, truth)
    robust = adjust_coplanarity(c, truth, CoplanarityOptions(loss=loss))
    assert max(robust.pose.angles_to(truth)) < 0.5 * max(plain.pose.angles_to(truth))
    assert robust.weights[5] < 0.1


def test_weights_act_as_repeated_points():
    left, right, truth = made_pair(10, 0.01, 10)
    weights = np.ones(10)
    weights[2] = 3.0
    weighted = adjust_coplanarity(correspondences_from_photo(left, right, C, 0.01, weights), truth)
    rows = [*range(10), 2, 2]
    repeated = adjust_coplanarity(correspondences_from_photo(left[rows], right[rows], C, 0.01), truth)
    assert max(weighted.pose.angles_to(repeated.pose)) < 1e-12
    np.testing.assert_allclose(weighted.cofactor, repeated.cofactor, rtol=1e-9)


def test_reproduces_kasper_4_with_three_points_of_a_section():
    """Five points: three in the section under the left projector, small parallaxes; omega is formula (4)."""
    z, y3, y5, h3, h5 = 1.0, 0.55, -0.48, 0.05, 0.17
    places = np.array(
        [[0.0, 0.0, -z], [0.0, y3, -(z - h3)], [0.0, y5, -(z - h5)], [0.6, 0.5, -0.9], [0.6, -0.4, -1.05]]
    )
    left = places[:, :2] / -places[:, 2:]
    seen = places - np.array([0.6, 0.0, 0.0])
    right = seen[:, :2] / -seen[:, 2:]
    parallax = np.array([2e-7, -3e-7, 5e-7])
    # p = y(left) - y(right) in the model; in the image it is smaller by the depth.
    right = right.copy()
    right[:3, 1] -= parallax / -places[:3, 2]
    c = correspondences_from_photo(left * C, right * C, C)
    result = adjust_coplanarity(c, pose_from_dependent(0, 0, 0, 0, 0, bx=0.6))
    p1, p3, p5 = parallax
    z3, z5 = z - h3, z - h5
    d = y5 - y3 - (z5 / y5 * h5 - z3 / y3 * h3)
    by_formula = ((p5 - p1) * z5 / y5 - (p3 - p1) * z3 / y3) / d
    # Turning the right camera by omega moves its rays by K omega: that must make up for left minus right.
    assert result.dependent(0.6)["omega"] == pytest.approx(by_formula, rel=1e-5)


@pytest.mark.real
def test_equal_conditions_reproduce_the_published_film_orientation(data_folder: Path):
    folder = data_folder / "houston_film" / "photo-lab3" / "data"
    left = np.loadtxt(folder / "image_27_given.txt")[:, 1:]
    right = np.loadtxt(folder / "image_28_given.txt")[:, 1:]
    c = correspondences_from_photo(left, right, 153.358, 0.005)
    textbook = relative_orientation(c)
    options = CoplanarityOptions(conditions="equal")
    elements = adjust_coplanarity(c, textbook.pose, options).dependent(92.0)
    assert [f"{v:.3f}" for v in elements.values[:2]] == ["-1.422", "-1.287"]
    assert [f"{v:.5f}" for v in np.degrees(elements.values[2:])] == ["-0.97723", "0.27326", "-1.72863"]
    # The rigorous weights differ in the last digits only.
    np.testing.assert_allclose(textbook.dependent(92.0).values, elements.values, rtol=2e-4)


@pytest.mark.real
def test_published_film_model_from_the_chain_of_corrections(data_folder: Path):
    """Comparator, affine, principal point, lens, refraction: the stated chain, then the orientation."""
    folder = data_folder / "houston_film" / "photo-lab3" / "data"
    affine = {
        27: (0.0118994263, 2.998e-7, -1.3405e-6, 0.0119012647, -122.0170, 123.5343),
        28: (0.0119000883, -8.4564e-6, 7.4035e-6, 0.0119010331, -122.1921, 123.5180),
    }
    photo = {}
    for number, (a, b, c, d, tx, ty) in affine.items():
        column, row = np.loadtxt(folder / f"image_{number}_obs.txt")[:, 1:].T
        fiducial = np.column_stack([tx + a * column + b * row, ty + c * column + d * row])
        printed = np.loadtxt(folder / f"image_{number}_fid.txt")[:, 1:]
        # The published affine has few digits: 18000 px times its last digit is 2 micrometres.
        np.testing.assert_allclose(fiducial, printed, atol=0.002)
        photo[number] = film_corrections(printed)
        corrected = np.loadtxt(folder / f"image_{number}_corrected.txt")[:, 1:]
        np.testing.assert_allclose(photo[number], corrected, atol=2e-5)
    c = correspondences_from_photo(photo[27], photo[28], 153.358, 0.005)
    result = relative_orientation(c)
    published = np.array([-1.422, -1.287, *np.radians([-0.97723, 0.27326, -1.72863])])
    # The publication measured other values (1-3 micrometres away): within its standard deviations.
    deviation = np.sqrt(np.diag(result.dependent(92.0).covariance))
    assert (np.abs(result.dependent(92.0).values - published) < 2.0 * deviation).all()


def film_corrections(fiducial: np.ndarray) -> np.ndarray:
    c, k0, k1, k2, p1, p2 = 153.358, 0.8878e-4, -0.1528e-7, 0.5256e-12, 0.1346e-6, 0.1224e-7
    flying, ground = 1.860, 1.100
    k = 1e-6 * (
        2410.0 * flying / (flying**2 - 6.0 * flying + 250.0)
        - 2410.0 * ground / (ground**2 - 6.0 * ground + 250.0) * (ground / flying)
    )
    point = fiducial - np.array([-0.006, 0.006])
    x, y = point.T
    r2 = x * x + y * y
    radial = k0 + k1 * r2 + k2 * r2 * r2
    refraction = k * (1.0 + r2 / c**2)
    dx = -x * radial - (p1 * (r2 + 2.0 * x * x) + 2.0 * p2 * x * y) - x * refraction
    dy = -y * radial - (p2 * (r2 + 2.0 * y * y) + 2.0 * p1 * x * y) - y * refraction
    return np.column_stack([x + dx, y + dy])


def test_asking_for_elements_that_do_not_exist():
    straight_down = RelativePose(np.array([0.0, 0.0, 1.0]), np.eye(3))
    with pytest.raises(NotDeterminedError, match="bx"):
        dependent_elements(straight_down, np.eye(5))
    with pytest.raises(NotDeterminedError, match="kappa1"):
        independent_elements(straight_down, np.eye(5))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda p: p.__setitem__((3, 1), math.nan), "finite"),
        (lambda p: p.__imul__(60.0), "pixels"),
    ],
)
def test_bad_coordinates_are_named(change, words):
    left, right, _ = made_pair(10, 0.0, 1)
    change(right)
    with pytest.raises(InputError, match=f"right_mm.*{words}|{words}.*right_mm"):
        correspondences_from_photo(left, right, C)


def test_bad_input_of_the_core():
    left, right, pose = made_pair(10, 0.0, 1)
    with pytest.raises(InputError, match="five points"):
        adjust_coplanarity(correspondences_from_photo(left[:4], right[:4], C), pose)
    with pytest.raises(InputError, match="shape"):
        correspondences_from_photo(left.ravel(), right, C)
    with pytest.raises(InputError, match="rows"):
        correspondences_from_photo(left[:6], right, C)
    with pytest.raises(InputError, match="positive"):
        correspondences_from_photo(left, right, -C)
    with pytest.raises(InputError, match="weights"):
        correspondences_from_photo(left, right, C, weights=np.full(10, -1.0))
    good = correspondences_from_photo(left, right, C)
    with pytest.raises(InputError, match="definite"):
        Correspondences(good.left, good.right, np.zeros((1, 3)), good.right_covariance, (C, C), "mm")
    with pytest.raises(InputError, match="unit vector"):
        RelativePose(np.array([2.0, 0.0, 0.0]), np.eye(3))
