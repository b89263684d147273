"""`stereomate georef audit` on a real delivery, and what it cannot audit."""

from __future__ import annotations

import json
import shutil

import pytest

from stereomate.cli import main
from stereomate.errors import OrientationError, ProjectError
from stereomate.project.audit import audit_project

PROJECT = """
[project]
crs = "EPSG:2154"
heights = "ellipsoidal"

[[camera]]
name = "UCE-M3-f120-s06"
size_px = [26460, 17004]
principal_distance_px = 30975.0
principal_point_px = [13210.0, 8502.0]

[photos]
files = "*.jp2"
orientation = "eo_lambert93_ign69.OPK"

[control]
file = "gcp_ellipsoidal.app"

[observations]
files = ["tie_points.mes", "gcp_image.mes"]
points = "tie_points_world_ellipsoidal.mes"
"""


@pytest.fixture(scope="module")
def borea(data_folder, tmp_path_factory):
    """The delivery with a project file that declares neither angles nor heights nor the adjustment."""
    folder = tmp_path_factory.mktemp("borea")
    for file in (data_folder / "ign_borea_A").iterdir():
        shutil.copyfile(file, folder / file.name)
    (folder / "project.toml").write_text(PROJECT)
    return folder / "project.toml"


@pytest.mark.real
def test_the_frame_of_a_real_delivery(borea, capsys):
    with pytest.raises(SystemExit) as end:
        main.run(["georef", "audit", str(borea), "--json", "--figure", str(borea.parent / "audit.svg")])
    assert end.value.code == 0
    value = json.loads(capsys.readouterr().out)
    says = {finding["key"]: finding for finding in value["findings"]}
    assert says["photos.heights"]["value"] == '"fr_ign_RAF20.tif"'
    assert "NGF-IGN69" in says["photos.heights"]["sentence"]
    assert says["control.heights"]["value"] == '"ellipsoidal"'
    assert says["photos.adjusted_in"]["value"] == '"grid"'
    assert says["photos.angles"]["value"] == '"grid"'
    assert {finding["sure"] for finding in says.values()} == {"practically certain"}

    best = value["hypotheses"][0]
    x, y = best["image_rms_px"]
    assert x < 0.1455
    assert y < 0.1875
    east, north, up = best["points"]["mean"]
    assert max(abs(east), abs(north)) < 0.01
    assert abs(up) < 0.0205
    assert best["points"]["std"][2] < 0.0205
    control = best["control"]["mean"]
    assert abs(control[0]) < 0.01
    assert abs(control[1]) < 0.03
    assert abs(control[2]) < 0.04

    rigorous = next(h for h in value["hypotheses"] if h["work"] == "space")
    assert rigorous["heights"] == "fr_ign_RAF20.tif"
    assert rigorous["points"]["mean"][2] == pytest.approx(0.508, abs=0.002)
    assert value["scale_excess_m"] == pytest.approx(0.486, abs=0.01)
    assert any("Earth curvature" in line and "0.027 m" in line for line in value["undecided"])
    assert value["explained"]
    assert "height +0.019 m" in (borea.parent / "audit.svg").read_text()


@pytest.mark.real
def test_the_geoid_that_is_missing(borea, tmp_path):
    for file in borea.parent.iterdir():
        if file.suffix != ".tif":
            shutil.copyfile(file, tmp_path / file.name)
    found = audit_project(tmp_path / "project.toml")
    assert not found.audit.explained
    assert found.audit.best.points.mean[2] == pytest.approx(-49.0, abs=0.5)
    assert any("NGF-IGN69" in name for name in found.registered)


def test_what_a_project_needs(small):
    with pytest.raises(ProjectError, match=r"observations: must be given.*ties\.mes"):
        audit_project(small.path, photographs=False)
    small.replace("project.toml", "[terrain]", '[observations]\nfiles = "ties.mes"\n\n[terrain]')
    small.write("ties.mes", "a other 1 2\n")
    with pytest.raises(OrientationError, match="no observation is in an oriented photograph"):
        audit_project(small.path)
    small.write(
        "ties.mes", "a photo_1 10 20\na photo_2 14 20\nb photo_1 30 20\nb photo_2 34 20\na other 1 2\n"
    )
    found = audit_project(small.path)
    assert any("1 photographs without orientation" in note for note in found.notes)
    assert any("without points of known ground" in line for line in found.audit.undecided)


@pytest.mark.real
def test_photographs_turned_against_their_yaw(data_folder, tmp_path, capsys):
    """Brighton Beach as `init` drafts it: the yaw of 24 to 29 is that of the flight, not of the pixels."""
    for file in (data_folder / "brighton_beach" / "images").iterdir():
        (tmp_path / file.name).symlink_to(file)
    with pytest.raises(SystemExit):
        main.run(["init", str(tmp_path)])
    capsys.readouterr()
    with pytest.raises(SystemExit) as end:
        main.run(["georef", "audit", str(tmp_path / "project.toml"), "--json"])
    assert end.value.code == 0
    value = json.loads(capsys.readouterr().out)
    assert sorted(value["turned"]) == [f"DJI_00{number}" for number in range(24, 30)]
    assert all(abs(abs(turn) - 180.0) < 10.0 for turn in value["turned"].values())
    assert len(value["turns"]) == 18
