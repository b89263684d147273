"""Exact points on the golden scene: analytic terrain, tilted cameras, traced by others to 1e-12."""

from __future__ import annotations

import numpy as np
import pytest
from golden_scene import AnalyticSurface, centres_of, law_of

from stereomate.stereo.exact import (
    ground_of_orthophoto,
    ground_of_stereomate,
    intersect_grounds,
    orientation_jacobians,
)

LAWS = ("linear", "logarithmic", "natural")


@pytest.fixture(scope="module")
def scene(golden):
    return golden("stereo_scene.json")


@pytest.fixture(scope="module")
def seen(golden):
    cases = golden("stereo_terrain_pair.json")["cases"]
    kept = [c for c in cases if not (c["hidden_left"] or c["hidden_right"])]
    assert len(kept) > 80
    return kept


def column(cases, *path):
    def pick(case):
        for key in path:
            case = case[key]
        return case

    return np.array([pick(case) for case in cases])


def reconstruct(scene, surface, law, left_uv, right_uv, sigma=0.045):
    left, right = ground_of_orthophoto(surface, left_uv), ground_of_stereomate(surface, law, right_uv)
    return left, right, intersect_grounds(left, right, centres_of(scene, len(left_uv)), 4 * (sigma,))


@pytest.mark.parametrize("kind", LAWS)
def test_exact_reconstruction(scene, seen, kind):
    """Points come back from product coordinates to a micrometre, for every law; and what the law reads."""
    surface, law = AnalyticSurface(scene), law_of(scene, kind)
    left_uv = column(seen, "product", "orthophoto_uv_m")
    right_uv = column(seen, "product", f"stereomate_{kind}_uv_m")
    left, right, exact = reconstruct(scene, surface, law, left_uv, right_uv)
    np.testing.assert_allclose(left.points, column(seen, "first_hit_left_m"), atol=1e-6)
    np.testing.assert_allclose(right.points, column(seen, "first_hit_right_m"), atol=1e-6)
    np.testing.assert_allclose(exact.points, column(seen, "input", "A_m"), atol=1e-6)
    assert exact.miss.max() < 1e-6
    read = law.inverse(left_uv[:, 0] - right_uv[:, 0])
    np.testing.assert_allclose(read, column(seen, "law_reading", kind, "Z_m"), atol=1e-6)
    np.testing.assert_allclose(
        left_uv[:, 1] - right_uv[:, 1], column(seen, "product", "y_parallax_m"), atol=1e-9
    )


@pytest.mark.parametrize("kind", LAWS)
def test_exact_with_a_wrong_height_model(scene, seen, kind):
    """Shifted by 10 m and tilted by 2 degrees: the law's heights are falsified, the exact ones are not."""
    surface, law = AnalyticSurface(scene, wrong=True), law_of(scene, kind)
    left_uv = column(seen, "wrong_model", "orthophoto_uv_m")
    right_uv = column(seen, "wrong_model", f"stereomate_{kind}_uv_m")
    left, right, exact = reconstruct(scene, surface, law, left_uv, right_uv)
    np.testing.assert_allclose(left.points, column(seen, "wrong_model", "ground_left_m"), atol=1e-6)
    np.testing.assert_allclose(right.points, column(seen, "wrong_model", "ground_right_m"), atol=1e-6)
    truth = column(seen, "input", "A_m")
    np.testing.assert_allclose(exact.points, truth, atol=1e-6)
    read = law.inverse(left_uv[:, 0] - right_uv[:, 0])
    np.testing.assert_allclose(read, column(seen, "wrong_model", f"law_reading_{kind}_Z_m"), atol=1e-6)
    assert np.abs(read - truth[:, 2]).max() > 1.0


@pytest.fixture(scope="module")
def noise(golden, seen):
    by_id = {c["id"]: c for c in golden("stereo_noise.json")["cases"] if not c["hidden"]}
    return [(c, by_id[c["id"]]) for c in seen if c["id"] in by_id]


@pytest.mark.parametrize("kind", LAWS)
def test_covariance(scene, noise, kind):
    """Noise through the whole chain: slope of the ground, inversion of the row, the best estimate."""
    assert len(noise) > 80
    cases, expected = [c for c, _ in noise], [n for _, n in noise]
    surface, law = AnalyticSurface(scene), law_of(scene, kind)
    _, _, exact = reconstruct(
        scene,
        surface,
        law,
        column(cases, "product", "orthophoto_uv_m"),
        column(cases, "product", f"stereomate_{kind}_uv_m"),
    )
    sigma = np.sqrt(np.einsum("nii->ni", exact.covariance))
    if kind == "logarithmic":
        np.testing.assert_allclose(sigma, column(expected, "sigma_ENZ_m"), rtol=1e-6)
        np.testing.assert_allclose(
            exact.covariance, column(expected, "covariance_ENZ_m2"), rtol=1e-5, atol=1e-9
        )
        np.testing.assert_allclose(exact.check, column(expected, "check_vector_product"), atol=1e-6)
    else:
        np.testing.assert_allclose(sigma, column(expected, "sigma_ENZ_m_other_laws", kind), rtol=1e-6)


def test_the_estimate_is_as_good_as_its_covariance(scene, seen):
    """Simulated: errors over their covariance, and the one residual, follow chi-square."""
    surface, law = AnalyticSurface(scene), law_of(scene, "logarithmic")
    calm = [c for c in seen if c["kind"] != "ridge"]
    left = column(calm, "product", "orthophoto_uv_m")
    right = column(calm, "product", "stereomate_logarithmic_uv_m")
    truth = column(calm, "input", "A_m")
    rng, sigma = np.random.default_rng(11), 0.045
    forms, tests = [], []
    for _ in range(40):
        noisy = [uv + sigma * rng.standard_normal(uv.shape) for uv in (left, right)]
        exact = reconstruct(scene, surface, law, *noisy)[2]
        error = exact.points - truth
        forms.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(exact.covariance), error))
        tests.append(exact.standardized)
    forms, tests = np.array(forms), np.array(tests)
    # means of chi-square over n draws: 3 +- sqrt(6/n), 1 +- sqrt(2/n)
    assert abs(forms.mean() - 3.0) < 3.0 * np.sqrt(6.0 / forms.size)
    assert abs((tests**2).mean() - 1.0) < 3.0 * np.sqrt(2.0 / tests.size)


def test_orientation_jacobians(scene, seen):
    """Against central differences: the same pixels, read with another orientation."""
    surface, law = AnalyticSurface(scene), law_of(scene, "linear")
    cases = seen[:20]
    left, right, exact = reconstruct(
        scene,
        surface,
        law,
        column(cases, "product", "orthophoto_uv_m"),
        column(cases, "product", "stereomate_linear_uv_m"),
    )
    centres, sigma = centres_of(scene, len(cases)), 4 * (0.045,)
    analytic = orientation_jacobians(exact, centres, sigma)
    for side in range(2):
        for k in range(6):
            step = 1e-3 if k < 3 else 1e-6
            moved = []
            for sign in (1.0, -1.0):
                # true = used + step: the point that the used orientation makes of true pixels. A true point
                # whose images are where they are lies on rays moved by the step; the estimate stays, so
                # estimate minus truth is minus the change of the true point.
                grounds, at = [left, right], list(centres)
                ray = grounds[side].points - at[side]
                if k < 3:
                    shift = sign * step * np.eye(3)[k]
                    at[side] = at[side] + shift
                    points = grounds[side].points + shift
                else:
                    points = grounds[side].points + sign * step * np.cross(np.eye(3)[k - 3], ray)
                grounds[side] = type(left)(
                    grounds[side].uvh, points, grounds[side].jacobian, grounds[side].steepness,
                    grounds[side].branches,
                )  # fmt: skip
                moved.append(intersect_grounds(*grounds, tuple(at), sigma).points)
            numeric = -(moved[0] - moved[1]) / (2.0 * step)
            scale = np.abs(numeric).max()
            np.testing.assert_allclose(analytic[side][:, :, k], numeric, atol=2e-5 * scale)
