"""`stereomate orient` on measurements alone: no photographs, only the sizes of their cameras."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from measured_block import FRAME, MeasuredBlock, measured_block

from stereomate.errors import HeightSystemError, ProjectError
from stereomate.frames.attitude import AttitudeConvention, object_from_camera
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import map_from_tangent, tangent_from_map
from stereomate.measurement.database import CameraRow, ImageRow, MeasurementDatabase, PairRow
from stereomate.measurement.features import Features
from stereomate.measurement.matching import Matches
from stereomate.project import load
from stereomate.project.orient import orient
from stereomate.project.orient_inputs import read_orient_inputs

SIGMA = "position_sigma_m = [0.05, 0.05, 0.05]"


@pytest.fixture(scope="module")
def block() -> MeasuredBlock:
    return measured_block()


def positions(block: MeasuredBlock) -> np.ndarray:
    return block.centres + np.random.default_rng(1).normal(0.0, 0.05, block.centres.shape)


def test_measurements_and_positions_orient_the_block(block: MeasuredBlock, tmp_path: Path) -> None:
    path = block.write(tmp_path, positions=positions(block), orient=SIGMA)
    result = orient(path, tmp_path / "out")
    record = result.record
    assert record["summary"]["oriented"] == 8
    assert record["summary"]["sigma0"] == pytest.approx(1.0, abs=0.1)
    order = [block.names.index(entry["name"]) for entry in record["photographs"]]
    found = np.array([entry["position"] for entry in record["photographs"]])
    sigma = np.array([entry["standard_deviation_m"] for entry in record["photographs"]])
    assert np.abs((found - block.centres[order]) / sigma).max() < 4.0
    assert not [line for line in record["findings"] if "heights of the positions" in line]
    # Nothing to make products of, but a flight to judge.
    survey = load(tmp_path / "out" / "oriented.toml", planned=True).survey
    assert [photo.name for photo in survey.photographs] == sorted(block.names)


def test_antenna_is_not_the_camera_and_what_was_stated_of_it_is_fitted(
    block: MeasuredBlock, tmp_path: Path
) -> None:
    """An antenna half a metre off, stated four times as bad as it is; errors met by the sum of residuals."""
    convention = AttitudeConvention("opk", "local", "deg")
    tangent = TangentFrame.at_map(FRAME, block.centres.mean(axis=0))
    centres = tangent_from_map(tangent, FRAME, block.centres)
    rotations = object_from_camera(block.opk_deg, convention, tangent, centres, None)
    arm = (0.4, -0.2, 0.5)
    antenna = map_from_tangent(tangent, FRAME, centres + rotations @ np.array(arm))
    antenna += np.random.default_rng(1).normal(0.0, 0.05, antenna.shape)
    keys = f"""position_sigma_m = [0.2, 0.2, 0.2]
lever_arm_m = {list(arm)}
robust = "l1"
variance_components = true
"""
    record = orient(block.write(tmp_path, positions=antenna, orient=keys), tmp_path / "out").record
    order = [block.names.index(entry["name"]) for entry in record["photographs"]]
    found = np.array([entry["position"] for entry in record["photographs"]])
    assert np.abs(found - block.centres[order]).max() < 0.25
    (fitted,) = [line for line in record["findings"] if "variance components" in line and "fitted" in line]
    factor = float(fitted.split("positions plan ")[1].split()[0])
    assert 0.12 < factor < 0.5
    sigma = np.array([entry["standard_deviation_m"] for entry in record["photographs"]])
    assert np.abs((found - block.centres[order]) / sigma).max() < 4.5


def test_names_points_seen_once_and_points_outside_are_said(block: MeasuredBlock, tmp_path: Path) -> None:
    path = block.write(tmp_path)
    ties = tmp_path / "ties.txt"
    rows = ties.read_text(encoding="utf-8").splitlines()
    # A gross error of 40 px, a column beyond the photograph, a point in one photograph only.
    wrong = next(k for k, row in enumerate(rows) if sum(r.startswith(row[:5]) for r in rows) >= 6)
    name, photo, col, row, sigma = rows[wrong].split()
    rows[wrong] = f"{name} {photo} {float(col) + 40.0:.3f} {row} {sigma}"
    rows += ["far s0_0 3500 200 0.2", "far s0_1 100 200 0.2", "once s0_2 100 200 0.2"]
    ties.write_text("\n".join(rows), encoding="utf-8")
    record = orient(path, tmp_path / "out").record
    assert record["frame"]["datum"] == "none"
    assert record["summary"]["oriented"] == 8
    findings = " | ".join(record["findings"])
    assert "1 tie point measurements lie outside their photograph and are left out: far in s0_0" in findings
    assert "tie points are measured in one photograph only" in findings
    (largest, *_) = record["gross_errors"]
    assert largest["place"] == f"{name} in {photo}"
    assert largest["size"][0] == pytest.approx(40.0, abs=1.5)


def test_without_photographs_and_measurements_nothing_can_be_done(
    block: MeasuredBlock, tmp_path: Path
) -> None:
    path = block.write(tmp_path)
    text = path.read_text(encoding="utf-8").replace('tie_points = "ties.txt"', "")
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ProjectError, match=r"photos\.files: must be given.*orient\.tie_points"):
        orient(path, tmp_path / "out")


def test_heights_in_feet_are_seen_by_the_ups_and_downs_of_the_flight(
    block: MeasuredBlock, tmp_path: Path
) -> None:
    wrong = positions(block)
    wrong[:, 2] /= 0.3048
    record = orient(block.write(tmp_path, positions=wrong, orient=SIGMA), tmp_path / "out").record
    (line,) = (f for f in record["findings"] if "heights of the positions go up and down" in f)
    assert "look like feet" in line


def test_heights_are_compared_with_the_ground(block: MeasuredBlock, tmp_path: Path) -> None:
    more = "[terrain]\nlevel = 300.0\n"
    wrong = positions(block)
    wrong[:, 2] /= 0.3048
    with pytest.raises(HeightSystemError, match=r"positions\.csv.*look like feet"):
        orient(block.write(tmp_path, positions=wrong, orient=SIGMA, more=more), tmp_path / "feet")
    shifted = positions(block) + np.array([0.0, 0.0, 47.0])
    record = orient(
        block.write(tmp_path, positions=shifted, orient=SIGMA, more=more), tmp_path / "out"
    ).record
    (line,) = (f for f in record["findings"] if "do not fit the height model" in f)
    # The hills are level on average.
    assert float(line.split(" m (scatter")[0].rsplit(" ", 1)[1]) == pytest.approx(47.0, abs=6.0)
    assert tomllib.loads((tmp_path / "out" / "oriented.toml").read_text())["terrain"] == {"level": 300.0}
    # A level that stands in was guessed from the positions: it judges nothing, and makes way.
    guessed = block.write(tmp_path, positions=shifted, orient=SIGMA, more=more + "stand_in = true\n")
    record = orient(guessed, tmp_path / "own").record
    assert not any("do not fit the height model" in f for f in record["findings"])
    assert tomllib.loads((tmp_path / "own" / "oriented.toml").read_text())["terrain"] == {
        "file": "surface.tif"
    }


def test_parts_of_single_strips_are_placed_by_positions_and_stated_angles(tmp_path: Path) -> None:
    """Oblique photographs, 30°; the points of one strip are not those of the other: nothing connects them.

    Positions on a line leave the tilt open, and the mean axis of the photographs is no plumb line here.
    """
    block = measured_block(points=340, tilt_deg=30.0)
    path = block.write(
        tmp_path, positions=positions(block), orient=SIGMA, keep=lambda j, k: (j % 2 == 0) == (k >= 4)
    )
    record = orient(path, tmp_path / "out").record
    findings = " | ".join(record["findings"])
    assert "falls apart into 2 parts of 4 + 4 photographs" in findings
    assert "the angles that the photographs state were taken to start with" in findings
    assert record["summary"]["oriented"] == 8
    for entry in record["photographs"]:
        k = block.names.index(entry["name"])
        off = np.array(entry["omega_phi_kappa_deg"]) - block.opk_deg[k]
        assert np.abs((off + 180.0) % 360.0 - 180.0).max() < 1.0
        assert np.abs(np.array(entry["position"]) - block.centres[k]).max() < 0.2


def test_tracks_of_opensfm_take_the_size_of_the_camera(block: MeasuredBlock, tmp_path: Path) -> None:
    path = block.write(tmp_path, sigma_px=0.001)
    rows = ["OPENSFM_TRACKS_VERSION_v2"]
    for k, (point, photo, col, row) in enumerate(block.image):
        x, y = (col - 1500.0) / 3000.0, (row - 1000.0) / 3000.0
        rows.append(f"{block.names[photo]}\t{point}\t{k}\t{x:.9f}\t{y:.9f}\t0.001\t0\t0\t0\t-1\t-1")
    (tmp_path / "tracks.csv").write_text("\n".join(rows), encoding="utf-8")
    text = path.read_text(encoding="utf-8").replace("ties.txt", "tracks.csv")
    path.write_text(text, encoding="utf-8")
    inputs = read_orient_inputs(path)
    assert [photo.name for photo in inputs.photos] == sorted(block.names)
    assert inputs.tie_points is not None
    np.testing.assert_allclose(inputs.tie_points.pixels, np.array(block.image)[:, 2:], atol=1e-4)


def test_a_colmap_database_brings_its_cameras(block: MeasuredBlock, tmp_path: Path) -> None:
    path = block.write(tmp_path)
    image = np.array(block.image)
    pixels = [image[image[:, 1] == k][:, 2:] for k in (0, 1)]
    points = [image[image[:, 1] == k][:, 0] for k in (0, 1)]
    _, left, right = np.intersect1d(*points, return_indices=True)
    with MeasurementDatabase.open(tmp_path / "matched.db") as database:
        simple_radial = CameraRow(2, (3000, 2000), (3010.0, 1500.0, 1000.0, -0.01))
        database.set_photographs({1: simple_radial}, [ImageRow(1, "a.jpg", 1), ImageRow(2, "b.jpg", 1)])
        for number, seen in enumerate(pixels, 1):
            n = len(seen)
            features = Features(seen, *(np.ones(n),) * 3, np.zeros((n, 128), np.float32))
            database.put_features(number, features, "key", {})
        rows = np.column_stack([left, right])
        matches = Matches(left, right, np.zeros(len(left)), np.zeros(len(left)))
        database.put_pair(PairRow(1, 2, rows), matches, "key", {})
    text = path.read_text(encoding="utf-8").replace("ties.txt", "matched.db")
    begin, end = text.index("[[camera]]"), text.index("[photos]")
    path.write_text(text[:begin] + text[end:], encoding="utf-8")
    inputs = read_orient_inputs(path)
    assert [photo.path.name for photo in inputs.photos] == ["a.jpg", "b.jpg"]
    camera = inputs.photos[0].camera
    assert camera.size_px == (3000, 2000)
    assert camera.distortion.k1 == -0.01  # type: ignore[union-attr]
    np.testing.assert_allclose(camera.rays_from_image([1500.0, 1000.0]), [0.0, 0.0, -1.0], atol=1e-12)
    assert inputs.tie_points is not None
    assert len(inputs.tie_points.points) == 2 * len(left)
