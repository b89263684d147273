"""`stereomate empirical` as a user types it."""

from __future__ import annotations

import json

import numpy as np
import pytest

from stereomate.cli import main
from stereomate.relative.empirical.scenes import StandardTerrain, wrong_orientation

MOUNTAIN = ["--heights", "0,.05,.2,.1,.15,-.1", "--tangent", "1/3", "--base", "500"]


def run(*arguments):
    with pytest.raises(SystemExit) as end:
        main.run(["empirical", *arguments])
    return end.value.code


def result(capsys, *arguments):
    assert run(*arguments, "--json") == 0
    return json.loads(capsys.readouterr().out)


def test_notes(capsys):
    assert run(*MOUNTAIN) == 0
    out = capsys.readouterr().out
    assert "over-corrected -5.667 times" in out
    assert out.splitlines()[-1].startswith("cleared:")


def test_rules_side_by_side(capsys):
    assert run(*MOUNTAIN, "--rule", "flat", "--rule", "general", "--rule", "3") == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[3:]] == ["flat", "general", "3"]
    assert [line.split()[-1] for line in lines[3:]] == ["diverging", "cleared", "diverging"]


def test_critical_terrain_is_said(capsys):
    value = result(capsys, "--heights", "0,0,.1,.1,.1,.1", "--tangent", "1/3", "--base", "500")
    assert value["outcome"] == "critical"
    assert "no over-correction factor" in value["reason"]


@pytest.mark.parametrize(
    "options",
    [
        ["--independent"],
        ["--moved", "1"],
        ["--corrected", "4"],
        ["--profiles", "5"],
        ["--noise", "0.001", "--rounds", "3"],
        [
            "--step",
            "4:bz2",
            "--step",
            "2:by2",
            "--step",
            "3:phi2",
            "--step",
            "1:kappa2",
            "--step",
            "5:omega2",
        ],
    ],
)
def test_ways_of_operating(capsys, options):
    value = result(capsys, *options)
    assert value["outcome"] == "cleared"
    assert value["largest_parallax_m"][-1] < 0.01


def image_table(path, scale=1.0):
    terrain = StandardTerrain((0, 0.05, 0.1, 0.1, 0.05, -0.1), 2 / 3, 1500.0, 937.5)
    truth = wrong_orientation(937.5, 4)
    model = terrain.model(truth, with_grid=False)
    lines = ["point,x_left,y_left,x_right,y_right"]
    for name, left, right in zip(model.names, model.left, model.right, strict=True):
        xy = np.concatenate((left[:2] / -left[2], right[:2] / -right[2])) * 150.0 * scale
        lines.append(",".join([name, *(f"{value:.6f}" for value in xy)]))
    path.write_text("\n".join(lines) + "\n")
    return truth


def test_measured_image_coordinates(tmp_path, capsys):
    table = tmp_path / "points.csv"
    truth = image_table(table)
    value = result(capsys, str(table), "--principal-distance", "150", "--base", "937.5")
    assert value["outcome"] == "cleared"
    assert value["settings"][-1]["right"]["omega"] == pytest.approx(truth.right.omega, abs=1e-6)


def test_terrain_table(tmp_path, capsys):
    table = tmp_path / "points.csv"
    table.write_text(
        "point,x,y,h\n1,20,-90,30\n2,930,60,0\n3,-10,-1000,80\n4,940,-960,40\n5,450,900,-60\n6,900,990,20\n"
    )
    options = [
        "--rule",
        "whole",
        "--base",
        "937.5",
        "--section",
        "1,3,5",
        "--step",
        "2:by2",
        "--step",
        "1:kappa2",
    ]
    options += ["--step", "4:bz2", "--step", "3:phi2", "--step", "5:omega2"]
    value = result(capsys, str(table), *options)
    assert value["outcome"] == "cleared"
    assert value["points"] == ["1", "2", "3", "4", "5", "6"]
    # Point 6 was not used and is free of parallax too.
    assert abs(value["parallaxes_m"][-1][5]) < 1e-4


def test_figures(tmp_path, capsys):
    figure, course = tmp_path / "residuals.svg", tmp_path / "course.png"
    assert (
        run(
            *MOUNTAIN, "--rule", "flat", "--rule", "general", "--figure", str(figure), "--course", str(course)
        )
        == 0
    )
    made = sorted(path.name for path in tmp_path.iterdir())
    assert made == ["course.png", "residuals-flat.svg", "residuals-general.svg"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--heights", "0,0,0"], "six heights"),
        (["--heights", "0,0,0,0,0,high"], "'high'"),
        (["--rule", "best"], "rule"),
        (["--rule", "nan"], "finite"),
        (["--step", "5-omega2"], "POINT:MOTION"),
        (["--step", "2:by2", "--step", "5:bx"], "POINT:MOTION"),
        (["--step", "5:omega2"], "--step"),
        (["--step", "2:by2", "--step", "5:omega2", "--section", "1,5"], "three points"),
        (["--step", "2:by2", "--step", "9:omega2", "--section", "1,3,9"], "'9'"),
        (["--corrected", "1"], "corrected"),
        (["--cycles", "0"], "cycles"),
        (["--base", "-5"], "base"),
        (["nowhere.csv"], "nowhere.csv"),
    ],
)
def test_wrong_use_is_one_line(capsys, arguments, message):
    assert run(*arguments) == 2
    captured = capsys.readouterr()
    assert message in captured.err
    assert captured.err.count("\n") == 1


def test_image_coordinates_in_other_units(tmp_path, capsys):
    table = tmp_path / "points.csv"
    image_table(table, scale=25.0)  # as if pixels of 40 µm
    assert run(str(table), "--principal-distance", "150") == 2
    assert "must be millimetres" in capsys.readouterr().err
    assert run(str(table)) == 2
    assert "--principal-distance" in capsys.readouterr().err
