"""Accuracy by check points: against sums written out, a simulation, and the rules of the standards."""

import math

import numpy as np
import pytest

from stereomate.errors import InputError
from stereomate.geometry.accuracy import accuracy_class_cm, point_accuracy


def test_figures_of_a_handful_of_points():
    found = point_accuracy(
        [[0.03, -0.04, 0.1], [0.01, 0.02, -0.2], [math.nan, math.nan, 0.3]], np.full((3, 3), 0.02)
    )
    assert found.east.points == 2
    assert found.height.points == 3
    assert found.horizontal_points == 2
    assert found.east.rmse_m == pytest.approx(math.sqrt((9 + 1) / 2) / 100)
    assert found.height.mean_m == pytest.approx(0.2 / 3)
    assert found.vertical_m == pytest.approx(math.sqrt((0.01 + 0.04 + 0.09) / 3 + 0.0004))
    # Of the two plan coordinates each carries the error of its own survey.
    assert found.horizontal_m == pytest.approx(math.sqrt((9 + 1) / 2 * 1e-4 + (16 + 4) / 2 * 1e-4 + 2 * 4e-4))


def test_with_fewer_than_thirty_points_nothing_is_claimed():
    few = point_accuracy(np.full((29, 3), 0.01))
    assert few.verdict("horizontal", 0.5) == "not assessed"
    assert "29 check points" in few.statement("vertical")
    enough = point_accuracy(np.full((30, 3), 0.01))
    assert enough.verdict("vertical", 0.0101) == "pass"
    assert enough.verdict("vertical", 0.0099) == "fail"
    assert enough.verdict("vertical", None) == "not assessed"


def test_the_survey_of_the_check_points_can_fail_a_product():
    differences = np.full((40, 3), 0.02)
    assert point_accuracy(differences).verdict("vertical", 0.025) == "pass"
    assert point_accuracy(differences, np.full((40, 3), 0.02)).verdict("vertical", 0.025) == "fail"


def test_95_percent_measures_hold_95_percent_of_normal_errors():
    errors = np.random.default_rng(3).normal(0.0, 0.1, (200_000, 3))
    measures = {m["measure"]: m["value_m"] for m in point_accuracy(errors).iso19157()}
    assert np.mean(np.abs(errors[:, 2]) <= measures[36]) == pytest.approx(0.95, abs=0.002)
    assert np.mean(np.hypot(errors[:, 0], errors[:, 1]) <= measures[45]) == pytest.approx(0.95, abs=0.002)


@pytest.mark.parametrize(
    ("rmse", "cm"), [(0.0412, 4.2), (0.05, 5.0), (0.0999, 10.0), (1.234, 130.0), (0.0, 0.0)]
)
def test_class_is_the_smallest_that_holds(rmse, cm):
    assert accuracy_class_cm(rmse) == cm


def test_wrong_shapes_are_named():
    with pytest.raises(InputError, match="differences_m"):
        point_accuracy([[1.0, 2.0]])
    with pytest.raises(InputError, match="sigma_m"):
        point_accuracy([[0.0, 0.0, 0.0]], [[0.1, -0.1, 0.1]])


def test_no_points_is_a_value():
    nothing = point_accuracy(np.zeros((0, 3)))
    assert nothing.as_record()["rmse_h_m"] is None
    assert nothing.iso19157() == ()
