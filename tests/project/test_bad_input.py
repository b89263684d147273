"""Every bad input of docs/errors.md: one clear line, exit code 2, no half-written file."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pytest
import tifffile

import stereomate.errors as errors
from stereomate.cli import main
from stereomate.project import load


def fails(small, error: type[errors.StereomateError], *words: str, strict: bool = False) -> str:
    with pytest.raises(error) as caught:
        load(small.path, strict=strict)
    message = str(caught.value)
    for word in words:
        assert word in message
    return message


def left_out(small, error: type[errors.StereomateError], *words: str) -> None:
    """One bad photograph does not stop the other, unless asked to."""
    project = load(small.path)
    assert len(project.survey.photographs) == 1
    (problem,) = project.problems
    assert type(problem.error) is error
    for word in words:
        assert word in str(problem.error)
    assert any(str(problem.error) in note for note in project.notes)
    fails(small, error, *words, strict=True)


def test_the_small_project_is_good(small):
    project = load(small.path)
    assert len(project.survey.photographs) == 2
    assert project.problems == ()


def test_missing_project(tmp_path):
    with pytest.raises(errors.ProjectError, match=r"nowhere\.toml: does not exist"):
        load(tmp_path / "nowhere.toml")


def test_folder_instead_of_a_project(tmp_path):
    with pytest.raises(errors.ProjectError, match="is a folder"):
        load(tmp_path)


def test_no_toml(small):
    small.write("project.toml", "[project\n")
    fails(small, errors.ProjectError, "must be TOML", "line 1")


def test_no_text(small):
    small.path.write_bytes(b"\xff\xfe\x00")
    fails(small, errors.ProjectError, "UTF-8")


def test_newer_form_names_both(small):
    small.replace("project.toml", "[project]", "[project]\nformat = 2")
    fails(small, errors.FormatError, "form 2", "form 1", "install a newer")


def test_two_cameras_under_one_name(small):
    text = small.path.read_text()
    start = text.index("[[camera]]")
    end = text.index("\n[", start + 1)
    small.path.write_text(text + "\n" + text[start:end] + "\n")
    fails(small, errors.ProjectError, "camera[2].name", "names two cameras alike")


def test_missing_photograph(small):
    small.replace("project.toml", '"photo_*.tif"', '["photo_1.tif", "photo_2.tif"]')
    (small.folder / "photo_2.tif").unlink()
    left_out(small, errors.ImageError, "photo_2.tif", "no such file")
    (small.folder / "photo_1.tif").unlink()
    fails(small, errors.ProjectError, "photo_1.tif", "is missing")


def test_pattern_without_photographs(small):
    small.replace("project.toml", "photo_*.tif", "*.jpg")
    fails(small, errors.ProjectError, "photos.files", "matches no file")


def test_truncated_photograph(small):
    path = small.folder / "photo_2.tif"
    path.write_bytes(path.read_bytes()[:3000])
    left_out(small, errors.ImageError, "photo_2.tif")


def test_photograph_that_is_nodata_everywhere(small):
    """Of one that has a single valid pixel something can be made."""
    pixels = np.zeros((40, 60, 3), np.uint8)
    path = small.folder / "photo_2.tif"
    tags = [(42113, "s", 1, "0", True)]  # GDAL's nodata
    tifffile.imwrite(path, pixels, photometric="rgb", extratags=tags)
    left_out(small, errors.ImageError, "photo_2.tif", "is nodata everywhere")
    pixels[3, 5] = 1
    tifffile.imwrite(path, pixels, photometric="rgb", extratags=tags)
    assert load(small.path).problems == ()


def test_photograph_that_is_none(small):
    (small.folder / "photo_2.tif").write_text("no image")
    left_out(small, errors.ImageError, "photo_2.tif", "cannot be read")


def test_truncated_jpeg(small):
    import imagecodecs

    pixels = np.random.default_rng(2).integers(0, 255, (40, 60, 3), dtype=np.uint8)
    data = imagecodecs.jpeg8_encode(pixels, level=95)
    small.replace("project.toml", "photo_*.tif", "photo_*.jpg")
    for number, content in ((1, data), (2, data[: len(data) // 2])):
        (small.folder / f"photo_{number}.jpg").write_bytes(content)
    left_out(small, errors.ImageError, "photo_2.jpg", "cut off")


def test_every_photograph_bad_is_an_error(small):
    for number in (1, 2):
        (small.folder / f"photo_{number}.tif").write_text("no image")
    fails(small, errors.ImageError, "photo_1.tif", "1 more photograph cannot take part")


def test_orientation_without_photograph(small):
    (small.folder / "photo_2.tif").unlink()
    left_out(small, errors.OrientationError, "photo_2.tif", "has no photograph")


def test_photograph_without_orientation(small):
    lines = (small.folder / "orientation.csv").read_text().splitlines()
    small.write("orientation.csv", "\n".join(lines[:2]))
    left_out(small, errors.OrientationError, "photo_2.tif", "has no orientation")


def test_duplicate_names(small):
    small.replace("orientation.csv", "photo_2.tif", "photo_1.tif")
    fails(small, errors.OrientationError, "photo_1.tif", "named twice, in lines 2 and 3")


def test_one_photograph_oriented_twice(small):
    small.replace("orientation.csv", "photo_2.tif", "photo_1")
    fails(small, errors.OrientationError, "oriented twice")


def test_names_of_two_photographs_alike(small):
    (small.folder / "more").mkdir()
    (small.folder / "more" / "photo_1.tif").write_bytes((small.folder / "photo_1.tif").read_bytes())
    small.replace("project.toml", '"photo_*.tif"', '"**/photo_*.tif"')
    fails(small, errors.ProjectError, "two photographs alike")


def test_angles_in_the_wrong_unit_look_at_the_sky(small):
    small.replace("orientation.csv", "0.5,-0.3,1.0", "2.0,-0.3,1.0")
    small.replace("orientation.csv", "-0.2,0.4,-1.5", "-2.1,0.4,-1.5")
    small.replace("project.toml", 'angles = "grid"', 'angles = "grid"\nangle_unit = "rad"')
    message = fails(small, errors.OrientationError, "looks at the sky", "photo_1.tif", "angle_unit")
    assert "1 more" in message


def test_one_photograph_that_looks_at_the_sky(small):
    small.replace("orientation.csv", "-0.2,0.4,-1.5", "180.0,0.4,-1.5")
    left_out(small, errors.OrientationError, "photo_2.tif", "looks at the sky")


def test_angles_beyond_a_full_turn(small):
    small.replace("orientation.csv", "-0.2,0.4,-1.5", "-0.2,0.4,398.5")
    fails(small, errors.OrientationError, "line 3, kappa", "full turn of 360 deg", "398.5")


def test_radians_read_as_degrees_are_noticed(small):
    small.replace("orientation.csv", "0.5,-0.3,1.0", "0.01,-0.005,3.10")
    small.replace("orientation.csv", "-0.2,0.4,-1.5", "0.01,-0.005,3.12")
    assert "radians" in load(small.path).warnings[0]


def test_missing_axes_lists_the_possibilities(small):
    small.replace("project.toml", 'angles = "grid"\n', "")
    fails(small, errors.ProjectError, "photos.angles", '"grid"', '"local"', '"tangent"', '"rph"')


def test_photographs_below_the_ground(small):
    small.replace("orientation.csv", "500.0,-0.2", "150.0,-0.2")
    left_out(small, errors.OrientationError, "photo_2.tif", "below the ground")


def test_photograph_that_does_not_reach_the_terrain(small):
    small.replace("orientation.csv", "512012.0", "522012.0")
    left_out(small, errors.CoverageError, "photo_2.tif", "sees no part of the height model")


def test_height_model_in_another_country(small):
    small.write_heights(np.full((40, 40), 300.0), crs="EPSG:2180")
    message = fails(small, errors.CoverageError, "no photograph sees any of the height model")
    assert re.search(r"photographs are at longitude 9\.1", message)


def test_height_model_of_nodata_only(small):
    small.write_heights(np.full((40, 40), -9999.0))
    fails(small, errors.CoverageError, "heights.tif", "nodata")


def test_height_model_that_is_missing(small):
    (small.folder / "heights.tif").unlink()
    fails(small, errors.ImageError, "heights.tif", "no such file")


@pytest.mark.parametrize(
    ("crs", "words"),
    [
        ("EPSG:4326", "axes are angles"),
        ("EPSG:3035", "is not conformal"),
        ("EPSG:99999", "known to PROJ"),
    ],
)
def test_crs_that_cannot_serve(small, crs, words):
    small.replace("project.toml", "EPSG:25832", crs)
    fails(small, errors.CrsError, "project.crs", words, crs)


def test_missing_geoid_grid_is_named(small):
    small.replace("project.toml", 'heights = "ellipsoidal"', 'heights = "geoid_of_nowhere.gtx"')
    fails(small, errors.MissingGridError, "geoid_of_nowhere.gtx", "project.heights")


def test_heights_that_are_no_system(small):
    small.replace("project.toml", 'heights = "ellipsoidal"', 'heights = "above sea"')
    fails(small, errors.CrsError, "project.heights", "above sea")


def test_photograph_of_another_size(small):
    import tifffile

    tifffile.imwrite(small.folder / "photo_2.tif", np.zeros((40, 61, 3), np.uint8), photometric="rgb")
    left_out(small, errors.ImageError, "60 x 40 pixels of camera small", "61 x 40")


def test_photograph_of_another_kind(small):
    import tifffile

    tifffile.imwrite(small.folder / "photo_2.tif", np.zeros((40, 60), np.uint8))
    left_out(small, errors.ImageError, "photo_2.tif", "bands like the others")


def test_bands_that_are_not_there(small):
    small.replace("project.toml", "gsd = 1.0", "gsd = 1.0\nbands = [1, 4]")
    fails(small, errors.ImageError, "band 4", "products.bands")


def test_unknown_camera(small):
    small.replace("project.toml", 'angles = "grid"', 'angles = "grid"\ncamera = "large"')
    fails(small, errors.ProjectError, "photos.camera", "small", "'large'")


def test_no_camera(small):
    text = small.path.read_text()
    start, end = text.index("[[camera]]"), text.index("[photos]")
    small.write("project.toml", text[:start] + text[end:])
    fails(small, errors.ProjectError, "camera", "principal distance")


@pytest.mark.parametrize(
    ("key", "field"),
    [
        ("gsd = -1.0", "products.gsd"),
        ('compression = "jpeg"\nnodata = 0', "products.nodata"),
        ('pairs = [["photo_1", "photo_9"]]', "products.pairs[1]"),
        ('pairs = [["photo_1", "photo_1.tif"]]', "products.pairs[1]"),
    ],
)
def test_product_keys(small, key, field):
    small.replace("project.toml", "gsd = 1.0", key)
    fails(small, errors.ProjectError, "project.toml", field)


# --- the same through the command line -------------------------------------------------------------------


def run(capsys, *arguments: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as end:
        main.run(list(arguments))
    out = capsys.readouterr()
    return end.value.code or 0, out.out, out.err


def test_command_line_is_one_line_and_code_2(small, capsys):
    small.replace("project.toml", "EPSG:25832", "EPSG:3035")
    code, out, err = run(capsys, "check", str(small.path))
    assert (code, out) == (2, "")
    assert err.startswith(f"error: {small.path}: project.crs: is not conformal")
    assert err.count("\n") == 1


def test_check_goes_on_past_one_bad_photograph_and_says_so(small, capsys):
    (small.folder / "photo_2.tif").write_text("no image")
    code, out, err = run(capsys, "check", str(small.path))
    assert code == 2
    assert "photo_1" in out
    assert any(line.startswith("error: ") and "photo_2.tif" in line for line in err.splitlines())


def test_unwritable_place(small, capsys):
    (small.folder / "file").write_text("a regular file")
    before = sorted(small.folder.iterdir())
    code, _, err = run(capsys, "init", str(small.folder), "-o", str(small.folder / "file" / "project.toml"))
    assert code == 2
    assert err.count("\n") == 1
    assert sorted(small.folder.iterdir()) == before


def test_full_disk_leaves_no_half_file(small, capsys, monkeypatch):
    small.path.unlink()
    before = sorted(small.folder.iterdir())

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    code, _, err = run(capsys, "init", str(small.folder))
    assert code == 2
    assert "No space left on device" in err
    assert err.count("\n") == 1
    assert sorted(small.folder.iterdir()) == before


def test_errors_page_lists_every_class():
    page = (Path(__file__).parents[2] / "docs" / "errors.md").read_text(encoding="utf-8")
    classes = [
        name
        for name, value in vars(errors).items()
        if isinstance(value, type) and issubclass(value, errors.StereomateError)
    ]
    assert [name for name in classes if f"`{name}`" not in page] == []


def test_centres_outside_the_map(small):
    table = small.folder / "orientation.csv"
    head, *rows = table.read_text().splitlines()
    x, y = (head.split(",").index(name) for name in "xy")
    swapped = []
    for row in rows:
        cells = row.split(",")
        cells[x], cells[y] = cells[y], cells[x]
        swapped.append(",".join(cells))
    table.write_text("\n".join([head, *swapped]) + "\n")
    fails(small, errors.CrsError, "2 of 2 projection centres lie outside", "x and y exchanged")


def test_control_heights_in_feet_are_named(small):
    places = [(512_000.0 + 10.0 * k, 5_400_000.0 - 5.0, 200.0 + k) for k in range(3)]
    project = (small.folder / "project.toml").read_text()
    small.write("project.toml", project + '[control]\nfile = "control.csv"\n')

    def written(unit_m):
        rows = [f"C{k},{x},{y},{z / unit_m:.3f}" for k, (x, y, z) in enumerate(places)]
        small.write("control.csv", "\n".join(["name,x,y,z", *rows]) + "\n")

    written(1.0)
    load(small.path)
    written(0.3048)
    with pytest.raises(errors.HeightSystemError, match=r"control\.csv.*look like feet"):
        load(small.path)


@pytest.mark.parametrize(
    ("written", "field", "words"),
    [
        ("nodata = 300.0", "products.nodata", ("must be a value of uint8", "the photographs are uint8")),
        ("gsd = 0.001", "products.gsd", ("within 100 times that of the photographs, 0.99",)),
        ("gsd = 1000.0", "products.gsd", ("within 100 times",)),
        ("w0_m = 5.0", "products.w0_m", ("highest ground above reference_m", 'law = "linear"')),
        ("reference_m = 9000.0", "products.reference_m", ("must be below the photographs",)),
        ("bounds = [0, 0, 10, 10]", "products.bounds", ("ground of the photographs",)),
    ],
)
def test_products_that_cannot_be(small, capsys, written, field, words):
    """Found before anything is computed, and by `check` too."""
    small.replace("project.toml", "gsd = 1.0", written)
    out = small.folder / "out"
    for arguments in (["run", str(small.path), "-o", str(out)], ["check", str(small.path)]):
        code, _, err = run(capsys, *arguments)
        assert code == 2
        for word in (str(small.path), field, *words):
            assert word in " ".join(err.split())
    assert not out.exists() or [path.name for path in out.iterdir()] == ["run.log"]


@pytest.mark.parametrize("kind", ["uint32", "float64"])
def test_photographs_of_a_type_that_no_product_has(small, kind):
    import tifffile

    for number in (1, 2):
        tifffile.imwrite(small.folder / f"photo_{number}.tif", np.ones((40, 60, 3), kind), photometric="rgb")
    fails(small, errors.ProjectError, "products.dtype", f"the photographs are {kind}")
    small.replace("project.toml", "gsd = 1.0", 'gsd = 1.0\ndtype = "uint16"')
    assert load(small.path).options.dtype == "uint16"
