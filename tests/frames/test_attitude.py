"""Attitudes: all golden rotations, every convention there and back, left-handed maps and their twins."""

import csv

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stereomate.errors import CrsError, OrientationError
from stereomate.frames.attitude import (
    AttitudeConvention,
    axes_from_camera,
    object_from_camera,
    rotation_tangent_from_axes,
    written_attitude,
    written_from_axes,
)
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import map_from_tangent, tangent_from_map
from stereomate.geometry.rotations import rotation_angle, rotation_from_opk, rotation_z

ELLIPSOIDAL = HeightSystem.ellipsoidal()


@pytest.fixture(scope="module")
def cases(golden):
    return golden("georef_rotations.json")["cases"]


def scene(case):
    frame = MapFrame(f"EPSG:{case['epsg']}", ELLIPSOIDAL)
    lat0, lon0, h0 = case["lsr_origin"]
    tangent = TangentFrame.at_geodetic(frame.geodetic, lon0, lat0, h0)
    centre = tangent.tangent_from_geodetic((case["lon_deg"], case["lat_deg"], case["h_m"]))
    return frame, tangent, centre


def test_all_golden_rotations(cases):
    for case in cases:
        frame, tangent, centre = scene(case)
        boresight = tuple(np.deg2rad(case["boresight_opk_deg"]))
        convention = AttitudeConvention("rph", "local", mount=case["mount"], boresight_rad=boresight)
        rph = (case["roll_deg"], case["pitch_deg"], case["heading_deg"])
        rotation = object_from_camera(rph, convention, tangent, centre)
        np.testing.assert_allclose(rotation, case["R_lsr"], rtol=0, atol=1e-11)

        for axes, angles in (
            ("grid_east_north", "opk_grid_EN_rad"),
            ("grid", "opk_grid_working_rad"),
            ("local", "opk_enu_at_prc_rad"),
            ("tangent", "opk_lsr_rad"),
            ("geocentric", "opk_ecef_rad"),
        ):
            opk = AttitudeConvention("opk", axes, "rad")
            found = written_attitude(rotation, opk, tangent, centre, frame)
            # Angles through their matrices: kappa of pi and of -pi are one.
            difference = rotation_from_opk(found).T @ rotation_from_opk(case[angles])
            assert rotation_angle(difference) < 1e-9
            np.testing.assert_allclose(
                np.exp(1j * found), np.exp(1j * np.array(case[angles])), rtol=0, atol=1e-9
            )
            back = object_from_camera(case[angles], opk, tangent, centre, frame)
            np.testing.assert_allclose(back, rotation, rtol=0, atol=1e-9)
        for axes, matrix in (("geocentric", "R_ecef"), ("grid_east_north", "R_grid_EN")):
            written = AttitudeConvention("matrix", axes)
            back = object_from_camera(case[matrix], written, tangent, centre, frame)
            np.testing.assert_allclose(back, rotation, rtol=0, atol=1e-9)


def test_heading_from_grid_north_is_heading_minus_convergence(cases):
    for case in cases:
        frame, tangent, centre = scene(case)
        boresight = tuple(np.deg2rad(case["boresight_opk_deg"]))
        kwargs = {"mount": case["mount"], "boresight_rad": boresight}
        rph = np.array([case["roll_deg"], case["pitch_deg"], case["heading_deg"]], dtype=float)
        true = object_from_camera(rph, AttitudeConvention("rph", "local", **kwargs), tangent, centre)
        rph[2] -= case["gamma_deg"]
        convention = AttitudeConvention("rph", "grid_east_north", **kwargs)
        grid = object_from_camera(rph, convention, tangent, centre, frame)
        np.testing.assert_allclose(grid, true, rtol=0, atol=1e-10)
        written = written_attitude(grid, convention, tangent, centre, frame)
        np.testing.assert_allclose(
            np.exp(1j * np.deg2rad(written)), np.exp(1j * np.deg2rad(rph)), rtol=0, atol=1e-10
        )


KINDS = [
    AttitudeConvention("opk", "grid", "gon"),
    AttitudeConvention("opk", "local", "deg.mmss"),
    AttitudeConvention("pok", "tangent", "deg"),
    AttitudeConvention("pok", "grid", "deg", inverse=True),
    AttitudeConvention("rph", "grid", "deg", mount="x_forward", boresight_rad=(0.01, -0.02, 1.5)),
    AttitudeConvention("rph", "local", "gon", mount="gimbal"),
    AttitudeConvention("matrix", "geocentric", camera_axes="computer_vision", inverse=True),
    AttitudeConvention("quaternion", "grid_east_north", camera_axes="computer_vision"),
]
angle = st.floats(-3.1, 3.1)


@settings(deadline=None, max_examples=40)
@given(
    st.lists(st.tuples(angle, angle, angle), min_size=1, max_size=4),
    st.sampled_from(KINDS),
    st.sampled_from(["EPSG:25832", "EPSG:2053", "EPSG:5513", "EPSG:2263"]),
)
def test_there_and_back_is_the_identity(opk, convention, crs):
    frame = MapFrame(crs, ELLIPSOIDAL)
    middle = {"EPSG:25832": (9.9, 50.1), "EPSG:2053": (28.3, -26.0), "EPSG:5513": (15.2, 49.8)}
    lon, lat = middle.get(crs, (-73.9, 40.7))
    tangent = TangentFrame.at_geodetic(frame.geodetic, lon, lat, 100.0)
    rotation = rotation_from_opk(np.array(opk))
    centres = np.array([[1000.0 * i, -700.0 * i, 1500.0] for i in range(len(opk))])
    written = written_attitude(rotation, convention, tangent, centres, frame)
    back = object_from_camera(written, convention, tangent, centres, frame)
    # deg.mmss is written to 1e-8 seconds of arc; near the poles of a set of angles they amplify rounding.
    np.testing.assert_allclose(back, rotation, rtol=0, atol=2e-9)


def test_left_handed_and_turned_maps_agree_with_their_right_handed_twin():
    base = "+proj=tmerc +lat_0=0 +lon_0=19 +k=1 +x_0=0 +y_0=0 +ellps=bessel +units=m"
    frames = {
        axis: MapFrame(f"{base} +axis={axis}", ELLIPSOIDAL)
        for axis in ("enu", "neu", "wsu", "swu", "nwu", "wnu", "esu", "seu")
    }
    tangent = TangentFrame.at_geodetic(frames["enu"].geodetic, 20.0, 49.0, 0.0)
    centre = np.array([3000.0, 40_000.0, 2000.0])
    rotation = rotation_from_opk([0.3, -0.2, 0.7])
    twin = object_from_camera(
        written_attitude(rotation, AttitudeConvention("opk", "grid"), tangent, centre, frames["enu"]),
        AttitudeConvention("opk", "grid_east_north"),
        tangent,
        centre,
        frames["enu"],
    )
    np.testing.assert_allclose(twin, rotation, atol=1e-12)
    directions = {"e": (1, 0, 0), "n": (0, 1, 0), "w": (-1, 0, 0), "s": (0, -1, 0)}
    for axis, frame in frames.items():
        east_north = rotation_tangent_from_axes("grid_east_north", tangent, centre, frame)
        reference = rotation_tangent_from_axes("grid_east_north", tangent, centre, frames["enu"])
        # Whatever the axes of its coordinates, grid east and north are the same directions.
        np.testing.assert_allclose(east_north, reference, rtol=0, atol=1e-11)
        x, y = np.array(directions[axis[0]]), np.array(directions[axis[1]])
        if axis == "neu" or np.cross(x, y)[2] < 0:  # exchanged by PROJ, or by the right-handed rule
            x, y = y, x
        working = np.column_stack([x, y, (0, 0, 1)]).astype(float)
        assert np.linalg.det(working) == 1.0
        found = rotation_tangent_from_axes("grid", tangent, centre, frame)
        np.testing.assert_allclose(found, reference @ working, rtol=0, atol=1e-11)


def test_gimbal_angles_of_a_nadir_photograph():
    tangent = TangentFrame(10.0, 50.0, 0.0, 6378137.0, 1 / 298.257223563)
    gimbal = AttitudeConvention("rph", "local", mount="gimbal")
    centre = (0.0, 0.0, 100.0)
    # Looking straight down, upper edge north; then turned east: the upper edge points east.
    down = object_from_camera((0.0, -90.0, 0.0), gimbal, tangent, centre)
    np.testing.assert_allclose(down, np.eye(3), atol=1e-12)
    east = object_from_camera((0.0, -90.0, 90.0), gimbal, tangent, centre)
    np.testing.assert_allclose(east[:, 1], (1.0, 0.0, 0.0), atol=1e-12)
    # At the horizon towards the north the camera looks along +north with its y axis up.
    level = object_from_camera((0.0, 0.0, 0.0), gimbal, tangent, centre)
    np.testing.assert_allclose(-level[:, 2], (0.0, 1.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(level[:, 1], (0.0, 0.0, 1.0), atol=1e-12)
    written = written_attitude(east, gimbal, tangent, centre)
    np.testing.assert_allclose(written, (0.0, -90.0, 90.0), atol=1e-6)


def test_tangent_axes_of_another_origin_turn_with_the_plumb_line():
    tangent = TangentFrame(10.0, 50.0, 0.0, 6378137.0, 1 / 298.257223563)
    other = TangentFrame(10.0, 50.1, 0.0, 6378137.0, 1 / 298.257223563)
    rotation = object_from_camera(
        (0.0, 0.0, 0.0), AttitudeConvention("opk", "tangent"), tangent, (0, 0, 0), origin=other
    )
    # 0.1 degrees of latitude tilt the vertical by 0.1 degrees about east.
    assert np.rad2deg(rotation_angle(rotation)) == pytest.approx(0.1, abs=1e-10)
    np.testing.assert_allclose(rotation[:, 0], (1, 0, 0), atol=1e-12)


def test_axes_on_another_datum_follow_its_own_normal():
    """DHDN against ETRS89: the normals differ by arc seconds, the axes are those of the map's datum."""
    frame = MapFrame("EPSG:31467", ELLIPSOIDAL)
    tangent = TangentFrame.at_map(MapFrame("EPSG:25832", ELLIPSOIDAL), (500_000.0, 5_500_000.0, 0.0))
    local = rotation_tangent_from_axes("local", tangent, (0.0, 0.0, 1000.0), frame)
    angle = np.rad2deg(rotation_angle(local)) * 3600
    assert 0.5 < angle < 10.0
    # The same by a plumb line: two points above one another on DHDN.
    low = map_from_tangent(tangent, frame, (0.0, 0.0, 1000.0))
    high = low + np.array([0.0, 0.0, 1000.0])
    up = tangent_from_map(tangent, frame, high) - tangent_from_map(tangent, frame, low)
    np.testing.assert_allclose(up / np.linalg.norm(up), local[:, 2], atol=1e-9)


def test_wrong_attitudes_are_refused_with_a_reason():
    tangent = TangentFrame(10.0, 50.0, 0.0, 6378137.0, 1 / 298.257223563)
    with pytest.raises(OrientationError, match="kind: must be one of opk"):
        AttitudeConvention("xyz", "grid")
    with pytest.raises(OrientationError, match="horizon"):
        AttitudeConvention("rph", "geocentric")
    with pytest.raises(OrientationError, match="map CRS"):
        object_from_camera((0, 0, 0), AttitudeConvention("opk", "grid"), tangent, (0, 0, 0))
    left = np.diag([1.0, -1.0, 1.0])
    with pytest.raises(OrientationError, match="left-handed"):
        axes_from_camera(left, AttitudeConvention("matrix", "grid"))
    with pytest.raises(OrientationError, match="shape"):
        axes_from_camera((0.0, 0.0), AttitudeConvention("opk", "grid"))
    for crs in ("EPSG:4326", "EPSG:3857", "EPSG:3035"):
        frame = MapFrame(crs, ELLIPSOIDAL)
        with pytest.raises(CrsError, match=r"not conformal|not projected"):
            object_from_camera((0, 0, 0), AttitudeConvention("opk", "grid"), tangent, (0, 0, 0), frame)


def test_packed_degrees_and_gon():
    opk = AttitudeConvention("opk", "local", "deg.mmss")
    rotation = axes_from_camera((0.0, 0.0, 12.3456), opk)
    expected = rotation_z(np.deg2rad(12 + 34 / 60 + 56 / 3600))
    np.testing.assert_allclose(rotation, expected, atol=1e-13)
    np.testing.assert_allclose(written_from_axes(expected, opk), (0.0, 0.0, 12.3456), atol=1e-12)
    gon = AttitudeConvention("opk", "local", "gon")
    np.testing.assert_allclose(axes_from_camera((0.0, 0.0, 100.0), gon), rotation_z(np.pi / 2), atol=1e-15)


@pytest.mark.real
def test_the_drone_table_and_its_gimbal_angles(data_folder):
    """Adjusted omega-phi-kappa against the raw roll-pitch-yaw: 0.5 to 1.5 degrees apart."""
    folder = data_folder / "odm_tuniu" / "odm"
    adjusted, raw = {}, {}
    with (folder.parent / "odm_xyz_opk.csv").open() as lines:
        for row in csv.reader(lines, delimiter=" ", quotechar="'"):
            if row[0] != "filename":
                adjusted[row[0]] = np.array(row[1:7], dtype=float)
    with (folder.parent / "odm_lla_rpy.csv").open() as lines:
        for row in csv.reader(lines, delimiter=" "):
            if row[0] != "filename":
                raw[row[0].removesuffix(".tif")] = np.array(row[1:7], dtype=float)
    assert set(adjusted) == set(raw)
    frame = MapFrame("EPSG:32651", HeightSystem.undeclared())
    names = sorted(adjusted)
    table = np.array([adjusted[name] for name in names])
    tangent = TangentFrame.at_map(frame, table[:, :3].mean(axis=0))
    centres = tangent_from_map(tangent, frame, table[:, :3])
    opk = AttitudeConvention("opk", "grid", "deg")
    rph = AttitudeConvention("rph", "local", "deg", mount="y_forward")
    rotations = object_from_camera(table[:, 3:], opk, tangent, centres, frame)
    gimbal = object_from_camera(np.array([raw[name][3:] for name in names]), rph, tangent, centres, frame)
    apart = np.rad2deg(rotation_angle(np.swapaxes(rotations, -1, -2) @ gimbal))
    assert apart.min() > 0.4
    assert apart.max() < 1.6
    # Re-expressed as roll, pitch and heading from true north, the adjusted table is the same orientation.
    written = written_attitude(rotations, rph, tangent, centres, frame)
    np.testing.assert_allclose(
        object_from_camera(written, rph, tangent, centres, frame), rotations, rtol=0, atol=1e-12
    )
    # Grid and true north lie 0.86 degrees apart here: reading the table in local axes would be that wrong.
    local = object_from_camera(table[:, 3:], AttitudeConvention("opk", "local"), tangent, centres, frame)
    wrong = np.rad2deg(rotation_angle(np.swapaxes(rotations, -1, -2) @ local))
    np.testing.assert_allclose(wrong, 0.86, atol=0.01)
