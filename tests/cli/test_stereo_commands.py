"""`stereomate measure`, `homogeneity` and `laws` on a small survey that is really run."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import rasterio
from typer.testing import CliRunner

import stereomate
from stereomate.cli.main import application
from stereomate.errors import FormatError, InputError
from stereomate.formats.measured_pairs import read_measured_pairs
from stereomate.formats.vector import read_features
from stereomate.frames.heights import HeightSystem
from stereomate.stereo.lineage import LineageRule
from stereomate.synthetic.files import write_survey
from stereomate.synthetic.survey import make_survey
from stereomate.terrain.model import HeightModel
from surveys import SMALLEST
from surveys import stereomate_says as run

OPTIONS = replace(SMALLEST, photos_per_strip=3)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stereo")
    survey = make_survey(OPTIONS)
    files = write_survey(survey, folder)
    run("--quiet", "run", files.project, "--out", folder / "out")
    return survey, files, folder / "out"


def write_pairs(path, product, count=20):
    """Positions on both products of ground points, as the law puts them, and where they are."""
    job = product.job
    cols, rows = job.grid.size
    rng = np.random.default_rng(1)
    pixels = np.array([cols, rows]) * rng.uniform(0.35, 0.65, (count, 2))
    left = job.grid.map_from_pixel(pixels)
    heights = job.heights.heights_at(left)
    shift = np.stack([job.law.q(heights), np.zeros(count)], axis=-1)
    right = job.grid.map_from_uv(job.grid.uv_from_map(left) - shift)
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["name", "left_x", "left_y", "right_x", "right_y"])
        for k in range(count):
            writer.writerow([f"P{k}", *left[k].tolist(), *right[k].tolist()])
    return np.column_stack([left, heights])


def test_measure_a_table(made, tmp_path):
    """Ground points come back at the height model; lineage by raster and by rule agree."""
    _, _, out = made
    product = stereomate.StereoProduct.open(out / "stereo.json")
    truth = write_pairs(tmp_path / "pairs.csv", product)
    text = run("measure", out, tmp_path / "pairs.csv", "--out", tmp_path / "points.csv")
    assert "‰ of the flying height" in text
    with (tmp_path / "points.csv").open() as file:
        rows = list(csv.DictReader(file))
    known = [k for k, row in enumerate(rows) if row["height"]]
    assert len(known) > 10
    found = np.array([[float(rows[k][c]) for c in ("easting", "northing", "height")] for k in known])
    np.testing.assert_allclose(found, truth[known], atol=2e-4)
    run("measure", out, tmp_path / "pairs.csv", "--out", tmp_path / "points.gpkg")
    layer = read_features(tmp_path / "points.gpkg")
    assert len(layer.features) == len(known)
    assert layer.features[0].geometry.has_z
    record = json.loads(run("measure", out, tmp_path / "pairs.csv", "--json"))
    assert record["summary"]["points"] == 20
    pairs = read_measured_pairs(tmp_path / "pairs.csv")
    rule = LineageRule(product.job)
    measured = product.measure(pairs.left, pairs.right)
    for side, xy in enumerate((pairs.left, pairs.right)):
        by_rule = rule.photographs(side, product.job.grid.pixel_from_map(xy)) - 1
        np.testing.assert_array_equal(measured.photographs[:, side], by_rule)
    both = product.measure_object((pairs.left, pairs.right), (pairs.left, pairs.right))
    np.testing.assert_allclose(both.heights[measured.measured], 0.0, atol=1e-12)


def test_products_and_height_model_that_do_not_belong_together(made, tmp_path):
    _, _, out = made
    folder = tmp_path / "copy"
    shutil.copytree(out.parent, folder)
    stereomate.StereoProduct.open(folder / "out")
    with rasterio.open(folder / "out" / "mate.tif", "r+", IGNORE_COG_LAYOUT_BREAK="YES") as file:
        file.update_tags(edited="yes")
    with pytest.raises(FormatError, match=r"mate\.tif"):
        stereomate.StereoProduct.open(folder / "out")
    stereomate.StereoProduct.open(folder / "out", verify=False)
    with rasterio.open(folder / "heights.tif", "r+") as file:
        file.write(file.read() + 1.0)
    with pytest.raises(InputError, match="height model"):
        stereomate.StereoProduct.open(folder / "out")
    with pytest.raises(FormatError, match="product"):
        stereomate.StereoProduct.open(folder / "out", "no such", verify=False)


def test_bad_tables(tmp_path):
    path = tmp_path / "pairs.csv"
    path.write_text("left_x,left_y,right_x\n1,2,3\n")
    with pytest.raises(FormatError, match="columns"):
        read_measured_pairs(path)
    path.write_text("left_x;left_y;right_x;right_y\n1;2;3;x\n")
    with pytest.raises(FormatError, match="row 1: right_y"):
        read_measured_pairs(path)


def test_homogeneity_of_a_project(made, tmp_path):
    _, files, _ = made
    text = run("homogeneity", files.project, "--object-height", "5,10", "--out", tmp_path, "--json")
    found = json.loads(text[text.index("[") :])
    assert [s["object_height_m"] for s in found] == [5.0, 10.0]
    for summary in found:
        assert 0.0 < summary["within_10_percent"] <= 1.0
        assert (tmp_path / summary["file"]).is_file()
        assert (tmp_path / summary["file"]).with_suffix(".png").is_file()
    assert "Object heights read through a law" in run(
        "homogeneity", files.project, "--object-height", "5", "--out", tmp_path
    )


def test_laws_of_a_project(made, tmp_path):
    _, files, _ = made
    text = run("laws", files.project, "--figure", tmp_path / "laws.png")
    assert "recommended: " in text
    assert (tmp_path / "laws.png").stat().st_size > 10_000
    record = json.loads(run("laws", files.project, "--json"))[0]
    assert {law["law"]["kind"] for law in record["laws"]} >= {"linear", "logarithmic", "natural"}
    assert record["recommended"]["base_m"] == pytest.approx(OPTIONS.base_m, rel=0.2)


def test_fold_map(made, tmp_path):
    """dq/dh times the slope along the row, counted here by differences of the height model itself."""
    _, files, _ = made
    text = run("laws", files.project, "--fold-map", tmp_path / "fold.tif")
    assert "folded: " in text
    record = json.loads(run("laws", files.project, "--json"))[0]
    (k,) = (k for k, law in enumerate(record["laws"]) if law["law"]["kind"] == "logarithmic")
    law = record["laws"][k]["law"]
    with rasterio.open(tmp_path / "fold.tif") as file:
        assert file.descriptions[k].startswith("logarithmic")
        values, transform = file.read(k + 1).astype(float), file.transform
    assert transform.a == pytest.approx(OPTIONS.terrain_step_m, rel=0.01)
    row, col = np.nonzero(np.isfinite(values))
    xy = np.stack(transform @ (col + 0.5, row + 0.5), axis=-1)
    along = np.array([transform.a, transform.d]) / np.hypot(transform.a, transform.d)
    model = HeightModel.open(files.heights, HeightSystem.ellipsoidal())
    ahead, behind, here = (model.heights_at(xy + step * along) for step in (0.01, -0.01, 0.0))
    expected = law["base_m"] / (law["w0_m"] - (here - law["reference_m"])) * (ahead - behind) / 0.02
    # positions on an edge of a cell of the height model have two slopes
    same = np.isclose(ahead - here, here - behind, atol=1e-6)
    assert same.mean() > 0.5
    np.testing.assert_allclose(values[row, col][same], expected[same], atol=2e-3)


def test_table_and_diagram(tmp_path):
    text = run("homogeneity", "table")
    assert "-35.71 / 34.51" in text
    line = run("homogeneity", "table", "--case", "100,200,0,0.05", "--slopes", "0,0", "--law", "linear")
    assert "5.26 / 0.00" not in line
    assert "-5.00 / 0.00" not in line
    run("homogeneity", "diagram", "--figure", tmp_path / "fig2.svg")
    assert (tmp_path / "fig2.svg").read_text().startswith("<?xml")


def planned_flight(files, folder):
    """The project without any photograph."""
    folder.mkdir()
    for path in (files.project, files.heights, files.orientation):
        shutil.copy(path, folder / path.name)
    return folder / files.project.name


def test_a_planned_flight_needs_no_photographs(made, tmp_path):
    """Laws and homogeneity from the orientation table alone, the same figures as with the photographs."""
    _, files, _ = made
    project = planned_flight(files, tmp_path / "planned")
    text = run("homogeneity", project, "--object-height", "5", "--out", tmp_path / "a", "--json")
    planned = json.loads(text[text.index("[") :])[0]
    text = run("homogeneity", files.project, "--object-height", "5", "--out", tmp_path / "b", "--json")
    flown = json.loads(text[text.index("[") :])[0]
    for name in ("area_m2", "seen_by_both", "within_5_percent", "error_rms_m"):
        assert planned[name] == pytest.approx(flown[name], rel=1e-6)
    assert "recommended: " in run("laws", project)
    result = CliRunner().invoke(application(), ["run", str(project), "--out", str(tmp_path / "out")])
    assert isinstance(result.exception, InputError)
    assert "photos.files" in str(result.exception)


def test_the_fitted_law_is_used_by_a_run(made, tmp_path):
    """`laws --write` makes a table, `run` takes it, `measure` finds it in stereo.json."""
    _, files, _ = made
    folder = tmp_path / "table"
    shutil.copytree(files.folder, folder, ignore=shutil.ignore_patterns("out"))
    project = folder / files.project.name
    run("laws", project, "--write", folder / "law.csv")
    text = project.read_text().replace('law = "logarithmic"', 'law = "table"\nlaw_table = "law.csv"')
    project.write_text(text)
    run("--quiet", "run", project, "--out", folder / "out")
    product = stereomate.StereoProduct.open(folder / "out")
    assert product.job.law.kind == "table"
    truth = write_pairs(tmp_path / "pairs.csv", product)
    pairs = read_measured_pairs(tmp_path / "pairs.csv")
    found = product.measure(pairs.left, pairs.right)
    np.testing.assert_allclose(found.points[found.measured], truth[found.measured], atol=2e-4)
    np.testing.assert_allclose(found.law_heights[found.measured], truth[found.measured, 2], atol=1e-6)
    project.write_text(text.replace('law_table = "law.csv"', ""))
    result = CliRunner().invoke(application(), ["check", str(project)])
    assert isinstance(result.exception, InputError)
    assert "law_table" in str(result.exception)
    (folder / "law.csv").write_text("height,parallax\n1,2\n3,1\n")
    project.write_text(text)
    result = CliRunner().invoke(application(), ["check", str(project)])
    assert "rising" in str(result.exception)


def pairs_file(path, left, right):
    rows = np.concatenate([left, right], axis=1)
    lines = [",".join(str(v) for v in row) for row in rows.tolist()]
    path.write_text("\n".join(["left_x,left_y,right_x,right_y", *lines]))
    return path


def test_bad_input_by_the_command_line(made, tmp_path):
    """Outside, nodata, exchanged eyes, an edited raster: a flag or an error that names it."""
    _, _, out = made
    product = stereomate.StereoProduct.open(out)
    write_pairs(tmp_path / "pairs.csv", product)
    pairs = read_measured_pairs(tmp_path / "pairs.csv")
    swapped = pairs_file(tmp_path / "swapped.csv", pairs.right, pairs.left)
    far = pairs_file(tmp_path / "far.csv", pairs.left + 1e5, pairs.right + 1e5)
    corner = product.job.grid.map_from_pixel([[0.5, 0.5]] * 2)
    empty = pairs_file(tmp_path / "empty.csv", corner, corner)
    record = json.loads(run("measure", out, far, "--json"))
    assert record["summary"]["refused"] == record["summary"]["points"]
    assert "outside" in record["points"][0]["flags"]
    record = json.loads(run("measure", out, empty, "--json"))
    assert "nodata" in record["points"][0]["flags"]
    # a law whose reference level is near the ground: parallaxes of some pixels are enough
    parallax = (pairs.left[:, 0] - pairs.right[:, 0]) / product.job.grid.gsd
    assert 2.0 < np.median(parallax) < 0.1 * product.job.law.base_m / product.job.grid.gsd
    result = CliRunner().invoke(application(), ["measure", str(out), str(swapped)])
    assert "exchanged" in str(result.exception)
    folder = tmp_path / "edited"
    shutil.copytree(out.parent, folder)
    with rasterio.open(folder / "out" / "mate.tif", "r+", IGNORE_COG_LAYOUT_BREAK="YES") as file:
        file.update_tags(edited="yes")
    for command in ("measure", "heights", "terrain"):
        arguments = [command, str(folder / "out"), *([str(far)] if command == "measure" else [])]
        result = CliRunner().invoke(application(), arguments)
        assert "edited or resampled" in str(result.exception)
    # back to the rasters as they were: one place for both photographs, no base at all, no height model
    shutil.copyfile(out / "mate.tif", folder / "out" / "mate.tif")
    json_file = folder / "out" / "stereo.json"
    good = json.loads(json_file.read_text())
    same = json.loads(json_file.read_text())
    for photograph in same["products"][0]["photographs"]:
        photograph["centre"] = good["products"][0]["photographs"][0]["centre"]
    json_file.write_text(json.dumps(same))
    record = json.loads(run("measure", folder / "out", tmp_path / "pairs.csv", "--json"))
    assert all("no_base" in point["flags"] for point in record["points"])
    bad = json.loads(json.dumps(good))
    bad["products"][0]["law"]["base_m"] = 0.0
    json_file.write_text(json.dumps(bad))
    result = CliRunner().invoke(application(), ["measure", str(folder / "out"), str(far)])
    assert "base_m: must be a positive number" in str(result.exception)
    good["products"][0]["height_model"]["file"] = "gone.tif"
    json_file.write_text(json.dumps(good))
    result = CliRunner().invoke(application(), ["measure", str(folder / "out"), str(far)])
    assert "must be there: every point is measured over the height model" in str(result.exception)
