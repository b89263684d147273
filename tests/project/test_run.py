"""`stereomate run` on a tiny synthetic survey: what it writes, and that it is what it says."""

from __future__ import annotations

import dataclasses
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import rasterio
import tifffile
from run_survey import make, raster, terrain_heights, variant, write_tiny

import stereomate.project.run as running
from stereomate.cli import main
from stereomate.errors import CoverageError, FormatError, ImageError, OrientationError
from stereomate.forms import STEREO
from stereomate.rectify.engine import rectify_window
from stereomate.stereo.agreement import measure_agreement
from stereomate.stereo.product import product_record, read_products
from stereomate.terrain.model import HeightModel
from stereomate.tiles.plan import TilePlan


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    """The project file of a survey of three photographs, flown to the east."""
    return write_tiny(tmp_path_factory.mktemp("survey"))


@pytest.fixture(scope="module")
def made(survey, tmp_path_factory):
    """The products of the survey, as nobody may change them."""
    folder = tmp_path_factory.mktemp("made")
    return make(variant(survey, folder), folder / "out", report=True)


@pytest.fixture
def copy(made, tmp_path):
    """Project file and products, to be spoiled; at the same depth, as names in stereo.json are relative."""
    shutil.copy(made.project.path, tmp_path / "project.toml")
    shutil.copytree(made.out, tmp_path / "out")
    return tmp_path / "project.toml", tmp_path / "out"


def command(capsys, *arguments) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as end:
        main.run([str(a) for a in arguments])
    said = capsys.readouterr()
    return end.value.code or 0, said.out, said.err


def contents(folder):
    return {p.relative_to(folder): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


# --- what is written --------------------------------------------------------------------------------------


def test_products_are_written_and_nothing_else(made):
    rasters = ["lineage.tif", "mate.tif", "ortho.tif"]
    beside = ["item.json", "report.html", "report.json", "seams.gpkg", "stereo.json"]
    assert sorted(p.name for p in made.out.iterdir()) == sorted(rasters + beside)
    grid = made.products[0].product.job.grid
    for name in ("ortho.tif", "mate.tif", "lineage.tif"):
        with rasterio.open(made.out / name) as file:
            assert (file.width, file.height) == grid.size
            assert file.crs.to_epsg() == 2154
            assert tuple(file.transform)[:6] == pytest.approx(grid.affine, abs=1e-9)
            assert file.profile["blockxsize"] == 128
            assert file.overviews(1)
            assert file.tags(ns="IMAGE_STRUCTURE")["COMPRESSION"] == "ZSTD"
            assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
    with rasterio.open(made.out / "ortho.tif") as file:
        assert [c.name for c in file.colorinterp] == ["red", "green", "blue"]
        assert file.tags()["ISO19115_ASSOCIATION"] == "stereoMate mate.tif"
    with rasterio.open(made.out / "lineage.tif") as file:
        assert file.dtypes == ("uint16", "uint16")
        assert file.descriptions == ("photograph of the orthophoto", "photograph of the stereomate")


def test_stereo_json_gives_the_job_and_its_pixels_back(made):
    (read,) = read_products(made.out / "stereo.json")
    job = made.products[0].product.job
    written = json.loads((made.out / "stereo.json").read_text())["products"][0]
    assert json.loads(json.dumps(product_record(read)).replace("NaN", "null")) == written
    for one, other in zip(read.job.models, job.models, strict=True):
        assert np.array_equal(dataclasses.astuple(one), dataclasses.astuple(other), equal_nan=True)
    assert read.job.law == job.law
    assert read.job.grid == job.grid
    assert read.job.options == job.options
    # A chunk of the run: its lattice, and so every bit, is the same.
    window = TilePlan(job.grid.size, 128, 2).chunks[1].window
    ortho, mate = rectify_window(read.job, window)
    for part, name in ((ortho, "ortho.tif"), (mate, "mate.tif")):
        pixels, valid = raster(made.out / name)
        cut = (slice(window.row0, window.row1), slice(window.col0, window.col1))
        np.testing.assert_array_equal(part.valid != 0, valid[cut])
        assert valid[cut].mean() > 0.5
        np.testing.assert_array_equal(np.moveaxis(part.pixels, -1, 0), pixels[:, *cut])


def shown_in_mate(result, lineage):
    """Per orthophoto pixel: photographs of orthophoto and stereomate for its ground (from 1; 0 none)."""
    job = result.products[0].product.job
    rows, cols = lineage.shape[1:]
    col, row = np.meshgrid(np.arange(cols) + 0.5, np.arange(rows) + 0.5)
    ground = terrain_heights(job.heights.path, job.grid.map_from_pixel(np.stack([col, row], axis=-1)))
    at = np.floor(col - np.asarray(job.law.q(ground)) / job.grid.gsd).astype(int)
    inside = (at >= 0) & (at < cols)
    right = np.where(inside, lineage[1][row.astype(int), np.clip(at, 0, cols - 1)], 0)
    return lineage[0], right, np.clip(at, 0, cols - 1)


def near_a_seam(values, reach=3):
    changes = np.zeros(values.shape, bool)
    changes[:, 1:] |= values[:, 1:] != values[:, :-1]
    changes[1:] |= values[1:] != values[:-1]
    out = changes.copy()
    for shift in range(-reach, reach + 1):
        out |= np.roll(changes, shift, axis=1) | np.roll(changes, shift, axis=0)
    return out


def test_left_and_right_are_a_model_and_their_seams_coincide(made):
    lineage, _ = raster(made.out / "lineage.tif")
    job = made.products[0].product.job
    left, right, at = shown_in_mate(made, lineage)
    rows = np.arange(left.shape[0])[:, None]
    # Three pixels either side of a seam of either raster, where rounding decides.
    clear = ~near_a_seam(left) & ~near_a_seam(lineage[1])[rows, at]
    both = clear & (left > 0) & (right > 0)
    assert both.sum() > 20_000
    assert not (left == right)[both].any()
    allowed = {(m.left + 1, m.right + 1) for m in job.models if m.right >= 0}
    found = set(zip(left[both].tolist(), right[both].tolist(), strict=True))
    assert found <= allowed
    # More than one model serves, so there are seams to coincide.
    assert len(found) > 1


def test_lineage_is_of_the_pixels_that_are_there(made):
    lineage, _ = raster(made.out / "lineage.tif")
    for band, name in enumerate(("ortho.tif", "mate.tif")):
        valid = raster(made.out / name)[1]
        # 0 where no photograph serves, also where the other raster has one.
        np.testing.assert_array_equal(lineage[band] > 0, valid)
        assert (~valid).any()


def test_left_is_the_western_photograph_and_high_ground_moves_left(made):
    job = made.products[0].product.job
    u = [p.orientation.centre[0] for p in job.photographs]
    assert all(u[m.left] < u[m.right] for m in job.models if m.right >= 0)
    assert job.law.slope(300.0) > 0.0


def test_measured_parallaxes_are_recorded(made):
    agreement = json.loads((made.out / "stereo.json").read_text())["products"][0]["agreement"]
    found = agreement["orthophoto_against_stereomate"]
    assert found["count"] > 30
    assert np.abs(found["median_px"]).max() < 0.1
    assert np.max(found["nmad_px"]) < 0.3


def test_a_wrong_height_model_shows_in_the_agreement_by_base_over_height(made):
    """Heights 3 m too high: features move to the nadir of their photograph, left against right by B/H dh."""
    job = made.products[0].product.job
    high = HeightModel.from_array(
        job.heights.patch(0, 0, *job.heights.shape[::-1]).heights + 3.0, job.heights.affine, job.heights.frame
    )
    found = measure_agreement(dataclasses.replace(job, heights=high))
    served = [m for m in job.models if m.right >= 0 and m.penalty < 0.3]
    expected = -3.0 * np.mean([m.base_u_m / m.height_above_ground_m for m in served]) / job.grid.gsd
    assert expected < -1.0
    for statistics in (found.ortho_ortho, found.ortho_mate):
        assert statistics.count > 30
        assert statistics.median_px[0] == pytest.approx(expected, rel=0.08)
        assert abs(statistics.median_px[1]) < 0.1


def test_stac_item_says_that_the_two_belong_together(made):
    item = json.loads((made.out / "item.json").read_text())
    stereo = json.loads((made.out / "stereo.json").read_text())
    assert (item["type"], item["stac_version"], item["id"]) == ("Feature", "1.1.0", "synthetic")
    assert set(item["assets"]) == {"ortho", "mate", "lineage", "stereo", "report"}
    for asset in item["assets"].values():
        assert (made.out / asset["href"]).is_file()
    for role in ("ortho", "mate", "lineage"):
        asset = item["assets"][role]
        assert asset["file:checksum"] == "1220" + stereo["products"][0]["sha256"][f"{role}.tif"]
    assert [link["href"] for link in item["links"] if link["rel"] == "stereoMate"] == ["./mate.tif"]
    assert item["properties"]["iso19115:associatedResource"][0] == {
        "associationType": "stereoMate",
        "resource": "ortho",
        "associatedWith": "mate",
    }
    assert item["properties"]["proj:code"] == "EPSG:2154"
    with rasterio.open(made.out / "ortho.tif") as file:
        assert item["properties"]["proj:shape"] == [file.height, file.width]
        assert item["properties"]["proj:transform"][:6] == pytest.approx(tuple(file.transform)[:6])
        lon, lat = file.lnglat()
    _follows_published_rules(item)
    west, south, east, north = item["bbox"]
    assert west < lon < east
    assert south < lat < north
    # Corsica
    assert 8.5 < west < 9.6
    assert 41.3 < south < 43.1


def _follows_published_rules(item):
    """Rules of the extensions projection 2.0 and file 2.1, by their published schemas."""
    assert [re.sub(r".*github\.io/|/schema\.json", "", url) for url in item["stac_extensions"]] == [
        "projection/v2.0.0", "file/v2.1.0",
    ]  # fmt: skip
    fields = {key: value for key, value in item["properties"].items() if key.startswith("proj:")}
    assert set(fields) <= {"proj:code", "proj:wkt2", "proj:shape", "proj:transform"}
    assert fields["proj:code"] is None or re.fullmatch(r"[A-Z]+:[0-9A-Za-z]+", fields["proj:code"])
    assert all(type(number) is int for number in fields["proj:shape"])
    assert len(fields["proj:transform"]) in (6, 9)
    assert {type(number) for number in fields["proj:transform"]} <= {float, int}
    for asset in item["assets"].values():
        assert {key for key in asset if ":" in key} <= {"file:checksum"}
        assert re.fullmatch("[a-f0-9]+", asset.get("file:checksum", "0"))
    corners = np.array(item["geometry"]["coordinates"][0])
    assert (corners[0] == corners[-1]).all()
    (x, y), (x1, y1) = corners[:-1].T, corners[1:].T
    assert (x * y1 - x1 * y).sum() > 0  # counter-clockwise, as RFC 7946 asks
    assert [*corners.min(axis=0), *corners.max(axis=0)] == item["bbox"]


def test_report_holds_everything_itself(made):
    page = (made.out / "report.html").read_text(encoding="utf-8")
    loads = re.findall(r"""(?:src|href|data|action|poster|srcset)\s*=\s*["']?([^"'\s>]+)""", page)
    loads += re.findall(r"url\(\s*[\"']?([^)\"']+)", page)
    assert loads
    outside = [u for u in loads if not u.startswith(("data:", "#"))]
    assert outside == []
    assert "<script src" not in page
    assert "@import" not in page
    assert page.count("data:image/") >= 6
    for words in ("Not modelled", "nominal base", "base/height", "synthetic"):
        assert words in page


# --- running again ----------------------------------------------------------------------------------------


def test_second_run_computes_nothing(copy, monkeypatch):
    project, out = copy
    before = contents(out)

    def refuse(*_, **__):
        raise AssertionError("computed again")

    monkeypatch.setattr(running, "_make_products", refuse)
    assert make(project, out).up_to_date
    assert contents(out) == before


def test_a_changed_file_or_a_missing_report_is_made_again(copy):
    project, out = copy
    (out / "report.html").unlink()
    (out / "mate.tif").write_bytes(b"edited")
    before = (out / "ortho.tif").read_bytes()
    assert not make(project, out, report=True).up_to_date
    assert (out / "report.html").is_file()
    assert (out / "ortho.tif").read_bytes() == before
    assert make(project, out).up_to_date


def test_fresh_makes_the_same_bytes_again(copy):
    project, out = copy
    before = contents(out)
    result = make(project, out, report=True, fresh=True)
    assert not result.up_to_date
    assert result.products[0].chunks_reused == 0
    after = contents(out)
    same = [name for name in before if name.suffix == ".tif" or name.name == "stereo.json"]
    assert len(same) == 4
    for name in same:
        assert after[name] == before[name]


def test_orthophoto_alone_removes_the_mate_of_the_run_before(copy):
    project, out = copy
    (out / "notes.txt").write_text("mine")
    make(project, out, report=True, stereo=False, agreement=False)
    assert sorted(p.name for p in out.iterdir()) == [
        "item.json", "lineage.tif", "notes.txt", "ortho.tif", "report.html", "report.json", "seams.gpkg",
        "stereo.json",
    ]  # fmt: skip
    with rasterio.open(out / "lineage.tif") as file:
        assert file.count == 1
    item = json.loads((out / "item.json").read_text())
    assert "mate" not in item["assets"]
    assert item["links"] == []
    (product,) = read_products(out / "stereo.json")
    assert not product.job.is_stereo
    assert product.files.mate is None


def test_newer_stereo_json_names_both_forms_and_is_kept(copy):
    project, out = copy
    path = out / "stereo.json"
    path.write_text(path.read_text().replace(f'"format": {STEREO.version}', '"format": 7', 1))
    before = contents(out)
    with pytest.raises(FormatError, match=rf"form 7.*form {STEREO.version}"):
        make(project, out)
    assert contents(out) == before
    # Whoever asks for it gets it made anew.
    assert not make(project, out, fresh=True).up_to_date


# --- what may be asked for --------------------------------------------------------------------------------


def test_a_pair_is_named_by_photographs_of_the_survey(survey, tmp_path, capsys):
    for pair, words in (
        (("strip1_01", "strip9"), "got 'strip9' (such as strip1_"),
        (("strip1_01",) * 2, "two"),
    ):
        code, _, err = command(capsys, "run", survey, "-o", tmp_path / "out", "--pair", *pair)
        assert code == 2
        assert "--pair: must name" in err
        assert words in err
        assert not (tmp_path / "out").exists()


def test_one_pair(survey, tmp_path, capsys):
    project = variant(survey, tmp_path)
    names = sorted(p.stem for p in survey.parent.glob("strip*.tif"))
    code, said, _ = command(
        capsys,
        "run",
        project,
        "-o",
        tmp_path / "out",
        "--pair",
        f"{names[2]}.tif",
        names[1],
        "--json",
        "--threads",
        "1",
    )
    assert code == 0
    assert json.loads(said)["products"][0]["models"] == 1
    (product,) = read_products(tmp_path / "out" / "stereo.json")
    model = next(m for m in product.job.models if m.right >= 0)
    photographs = product.job.photographs
    # Asked for right to left; left is the western one all the same.
    assert [photographs[model.left].name, photographs[model.right].name] == names[1:]
    assert (tmp_path / "out" / "run.log").read_text().count("command line") == 1


def test_a_pair_that_is_none(survey, tmp_path):
    project = variant(survey, tmp_path)
    with pytest.raises(OrientationError, match="nobody"):
        make(project, tmp_path / "out", pairs=(("nobody", "strip1_1"),))


def test_bounds_are_snapped_to_whole_gsds(survey, made, tmp_path):
    left, bottom, right, top = rasterio.open(made.out / "ortho.tif").bounds
    x, y = 0.5 * (left + right), 0.5 * (bottom + top)
    project = variant(survey, tmp_path, bounds=f"[{x - 20.3}, {y - 11.2}, {x + 20.1}, {y + 11.3}]", gsd="0.6")
    make(project, tmp_path / "out", agreement=False)
    with rasterio.open(tmp_path / "out" / "ortho.tif") as file:
        for edge, wanted, side in (
            (file.bounds.left, x - 20.3, -1), (file.bounds.bottom, y - 11.2, -1),
            (file.bounds.right, x + 20.1, 1), (file.bounds.top, y + 11.3, 1),
        ):  # fmt: skip
            assert edge / 0.6 == pytest.approx(round(edge / 0.6), abs=1e-6)
            assert 0.0 <= side * (edge - wanted) < 0.6 + 1e-6


def test_sheets_are_products_of_one_lattice(survey, made, tmp_path):
    left, bottom, right, top = rasterio.open(made.out / "ortho.tif").bounds
    x, y = 0.5 * (left + right), 0.5 * (bottom + top)
    rings = {"A": (x - 30.2, x), "B": (x, x + 30.7)}
    features = [
        {
            "type": "Feature",
            "properties": {"name": name},
            "geometry": {
                "type": "Polygon",
                "coordinates": [[[a, y - 20.1], [b, y - 20.1], [b, y + 20.1], [a, y + 20.1], [a, y - 20.1]]],
            },
        }
        for name, (a, b) in rings.items()
    ]
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::2154"}}
    text = json.dumps({"type": "FeatureCollection", "crs": crs, "features": features})
    (tmp_path / "sheets.geojson").write_text(text)
    result = make(
        variant(survey, tmp_path, sheets='"sheets.geojson"'), tmp_path / "out", report=True, agreement=False
    )
    assert [r.product.job.name for r in result.products] == ["A", "B"]
    for name in ("A", "B"):
        for raster_name in (
            f"ortho_{name}.tif",
            f"mate_{name}.tif",
            f"lineage_{name}.tif",
            f"item_{name}.json",
        ):
            assert (tmp_path / "out" / raster_name).is_file()
        with rasterio.open(tmp_path / "out" / f"ortho_{name}.tif") as file:
            assert file.bounds.left / 0.5 == round(file.bounds.left / 0.5)
            assert file.bounds.top / 0.5 == round(file.bounds.top / 0.5)
    assert len(read_products(tmp_path / "out" / "stereo.json")) == 2


def test_rows_along_the_base_where_the_flight_is_askew(tmp_path):
    (tmp_path / "survey").mkdir()
    base = write_tiny(tmp_path / "survey", heading_deg=60.0, photos_per_strip=2)
    turned = make(variant(base, tmp_path), tmp_path / "turned")
    job = turned.products[0].product.job
    record = json.loads((tmp_path / "turned" / "stereo.json").read_text())["products"][0]
    # The base flown is 60 degrees from north, but for the scatter of the centres (2 m in 64 m).
    assert record["base"]["grid_azimuth_deg"] == pytest.approx(60.0, abs=5.0)
    model = job.models[0]
    assert abs(model.base_v_m) < 0.01
    with rasterio.open(tmp_path / "turned" / "ortho.tif") as file:
        assert file.transform.b == pytest.approx(0.5 * np.sin(job.grid.rotation))
        assert file.transform.b != 0.0
        low, high = ~file.transform @ (0.0, 0.0), job.grid.uv_from_map([0.0, 0.0])
        assert low[0] == pytest.approx((high[0] - job.grid.u0) / 0.5, abs=1e-4)
    agreement = record["agreement"]["orthophoto_against_stereomate"]
    assert agreement["count"] > 20
    assert np.abs(agreement["median_px"]).max() < 0.1
    north_up = tmp_path / "north"
    north_up.mkdir()
    straight = make(
        variant(base, north_up, rotation='"north-up"'), north_up / "out", report=True, agreement=False
    )
    job = straight.products[0].product.job
    assert job.grid.rotation == 0.0
    # Half the base lies across the rows now: y-parallax, which the report states.
    assert abs(job.models[0].base_v_m) > 20.0
    page = (north_up / "out" / "report.html").read_text()
    stated = float(re.search(r"shows at most ([0-9.]+) pixels of y-parallax", page)[1])
    b_v, depth = abs(job.models[0].base_v_m), job.models[0].height_above_ground_m
    assert stated == pytest.approx(b_v * 20.0 / (depth - 20.0) / 0.5, abs=0.006)


# Seams and brightness are found from the pixels: rounded ones give others.
AS_RECORDED = {"seams": '"nearest"', "balance": "false"}


@pytest.fixture(scope="module")
def unbalanced(survey, tmp_path_factory):
    """Products of the photographs as they are."""
    folder = tmp_path_factory.mktemp("unbalanced")
    return make(variant(survey, folder, **AS_RECORDED), folder / "out", agreement=False).out


@pytest.mark.parametrize("kind", ["uint16", "float32", "gray"])
def test_other_types_and_band_counts(survey, unbalanced, tmp_path, kind):
    """The same numbers in another type give the same products."""
    folder = tmp_path / "photos"
    folder.mkdir()
    for path in sorted(survey.parent.glob("strip*.tif")):
        pixels = tifffile.imread(path)
        changed = {
            "uint16": lambda a: a.astype(np.uint16) * 200,
            "float32": lambda a: a.astype(np.float32) / 128.0,
            "gray": lambda a: a[:, :, 1],
        }[kind](pixels)
        tifffile.imwrite(
            folder / path.name, changed, tile=(64, 64), photometric="minisblack" if kind == "gray" else "rgb"
        )
    project = variant(survey, tmp_path, photos=f'"{folder}/strip*.tif"', **AS_RECORDED)
    make(project, tmp_path / "out")
    agreement = json.loads((tmp_path / "out" / "stereo.json").read_text())["products"][0]["agreement"]
    assert agreement["orthophoto_against_stereomate"]["count"] > 30
    for name in ("ortho.tif", "mate.tif"):
        found, valid = raster(tmp_path / "out" / name)
        expected, there = raster(unbalanced / name)
        np.testing.assert_array_equal(valid, there)
        with rasterio.open(tmp_path / "out" / name) as file:
            if kind == "float32":
                assert np.isnan(file.nodata)
                assert np.isnan(found[:, ~valid]).all()
            else:
                assert file.nodata is None
        expected = expected[1:2] if kind == "gray" else expected
        scale = {"uint16": 200.0, "float32": 1 / 128.0, "gray": 1.0}[kind]
        assert found.shape == expected.shape
        difference = found[:, valid] / scale - expected[:, valid]
        # uint8 rounds and clips what overshoots; the rest is the same interpolation.
        clipped = (expected[:, valid] <= 1) | (expected[:, valid] >= 254)
        assert np.abs(difference[~clipped]).max() <= 0.6


def test_hidden_ground(survey, tmp_path):
    """A wall in the height model hides ground from one side."""
    with rasterio.open(survey.parent / "heights.tif") as file:
        heights, profile = file.read(1), file.profile
    middle = heights.shape[1] // 2
    heights[:, middle - 2 : middle + 3] += 60.0
    with rasterio.open(tmp_path / "wall.tif", "w", **profile) as file:
        file.write(heights, 1)
    valid, lineage = {}, {}
    for hidden in ("keep", "nodata", "fill"):
        folder = tmp_path / hidden
        folder.mkdir()
        project = variant(survey, folder, hidden=f'"{hidden}"')
        project.write_text(
            project.read_text().replace(str(survey.parent / "heights.tif"), str(tmp_path / "wall.tif"))
        )
        make(project, folder / "out", agreement=False)
        valid[hidden] = raster(folder / "out" / "ortho.tif")[1]
        lineage[hidden] = raster(folder / "out" / "lineage.tif")[0][0]
    masked = valid["keep"] & ~valid["nodata"]
    assert masked.sum() > 500
    # Filled from another photograph, where one sees it; never what the photograph kept shows there.
    filled = masked & valid["fill"]
    assert filled.sum() > 0.3 * masked.sum()
    assert (lineage["fill"][filled] != lineage["keep"][filled]).all()
    assert (valid["nodata"] <= valid["fill"]).all()
    assert (valid["fill"] <= valid["keep"]).all()


def test_nodata_instead_of_a_mask(survey, made, tmp_path):
    make(variant(survey, tmp_path, masking='"nodata"'), tmp_path / "out", agreement=False)
    with rasterio.open(tmp_path / "out" / "ortho.tif") as file:
        assert file.nodata == 0.0
    found, valid = raster(tmp_path / "out" / "ortho.tif")
    expected, there = raster(made.out / "ortho.tif")
    np.testing.assert_array_equal(valid, there)
    np.testing.assert_array_equal(found[:, valid], np.maximum(expected[:, valid], 1))


# --- bad input ---------------------------------------------------------------------------------------------


def test_a_truncated_photograph_does_not_stop_the_others(survey, tmp_path, capsys):
    folder = tmp_path / "survey"
    shutil.copytree(survey.parent, folder)
    bad = sorted(folder.glob("strip*.tif"))[2]
    bad.write_bytes(bad.read_bytes()[:-2000])
    project = variant(folder / "project.toml", tmp_path)
    code, _, err = command(capsys, "run", project, "-o", tmp_path / "strict", "--strict")
    assert code == 2
    assert err.startswith("error: ")
    assert bad.name in err
    assert not (tmp_path / "strict").exists()
    code, _, err = command(capsys, "run", project, "-o", tmp_path / "out", "-q", "--no-agreement")
    assert code == 0
    (product,) = read_products(tmp_path / "out" / "stereo.json")
    assert len(product.job.photographs) == 2
    assert f"left out: {bad}" in (tmp_path / "out" / "report.html").read_text()


@pytest.fixture
def rotten(survey, tmp_path):
    """A survey in which one photograph looks whole, but whose pixels cannot be decoded."""
    folder = tmp_path / "survey"
    shutil.copytree(survey.parent, folder)
    bad = sorted(folder.glob("strip*.tif"))[2]
    data = bytearray(bad.read_bytes())
    with tifffile.TiffFile(bad) as file:
        page = file.pages[0]
        for offset, size in zip(page.dataoffsets, page.databytecounts, strict=True):
            data[offset : offset + size] = b"\x55" * size
    bad.write_bytes(data)
    return variant(folder / "project.toml", tmp_path), bad


def test_a_rotten_photograph_is_left_out_while_running(rotten, tmp_path):
    project, bad = rotten
    result = make(project, tmp_path / "out", report=True, agreement=False)
    assert len(result.products[0].product.job.photographs) == 2
    assert any("left out" in note and bad.name in note for note in result.project.notes)
    assert str(bad) in (tmp_path / "out" / "report.html").read_text()
    # It is known the next time, until its file changes.
    assert make(project, tmp_path / "out", agreement=False).up_to_date
    assert not (tmp_path / "out" / ".stereomate").exists()


def test_a_rotten_photograph_stops_a_strict_run(rotten, tmp_path):
    project, bad = rotten
    with pytest.raises(ImageError, match=re.escape(bad.name)):
        make(project, tmp_path / "out", strict=True)
    assert list((tmp_path / "out").iterdir()) == []


def test_overviews_cannot_be_left_out(survey, tmp_path, capsys):
    project = variant(survey, tmp_path, overviews="false")
    code, _, err = command(capsys, "run", project, "-o", tmp_path / "out")
    assert code == 2
    assert "products.overviews: must be true" in err


def test_height_model_in_another_country(survey, tmp_path, capsys):
    project = variant(survey, tmp_path)
    text = project.read_text().replace(
        'file = "' + str(survey.parent / "heights.tif"),
        'crs = "EPSG:25832"\nfile = "' + str(survey.parent / "heights.tif"),
    )
    project.write_text(text)
    code, out, err = command(capsys, "run", project, "-o", tmp_path / "out")
    assert (code, out) == (2, "")
    assert "no photograph sees any of the height model" in err
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_nodata_where_the_product_lies(survey, made, tmp_path):
    """Heights there are, but not under the bounds that are asked for."""
    with rasterio.open(survey.parent / "heights.tif") as file:
        heights, profile = file.read(1), file.profile
        bounds = rasterio.open(made.out / "ortho.tif").bounds
        x, y = 0.5 * (bounds.left + bounds.right), 0.5 * (bounds.bottom + bounds.top)
        row, col = file.index(x, y)
    heights[row - 15 : row + 15, col - 15 : col + 15] = profile["nodata"]
    with rasterio.open(tmp_path / "hole.tif", "w", **profile) as file:
        file.write(heights, 1)
    project = variant(survey, tmp_path, bounds=f"[{x - 15}, {y - 15}, {x + 15}, {y + 15}]")
    project.write_text(
        project.read_text().replace(str(survey.parent / "heights.tif"), str(tmp_path / "hole.tif"))
    )
    with pytest.raises(CoverageError, match=r"hole\.tif: terrain: has no heights under the photographs"):
        make(project, tmp_path / "out")
    assert list((tmp_path / "out").iterdir()) == []


def test_an_unwritable_place(survey, tmp_path, capsys):
    project = variant(survey, tmp_path)
    (tmp_path / "file").write_text("a regular file")
    before = contents(tmp_path)
    code, out, err = command(capsys, "run", project, "-o", tmp_path / "file" / "out")
    assert (code, out) == (2, "")
    assert str(tmp_path / "file") in err
    assert err.count("\n") == 1
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    "victims", [("mate.tif", "stereo.json"), pytest.param(("report.html",), marks=pytest.mark.slow)]
)
def test_a_full_disk_leaves_no_half_file_and_the_run_goes_on(copy, capsys, monkeypatch, victims):
    """The disk is full at one file after the other, until there is room."""
    import stereomate.raster.files as files

    project, out = copy
    whole = contents(out)
    real = files.os.replace
    ending = ""

    def full(source, target):
        if ending and str(target).endswith(ending):
            raise OSError(28, "No space left on device", str(target))
        real(source, target)

    monkeypatch.setattr(files.os, "replace", full)
    for ending in victims:
        fresh = ["--fresh"] if ending == victims[0] else []
        code, _, err = command(capsys, "run", project, "-o", out, *fresh, "-q", "--no-agreement")
        assert code == 2
        assert "No space left on device" in err
        assert ending in err
        assert err.count("\n") == 1
        assert [p for p in out.rglob("*") if p.name.endswith(".part")] == []
        assert not (out / "stereo.json").exists()
    monkeypatch.undo()
    code, _, _ = command(capsys, "run", project, "-o", out, "-q", "--no-agreement")
    assert code == 0
    after = contents(out)
    assert set(after) == {*whole, Path("run.log")}
    assert [name for name in whole if name.suffix == ".tif" and after[name] != whole[name]] == []


def test_a_product_without_a_valid_pixel_is_told(survey, tmp_path, caplog):
    """All but the corners of the photographs is nodata: the middle of the block stays empty."""
    pixels = np.zeros((240, 320, 3), np.uint8)
    pixels[0, 0] = 9
    for path in survey.parent.glob("strip*.tif"):
        tags = [(42113, "s", 1, "0", True)]
        tifffile.imwrite(tmp_path / path.name, pixels, photometric="rgb", tile=(128, 128), extratags=tags)
    with rasterio.open(survey.parent / "heights.tif") as file:
        x, y = file.xy(file.height // 2, file.width // 2)
    project = variant(
        survey, tmp_path, photos='"strip*.tif"', bounds=f"[{x - 5}, {y - 5}, {x + 5}, {y + 5}]", **AS_RECORDED
    )
    text = project.read_text().replace(f'"{survey.parent}/strip*.tif"', '"strip*.tif"')
    project.write_text(text)
    make(project, tmp_path / "out", agreement=False, stereo=False)
    assert "ortho.tif: holds no valid pixel" in caplog.text
    with rasterio.open(tmp_path / "out" / "ortho.tif") as file:
        assert not file.dataset_mask().any()
