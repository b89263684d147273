"""Footprints, pairs and pixel sizes: simple geometry, oblique views, real flights, bad input."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest
import shapely

from stereomate.camera.distortion import BrownDistortion
from stereomate.camera.model import Camera
from stereomate.coverage.footprints import footprint
from stereomate.coverage.pairs import find_pairs
from stereomate.coverage.summary import survey_coverage
from stereomate.coverage.survey import Photograph, Survey
from stereomate.errors import CoverageError, OrientationError
from stereomate.frames.attitude import AttitudeConvention, object_from_camera
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.orientation import ExteriorOrientation
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import tangent_from_map
from stereomate.terrain.model import HeightModel

FRAME = MapFrame("EPSG:32631", HeightSystem.ellipsoidal())
X0, Y0 = 500000.0, 4900000.0  # on the central meridian: grid north is north, scale 0.9996
TAU = 0.9996
CAMERA = Camera.from_pixel_pitch("cam", (6000, 4000), 50.0, 0.006)  # 36 x 24 mm


def photographs(frame: MapFrame, camera: Camera, rows: list[tuple]) -> Survey:
    """A survey of (name, x, y, z, omega, phi, kappa), angles in degrees about grid axes."""
    centres = np.array([row[1:4] for row in rows], float)
    tangent = TangentFrame.at_map(frame, (*centres[:, :2].mean(axis=0), 0.0))
    places = tangent_from_map(tangent, frame, centres)
    rotations = object_from_camera(
        np.array([row[4:7] for row in rows], float), AttitudeConvention("opk", "grid"), tangent, places, frame
    )
    return Survey(
        frame,
        tangent,
        tuple(
            Photograph(str(row[0]), None, camera, ExteriorOrientation(tuple(place), rotation))
            for row, place, rotation in zip(rows, places, rotations, strict=True)
        ),
    )


def plane(height: float, size: float = 20000.0, cell: float = 50.0) -> HeightModel:
    count = int(size / cell)
    affine = (cell, 0.0, X0 - size / 2, 0.0, -cell, Y0 + size / 2)
    return HeightModel.from_array(np.full((count, count), height), affine, FRAME)


@pytest.mark.parametrize("on_model", [True, False])
def test_a_vertical_photograph(on_model: bool) -> None:
    survey = photographs(FRAME, CAMERA, [("a", X0, Y0, 1200.0, 0, 0, 0)])
    found = footprint(survey, survey.photographs[0], plane(200.0) if on_model else 200.0)
    # 1000 m above ground: 720 m x 480 m, GSD 0.12 m; in the grid times its scale, which includes the height
    assert found.height_above_ground_m == pytest.approx(1000.0, abs=0.02)
    assert found.ground_m == pytest.approx(200.0, abs=0.02)
    assert found.gsd_m == pytest.approx(0.12, rel=2e-4)
    assert found.gsd_max_m / found.gsd_min_m == pytest.approx(1.0, abs=1e-3)
    assert found.tilt_deg == pytest.approx(0.0, abs=1e-4)
    assert found.covered == 1.0
    x0, y0, x1, y1 = found.polygon.bounds
    scale = TAU * (1.0 - 200.0 / 6.37e6)
    assert x1 - x0 == pytest.approx(720.0 * scale, abs=0.05)
    assert y1 - y0 == pytest.approx(480.0 * scale, abs=0.05)
    assert (x0 + x1) / 2 == pytest.approx(X0, abs=0.01)


def test_footprints_on_relief_lie_on_the_rays() -> None:
    x, y = np.meshgrid(np.arange(400), np.arange(400))
    heights = 300.0 + 100.0 * np.sin(x / 20.0) * np.cos(y / 15.0)
    model = HeightModel.from_array(heights, (10.0, 0.0, X0 - 2000, 0.0, -10.0, Y0 + 2000), FRAME)
    survey = photographs(FRAME, CAMERA, [("a", X0, Y0, 1500.0, 6, -9, 33)])
    photograph = survey.photographs[0]
    found = footprint(survey, photograph, model)
    corners = shapely.get_coordinates(found.polygon)[:-1]
    points = tangent_from_map(survey.tangent, FRAME, np.column_stack([corners, model.heights_at(corners)]))
    pixels, _ = photograph.camera.image_from_camera(photograph.orientation.camera_from_tangent(points))
    size = np.array(photograph.camera.size_px)
    from_border = np.minimum(pixels, size - pixels).min(axis=1)
    assert np.abs(from_border).max() < 1e-3
    assert found.tilt_deg == pytest.approx(
        math.degrees(math.acos(math.cos(math.radians(6)) * math.cos(math.radians(9)))), abs=1e-3
    )
    # the mean over all pixels' rays, by a denser grid of its own
    assert found.ground_m == pytest.approx(300.0, abs=25.0)
    assert found.gsd_min_m < found.gsd_m < found.gsd_max_m


def test_partly_covered_photographs_keep_a_whole_footprint() -> None:
    survey = photographs(FRAME, CAMERA, [("a", X0, Y0, 1200.0, 0, 0, 0)])
    whole = footprint(survey, survey.photographs[0], plane(200.0))
    model = plane(200.0)
    heights = model.patch(0, 0, 400, 400).heights
    heights[:, :200] = np.nan  # west of the nadir
    half = footprint(survey, survey.photographs[0], HeightModel.from_array(heights, model.affine, FRAME))
    assert half.covered == pytest.approx(0.5, abs=0.07)
    assert half.polygon.area == pytest.approx(whole.polygon.area, rel=1e-4)


def test_a_view_to_the_horizon_has_a_bounded_footprint() -> None:
    survey = photographs(FRAME, CAMERA, [("a", X0, Y0, 1200.0, 80, 0, 0)])
    found = footprint(survey, survey.photographs[0], 200.0)
    _, y0, _, y1 = found.polygon.bounds
    assert y0 > Y0 + 1000.0 / math.tan(math.radians(10 + 13.5)) - 50
    assert y1 < Y0 + 1000.0 / math.tan(math.radians(8.0)) + 100
    assert found.tilt_deg == pytest.approx(80.0, abs=1e-3)


def test_looking_at_the_sky() -> None:
    survey = photographs(
        FRAME, CAMERA, [("a", X0, Y0, 1200.0, 172.0, 0, 0), ("b", X0, Y0, 1200.0, 100, 0, 0)]
    )
    for photograph in survey.photographs:
        with pytest.raises(OrientationError, match=f"photograph {photograph.name}: looks at the sky"):
            footprint(survey, photograph, 200.0)


def test_not_reaching_the_terrain() -> None:
    survey = photographs(
        FRAME, CAMERA, [("far", X0 + 90000, Y0, 1200.0, 0, 0, 0), ("under", X0, Y0, 150.0, 0, 0, 0)]
    )
    with pytest.raises(CoverageError, match="photograph far: does not reach the height model"):
        footprint(survey, survey.photographs[0], plane(200.0))
    with pytest.raises(CoverageError, match="photograph under: does not reach the height model"):
        footprint(survey, survey.photographs[1], plane(200.0))
    with pytest.raises(CoverageError, match="photograph under: projection centre must be above the ground"):
        footprint(survey, survey.photographs[1], 200.0)


@pytest.mark.parametrize(
    "crs, x, y", [("EPSG:2193", 1.6e6, 5.4e6), ("EPSG:32760", 5e5, 5.5e6), ("EPSG:3031", 0.0, 0.0)]
)
def test_a_height_model_in_another_country(crs: str, x: float, y: float) -> None:
    frame = MapFrame(crs, HeightSystem.ellipsoidal())
    elsewhere = HeightModel.from_array(np.full((50, 50), 100.0), (25.0, 0.0, x, 0.0, -25.0, y), frame)
    with pytest.raises(CoverageError, match="does not reach the height model"):
        survey_coverage(strip(), elsewhere)


def strip() -> Survey:
    """60 % forward overlap along the shorter side, two lines with 30 % side overlap, one flown back."""
    rows = [(f"1-{k}", X0 + 192.0 * k * TAU, Y0, 1200.0, 0, 0, 90) for k in range(4)]
    rows += [(f"2-{k}", X0 + 192.0 * (3 - k) * TAU, Y0 + 504.0 * TAU, 1200.0, 0, 0, -90) for k in range(4)]
    return photographs(FRAME, CAMERA, rows)


def test_pairs_of_a_block() -> None:
    survey = strip()
    result = survey_coverage(survey, plane(200.0))
    assert not result.problems
    pairs = {pair.names: pair for pair in result.pairs}
    forward = pairs["1-0", "1-1"]
    assert forward.overlap == pytest.approx(0.6, abs=1e-3)
    assert forward.base_height == pytest.approx(0.192 * TAU, rel=1e-4)
    assert forward.base_m == pytest.approx(192.0, rel=3e-4)
    assert forward.azimuth_deg == pytest.approx(90.0, abs=1e-6)
    assert pairs["1-0", "1-2"].overlap == pytest.approx(0.2, abs=1e-3)
    assert ("1-0", "1-3") not in pairs
    assert pairs["1-0", "2-3"].overlap == pytest.approx(0.3, abs=1e-3)
    assert math.sin(math.radians(pairs["1-0", "2-3"].azimuth_deg)) == pytest.approx(0.0, abs=1e-5)
    assert pairs["2-0", "2-1"].azimuth_deg == pytest.approx(270.0, abs=1e-3)
    # left is the western one, whatever the order of exposure
    assert pairs["2-0", "2-1"].left_right() == (5, 4)
    assert forward.left_right() == (0, 1)
    assert forward.left_right(math.pi) == (1, 0)
    assert result.gsd_m == pytest.approx(0.12, rel=3e-4)
    width = 3 * 192 + 480
    assert result.area.area == pytest.approx(width * (504 + 720) * TAU**2, rel=2e-3)
    assert result.stereo_area.area < result.area.area
    assert result.covered == 1.0


def test_one_bad_photograph_does_not_stop_the_others() -> None:
    good = strip()
    sky = photographs(FRAME, CAMERA, [("sky", X0, Y0, 1200.0, 180, 0, 0)]).photographs[0]
    survey = Survey(good.frame, good.tangent, (*good.photographs[:2], sky, *good.photographs[2:]))
    result = survey_coverage(survey, plane(200.0))
    assert result.footprints[2] is None
    assert [type(p) for p in result.problems] == [OrientationError]
    assert result.pairs[0].names == ("1-0", "1-1")
    assert {i for p in result.pairs for i in (p.first, p.second)} == {0, 1, 3, 4, 5, 6, 7, 8}
    with pytest.raises(OrientationError, match="sky"):
        survey_coverage(Survey(good.frame, good.tangent, (sky,)), plane(200.0))


def test_coincident_centres_make_no_pair() -> None:
    survey = photographs(FRAME, CAMERA, [("a", X0, Y0, 1200.0, 0, 0, 0), ("b", X0, Y0, 1200.0, 0, 1, 0)])
    prints = [footprint(survey, p, 200.0) for p in survey.photographs]
    assert find_pairs(survey, prints) == []


def test_surveys_are_checked() -> None:
    survey = strip()
    assert survey.index("2-1") == 5
    np.testing.assert_allclose(survey.centres_map[0], (X0, Y0, 1200.0), atol=1e-6)
    with pytest.raises(OrientationError, match="no photograph of this name"):
        survey.index("9")
    with pytest.raises(OrientationError, match="unique, got '1-0'"):
        Survey(survey.frame, survey.tangent, survey.photographs[:1] * 2)
    with pytest.raises(OrientationError, match="at least one photograph"):
        Survey(survey.frame, survey.tangent, ())


def table(path: Path, delimiter: str = ",", quote: str = '"') -> list[tuple]:
    with path.open() as file:
        rows = list(csv.DictReader(file, delimiter=delimiter, quotechar=quote))
    return [(r["filename"], *(float(r[k]) for k in ("x", "y", "z", "omega", "phi", "kappa"))) for r in rows]


@pytest.mark.real
def test_ngi(data_folder: Path) -> None:
    """Facts of the data page: GSD 5.8-6.1 m, 4.9 km above ground, overlap 33 %, B/H 0.54; left is 0184."""
    folder = data_folder / "ngi_strip05"
    frame = MapFrame(
        "+proj=tmerc +lat_0=0 +lon_0=25 +k=1 +x_0=0 +y_0=0 +ellps=WGS84 +units=m", HeightSystem.undeclared()
    )
    camera = Camera.from_pixel_pitch("DMC", (640, 1152), 120.0, 0.144)
    survey = photographs(frame, camera, table(folder / "ngi_xyz_opk.csv"))
    model = HeightModel.open(folder / "dem.tif", HeightSystem.undeclared())
    result = survey_coverage(survey, model)
    for found in result.known:
        assert 5.8 <= found.gsd_m <= 6.1
        assert found.height_above_ground_m == pytest.approx(4900, abs=100)
        assert found.covered > 0.9
        assert found.tilt_deg < 0.6
    (pair,) = result.pairs
    assert pair.overlap == pytest.approx(0.33, abs=0.01)
    assert pair.base_height == pytest.approx(0.54, abs=0.01)
    left, right = pair.left_right()
    assert "0184" in survey.photographs[left].name
    assert "0182" in survey.photographs[right].name


@pytest.mark.real
def test_tuniu(data_folder: Path) -> None:
    """Tilted by about 30 degrees with Brown distortion, over a surface model of 0.8 m; overlap up to 54 %."""
    folder = data_folder / "odm_tuniu"
    frame = MapFrame("EPSG:32651", HeightSystem.undeclared())
    with (folder / "odm/opensfm/reconstruction.json").open() as file:
        (given,) = json.load(file)[0]["cameras"].values()
    width, height = given["width"], given["height"]
    camera = Camera.from_focal_lengths(
        "fc6310r",
        (width, height),
        (given["focal_x"] * width, given["focal_y"] * width),
        (width / 2 + given["c_x"] * width, height / 2 + given["c_y"] * width),
        BrownDistortion(**{name: given[name] for name in ("k1", "k2", "k3", "p1", "p2")}),
    )
    survey = photographs(frame, camera, table(folder / "odm_xyz_opk.csv", " ", "'"))
    model = HeightModel.open(folder / "odm/odm_dem/dsm.tif", HeightSystem.undeclared())
    result = survey_coverage(survey, model)
    assert len(result.known) == 4
    for found in result.known:
        assert found.tilt_deg == pytest.approx(29.5, abs=1.5)
        assert found.gsd_max_m > 1.5 * found.gsd_min_m
    assert max(pair.overlap for pair in result.pairs) == pytest.approx(0.52, abs=0.03)
