"""Map frames: units, datums, thread- and process-safety, the network off."""

import os
import pickle
import subprocess
import sys
import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stereomate.errors import CrsError
from stereomate.frames.crs import datum_note, datum_operation, geodetic_of
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.orientation import ExteriorOrientation
from stereomate.frames.tangent import TangentFrame, geocentric_from_geodetic, geodetic_from_geocentric
from stereomate.frames.transform import map_from_map, map_from_tangent, tangent_from_map

ELLIPSOIDAL = HeightSystem.ellipsoidal()
PLACES = {
    "EPSG:25832": (9.0, 50.0),
    "EPSG:2154": (5.0, 45.0),
    "EPSG:2263": (-74.0, 40.7),
    "EPSG:2053": (28.5, -26.0),
    "EPSG:5513": (15.0, 49.8),
    "EPSG:27572": (2.4, 47.0),
    "EPSG:3031": (30.0, -78.0),
}
NGI = "+proj=tmerc +lat_0=0 +lon_0=25 +k=1 +x_0=0 +y_0=0 +ellps=WGS84 +units=m"


@settings(deadline=None, max_examples=80)
@given(st.floats(-180.0, 180.0), st.floats(-90.0, 90.0), st.floats(-1000.0, 20_000.0))
def test_geodetic_and_geocentric_there_and_back(lon, lat, h):
    a, f = 6378137.0, 1 / 298.257222101
    ecef = geocentric_from_geodetic((lon, lat, h), a, f)
    found = geodetic_from_geocentric(ecef, a, f)
    # Five units in the last place of an Earth radius.
    np.testing.assert_allclose(geocentric_from_geodetic(found, a, f), ecef, rtol=0, atol=5e-9)
    assert abs(found[1] - lat) < 1e-13
    assert abs(found[2] - h) < 6e-9


def test_geocentric_against_proj():
    import pyproj

    rng = np.random.default_rng(4)
    points = np.column_stack(
        [rng.uniform(-180, 180, 500), rng.uniform(-90, 90, 500), rng.uniform(-5e2, 9e3, 500)]
    )
    to_ecef = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    expected = np.column_stack(to_ecef.transform(*points.T))
    found = geocentric_from_geodetic(points, 6378137.0, 1 / 298.257223563)
    np.testing.assert_allclose(found, expected, rtol=0, atol=5e-9)


@settings(deadline=None, max_examples=30)
@given(
    st.sampled_from(list(PLACES)),
    st.floats(-20_000.0, 20_000.0),
    st.floats(-20_000.0, 20_000.0),
    st.floats(-100.0, 8000.0),
)
def test_tangent_and_map_there_and_back(crs, e, n, u):
    frame = MapFrame(crs, ELLIPSOIDAL)
    tangent = TangentFrame.at_geodetic(frame.geodetic, *PLACES[crs], 50.0)
    xyz = map_from_tangent(tangent, frame, (e, n, u))
    np.testing.assert_allclose(tangent_from_map(tangent, frame, xyz), (e, n, u), rtol=0, atol=2e-8)


def test_a_block_moved_as_a_whole_gives_moved_results():
    """Points and origin turned about the Earth's axis by one zone: the same grid coordinates."""
    first, second = MapFrame("EPSG:32632", ELLIPSOIDAL), MapFrame("EPSG:32633", ELLIPSOIDAL)
    points = np.random.default_rng(3).uniform(-5000, 5000, (50, 3))
    a = map_from_tangent(TangentFrame.at_geodetic(first.geodetic, 8.5, 47.0, 0.0), first, points)
    b = map_from_tangent(TangentFrame.at_geodetic(second.geodetic, 14.5, 47.0, 0.0), second, points)
    np.testing.assert_allclose(a, b, rtol=0, atol=2e-8)


def test_grads_and_the_meridian_of_paris_are_normalised():
    """NTF (Paris): grads from Paris inside PROJ, degrees from Greenwich here."""
    frame = MapFrame("EPSG:27572", ELLIPSOIDAL)
    lon, lat, _ = frame.geodetic_from_map((600_000.0, 2_200_000.0, 0.0))
    assert lon == pytest.approx(2.33722917, abs=1e-7)
    assert lat == pytest.approx(46.8, abs=1e-6)  # 52 grads
    np.testing.assert_allclose(
        frame.map_from_geodetic((lon, lat, 0.0)), (600_000.0, 2_200_000.0, 0.0), atol=1e-6
    )


def test_us_survey_feet():
    feet, metres = MapFrame("EPSG:2263", ELLIPSOIDAL), MapFrame("EPSG:32118", ELLIPSOIDAL)
    point = (-73.98, 40.75, 0.0)
    a, b = feet.map_from_geodetic(point), metres.map_from_geodetic(point)
    assert feet.unit_m == pytest.approx(1200 / 3937, rel=1e-15)
    np.testing.assert_allclose(a[:2] * feet.unit_m, b[:2], atol=1e-3)


def test_datum_differences_are_transformed_or_refused():
    dhdn, etrs = MapFrame("EPSG:31467", ELLIPSOIDAL), MapFrame("EPSG:25832", ELLIPSOIDAL)
    xyz = (3_500_000.0, 5_500_000.0, 100.0)
    moved = map_from_map(etrs, dhdn, xyz)
    # DHDN and ETRS89 lie 100 to 200 m apart; the scale of UTM takes 0.4 m per km of northing off.
    assert 20.0 < np.hypot(moved[0] - 500_000.0, moved[1] - 5_500_000.0 * 0.9996) < 3000.0
    np.testing.assert_allclose(map_from_map(dhdn, etrs, moved), xyz, atol=1e-3)
    # An unnamed datum on another ellipsoid: nothing may be assumed.
    bare = MapFrame("+proj=utm +zone=32 +ellps=bessel", ELLIPSOIDAL)
    with pytest.raises(CrsError, match="names only an ellipsoid"):
        map_from_map(etrs, bare, (500_000.0, 5_500_000.0, 0.0))
    # The Moon has no transformation to the Earth.
    moon = MapFrame("IAU_2015:30100", ELLIPSOIDAL)
    with pytest.raises(CrsError, match="has no transformation"):
        map_from_map(etrs, moon, (10.0, 50.0, 0.0))


def test_the_operation_between_datums_is_told_with_its_accuracy():
    swiss, etrs, wgs = (geodetic_of(crs) for crs in ("EPSG:2056", "EPSG:25832", "EPSG:32632"))
    name, accuracy = datum_operation(swiss, etrs, 8.0, 47.0)
    assert name == "CH1903+ to ETRS89 (1)"
    assert accuracy == 0.1
    assert datum_operation(etrs, etrs, 8.0, 47.0) is None
    name, accuracy = datum_operation(geodetic_of("EPSG:31467"), etrs, 9.0, 51.0)
    assert "DHDN to ETRS89" in name
    assert accuracy is None or accuracy >= 1.0
    assert datum_operation(wgs, etrs, 9.0, 51.0) is not None


def test_an_unnamed_datum_on_the_same_ellipsoid_is_taken_as_its_partners_and_said():
    project, raster = (
        MapFrame(NGI, HeightSystem.undeclared()),
        MapFrame("EPSG:32735", HeightSystem.undeclared()),
    )
    note = datum_note(project.geodetic, raster.geodetic)
    assert note is not None
    assert "datum of 'WGS 84'" in note
    assert datum_note(raster.geodetic, raster.geodetic) is None
    moved = map_from_map(raster, project, (0.0, -3_700_000.0, 5.0))
    lon = raster.geodetic_from_map(moved)[0]
    assert lon == pytest.approx(25.0, abs=1e-12)
    assert moved[2] == 5.0


def test_a_vertical_part_of_a_compound_crs_is_noted_not_applied():
    frame = MapFrame("EPSG:25832+7837", HeightSystem.undeclared())
    assert frame.vertical_name == "DHHN2016 height"
    assert MapFrame("EPSG:25832", ELLIPSOIDAL).vertical_name is None
    xyz = (500_000.0, 5_500_000.0, 100.0)
    np.testing.assert_allclose(
        frame.geodetic_from_map(xyz), MapFrame("EPSG:25832", ELLIPSOIDAL).geodetic_from_map(xyz)
    )


def test_points_outside_the_projection_are_an_error_and_nan_stays_nan():
    frame = MapFrame("EPSG:2154", ELLIPSOIDAL)
    with pytest.raises(CrsError, match="outside the domain"):
        frame.map_from_geodetic([(3.0, 46.0, 0.0), (3.0, -90.0, 0.0)])
    assert np.isnan(frame.geodetic_from_map((np.nan, np.nan, np.nan))).all()
    out = frame.geodetic_from_map([(700_000.0, 6_600_000.0, 0.0), (np.nan, np.nan, np.nan)])
    assert np.isfinite(out[0]).all()
    assert np.isnan(out[1]).all()


def test_crs_that_are_no_map_are_refused():
    for crs in ("nonsense", "EPSG:5773", "EPSG:4978"):
        with pytest.raises(CrsError):
            MapFrame(crs, ELLIPSOIDAL)
    with pytest.raises(CrsError, match="another ellipsoid"):
        tangent_from_map(
            TangentFrame(9, 50, 0, 6377397.155, 1 / 299.15),
            MapFrame("EPSG:25832", ELLIPSOIDAL),
            (5e5, 5e6, 0),
        )
    with pytest.raises(CrsError, match="latitude"):
        TangentFrame(9.0, 91.0, 0.0, 6378137.0, 0.003)


def test_values_travel_to_other_processes():
    frame = MapFrame("EPSG:2154", ELLIPSOIDAL)
    tangent = TangentFrame.at_map(frame, (815_000.0, 6_285_000.0, 0.0))
    orientation = ExteriorOrientation((1.0, 2.0, 3.0), np.eye(3))
    for value in (
        frame,
        tangent,
        orientation,
        HeightSystem.vertical_crs("EPSG:5773"),
        geodetic_of("EPSG:2154"),
    ):
        copy = pickle.loads(pickle.dumps(value))
        assert copy == value
        assert hash(copy) == hash(value)
    np.testing.assert_array_equal(
        map_from_tangent(pickle.loads(pickle.dumps(tangent)), frame, (1.0, 2.0, 3.0)),
        map_from_tangent(tangent, frame, (1.0, 2.0, 3.0)),
    )


def test_threads_share_frames():
    frame = MapFrame("EPSG:25832", ELLIPSOIDAL)
    dhdn = MapFrame("EPSG:31467", ELLIPSOIDAL)
    tangent = TangentFrame.at_map(frame, (600_000.0, 5_600_000.0, 0.0))
    points = np.random.default_rng(0).uniform(-1000, 1000, (5000, 3))
    expected = map_from_tangent(tangent, dhdn, points)
    results = []

    def work():
        for _ in range(5):
            results.append(np.array_equal(map_from_tangent(tangent, dhdn, points), expected))

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(results) == 20
    assert all(results)


def test_the_network_of_proj_is_off_even_when_the_environment_asks_for_it():
    script = (
        "import threading, pyproj\n"
        "from stereomate.frames.mapframe import MapFrame\n"
        "from stereomate.frames.heights import HeightSystem\n"
        "from stereomate.errors import MissingGridError\n"
        "def work():\n"
        "    try:\n"
        "        HeightSystem.vertical_crs('EPSG:5773').ellipsoidal_from_system(10.0, 50.0, 0.0)\n"
        "    except MissingGridError:\n"
        "        print(pyproj.network.is_network_enabled())\n"
        "work()\n"
        "t = threading.Thread(target=work); t.start(); t.join()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PROJ_NETWORK": "ON"},
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["False", "False"]


def test_an_orientation_is_a_rotation():
    with pytest.raises(ValueError, match="rotation"):
        ExteriorOrientation((0.0, 0.0, 0.0), np.diag([1.0, 1.0, -1.0]))
    with pytest.raises(ValueError, match="finite"):
        ExteriorOrientation((0.0, np.nan, 0.0), np.eye(3))
    turned = ExteriorOrientation(
        (10.0, 20.0, 30.0), np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    )
    point = np.array([11.0, 22.0, 5.0])
    np.testing.assert_allclose(turned.camera_from_tangent(point), (2.0, -1.0, -25.0))
    np.testing.assert_allclose(turned.tangent_from_camera(turned.camera_from_tangent(point)), point)
    np.testing.assert_allclose(turned.viewing_direction, (0.0, 0.0, -1.0))
    with pytest.raises(ValueError, match="read-only"):
        turned.object_from_camera[0, 0] = 2.0
