"""`stereomate convert`: what it writes, what it says, what it refuses."""

from __future__ import annotations

import json

import numpy as np
import pytest

from stereomate.cli import main

TABLE = "filename;x;y;z;omega;phi;kappa\na;691000;5332000;800;0.5;-0.3;30\nb;691100;5332000;800;0.1;0.2;31\n"
DECLARED = (
    "--from-crs",
    "EPSG:32632",
    "--from-axes",
    "grid",
    "--from-unit",
    "gon",
    "--from-heights",
    "ellipsoidal",
)


def convert(*arguments):
    try:
        main.run(["convert", *map(str, arguments)])
    except SystemExit as stop:
        return stop.code or 0
    return 0


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "eo.csv"
    path.write_text(TABLE)
    return path


def test_orientation_to_other_angles_and_back(tmp_path, table, capsys):
    there, back = tmp_path / "there.csv", tmp_path / "back.csv"
    code = convert(
        "orientation", table, there, "--from", "table", "--to", "table", *DECLARED,
        "--to-crs", "EPSG:4979", "--to-order", "rph", "--to-mount", "y_forward", "--to-unit", "rad", "--json",
    )  # fmt: skip
    assert code == 0
    said = json.loads(capsys.readouterr().out)
    assert said["photographs"] == 2
    assert any("omega-phi-kappa in gon about axes grid" in note for note in said["notes"])
    assert any("ppm" in note for note in said["notes"])
    code = convert(
        "orientation", there, back, "--from", "table", "--to", "table", "--from-crs", "EPSG:4979",
        "--from-axes", "local", "--from-unit", "rad", "--from-mount", "y_forward",
        "--to-crs", "EPSG:32632", "--to-heights", "ellipsoidal", "--to-axes", "grid", "--to-unit", "gon",
    )  # fmt: skip
    assert code == 0
    rows = [line.split(",") for line in back.read_text().splitlines() if line[:2] in ("a,", "b,")]
    found = np.array([[float(cell) for cell in row[1:7]] for row in rows])
    expected = np.array([[float(cell) for cell in line.split(";")[1:]] for line in TABLE.splitlines()[1:]])
    np.testing.assert_allclose(found, expected, rtol=0, atol=1.1e-4)
    np.testing.assert_allclose(found[:, 3:], expected[:, 3:], rtol=0, atol=1e-7)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--from", "table", "--to", "table"), "EPSG:25832"),
        (("--from", "table", "--to", "table", "--from-crs", "EPSG:32632"), "grid_east_north"),
        (("--from", "tabel", "--to", "table"), "must be one of table"),
        (("--from", "table", "--to", "table", "--from-unit", "degrees"), "--from-unit: must be one of deg"),
        (
            ("--from", "table", "--to", "table", "--from-offset", "1,2"),
            "--from-offset: must be three numbers",
        ),
        (("--from", "table", "--to", "colmap-text", *DECLARED), "needs the camera"),
        (("--from", "table", "--to", "patb", *DECLARED), "object_from_camera"),
        (("--from", "table", "--to", "pix4d", *DECLARED, "--to-crs", "EPSG:4979"), "holds map coordinates"),
        (
            ("--from", "table", "--to", "table", *DECLARED, "--to-crs", "EPSG:4979", "--to-axes", "grid"),
            "axes",
        ),
    ],
)
def test_refused_with_the_possibilities(tmp_path, table, capsys, options, message):
    out = tmp_path / "out"
    assert convert("orientation", table, out, *options) == 2
    assert message in capsys.readouterr().err
    assert not out.exists()


def test_cameras_from_a_file(tmp_path, table):
    cameras = tmp_path / "cameras.toml"
    cameras.write_text(
        '[[camera]]\nname = "lens"\nsize_px = [4000, 3000]\n'
        "principal_distance_mm = 35.0\n"
        "sensor_mm = [40.0, 30.0]\n"
    )
    out = tmp_path / "model"
    code = convert(
        "orientation", table, out, "--from", "table", "--to", "colmap-text", *DECLARED, "--cameras", cameras,
        "--to-offset", "691000,5332000,0",
    )  # fmt: skip
    assert code == 0
    assert "PINHOLE 4000 3000 3500.0 3500.0 2000.0 1500.0" in (out / "cameras.txt").read_text()


def test_points_from_a_tangent_frame(tmp_path, capsys):
    path, out = tmp_path / "a.xyz", tmp_path / "b.xyz"
    path.write_text("0 0 0\n2000 0 0\n5000 0 0\n")
    code = convert(
        "points",
        path,
        out,
        "--from-origin",
        "11.5,48.1,500",
        "--to-crs",
        "EPSG:32632",
        "--to-heights",
        "ellipsoidal",
    )
    assert code == 0
    assert "3 points" in capsys.readouterr().out
    heights = np.loadtxt(out)[:, 2]
    # Heights above a curved Earth: s squared over two radii of the prime vertical.
    radius = 6378137.0 / np.sqrt(1 - 0.00669438 * np.sin(np.deg2rad(48.1)) ** 2) + 500.0
    np.testing.assert_allclose(
        heights - 500.0, np.array([0.0, 2000.0, 5000.0]) ** 2 / (2 * radius), atol=1e-3
    )


def test_points_need_both_frames(tmp_path, capsys):
    path = tmp_path / "a.xyz"
    path.write_text("0 0 0\n")
    assert convert("points", path, tmp_path / "b.xyz", "--to-crs", "EPSG:32632") == 2
    assert "origin longitude,latitude,height" in capsys.readouterr().err
    assert convert("points", path, tmp_path / "b.xyz", "--from-origin", "11.5,48.1,500") == 2
    assert "--to-crs" in capsys.readouterr().err
    assert (
        convert(
            "points", path, tmp_path / "b.xyz", "--from-origin", "11.5,48.1,500", "--to-crs", "EPSG:32632"
        )
        == 2
    )
    assert "undeclared" in capsys.readouterr().err
