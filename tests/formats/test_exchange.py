"""Every format of orientations: there and back, and against a formula that is not the code's own."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from stereomate.camera.distortion import BrownDistortion
from stereomate.camera.model import Camera
from stereomate.errors import CrsError, FormatError, HeightSystemError, OrientationError
from stereomate.formats.declared import Declared
from stereomate.formats.exchange import FORMATS, convert_orientation
from stereomate.formats.orientation_set import (
    GeocentricFrame,
    OrientationSet,
    converted,
    grid_from_space,
    positions_in,
    space_from_grid,
)
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.geometry.rotations import rotation_from_opk

GRID = MapFrame("EPSG:32632", HeightSystem.ellipsoidal())
CAMERA = Camera.from_focal_lengths(
    "lens",
    (4000, 3000),
    (3500.0, 3500.0),
    (2011.0, 1493.0),
    BrownDistortion(k1=-0.1, k2=0.02, p1=3e-4, p2=-2e-4),
)
GROUND = np.array([691230.0, 5332250.0, 480.0])


def block(place=GRID, cameras=True) -> OrientationSet:
    """Five tilted photographs 300 m above ground, far from the central meridian."""
    random = np.random.default_rng(3)
    angles = random.uniform((-0.3, -0.3, -3.0), (0.3, 0.3, 3.0), (5, 3))
    positions = GROUND + random.uniform((-100, -100, 290), (100, 100, 310), (5, 3))
    names = tuple(f"photo_{k}.jpg" for k in range(5))
    grid = OrientationSet(
        names, positions, rotation_from_opk(angles), GRID, "grid",
        ("lens",) * 5 if cameras else (), {"lens": CAMERA} if cameras else {},
    )  # fmt: skip
    return converted(grid, place) if place is not GRID else grid


def tangent() -> TangentFrame:
    return TangentFrame.at_map(GRID, GROUND)


def assert_same(first: OrientationSet, second: OrientationSet, metres=1e-5, radians=1e-10) -> None:
    assert first.names == second.names
    order = [second.names.index(name) for name in first.names]
    there = converted(second, first.place, first.axes)
    np.testing.assert_allclose(there.positions[order], first.positions, rtol=0, atol=metres)
    np.testing.assert_allclose(there.rotations[order], first.rotations, rtol=0, atol=radians)


DECLARED = {
    "table": Declared(crs="EPSG:32632", heights=HeightSystem.ellipsoidal(), axes="grid", unit="deg"),
    "ign-opk": Declared(crs="EPSG:32632", heights=HeightSystem.ellipsoidal(), axes="grid", unit="gon"),
    "orthority-csv": Declared(heights=HeightSystem.ellipsoidal()),
    "orthority-geojson": Declared(heights=HeightSystem.ellipsoidal()),
    "patb": Declared(
        crs="EPSG:32632", heights=HeightSystem.ellipsoidal(), axes="grid", matrix="camera_from_object"
    ),
    "metashape-opk": Declared(crs="EPSG:32632", heights=HeightSystem.ellipsoidal(), axes="grid"),
    "pix4d": Declared(crs="EPSG:32632", heights=HeightSystem.ellipsoidal()),
    "opf": Declared(heights=HeightSystem.ellipsoidal()),
    "opensfm": Declared(crs="EPSG:32632", heights=HeightSystem.ellipsoidal(), opensfm_frame="projected"),
    "colmap-text": Declared(
        crs="EPSG:32632", heights=HeightSystem.ellipsoidal(), axes="grid", offset=(691000.0, 5332000.0, 0.0)
    ),
    "colmap-binary": Declared(crs="EPSG:32632", heights=HeightSystem.ellipsoidal(), axes="grid"),
    "micmac": Declared(crs="EPSG:32632", heights=HeightSystem.ellipsoidal(), axes="grid"),
}


@pytest.mark.parametrize("name", sorted(DECLARED))
def test_there_and_back_in_the_grid(tmp_path, name):
    source = block()
    path = tmp_path / ("file" if name not in ("opf",) else "folder")
    declared = DECLARED[name]
    FORMATS[name].write(path, source, declared)
    back = FORMATS[name].read(path, declared)
    assert back.place == GRID or back.place.name == GRID.name
    assert_same(source, back, metres=6e-5)


@pytest.mark.parametrize("name", ["table", "patb", "colmap-text", "micmac", "opensfm"])
def test_there_and_back_in_a_tangent_frame(tmp_path, name):
    source = block(tangent())
    origin = (tangent().longitude_deg, tangent().latitude_deg, tangent().height_m)
    declared = Declared(
        origin=origin, axes="tangent", unit="rad", matrix="object_from_camera", opensfm_frame="topocentric"
    )
    path = tmp_path / "file"
    FORMATS[name].write(path, source, declared)
    back = FORMATS[name].read(path, declared)
    np.testing.assert_allclose(back.positions, source.positions, atol=6e-5)
    np.testing.assert_allclose(back.rotations, source.rotations, atol=1e-10)


def test_cameras_survive(tmp_path):
    pixels = np.array([[10.0, 20.0], [3900.0, 2800.0], [2000.0, 10.0]])
    for name in ("colmap-text", "colmap-binary", "opensfm", "metashape-xml"):
        declared = DECLARED.get(name, Declared())
        source = block() if name != "metashape-xml" else block(GeocentricFrame("EPSG:4978"))
        FORMATS[name].write(tmp_path / name, source, declared)
        back = FORMATS[name].read(tmp_path / name, declared)
        camera = back.camera_values[back.cameras[0]]
        np.testing.assert_allclose(
            camera.rays_from_image(pixels), CAMERA.rays_from_image(pixels), atol=1e-12, err_msg=name
        )


def test_a_table_says_what_it_is(tmp_path):
    path = tmp_path / "table.csv"
    FORMATS["table"].write(path, block(), Declared())
    text = path.read_text()
    assert "# crs: EPSG:32632" in text
    assert "# angles: omega-phi-kappa in deg about axes grid" in text


@pytest.mark.parametrize(("kind", "mount"), [("pok", None), ("rph", "y_forward"), ("rph", "gimbal")])
def test_tables_of_other_angles(tmp_path, kind, mount):
    declared = Declared(
        crs="EPSG:32632",
        heights=HeightSystem.ellipsoidal(),
        axes="local",
        unit="gon",
        order=kind,
        mount=mount,
    )
    source = converted(block(), GRID, "local")
    FORMATS["table"].write(tmp_path / "t.txt", source, replace(declared, separator=";"))
    assert_same(source, FORMATS["table"].read(tmp_path / "t.txt", declared), metres=6e-5)


# Formats against formulas that are not the code's own.


def image_ray(orientation, k, point):
    """Direction of a point in the camera (x right, y down, z forward), by the set's rotation."""
    return np.diag([1.0, -1.0, -1.0]) @ orientation.rotations[k].T @ (point - orientation.positions[k])


def test_colmap_text_is_what_pycolmap_reads(tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    source = block(tangent())
    point = np.array([12.0, -7.0, 3.0])
    for name in ("colmap-text", "colmap-binary"):
        FORMATS[name].write(tmp_path / name, source, Declared())
        model = pycolmap.Reconstruction(str(tmp_path / name))
        images = {image.name: image for image in model.images.values()}
        for k, photo in enumerate(source.names):
            pose = images[photo].cam_from_world()
            np.testing.assert_allclose(pose * point, image_ray(source, k, point), atol=1e-9)
            pixel = images[photo].camera.img_from_cam(image_ray(source, k, point))
            ours = CAMERA.image_from_camera(np.diag([1.0, -1.0, -1.0]) @ image_ray(source, k, point))[0]
            np.testing.assert_allclose(np.ravel(pixel), ours, atol=1e-6)


def test_colmap_written_by_pycolmap_is_read(tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    source = block(tangent())
    FORMATS["colmap-text"].write(tmp_path, source, Declared())
    model = pycolmap.Reconstruction(str(tmp_path))
    for write, name in ((model.write_text, "t"), (model.write_binary, "b")):
        (tmp_path / name).mkdir()
        write(str(tmp_path / name))
        frame = tangent()
        declared = Declared(origin=(frame.longitude_deg, frame.latitude_deg, frame.height_m), axes="tangent")
        back = FORMATS["colmap-text"].read(tmp_path / name, declared)
        order = [back.names.index(photo) for photo in source.names]
        np.testing.assert_allclose(back.positions[order], source.positions, atol=1e-6)
        np.testing.assert_allclose(back.rotations[order], source.rotations, atol=1e-12)


def test_opf_angles_are_those_of_its_own_converter(tmp_path, monkeypatch):
    # Its tools want a progress bar that nothing here needs.
    monkeypatch.setitem(sys.modules, "tqdm", SimpleNamespace(tqdm=iter))
    tools = pytest.importorskip("opf_tools.opf2colmap.converter")
    source = block()
    FORMATS["opf"].write(tmp_path / "opf", source, Declared())
    calibrated = json.loads(next((tmp_path / "opf").glob("**/calibrated_cameras.json")).read_text())
    scene = json.loads((tmp_path / "opf" / "scene_reference_frame.json").read_text())
    shift = np.array(scene["base_to_canonical"]["shift"])
    for k, camera in enumerate(calibrated["cameras"]):
        quaternion, translation = tools.orient_pos_computation(
            np.array(camera["orientation_deg"]), np.array(camera["position"])
        )
        w, *v = quaternion
        # Rotation of a vector by a quaternion, written out: p + 2w (v x p) + 2 v x (v x p).
        p = GROUND + shift
        turned = p + 2 * w * np.cross(v, p) + 2 * np.cross(v, np.cross(v, p))
        np.testing.assert_allclose(turned + translation, image_ray(source, k, GROUND), atol=1e-6)


def test_metashape_xml_by_its_own_chain(tmp_path):
    """Camera -> chunk -> geocentric with an arbitrary similarity, as Metashape's reference manual has it."""
    geocentric = block(GeocentricFrame("EPSG:4978"))
    turn, shift, scale = rotation_from_opk([0.4, -1.0, 2.0]), geocentric.positions.mean(axis=0) + 50.0, 7.5
    cameras = []
    for k, name in enumerate(geocentric.names):
        matrix = np.eye(4)
        matrix[:3, :3] = turn.T @ geocentric.rotations[k] @ np.diag([1.0, -1.0, -1.0])
        matrix[:3, 3] = turn.T @ (geocentric.positions[k] - shift) / scale
        numbers = " ".join(f"{v:.17g}" for v in matrix.ravel())
        cameras.append(
            f'<camera id="{k}" sensor_id="0" label="{name}"><transform>{numbers}</transform></camera>'
        )
    path = tmp_path / "cameras.xml"
    path.write_text(
        '<document version="2.0.0"><chunk><sensors><sensor id="0" label="lens" type="frame">'
        '<calibration type="frame" class="adjusted"><resolution width="4000" height="3000"/>'
        "<f>3500</f><cx>11</cx><cy>-7</cy><k1>-0.1</k1><k2>0.02</k2><p1>-0.0002</p1><p2>0.0003</p2>"
        f"</calibration></sensor></sensors><cameras>{''.join(cameras)}"
        '<camera id="9" sensor_id="0" label="not aligned"/></cameras>'
        f"<transform><rotation>{' '.join(f'{v:.17g}' for v in turn.ravel())}</rotation>"
        f"<translation>{' '.join(f'{v:.17g}' for v in shift)}</translation><scale>{scale}</scale></transform>"
        '<reference>GEOGCS["WGS 84",DATUM["World Geodetic System 1984",SPHEROID["WGS 84",6378137,'
        '298.257223563]],PRIMEM["Greenwich",0],UNIT["degree",0.01745329251994328],AUTHORITY["EPSG","4326"]]'
        "</reference></chunk></document>"
    )
    back = FORMATS["metashape-xml"].read(path, Declared())
    assert any("1 cameras are not aligned" in note for note in back.notes)
    assert_same(block(), back, metres=1e-6)
    # Metashape's pixel: u = w/2 + cx + f x', x' = x (1 + k1 r2 + k2 r4) + p1 (r2 + 2x2) + 2 p2 x y.
    point = positions_in(GRID, back.place, GROUND[None])[0][0]
    x, y, z = image_ray(back, 0, point)
    x, y = x / z, y / z
    r2 = x * x + y * y
    radial = 1 - 0.1 * r2 + 0.02 * r2 * r2
    u = 2000 + 11 + 3500 * (x * radial - 0.0002 * (r2 + 2 * x * x) + 2 * 0.0003 * x * y)
    v = 1500 - 7 + 3500 * (y * radial + 0.0003 * (r2 + 2 * y * y) - 2 * 0.0002 * x * y)
    ours = back.camera_values["lens"].image_from_camera(back.rotations[0].T @ (point - back.positions[0]))[0]
    np.testing.assert_allclose(ours, (u, v), atol=1e-6)


def test_metashape_opk_matrix_contradicts(tmp_path):
    path = tmp_path / "opk.txt"
    FORMATS["metashape-opk"].write(path, block(), Declared())
    declared = DECLARED["metashape-opk"]
    back = FORMATS["metashape-opk"].read(path, declared)
    assert any("camera from object" in note for note in back.notes)
    lines = path.read_text().splitlines()
    cells = lines[2].split("\t")
    cells[4] = "0.5"
    path.write_text("\n".join([*lines[:2], "\t".join(cells), *lines[3:]]))
    with pytest.raises(FormatError, match="angles and matrices that differ"):
        FORMATS["metashape-opk"].read(path, declared)


def test_micmac_maps_camera_to_world(tmp_path):
    source = block(tangent())
    FORMATS["micmac"].write(tmp_path / "Ori", source, Declared())
    from xml.etree import ElementTree

    for k, name in enumerate(source.names):
        root = ElementTree.parse(tmp_path / "Ori" / f"Orientation-{name}.xml").getroot()
        rows = [root.findtext(f".//CodageMatr/L{i}") for i in (1, 2, 3)]
        matrix = np.array([[float(v) for v in row.split()] for row in rows])
        centre = np.array([float(v) for v in root.findtext(".//Externe/Centre").split()])
        p = image_ray(source, k, np.array([5.0, 6.0, 7.0]))
        np.testing.assert_allclose(matrix @ p + centre, [5.0, 6.0, 7.0], atol=1e-9)


def test_opensfm_maps_world_to_camera(tmp_path):
    from scipy.spatial.transform import Rotation

    source = block(tangent())
    FORMATS["opensfm"].write(tmp_path / "r.json", source, Declared())
    part = json.loads((tmp_path / "r.json").read_text())[0]
    for k, name in enumerate(source.names):
        shot = part["shots"][name]
        turned = Rotation.from_rotvec(shot["rotation"]).apply([5.0, 6.0, 7.0]) + shot["translation"]
        np.testing.assert_allclose(turned, image_ray(source, k, np.array([5.0, 6.0, 7.0])), atol=1e-9)


def test_patb_directions_are_each_others_transpose(tmp_path):
    path = tmp_path / "a.ori"
    FORMATS["patb"].write(path, block(), Declared(matrix="object_from_camera"))
    declared = replace(DECLARED["patb"], matrix="object_from_camera")
    right = FORMATS["patb"].read(path, declared)
    wrong = FORMATS["patb"].read(path, DECLARED["patb"])
    np.testing.assert_allclose(right.rotations, block().rotations, atol=1e-11)
    np.testing.assert_allclose(np.swapaxes(wrong.rotations, 1, 2), right.rotations, atol=1e-15)


@pytest.mark.parametrize("distance", ["153120.0 ", ""])
def test_patb_records_over_any_lines(tmp_path, distance):
    r = rotation_from_opk([0.01, -0.02, 1.5])
    numbers = " ".join(f"{v:.9f}" for v in r.ravel())
    path = tmp_path / "b.ori"
    path.write_text(f"# made\n101 {distance}691000.5 5332000.25 800.125 {numbers}\n-99\n")
    back = FORMATS["patb"].read(path, replace(DECLARED["patb"], matrix="object_from_camera"))
    assert back.names == ("101",)
    np.testing.assert_allclose(back.positions, [[691000.5, 5332000.25, 800.125]])
    np.testing.assert_allclose(back.rotations[0], r, atol=1e-9)


# Frames.


def test_frames_there_and_back():
    source = block()
    places = [
        tangent(),
        GeocentricFrame("EPSG:4978"),
        MapFrame("EPSG:4979", HeightSystem.ellipsoidal()),
        MapFrame("EPSG:32633", HeightSystem.ellipsoidal()),
    ]
    for place in places:
        there = converted(source, place)
        assert_same(source, there, metres=1e-7, radians=1e-12)


def test_golden_rotations(golden):
    """Grid, geocentric and topocentric matrices of all places, by two programs that are not this one."""
    for case in golden("georef_rotations.json")["cases"]:
        frame = MapFrame(f"EPSG:{case['epsg']}", HeightSystem.ellipsoidal())
        xyz = frame.map_from_geodetic((case["lon_deg"], case["lat_deg"], case["h_m"]))
        working = rotation_from_opk(case["opk_grid_working_rad"])
        source = OrientationSet(("p",), xyz[None], working[None], frame, "grid")
        datum = frame.geodetic
        lat, lon, h = case["lsr_origin"]
        places = {
            "ecef": GeocentricFrame(datum.crs),
            "lsr": TangentFrame.at_geodetic(datum, lon, lat, h),
        }
        for name, place in places.items():
            there = converted(source, place)
            np.testing.assert_allclose(there.positions[0], case[f"prc_{name}_m"], rtol=0, atol=5e-9)
            np.testing.assert_allclose(there.rotations[0], case[f"R_{name}"], rtol=0, atol=1e-9)
            assert_same(source, there, metres=1e-7, radians=1e-12)
        east_north = converted(source, frame, "grid_east_north")
        np.testing.assert_allclose(east_north.rotations[0], case["R_grid_EN"], rtol=0, atol=1e-9)
        local = converted(source, frame, "local")
        enu = rotation_from_opk(case["opk_enu_at_prc_rad"])
        np.testing.assert_allclose(local.rotations[0], enu, rtol=0, atol=1e-9)


def test_moving_a_block_between_datums_keeps_its_rays():
    """Orientation on Bessel, grid of DHDN, to geocentric WGS 84: a ray through a point goes through it
    there."""
    frame = MapFrame("EPSG:31468", HeightSystem.ellipsoidal())
    ground = np.array([4468000.0, 5333000.0, 500.0])
    space = TangentFrame.at_map(frame, ground)
    rotation = rotation_from_opk([0.1, -0.2, 0.7])
    source = OrientationSet(("p",), np.array([[30.0, -40.0, 300.0]]), rotation[None], space, "tangent")
    there = converted(source, GeocentricFrame("EPSG:4978"))
    point = positions_in(space, there.place, np.zeros((1, 3)))[0]
    before = rotation.T @ (np.zeros(3) - source.positions[0])
    after = there.rotations[0].T @ (point[0] - there.positions[0])
    # The datum transformation may scale by some ppm; directions must agree to its rotation's precision.
    np.testing.assert_allclose(after / after[2], before / before[2], atol=2e-8)


def test_grid_adjustment_and_back():
    source = block()
    there = space_from_grid(source, 480.0)
    shift = there.positions[:, 2] - source.positions[:, 2]
    # Equation (2): (tau_e - 1) H, with tau from the grid factors page: at 691 km E 48.1 N tau - 1 = +49 ppm.
    assert np.all(np.abs(shift) < 0.05)
    assert np.all(shift != 0.0)
    np.testing.assert_allclose(grid_from_space(there, 480.0).positions, source.positions, atol=1e-9)
    with pytest.raises(OrientationError, match="map grid"):
        space_from_grid(block(tangent()), 480.0)


def test_undeclared_heights_stay_or_are_refused():
    undeclared = MapFrame("EPSG:32632", HeightSystem.undeclared())
    source = replace(block(), place=undeclared)
    other = converted(source, MapFrame("EPSG:32633", HeightSystem.undeclared()))
    np.testing.assert_allclose(other.positions[:, 2], source.positions[:, 2], atol=1e-8)
    with pytest.raises(HeightSystemError, match="undeclared"):
        converted(source, GeocentricFrame("EPSG:4978"))


# What is ambiguous is refused with the possibilities.

TABLE = "filename x y z omega phi kappa\na 691000 5332000 800 0.1 0.2 3.0\nb 691100 5332000 800 0.1 0.2 3.0\n"


@pytest.mark.parametrize(
    ("text", "declared", "message"),
    [
        (TABLE, Declared(), "coordinate system .*EPSG:25832.*origin"),
        (TABLE, Declared(crs="EPSG:32632"), "axes its angles turn.*grid.*local.*geocentric"),
        (TABLE, Declared(crs="EPSG:32632", axes="grid"), "unit of its angles.*deg, gon, rad"),
        (TABLE.replace("3.0", "395.0"), Declared(crs="EPSG:32632", axes="grid"), "one of: gon\\)"),
        (TABLE.replace("3.0", "395.0"), Declared(crs="EPSG:32632", axes="grid", unit="deg"), "full turn"),
        (
            TABLE.replace("omega phi kappa", "roll pitch yaw"),
            Declared(crs="EPSG:32632", axes="grid", unit="deg"),
            "y_forward.*x_forward.*gimbal",
        ),
        (TABLE, Declared(crs="EPSG:32632", axes="tangent", unit="deg"), "must be one of grid"),
    ],
)
def test_ambiguous_tables_are_refused(tmp_path, text, declared, message):
    path = tmp_path / "t.txt"
    path.write_text(text)
    with pytest.raises((FormatError, OrientationError), match=message):
        FORMATS["table"].read(path, declared)


def test_other_refusals(tmp_path):
    FORMATS["patb"].write(tmp_path / "a.ori", block(), Declared(matrix="object_from_camera"))
    with pytest.raises(FormatError, match=r"object_from_camera.*camera_from_object"):
        FORMATS["patb"].read(tmp_path / "a.ori", Declared(crs="EPSG:32632", axes="grid"))
    with pytest.raises(FormatError, match="needs the camera"):
        FORMATS["colmap-text"].write(tmp_path / "c", block(cameras=False), Declared())
    assert not (tmp_path / "c").exists()
    FORMATS["opensfm"].write(tmp_path / "r.json", block(), Declared())
    with pytest.raises(FormatError, match=r"topocentric.*projected"):
        FORMATS["opensfm"].read(tmp_path / "r.json", Declared())
    with pytest.raises(FormatError, match="can only be read"):
        convert_orientation(tmp_path / "a.ori", tmp_path / "b", "patb", "exif")
    with pytest.raises(FormatError, match="must be one of table"):
        convert_orientation(tmp_path / "a.ori", tmp_path / "b", "pat-b", "table")


@pytest.mark.parametrize(
    ("name", "file", "text"),
    [
        ("patb", "x", "1 2 3"),
        ("patb", "x", "101 153 1 2 3 " + "1 " * 9),
        ("metashape-xml", "x", "<document><chunk>"),
        ("metashape-xml", "x", "<kml/>"),
        ("micmac", "x", "<ExportAPERO/>"),
        ("orthority-geojson", "x", "{"),
        ("orthority-geojson", "x", '{"features": [{"properties": {"filename": "a"}}]}'),
        ("orthority-csv", "x", "filename latitude longitude altitude roll pitch yaw\na 1 2 3 4 5 6"),
        ("ign-opk", "x", "a b c"),
        ("pix4d", "x", "imageName X Y Z\na 1 2 3"),
    ],
)
def test_malformed_files(tmp_path, name, file, text):
    (tmp_path / file).write_text(text)
    with pytest.raises(FormatError):
        FORMATS[name].read(tmp_path / file, DECLARED.get(name, Declared()))


def test_cut_off_binary_model(tmp_path):
    FORMATS["colmap-binary"].write(tmp_path, block(), Declared())
    whole = (tmp_path / "images.bin").read_bytes()
    for size in (4, 20, 80, len(whole) - 1):
        (tmp_path / "images.bin").write_bytes(whole[:size])
        with pytest.raises(FormatError, match="cut off"):
            FORMATS["colmap-binary"].read(tmp_path, DECLARED["colmap-binary"])


def test_datums_and_places_of_a_conversion(tmp_path):
    """The transformation between datums is named with its accuracy; places outside a map are refused."""
    ellipsoidal = HeightSystem.ellipsoidal()
    place = MapFrame("EPSG:2056", ellipsoidal)
    centre = np.array([[2_600_000.0, 1_200_000.0, 900.0]])
    swiss = OrientationSet(("a",), centre, np.eye(3)[None], place, "grid")
    moved = converted(swiss, MapFrame("EPSG:25832", ellipsoidal))
    assert any(note.startswith("datums differ: transformed by CH1903+ to ETRS89") for note in moved.notes)
    assert any("accurate to 0.1 m" in note for note in moved.notes)
    FORMATS["table"].write(tmp_path / "a.csv", swiss, Declared())
    declared = Declared(crs="EPSG:2056", heights=ellipsoidal, axes="grid", unit="deg")
    with pytest.raises(CrsError, match=r"out\.csv: crs: 1 of 1 projection centres lie outside"):
        convert_orientation(
            tmp_path / "a.csv",
            tmp_path / "out.csv",
            "table",
            "table",
            declared,
            Declared(crs="EPSG:25835", heights=ellipsoidal),
        )
    assert not (tmp_path / "out.csv").exists()
    swapped = replace(swiss, positions=swiss.positions[:, [1, 0, 2]])
    FORMATS["table"].write(tmp_path / "a.csv", swapped, Declared())
    with pytest.raises(CrsError, match=r"a\.csv.*they would lie inside with x and y exchanged"):
        convert_orientation(tmp_path / "a.csv", tmp_path / "out.csv", "table", "table", declared)
