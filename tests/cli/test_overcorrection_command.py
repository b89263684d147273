"""`stereomate overcorrection` as a user types it."""

from __future__ import annotations

import csv
import io
import json

import pytest

from stereomate.cli import main
from stereomate.relative.overcorrection import overcorrection_factor

FLAT = ["--point", "0,1500", "--point", "-500,1500", "--point", "500,1500"]


def run(*arguments):
    with pytest.raises(SystemExit) as end:
        main.run(["overcorrection", *arguments])
    return end.value.code


def test_text(capsys):
    assert run(*FLAT) == 0
    out = capsys.readouterr().out
    assert "n at point 5:  5.0000" in out
    assert "d = 1581.139 m, a = 316.228 m" in out
    assert "centre y = -250.000 m, z = 750.000 m, radius 790.569 m" in out
    assert "point 5 is outside it" in out


def test_json(capsys):
    assert (
        run("--point", "40,1500", "--point", "-480,1290", "--point", "530,1610", "--corrected", "3", "--json")
        == 0
    )
    value = json.loads(capsys.readouterr().out)
    expected = overcorrection_factor([[40, 1500], [-480, 1290], [530, 1610]], 3)
    assert value["n"] == pytest.approx(expected)
    assert value["n_read_off"] == pytest.approx(expected, rel=1e-9)
    assert len(value["n_per_metre_of_height"]) == 3
    assert value["omega_std_rad_per_metre_of_parallax"] > 0


def test_critical(capsys):
    arguments = ["--point", "0,1500", "--point", "-450,1350", "--point", "450,1350"]
    assert run(*arguments) == 0
    out = capsys.readouterr().out
    assert "±∞ (critical)" in out
    assert "not determined" in out
    assert run(*arguments, "--json") == 0
    value = json.loads(capsys.readouterr().out)
    assert (value["n"], value["critical"], value["critical_circle"]["side"]) == (None, True, "on")


@pytest.mark.parametrize("name", ["drawing.svg", "drawing.pdf", "drawing.png", "drawing.html"])
def test_figures(tmp_path, capsys, name):
    profile = tmp_path / "profile.csv"
    profile.write_text("y,z\n-900,1480\n0,1500\n900,1450\n")
    assert run(*FLAT, "--figure", str(tmp_path / name), "--profile", str(profile), "--construction") == 0
    assert (tmp_path / name).stat().st_size > 3000
    assert f"wrote {tmp_path / name}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (FLAT[:4], "--point: must be given three times"),
        ([*FLAT[:4], "--point", "1,2,3"], "must be Y,Z"),
        ([*FLAT[:4], "--point", "1,deep"], "'deep'"),
        ([*FLAT[:4], "--point", "500,nan"], "--point"),
        ([*FLAT[:4], "--point", "500,-1500"], "below the projection centre"),
        ([*FLAT, "--corrected", "8"], "corrected"),
        ([*FLAT[:2], "--point", "0,1000", *FLAT[4:]], "one ray"),
        ([*FLAT, "--figure", "drawing.jpg"], "must end in"),
        ([*FLAT, "--figure", "/dev/null/drawing.svg"], "cannot write"),
        ([*FLAT, "--figure", "/dev/null/drawing.html"], "cannot write"),
        ([*FLAT, "--profile", "nowhere.csv"], "nowhere.csv"),
        (["table", "III"], "must be I or II"),
        (["table", "I", "--tangent", "0.5"], "--tangent"),
        (["table", "--tangent", "1/0"], "--tangent"),
        (["table", "--tangent", "0.5", "--heights", "0.2:0.1:0.1"], "--heights"),
        (["table", "--tangent", "0.5", "--heights", "0:1"], "FROM:TO:STEP"),
        (["table", "--tangent", "0.5", "--heights", "0,1"], "below 1"),
        (["table", "--figure", "map.svg"], "one table"),
    ],
)
def test_wrong_use_is_one_line(capsys, arguments, message):
    assert run(*arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert message in captured.err
    assert captured.err.count("\n") == 1


def test_wrong_profile_names_the_line(tmp_path, capsys):
    profile = tmp_path / "profile.csv"
    profile.write_text("y,z\n-900,1480\n0 abc\n")
    assert run(*FLAT, "--profile", str(profile)) == 2
    assert "line 3" in capsys.readouterr().err


def test_tables(capsys):
    assert run("table") == 0
    out = capsys.readouterr().out
    assert "Table I:" in out
    assert "Table II:" in out
    assert out.count("±∞") == 5
    assert run("table", "ii", "--decimals", "3") == 0
    assert "3.171" in capsys.readouterr().out


def test_own_table(tmp_path, capsys):
    figure = tmp_path / "map.svg"
    assert (
        run(
            "table",
            "--tangent",
            "1/2",
            "--heights",
            "-0.1:0.1:0.1",
            "--h3",
            "0,0.2",
            "--csv",
            "--figure",
            str(figure),
        )
        == 0
    )
    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    assert [(row["h3_over_z1"], row["h5_over_z1"]) for row in rows] == [
        ("0.2", "-0.1"), ("0.2", "0.0"), ("0.2", "0.1"), ("0.0", "-0.1"), ("0.0", "0.0"), ("0.0", "0.1"),
    ]  # fmt: skip
    assert float(rows[4]["n"]) == pytest.approx(2.5)
    assert figure.stat().st_size > 3000
    assert run("table", "--csv") == 0
    assert len(capsys.readouterr().out.splitlines()) == 1 + 81 + 49
    assert run("table", "I", "--json") == 0
    value = json.loads(capsys.readouterr().out)[0]
    assert value["n"][0][4] is None
    assert value["critical_sum"] == pytest.approx(0.2)
