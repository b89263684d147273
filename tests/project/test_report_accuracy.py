"""Accuracy in the report of a run: check points against truth, requirements judged, the record's schema."""

from __future__ import annotations

import json
from importlib import resources

import jsonschema
import numpy as np
import pytest
from run_survey import TINY, make

from stereomate.errors import FormatError
from stereomate.project import load
from stereomate.project.check_points import check_points
from stereomate.project.run_record import read_run_record
from stereomate.synthetic.files import write_survey
from stereomate.synthetic.observations import NoiseOptions, observe_tie_points
from stereomate.synthetic.options import SurveyOptions
from stereomate.synthetic.survey import make_survey

ASKED = """
[control]
file = "known.csv"
measurements = "measured.csv"
sigma_m = [0.001, 0.001, 0.001]
measurement_sigma_px = 0.3

[accuracy]
horizontal_m = 0.3
vertical_m = 0.5
y_parallax_px = 0.0001
"""
NOISE_PX = 0.3


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    folder = tmp_path_factory.mktemp("checked")
    survey = make_survey(SurveyOptions(**TINY))
    path = write_survey(survey, folder).project
    seen = observe_tie_points(survey, 120, NoiseOptions(sigma=NOISE_PX, seed=5))
    points = [
        f"{name},{x:.4f},{y:.4f},{z:.4f}" for name, (x, y, z) in zip(seen.names, seen.points, strict=True)
    ]
    (folder / "known.csv").write_text("\n".join(["name,x,y,z", *points]) + "\n")
    names = [p.name for p in survey.survey.photographs]
    rows = ["point,photograph,col,row"] + [
        f"{seen.names[k]},{names[p]},{col:.4f},{row:.4f}"
        for p, k, (col, row) in zip(seen.photograph, seen.point, seen.pixels, strict=True)
    ]
    (folder / "measured.csv").write_text("\n".join(rows) + "\n")
    path.write_text(path.read_text() + ASKED)
    return path


@pytest.fixture(scope="module")
def made(project, tmp_path_factory):
    return make(project, tmp_path_factory.mktemp("made"), report=True)


def test_differences_are_what_the_measurements_allow(project):
    found = check_points(load(project))
    assert len(found.names) >= 30
    # Three coordinates of each point are fitted to its 2r image coordinates.
    left = np.sum(2 * found.rays - 3) / np.sum(2 * found.rays)
    assert found.image_rms_px == pytest.approx(NOISE_PX * np.sqrt(left), rel=0.15)
    normed = found.differences_m / found.measured_sigma_m
    # 1 ± 4 standard deviations of a mean of squares with as many degrees as points (components share noise).
    assert np.mean(normed**2) == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / len(found.names)))
    assert np.all(np.abs(normed.mean(axis=0)) < 4.0 / np.sqrt(len(found.names)))


def test_a_wrong_orientation_is_seen_in_metres(project, tmp_path):
    text = project.read_text()
    for name in ("heights.tif", "known.csv", "measured.csv"):
        text = text.replace(f'"{name}"', f'"{project.parent / name}"')
    lines = (project.parent / "orientation.csv").read_text().splitlines()
    z = lines[0].split(",").index("z")
    raised = [lines[0]]
    for line in lines[1:]:
        cells = line.split(",")
        cells[z] = repr(float(cells[z]) + 0.75)
        raised.append(",".join(cells))
    (tmp_path / "orientation.csv").write_text("\n".join(raised) + "\n")
    copy = tmp_path / "project.toml"
    copy.write_text(text.replace('"strip*.tif"', f'"{project.parent}/strip*.tif"'))
    shift = check_points(load(copy)).differences_m - check_points(load(project)).differences_m
    assert np.allclose(shift, [0.0, 0.0, 0.75], atol=0.002)


def test_the_report_states_judges_and_validates(made):
    record = read_run_record(made.out / "report.json")
    schema = json.loads(resources.files("stereomate.report").joinpath("report.schema.json").read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(record, schema)
    verdicts = {j["requirement"].split()[0]: j["verdict"] for j in record["accuracy"]["requirements"]}
    assert verdicts["horizontal"] == "pass"
    # Nothing that is measured by matching is good to a ten-thousandth of a pixel.
    assert verdicts["y-parallax"] in ("fail", "not assessed")
    page = (made.out / "report.html").read_text()
    assert "class of ASPRS 2023" in page
    assert "Map projection" in page
    assert {"report.html", "report.json"} <= set(
        json.loads((made.out / "stereo.json").read_text())["run"]["documents"]
    )


def test_effects_of_the_map_have_the_size_of_their_formulas(made):
    record = read_run_record(made.out / "report.json")
    effects = {e["effect"].split()[0]: e for e in record["map_projection"]}
    flown = np.mean([p["height_above_ground_m"] for p in record["photographs"]])
    ppm = float(effects["scale"]["size"].split()[4])
    assert effects["scale"]["error_m"] == pytest.approx(abs(ppm) * 1e-6 * flown, rel=0.05)
    reach = float(effects["Earth"]["size"].split()[2])
    assert effects["Earth"]["error_m"] == pytest.approx(reach**2 / (2 * 6.37e6), rel=0.02)
    assert not effects["atmospheric"]["handled"]


def test_without_points_nothing_is_claimed(project, tmp_path):
    bare = tmp_path / "project.toml"
    text = project.read_text().replace(ASKED, "")
    for name in ("heights.tif", "orientation.csv"):
        text = text.replace(f'"{name}"', f'"{project.parent / name}"')
    bare.write_text(text.replace('"strip*.tif"', f'"{project.parent}/strip*.tif"'))
    assert check_points(load(bare)) is None


def test_a_record_of_a_newer_form_is_refused(tmp_path):
    path = tmp_path / "report.json"
    path.write_text('{"kind": "stereomate report", "format": 99}')
    with pytest.raises(FormatError, match=r"form 99.*form 1"):
        read_run_record(path)
    path.write_text("{}")
    with pytest.raises(FormatError, match="report of stereomate"):
        read_run_record(path)
