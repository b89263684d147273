"""Relative orientation without approximate values: any tilt, gross errors, undetermined geometry."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stereomate.errors import InputError, NotDeterminedError
from stereomate.geometry.rotations import rotation_from_vector
from stereomate.relative.coplanarity import adjust_coplanarity
from stereomate.relative.elements import dependent_elements
from stereomate.relative.minimal import five_point
from stereomate.relative.model import critical_cylinder, model_points
from stereomate.relative.orientation import RelativeOptions, relative_orientation
from stereomate.relative.overcorrection import overcorrection_factor
from stereomate.relative.pair import RelativePose, correspondences_from_photo
from stereomate.relative.robust import RobustOptions, robust_orientation

C = 1000.0


def project(points, pose):
    """Photo coordinates (units of C) of model points, and whether they are before both cameras."""
    seen = (points - pose.base) @ pose.left_from_right
    left, right = points[:, :2] / -points[:, 2:] * C, seen[:, :2] / -seen[:, 2:] * C
    return left, right, (points[:, 2] < -0.05) & (seen[:, 2] < -0.05)


def any_pose(rng, largest=3.1):
    axis = rng.normal(size=3)
    rotation = rotation_from_vector(axis / np.linalg.norm(axis) * rng.uniform(0.0, largest))
    base = rng.normal(size=3)
    return RelativePose(base / np.linalg.norm(base), rotation)


def converging_pair(rng, n, noise=0.0, relief=0.6):
    """Two cameras anywhere that look at one scene: tilts up to any angle."""
    points = rng.uniform(-1.0, 1.0, (n, 3)) * np.array([1.0, 1.0, relief])
    views = []
    for _ in range(2):
        centre = rng.normal(size=3)
        centre *= rng.uniform(4.0, 6.0) / np.linalg.norm(centre)
        z = centre / np.linalg.norm(centre)
        x = np.cross(rng.normal(size=3), z)
        x /= np.linalg.norm(x)
        views.append((centre, np.column_stack([x, np.cross(z, x), z])))
    (c1, r1), (c2, r2) = views
    pose = RelativePose.from_exterior(c1, r1, c2, r2)
    scale = np.linalg.norm(c2 - c1)
    left, right, _ = project((points - c1) @ r1 / scale, pose)
    return left + rng.normal(0, noise, left.shape), right + rng.normal(0, noise, right.shape), pose


def aerial_pair(rng, n, noise=0.5, wrong=0.0, relief=0.25):
    pose = RelativePose(
        np.array([1.0, 0.04, -0.03]) / np.linalg.norm([1.0, 0.04, -0.03]),
        rotation_from_vector(rng.normal(0.0, 0.05, 3)),
    )
    points = np.column_stack(
        [rng.uniform(-0.3, 1.3, n), rng.uniform(-0.9, 0.9, n), -rng.uniform(1.8 - relief, 1.8 + relief, n)]
    )
    left, right, _ = project(points, pose)
    left += rng.normal(0.0, noise, left.shape)
    right += rng.normal(0.0, noise, right.shape)
    bad = rng.permutation(n)[: int(n * wrong)]
    left[bad] = rng.uniform(-700.0, 700.0, (len(bad), 2))
    right[bad] = rng.uniform(-700.0, 700.0, (len(bad), 2))
    good = np.ones(n, dtype=bool)
    good[bad] = False
    return left, right, pose, good


@settings(deadline=None, max_examples=200)
@given(st.integers(0, 2**32 - 1))
def test_five_point_finds_the_true_orientation_for_any_tilt(seed):
    rng = np.random.default_rng(seed)
    left, right, pose = converging_pair(rng, 5)
    solutions = five_point(left / C, right / C)
    assert min((max(s.angles_to(pose)) for s in solutions), default=9.0) < 1e-3
    for solution in solutions:
        rays = [np.column_stack([p / C, -np.ones(5)]) for p in (left, right)]
        closures = np.einsum("ij,jk,ik->i", rays[0], solution.essential, rays[1])
        np.testing.assert_allclose(closures, 0.0, atol=1e-6)


def test_five_point_accuracy():
    rng = np.random.default_rng(0)
    errors = []
    for _ in range(500):
        left, right, pose = converging_pair(rng, 5)
        errors.append(min((max(s.angles_to(pose)) for s in five_point(left / C, right / C)), default=9.0))
    assert np.median(errors) < 1e-12
    assert np.percentile(errors, 98) < 1e-7


def test_five_point_agrees_with_opencv():
    cv2 = pytest.importorskip("cv2")
    rng = np.random.default_rng(3)
    flip = np.diag([1.0, -1.0, -1.0])
    for _ in range(20):
        left, right, _ = converging_pair(rng, 5)
        down = np.array([1.0, -1.0])
        theirs = cv2.findEssentialMat(right * down / C, left * down / C, np.eye(3), method=cv2.RANSAC)[0]
        theirs = [flip @ m @ flip for m in theirs.reshape(-1, 3, 3)] if theirs is not None else []
        ours = [s.essential for s in five_point(left / C, right / C, in_front=0)]
        for matrix in theirs:
            matrix = matrix / np.linalg.norm(matrix) * math.sqrt(2.0)
            distance = min(
                min(np.abs(matrix - e).max(), np.abs(matrix + e).max()) for e in [*ours, np.full((3, 3), 9.0)]
            )
            assert distance < 1e-4


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_any_tilt_with_gross_errors(seed):
    rng = np.random.default_rng(seed)
    left, right, pose = converging_pair(rng, 120, noise=0.3)
    wrong = rng.permutation(120)[:40]
    right[wrong] += rng.normal(0.0, 80.0, (40, 2))
    result = relative_orientation(correspondences_from_photo(left, right, C, 0.3))
    turn, tilt = result.pose.angles_to(pose)
    if result.determined:
        deviation = math.sqrt(float(np.linalg.eigvalsh(result.adjustment.covariance)[-1]))
        assert max(turn, tilt) < 7.0 * deviation + 1e-6


@pytest.mark.parametrize("wrong", [0.0, 0.2, 0.5])
def test_search_is_near_the_statistical_optimum(wrong):
    """Mean errors against least squares over the true points, paired over seeds; `make bench` does 200."""
    ours, best = [], []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        left, right, pose, good = aerial_pair(rng, 1000, wrong=wrong)
        c = correspondences_from_photo(left, right, C, 0.5)
        result = relative_orientation(c)
        assert result.determined
        ours.append(result.pose.angles_to(pose))
        best.append(adjust_coplanarity(c, pose, use=good).pose.angles_to(pose))
    ratio = np.mean(ours, axis=0) / np.mean(best, axis=0)
    assert (ratio < 1.12).all()


def test_same_seed_same_result_and_other_seeds_nearly():
    rng = np.random.default_rng(5)
    left, right, pose, _ = aerial_pair(rng, 3000, wrong=0.4)
    c = correspondences_from_photo(left, right, C, 0.5)
    first, again = (robust_orientation(c, RobustOptions(seed=7)) for _ in range(2))
    np.testing.assert_array_equal(first.pose.base, again.pose.base)
    np.testing.assert_array_equal(first.inliers, again.inliers)
    results = [relative_orientation(c, RelativeOptions(search=RobustOptions(seed=s))) for s in range(4)]
    assert max(max(r.pose.angles_to(results[0].pose)) for r in results) < 2e-4
    assert np.isfinite([r.sigma0 for r in results]).all()
    assert max(results[0].pose.angles_to(pose)) < 1e-3


def test_noise_larger_and_smaller_than_stated():
    for noise in (0.1, 1.2):
        rng = np.random.default_rng(11)
        left, right, pose, good = aerial_pair(rng, 2000, noise=noise, wrong=0.3)
        result = relative_orientation(correspondences_from_photo(left, right, C, 0.5))
        assert result.sigma0 == pytest.approx(noise / 0.5, rel=0.06)
        assert np.mean(result.used[good]) > 0.985
        assert max(result.pose.angles_to(pose)) < 2e-3 * noise


def test_random_matches_are_no_orientation():
    for seed in range(4):
        rng = np.random.default_rng(seed)
        left, right = rng.uniform(-600.0, 600.0, (2, 40 + 60 * seed, 2))
        result = relative_orientation(correspondences_from_photo(left, right, C, 0.5))
        assert not result.determined
        assert "agree on no orientation" in result.reasons[0]
        with pytest.raises(NotDeterminedError, match="agree on no orientation"):
            result.dependent()


def test_pure_rotation_has_no_base():
    rng = np.random.default_rng(2)
    rotation = rotation_from_vector([0.02, 0.05, -0.1])
    left = rng.uniform(-500.0, 500.0, (200, 2))
    turned = np.column_stack([left / C, -np.ones(200)]) @ rotation
    right = turned[:, :2] / -turned[:, 2:] * C
    left += rng.normal(0.0, 0.3, right.shape)
    right += rng.normal(0.0, 0.3, right.shape)
    result = relative_orientation(correspondences_from_photo(left, right, C, 0.3))
    assert not result.determined
    assert any("no parallax" in reason for reason in result.reasons)
    assert result.diagnosis.parallax_ratio == pytest.approx(1.0, abs=0.25)


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_points_on_one_line(noise):
    rng = np.random.default_rng(4)
    pose = RelativePose(np.array([1.0, 0.0, 0.0]), rotation_from_vector([0.01, 0.02, 0.03]))
    t = rng.uniform(-1.0, 1.0, 60)
    points = np.column_stack([0.5 + 0.8 * t, 0.6 * t, -2.0 + 0.2 * t])
    left, right, _ = project(points, pose)
    left += rng.normal(0.0, noise, left.shape)
    right += rng.normal(0.0, noise, right.shape)
    try:
        result = relative_orientation(correspondences_from_photo(left, right, C, 0.3))
    except NotDeterminedError:
        return
    assert not result.determined
    with pytest.raises(NotDeterminedError):
        result.independent()


def test_vertical_pair_over_a_plane_is_resolved_by_cheirality():
    for seed in range(10):
        rng = np.random.default_rng(seed)
        left, right, pose, _ = aerial_pair(rng, 400, noise=0.5, relief=0.0)
        result = relative_orientation(correspondences_from_photo(left, right, C, 0.5))
        assert result.determined, result.reasons
        assert result.diagnosis.planar
        deviation = math.sqrt(float(np.linalg.eigvalsh(result.adjustment.covariance)[-1]))
        assert max(result.pose.angles_to(pose)) < 5.0 * deviation


def orientations_of_plane(pose, normal, distance):
    """All orientations whose homography of the plane n·X = d is that of this one, by OpenCV's closed form."""
    import cv2

    # OpenCV's cameras look along +z with y down.
    turn = np.diag([1.0, -1.0, -1.0])
    homography = pose.left_from_right.T @ (np.eye(3) - np.outer(pose.base, normal) / distance)
    _, rotations, translations, _ = cv2.decomposeHomographyMat(turn @ homography @ turn, np.eye(3))
    found = []
    for rotation, translation in zip(rotations, translations, strict=True):
        left_from_right = turn @ rotation.T @ turn
        base = -turn @ rotation.T @ translation[:, 0]
        found.append(RelativePose(base / np.linalg.norm(base), left_from_right))
    return found


def test_plane_seen_obliquely_may_have_two_solutions_and_says_so():
    """A camera moving towards a wall: both decompositions of the homography have the points in front."""
    rng = np.random.default_rng(6)
    pose = RelativePose(
        np.array([0.35, 0.1, -0.93]) / np.linalg.norm([0.35, 0.1, -0.93]),
        rotation_from_vector([0.05, -0.1, 0.02]),
    )
    normal = np.array([0.25, 0.1, -0.96])
    normal /= np.linalg.norm(normal)
    rays = np.column_stack([rng.uniform(-0.35, 0.35, (150, 2)), -np.ones(150)])
    points = rays * (3.0 / (rays @ normal))[:, None]
    left, right, front = project(points, pose)
    assert front.all()
    left += rng.normal(0.0, 0.2, left.shape)
    right += rng.normal(0.0, 0.2, right.shape)
    result = relative_orientation(correspondences_from_photo(left, right, C, 0.2))
    assert not result.determined
    assert "plane" in result.reasons[0]
    both = [result.pose, *result.diagnosis.alternatives]
    assert min(max(p.angles_to(pose)) for p in both) < 0.02
    others = orientations_of_plane(pose, normal, 3.0)
    assert min(max(o.angles_to(pose)) for o in others) < 1e-6
    other = [o for o in others if max(o.angles_to(pose)) > 0.05]
    assert min(max(p.angles_to(o)) for p in both for o in other) < 0.02


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_critical_cylinder_is_never_a_silent_wrong_orientation(seed):
    """Points on the circular cylinder through the base: no factor exists, the tilt is not determined."""
    rng = np.random.default_rng(seed)
    radius = rng.uniform(0.9, 1.6)
    angle = rng.uniform(-0.6, 0.6, 80)
    # Circle through the axis of the base: centre below it.
    points = np.column_stack(
        [rng.uniform(0.0, 1.0, 80), radius * np.sin(2.0 * angle), -radius * (1.0 + np.cos(2.0 * angle))]
    )
    pose = RelativePose(np.array([1.0, 0.0, 0.0]), np.eye(3))
    left, right, _ = project(points, pose)
    left += rng.normal(0.0, 0.2, left.shape)
    right += rng.normal(0.0, 0.2, right.shape)
    section = np.column_stack([points[:3, 1], -points[:3, 2]])
    assert not abs(overcorrection_factor(section)) < 1e6
    result = relative_orientation(correspondences_from_photo(left, right, C, 0.2))
    assert result.diagnosis is None or result.diagnosis.critical_cylinder.distance < 0.02
    assert not result.determined
    assert re.search("critical|do not determine|agree on no orientation", result.reasons[0])


def test_distance_from_the_critical_cylinder():
    angle = np.linspace(-0.5, 0.5, 40)
    on = np.column_stack([0.0 * angle, 1.2 * np.sin(2 * angle), 1.2 * (1 + np.cos(2 * angle))])
    circle = critical_cylinder(on)
    assert circle.radius == pytest.approx(1.2)
    np.testing.assert_allclose(circle.centre, [0.0, 1.2], atol=1e-12)
    assert circle.distance == pytest.approx(0.0, abs=1e-12)
    assert critical_cylinder(on * np.array([1, 1, 0]) + np.array([0, 0, 2.0])).distance > 0.01


def test_model_points_are_the_points():
    rng = np.random.default_rng(1)
    pose = RelativePose(np.array([0.0, 1.0, 0.0]), rotation_from_vector([0.0, 0.0, 0.1]))
    points = np.column_stack([rng.uniform(-0.5, 0.5, (20, 2)), -rng.uniform(1.5, 2.0, 20)])
    left, right, _ = project(points, pose)
    model = model_points(pose, correspondences_from_photo(left, right, C, 0.1))
    # Base along y, looking down: x = y of the camera, depth = -z, across = z × x.
    np.testing.assert_allclose(model[:, 0], points[:, 1], atol=1e-9)
    np.testing.assert_allclose(model[:, 2], -points[:, 2], atol=1e-9)
    np.testing.assert_allclose(np.abs(model[:, 1]), np.abs(points[:, 0]), atol=1e-9)


def test_five_and_six_points():
    rng = np.random.default_rng(8)
    left, right, pose, _ = aerial_pair(rng, 6, noise=0.0)
    six = relative_orientation(correspondences_from_photo(left, right, C, 0.5))
    assert max(six.pose.angles_to(pose)) < 1e-8
    five = relative_orientation(correspondences_from_photo(left[:5], right[:5], C, 0.5))
    assert math.isnan(five.sigma0)
    solutions = five_point(left[:5] / C, right[:5] / C)
    if len(solutions) > 1:
        assert not five.determined
        assert "satisfy the five points" in five.reasons[0]
    with pytest.raises(InputError, match="five points"):
        relative_orientation(correspondences_from_photo(left[:4], right[:4], C))


def test_points_behind_the_cameras_are_no_good_points():
    rng = np.random.default_rng(9)
    left, right, pose, _ = aerial_pair(rng, 300, noise=0.3)
    # Points of a scene behind: their rays meet, with negative distances.
    mirrored = np.column_stack([rng.uniform(-0.5, 1.5, 40), rng.uniform(-0.9, 0.9, 40), np.full(40, 1.5)])
    back_left, back_right, _ = project(mirrored, pose)
    result = relative_orientation(
        correspondences_from_photo(np.vstack([left, back_left]), np.vstack([right, back_right]), C, 0.3)
    )
    assert result.determined
    assert not result.used[300:].any()
    assert result.used[:300].mean() > 0.97


def test_all_points_the_same():
    same = np.full((30, 2), 12.0)
    try:
        result = relative_orientation(correspondences_from_photo(same, same, C, 0.3))
    except NotDeterminedError:
        return
    assert not result.determined


@pytest.mark.parametrize(
    "options",
    [{"limit_sigmas": -1.0}, {"confidence": 1.0}, {"least_samples": 0}, {"subset": 3}, {"seed": -1}],
)
def test_bad_options(options):
    with pytest.raises(InputError):
        RobustOptions(**options)


@pytest.mark.parametrize(("share", "wide"), [(0.0, 1.0), (0.05, 5.0), (0.12, 3.0)])
def test_standard_deviations_hold_whatever_is_cut_off(share, wide):
    """Points of real pairs have long tails: the cut must not flatter the noise, nor the elements."""
    errors, inside, scatter = [], [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        left, right, pose, _ = aerial_pair(rng, 400, noise=0.3)
        moving = rng.random(400) < share
        right[moving] += rng.normal(0.0, 0.3 * wide, (np.count_nonzero(moving), 2))
        search = RobustOptions(widening=1.0, seed=seed)
        result = relative_orientation(
            correspondences_from_photo(left, right, C, 0.3), RelativeOptions(search=search)
        )
        found = result.dependent()
        truth = dependent_elements(pose, np.eye(5))
        errors.append((found.values - truth.values) / found.standard_deviations)
        inside.append(result.sampson_rms)
        scatter.append(result.sampson_robust)
    # The rms of 60 times 5 normalised errors, correlated within a pair.
    assert 0.8 < float(np.sqrt(np.mean(np.square(errors)))) < 1.25
    # Not below the noise of the good points, not above that of all points together.
    everything = 0.3 * math.sqrt(1.0 + 0.5 * share * wide**2)
    assert 0.97 * 0.3 < np.mean(inside) < 1.03 * everything
    assert 0.97 * 0.3 < np.mean(scatter) < 1.03 * everything
