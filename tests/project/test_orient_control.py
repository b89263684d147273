"""`stereomate orient` with control points as the only datum."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from run_survey import write_tiny

from stereomate.frames.transform import tangent_from_map
from stereomate.project import load
from stereomate.project.orient import orient


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six rendered photographs in two strips; without control points of their own."""
    folder = tmp_path_factory.mktemp("survey")
    path = write_tiny(folder, strips=2, size_px=(480, 360), control_points=0)
    with path.open("a", encoding="utf-8") as file:
        file.write(
            '\n[orient]\ncalibrate = "none"\nposition_sigma_m = [0.1, 0.1, 0.1]\n'
            "features = 1200\npoints_per_photo = 120\n"
        )
    return path


def test_control_points_alone_place_the_block_and_check_points_tell_how_well(
    survey: Path, tmp_path: Path
) -> None:
    """No positions: eight control points, one without height, one with swapped x and y; four check points."""
    shutil.copytree(survey.parent, tmp_path / "copy")
    path = tmp_path / "copy" / survey.name
    truth = load(survey)
    heights = truth.require_heights()
    centres = truth.survey.centres_map[:, :2]
    rng = np.random.default_rng(3)
    low, high = centres.min(axis=0), centres.max(axis=0)
    xy = rng.uniform(low, high, (12, 2))
    xyz = np.column_stack([xy, heights.heights_at(xy)])
    ground = tangent_from_map(truth.tangent, truth.frame, xyz)
    measured = ["point,photograph,col,row,sigma"]
    for photo in truth.survey.photographs:
        pixels, inside = photo.camera.image_from_camera(photo.orientation.camera_from_tangent(ground))
        for k in np.flatnonzero(inside):
            col, row = pixels[k] + rng.normal(0, 0.1, 2)
            measured.append(f"g{k},{photo.path.name},{col:.3f},{row:.3f},0.1")
    rows = ["name,x,y,z,role"]
    for k, (x, y, z) in enumerate(xyz):
        height = "" if k == 5 else f"{z:.3f}"
        x, y = (y, x) if k == 7 else (x, y)
        rows.append(f"g{k},{x:.3f},{y:.3f},{height},{'check' if k >= 8 else 'xy' if k == 5 else 'control'}")
    (path.parent / "gcp.csv").write_text("\n".join(rows), encoding="utf-8")
    (path.parent / "gcp_px.csv").write_text("\n".join(measured), encoding="utf-8")
    text = path.read_text(encoding="utf-8")
    kept = [
        line
        for line in text.splitlines()
        if not line.startswith(("orientation", "angles", "adjusted_in", "angle_", "position_sigma"))
    ]
    kept += ["[control]", 'file = "gcp.csv"', 'measurements = "gcp_px.csv"', "sigma_m = [0.05, 0.05, 0.05]"]
    path.write_text("\n".join(kept), encoding="utf-8")
    record = orient(path, tmp_path / "out").record
    assert record["summary"]["oriented"] == 6
    # The tangent frame lies at the block, wherever the swapped point is.
    origin = record["frame"]["tangent_origin"][:2]
    assert np.hypot(*(np.array(origin) - (truth.tangent.longitude_deg, truth.tangent.latitude_deg))) < 0.01
    assert any("g7 contradicts the others" in finding for finding in record["findings"])
    check = record["control"]["check"]
    assert check["count"] == 4
    # The pixel of this camera is half a metre on the ground.
    assert max(check["rms_m"]) < 0.5
    found = load(tmp_path / "out" / "oriented.toml").survey
    assert np.abs(found.centres_map - truth.survey.centres_map).max() < 1.0
