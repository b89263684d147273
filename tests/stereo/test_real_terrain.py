"""The given 24 m height model of a real pair, as the pair itself sees it."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

from stereomate.cli.main import application

pytestmark = pytest.mark.real

PROJECT = """
[project]
format = 1
crs = "+proj=tmerc +lat_0=0 +lon_0=25 +k=1 +x_0=0 +y_0=0 +ellps=WGS84 +units=m"
heights = "undeclared"
[[camera]]
name = "DMC"
principal_distance_mm = 120.0
size_px = [640, 1152]
sensor_mm = [92.16, 165.888]
principal_point_mm = [0.0, 0.0]
[photos]
files = "{0}/*_RGB.tif"
orientation = "{0}/ngi_xyz_opk.csv"
angles = "grid"
adjusted_in = "grid"
[terrain]
file = "{0}/dem.tif"
[products]
gsd = 5.0
"""


def test_ngi_height_model_and_orientation(data_folder, tmp_path):
    """Without bias, scatter below that of sparse matches, rays that meet to a fifth of a pixel."""
    (tmp_path / "project.toml").write_text(PROJECT.format(data_folder / "ngi_strip05"))
    run = ["--threads", "1", "--quiet", "run", str(tmp_path / "project.toml"), "--out", str(tmp_path / "out")]
    assert CliRunner().invoke(application(), run).exit_code == 0
    options = ["--above", "60", "--below", "60", "--step", "1", "--largest-object", "100", "--json"]
    said = CliRunner().invoke(application(), ["--threads", "1", "terrain", str(tmp_path / "out"), *options])
    assert said.exit_code == 0
    record = json.loads(said.output[said.output.index("{") :])
    terrain, (model, *_) = record["terrain"], record["surface"]["models"]
    assert terrain["nodes"] > 10_000
    assert abs(terrain["median_m"]) < 0.5
    assert abs(terrain["mean_m"]) < 0.5
    assert terrain["nmad_m"] < 4.0
    assert max(map(abs, terrain["tilt_per_mille"])) < 0.5
    # the photographs have 5.9 m to the pixel
    assert model["miss_rms_m"] < 0.2 * 5.9
    assert (tmp_path / "out" / "terrain.png").stat().st_size > 10_000
