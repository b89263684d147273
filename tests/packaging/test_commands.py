"""The commands and programs of README and tutorial run as they are written, on a small survey."""

from __future__ import annotations

import contextlib
import io
import shlex
import shutil
from pathlib import Path

import pytest
from pages import ROOT, blocks, commands

from stereomate.cli import main
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


def run(folder: Path, words: list[str]) -> str:
    """What a command says. In this process: starting the program itself is what `test_wheel` tests."""
    assert words[0] == "stereomate"
    said = io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(said), pytest.raises(SystemExit) as ended:
        main.run(words[1:])
    assert ended.value.code in (0, None), f"{shlex.join(words)}\n{said.getvalue()}"
    return said.getvalue()


def run_page(folder: Path, page: Path) -> None:
    lines = commands(page)
    assert lines
    for line in lines:
        complete_draft(folder, run(folder, shlex.split(line)))
    program = "\n".join(blocks(page, "python", marked=True))
    said = io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(said):
        exec(compile(program, str(page), "exec"), {"__name__": "__main__"})
    assert said.getvalue().strip()


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
