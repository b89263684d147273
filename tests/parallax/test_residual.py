"""Residual parallaxes and homogeneity: golden vectors, the paper's table, independent ray tracing."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stereomate.errors import InputError
from stereomate.parallax.homogeneity import (
    PAPER_CASES,
    TableCase,
    error_vectors_mm,
    homogeneity,
    homogeneity_table,
    ideal_parallax_mm,
)
from stereomate.parallax.laws import ParallaxLaw
from stereomate.parallax.residual import residual_parallax

# Table 1 as printed (t_x, t_y in percent). The cell (210, 0, point 4) is unreadable in the scan.
PRINTED = [
    (5.41, [2.3, -19.3, -0.4, 12.7, -35.7, -12.7], [0, 0, -14.5, 72.4, 34.5, -10.1]),
    (4.84, [1.7, -18.9, -0.5, 9.6, -34.7, -12.5], [0, 0, -14.1, 67.0, 32.9, -9.9]),
    (2.85, [0.9, -18.6, -0.2, 5.6, -34.6, -11.8], [0, 0, -13.9, 63.4, 31.8, -9.7]),
    (0.93, [0.3, -18.3, 0.1, 1.7, -34.6, -11.3], [0, 0, -13.7, 60.1, 30.8, -9.7]),
    (4.38, [1.4, -18.5, -0.5, 7.8, -33.9, -12.1], [0, 0, -13.8, 63.2, 31.7, -9.7]),
    (4.24, [1.0, -11.8, -0.2, 3.4, -15.9, -9.3], [0, 0, -9.4, 21.1, 15.2, -7.5]),
    (3.79, [0.8, -11.6, -0.3, np.nan, -15.7, -9.2], [0, 0, -9.2, np.nan, 14.8, -7.4]),
    (3.43, [0.7, -11.5, -0.3, 2.3, -15.6, -9.1], [0, 0, -9.1, 19.9, 14.5, -7.3]),
]
# The same, computed by others with 0.01.
RECOMPUTED = [
    (5.412, [2.26, -19.27, -0.33, 12.64, -35.71, -12.68], [0, 0, -14.48, 72.36, 34.51, -10.10]),
    (4.842, [1.72, -18.82, -0.40, 9.72, -34.68, -12.37], [0, 0, -14.08, 67.05, 32.88, -9.88]),
    (2.845, [1.01, -18.51, -0.23, 5.55, -34.68, -11.83], [0, 0, -13.89, 63.41, 31.82, -9.80]),
    (0.929, [0.33, -18.20, -0.08, 1.77, -34.69, -11.31], [0, 0, -13.69, 60.12, 30.83, -9.71]),
    (4.381, [1.36, -18.46, -0.43, 7.80, -33.85, -12.11], [0, 0, -13.77, 63.23, 31.66, -9.71]),
    (4.235, [1.03, -11.76, -0.19, 3.37, -15.84, -9.34], [0, 0, -9.42, 21.14, 15.20, -7.52]),
    (3.789, [0.81, -11.61, -0.24, 2.77, -15.70, -9.17], [0, 0, -9.25, 20.48, 14.81, -7.40]),
    (3.429, [0.65, -11.48, -0.26, 2.35, -15.57, -9.03], [0, 0, -9.11, 19.97, 14.51, -7.31]),
]


def law_of(values: dict) -> ParallaxLaw:
    return ParallaxLaw(values["law"], values["law_base_m"], values["w0_m"])


def test_golden_plane_vectors(golden) -> None:
    cases = golden("stereo_plane_vectors.json")["cases"]
    assert len(cases) >= 10
    for case in cases:
        values, expected = case["input"], case["expected"]
        found = residual_parallax(
            [values["X_T_m"], values["Y_T_m"], values["w_T_m"]],
            values["base_m"],
            np.tan(np.radians([values["slope_x_deg"], values["slope_y_deg"]])),
            values["object_height_m"],
            law_of(values),
            values["h_T_m"],
        )
        assert found.mu_left == pytest.approx(expected["mu_left"], abs=1e-12)
        assert found.mu_right == pytest.approx(expected["mu_right"], abs=1e-12)
        for value, name in (
            (found.ortho_m, "dp_ortho_m"),
            (found.ground_left_m, "dh_ATL_m"),
            (found.ground_right_m, "dh_ATR_m"),
            (found.artificial_m, "dq_m"),
            (found.stereo_m, "dp_s_m"),
        ):
            np.testing.assert_allclose(value, expected[name], rtol=0, atol=1e-8)
        # the ideal parallax along the rows is the first component of the golden vector
        assert found.ideal_m == pytest.approx(expected["dp_ideal_vector_m"][0], abs=1e-8)


def test_golden_block(golden) -> None:
    """Objects in models whose bases differ from the nominal one, on level ground and on slopes."""
    data = golden("stereo_block.json")
    block = data["block"]
    w0, rows = block["w0_m"], block["rows_direction_deg_from_east_ccw"]
    flat = 0
    for case in data["cases"]:
        values, model = case["input"], block["models"][case["model"]]
        delta = np.radians(model["direction_deg_from_east_ccw"] - rows)
        base = (model["base_m"] * np.cos(delta), model["base_m"] * np.sin(delta), model["Bz_m"])
        ground = (values.get("X_T_m", 123.0), values.get("Y_T_m", -77.0), w0 - values["h_T_m"])
        slope = np.tan(np.radians([values.get("slope_x_deg", 0.0), values.get("slope_y_deg", 0.0)]))
        flat += case["kind"] == "flat"
        for kind, expected in case["expected"].items():
            law = ParallaxLaw(kind, block["law_base_m"], w0)
            found = residual_parallax(ground, base, slope, values["object_height_m"], law)
            terrain = float(law.q(values["h_T_m"]))
            assert terrain == pytest.approx(expected["terrain_parallax_m"], abs=1e-9)
            assert found.stereo_m[0] == pytest.approx(expected["object_dp_x_m"], abs=1e-9)
            assert found.stereo_m[1] == pytest.approx(expected["object_dp_y_m"], abs=1e-9)
            read = float(law.inverse(terrain + found.stereo_m[0])) - values["h_T_m"]
            assert read == pytest.approx(expected["height_read_m"], abs=1e-8)
    assert flat >= 6


def test_table_1() -> None:
    rows = homogeneity_table()
    assert len(rows) == len(PRINTED) == len(RECOMPUTED) == 8
    for row, printed, recomputed in zip(rows, PRINTED, RECOMPUTED, strict=True):
        assert row.ideal_mm == pytest.approx(printed[0], abs=0.006)
        assert row.ideal_mm == pytest.approx(recomputed[0], abs=0.0006)
        np.testing.assert_allclose(100 * row.t_x, recomputed[1], rtol=0, atol=0.01)
        np.testing.assert_allclose(100 * row.t_y, recomputed[2], rtol=0, atol=0.01)
        readable = np.isfinite(printed[1])
        assert np.abs(100 * row.t_x - printed[1])[readable].max() <= 0.18
        assert np.abs(100 * row.t_y - printed[2])[readable].max() <= 0.10


laws = st.sampled_from(["logarithmic", "linear", "natural", "none"])


@given(
    laws,
    st.floats(-120, 120),
    st.floats(-120, 120),
    st.floats(80, 300),
    st.floats(20, 120),
    st.floats(-0.3, 0.3),
    st.floats(0.001, 0.2),
    st.floats(-40, 40),
    st.floats(-40, 40),
)
@settings(deadline=None, max_examples=200)
def test_relative_form_is_the_vector_form(law, x, y, c, b, d, gk, slope_x, slope_y) -> None:
    """Photo coordinates and ratios against metres: two derivations of one thing."""
    w0 = 1700.0
    t_x, t_y = homogeneity(x, y, c, b, d, gk, slope_x, slope_y, law)
    base = b * w0 / c
    depth = w0 * (1 - d)
    found = residual_parallax(
        [x * depth / c, y * depth / c, depth],
        [base, 0.0, 0.0],
        np.tan(np.radians([slope_x, slope_y])),
        gk * w0,
        ParallaxLaw(law, base, w0),
    )
    expected = found.relaxation
    if np.isnan(expected[0]):
        assert np.isnan(t_x)
    else:
        scale = 1.0 + np.abs(expected).max()
        assert t_x == pytest.approx(expected[0], abs=1e-10 * scale**2)
        assert t_y == pytest.approx(expected[1], abs=1e-10 * scale**2)


@given(st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=100)
def test_vector_form_against_rays_and_planes(seed: int) -> None:
    """The two rays of A are intersected with the plane by vectors; nothing of the formulas is used."""
    rng = np.random.default_rng(seed)
    ground = np.array([*rng.uniform(-900, 900, 2), rng.uniform(900, 2000)])
    base = np.array([rng.uniform(400, 1200), *rng.uniform(-150, 150, 2)])
    tangents = np.tan(np.radians(rng.uniform(-25, 25, 2)))
    dh = rng.uniform(1, 60)
    law = ParallaxLaw(rng.choice(["linear", "logarithmic", "natural"]), 900.0, 1500.0, 350.0)
    level = rng.uniform(-150, 150)
    foot = ground * (1, 1, -1)
    top = foot + np.array([0, 0, dh])
    normal = np.array([-tangents[0], -tangents[1], 1.0])
    hits, reach = [], []
    for centre in (np.zeros(3), base):
        ray = top - centre
        reach.append((normal @ (foot - centre)) / (normal @ ray))
        hits.append(centre + ray * reach[-1])
    found = residual_parallax(ground, base, tangents, dh, law, level)
    if (
        min(reach) < 1.0
    ):  # the plane is met above A or behind the camera: the object is below the ground there
        assert np.isnan(found.stereo_m).all()
        return
    np.testing.assert_allclose(found.ortho_m, (hits[0] - hits[1])[:2], atol=1e-8)
    right_u = hits[1][0] - law.q(350.0 + level + hits[1][2] - foot[2])
    foot_u = foot[0] - law.q(350.0 + level)
    assert found.stereo_m[0] == pytest.approx(hits[0][0] - right_u - (foot[0] - foot_u), abs=1e-8)


def test_level_ground_is_homogeneous_for_low_objects_and_the_logarithmic_law() -> None:
    t_x, t_y = homogeneity(30.0, 20.0, 152.0, 92.0, [-0.1, 0.0, 0.1], 0.05, 0.0, 0.0)
    np.testing.assert_allclose([t_x, t_y], 0.0, atol=1e-12)
    # without longitudinal slope only the height of the object disturbs
    t_x, t_y = homogeneity(30.0, 20.0, 152.0, 92.0, 0.0, 1e-9, 0.0, 25.0)
    np.testing.assert_allclose([t_x, t_y], 0.0, atol=1e-7)


def test_limit_of_low_objects() -> None:
    for law in ("logarithmic", "linear", "natural", "none"):
        limit = homogeneity(40.0, -30.0, 152.0, 92.0, 0.05, 0.0, 20.0, 30.0, law)
        near = homogeneity(40.0, -30.0, 152.0, 92.0, 0.05, 1e-7, 20.0, 30.0, law)
        np.testing.assert_allclose(limit, near, atol=1e-5)


def test_broadcasting_and_misses() -> None:
    x = np.linspace(0, 92, 5)[:, None]
    y = np.linspace(-80, 80, 4)
    t_x, t_y = homogeneity(x, y, 152.0, 92.0, 0.0, 0.05, 20.0, 30.0)
    assert t_x.shape == t_y.shape == (5, 4)
    # the ground falls away from the ray faster than the ray comes down
    assert np.isnan(homogeneity(0.0, -110.0, 152.0, 92.0, 0.0, 0.05, 20.0, 56.0)[0])
    assert np.isnan(
        residual_parallax(
            [0, -1000, 1000], [600, 0, 0], [0, 2.0], 30.0, ParallaxLaw("none", 600, 1000)
        ).stereo_m
    ).all()


def test_level_ground_closed_forms_of_bz() -> None:
    """t_x = -Bz/(Z'+Bz) (1 - X_T/Bx), t_y = Bz Y_T / (Bx (Z'+Bz)) on level ground."""
    ground, dh, bz = np.array([300.0, -200.0, 1500.0]), 20.0, 25.0
    found = residual_parallax(
        ground, [900.0, 0.0, bz], [0.0, 0.0], dh, ParallaxLaw("logarithmic", 900.0, 1500.0)
    )
    z = 1500.0 - dh
    assert found.relaxation[0] == pytest.approx(-bz / (z + bz) * (1 - 300.0 / 900.0), abs=1e-12)
    assert found.relaxation[1] == pytest.approx(bz * -200.0 / (900.0 * (z + bz)), abs=1e-12)


def test_error_vectors_to_scale() -> None:
    case = PAPER_CASES[1]
    vectors = error_vectors_mm(case, case.points_mm, (20.0, 30.0), "logarithmic", 10.0)
    row = homogeneity_table([case])[0]
    np.testing.assert_allclose(vectors, np.column_stack([row.t_x, row.t_y]) * row.ideal_mm * 10.0, rtol=1e-12)
    assert ideal_parallax_mm(92.0, 0.0, 0.05) == pytest.approx(row.ideal_mm)
    other = TableCase(300.0, 230.0, 0.0, 0.05)
    assert np.abs(homogeneity_table([other])[0].t_x).max() < np.abs(row.t_x).max()


@pytest.mark.parametrize(
    "arguments, message",
    [
        ((0, 0, 152, 92, 0, 0.05, 0, 0, "cubic"), "law: must be one of"),
        ((0, 0, 0, 92, 0, 0.05, 0, 0), "principal_distance_mm: must be positive"),
        ((0, 0, 152, [92, -1], 0, 0.05, 0, 0), "base_mm: must be positive, got -1"),
    ],
)
def test_bad_input(arguments, message: str) -> None:
    with pytest.raises(InputError, match=message):
        homogeneity(*arguments)
