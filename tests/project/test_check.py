"""What `check` says about a project, in tables and as JSON."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from stereomate.cli import main
from stereomate.errors import CoverageError
from stereomate.project import load
from stereomate.project.check import check_project


def run(capsys, *arguments: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as end:
        main.run(list(arguments))
    out = capsys.readouterr()
    return end.value.code or 0, out.out, out.err


def test_figures_of_the_small_project(small):
    small.write_heights(np.full((40, 40), 200.0))
    small.write(
        "orientation.csv",
        "filename,x,y,z,omega,phi,kappa\nphoto_1,511988,5400000,500,0,0,0\nphoto_2,512012,5400000,500,0,0,0\n",
    )
    report = check_project(load(small.path))
    assert report.is_good
    # Vertical, 300 m above level ground: 0.1 mm / 30 mm * 300 m; a frame 60 m wide moved by 24 m.
    for row in report.photographs:
        assert (row.size_px, row.bands, row.dtype, row.camera) == ((60, 40), 3, "uint8", "small")
        assert row.gsd_m == pytest.approx(1.0, abs=1e-3)
        assert row.height_above_ground_m == pytest.approx(300.0, abs=0.01)
        assert row.tilt_deg == pytest.approx(0.0, abs=1e-4)
        assert row.covered == 1.0
    (pair,) = report.pairs
    assert pair.overlap == pytest.approx(36 / 60, abs=2e-3)
    assert pair.base_height == pytest.approx(24 / 300, rel=1e-3)
    assert pair.azimuth_deg == pytest.approx(90.0)
    assert pair.serves
    (product,) = report.products
    assert product.files == ("ortho.tif", "mate.tif", "lineage.tif")
    assert (product.gsd, product.bands, product.dtype, product.models) == (1.0, 3, "uint8", 1)
    assert (product.law, product.reference_m) == ("logarithmic", 200.0)
    assert product.base_m == pytest.approx(24.0, abs=0.02)
    assert product.w0_m == pytest.approx(300.0, abs=0.01)
    columns, rows = product.size_px
    assert columns == pytest.approx(84, abs=2)
    assert rows == pytest.approx(40, abs=2)
    assert product.megabytes == pytest.approx(columns * rows * (3 + 2) * 2 * 4 / 3 / 1e6)
    assert report.terrain is not None
    assert (report.terrain.lowest, report.terrain.highest) == (200.0, 200.0)
    assert report.terrain.resolution_m == pytest.approx(5.0, rel=1e-3)


def test_strength_of_geometry(small, capsys):
    """Flat ground under photographs of ±4° across: n by Kasper's formula for flat terrain, near critical."""
    small.write_heights(np.full((40, 40), 200.0))
    small.write(
        "orientation.csv",
        "filename,x,y,z,omega,phi,kappa\nphoto_1,511988,5400000,500,0,0,0\nphoto_2,512012,5400000,500,0,0,0\n",
    )
    report = check_project(load(small.path))
    (pair,) = report.pairs
    # Points at nine tenths of the half width: 20 m of 300 m; rays stand 0.03 of that apart.
    assert pair.factors == pytest.approx([0.5 * (1 + (300 / 18.0) ** 2)] * 2, rel=0.08)
    assert pair.geometry == "near critical"
    assert 0.0 < pair.strength < 0.2
    (warning,) = [text for text in report.warnings if "critical circle" in text]
    assert "photo_1 - photo_2" in warning
    _, out, _ = run(capsys, "check", str(small.path))
    assert "near critical" in " ".join(out.split())


def test_no_pair_is_said_and_an_orthophoto_is_left(small):
    small.replace("project.toml", "gsd = 1.0", "gsd = 1.0\nmin_base_height = 0.5")
    report = check_project(load(small.path))
    assert not report.is_good
    assert "no two photographs make a model" in report.problems[0]
    (product,) = report.products
    assert product.files == ("ortho.tif", "lineage.tif")
    assert product.base_m is None


def test_doubts(small):
    heights = np.full((40, 40), 200.0)
    heights[:, 20:] = -9999.0
    small.write_heights(heights)
    small.replace("project.toml", "gsd = 1.0", "gsd = 0.1")
    warnings = "\n".join(check_project(load(small.path)).warnings)
    assert "the height model covers" in warnings
    assert "times finer than the photographs" in warnings


def test_without_terrain(small):
    small.replace("project.toml", '[terrain]\nfile = "heights.tif"\n', "")
    with pytest.raises(CoverageError, match="needs a height model"):
        check_project(load(small.path))


def test_tables(small, capsys):
    code, out, err = run(capsys, "check", str(small.path))
    assert (code, err) == (0, "")
    for word in (
        "photo_1",
        "overlap",
        "base/height",
        "heights.tif",
        "ortho.tif, mate.tif, lineage.tif",
        "logarithmic",
        "Notes",
    ):
        assert word in out


def test_json(small, capsys):
    code, out, _ = run(capsys, "check", str(small.path), "--json")
    value = json.loads(out)
    assert (code, value["good"], value["problems"]) == (0, True, [])
    assert {row["name"] for row in value["photographs"]} == {"photo_1", "photo_2"}
    assert value["products"][0]["files"] == ["ortho.tif", "mate.tif", "lineage.tif"]
    assert math.isfinite(value["pairs"][0]["base_height"])


def test_markup_in_names_is_text(small, capsys):
    """rich takes [red] for a colour; a file may be called so."""
    for old, new in (("photo_1", "[red]photo_1"), ("photo_2", "[red]photo_2")):
        (small.folder / f"{old}.tif").rename(small.folder / f"{new}.tif")
        small.replace("orientation.csv", old, new)
    small.replace("project.toml", "photo_*.tif", "*photo_*.tif")
    _, out, _ = run(capsys, "check", str(small.path))
    assert "[red]photo_1" in out


def test_sheets_are_products(small):
    ring = "[[511980, 5399990], [512010, 5399990], [512010, 5400010], [511980, 5400010], [511980, 5399990]]"
    geometry = f'{{"type": "Polygon", "coordinates": [{ring}]}}'
    feature = f'{{"type": "Feature", "properties": {{"name": "A1"}}, "geometry": {geometry}}}'
    crs = '{"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::25832"}}'
    text = f'{{"type": "FeatureCollection", "crs": {crs}, "features": [{feature}]}}'
    small.write("sheets.geojson", text)
    small.replace("project.toml", "gsd = 1.0", 'gsd = 1.0\nsheets = "sheets.geojson"')
    (product,) = check_project(load(small.path)).products
    assert product.files == ("ortho_A1.tif", "mate_A1.tif", "lineage_A1.tif")
    assert product.size_px == (30, 20)
