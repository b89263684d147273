"""Eighteen drone photographs of a beach, from their EXIF alone (figures of the issue)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stereomate.project import load
from stereomate.project.orient import OrientOptions, OrientResult, orient
from stereomate.project.orient_files import ORIENTATION, TABLES

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
