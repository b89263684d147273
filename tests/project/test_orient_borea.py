"""A real delivery that was adjusted in the grid, ``ign_borea_A``, oriented by its measurements alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stereomate.frames.adjusted import space_from_grid_centres
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.project.orient import orient
from stereomate.project.orient_report import write_orient_report

pytestmark = pytest.mark.real

PROJECT = """
[project]
name = "borea"
crs = "EPSG:2154"
heights = "{data}/fr_ign_RAF20.tif"

[[camera]]
name = "UCE-M3-f120-s06"
size_px = [26460, 17004]
principal_distance_px = 30975.0
pixel_pitch_mm = 0.004
principal_point_px = [13210.0, 8502.0]

[photos]
orientation = "perturbed.OPK"
angles = "grid"
adjusted_in = "{meaning}"

[control]
file = "{data}/gcp_ellipsoidal.app"
heights = "ellipsoidal"
measurements = "{data}/gcp_image.mes"
sigma_m = [0.02, 0.02, 0.02]

[orient]
tie_points = "{data}/tie_points.mes"
position_sigma_m = [0.05, 0.05, 0.05]
calibrate = {calibrate}
"""


def oriented(
    data: Path, folder: Path, meaning: str, calibrate: str, control: bool = True
) -> tuple[Path, dict[str, Any]]:
    """Oriented with the delivered centres as GNSS positions of 5 cm; angles are off by half a degree."""
    rng = np.random.default_rng(3)
    head, *rows = [row for row in (data / "eo_lambert93_ign69.OPK").read_text().splitlines() if row.strip()]
    lines = [head]
    for row in rows:
        name, *numbers, camera = row.split()
        values = np.array(numbers, dtype=float) + np.r_[rng.normal(0.0, 0.05, 3), rng.normal(0.0, 0.5, 3)]
        lines.append("\t".join([name, *(f"{v:.6f}" for v in values), camera]))
    (folder / "perturbed.OPK").write_text("\n".join(lines), encoding="utf-8")
    path = folder / "project.toml"
    text = PROJECT.format(data=data.as_posix(), meaning=meaning, calibrate=calibrate)
    if not control:
        text = text[: text.index("[control]")] + text[text.index("[orient]") :]
        text = text.replace('adjusted_in = "grid"', 'adjusted_in = "grid"\ngrid_reference_height = 60.0')
    path.write_text(text, encoding="utf-8")
    result = orient(path, folder / "out", documents=lambda r: [write_orient_report(r)])
    return folder / "out", result.record


def test_centres_taken_as_true_positions_show_the_half_metre(data_folder: Path, tmp_path: Path) -> None:
    out, record = oriented(data_folder / "ign_borea_A", tmp_path, "space", '"none"')
    # One photograph shows a single point; two show four, and are placed by their position.
    assert [entry["name"] for entry in record["not_oriented"]] == ["23FD1305x00026_01300"]
    assert record["summary"]["oriented"] == 36
    # The control contradicts the heights of all positions, and goes: that is said first, with its cause.
    assert "equation (2) of Ressl (2002)" in record["findings"][0]
    assert 'adjusted_in = "grid"' in record["findings"][0]
    shift = record["comparison"]["positions_shift"]
    assert shift["significant"] == [False, False, True]
    assert shift["grid_excess_m"] == pytest.approx(0.486, abs=0.003)
    assert abs(shift["east_north_up_m"][2] - 0.486) < 4.0 * shift["sigma_m"][2]
    # In the grid with the curvature corrected the points lie deeper by it; with scaled heights they do not.
    rows = record["comparison"]["in_grid"]
    table = {row["method"]: row for row in rows if row["principal_distance"] == "held"}
    # The only control point is out: a free principal distance would be any, and that is said.
    assert ["took part" in row["failed"] for row in rows if row["principal_distance"] == "free"] == [True] * 3
    assert table["P1"]["points_mean_m"][2] == pytest.approx(-0.489, abs=0.003)
    for method in ("M2", "M3"):
        assert max(table[method]["points_rms_m"]) < 0.005
    page = (out / "orient.html").read_text(encoding="utf-8")
    assert "Ressl" in page
    assert "MES_" in page


def test_grid_centres_come_back_with_the_principal_distance_free(data_folder: Path, tmp_path: Path) -> None:
    data = data_folder / "ign_borea_A"
    _, record = oriented(data, tmp_path, "grid", '["principal_distance"]')
    assert record["summary"]["oriented"] == 36
    assert not [line for line in record["findings"] if "Ressl" in line]
    rows = [row.split() for row in (data / "eo_lambert93_ign69.OPK").read_text().splitlines()[1:]]
    delivered = {row[0]: np.array(row[1:4], dtype=float) for row in rows if row}
    photos = record["photographs"]
    frame = MapFrame("EPSG:2154", HeightSystem.grid_file(data / "fr_ign_RAF20.tif"))
    level = record["control"]["control"]["points"][0]["given"][2]
    true = space_from_grid_centres(frame, [delivered[p["name"]] for p in photos], level).centres
    off = np.array([p["position"] for p in photos]) - true
    sigma = np.array([p["standard_deviation_m"] for p in photos])
    # The delivery has an accuracy of its own, 5 cm.
    assert np.abs(off / np.hypot(sigma, 0.05)).max() < 5.0
    assert np.abs(off.mean(axis=0)).max() < 0.03
    found = record["cameras"][0]["parameters"]["principal_distance_mm"]
    assert abs(found["value"] - 123.9) < 5.0 * found["standard_deviation"]


def test_positions_are_not_condemned_for_decentring_that_is_found_with_the_principal_point_held(
    data_folder: Path, tmp_path: Path
) -> None:
    """Decentring needs the principal point to move with it: 0.4 m to the side of the camera, strip by strip.

    The strips fly there and back, so the middle one seems shifted by twice that against the others; without
    control nothing tells which of them, or that it is the camera.
    """
    data = data_folder / "ign_borea_A"
    _, record = oriented(data, tmp_path, "grid", '["k1", "k2", "p1", "p2"]', control=False)
    assert record["summary"]["oriented"] == 36
    out = [error for error in record["gross_errors"] if error["kind"] == "positions"]
    assert len(out) <= 4
    (line,) = [line for line in record["findings"] if "contradict each other" in line]
    assert "or whether the camera is off (a lever arm, a principal point" in line
    (taken, *_) = record["navigation"]["taken_as_shifted"]
    assert taken["kind"] == "mount"
    assert taken["shift_m"][1] == pytest.approx(0.4, abs=0.1)
    assert not [line for line in record["findings"] if "inner constraints" in line]
