"""`stereomate georef` as a user types it."""

from __future__ import annotations

import json

import pytest

import stereomate
from stereomate.cli import main
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame

# The paper's place: Gauss-Krüger, 2 degrees from the meridian, 48 degrees north.
GK = "+proj=tmerc +lat_0=0 +lon_0=9 +k=1 +x_0=500000 +y_0=0 +ellps=bessel +units=m"


def run(*arguments):
    with pytest.raises(SystemExit) as end:
        main.run(["georef", *(str(argument) for argument in arguments)])
    return end.value.code


@pytest.fixture(scope="module")
def paper():
    x, y, _ = MapFrame(GK, HeightSystem.ellipsoidal()).map_from_geodetic((11.0, 48.0, 0.0))
    return ["predict", "--crs", GK, "--at", f"{x},{y}", "--flying-height", "1500", "--ground", "0",
            "--relief", "200", "--curvature", "sphere", "--level", "ellipsoid"]  # fmt: skip


def test_the_example_of_the_paper(paper, capsys, tmp_path):
    assert run(*paper, "--json", "--figure", tmp_path / "map.svg") == 0
    value = json.loads(capsys.readouterr().out)
    assert value["expected_m"] == pytest.approx(0.09)
    assert value["equation_2_m"] == pytest.approx(0.4104, abs=1e-4)
    assert value["equation_3_m"] == pytest.approx(0.0547, abs=1e-4)
    assert value["equation_4_m"] == pytest.approx(-0.4104, abs=1e-4)
    assert len(value["outcomes"]) == 21
    p1 = next(o for o in value["outcomes"] if (o["mode"], o["method"]) == ("direct", "P1"))
    assert p1["centre_error_m"][2] == pytest.approx(-0.4104, abs=5e-4)
    assert not p1["harmless"]
    assert "the block" in (tmp_path / "map.svg").read_text()


def test_the_prediction_in_words(paper, capsys):
    assert run(*paper) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "0.410 m too low" in out
    assert "4.6 times the 0.090 m" in out
    assert "M1 (tangent frame) -0.0000" in out or "M1 (tangent frame) +0.0000" in out


def test_what_cannot_be_predicted(paper, capsys):
    for old, new, word in (
        (paper[4], "12", "--at"),
        ("sphere", "flat", "classical"),
        (GK, "EPSG:4326", "projected"),
    ):
        arguments = [new if argument == old else argument for argument in paper]
        assert run(*arguments) == 2
        assert word in capsys.readouterr().err


def test_public_names():
    tau, gamma = stereomate.grid_factors("EPSG:25832", 650000.0, 5316000.0)
    assert float(tau) == pytest.approx(1 - 123.5e-6, abs=1e-7)
    assert float(gamma) > 0.0
    assert callable(stereomate.homogeneity)
