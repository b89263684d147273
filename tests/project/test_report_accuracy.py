"""Accuracy in the report of a run: check points against truth, requirements judged, the record's schema."""

from __future__ import annotations

import json
import re
from importlib import resources

import jsonschema
import numpy as np
import pytest
from run_survey import TINY, make

from stereomate.errors import FormatError
from stereomate.project import load
from stereomate.project.accuracy_report import judgements
from stereomate.project.adjustment_report import adjusted_check_points, adjustment_of
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


def adjustment(project, moved_m=0.0):
    """A record of a block adjustment as `stereomate orient` writes it, with the positions of a project."""
    loaded = load(project)
    nothing = [None, None, None]
    return {
        "format": 1,
        "kind": "block adjustment",
        "key": "0123",
        "frame": {"datum": "control", "crs": "EPSG:2154", "heights": "ellipsoidal"},
        "summary": {
            "photographs": 4, "oriented": 3, "tie_points": 800, "image_points": 2000, "observations": 4100,
            "unknowns": 2418, "redundancy": 1682, "sigma0": 1.02,
            "global_test": {"statistic": 1.0, "lower": 0.5, "upper": 2.0, "passed": True},
            "converged": True, "iterations": 5, "image_rms_px": {"columns": 0.3, "rows": 0.4},
            "gross_errors": 1,
        },
        "findings": ["one photograph is turned"],
        "cameras": [
            {
                "name": "camera",
                "size_px": [100, 80],
                "parameters": {
                    "k1": {"value": 1e-5, "standard_deviation": 1e-7, "prior": None, "found": True}
                },
            }
        ],
        "photographs": [
            {
                "name": f"{photograph.name}.tif", "camera": "camera",
                "position": [centre[0] + moved_m, centre[1], centre[2]],
                "omega_phi_kappa_deg": [0.0, 0.0, 90.0], "standard_deviation_m": [0.03, 0.03, 0.05],
                "standard_deviation_deg": [0.01, 0.01, 0.005], "image_points": 600,
            }
            for photograph, centre in zip(
                loaded.survey.photographs, loaded.survey.centres_map.tolist(), strict=True
            )
        ],
        "not_oriented": [{"name": "lost.tif", "reason": "no pair holds it"}],
        "positions": None,
        "control": {
            "control": {"count": 0, "rms_m": nothing, "points": []},
            "check": {
                "count": 1,
                "rms_m": [0.1, 0.2, 0.3],
                "points": [
                    {
                        "name": "C7", "residual_m": [0.1, -0.2, 0.3], "sigma_m": [0.02, 0.02, 0.03],
                        "standard_deviation_m": [0.04, 0.04, 0.09], "standardized": nothing,
                        "redundancy": nothing, "rays": 5, "given": [10.0, 20.0, 30.0],
                    }
                ],
            },
        },
        "y_parallaxes": [{"left": "a", "right": "b", "points": 90, "rms_px": 0.41}],
        "gross_errors": [
            {"kind": "image", "place": "P3 in a.tif", "size": [4.0, 1.0], "standardized": 9.0}
        ],
    }  # fmt: skip


@pytest.fixture(scope="module")
def made(project, tmp_path_factory):
    (project.parent / "adjustment.json").write_text(json.dumps(adjustment(project)))
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


def test_the_report_holds_orientation_and_homogeneity(made):
    record = read_run_record(made.out / "report.json")
    orientation = record["orientation"]
    assert orientation["summary"]["redundancy"] == 1682
    assert orientation["control"]["check"]["points"][0]["name"] == "C7"
    (product,) = record["homogeneity"]
    heights = [h["object_height_m"] for h in product["object_heights"]]
    assert heights == [5.0, 10.0, 20.0]
    # taller objects are read less well
    assert all(0.0 < h["seen_by_both"] <= 1.0 and h["error_rms_m"] > 0.0 for h in product["object_heights"])
    errors = [h["error_rms_m"] for h in product["object_heights"]]
    assert errors == sorted(errors)
    page = (made.out / "report.html").read_text()
    for text in ("<h2>Orientation</h2>", "<h2>Homogeneity</h2>", "one photograph is turned", "lost.tif",
                 "P3 in a.tif", "redundancy 1682", "C7"):  # fmt: skip
        assert text in page, text
    # every figure has its numbers in a table behind it, or beside it
    figures = re.findall(r"<figure.*?</figure>", page, re.DOTALL)
    assert len(figures) > 6
    bare = [re.search(r'alt="([^"]*)"', f)[1] for f in figures if "<details>" not in f]
    assert bare == []


def test_check_points_of_an_adjustment_are_judged(project):
    checked = adjusted_check_points(adjustment(project))
    assert checked.independent
    assert checked.names == ("C7",)
    np.testing.assert_array_equal(checked.differences_m, [[-0.1, 0.2, -0.3]])
    np.testing.assert_array_equal(checked.map_xy, [[10.0, 20.0]])
    (horizontal, *_) = judgements(load(project), checked, None)
    assert (horizontal.verdict, horizontal.found) == (
        "not assessed",
        pytest.approx(np.hypot(0.1, 0.2), rel=0.05),
    )


def test_an_adjustment_of_other_positions_is_passed_over(project, tmp_path):
    for moved, taken in ((0.0, True), (0.5, False)):
        (project.parent / "adjustment.json").write_text(json.dumps(adjustment(project, moved)))
        assert (adjustment_of(load(project)) is not None) == taken
    (project.parent / "adjustment.json").write_text(json.dumps(adjustment(project)))


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
