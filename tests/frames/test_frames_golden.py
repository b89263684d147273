"""The golden rotations: factors, geocentric and tangent coordinates."""

import numpy as np
import pytest

from stereomate.frames.factors import grid_axes, grid_factors, grid_factors_geodetic
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame, geocentric_from_geodetic, geodetic_from_geocentric
from stereomate.frames.transform import map_from_tangent, tangent_from_map


@pytest.fixture(scope="module")
def cases(golden):
    return golden("georef_rotations.json")["cases"]


def test_points_and_factors_of_all_cases(cases):
    assert len(cases) == 8
    for case in cases:
        frame = MapFrame(f"EPSG:{case['epsg']}", HeightSystem.ellipsoidal())
        geodetic = (case["lon_deg"], case["lat_deg"], case["h_m"])
        xyz = frame.map_from_geodetic(geodetic)
        native = np.array(case["native_xy"])
        # PROJ's always_xy exchanges (north, east) pairs and nothing else.
        expected = native[::-1] if case["native_axes"] == ["north", "east"] else native
        np.testing.assert_allclose(xyz[:2], expected, rtol=0, atol=2e-9)
        tau, gamma = grid_factors(frame.crs, xyz[0], xyz[1])
        # The golden tau itself is stated to 2.8e-11, gamma to 1.6e-12.
        assert abs(tau - case["tau"]) < 1e-10
        assert abs(gamma - case["gamma_rad"]) < 1e-10
        again = grid_factors_geodetic(frame.crs, geodetic[0], geodetic[1])
        np.testing.assert_allclose(again, (tau, gamma), rtol=0, atol=1e-12)

        datum = frame.geodetic
        ecef = geocentric_from_geodetic(geodetic, datum.semi_major_m, datum.flattening)
        np.testing.assert_allclose(ecef, case["prc_ecef_m"], rtol=0, atol=2e-9)
        lat0, lon0, h0 = case["lsr_origin"]
        tangent = TangentFrame.at_geodetic(datum, lon0, lat0, h0)
        local = tangent_from_map(tangent, frame, xyz)
        np.testing.assert_allclose(local, case["prc_lsr_m"], rtol=0, atol=4e-9)
        np.testing.assert_allclose(map_from_tangent(tangent, frame, local), xyz, rtol=0, atol=4e-9)
        np.testing.assert_allclose(
            geodetic_from_geocentric(ecef, datum.semi_major_m, datum.flattening)[:2],
            geodetic[:2],
            rtol=0,
            atol=2e-14,
        )


def test_axes_of_the_golden_systems(cases):
    for case in cases:
        axes = grid_axes(f"EPSG:{case['epsg']}")
        # always_xy has exchanged the left-handed (north, east) systems already.
        assert not axes.left_handed
        turns = case["quarter_turns_working_vs_EN"]
        expected = {0: np.eye(2), 2: -np.eye(2)}[turns]
        np.testing.assert_array_equal(axes.working_from_east_north, expected)
