"""`stereomate orient`: from pixels to an oriented block, resumed where it was killed, wrong input named."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyogrio
import pytest
import shapely
import tifffile
from report_schema import require_reportable
from run_survey import write_tiny

from stereomate.errors import FormatError, NotDeterminedError, ProjectError
from stereomate.project import load
from stereomate.project.covariance_file import COVARIANCE
from stereomate.project.orient import OrientOptions, OrientResult, orient
from stereomate.project.orient_files import ORIENTATION, TABLES
from stereomate.project.orient_layers import LAYERS
from stereomate.project.orient_report import write_orient_report

SAME = ("adjustment.json", ORIENTATION, COVARIANCE, "oriented.toml", LAYERS, *TABLES)


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six rendered photographs in two strips; the project file has their true orientation as its table."""
    folder = tmp_path_factory.mktemp("survey")
    path = write_tiny(folder, strips=2, size_px=(480, 360), control_points=0)
    with path.open("a", encoding="utf-8") as file:
        file.write(
            '\n[orient]\ncalibrate = "none"\nposition_sigma_m = [0.1, 0.1, 0.1]\n'
            "features = 1200\npoints_per_photo = 120\n"
        )
    return path


@pytest.fixture(scope="module")
def whole(survey: Path, tmp_path_factory: pytest.TempPathFactory) -> OrientResult:
    """A run that went through."""
    out = tmp_path_factory.mktemp("whole")
    return orient(survey, out, documents=lambda result: [write_orient_report(result)])


def test_rendered_photographs_are_oriented_to_the_truth(survey: Path, whole: OrientResult) -> None:
    require_reportable(whole.record)
    summary = whole.record["summary"]
    assert summary["oriented"] == summary["photographs"] == 6
    assert summary["converged"]
    assert summary["image_rms_px"]["columns"] < 0.3
    truth = load(survey).survey
    assert whole.project_file is not None
    found = load(whole.project_file).survey
    assert [p.name for p in found.photographs] == [p.name for p in truth.photographs]
    for one, other in zip(found.photographs, truth.photographs, strict=True):
        turn = one.orientation.object_from_camera.T @ other.orientation.object_from_camera
        angle = np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))
        # A pixel of this camera is 0.5 m on the ground and 0.11 degrees.
        assert angle < 0.05, one.name
        shift = np.array(one.orientation.centre) - np.array(other.orientation.centre)
        assert np.abs(shift).max() < 0.3, one.name
    assert (whole.out / "orient.html").is_file()


def test_layers_hold_photographs_points_and_residuals(whole: OrientResult) -> None:
    path = whole.out / LAYERS
    assert {name for name, _ in pyogrio.list_layers(path)} == {"photographs", "points", "residual_vectors"}
    meta, _, geometry, fields = pyogrio.raw.read(path, layer="photographs")
    centres = shapely.get_coordinates(shapely.from_wkb(geometry), include_z=True)
    listed = dict(zip(meta["fields"], fields, strict=True))
    record = {entry["name"]: entry for entry in whole.record["photographs"]}
    for name, centre, rms in zip(listed["name"], centres, listed["image_rms_px"], strict=True):
        np.testing.assert_allclose(centre, record[name]["position"], atol=1e-6)
        assert rms == pytest.approx(record[name]["image_rms_px"])
    # Over all photographs they are the rms of the block.
    weight = np.array([record[name]["image_points"] for name in listed["name"]])
    x, y = whole.record["summary"]["image_rms_px"].values()
    mean = np.sqrt(np.average(listed["image_rms_px"] ** 2, weights=weight))
    assert mean == pytest.approx(np.hypot(x, y) / np.sqrt(2.0), rel=1e-6)
    meta, _, geometry, fields = pyogrio.raw.read(path, layer="residual_vectors")
    listed = dict(zip(meta["fields"], fields, strict=True))
    lines = shapely.get_coordinates(shapely.from_wkb(geometry), include_z=True).reshape(-1, 2, 3)
    assert len(lines) == 6
    length = np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1) / listed["exaggeration"]
    # The map's scale differs from 1 by a thousandth or two.
    stated = np.linalg.norm([listed["dx"], listed["dy"], listed["dz"]], axis=0)
    np.testing.assert_allclose(length, stated, rtol=5e-3)
    assert len(pyogrio.raw.read(path, layer="points")[2]) == whole.record["summary"]["tie_points"]


def test_what_was_expected_stands_beside_what_was_found(whole: OrientResult) -> None:
    expected = whole.record["expected"]
    sigma = [entry["standard_deviation_m"] for entry in whole.record["photographs"]]
    np.testing.assert_allclose(expected["found"]["centres_m"], np.median(sigma, axis=0), rtol=1e-6)
    assert all(0.1 < ratio < 3.0 for ratio in expected["ratio"]["centres_m"])
    assert "Expected before the flight" in (whole.out / "orient.html").read_text(encoding="utf-8")


def test_products_know_how_well_the_block_is_oriented(whole: OrientResult, tmp_path: Path) -> None:
    """Through the file into the project: the same numbers, along the same axes, or not at all."""
    assert whole.project_file is not None
    assert whole.adjusted is not None
    statistics = whole.adjusted.result.statistics
    known = load(whole.project_file).orientation_covariance
    assert known is not None
    assert statistics is not None
    names = [Path(name).stem for name in whole.adjusted.result.network.photographs.names]
    assert len(known.pairs) == len(whole.record["y_parallaxes"]) > 6
    for k, name in enumerate(names):
        np.testing.assert_allclose(
            np.sqrt(np.diagonal(known.photographs[name])), statistics.photo_sigma[k], rtol=1e-9
        )
    for left, right in known.pairs:
        matrix = known.of_pair(left, right)
        sigma = np.sqrt(np.diagonal(matrix))
        # neighbours err together, and never more than that
        assert np.linalg.eigvalsh(matrix / np.outer(sigma, sigma)).min() > 0.0
        assert np.abs(known.of_pair(right, left)[:6, 6:] - matrix[6:, :6]).max() == 0.0
    folder = tmp_path / "copy"
    shutil.copytree(whole.out, folder)
    table = folder / ORIENTATION
    table.write_text(table.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    with pytest.raises(FormatError, match="belongs to other orientations than"):
        load(folder / "oriented.toml")


def test_stated_accuracy_holds(survey: Path, whole: OrientResult) -> None:
    """Centres are off the truth by what their standard deviations say (chi-square over 18 values, 0.1 %)."""
    truth = {p.name: np.array(p.orientation.centre) for p in load(survey).survey.photographs}
    assert whole.adjusted is not None
    result = whole.adjusted.result
    assert result.statistics is not None
    names = result.network.photographs.names
    sigma = result.statistics.photo_sigma[:, :3] / result.statistics.scale
    standardized = (result.centres - np.array([truth[name] for name in names])) / sigma
    # The table holds the truth itself, not a measurement of it: too good, never too bad.
    assert float(np.sum(standardized**2)) < 42.3


# Runs an orientation in a process of its own that kills itself, as a power cut does: when a stage is
# finished, or at a number of it. What it reached stands in a file.
VICTIM = """
import os, signal, sys
from pathlib import Path
from stereomate.project.orient import orient

project, out, stage, at, seen = sys.argv[1:]


def progress(name, done, total):
    with open(seen, "a", encoding="utf-8") as file:
        file.write(f"{name}\\t{done}\\n")
    if name == stage and done == (total if at == "-" else int(at)):
        os.kill(os.getpid(), signal.SIGKILL)


orient(project, Path(out), progress=progress)
"""


@pytest.mark.slow
def test_killed_at_every_boundary_and_within_the_longest_stages_it_gives_the_same_bytes(
    survey: Path, whole: OrientResult, tmp_path: Path
) -> None:
    """One folder, killed again and again with SIGKILL: nothing finished is lost, nothing half is left."""
    out, log = tmp_path / "out", tmp_path / "seen"
    kills = [("features", "3"), ("features", "-"), ("pairs", "5"), ("pairs", "-"), ("tie points", "-"),
             ("start", "-"), ("refinement", "2"), ("refinement", "-"), ("adjustment", "-"),
             ("documents", "0")]  # fmt: skip
    reached: dict[str, int] = {}
    for stage, at in kills:
        log.write_text("", encoding="utf-8")
        run = subprocess.run(
            [sys.executable, "-c", VICTIM, str(survey), str(out), stage, at, str(log)], check=False
        )
        assert run.returncode == -signal.SIGKILL, (stage, at)
        assert not (out / "adjustment.json").exists()
        seen = [
            (name, int(done)) for name, done in (line.split("\t") for line in log.read_text().splitlines())
        ]
        # Stages begin where the run before was stopped.
        for name, done in reached.items():
            assert next(d for n, d in seen if n == name) >= done, (stage, name)
        if stage in ("features", "pairs", "refinement"):
            reached[stage] = seen[-1][1]
    orient(survey, out)
    for name in SAME:
        assert (out / name).read_bytes() == (whole.out / name).read_bytes(), name


@pytest.mark.slow
def test_two_threads_and_a_repeated_run_give_the_same_bytes(
    survey: Path, whole: OrientResult, tmp_path: Path
) -> None:
    orient(survey, tmp_path, OrientOptions(threads=2))
    for name in SAME:
        assert (tmp_path / name).read_bytes() == (whole.out / name).read_bytes(), name
    again = orient(survey, tmp_path, OrientOptions(threads=2))
    assert again.up_to_date
    assert again.record == json.loads((whole.out / "adjustment.json").read_text())


def changed(survey: Path, folder: Path, **replaced: str) -> Path:
    """A copy of the survey with texts of its project file replaced."""
    shutil.copytree(survey.parent, folder / "copy")
    path = folder / "copy" / survey.name
    text = path.read_text(encoding="utf-8")
    for old, new in replaced.items():
        assert old in text
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.slow
def test_duplicate_unreadable_and_foreign_photographs_are_left_out_and_named(
    survey: Path, tmp_path: Path
) -> None:
    path = changed(survey, tmp_path)
    folder = Path(load(survey).survey.photographs[0].path).parent.relative_to(survey.parent)
    first = sorted((path.parent / folder).glob("*.tif"))[0]
    shutil.copy(first, first.with_name("zz_twin.tif"))
    tifffile.imwrite(first.with_name("zz_small.tif"), np.zeros((100, 90, 3), np.uint8), photometric="rgb")
    first.with_name("zz_broken.tif").write_bytes(first.read_bytes()[:2000])
    text = path.read_text(encoding="utf-8")
    lines = text.splitlines()
    (row,) = [k for k, line in enumerate(lines) if line.startswith("files")]
    lines[row] = f'files = "{folder.as_posix()}/*.tif"'
    path.write_text("\n".join(lines), encoding="utf-8")
    record = orient(path, tmp_path / "out").record
    reasons = {entry["name"]: entry["reason"] for entry in record["not_oriented"]}
    assert record["summary"]["oriented"] == 6
    assert "is the same photograph as" in reasons["zz_twin.tif"]
    assert "another camera" in reasons["zz_small.tif"]
    assert "zz_broken.tif" in reasons


def test_photographs_that_share_nothing_are_an_error_with_a_reason(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for k in range(3):
        image = rng.integers(0, 255, (300, 400, 3), dtype=np.uint8)
        tifffile.imwrite(tmp_path / f"p{k}.tif", image, photometric="rgb")
    (tmp_path / "project.toml").write_text(
        '[project]\ncrs = "EPSG:25832"\nheights = "undeclared"\n'
        '[[camera]]\nname = "c"\nsize_px = [400, 300]\n'
        'principal_distance_px = 400.0\n[photos]\nfiles = "p*.tif"\n',
        encoding="utf-8",
    )
    with pytest.raises(NotDeterminedError, match="no pair of photographs gives a model"):
        orient(tmp_path / "project.toml", tmp_path / "out")
    assert not (tmp_path / "out" / "adjustment.json").exists()


def test_control_without_measurements_is_refused(survey: Path, tmp_path: Path) -> None:
    path = changed(survey, tmp_path)
    # Somewhere below the first photograph.
    x, y = (path.parent / "orientation.csv").read_text(encoding="utf-8").splitlines()[1].split(",")[1:3]
    (path.parent / "gcp.csv").write_text(f"name,x,y,z\na,{x},{y},400.0\n", encoding="utf-8")
    with path.open("a", encoding="utf-8") as file:
        file.write('\n[control]\nfile = "gcp.csv"\n')
    with pytest.raises(ProjectError, match=r"control\.measurements.*must be given"):
        orient(path, tmp_path / "out")
