"""`stereomate surface` and `run` on a project without a height model."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from run_survey import raster, terrain_heights, write_tiny

from stereomate.cli import main
from stereomate.project import load
from stereomate.project.own_surface import make_own_surface

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three rendered photographs with orientation; the project file names no terrain."""
    path = write_tiny(tmp_path_factory.mktemp("survey"), size_px=(360, 270), buildings=0, trees=0)
    text = path.read_text(encoding="utf-8")
    start, end = text.index("[terrain]"), text.index("[products]")
    surface = "[surface]\nlargest_object_m = 20.0\npairs_per_photo = 2\n\n"
    path.write_text(text[:start] + surface + text[end:], encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def own(survey: Path) -> Path:
    """The folder of its surface."""
    out = survey.parent / "surface"
    assert not make_own_surface(survey, out).up_to_date
    return out


def test_the_project_with_its_own_height_model_is_that_of_the_truth(survey: Path, own: Path) -> None:
    record = json.loads((own / "surface.json").read_text())
    assert record["used"] == "terrain.tif"
    project = load(own / "project.toml")
    x, y = project.survey.centres_map[:, :2].mean(axis=0)
    place = np.array([[x, y], [x + 10.0, y - 15.0], [x - 20.0, y + 5.0]])
    found = project.require_heights().heights_at(place)
    np.testing.assert_allclose(found, terrain_heights(survey.parent / "heights.tif", place), atol=0.5)


def test_run_makes_its_own_height_model(survey: Path, tmp_path: Path) -> None:
    with pytest.raises(SystemExit) as end:
        main.run(["run", str(survey), "-o", str(tmp_path), "-q", "--no-agreement"])
    assert end.value.code in (0, None)
    assert (tmp_path / "surface" / "surface.json").is_file()
    pixels, valid = raster(tmp_path / "mate.tif")
    assert valid.mean() > 0.25
    assert pixels[:, valid].std() > 5.0


def test_a_finished_surface_is_not_made_again_and_a_damaged_one_is(survey: Path, own: Path) -> None:
    folder = own
    before = (folder / "surface.tif").stat().st_mtime_ns
    assert make_own_surface(survey, folder).up_to_date
    assert (folder / "surface.tif").stat().st_mtime_ns == before
    (folder / "terrain.tif").unlink()
    calls: list[str] = []
    again = make_own_surface(survey, folder, progress=lambda stage, done, total: calls.append(stage))
    assert not again.up_to_date
    assert (folder / "terrain.tif").is_file()
    # Tie points of the first ground were in the database.
    assert calls.index("matching") < calls.index("terrain")


def test_photographs_from_one_place_give_no_surface(survey: Path, tmp_path: Path, capsys) -> None:
    text = (survey.parent / "orientation.csv").read_text().splitlines()
    parts = text[1].split(",")
    rows = [text[0]] + [",".join([line.split(",")[0], *parts[1:]]) for line in text[1:]]
    (tmp_path / "orientation.csv").write_text("\n".join(rows) + "\n")
    project = survey.read_text().replace('"strip*.tif"', f'"{survey.parent.as_posix()}/strip*.tif"')
    (tmp_path / "project.toml").write_text(project)
    with pytest.raises(SystemExit) as end:
        main.run(["surface", str(tmp_path / "project.toml"), "-q"])
    assert end.value.code == 2
    assert "surface" in capsys.readouterr().err
    assert not (tmp_path / "surface" / "surface.json").exists()
