"""`stereomate georef fix`: files for software that works in the grid, and its results brought back."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from stereomate.cli import main
from stereomate.errors import CrsError, FormatError, InputError, ProjectError
from stereomate.formats.orientation_table import read_orientation_table
from stereomate.project.audit import audit_project
from stereomate.project.fix import fix_project, results_back

TIES = "".join(
    f"{point} photo_{photo} {col} {row}\n"
    for point, (x, row) in {"a": (20, 10), "b": (32, 12), "c": (25, 30)}.items()
    for photo, col in ((1, x), (2, x - 12))
)


def run(*arguments):
    with pytest.raises(SystemExit) as end:
        main.run(["georef", "fix", *(str(argument) for argument in arguments)])
    return end.value.code


def test_heights_scaled_and_brought_back(small, capsys):
    small.replace("project.toml", "[terrain]", '[observations]\nfiles = "ties.mes"\n\n[terrain]')
    small.write("ties.mes", TIES)
    out = small.folder / "fixed"
    assert run(small.path, out, "--remedy", "M2", "--json") == 0
    value = json.loads(capsys.readouterr().out)
    assert len(value["files"]) == 3
    assert value["scale"] == pytest.approx(1 - 0.0004 + 1.8e-6, abs=4e-5)
    row = read_orientation_table(out / "orientation.csv").rows[0]
    assert row.numbers["z"] == pytest.approx(500.0 * value["scale"], abs=1e-4)
    assert row.numbers["omega"] == pytest.approx(0.5, abs=1e-8)
    assert run(small.path, out, "--back", out / "orientation.csv") == 0
    back = read_orientation_table(out / "orientation_true.csv").rows[0]
    assert back.numbers["z"] == pytest.approx(500.0, abs=2e-5)
    assert back.numbers["x"] == row.numbers["x"]


def test_principal_distance_needs_no_observations_but_a_ground(small):
    with pytest.raises(InputError, match="no point is seen twice"):
        fix_project(small.path, small.folder / "fixed", "M3")
    small.replace("project.toml", "[terrain]", '[control]\nfile = "control.app"\n\n[terrain]')
    small.write("control.app", "k 13 512000 5400000 200\n")
    made = fix_project(small.path, small.folder / "fixed", "M3", per_image=True)
    rows = read_orientation_table(small.folder / "fixed" / "orientation.csv").rows
    assert rows[0].numbers["z"] == pytest.approx(500.0, abs=1e-4)
    text = (small.folder / "fixed" / "orientation.csv").read_text().splitlines()[1]
    assert float(text.split(",")[-1]) == pytest.approx(300.0 / made.fixed.scale[0], abs=1e-4)
    assert made.fixed.ground_m == pytest.approx(200.0)
    for remedy, scale in (("M3", 1.0), ("M2", float(made.fixed.scale.mean()))):
        fix_project(small.path, small.folder / "fixed", remedy)
        (control,) = read_orientation_table(small.folder / "fixed" / "control.csv").rows
        assert control.numbers["z"] == pytest.approx(200.0 * scale, abs=1e-3)
    small.write("control.app", "k 13 5400000 512000 200\n")
    with pytest.raises(CrsError, match=r"control points lie outside.*x and y exchanged"):
        fix_project(small.path, small.folder / "fixed", "M3")


def test_what_cannot_be_fixed(small):
    with pytest.raises(ProjectError, match="M4 corrects image observations"):
        fix_project(small.path, small.folder / "fixed", "M4")
    with pytest.raises(FormatError, match="the record a fix wrote"):
        results_back(small.folder, small.folder / "orientation.csv", small.folder / "out.csv")
    small.replace("project.toml", 'adjusted_in = "space"\n', "")
    with pytest.raises(ProjectError, match=r'must be "grid" or "space".*georef audit'):
        fix_project(small.path, small.folder / "fixed", "M2")


@pytest.mark.real
def test_a_real_block_fixed_for_cartesian_software(data_folder, tmp_path):
    """M4's files, taken as a Cartesian grid, give the rigorous points: +0.019 m, not -0.009 m."""
    for file in (data_folder / "ign_borea_A").iterdir():
        shutil.copyfile(file, tmp_path / file.name)
    common = """
[project]
crs = "EPSG:2154"
heights = "ellipsoidal"
[[camera]]
name = "UCE-M3-f120-s06"
size_px = [26460, 17004]
principal_distance_px = 30975.0
principal_point_px = [13210.0, 8502.0]
[control]
file = "gcp_ellipsoidal.app"
"""
    (tmp_path / "project.toml").write_text(
        common + '[photos]\nfiles = "*.jp2"\norientation = "eo_lambert93_ign69.OPK"\nangles = "grid"\n'
        'heights = "fr_ign_RAF20.tif"\nadjusted_in = "grid"\n'
        '[observations]\nfiles = ["tie_points.mes", "gcp_image.mes"]\n'
    )
    made = fix_project(tmp_path / "project.toml", tmp_path / "fixed", "M4")
    assert len(made.files) == 4
    (tmp_path / "again.toml").write_text(
        common + '[photos]\nfiles = "*.jp2"\norientation = "fixed/orientation.csv"\nangles = "grid"\n'
        '[observations]\nfiles = "fixed/observations.mes"\npoints = "tie_points_world_ellipsoidal.mes"\n'
    )
    result = audit_project(tmp_path / "again.toml").audit
    plain = next(h for h in result.ranked if h.work == "cartesian" and h.heights.text == "ellipsoidal")
    np.testing.assert_allclose(plain.points.mean, (0.0, -0.002, 0.019), atol=0.001)
    assert plain.points.std[2] == pytest.approx(0.019, abs=0.001)
    assert plain.image_rms_px[1] == pytest.approx(0.187, abs=0.001)
