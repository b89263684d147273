"""The project file a synthetic survey writes means that survey: the loader against known truth."""

from __future__ import annotations

import numpy as np
import pytest

from stereomate.frames.transform import map_from_tangent, tangent_from_map
from stereomate.project import load
from stereomate.project.check import check_project
from stereomate.synthetic.files import write_survey
from stereomate.synthetic.survey import make_survey
from surveys import SMALLEST


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    survey = make_survey(SMALLEST)
    return survey, write_survey(survey, tmp_path_factory.mktemp("synthetic"))


def test_the_loaded_survey_is_the_true_one(written):
    """Ground points imaged by the loaded cameras fall where the world's own cameras see them."""
    truth, files = written
    project = load(files.project)
    names = [photo.name for photo in truth.survey.photographs]
    assert [photo.name for photo in project.survey.photographs] == names
    points = np.array([point.position for point in (*truth.control_points, *truth.check_points)])
    local = tangent_from_map(project.tangent, project.frame, points)
    for number, photo in enumerate(project.survey.photographs):
        pixels, inside = photo.camera.image_from_camera(photo.orientation.camera_from_tangent(local))
        expected, seen = truth.project(number, points)
        np.testing.assert_array_equal(inside, seen)
        assert seen.any()
        np.testing.assert_allclose(pixels[seen], expected[seen], atol=1e-3)


def test_check_finds_what_was_planned(written):
    _, files = written
    report = check_project(load(files.project))
    assert report.is_good
    (pair,) = report.pairs
    assert pair.overlap == pytest.approx(SMALLEST.forward_overlap, abs=0.06)
    assert pair.base_m == pytest.approx(SMALLEST.base_m, abs=3 * SMALLEST.position_sigma_m)
    for row in report.photographs:
        assert row.gsd_m == pytest.approx(SMALLEST.gsd_m, rel=0.06)
        assert row.covered == 1.0


def test_centres_are_where_the_table_says(written):
    truth, files = written
    project = load(files.project)
    centres = map_from_tangent(project.tangent, project.frame, project.survey.centres_tangent)
    np.testing.assert_allclose(centres, truth.centres, atol=2e-6)
