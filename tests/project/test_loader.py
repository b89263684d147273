"""From a project file to a survey: one orientation in every convention, and what `adjusted_in` does."""

from __future__ import annotations

import json
import math

import numpy as np
import pyproj
import pytest

from stereomate.errors import FormatError, HeightSystemError, InputError, ProjectError
from stereomate.frames.attitude import AttitudeConvention, written_attitude
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import map_from_tangent, tangent_from_map
from stereomate.geometry.rotations import rotation_angle
from stereomate.project import load
from stereomate.project.cameras import load_cameras

EAST, NORTH, GROUND, FLYING = 512_000.0, 5_400_000.0, 200.0, 300.0
NAMES = ("photo_1.tif", "photo_2.tif")


def rows(*columns) -> str:
    return "\n".join(
        ",".join([name, *map(repr, map(float, row))]) for name, row in zip(NAMES, *columns, strict=True)
    )


def same_survey(one, two, metres=1e-7, radians=1e-10) -> None:
    for a, b in zip(one.survey.photographs, two.survey.photographs, strict=True):
        assert a.name == b.name
        np.testing.assert_allclose(a.orientation.centre, b.orientation.centre, atol=metres)
        turn = a.orientation.object_from_camera.T @ b.orientation.object_from_camera
        assert rotation_angle(turn) < radians


def written(project, convention, origin=None):
    survey = project.survey
    rotations = np.array([photo.orientation.object_from_camera for photo in survey.photographs])
    centres = survey.centres_tangent
    return written_attitude(rotations, convention, survey.tangent, centres, survey.frame, origin)


@pytest.mark.parametrize(
    ("keys", "header", "convention"),
    [
        ('angles = "local"', "omega,phi,kappa", AttitudeConvention("opk", "local")),
        (
            'angles = "local"\nangle_unit = "gon"',
            "omega,phi,kappa",
            AttitudeConvention("opk", "local", "gon"),
        ),
        ('angles = "grid"', "omega[rad],phi[rad],kappa[rad]", AttitudeConvention("opk", "grid", "rad")),
        (
            'angles = "grid"\nangle_order = "phi-omega-kappa"',
            "phi,omega,kappa",
            AttitudeConvention("pok", "grid"),
        ),
        ('angles = "rph"', "roll,pitch,yaw", AttitudeConvention("rph", "local")),
        (
            'angles = "rph"\nnorth = "grid"',
            "roll,pitch,heading",
            AttitudeConvention("rph", "grid_east_north"),
        ),
        (
            'angles = "rph"\nmount = "gimbal"',
            "roll,pitch,yaw",
            AttitudeConvention("rph", "local", mount="gimbal"),
        ),
        (
            'angles = "rph"\nmount = "x_forward"\nboresight_deg = [0.1, -0.2, 0.3]',
            "roll,pitch,yaw",
            AttitudeConvention(
                "rph",
                "local",
                mount="x_forward",
                boresight_rad=(math.radians(0.1), math.radians(-0.2), math.radians(0.3)),
            ),
        ),
    ],
)
def test_one_orientation_in_every_convention(small, keys, header, convention):
    first = load(small.path)
    angles = written(first, convention)
    small.replace("project.toml", 'angles = "grid"', keys)
    centres = first.survey.centres_map
    small.write("orientation.csv", f"filename,x,y,z,{header}\n" + rows(np.column_stack([centres, angles])))
    same_survey(first, load(small.path))


def test_angles_about_one_tangent_frame(small):
    first = load(small.path)
    origin = TangentFrame.at_geodetic(first.frame.geodetic, 9.5, 48.9, 0.0)
    angles = written(first, AttitudeConvention("opk", "tangent"), origin)
    small.replace("project.toml", 'angles = "grid"', 'angles = "tangent"\norigin = [9.5, 48.9, 0.0]')
    table = rows(np.column_stack([first.survey.centres_map, angles]))
    small.write("orientation.csv", "filename,x,y,z,omega,phi,kappa\n" + table)
    same_survey(first, load(small.path))


def test_longitude_latitude_height_and_heading(small):
    """The classical output of satellite and inertial navigation means the same photographs."""
    first = load(small.path)
    angles = written(first, AttitudeConvention("rph", "local"))
    places = first.frame.geodetic_from_map(first.survey.centres_map)
    small.replace(
        "project.toml", 'angles = "grid"\nadjusted_in = "space"', 'angles = "rph"\ncrs = "EPSG:4258"'
    )
    table = rows(np.column_stack([places, angles]))
    small.write("orientation.csv", "name,lon,lat,alt,roll,pitch,heading\n" + table)
    same_survey(first, load(small.path))


def test_the_map_does_not_depend_on_the_tangent_frame(small):
    first = load(small.path)
    small.replace("project.toml", "[project]", "[project]\ntangent_origin = [9.3, 48.6, 100.0]")
    other = load(small.path)
    assert other.tangent.longitude_deg == 9.3
    np.testing.assert_allclose(other.survey.centres_map, first.survey.centres_map, atol=1e-6)


def test_vertical_photographs_look_down_and_grid_north(small):
    """By hand: omega = phi = kappa = 0 about grid axes is a camera whose y axis points to grid north."""
    small.write(
        "orientation.csv",
        "filename,x,y,z,omega,phi,kappa\n"
        + rows([[EAST - 12, NORTH, 500, 0, 0, 0], [EAST + 12, NORTH, 500, 0, 0, 0]]),
    )
    project = load(small.path)
    photo = project.survey.photographs[0]
    north = np.array(photo.orientation.centre) + photo.orientation.object_from_camera @ [0.0, 10.0, 0.0]
    x, y, z = map_from_tangent(project.tangent, project.frame, north)
    assert x == pytest.approx(EAST - 12, abs=1e-4)
    # Ten metres in space at 500 m are 10 tau_e in the grid.
    tau = pyproj.Proj("EPSG:25832").get_factors(9.1634, 48.7537).meridional_scale
    assert y - NORTH == pytest.approx(10.0 * tau / (1 + 500 / 6.38e6), abs=1e-4)
    assert z == pytest.approx(500.0, abs=1e-4)


def test_heights_of_the_ground(small):
    ground = load(small.path).ground
    # The middle node of the height model is 200 + 0.2 * 20 - 0.1 * 20 = 202 m.
    assert ground.mean_m == pytest.approx(201.95, abs=0.15)
    assert ground.gsd_m == pytest.approx([0.1 / 30 * 298.0] * 2, rel=0.01)
    assert (ground.seen == 1.0).all()


# --- adjusted_in -----------------------------------------------------------------------------------------


def excess(height_above: float, reference: float) -> float:
    """(tau_e - 1) H from pyproj's own factors: another way than the frames' stencil."""
    projection = pyproj.Proj("EPSG:25832")
    lon, lat = projection(EAST, NORTH, inverse=True)
    tau = projection.get_factors(lon, lat).meridional_scale
    tau_e = tau / (1.0 + reference / 6.38e6)
    return height_above * (1.0 - 1.0 / tau_e)


def test_adjusted_in_grid_gives_true_heights(small):
    as_written = load(small.path)
    small.replace("project.toml", 'adjusted_in = "space"', 'adjusted_in = "grid"')
    project = load(small.path)
    change = project.survey.centres_map[:, 2] - as_written.survey.centres_map[:, 2]
    expected = -excess(GROUND + FLYING - project.ground.mean_m, project.ground.mean_m)
    assert expected > 0.1
    np.testing.assert_allclose(change, expected, atol=2e-4)
    assert project.grid_adjustment is not None
    (note,) = [note for note in project.notes if "adjustment in the grid" in note]
    assert f"{expected:+.3f} m on average" in note
    assert "mean terrain under the block" in note


def test_reference_height_may_be_stated(small):
    small.replace(
        "project.toml", 'adjusted_in = "space"', 'adjusted_in = "grid"\ngrid_reference_height = 0.0'
    )
    change = load(small.path).survey.centres_map[:, 2] - (GROUND + FLYING)
    np.testing.assert_allclose(change, -excess(GROUND + FLYING, 0.0), atol=1e-4)


def test_reference_height_is_that_of_the_control(small):
    small.replace("project.toml", "[terrain]", '[control]\nfile = "control.csv"\n\n[terrain]')
    small.replace("project.toml", 'adjusted_in = "space"', 'adjusted_in = "grid"')
    small.write("control.csv", f"name,x,y,z\na,{EAST},{NORTH},90\nb,{EAST},{NORTH},110\n")
    project = load(small.path)
    change = project.survey.centres_map[:, 2] - (GROUND + FLYING)
    np.testing.assert_allclose(change, -excess(400.0, 100.0), atol=1e-4)
    assert any("mean control height" in note for note in project.notes)


def test_without_the_key_the_difference_is_computed(small):
    small.replace("project.toml", 'adjusted_in = "space"\n', "")
    project = load(small.path)
    assert project.grid_adjustment is None
    size = abs(excess(GROUND + FLYING - project.ground.mean_m, project.ground.mean_m))
    assert any(f"{size:.3f} m wrong in height" in note for note in project.notes)
    small.replace("project.toml", "gsd = 1.0", "gsd = 0.2")
    with pytest.raises(ProjectError) as caught:
        load(small.path)
    message = str(caught.value)
    for word in (
        "photos.adjusted_in",
        '"grid" (from an adjustment',
        '"space" (true positions',
        f"{size:.3f} m",
        "0.060 m",
    ):
        assert word in message


def test_grid_heights_without_a_grid_are_refused(small):
    first = load(small.path)
    places = first.frame.geodetic_from_map(first.survey.centres_map)
    table = rows(np.column_stack([places, np.zeros((2, 3))]))
    small.write("orientation.csv", "name,lon,lat,alt,roll,pitch,heading\n" + table)
    small.replace(
        "project.toml", 'angles = "grid"\nadjusted_in = "space"', 'angles = "rph"\nadjusted_in = "grid"'
    )
    with pytest.raises(ProjectError, match="adjusted_in: cannot be"):
        load(small.path)


# --- heights, terrain, compare, vector files ------------------------------------------------------------


def test_undeclared_heights_are_said_and_a_vertical_crs_is_not_applied(small):
    small.write_heights(np.full((40, 40), 200.0), crs="EPSG:25832+5783")
    small.replace("project.toml", '"ellipsoidal"', '"undeclared"')
    project = load(small.path)
    assert project.ground.mean_m == pytest.approx(200.0, abs=1e-6)
    notes = "\n".join(project.notes)
    assert "one unknown common system" in notes
    assert "DHHN92 height: noted, not applied" in notes


def test_heights_of_sections_are_brought_together(small, tmp_path):
    """A geoid grid for the height model: its heights are 40 m lower than ellipsoidal ones."""
    import rasterio

    grid = tmp_path / "geoid.tif"
    with rasterio.open(
        grid, "w", driver="GTiff", width=20, height=20, count=1, dtype="float32", crs="EPSG:4326",
        transform=rasterio.Affine(0.05, 0.0, 8.7, 0.0, -0.05, 49.2),
    ) as file:  # fmt: skip
        file.write(np.full((20, 20), 40.0, np.float32), 1)
    plain = load(small.path).ground.mean_m
    small.replace("project.toml", 'file = "heights.tif"', 'file = "heights.tif"\nheights = "geoid.tif"')
    assert load(small.path).ground.mean_m == pytest.approx(plain + 40.0, abs=1e-3)


def test_heights_in_feet(small):
    small.write_heights(np.full((40, 40), 656.0))
    small.replace("project.toml", 'file = "heights.tif"', 'file = "heights.tif"\nunit = "foot"')
    assert load(small.path).ground.mean_m == pytest.approx(656.0 * 0.3048, abs=1e-6)


def test_map_in_us_feet(small):
    """North Carolina (EPSG:2264) in US survey feet: the tangent frame is in metres."""
    foot = 1200.0 / 3937.0
    x, y = 1_500_000.0, 700_000.0
    table = [[x, y, 500.0, 0, 0, 0], [x + 24.0 / foot, y, 500.0, 0, 0, 0]]
    small.write("orientation.csv", "filename,x,y,z,omega,phi,kappa\n" + rows(table))
    small.replace("project.toml", "EPSG:25832", "EPSG:2264")
    small.replace("project.toml", 'file = "heights.tif"', "level = 200.0")
    project = load(small.path)
    one, two = project.survey.centres_tangent
    tau = pyproj.Proj("EPSG:2264").get_factors(-80.9, 35.6).meridional_scale
    expected = 24.0 / tau * (1.0 + 500.0 / 6.37e6)
    assert np.linalg.norm(two - one) == pytest.approx(expected, abs=1e-3)
    assert project.ground.gsd_m == pytest.approx([1.0, 1.0], abs=1e-3)


def test_level_ground(small):
    small.replace("project.toml", 'file = "heights.tif"', "level = 210.0")
    project = load(small.path)
    assert project.ground.mean_m == pytest.approx(210.0, abs=1e-6)
    assert project.ground.relief_m == pytest.approx(0.0, abs=1e-6)
    assert project.ground.flying_height_m == pytest.approx([290.0, 290.0], abs=1e-6)


def test_second_orientation_is_compared(small):
    first = load(small.path)
    angles = written(first, AttitudeConvention("rph", "local"))
    angles[:, 0] += [1.0, 0.5]
    places = first.frame.geodetic_from_map(first.survey.centres_map + np.array([0.0, 0.0, 2.0]))
    small.write("raw.csv", "name,lon,lat,alt,roll,pitch,heading\n" + rows(np.column_stack([places, angles])))
    compare = '[photos.compare]\norientation = "raw.csv"\ncrs = "EPSG:4258"\nangles = "rph"\n\n[terrain]'
    small.replace("project.toml", "[terrain]", compare)
    comparison = load(small.path).comparison
    assert [d.angle_deg for d in comparison.differences] == pytest.approx([1.0, 0.5], abs=1e-9)
    assert comparison.differences[0].angle_px == pytest.approx(math.radians(1.0) * 300.0)
    assert comparison.differences[1].shift_m == pytest.approx((0.0, 0.0, 2.0), abs=1e-4)
    assert not comparison.is_same
    assert "0.75° on average (0.50° to 1.00°" in comparison.sentence


def square(x: float, y: float, size: float, **properties):
    ring = [[x, y], [x + size, y], [x + size, y + size], [x, y + size], [x, y]]
    geometry = {"type": "Polygon", "coordinates": [ring]}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def geojson(small, name: str, *features) -> None:
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::25832"}}
    small.write(name, json.dumps({"type": "FeatureCollection", "crs": crs, "features": list(features)}))


def test_area_sheets_and_breaklines(small):
    geojson(small, "area.geojson", square(EAST, NORTH, 10.0), square(EAST + 5, NORTH, 10.0))
    geojson(small, "sheets.geojson", square(EAST, NORTH, 5.0, name="A1"), square(EAST + 5, NORTH, 5.0))
    geojson(small, "bridge.geojson", square(EAST - 10, NORTH - 10, 20.0, height=260.0, rule="raise"))
    keys = 'area = "area.geojson"\nsheets = "sheets.geojson"\nbreaklines = "bridge.geojson"'
    small.replace("project.toml", "gsd = 1.0", f"gsd = 1.0\n{keys}")
    project = load(small.path)
    assert project.area.area == pytest.approx(150.0)
    assert [sheet.name for sheet in project.sheets] == ["A1", "sheet_2"]
    assert float(project.heights.heights_at([EAST, NORTH])) == pytest.approx(260.0)
    assert {item.role for item in project.inputs} >= {"area", "sheets", "breaklines"}


@pytest.mark.parametrize("names", [("../A1", "B"), ("A", "A"), ("A 1", "B")])
def test_names_of_sheets_become_file_names(small, names):
    squares = [square(EAST, NORTH, 5.0, name=name) for name in names]
    geojson(small, "sheets.geojson", *squares)
    small.replace("project.toml", "gsd = 1.0", 'gsd = 1.0\nsheets = "sheets.geojson"')
    with pytest.raises(FormatError, match=r"sheets\.geojson.*name"):
        load(small.path)


def test_area_in_another_crs_is_projected(small):
    first = load(small.path)
    corners = first.frame.geodetic_from_map(
        [[EAST, NORTH, 0], [EAST + 50, NORTH, 0], [EAST + 50, NORTH + 20, 0], [EAST, NORTH + 20, 0]]
    )
    ring = [[float(lon), float(lat)] for lon, lat, _ in [*corners, corners[0]]]
    feature = {"type": "Feature", "properties": {}, "geometry": {"type": "Polygon", "coordinates": [ring]}}
    small.write("area.geojson", json.dumps({"type": "FeatureCollection", "features": [feature]}))
    small.replace("project.toml", "gsd = 1.0", 'gsd = 1.0\narea = "area.geojson"')
    # GeoJSON is on WGS 84; PROJ's best transformation to ETRS89 is the identity.
    assert load(small.path).area.bounds == pytest.approx((EAST, NORTH, EAST + 50, NORTH + 20), abs=1e-3)


@pytest.mark.parametrize(
    ("feature", "error", "message"),
    [
        (square(EAST, NORTH, 5.0), InputError, "height at every vertex"),
        (square(EAST, NORTH, 5.0, height="high"), FormatError, "must be numbers"),
        (square(EAST, NORTH, 5.0, height=3.0, rule="lift"), InputError, "rule"),
    ],
)
def test_breaklines_that_cannot_be_burned(small, feature, error, message):
    geojson(small, "bridge.geojson", feature)
    small.replace("project.toml", "gsd = 1.0", 'gsd = 1.0\nbreaklines = "bridge.geojson"')
    with pytest.raises(error, match=message) as caught:
        load(small.path)
    assert "bridge.geojson" in str(caught.value)


@pytest.mark.parametrize("text", ["no vector file", ""])
def test_area_that_is_no_vector_file(small, text):
    small.write("area.gpkg", text)
    small.replace("project.toml", "gsd = 1.0", 'gsd = 1.0\narea = "area.gpkg"')
    with pytest.raises(FormatError, match=r"area\.gpkg"):
        load(small.path)


def test_geoid_grid_elsewhere(small, tmp_path):
    import rasterio

    with rasterio.open(
        tmp_path / "geoid.tif", "w", driver="GTiff", width=20, height=20, count=1, dtype="float32",
        crs="EPSG:4326", transform=rasterio.Affine(0.05, 0.0, 20.0, 0.0, -0.05, 10.0),
    ) as file:  # fmt: skip
        file.write(np.full((20, 20), 40.0, np.float32), 1)
    small.replace("project.toml", 'heights = "ellipsoidal"', 'heights = "geoid.tif"')
    with pytest.raises(HeightSystemError, match="does not cover"):
        load(small.path)


# --- cameras ---------------------------------------------------------------------------------------------


def cameras(tmp_path, text: str):
    path = tmp_path / "cam.toml"
    path.write_text(text)
    return load_cameras(path)


def test_principal_point_in_pixels(tmp_path):
    (camera,) = cameras(
        tmp_path,
        '[[camera]]\nname = "c"\nsize_px = [400, 300]\nprincipal_distance_px = 500\n'
        "principal_point_px = [210, 140]\n",
    )
    pixels, inside = camera.image_from_camera([[0.0, 0.0, -1.0], [0.1, 0.2, -1.0]])
    np.testing.assert_allclose(pixels, [[210, 140], [260, 40]], atol=1e-9)
    assert inside.all()
    # Nothing is known of the sensor: it counts as 36 mm wide.
    assert camera.principal_distance_mm == pytest.approx(500 * 36 / 400)


def test_sensor_in_the_wrong_order(tmp_path):
    text = '[[camera]]\nname = "c"\nsize_px = [640, 1152]\nprincipal_distance_mm = 120\n'
    text += "sensor_mm = [165.888, 92.16]\n"
    with pytest.raises(ProjectError, match=r"camera\[1\]\.sensor_mm: must be in the order of size_px"):
        cameras(tmp_path, text)


def test_distortion_is_that_of_the_camera(tmp_path):
    (camera,) = cameras(
        tmp_path,
        '[[camera]]\nname = "c"\nsize_px = [400, 300]\nprincipal_distance_mm = 10\n'
        "pixel_pitch_mm = [0.01, 0.02]\n"
        'distortion = { model = "opencv", k1 = 0.1, taux = 0.01 }\n',
    )
    assert type(camera.distortion).__name__ == "OpenCVDistortion"
    assert (camera.distortion.k1, camera.distortion.taux) == (0.1, 0.01)
    assert np.array(camera.pixel_from_photo)[:, :2].tolist() == [[100.0, 0.0], [0.0, -50.0]]


def test_two_cameras_are_told_apart_by_name_or_size(small):
    second = '[[camera]]\nname = "large"\nsize_px = [90, 40]\nprincipal_distance_mm = 30.0\n'
    second += "pixel_pitch_mm = 0.1\n\n[photos]"
    small.replace("project.toml", "[photos]", second)
    assert {photo.camera.name for photo in load(small.path).survey.photographs} == {"small"}
    small.replace("project.toml", "size_px = [90, 40]", "size_px = [60, 40]")
    with pytest.raises(InputError, match="must name its camera, one of small, large"):
        load(small.path)
    lines = (small.folder / "orientation.csv").read_text().splitlines()
    cells = ["camera", "small", "large"]
    small.write("orientation.csv", "\n".join(f"{a},{b}" for a, b in zip(lines, cells, strict=True)))
    assert [photo.camera.name for photo in load(small.path).survey.photographs] == ["small", "large"]


# --- real projects ---------------------------------------------------------------------------------------

TUNIU = """
[project]
crs = "EPSG:32651"
heights = "undeclared"
{camera}
[photos]
files = "{folder}/odm/images/*.tif"
orientation = "{folder}/{orientation}"
{keys}
[terrain]
file = "{folder}/odm/odm_dem/dsm.tif"
"""
TUNIU_CAMERA = """
[[camera]]
name = "fc6310r"
size_px = [1368, 912]
principal_distance_px = 911.719212
principal_point_px = [681.885011, 462.500565]
distortion = { model = "brown", k1 = -0.264063, k2 = 0.101889, k3 = -0.02582, p1 = 0.00073, p2 = 0.00026 }
"""


def tuniu(tmp_path, data_folder, name, orientation, keys, camera=TUNIU_CAMERA):
    path = tmp_path / f"{name}.toml"
    folder = data_folder / "odm_tuniu"
    path.write_text(TUNIU.format(folder=folder, orientation=orientation, keys=keys, camera=camera))
    return load(path)


def largest_shift_px(one, two) -> float:
    """How far points of the height model move in the photographs between two surveys."""
    rows_, columns = one.heights.shape
    col, row = np.meshgrid(np.linspace(5, columns - 5, 40), np.linspace(5, rows_ - 5, 40))
    xy = one.heights.map_from_pixel(np.stack([col.ravel(), row.ravel()], axis=-1))
    points = np.column_stack([xy, one.heights.heights_at(xy)])
    points = points[np.isfinite(points[:, 2])]
    largest = 0.0
    for a, b in zip(one.survey.photographs, two.survey.photographs, strict=True):
        pixels = []
        for project, photo in ((one, a), (two, b)):
            local = tangent_from_map(project.tangent, project.frame, points)
            pixels.append(photo.camera.image_from_camera(photo.orientation.camera_from_tangent(local)))
        inside = pixels[0][1] & pixels[1][1]
        assert inside.sum() > 100
        largest = max(largest, float(np.abs(pixels[0][0] - pixels[1][0])[inside].max()))
    return largest


@pytest.mark.real
def test_tuniu_in_three_forms_and_the_raw_gimbal(tmp_path, data_folder):
    adjusted = tuniu(tmp_path, data_folder, "a", "odm_xyz_opk.csv", 'angles = "grid"\nadjusted_in = "space"')
    opensfm = tuniu(tmp_path, data_folder, "b", "odm/opensfm/reconstruction.json", "", camera="")
    # The table is rounded to a millimetre and a thousandth of a degree.
    same_survey(adjusted, opensfm, metres=1e-3, radians=math.radians(1e-3))
    assert largest_shift_px(adjusted, opensfm) < 0.1
    (note,) = [note for note in opensfm.notes if "reference_lla" in note]
    assert "0.02 m rms as projected" in note
    places = adjusted.frame.geodetic_from_map(adjusted.survey.centres_map)
    angles = written(adjusted, AttitudeConvention("rph", "local"))
    names = [photo.name for photo in adjusted.survey.photographs]
    lines = [
        ",".join([name, *map(repr, map(float, row))])
        for name, row in zip(names, np.column_stack([places, angles]), strict=True)
    ]
    table = tmp_path / "navigation.csv"
    table.write_text("\n".join(["filename,longitude,latitude,altitude,roll,pitch,heading", *lines]))
    navigation = tuniu(tmp_path, data_folder, "c", "../" * 20 + str(table)[1:], 'angles = "rph"')
    same_survey(adjusted, navigation, metres=1e-6)
    assert largest_shift_px(adjusted, navigation) < 1e-4
    compare = (
        f'angles = "grid"\nadjusted_in = "space"\n[photos.compare]\nangles = "rph"\n'
        f'orientation = "{data_folder}/odm_tuniu/odm_lla_rpy.csv"\n'
    )
    both = tuniu(tmp_path, data_folder, "d", "odm_xyz_opk.csv", compare)
    differences = [d.angle_deg for d in both.comparison.differences]
    assert min(differences) > 0.5
    assert max(differences) < 1.5
    assert "angles differ by 1.13° on average" in both.comparison.sentence


@pytest.mark.real
def test_ngi_with_the_form_as_written(tmp_path, data_folder):
    from test_project_schema import FROZEN_1

    folder = data_folder / "ngi_strip05"
    text = FROZEN_1
    for name in ("*_RGB.tif", "ngi_xyz_opk.csv", "dem.tif"):
        text = text.replace(f'"{name}"', f'"{folder}/{name}"')
    path = tmp_path / "project.toml"
    path.write_text(text)
    project = load(path)
    assert len(project.survey.photographs) == 2
    # tmerc with k = 1 at 24.4 degrees east: 41 ppm of scale less 57 ppm of 365 m of height.
    assert project.grid_adjustment.shift_m == pytest.approx([0.098, 0.080], abs=0.002)
    assert project.ground.gsd_m == pytest.approx([5.9, 5.85], abs=0.1)
    notes = "\n".join(project.notes)
    assert "EGM2008 height: noted, not applied" in notes
    assert "names only an ellipsoid" in notes
