"""Bases of two directions: two products with rotated grids that continue each other."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from run_survey import make, write_tiny

from stereomate.project import load
from stereomate.project.joins import measured_joins
from stereomate.project.run import RunOptions, plan
from stereomate.rectify.mosaic import plan_mosaics


@pytest.fixture(scope="module")
def crossed(tmp_path_factory):
    """Two strips; one model along the first strip, one across both."""
    folder = tmp_path_factory.mktemp("crossed")
    project = write_tiny(
        folder, strips=2, photos_per_strip=2, side_overlap=0.5, colour_sigma=0.05, exposure_sigma=0.05
    )
    text = project.read_text().replace(
        "gsd = 0.5", 'gsd = 0.5\npairs = [["strip1_01", "strip1_02"], ["strip1_02", "strip2_01"]]'
    )
    project.write_text(text)
    return project


@pytest.mark.slow
def test_each_base_direction_is_a_product_and_they_agree(crossed, tmp_path):
    jobs = plan(load(crossed), RunOptions())[1]
    assert [job.name for job in jobs] == ["", "2"]
    turn = jobs[1].grid.rotation - jobs[0].grid.rotation
    assert abs(math.degrees(math.remainder(turn, math.pi))) > 60.0
    for job in jobs:
        model = job.models[0]
        assert model.base_u_m > 0.0
        # rows run along the base, or so nearly that an object 20 m high shows less than a pixel
        assert abs(model.base_v_m) * 20.0 / (model.height_above_ground_m - 20.0) / 0.5 < 1.0
    (recorded,) = measured_joins(jobs)
    balanced = [job for job, _ in plan_mosaics(jobs)]
    assert all(job.seams is None and job.balance is not None for job in balanced)
    (join,) = measured_joins(balanced)
    assert join.products == ("", "2")
    assert join.windows > 10
    assert np.abs(join.shift_px).max() < 0.1
    assert max(join.spread_px) < 0.3
    assert recorded.step > 0.02
    assert join.step < 0.5 * recorded.step
    make(crossed, tmp_path / "out")
    record = json.loads((tmp_path / "out" / "stereo.json").read_text())
    assert record["run"]["joins"][0]["windows"] == join.windows
