"""The figures that README and docs/accuracy.md state for a real project are those of a run."""

from __future__ import annotations

import json
import re
import subprocess
import sys

import pytest
from pages import ROOT, blocks

PAGE = ROOT / "docs" / "accuracy.md"


def stated(first_cell: str, after: str) -> tuple[list[float], int]:
    """Medians and nmads in x and y, and the number of matches, of a row of the page."""
    text = PAGE.read_text(encoding="utf-8")
    section = text[text.index(after) :]
    row = next(line for line in section.splitlines() if line.startswith(f"| {first_cell}"))
    numbers = re.findall(r"[-+]?\d+\.\d+", row)
    return [float(n) for n in numbers], int(row.rstrip("| ").rsplit("|", 1)[1])


@pytest.mark.real
def test_the_national_survey_is_as_accurate_as_the_page_says(tmp_path, data_folder):
    """The project file is the one of the manual; two decimals are stated."""
    folder = data_folder / "ngi_strip05"
    text = blocks(ROOT / "docs" / "project_file.md", "toml")[0]
    for name in ("*_RGB.tif", "ngi_xyz_opk.csv", "dem.tif"):
        assert f'"{name}"' in text
        text = text.replace(f'"{name}"', f'"{folder}/{name}"')
    (tmp_path / "project.toml").write_text(text)
    done = subprocess.run(
        [sys.executable, "-m", "stereomate", "-q", "run", "project.toml", "-o", "out"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    agreement = json.loads((tmp_path / "out" / "stereo.json").read_text())["products"][0]["agreement"]
    for name, key in (
        ("orthophoto against orthophoto", "orthophoto_against_orthophoto"),
        ("orthophoto against stereomate", "orthophoto_against_stereomate"),
    ):
        values, matches = stated(name, "South African")
        measured = [*agreement[key]["median_px"], *agreement[key]["nmad_px"]]
        assert values == pytest.approx(measured, abs=0.006)
        assert matches == agreement[key]["count"]
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (row,) = (line for line in readme.splitlines() if "two frames of a national survey" in line)
    assert [float(n) for n in re.findall(r"[-+]?\d+\.\d+", row)] == pytest.approx(measured, abs=0.006)
