"""A project file drafted from a folder: found, commented, and good for `check`."""

from __future__ import annotations

import shutil
import tomllib

import numpy as np
import pytest
import tifffile

from stereomate.cli import main
from stereomate.errors import ProjectError
from stereomate.formats.exif import CameraTags
from stereomate.project import load
from stereomate.project.check import check_project
from stereomate.project.draft import draft_project, write_draft
from stereomate.project.findings import look_through, photo_pattern
from stereomate.project.sensors import draft_camera


def run(capsys, *arguments: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as end:
        main.run(list(arguments))
    out = capsys.readouterr()
    return end.value.code or 0, out.out, out.err


def test_table_crs_and_height_model_are_found(small, capsys):
    small.path.unlink()
    code, out, err = run(capsys, "init", str(small.folder))
    assert (code, err) == (0, "")
    assert "to do: camera camera: fill in the calibration" in out
    document = tomllib.loads(small.path.read_text())
    assert document["project"]["crs"] == "EPSG:25832"
    assert document["photos"]["files"] == "photo_*.tif"
    assert document["photos"]["orientation"] == "orientation.csv"
    assert document["terrain"]["file"] == "heights.tif"
    with pytest.raises(ProjectError, match="principal_distance"):
        load(small.path)
    small.replace("project.toml", "# principal_distance_mm = ", "principal_distance_mm = 30.0")
    small.replace("project.toml", "# sensor_mm = [ , ]", "pixel_pitch_mm = 0.1")
    assert check_project(load(small.path)).is_good


def test_camera_files_are_found_and_those_of_another_size_named(small, capsys):
    """Good for `check` without a word of the user; a link to a folder is a folder."""
    small.path.unlink()
    (small.folder / ".elsewhere").mkdir()
    small.write(
        ".elsewhere/int_param.yaml",
        "other:\n  type: pinhole\n  im_size: [7, 5]\n  focal_len: 1.0\n"
        "lens:\n  type: pinhole\n  im_size: [60, 40]\n  focal_len: 30.0\n  sensor_size: [6.0, 4.0]\n"
        "spare:\n  type: pinhole\n  im_size: [60, 40]\n  focal_len: 1.0\n",
    )
    (small.folder / "cameras").symlink_to(small.folder / ".elsewhere", target_is_directory=True)
    code, out, err = run(capsys, "init", str(small.folder))
    assert (code, err) == (0, "")
    assert "int_param.yaml: no photograph has the 7 x 5 pixels of other" in out
    assert "int_param.yaml: camera spare is of the same size, and not used" in out
    (camera,) = tomllib.loads(small.path.read_text())["camera"]
    assert camera["name"] == "lens"
    assert check_project(load(small.path)).is_good


def test_an_existing_project_is_kept(small, capsys):
    before = small.path.read_text()
    code, _, err = run(capsys, "init", str(small.folder))
    assert code == 2
    assert "is there already" in err
    assert small.path.read_text() == before
    assert run(capsys, "init", str(small.folder), "--force")[0] == 0
    assert small.path.read_text() != before


@pytest.mark.parametrize("make", [lambda folder: None, lambda folder: folder.mkdir()])
def test_no_folder_or_an_empty_one(tmp_path, make):
    folder = tmp_path / "photos"
    make(folder)
    with pytest.raises(ProjectError, match=r"must be a folder|holds no photograph"):
        draft_project(folder)


def test_prj_beside_the_table_goes_first(small):
    small.write("orientation.prj", "+proj=tmerc +lat_0=0 +lon_0=9 +k=1 +x_0=500000 +ellps=GRS80 +units=m")
    assert look_through(small.folder).crs.source == "orientation.prj"


def test_crs_that_is_not_conformal_is_passed_over(small):
    small.write("orientation.prj", "EPSG:3035")
    assert look_through(small.folder).crs.text == "EPSG:25832"


def test_second_table_becomes_a_comparison(small):
    small.path.unlink()
    small.write(
        "raw.csv",
        "filename,lon,lat,alt,roll,pitch,yaw\nphoto_1.tif,9,48,500,0,0,0\nphoto_2.tif,9,48,500,0,0,0\n",
    )
    draft = draft_project(small.folder)
    document = tomllib.loads(draft.text)
    assert document["photos"]["orientation"] == "orientation.csv"
    assert document["photos"]["compare"] == {"orientation": "raw.csv", "crs": "EPSG:4326", "angles": "rph"}


def test_table_without_header_is_guessed(small):
    small.path.unlink()
    lines = (small.folder / "orientation.csv").read_text().splitlines()[1:]
    (small.folder / "orientation.csv").unlink()
    small.write("eo.txt", "\n".join(line.replace(",", " ") for line in lines))
    photos = tomllib.loads(draft_project(small.folder).text)["photos"]
    assert photos["columns"] == ["filename", "x", "y", "z", "omega", "phi", "kappa"]


def test_images_without_orientation_are_no_photographs(small):
    tifffile.imwrite(small.folder / "overview.tif", np.zeros((20, 30, 3), np.uint8), photometric="rgb")
    found = look_through(small.folder)
    assert [photo.path.name for photo in found.photographs] == ["photo_1.tif", "photo_2.tif"]
    assert [photo.path.name for photo in found.others] == ["overview.tif"]


def test_pattern_names_exactly_the_photographs(small):
    found = look_through(small.folder)
    assert photo_pattern(found.photographs, small.folder) == "photo_*.tif"
    assert photo_pattern(found.photographs[:1], small.folder) == "photo_1.tif"
    tifffile.imwrite(small.folder / "photo_x.tif", np.zeros((20, 30, 3), np.uint8), photometric="rgb")
    assert photo_pattern(found.photographs, small.folder) == ["photo_1.tif", "photo_2.tif"]


SIZE = (4000, 2250)


@pytest.mark.parametrize(
    ("tags", "line", "source"),
    [
        (CameraTags(model="FC300S", focal_length_mm=3.61), "principal_distance_mm = 3.61", "sensor width"),
        (CameraTags(focal_length_35mm=20.0), "principal_distance_px = 2222.2", "36 mm wide assumed"),
        (CameraTags(model="X", focal_length_mm=5.0), "# principal_distance_mm = ", "fill in"),
        (
            CameraTags(calibrated_focal_px=3666.0, size_px=(8000, 4500)),
            "principal_distance_px = 1833.000",
            "Calibrated",
        ),
    ],
)
def test_camera_by_what_is_known(tags, line, source):
    camera = draft_camera(tags, SIZE)
    assert camera.lines[0] == line
    assert source in camera.source


def test_calibration_of_the_maker_keeps_both_focal_lengths(tmp_path):
    """fx and fy differ: the affinity of the Brown model carries it."""
    from stereomate.project.cameras import load_cameras

    dewarp = (3657.02, 3650.62, -4.03, 23.1, -0.267098, 0.111977, 0.000924881, 0.0000882056, -0.0331614)
    draft = draft_camera(CameraTags(model="FC6310R", dewarp=dewarp, size_px=(5472, 3648)), (1368, 912))
    path = tmp_path / "cam.toml"
    path.write_text("\n".join(["[[camera]]", 'name = "c"', "size_px = [1368, 912]", *draft.lines]))
    (camera,) = load_cameras(path)
    x, y = 0.3, -0.2  # y down
    r2 = x * x + y * y
    radial = 1 + r2 * (-0.267098 + r2 * (0.111977 - 0.0331614 * r2))
    p1, p2 = 0.000924881, 0.0000882056
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    pixel, _ = camera.image_from_camera([x, -y, -1.0])
    expected = [(3657.02 * xd + 2736 - 4.03) / 4, (3650.62 * yd + 1824 + 23.1) / 4]
    np.testing.assert_allclose(pixel, expected, atol=2e-4)


def copied(data_folder, name, tmp_path):
    folder = tmp_path / name
    shutil.copytree(data_folder / name, folder, copy_function=shutil.copyfile)
    folder.chmod(0o755)
    return folder


@pytest.mark.real
def test_brighton_beach_from_exif_alone(data_folder, tmp_path):
    folder = copied(data_folder, "brighton_beach", tmp_path)
    draft = draft_project(folder)
    write_draft(draft, folder / "project.toml")
    document = tomllib.loads(draft.text)
    assert document["project"]["crs"] == "EPSG:32615"
    assert document["camera"][0]["principal_distance_mm"] == 3.61
    report = check_project(load(folder / "project.toml"))
    assert len(report.photographs) == 18
    # The data's own README: 40 m above ground, 1.7 cm, 56-67 % forward overlap.
    assert np.median([row.gsd_m for row in report.photographs]) == pytest.approx(0.017, abs=0.0005)
    forward = {(row.first, row.second): row.overlap for row in report.pairs}
    assert 0.56 < forward["DJI_0018", "DJI_0019"] < 0.67


@pytest.mark.real
def test_odm_tuniu_is_ready_to_check(data_folder, tmp_path):
    folder = copied(data_folder, "odm_tuniu", tmp_path)
    for child in folder.rglob("*"):
        if child.is_dir():
            child.chmod(0o755)
    draft = draft_project(folder)
    assert draft.to_do == ()
    write_draft(draft, folder / "project.toml")
    report = check_project(load(folder / "project.toml"))
    assert report.is_good
    assert any("angles differ by 1.13°" in warning for warning in report.warnings)


@pytest.mark.real
def test_ngi_is_ready_to_check(data_folder, tmp_path):
    draft = draft_project(copied(data_folder, "ngi_strip05", tmp_path))
    assert draft.to_do == ()
    document = tomllib.loads(draft.text)
    (camera,) = document["camera"]
    assert (camera["name"], camera["principal_distance_mm"]) == ("Integraph DMC", 120.0)
    assert document["project"]["crs"].startswith("+proj=tmerc")
    assert document["photos"]["files"] == "*_RGB.tif"
    assert "dem.tif names EGM2008 height" in draft.text
