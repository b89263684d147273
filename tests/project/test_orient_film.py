"""Deformed film through `stereomate orient`: Ebner's twelve, projective scans, priors, and what is said."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from film_block import PLANTED, FilmBlock, film_block
from scipy.stats import chi2

from stereomate.cli import main
from stereomate.errors import ProjectError
from stereomate.frames.transform import tangent_from_map
from stereomate.project import load
from stereomate.project.orient import orient

BROWN = '"principal_distance", "principal_point", "k1", "k2", "k3", "p1", "p2", "b1", "b2"'


@pytest.fixture(scope="module")
def block() -> FilmBlock:
    return film_block()


@pytest.fixture(scope="module")
def oriented(block: FilmBlock, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    folder = tmp_path_factory.mktemp("ebner")
    path = block.write(folder, orient='calibrate = ["ebner"]')
    with pytest.raises(SystemExit) as end:
        main.run(["orient", str(path), "-o", str(folder / "out"), "-q"])
    assert end.value.code in (0, None)
    return folder / "out", json.loads((folder / "out" / "adjustment.json").read_text())


def errors(block: FilmBlock, out: Path) -> np.ndarray:
    """Adjusted minus true points of the ground."""
    table = pq.read_table(out / "points.parquet").to_pydict()
    xyz = np.array([table[axis] for axis in "xyz"], dtype=float).T
    found = xyz - block.ground[[int(name[1:]) for name in table["name"]]]
    return found[np.isfinite(found).all(axis=1)]


def test_ebner_finds_the_deformation_of_the_film(block: FilmBlock, oriented: tuple[Path, dict]) -> None:
    out, record = oriented
    assert record["summary"]["oriented"] == len(block.names)
    assert record["summary"]["gross_errors"] == 0
    assert record["summary"]["sigma0"] == pytest.approx(1.0, abs=0.1)
    (camera,) = record["cameras"]
    found = [camera["parameters"][f"ebner_b{k}"] for k in range(1, 13)]
    error = np.array([p["value"] - b for p, b in zip(found, PLANTED, strict=True)])
    sigma = np.array([p["standard_deviation"] for p in found])
    assert sigma.max() < 0.003
    assert 0.5 * chi2.ppf(0.005, 12) < np.sum((error / sigma) ** 2) < chi2.ppf(0.999, 12)
    assert all(p["significant"] for p in found)
    assert camera["ebner_spacing_mm"] == pytest.approx(0.4 * 228.0)
    (said,) = [line for line in record["findings"] if line.startswith("Ebner")]
    assert "12 of 12 significant" in said
    assert not [line for line in record["findings"] if "overparametrised" in line]
    assert np.sqrt(np.mean(errors(block, out) ** 2, axis=0)).max() < 0.08


def test_oriented_project_has_film_and_projective_scans_again(
    block: FilmBlock, oriented: tuple[Path, dict]
) -> None:
    project = load(oriented[0] / "oriented.toml", planned=True)
    assert len(project.survey.photographs) == len(block.names)
    ground = tangent_from_map(project.survey.tangent, project.survey.frame, block.ground)
    written = [line.split() for line in (oriented[0].parent / "ties.txt").read_text().splitlines()]
    misfit = []
    for photo in project.survey.photographs:
        camera = photo.camera
        assert camera.deformation is not None
        assert camera.projective_per_mm != (0.0, 0.0)
        assert camera.format_mm == (228.0, 228.0)
        pixels, inside = camera.image_from_camera(photo.orientation.camera_from_tangent(ground))
        for name, of, col, row, _ in written:
            if of == photo.name:
                assert inside[int(name[1:])]
                misfit.append(pixels[int(name[1:])] - (float(col), float(row)))
    # 0.15 px of the measurements, and what positions of 5 cm leave of the block.
    assert np.sqrt(np.mean(np.square(misfit))) < 0.4


@pytest.mark.slow
def test_brown_alone_does_not_and_both_are_too_much(
    block: FilmBlock, oriented: tuple[Path, dict], tmp_path: Path
) -> None:
    path = block.write(tmp_path / "brown", orient=f"calibrate = [{BROWN}]")
    record = orient(path, tmp_path / "brown" / "out").record
    rms = np.hypot(*record["summary"]["image_rms_px"].values())
    assert rms > 0.2
    (scaled,) = [line for line in record["findings"] if "variance component of the image points" in line]
    assert float(scaled.split("are ")[1].split()[0]) > 1.5
    by_brown, by_ebner = (
        np.sqrt(np.mean(errors(block, out)[:, 2] ** 2)) for out in (tmp_path / "brown" / "out", oriented[0])
    )
    assert by_brown > 3.0 * by_ebner
    # The camera's own keys count before those of all cameras.
    path = block.write(
        tmp_path / "both", orient='calibrate = "none"', camera=f'calibrate = [{BROWN}, "ebner"]'
    )
    record = orient(path, tmp_path / "both" / "out").record
    (said,) = [line for line in record["findings"] if line.startswith("overparametrised")]
    assert "b1 and ebner_b1" in said
    assert "p1 and ebner_b3" in said
    (named,) = [line for line in record["findings"] if line.startswith("Ebner")]
    assert "could be held" in named


@pytest.mark.slow
def test_priors_are_those_stated(block: FilmBlock, tmp_path: Path) -> None:
    camera = 'calibrate = ["ebner_b7", "ebner_b8", "principal_point"]\npriors = { ebner_b8 = 1e-6 }'
    path = block.write(tmp_path, orient="priors = { ebner = 0.02, principal_point = 0.004 }", camera=camera)
    found = orient(path, tmp_path / "out").record["cameras"][0]["parameters"]
    assert found["ebner_b7"]["prior"] == 0.02
    assert found["ebner_b8"]["prior"] == 1e-6
    assert abs(found["ebner_b8"]["value"]) < 1e-5
    assert found["ebner_b8"]["t"] is None
    assert found["principal_point_x_mm"]["prior"] == 0.004
    assert not found["ebner_b1"]["found"]
    with pytest.raises(ProjectError, match=r"priors.*ebner_b13"):
        orient(block.write(tmp_path / "bad", orient="priors = { ebner_b13 = 0.02 }"), tmp_path / "out")


def test_what_a_camera_has_no_room_for_is_said(block: FilmBlock, tmp_path: Path) -> None:
    path = block.write(tmp_path, orient='calibrate = ["ebner"]')
    text = path.read_text()
    a, b = text.index("[camera.distortion]"), text.index("[camera.fiducials]")
    fisheye = text[:a] + '[camera.distortion]\nmodel = "fisheye"\nk1 = 0.0\n' + text[b:]
    for wrong, said in (
        (fisheye, "a projective transform of fiducials goes with the brown model"),
        (fisheye.replace('"projective"', '"affine"'), "ebner goes with the brown model or none; RC30"),
        (fisheye.replace("[camera.distortion]", "[camera.ebner]\nspacing_mm = 92.0\n[camera.distortion]"),
         "ebner goes with the brown model"),
    ):  # fmt: skip
        path.write_text(wrong)
        with pytest.raises(ProjectError, match=said):
            orient(path, tmp_path / "out")
