"""Predictions: the tables of the theory page by the package's own simulation."""

import numpy as np
import pytest

from stereomate.errors import CrsError, InputError, OrientationError
from stereomate.frames.curvature import CurvatureOptions
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.prediction.plan import FlightPlan, simulated_block, simulated_pair
from stereomate.frames.prediction.predict import error_map, predict
from stereomate.frames.prediction.simulate import GridWork, direct_outcome, indirect_outcome

GK = "+proj=tmerc +lat_0=0 +lon_0=9 +k=1 +x_0=500000 +y_0=0 +ellps=bessel +units=m"
UTM = "+proj=tmerc +lat_0=0 +lon_0=9 +k=0.9996 +x_0=500000 +y_0=0 +ellps=GRS80 +units=m"
SITES = {
    "GK+2": (GK, 11.0, 48.0),
    "GK+1.5": (GK, 10.5, 48.0),
    "GK+3": (GK, 12.0, 48.0),
    "GK CM": (GK, 9.0, 48.0),
    "UTM CM": (UTM, 9.0, 48.0),
    "UTM+3.5": (UTM, 12.5, 48.0),
    "L93 51N": ("EPSG:2154", 3.0, 51.0),
    "Corsica": ("EPSG:2154", 9.2, 41.6),
}


def plan_at(site, height, **extra):
    crs, lon, lat = SITES[site]
    x, y, _ = MapFrame(crs, HeightSystem.ellipsoidal()).map_from_geodetic((lon, lat, 0.0))
    return FlightPlan(crs, float(x), float(y), height, **extra)


def direct(plan, method, curvature=None):
    return direct_outcome(GridWork(plan, simulated_pair(plan), curvature), method)


@pytest.mark.parametrize(
    ("site", "height", "error"),
    [
        ("GK+2", 100.0, -0.027), ("GK+2", 1500.0, -0.410), ("GK+2", 6000.0, -1.641), ("GK+3", 1500.0, -0.923),
        ("UTM CM", 1500.0, 0.600), ("UTM+3.5", 3000.0, -1.313), ("Corsica", 500.0, -1.314),
        ("Corsica", 6000.0, -15.763),
    ],
)  # fmt: skip
def test_curvature_correction_alone(site, height, error):
    """Theory, "P1 only", dZ at the model centre."""
    plan = plan_at(site, height)
    found = direct(plan, "P1").centre_error[2]
    assert found == pytest.approx(error, abs=6e-4 + 2e-4 * abs(error))


@pytest.mark.parametrize(
    ("site", "ground", "error"),
    [
        ("GK CM", 1000.0, 0.2348), ("GK CM", 2000.0, 0.4694), ("GK+1.5", 0.0, -0.2308),
        ("GK+1.5", 1000.0, 0.0039),
        ("GK+2", 1000.0, -0.1756), ("GK+2", 2000.0, 0.0592), ("UTM CM", 1000.0, 0.8346),
        ("UTM CM", 2000.0, 1.0692), ("L93 51N", 0.0, -3.2922), ("L93 51N", 2000.0, -2.8219),
    ],
)  # fmt: skip
def test_height_of_the_ground(site, ground, error):
    """Theory, section 2: the effective scale, by simulation, and equation (4') beside it."""
    plan = plan_at(site, 1500.0, ground_m=ground)
    found = direct(plan, "P1").centre_error[2]
    assert found == pytest.approx(error, abs=2e-4)
    assert found == pytest.approx(-(plan.tau_e - 1.0) * 1500.0, abs=1e-3)


def test_doing_nothing_adds_the_bend_of_the_earth():
    plan = plan_at("GK+2", 1500.0)
    outcome = direct(plan, "nothing")
    assert outcome.centre_error[2] == pytest.approx(-0.427, abs=5e-4)
    assert outcome.worst_height_m == pytest.approx(-0.565, abs=5e-3)


@pytest.mark.parametrize(
    ("site", "height", "up_mm", "plan_mm"),
    [
        ("GK CM", 1500.0, 0.1, 0.0),
        ("GK+2", 1500.0, 0.3, 2.8),
        ("GK+2", 6000.0, 6.7, 44.0),
        ("L93 51N", 3000.0, 82.0, 40.0),
    ],
)
def test_what_m2_leaves(site, height, up_mm, plan_mm):
    """Theory, "Remaining errors": P3 inside the image."""
    outcome = direct(plan_at(site, height), "M2")
    assert 1e3 * abs(outcome.worst_height_m) == pytest.approx(up_mm, rel=0.05, abs=0.06)
    assert 1e3 * outcome.worst_plan_m == pytest.approx(plan_mm, rel=0.05, abs=0.06)


def test_m3_fails_for_tilted_photographs_and_m2_does_not():
    plan = plan_at("GK+2", 1500.0, tilt_deg=4.5)
    assert abs(direct(plan, "M2").worst_height_m) < 5e-4
    assert abs(direct(plan, "M3").worst_height_m) > 0.02


def test_rigorous_ways_are_right_everywhere():
    for site, height in (("Corsica", 6000.0), ("UTM+3.5", 100.0)):
        plan = plan_at(site, height, ground_m=300.0, relief_m=0.3 * height, tilt_deg=4.0)
        for method in ("M1", "M4"):
            outcome = direct(plan, method)
            assert np.abs(outcome.errors).max() < 1e-7


@pytest.mark.parametrize("index", range(4))
def test_the_golden_indirect_blocks(golden, index):
    """Five by three photographs on three by five control points, c fixed, exact curvature correction."""
    data = golden("georef_indirect.json")
    case = data["cases"][index]
    site = {"GK+2.0": "GK+2", "UTM CM": "UTM CM"}[case["site"]]
    assert (SITES[site][1], SITES[site][2]) == (case["lon"], case["lat"])
    plan = plan_at(site, case["H"], ground_m=case["hg"], relief_m=case["hill"])
    block = simulated_block(plan)
    assert len(block.centres) == 15
    assert block.control.sum() == 15
    work = GridWork(plan, block, CurvatureOptions(plan.radius_m, "sphere", "ellipsoid"))
    outcome = indirect_outcome(work, "P1")
    hills = work.truth[~block.control, 2] > case["hg"] + 1.0
    assert hills.sum() > 20
    assert outcome.centres_up_m == pytest.approx(case["prc_shift_mean"], abs=data["tolerance_m"])
    assert outcome.errors[hills, 2].mean() == pytest.approx(case["hill_dz_mean"], abs=data["tolerance_m"])


@pytest.mark.parametrize(("site", "c"), [("GK+2", 149.9590), ("UTM CM", 150.0600), ("L93 51N", 149.6715)])
def test_a_free_principal_distance_takes_the_scale(site, c):
    """Theory, section 4: with GNSS centres c becomes c / tau_e, to 1e-4 mm."""
    plan = plan_at(site, 1500.0)
    outcome = indirect_outcome(GridWork(plan, simulated_block(plan)), "P1", free=True)
    assert outcome.principal_distance_mm == pytest.approx(c, abs=3e-4)
    assert abs(outcome.centres_up_m) < 1e-3


def test_the_example_of_the_paper():
    """41 cm and 5.5 cm, and what they are against 0.06 per mille."""
    plan = plan_at("GK+2", 1500.0, relief_m=200.0)
    prediction = predict(plan, curvature=CurvatureOptions(plan.radius_m, "sphere", "ellipsoid"))
    assert len(prediction.outcomes) == 21
    assert prediction.expected_m == pytest.approx(0.09)
    assert prediction.equation_2_m == pytest.approx(0.4104, abs=5e-5)
    assert prediction.equation_3_m == pytest.approx(0.0547, abs=5e-5)
    assert prediction.equation_4_m == pytest.approx(-0.4104, abs=5e-5)
    p1 = prediction.outcome("direct", "P1")
    assert p1.centre_error[2] == pytest.approx(prediction.equation_4_m, abs=5e-4)
    fixed = prediction.outcome("indirect", "P1")
    assert fixed.centres_up_m == pytest.approx(prediction.equation_2_m, abs=5e-4)
    assert fixed.worst_height_m == pytest.approx(prediction.equation_3_m, abs=4e-3)
    assert not prediction.harmless(p1)
    for free in (False, True):
        for method in ("M1", "M4"):
            outcome = prediction.outcome("indirect", method, free=free)
            assert np.abs(outcome.errors).max() < 1e-6
            assert prediction.harmless(outcome)
    assert prediction.harmless(prediction.outcome("direct", "M2"))
    words = " ".join(prediction.words())
    assert "0.410 m too low" in words
    assert "4.6 times the 0.090 m" in words
    assert "M2, M3, M3i, M4, M1." in words


@pytest.mark.slow
def test_relief_under_the_classical_correction():
    """Distances stay at each point's height: control at another height forces its scale on hills."""
    plan = plan_at("GK+2", 1500.0, relief_m=200.0)
    prediction = predict(plan)
    assert prediction.equation_3_m == pytest.approx(0.0547 + 200.0 / plan.radius_m * 1300.0, abs=1e-4)
    assert prediction.outcome("indirect", "P1").worst_height_m == pytest.approx(
        prediction.equation_3_m, abs=5e-3
    )


def test_map_of_errors():
    plan = plan_at("UTM CM", 1500.0)
    chart = error_map(plan, 15)
    assert chart.height_error_m.shape == (15, 15)
    # Along the central meridian the scale is 0.9996 and points come out 0.6 m too high.
    assert chart.height_error_m[:, 7] == pytest.approx(0.6, abs=1e-9)
    assert chart.longitude_deg[0, 7] == pytest.approx(9.0)
    assert chart.height_error_m[0, 0] < 0.6
    assert np.isfinite(error_map(plan_at("Corsica", 1500.0), 10).height_error_m).all()


def test_narrow_sidelap_relief_and_tilt():
    """Points that one photograph alone sees once left the normal matrix singular."""
    plan = plan_at(
        "Corsica", 3000.0, ground_m=500.0, relief_m=800.0, tilt_deg=3.0, sidelap=0.2, heading_deg=30.0
    )
    work = GridWork(plan, simulated_block(plan))
    assert np.bincount(work.block.point_of).min() >= 2
    for method in ("M1", "M4"):
        assert np.abs(indirect_outcome(work, method).errors).max() < 1e-6
    assert abs(indirect_outcome(work, "P1").worst_height_m) > 0.1


def test_plans_that_cannot_be_adjusted():
    with pytest.raises(InputError, match="above the horizon"):
        simulated_pair(plan_at("UTM CM", 800.0, principal_distance_mm=8.0, tilt_deg=19.0))
    with pytest.raises(InputError, match="no point that two photographs see"):
        simulated_block(plan_at("UTM CM", 800.0, principal_distance_mm=305.0, format_mm=13.0, tilt_deg=19.0))
    apart = plan_at("GK+2", 3000.0, overlap=0.05, sidelap=0.3)
    with pytest.raises(OrientationError, match="more overlap"):
        indirect_outcome(GridWork(apart, simulated_block(apart)), "nothing")


def test_plans_that_cannot_be_flown():
    with pytest.raises(CrsError, match="conformal"):
        FlightPlan("EPSG:3035", 4e6, 3e6, 1500.0)
    with pytest.raises(CrsError, match="they would lie inside with x and y exchanged"):
        FlightPlan("EPSG:2154", 6_050_000.0, 1_240_000.0, 1500.0)
    for field, value in (("overlap", 1.0), ("sidelap", 0.0), ("relief_m", 1400.0), ("tilt_deg", 60.0),
                         ("principal_distance_mm", 0.0)):  # fmt: skip
        with pytest.raises(InputError, match=field):
            plan_at("UTM CM", 1500.0, **{field: value})
