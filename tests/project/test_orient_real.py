"""Eighteen drone photographs of a beach, from their EXIF alone (figures of the issue)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest

from stereomate.project import load
from stereomate.project.orient import OrientOptions, OrientResult, orient
from stereomate.project.orient_files import ORIENTATION, TABLES
from stereomate.project.orient_layers import LAYERS
from stereomate.project.own_surface import make_own_surface
from stereomate.terrain.model import HeightModel

PROJECT = """
[project]
name = "brighton"
crs = "EPSG:32615"
heights = "undeclared"

[photos]
files = "{folder}/*.JPG"
"""


@pytest.fixture(scope="module")
def brighton(data_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, OrientResult]:
    folder = tmp_path_factory.mktemp("brighton")
    images = (data_folder / "brighton_beach" / "images").resolve()
    path = folder / "project.toml"
    path.write_text(PROJECT.format(folder=images.as_posix()), encoding="utf-8")
    return path, orient(path, folder / "out", OrientOptions(threads=2))


@pytest.mark.real
@pytest.mark.slow
def test_all_are_oriented_and_fit(brighton: tuple[Path, OrientResult]) -> None:
    record = brighton[1].record
    assert record["summary"]["oriented"] == 18
    assert record["summary"]["converged"]
    rms = record["summary"]["image_rms_px"]
    assert np.hypot(rms["columns"], rms["rows"]) / np.sqrt(2.0) < 0.6
    assert record["positions"]["rms_plan_m"] < 3.0
    assert record["not_oriented"] == []


@pytest.mark.real
@pytest.mark.slow
def test_what_cannot_be_known_is_said(brighton: tuple[Path, OrientResult]) -> None:
    """Height datum, pixels turned by 180°, principal distance not separable from height: held."""
    record = brighton[1].record
    findings = " | ".join(record["findings"])
    assert "height datum is unverified" in findings
    assert "6 photographs are turned by about 180°" in findings
    for number in range(24, 30):
        assert f"DJI_00{number}" in findings
    assert "not separable" in findings
    (camera,) = record["cameras"]
    assert camera["parameters"]["principal_distance_mm"]["value"] == 3.61
    assert not camera["parameters"]["principal_distance_mm"]["found"]


@pytest.mark.real
@pytest.mark.slow
def test_the_oriented_project_loads_and_a_repeated_adjustment_is_the_same(
    brighton: tuple[Path, OrientResult], tmp_path: Path
) -> None:
    path, result = brighton
    assert result.project_file is not None
    project = load(result.project_file)
    assert len(project.survey.photographs) == 18
    assert project.heights is not None  # made from the tie points: there was none
    before = {name: (result.out / name).read_bytes() for name in ("adjustment.json", ORIENTATION, *TABLES)}
    (result.out / "adjustment.json").unlink()
    orient(path, result.out)
    for name, data in before.items():
        assert (result.out / name).read_bytes() == data, name


@pytest.mark.real
def test_from_the_photographs_twice_with_other_threads_gives_the_same_bytes(
    data_folder: Path, tmp_path: Path
) -> None:
    """Four of the photographs, two of them with turned pixels, in small; then their surface."""
    images = (data_folder / "brighton_beach" / "images").resolve()
    names = [f"{images.as_posix()}/DJI_00{k}.JPG" for k in (28, 29, 30, 31)]
    text = PROJECT.replace('"{folder}/*.JPG"', str(names).replace("'", '"'))
    text += (
        "\n[orient]\nlargest_side_px = 1000\nfeatures = 2000\npoints_per_photo = 150\n"
        "\n[surface]\nlargest_side_px = 600\npairs_per_photo = 2\nlargest_object_m = 8\n"
    )
    path = tmp_path / "project.toml"
    path.write_text(text, encoding="utf-8")
    one = orient(path, tmp_path / "one", OrientOptions(threads=1))
    two = orient(path, tmp_path / "two", OrientOptions(threads=2))
    assert one.record["summary"]["oriented"] == 4
    for name in ("adjustment.json", ORIENTATION, LAYERS, *TABLES):
        assert (one.out / name).read_bytes() == (two.out / name).read_bytes(), name
    assert one.project_file is not None
    surface = make_own_surface(one.project_file, tmp_path / "surface", threads=2)
    record = surface.record
    assert all(abs(pair["y_parallax_px"]) < 0.5 for pair in record["pairs"])
    # Tie points lie on it, but for those on trees and water.
    rows = pyarrow.parquet.read_table(one.out / TABLES[1]).to_pydict()
    points = np.array([rows["x"], rows["y"], rows["z"]], dtype=np.float64).T
    points = points[np.isfinite(points).all(axis=1)]
    project = load(surface.project_file)
    height = HeightModel.open(tmp_path / "surface" / "surface.tif", project.frame.heights)
    difference = points[:, 2] - height.heights_at(points[:, :2])
    known = np.isfinite(difference)
    assert known.mean() > 0.5
    assert abs(float(np.median(difference[known]))) < 0.05
    assert 1.4826 * float(np.median(np.abs(difference[known]))) < 0.10
