"""The paper's equations and tables."""

import numpy as np
import pytest

from stereomate.frames.prediction.equations import (
    block_width_m,
    centre_height_shift,
    curvature_deformation,
    direct_point_error,
    indirect_point_error,
    m3_height_limit_mm,
    m3_planar_limit_mm,
)


@pytest.fixture(scope="module")
def tables(golden):
    return golden("georef_paper_tables.json")


def test_table_5(tables):
    """Limits of c for M3 with tilts of 5 and 3 gon: 10 µm in the image, 0.1 per mille of the height."""
    table, tilts = tables["table5"], (np.deg2rad(4.5), np.deg2rad(2.7))
    for k, tau in enumerate(table["tau"]):
        planar = m3_planar_limit_mm(tau, *tilts, 0.010)
        height = m3_height_limit_mm(tau, *tilts, 1e-4, 110.0)
        assert planar == pytest.approx(table["planar_mm"][k], rel=1e-10)
        assert height == pytest.approx(table["height_mm"][k], rel=1e-10)
        # The paper prints tau to 1e-5, a half of which is up to 3 % of these.
        for found, printed in ((planar, "planar"), (height, "height")):
            value = table["paper"][printed][k]
            if isinstance(value, int):
                assert abs(found - value) <= max(1.0, 0.5e-5 / abs(tau - 1.0) * value)


def test_table_6(tables):
    table = tables["table6"]
    for x, linear, printed in zip(table["X_km"], table["linear_km"], table["paper_km"], strict=True):
        width = block_width_m(1000.0 * x, 0.06e-3, 1000.0 * table["R_km"]) / 1000.0
        assert width == pytest.approx(linear, rel=1e-12)
        assert int(width + 0.5) == printed or int(width) == printed  # the paper truncates some


def test_the_example_of_the_paper(tables):
    """Flying height 1500 m, 2 degrees from the meridian: 41 cm; points 200 m above the control: 5.5 cm."""
    case = tables["eq2_eq3_eq4"][0]
    assert centre_height_shift(case["tau"], 1500.0, 0.0) == pytest.approx(case["dH"], abs=1e-12)
    assert indirect_point_error(case["tau"], 200.0, 0.0) == pytest.approx(case["dH200"], abs=1e-12)
    assert direct_point_error(case["tau"], 0.0, 1500.0) == pytest.approx(-case["dH"], abs=1e-12)
    assert centre_height_shift(case["tau"], 1500.0, 0.0) == pytest.approx(0.41, abs=0.005)
    assert indirect_point_error(case["tau"], 200.0, 0.0) == pytest.approx(0.055, abs=0.0005)


def test_equations_2_and_3_against_the_simulated_blocks(golden):
    data = golden("georef_indirect.json")
    assert data["tolerance_m"] == 0.002
    for case in data["cases"]:
        shift = centre_height_shift(case["tau"], case["hg"] + case["H"], case["hg"])
        assert shift == pytest.approx(case["eq2"], abs=1e-9)
        assert shift == pytest.approx(case["prc_shift_mean"], abs=0.002)
        error = indirect_point_error(case["tau"], case["hg"] + case["hill"], case["hg"])
        assert error == pytest.approx(case["eq3"], abs=1e-9)
        assert error == pytest.approx(case["hill_dz_mean"], abs=0.002)


@pytest.mark.parametrize(
    ("height", "centre", "corner"), [(1500, -0.0166, -0.154), (3000, -0.066, -0.616), (6000, -0.265, -2.467)]
)
def test_deformation_without_curvature_correction(height, centre, corner):
    """The numbers of the theory page: a 60 % pair, c 150 mm, 230 mm format, the corner at 105.8 mm."""
    base = 0.4 * 0.230 / 0.150 * height
    assert curvature_deformation(base / 2, base, 0.0, 6.38e6) == pytest.approx(centre, abs=6e-4)
    across = 0.1058 / 0.150 * height
    assert curvature_deformation(0.0, base, across, 6.38e6) == pytest.approx(corner, rel=0.003)
