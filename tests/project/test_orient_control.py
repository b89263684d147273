"""`stereomate orient` with control points: as the only datum; control and positions that are wrong."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from report_schema import require_reportable
from run_survey import write_tiny

from stereomate.errors import CrsError, HeightSystemError, ProjectError, StereomateError
from stereomate.frames.transform import tangent_from_map
from stereomate.project import load
from stereomate.project.orient import DATABASE, orient


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
    """No positions: eight control points, one without height, and four check points; one of each swapped."""
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
        x, y = (y, x) if k in (7, 8) else (x, y)
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
    assert any(
        "g7 contradicts the others and is left out: its x and y are exchanged" in finding
        for finding in record["findings"]
    )
    check = record["control"]["check"]
    # The one with swapped coordinates is named and does not spoil what the others say.
    assert check["count"] == 3
    assert check["apart"] == ["g8"]
    assert [point["name"] for point in check["points"]] == ["g8", "g9", "g10", "g11"]
    assert any("check point g8 contradicts the block" in finding for finding in record["findings"])
    # The pixel of this camera is half a metre on the ground.
    assert max(check["rms_m"]) < 0.5
    found = load(tmp_path / "out" / "oriented.toml").survey
    assert np.abs(found.centres_map - truth.survey.centres_map).max() < 1.0


FOOT = 0.3048


@pytest.fixture(scope="module")
def block(survey: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray]:
    """The survey with tie points of a file, positions and eight good control points; oriented once."""
    folder = tmp_path_factory.mktemp("block") / "good"
    shutil.copytree(survey.parent, folder)
    truth, rng = load(survey), np.random.default_rng(3)
    heights, centres = truth.require_heights(), truth.survey.centres_map[:, :2]
    xy = rng.uniform(centres.min(axis=0), centres.max(axis=0), (158, 2))
    xyz = np.column_stack([xy, heights.heights_at(xy)])
    ground = tangent_from_map(truth.tangent, truth.frame, xyz)
    header = "point,photograph,col,row,sigma"
    measured, ties = [header], [header]
    for photo in truth.survey.photographs:
        pixels, inside = photo.camera.image_from_camera(photo.orientation.camera_from_tangent(ground))
        for k in np.flatnonzero(inside):
            col, row = pixels[k] + rng.normal(0, 0.1, 2)
            (measured if k < 8 else ties).append(f"g{k},{photo.path.name},{col:.3f},{row:.3f},0.1")
    (folder / "gcp_px.csv").write_text("\n".join(measured), encoding="utf-8")
    (folder / "ties.csv").write_text("\n".join(ties), encoding="utf-8")
    (folder / "gcp.csv").write_text(table(xyz[:8]), encoding="utf-8")
    path = folder / survey.name
    text = path.read_text(encoding="utf-8").replace(
        "features = 1200", 'features = 600\ntie_points = "ties.csv"'
    )
    text += '\n[control]\nfile = "gcp.csv"\nmeasurements = "gcp_px.csv"\nsigma_m = [0.05, 0.05, 0.05]\n'
    path.write_text(text, encoding="utf-8")
    record = orient(path, folder / "out").record
    assert not [line for line in record["findings"] if line.startswith(("control", "positions"))]
    assert record["control"]["control"]["count"] == 8
    require_reportable(record)
    return path, xyz[:8]


def table(xyz: np.ndarray) -> str:
    rows = (f"g{k},{x:.3f},{y:.3f},{z:.3f}" for k, (x, y, z) in enumerate(xyz))
    return "\n".join(["name,x,y,z", *rows])


def variant(
    block: tuple[Path, np.ndarray],
    folder: Path,
    control: Callable[[np.ndarray], Any] = lambda xyz: None,
    height: Callable[[float], float] = lambda z: z,
    **replaced: str,
) -> Path:
    """The block, measured already, with other control, heights of positions, or texts of its project file."""
    shutil.copytree(block[0].parent, folder / "copy", ignore=shutil.ignore_patterns("out"))
    (folder / "out").mkdir()
    shutil.copy(block[0].parent / "out" / DATABASE, folder / "out")
    path = folder / "copy" / block[0].name
    xyz = block[1].copy()
    control(xyz)
    (path.parent / "gcp.csv").write_text(table(xyz), encoding="utf-8")
    source = path.parent / "orientation.csv"
    header, *rows = (line.split(",") for line in source.read_text(encoding="utf-8").splitlines())
    lines = [",".join([*row[:3], f"{height(float(row[3])):.4f}", *row[4:]]) for row in rows]
    source.write_text("\n".join([",".join(header), *lines]), encoding="utf-8")
    text = path.read_text(encoding="utf-8")
    for old, new in replaced.items():
        assert old in text
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")
    return path


def offset(record: dict[str, Any], block: tuple[Path, np.ndarray]) -> float:
    """The largest of all differences of the centres to the truth."""
    survey = load(block[0]).survey
    names = [photo.path.name for photo in survey.photographs]
    truth = dict(zip(names, survey.centres_map, strict=True))
    return max(float(np.abs(truth[p["name"]] - p["position"]).max()) for p in record["photographs"])


@pytest.mark.slow
def test_exchanged_shifted_and_feet_control_points_are_named_and_left_out(
    block: tuple[Path, np.ndarray], tmp_path: Path
) -> None:
    def spoil(xyz: np.ndarray) -> None:
        xyz[3, :2] = xyz[3, 1::-1]
        xyz[5, 0] += 50.0
        xyz[6, 2] /= FOOT

    record = orient(variant(block, tmp_path, spoil), tmp_path / "out").record
    found = "\n".join(record["findings"])
    assert "g3 contradicts the others and is left out: its x and y are exchanged" in found
    assert "g5 contradicts the others and is left out: it is off by +50.0, " in found
    assert "g6 contradicts the others and is left out: its height looks like feet" in found
    assert found.count("contradicts") == 3
    assert record["control"]["control"]["count"] == 5
    assert record["summary"]["global_test"]["passed"]
    assert offset(record, block) < 0.3


def feet(columns: slice) -> Callable[[np.ndarray], None]:
    def spoil(xyz: np.ndarray) -> None:
        xyz[:, columns] /= FOOT

    return spoil


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"control": feet(slice(2, 3))}, HeightSystemError, r"gcp\.csv.*control points.*look like feet"),
        ({"control": feet(slice(0, 3))}, CrsError, r"gcp\.csv.*8 of 8 control points.*coordinates in feet"),
        pytest.param(
            {"height": lambda z: z / FOOT},
            HeightSystemError,
            r"orientation\.csv.*positions.*look like feet",
            marks=pytest.mark.slow,
        ),
        (
            {"principal_distance_mm = 52.0": "principal_distance_mm = 78.0"},
            ProjectError,
            r"principal distance: makes the flying height 1\.[45].*got '78 mm' \(5\d",
        ),
    ],
)
def test_wrong_units_and_principal_distance_are_errors(
    block: tuple[Path, np.ndarray],
    tmp_path: Path,
    changes: dict[str, Any],
    error: type[StereomateError],
    words: str,
) -> None:
    with pytest.raises(error, match=words):
        orient(variant(block, tmp_path, **changes), tmp_path / "out")
    assert not (tmp_path / "out" / "adjustment.json").exists()


@pytest.mark.slow
def test_positions_of_other_heights_are_left_out(block: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    """The 48 m of a geoid, in a project that does not say what its heights are."""
    changes = {'heights = "ellipsoidal"': 'heights = "undeclared"'}
    path = variant(block, tmp_path, height=lambda z: z + 48.0, **changes)
    record = orient(path, tmp_path / "out").record
    assert any(line.startswith("positions: they are off what the control") for line in record["findings"])
    assert record["summary"]["oriented"] == 6
    assert offset(record, block) < 1.0
