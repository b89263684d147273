"""Seams as a GeoPackage: written, edited, read back; `stereomate mosaic`, and what it refuses."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import pytest
import rasterio
import shapely
from run_survey import make, variant, write_tiny

from stereomate.cli import main
from stereomate.errors import FormatError
from stereomate.formats.seams import read_seams, write_seams
from stereomate.project.mosaic import edited_polygons, sources_of
from stereomate.project.run import RunOptions, plan
from stereomate.stereo.product import read_products

# A product with seams has to be made first.
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    return write_tiny(tmp_path_factory.mktemp("survey"))


@pytest.fixture(scope="module")
def made(survey, tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    return make(variant(survey, folder), folder / "out", agreement=False)


@pytest.fixture(scope="module")
def jobs(made):
    return plan(made.project, RunOptions())[1]


@pytest.fixture(scope="module")
def records(made):
    return read_seams(made.out / "seams.gpkg")[0]


def refused(tmp_path, jobs, records, crs="EPSG:2154") -> str:
    path = tmp_path / "edited.gpkg"
    write_seams(path, records, crs)
    with pytest.raises(FormatError) as caught:
        edited_polygons(path, jobs)
    assert str(path) in str(caught.value)
    return str(caught.value)


def test_the_file_names_photographs_and_covers_the_product(made, jobs, records):
    job = jobs[0]
    names = {p.name for p in job.photographs}
    # ground that one photograph alone shows has no right one
    assert {r.left for r in records} <= names
    assert {r.right for r in records} <= names | {""}
    outline = shapely.Polygon(job.grid.corners())
    union = shapely.union_all([r.geometry for r in records])
    assert union.symmetric_difference(outline).area < 1e-3 * outline.area
    assert all(0.05 < r.base_height < 2.0 for r in records if r.base_height == r.base_height)
    assert len(records) >= 2


def test_overlaps_and_gaps_are_refused_with_their_place(tmp_path, jobs, records):
    wide = replace(records[0], geometry=records[0].geometry.buffer(3.0))
    text = refused(tmp_path, jobs, [wide, *records[1:]])
    assert "must not overlap" in text
    assert "feature 1 and feature 2" in text
    assert "square map units" in text
    narrow = replace(records[0], geometry=records[0].geometry.buffer(-3.0))
    assert "must cover the whole product" in refused(tmp_path, jobs, [narrow, *records[1:]])


def test_unknown_names_are_refused(tmp_path, jobs, records):
    first, *rest = records
    assert "must name a photograph" in refused(tmp_path, jobs, [replace(first, left="nobody"), *rest])
    assert "one of the products" in refused(tmp_path, jobs, [replace(first, product="7"), *rest])
    turned = replace(first, left=first.right, right=first.left)
    assert "exchanged" in refused(tmp_path, jobs, [turned, *rest])
    assert "CRS of the project" in refused(tmp_path, jobs, records, "EPSG:25832")


def test_what_is_no_file_of_seams(tmp_path, jobs, records):
    with pytest.raises(FormatError, match="does not exist"):
        edited_polygons(tmp_path / "nothing.gpkg", jobs)
    text = tmp_path / "text.gpkg"
    text.write_text("seams")
    with pytest.raises(FormatError, match="cannot be read"):
        edited_polygons(text, jobs)
    bow = shapely.Polygon([(0, 0), (10, 10), (10, 0), (0, 10)])
    assert "valid polygon" in refused(tmp_path, jobs, [replace(records[0], geometry=bow)])
    assert "at least one" in refused(tmp_path, jobs, [])


def command(capsys, *arguments) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as end:
        main.run([str(a) for a in arguments])
    said = capsys.readouterr()
    return end.value.code or 0, said.out, said.err


def test_products_with_edited_seams(made, records, tmp_path, capsys):
    """A straight line across the product instead of the path that was found."""
    job = read_products(made.out / "stereo.json")[0].job
    pairs = [(a, b) for a in records for b in records if a.row < b.row and a.right and b.right]
    first, second = max(pairs, key=lambda pair: pair[0].geometry.intersection(pair[1].geometry).length)
    if shapely.centroid(first.geometry).x > shapely.centroid(second.geometry).x:
        first, second = second, first
    cols, rows = job.grid.size
    border = first.geometry.intersection(second.geometry)
    # both models show the ground of their seam
    at = job.grid.pixel_from_map(shapely.get_coordinates(shapely.centroid(border)))[0, 0] + 5.3
    halves = [
        replace(r, geometry=shapely.transform(shapely.box(a, 0, b, rows), job.grid.map_from_pixel))
        for r, a, b in ((first, 0, at), (second, at, cols))
    ]
    edited = tmp_path / "edited.gpkg"
    write_seams(edited, halves, "EPSG:2154")
    code, said, _ = command(capsys, "mosaic", made.out, "--seams", edited, "--check", "--json")
    assert code == 0
    assert json.loads(said) == {"polygons": {"": 2}}
    out = tmp_path / "out"
    code, _, error = command(capsys, "mosaic", made.out, "--seams", edited, "--out", out, "--quiet")
    assert (code, error) == (0, "")
    again = read_products(out / "stereo.json")[0].job
    assert len(again.seams.polygons) == 2
    names = [p.name for p in again.photographs]
    with rasterio.open(out / "lineage.tif") as file:
        lineage = file.read(1)
    for record, begin in ((first, math.floor(at) - 9), (second, math.ceil(at) + 1)):
        beside = lineage[rows // 2 - 40 : rows // 2 + 40, begin : begin + 8]
        assert (beside == names.index(record.left) + 1).mean() > 0.99
    code, said, _ = command(capsys, "mosaic", made.out, "--seams", edited, "--out", out)
    assert "up to date" in " ".join(said.split())


def test_wrong_seams_are_said_before_anything_is_made(made, records, tmp_path, capsys):
    edited = tmp_path / "edited.gpkg"
    write_seams(edited, records[1:], "EPSG:2154")
    code, _, error = command(capsys, "mosaic", made.out, "--seams", edited, "--out", tmp_path / "out")
    assert code == 2
    assert "must cover the whole product" in error
    assert not (tmp_path / "out").exists()


def test_sources(made, tmp_path):
    assert sources_of(made.out, None) == (made.project.path, made.out, True)
    with pytest.raises(FormatError, match="must be given"):
        sources_of(made.project.path, None)
    record = json.loads((made.out / "stereo.json").read_text())
    record["run"]["project_file"] = "elsewhere.toml"
    (tmp_path / "stereo.json").write_text(json.dumps(record))
    with pytest.raises(FormatError, match="not there any more"):
        sources_of(tmp_path, None)


def test_seams_of_the_project_file(survey, made, records, tmp_path):
    """The seams of a run, named in the project file, give the run again."""
    write_seams(tmp_path / "kept.gpkg", records, "EPSG:2154")
    result = make(variant(survey, tmp_path, seam_file='"kept.gpkg"'), tmp_path / "out", agreement=False)
    assert any(i.role == "seam_file" for i in result.project.inputs)
    for name in ("ortho.tif", "mate.tif", "lineage.tif"):
        assert (tmp_path / "out" / name).read_bytes() == (made.out / name).read_bytes()
