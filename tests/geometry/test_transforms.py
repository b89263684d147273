"""Plane and space transforms: inverses, composition, estimation, statistics."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stereomate.errors import InputError, NotDeterminedError
from stereomate.geometry.adjustment import AdjustmentOptions
from stereomate.geometry.rotations import rotation_angle, rotation_from_opk
from stereomate.geometry.similarity import SpaceTransform, estimate_space_transform
from stereomate.geometry.transforms import PlaneTransform, estimate_plane_transform

KINDS = ("similarity", "affine", "projective")
FIDUCIALS = np.array(
    [[-106, -106], [106, 106], [-106, 106], [106, -106], [-112, 0], [112, 0], [0, 112], [0, -112]], float
)


def _plane(kind: str, seed: int) -> PlaneTransform:
    rng = np.random.default_rng(seed)
    scale, turn = rng.uniform(10, 90), rng.uniform(-3, 3)
    a, b = scale * np.cos(turn), scale * np.sin(turn)
    m = np.array([[a, -b, rng.uniform(0, 9000)], [b, a, rng.uniform(0, 9000)], [0, 0, 1.0]])
    if kind != "similarity":
        m[:2, :2] += rng.uniform(-2, 2, (2, 2))
    if kind == "projective":
        m[2, :2] = rng.uniform(-2e-4, 2e-4, 2)
    return PlaneTransform.from_array(kind, m)


@settings(deadline=None, max_examples=40)
@given(st.sampled_from(KINDS), st.sampled_from(KINDS), st.integers(0, 10**6))
def test_plane_inverse_and_composition(first, second, seed):
    one, two = _plane(first, seed), _plane(second, seed + 1)
    np.testing.assert_allclose(one.inverse().apply(one.apply(FIDUCIALS)), FIDUCIALS, atol=1e-7)
    both = two.compose(one.inverse())
    np.testing.assert_allclose(both.apply(one.apply(FIDUCIALS)), two.apply(FIDUCIALS), rtol=1e-9, atol=1e-6)
    assert both.kind == max(first, second, key=KINDS.index)


@settings(deadline=None, max_examples=40)
@given(st.sampled_from(KINDS), st.integers(0, 10**6))
def test_exact_points_give_the_plane_transform_back(kind, seed):
    truth = _plane(kind, seed)
    estimate = estimate_plane_transform(kind, FIDUCIALS, truth.apply(FIDUCIALS))
    np.testing.assert_allclose(estimate.transform.matrix, truth.matrix, rtol=1e-8, atol=1e-8)
    assert np.abs(estimate.residuals).max() < 1e-8
    assert estimate.summary.redundancy == 16 - {"similarity": 4, "affine": 6, "projective": 8}[kind]
    assert estimate.summary.redundancy_numbers.sum() == pytest.approx(estimate.summary.redundancy)


@pytest.mark.parametrize("kind", KINDS)
def test_plane_covariance_is_the_scatter_of_repeated_measurement(kind):
    truth = _plane(kind, 5)
    rng = np.random.default_rng(6)
    exact = truth.apply(FIDUCIALS)
    given_out, total, unit = [], 0.0, 0.0
    for _ in range(150):
        estimate = estimate_plane_transform(kind, FIDUCIALS, exact + rng.normal(0, 0.3, exact.shape), 0.3)
        m = np.array(estimate.transform.matrix)
        vector = m[[0, 1, 0, 1], [0, 0, 2, 2]] if kind == "similarity" else m.reshape(-1)
        u = estimate.summary.cofactor.shape[0]
        t = np.array(truth.matrix)
        true_vector = t[[0, 1, 0, 1], [0, 0, 2, 2]] if kind == "similarity" else t.reshape(-1)
        given_out.append((vector - true_vector)[:u])
        total += given_out[-1] @ np.linalg.solve(estimate.summary.cofactor, given_out[-1])
        unit += estimate.summary.sigma0**2 / 150
    degrees = 150 * u
    assert abs(total - degrees) < 2.6 * np.sqrt(2 * degrees)
    assert abs(unit - 1.0) < 2.6 * np.sqrt(2 / (150 * (16 - u)))


def test_plane_angles_and_scales():
    # x axis of scale 2 turned by 10°, y axis of scale 3 turned by 12°: non-orthogonality -2°.
    x, y = np.radians([10.0, 12.0])
    m = [[2 * np.cos(x), -3 * np.sin(y), 5.0], [2 * np.sin(x), 3 * np.cos(y), 6.0]]
    transform = PlaneTransform.from_array("affine", m)
    assert transform.scales == pytest.approx((2.0, 3.0))
    assert np.degrees(transform.rotation) == pytest.approx(10.0)
    assert np.degrees(transform.non_orthogonality) == pytest.approx(-2.0)
    assert not transform.mirrored
    assert PlaneTransform.from_array("affine", [[1, 0, 0], [0, -1, 0]]).mirrored


def test_plane_robust_loss_survives_a_confused_mark():
    truth = _plane("affine", 8)
    target = truth.apply(FIDUCIALS) + np.random.default_rng(1).normal(0, 0.3, (8, 2))
    target[6] += [25.0, 0.0]
    plain = estimate_plane_transform("affine", FIDUCIALS, target, 0.3)
    robust = estimate_plane_transform(
        "affine", FIDUCIALS, target, 0.3, options=AdjustmentOptions(loss="huber", max_iterations=200)
    )
    good = np.arange(8) != 6
    worst = [
        np.abs(e.transform.apply(FIDUCIALS) - truth.apply(FIDUCIALS))[good].max() for e in (plain, robust)
    ]
    assert worst[1] < 0.4 * worst[0]
    assert np.argmax(np.abs(robust.residuals).max(axis=1)) == 6


def test_wrong_plane_input_is_refused():
    with pytest.raises(NotDeterminedError, match="3 points"):
        estimate_plane_transform("affine", FIDUCIALS[:2], FIDUCIALS[:2])
    line = np.array([[0.0, 0], [1, 1], [2, 2], [3, 3]])
    with pytest.raises(NotDeterminedError):
        estimate_plane_transform("affine", line, line)
    with pytest.raises(InputError, match="shape"):
        estimate_plane_transform("affine", FIDUCIALS, FIDUCIALS[:5])
    with pytest.raises(InputError, match="finite"):
        estimate_plane_transform("affine", FIDUCIALS, FIDUCIALS * np.nan)
    with pytest.raises(InputError, match="sigma"):
        estimate_plane_transform("affine", FIDUCIALS, FIDUCIALS, 0.0)
    with pytest.raises(InputError, match="similarity, affine or projective"):
        estimate_plane_transform("polynomial", FIDUCIALS, FIDUCIALS)
    with pytest.raises(InputError, match="invertible"):
        PlaneTransform.from_array("affine", [[1, 2, 0], [2, 4, 0]])
    with pytest.raises(InputError, match="row"):
        PlaneTransform("affine", ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.1, 0.0, 1.0)))


def _space(seed: int, rigid: bool) -> SpaceTransform:
    rng = np.random.default_rng(seed)
    rotation = rotation_from_opk(rng.uniform([-3, -1.5, -3], [3, 1.5, 3]))
    return SpaceTransform.from_arrays(
        rotation, rng.uniform(-1e6, 1e6, 3), 1.0 if rigid else rng.uniform(0.01, 50)
    )


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10**6), st.booleans(), st.integers(3, 20))
def test_exact_points_give_the_space_transform_back(seed, rigid, n):
    truth = _space(seed, rigid)
    rng = np.random.default_rng(seed)
    source = rng.uniform(-500, 500, (n, 3)) * [1, 1, 0.1]
    if np.linalg.svd(source - source.mean(axis=0), compute_uv=False)[1] < 100:
        return
    target = truth.apply(source)
    estimate = estimate_space_transform(source, target, rigid=rigid)
    assert np.abs(estimate.residuals).max() < 1e-6
    assert rotation_angle(np.array(estimate.transform.rotation).T @ truth.rotation) < 1e-8
    assert estimate.transform.scale == pytest.approx(truth.scale, rel=1e-9)
    np.testing.assert_allclose(truth.inverse().apply(target), source, atol=1e-4)
    back = truth.compose(estimate.transform.inverse())
    np.testing.assert_allclose(back.apply(target), target, atol=1e-4)


def test_points_in_a_plane_are_enough_and_never_mirrored():
    source = np.array([[0.0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 12, 0]])
    truth = _space(3, False)
    estimate = estimate_space_transform(source, truth.apply(source))
    assert np.linalg.det(estimate.transform.rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(estimate.transform.apply([5, 5, 5]), truth.apply([5, 5, 5]), atol=1e-6)


def test_space_statistics_with_weights_per_axis():
    truth = _space(4, False)
    rng = np.random.default_rng(8)
    source = rng.uniform(-500, 500, (12, 3)) * [1, 1, 0.1]
    sigma = np.broadcast_to([0.02, 0.02, 0.08], (12, 3)).copy()
    sigma[3] = 5.0
    exact = truth.apply(source)
    total = unit = 0.0
    for _ in range(150):
        estimate = estimate_space_transform(source, exact + rng.normal(0, sigma), sigma=sigma)
        left = np.array(estimate.transform.rotation) @ np.array(truth.rotation).T
        error = np.array(
            [
                *(estimate.transform.apply(source.mean(axis=0)) - truth.apply(source.mean(axis=0))),
                left[2, 1], left[0, 2], left[1, 0],
                np.log(estimate.transform.scale / truth.scale),
            ]
        )  # fmt: skip
        total += error @ np.linalg.solve(estimate.summary.cofactor, error)
        unit += estimate.summary.sigma0**2 / 150
    assert abs(total - 1050) < 2.6 * np.sqrt(2100)
    assert abs(unit - 1.0) < 2.6 * np.sqrt(2 / (150 * 29))


def test_space_robust_loss_survives_a_third_of_gross_errors():
    truth = _space(5, False)
    rng = np.random.default_rng(9)
    source = rng.uniform(-500, 500, (15, 3))
    target = truth.apply(source) + rng.normal(0, 0.02, (15, 3))
    target[[1, 4, 7, 10, 13]] += rng.uniform(-300, 300, (5, 3))
    options = AdjustmentOptions(loss="huber", max_iterations=300)
    robust = estimate_space_transform(source, target, sigma=0.02, options=options)
    assert np.abs(robust.transform.apply(source) - truth.apply(source)).max() < 0.25
    bad = np.argsort(np.linalg.norm(robust.residuals, axis=1))[-5:]
    assert set(bad) == {1, 4, 7, 10, 13}


def test_wrong_space_input_is_refused():
    source = np.eye(3)
    with pytest.raises(NotDeterminedError, match="3 points"):
        estimate_space_transform(source[:2], source[:2])
    line = np.arange(5.0)[:, None] * [1.0, 2.0, 3.0]
    with pytest.raises(NotDeterminedError, match="line"):
        estimate_space_transform(line, line)
    with pytest.raises(InputError, match="sigma"):
        estimate_space_transform(source, source, sigma=-1.0)
    with pytest.raises(InputError, match="rotation"):
        SpaceTransform.from_arrays(np.diag([1.0, 1.0, -1.0]), [0, 0, 0])
    with pytest.raises(InputError, match="scale"):
        SpaceTransform.from_arrays(np.eye(3), [0, 0, 0], 0.0)
    with pytest.raises(InputError, match="translation"):
        SpaceTransform.from_arrays(np.eye(3), [0, np.nan, 0])
