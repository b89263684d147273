"""IGN text files: observations, ground points, orientations."""

from __future__ import annotations

import numpy as np
import pytest

from stereomate.errors import FormatError, StorageError
from stereomate.formats.ign import ImageObservations, read_ground_points, read_mes, write_mes
from stereomate.formats.orientation_table import read_orientation_table


def test_observations_there_and_back(tmp_path):
    path = tmp_path / "ties.mes"
    pixels = np.array([[5071.56, 13110.12], [0.25, 17003.999999]])
    write_mes(path, ImageObservations(("MES 1", "2"), ("strip_1", "strip_2"), pixels))
    assert path.read_text().startswith('"MES 1" strip_1 5071.560000')
    found = read_mes(path)
    assert found.points == ("MES 1", "2")
    assert found.photographs == ("strip_1", "strip_2")
    np.testing.assert_allclose(found.pixels, pixels, atol=5e-7)
    with pytest.raises(StorageError, match="cannot write"):
        write_mes(tmp_path / "absent" / "ties.mes", found)


def test_ground_points_with_and_without_class(tmp_path):
    path = tmp_path / "control.app"
    path.write_text('# control\n"1003" 13 815601.510 6283629.280 54.960 \n')
    found = read_ground_points(path)
    assert found.names == ("1003",)
    np.testing.assert_array_equal(found.xyz, [[815601.510, 6283629.280, 54.960]])
    path.write_text("a 1 2 3\nb 4 5 6\n")
    np.testing.assert_array_equal(read_ground_points(path).xyz, [[1, 2, 3], [4, 5, 6]])


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        ("a p 1\n", "line 1: must hold point, photograph"),
        ("a p 1 2\na p 3 4\n", r"observes point a in p again \(first in line 1\)"),
        ("a p 1 x\n", "must be a number, got 'x'"),
        ("a p 1 nan\n", "must be a number"),
        ("\n# only a comment\n", "holds no point"),
    ],
)
def test_wrong_observations(tmp_path, text, rule):
    path = tmp_path / "ties.mes"
    path.write_text(text)
    with pytest.raises(FormatError, match=rule):
        read_mes(path)


def test_wrong_ground_points(tmp_path):
    path = tmp_path / "control.app"
    path.write_text("a 1 2 3\na 1 2 3\n")
    with pytest.raises(FormatError, match="holds a point twice"):
        read_ground_points(path)
    path.write_text("a 1 2\n")
    with pytest.raises(FormatError, match="must hold point"):
        read_ground_points(path)
    with pytest.raises(FormatError, match="does not exist"):
        read_ground_points(tmp_path / "absent.app")


@pytest.mark.real
def test_the_real_files(data_folder):
    folder = data_folder / "ign_borea_A"
    ties = read_mes(folder / "tie_points.mes")
    assert len(ties.points) == 8873
    assert len(set(ties.points)) == 1782
    assert read_ground_points(folder / "gcp_ellipsoidal.app").names == ("1003",)
    assert len(read_ground_points(folder / "tie_points_world_ellipsoidal.mes").names) == 1726
    table = read_orientation_table(folder / "eo_lambert93_ign69.OPK")
    assert len(table.rows) == 37
    assert {"filename", "x", "y", "z", "omega", "phi", "kappa", "camera"} <= set(table.columns)
    assert table.rows[0].numbers["omega"] == -0.589651498225
