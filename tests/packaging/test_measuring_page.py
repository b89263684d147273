"""The tutorial on measuring runs as it is written, on a small survey."""

from __future__ import annotations

import numpy as np
import pytest
from pages import ROOT
from test_commands import SMALL, run, run_page

import stereomate
from stereomate.synthetic.files import write_survey
from stereomate.synthetic.survey import make_survey

pytestmark = pytest.mark.slow


def test_measuring_tutorial(tmp_path):
    write_survey(make_survey(SMALL), tmp_path / "demo")
    run(tmp_path, ["stereomate", "--quiet", "run", "demo/project.toml", "-o", "out"])
    job = stereomate.StereoProduct.open(tmp_path / "out").job
    left = job.grid.map_from_pixel(np.array([job.grid.size]) * [[0.5, 0.5], [0.45, 0.55]])
    shift = np.stack([job.law.q(job.heights.heights_at(left)), np.zeros(2)], axis=-1)
    right = job.grid.map_from_uv(job.grid.uv_from_map(left) - shift)
    rows = [f"P{k},{a[0]},{a[1]},{b[0]},{b[1]}" for k, (a, b) in enumerate(zip(left, right, strict=True))]
    (tmp_path / "pairs.csv").write_text("\n".join(["name,left_x,left_y,right_x,right_y", *rows]))
    run_page(tmp_path, ROOT / "docs" / "measuring.md")
    for name in ("laws.png", "fold.tif", "points.gpkg", "better.tif", "out/surface.tif", "again/report.html"):
        assert (tmp_path / name).is_file(), name
