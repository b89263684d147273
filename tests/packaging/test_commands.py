"""The commands and programs of README and tutorial run as they are written, on a small survey."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from pages import ROOT, blocks, commands

from stereomate.synthetic.files import write_survey
from stereomate.synthetic.options import SurveyOptions
from stereomate.synthetic.survey import make_survey

SMALL = SurveyOptions(
    seed=5, strips=1, photos_per_strip=3, size_px=(320, 240), gsd_m=0.5, flying_height_m=260.0,
    pixel_pitch_mm=0.1, relief_m=30.0, terrain_step_m=3.0, buildings=3, trees=8, control_points=0,
    check_points=0,
)  # fmt: skip


@pytest.fixture(scope="module")
def survey(tmp_path_factory) -> Path:
    """A folder with a survey named as in the tutorial, ``demo``, and its photographs alone, ``photos``."""
    folder = tmp_path_factory.mktemp("pages")
    made = write_survey(make_survey(SMALL), folder / "demo", photos="tif")
    (folder / "photos").mkdir()
    for path in (*made.photographs, made.heights, made.orientation):
        shutil.copy(path, folder / "photos")
    return folder


def run(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        arguments,
        cwd=folder,
        env={**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )


def run_page(folder: Path, page: Path) -> None:
    lines = commands(page)
    assert lines
    for line in lines:
        words = shlex.split(line)
        assert words[0] == "stereomate"
        done = run(folder, *words)
        assert done.returncode == 0, f"{line}\n{done.stdout}\n{done.stderr}"
        complete_draft(folder, done.stdout)
    program = "\n".join(blocks(page, "python", marked=True))
    done = run(folder, sys.executable, "-c", program)
    assert done.returncode == 0, f"{program}\n{done.stderr}"
    assert done.stdout.strip()


def complete_draft(folder: Path, said: str) -> None:
    """After `init`: the calibration, which no photograph tells, comes from the survey's own project."""
    draft = folder / "photos" / "project.toml"
    if "to do" not in said or not draft.exists():
        return
    draft.write_text((folder / "demo" / "project.toml").read_text())


def test_tutorial(survey):
    run_page(survey, ROOT / "docs" / "tutorial.md")
    for product in ("out", "pair"):
        assert {"ortho.tif", "mate.tif", "report.html"} <= {
            path.name for path in (survey / product).iterdir()
        }
    assert not (survey / "ortho" / "mate.tif").exists()


def test_readme(survey):
    run_page(survey, ROOT / "README.md")
    named = set(blocks_of_table((ROOT / "README.md").read_text()))
    assert named == {path.name for path in (survey / "products").iterdir() if path.suffix != ".log"}


def blocks_of_table(text: str) -> list[str]:
    """File names of the table that says what `run` makes."""
    rows = text[text.index("| file |") :].split("\n\n")[0].splitlines()[2:]
    return [name.strip(" `") for row in rows for name in row.split("|")[1].split(",")]
