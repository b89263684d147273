"""Control points with their standard deviations, and image measurements, of every form that is read."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pyogrio
import pytest
import shapely

from stereomate.errors import FormatError
from stereomate.formats.control_points import read_control_points
from stereomate.formats.image_points import read_image_points


def written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def test_csv_with_deviations_roles_and_missing_axes(tmp_path: Path) -> None:
    path = written(
        tmp_path / "gcp.csv",
        "# surveyed 2020\nPoint;E;N;H;sxy;sz;role\n1;500.5;600.25;70;0.01;0.02;\nP2;1;2;;;;control\n"
        "7;10;20;30;;;check\n8;10;20;30;;;xy\n9;1;2;3;;;z\n",
    )
    points = {point.name: point for point in read_control_points(path).points}
    assert points["1"].xyz == (500.5, 600.25, 70.0)
    assert points["1"].sigma_m == (0.01, 0.01, 0.02)
    assert math.isnan(points["P2"].xyz[2])
    assert math.isnan(points["P2"].sigma_m[0])
    assert points["7"].check
    assert not points["8"].check
    assert math.isnan(points["8"].xyz[2])
    assert math.isnan(points["9"].xyz[0])
    assert points["9"].xyz[2] == 3.0


def test_text_by_blanks_with_and_without_header(tmp_path: Path) -> None:
    with_header = written(tmp_path / "a.txt", 'name x y z sigma\n"A 1" 1 2 3 0.05\nB 4 5 6 0.1\n')
    points = read_control_points(with_header).points
    assert points[0].name == "A 1"
    assert points[0].sigma_m == (0.05, 0.05, 0.05)
    without = written(tmp_path / "b.txt", "A 1 2 3\nB 4 5 6\n")
    points = read_control_points(without, ("name", "x", "y", "z")).points
    assert points[1].xyz == (4.0, 5.0, 6.0)
    with pytest.raises(FormatError, match=r"must have the columns name, x, y, z"):
        read_control_points(without)


def test_geographic_columns(tmp_path: Path) -> None:
    path = written(tmp_path / "g.csv", "id,lon,lat,height\na,-92.0,46.8,180\n")
    file = read_control_points(path)
    assert file.geographic
    assert file.points[0].xyz == (-92.0, 46.8, 180.0)


def test_geopackage(tmp_path: Path) -> None:
    path = tmp_path / "gcp.gpkg"
    shapes = shapely.to_wkb([shapely.Point(1, 2, 3), shapely.Point(4, 5, 6)], output_dimension=3)
    columns = [np.array(["a", "b"], object), np.array([0.01, np.nan]), np.array(["", "check"], object)]
    pyogrio.raw.write(
        path, shapes, columns, ["name", "sz", "role"], geometry_type="Point Z", crs="EPSG:32615",
        driver="GPKG",
    )  # fmt: skip
    file = read_control_points(path)
    assert "32615" in file.crs
    assert file.points[0].xyz == (1.0, 2.0, 3.0)
    assert file.points[0].sigma_m[2] == 0.01
    assert file.points[1].check


GCP_LIST = """WGS84 UTM 15N
# a comment
576529.22 5188003.21 180.5 300.25 2500.0 IMG_1.JPG gcp01
576529.22 5188003.21 180.5 1200.0 800.0 IMG_2.JPG gcp01
576600.0 5188100.0 181.0 50.0 60.0 IMG_1.JPG
576600.0 5188100.0 181.0 70.0 80.0 IMG_2.JPG
"""


def test_gcp_list_of_odm(tmp_path: Path) -> None:
    """CRS in the first line, one measurement a line; points without a name are told by their coordinates."""
    file = read_control_points(written(tmp_path / "gcp_list.txt", GCP_LIST))
    assert file.crs == "EPSG:32615"
    assert [point.name for point in file.points] == ["gcp01", "gcp1"]
    measurements = file.measurements
    assert measurements is not None
    assert measurements.points == ("gcp01", "gcp01", "gcp1", "gcp1")
    assert measurements.photographs[1] == "IMG_2.JPG"
    np.testing.assert_array_equal(measurements.pixels[0], [300.25, 2500.0])
    contradicting = GCP_LIST + "1.0 2.0 3.0 5 6 IMG_3.JPG gcp01\n"
    with pytest.raises(FormatError, match=r"line 7.*gives point gcp01 other coordinates"):
        read_control_points(written(tmp_path / "bad.txt", contradicting))
    twice = GCP_LIST + "576529.22 5188003.21 180.5 301 2500.0 IMG_1.JPG gcp01\n"
    with pytest.raises(FormatError, match=r"gcp01 in IMG_1.JPG twice"):
        read_control_points(written(tmp_path / "twice.txt", twice))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name,x,y,z\na,1,2,x3\n", r"line 2: z.*must be a number.*x3"),
        ("name,x,y,z\na,1,2,3\na,1,2,3\n", r"names a point twice.*a"),
        ("name,x,y,z,sz\na,1,2,3,-0.1\n", r"line 2: sz.*must be positive"),
        ("name,x,y,z\na,,,\n", r"line 2.*must have a coordinate"),
        ("name,x,y,z\na,1,,3\n", r"line 2.*both plan coordinates"),
        ("name,x,y,z,role\na,1,2,3,maybe\n", r"line 2: role.*must be control, check, xy or z"),
        ("name,x,y,z\na,1,2,3,4\n", r"line 2.*5 values for 4 columns"),
        ("name,x,x,z\na,1,2,3\n", r"column x twice"),
        ("# nothing\n", r"holds no point"),
    ],
)
def test_wrong_tables_are_named(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(FormatError, match=message):
        read_control_points(written(tmp_path / "p.csv", text))


def test_image_measurements_as_text(tmp_path: Path) -> None:
    path = written(tmp_path / "m.csv", "point,photo,col,row,sigma\nA,one.jpg,1.5,2.5,0.3\nA,two.jpg,3,4,\n")
    found = read_image_points(path)
    assert found.points == ("A", "A")
    assert found.sigma_px[0] == 0.3
    assert math.isnan(found.sigma_px[1])
    blanks = written(tmp_path / "m.txt", "A one.jpg 1.5 2.5\nB one.jpg 3 4\n")
    np.testing.assert_array_equal(read_image_points(blanks).pixels, [[1.5, 2.5], [3.0, 4.0]])
    for text, message in (
        ("A one.jpg 1.5\n", r"line 1.*point, photograph, column, row"),
        ("A one.jpg 1 2\nA one.jpg 1 2\n", r"measures point A in one.jpg twice"),
        ("A one.jpg 1 2 -1\n", r"line 1.*positive"),
        ("A one.jpg 1 2\nB one.jpg nan 2\n", r"line 2.*must be a number"),
        ("# none\n", r"holds no measurement"),
    ):
        with pytest.raises(FormatError, match=message):
            read_image_points(written(tmp_path / "bad.txt", text))


def test_tracks_of_opensfm(tmp_path: Path) -> None:
    """Normalised by the longer side from the middle: a corner of 4000 x 3000 pixels is (-0.5, -0.375)."""
    text = (
        "OPENSFM_TRACKS_VERSION_v2\n"
        "a.jpg\t0\t17\t-0.5\t-0.375\t0.004\t10\t20\t30\t-1\t-1\n"
        "b.jpg\t0\t18\t0\t0\t0.004\t10\t20\t30\t-1\t-1\n"
    )
    sizes = {"a.jpg": (4000, 3000), "b.jpg": (3000, 4000)}
    found = read_image_points(written(tmp_path / "tracks.csv", text), sizes.get)
    np.testing.assert_allclose(found.pixels, [[0.0, 0.0], [1500.0, 2000.0]])
    assert found.points == ("0", "0")
    with pytest.raises(FormatError, match=r"size is not known.*b\.jpg"):
        read_image_points(tmp_path / "tracks.csv", {"a.jpg": (4000, 3000)}.get)


@pytest.mark.real
def test_mes_of_borea(data_folder: Path) -> None:
    found = read_image_points(data_folder / "ign_borea_A" / "tie_points.mes")
    assert len(found.points) == 8873
    assert len(set(found.photographs)) == 37
