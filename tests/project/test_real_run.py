"""`stereomate run` on two real blocks, against figures measured with independent tools."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
import rasterio
from run_survey import make, raster, terrain_heights
from test_loader import TUNIU, TUNIU_CAMERA, written
from test_project_schema import FROZEN_1

from stereomate.cli import main
from stereomate.frames.attitude import AttitudeConvention
from stereomate.project import load
from stereomate.project.run import RunOptions, plan
from stereomate.stereo.agreement import AgreementOptions, measure_agreement

pytestmark = pytest.mark.real

# What a forty-line sketch with SIFT found on this block (left minus right; x, y): orthophoto against
# orthophoto (1318 matches) and orthophoto against stereomate less q(h) (827 matches).
SKETCH_ORTHO = {"count": 1318, "median": (-0.02, 0.02), "nmad": (0.41, 0.26)}
SKETCH_MATE = {"count": 827, "median": (-0.01, 0.01), "nmad": (0.41, 0.27)}


def command(capsys, *arguments) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as end:
        main.run([str(a) for a in arguments])
    said = capsys.readouterr()
    return end.value.code or 0, said.out, said.err


def at_or_below(median, nmad, count, sketch) -> None:
    """Scatter no larger; medians no larger but for what chance does to the medians of both samples.

    The sketch's figures were written with two decimals.
    """
    for axis in (0, 1):
        assert round(float(nmad[axis]), 2) <= sketch["nmad"][axis]
        spread = 1.2533 * np.hypot(nmad[axis] / count**0.5, sketch["nmad"][axis] / sketch["count"] ** 0.5)
        assert abs(median[axis]) <= abs(sketch["median"][axis]) + 2.0 * spread


# --- ngi_strip05 -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def ngi(data_folder, tmp_path_factory):
    """The project file of the issue, run."""
    folder = tmp_path_factory.mktemp("ngi")
    text = FROZEN_1
    for name in ("*_RGB.tif", "ngi_xyz_opk.csv", "dem.tif"):
        text = text.replace(f'"{name}"', f'"{data_folder}/ngi_strip05/{name}"')
    (folder / "project.toml").write_text(text)
    return make(folder / "project.toml", folder / "out", report=True)


def test_ngi_left_is_the_western_photograph_though_exposed_later(ngi):
    record = json.loads((ngi.out / "stereo.json").read_text())["products"][0]
    model = next(m for m in record["models"] if m["right"] >= 0)
    names = [p["name"] for p in record["photographs"]]
    assert names[model["left"]].endswith("0184_RGB")
    assert names[model["right"]].endswith("0182_RGB")
    (pair,) = json.loads((ngi.out / "report.json").read_text())["pairs"]
    assert (pair["left"][-8:], pair["right"][-8:]) == ("0184_RGB", "0182_RGB")
    assert 89.0 < pair["azimuth_deg"] < 90.0
    assert record["law"]["kind"] == "logarithmic"
    # North-up: 27 m of 2616 m of base lie across the rows.
    assert record["grid"]["rotation_rad"] == 0.0


def test_ngi_figures_of_the_report_are_at_or_below_those_of_the_sketch(ngi):
    record = json.loads((ngi.out / "stereo.json").read_text())["products"][0]["agreement"]
    for key, sketch in (
        ("orthophoto_against_orthophoto", SKETCH_ORTHO),
        ("orthophoto_against_stereomate", SKETCH_MATE),
    ):
        found = record[key]
        assert found["count"] > sketch["count"]
        # Blocks drawn anew: larger than independent matches would give, and no excuse for a large median.
        assert 0.003 < max(found["standard_error_px"]) < 0.03
        at_or_below(found["median_px"], found["nmad_px"], found["count"], sketch)
    low, high = record["parallax_range_px"]
    assert low < 3.0
    assert high > 30.0


def sift(a, b, mask_a, mask_b):
    """Positions of features that are each other's nearest, (n, 2) in both images."""
    finder = cv2.SIFT_create()
    at_a, kinds_a = finder.detectAndCompute(a, mask_a)
    at_b, kinds_b = finder.detectAndCompute(b, mask_b)
    matcher = cv2.BFMatcher(cv2.NORM_L2)
    back = {m[0].queryIdx: m[0].trainIdx for m in matcher.knnMatch(kinds_b, kinds_a, k=1)}
    good = [
        m
        for m, second in matcher.knnMatch(kinds_a, kinds_b, k=2)
        if m.distance < 0.75 * second.distance and back.get(m.trainIdx) == m.queryIdx
    ]
    # OpenCV counts from the middle of the first pixel.
    return (
        np.array([at_a[m.queryIdx].pt for m in good]) + 0.5,
        np.array([at_b[m.trainIdx].pt for m in good]) + 0.5,
    )


def grey(path):
    pixels, valid = raster(path)
    inner = cv2.erode(valid.astype(np.uint8) * 255, np.ones((15, 15)))
    return np.rint(pixels.mean(axis=0)).astype(np.uint8), inner


def median_and_nmad(residuals):
    near = residuals[np.hypot(*residuals.T) < 5.0]
    median = np.median(near, axis=0)
    return median, 1.4826 * np.median(np.abs(near - median), axis=0), len(near)


def test_ngi_orthophotos_of_the_two_photographs_agree(ngi, tmp_path):
    """Each photograph rectified alone, matched with SIFT."""
    bounds = list(rasterio.open(ngi.out / "ortho.tif").bounds)
    images = []
    for number in ("0184", "0182"):
        text = ngi.project.path.read_text().replace("*_RGB.tif", f"*{number}_RGB.tif")
        project = tmp_path / f"{number}.toml"
        project.write_text(text.replace("gsd = 5.0", f"gsd = 5.0\nbounds = {bounds}"))
        make(project, tmp_path / number, stereo=False)
        images.append(grey(tmp_path / number / "ortho.tif"))
    (left, left_valid), (right, right_valid) = images
    both = np.minimum(left_valid, right_valid)
    at_left, at_right = sift(left, right, both, both)
    median, nmad, count = median_and_nmad(at_left - at_right)
    print(f"orthophotos: {count} matches, median {median.round(3)}, nmad {nmad.round(3)}")
    assert count > 900
    at_or_below(median, nmad, count, SKETCH_ORTHO)


def test_ngi_stereomate_shows_the_parallax_of_its_law(ngi, data_folder):
    """SIFT in both images; q(h) from the written law and the height model, interpolated by scipy."""
    record = json.loads((ngi.out / "stereo.json").read_text())["products"][0]
    law = record["law"]
    at_left, at_right = sift(
        *(
            x
            for pair in zip(grey(ngi.out / "ortho.tif"), grey(ngi.out / "mate.tif"), strict=True)
            for x in pair
        )
    )
    with rasterio.open(ngi.out / "ortho.tif") as file:
        xy = np.stack(file.transform @ at_left.T, axis=-1)
    heights = terrain_heights(data_folder / "ngi_strip05" / "dem.tif", xy)
    q = law["base_m"] * np.log(law["w0_m"] / (law["w0_m"] - (heights - law["reference_m"]))) / 5.0
    parallax = at_left - at_right
    residuals = np.column_stack([parallax[:, 0] - q, parallax[:, 1]])
    median, nmad, count = median_and_nmad(residuals)
    print(f"x - q(h), y: {count} matches, median {median.round(3)}, nmad {nmad.round(3)}")
    assert count > 600
    at_or_below(median, nmad, count, SKETCH_MATE)
    assert np.ptp(q[np.hypot(*residuals.T) < 5.0]) > 30.0


def test_ngi_report_says_what_was_assumed(ngi):
    page = (ngi.out / "report.html").read_text(encoding="utf-8")
    for words in ("one unknown common system", "adjustment in the grid", "left minus right"):
        assert words in page


# --- odm_tuniu ---------------------------------------------------------------------------------------------


def tuniu_project(folder, data_folder, orientation, keys, camera=TUNIU_CAMERA):
    folder.mkdir()
    text = TUNIU.format(folder=data_folder / "odm_tuniu", orientation="ORIENTATION", keys=keys, camera=camera)
    text = text.replace(f"{data_folder}/odm_tuniu/ORIENTATION", str(orientation))
    (folder / "project.toml").write_text(text + "[products]\ngsd = 0.15\n")
    return folder / "project.toml"


def shifts(one, other, same, block=64):
    """Shift of `other` against `one` in every textured block, least squares on the gradient, pixels."""
    gy, gx = np.gradient(one)
    difference = other - one
    found = []
    for r in range(0, one.shape[0] - block, block):
        for c in range(0, one.shape[1] - block, block):
            cut = (slice(r, r + block), slice(c, c + block))
            if not same[cut].all():
                continue
            design = np.column_stack([gx[cut].ravel(), gy[cut].ravel()])
            normal = design.T @ design
            if np.linalg.eigvalsh(normal)[0] > 20.0 * block**2:
                found.append(-np.linalg.solve(normal, design.T @ difference[cut].ravel()))
    return np.array(found)


def moved(image, rows, cols):
    """The image by whole pixels further down and right."""
    return np.roll(np.pad(image, ((0, 8), (0, 8))), (rows, cols), (0, 1))


def test_tuniu_is_the_same_orthophoto_from_three_forms_of_its_orientation(data_folder, tmp_path):
    source = data_folder / "odm_tuniu"
    keys = 'angles = "grid"\nadjusted_in = "space"'
    adjusted = make(
        tuniu_project(tmp_path / "table", data_folder, source / "odm_xyz_opk.csv", keys),
        tmp_path / "table" / "out",
        stereo=False,
    )
    opensfm = tuniu_project(
        tmp_path / "opensfm", data_folder, source / "odm" / "opensfm" / "reconstruction.json", "", camera=""
    )
    places = adjusted.project.frame.geodetic_from_map(adjusted.project.survey.centres_map)
    angles = written(adjusted.project, AttitudeConvention("rph", "local"))
    lines = ["filename,longitude,latitude,altitude,roll,pitch,heading"]
    for photo, row in zip(
        adjusted.project.survey.photographs, np.column_stack([places, angles]), strict=True
    ):
        lines.append(",".join([photo.name, *(repr(float(v)) for v in row)]))
    (tmp_path / "navigation.csv").write_text("\n".join(lines))
    navigation = tuniu_project(
        tmp_path / "navigation", data_folder, tmp_path / "navigation.csv", 'angles = "rph"'
    )
    first, valid = raster(adjusted.out / "ortho.tif")
    lineage, _ = raster(adjusted.out / "lineage.tif")
    frame = adjusted.products[0].product.job.grid
    for project, bound in ((opensfm, 0.1), (navigation, 0.01)):
        made = make(project, project.parent / "out", stereo=False)
        grid = made.products[0].product.job.grid
        assert grid.gsd == frame.gsd
        # Grids may differ by whole pixels where a footprint ends.
        dc, dr = round((grid.u0 - frame.u0) / 0.15), round((frame.v0 - grid.v0) / 0.15)
        other, there = raster(made.out / "ortho.tif")
        from_photo, _ = raster(made.out / "lineage.tif")
        rows, cols = (min(n, m) - 8 for n, m in zip(valid.shape, there.shape, strict=True))
        same = valid[:rows, :cols] & moved(there, dr, dc)[:rows, :cols]
        same &= lineage[0][:rows, :cols] == moved(from_photo[0], dr, dc)[:rows, :cols]
        assert same.mean() > 0.9 * valid.mean()
        blocks = shifts(
            first[1].astype(float)[:rows, :cols], moved(other[1].astype(float), dr, dc)[:rows, :cols], same
        )
        print(f"{project.parent.name}: {len(blocks)} blocks, largest shift {np.abs(blocks).max():.4f} px")
        assert len(blocks) > 20
        assert np.abs(blocks).max() < bound


def moved_camera(job, shift_px):
    """The job with all image coordinates moved."""

    def moved(photograph):
        (a, b, c), (d, e, f) = photograph.camera.pixel_from_photo
        camera = replace(photograph.camera, pixel_from_photo=((a, b, c + shift_px), (d, e, f + shift_px)))
        return replace(photograph, camera=camera)

    return replace(job, photographs=tuple(moved(p) for p in job.photographs))


def test_tuniu_y_parallax_is_that_of_its_camera(data_folder, tmp_path):
    """What docs/accuracy.md says: a sixth of a pixel in the camera is the y-parallax of the product."""
    source = data_folder / "odm_tuniu" / "odm_xyz_opk.csv"
    keys = 'angles = "grid"\nadjusted_in = "space"'
    project = load(tuniu_project(tmp_path / "table", data_folder, source, keys))
    (job,) = plan(project, RunOptions(pairs=(("100_0005_0142", "100_0005_0018"),)))[1]
    options = AgreementOptions(windows=12, points=2400)
    given, moved = (measure_agreement(j, options).ortho_ortho for j in (job, moved_camera(job, -1.0 / 6.0)))
    print(f"y-parallax as given {given.median_px[1]:+.3f}, moved {moved.median_px[1]:+.3f}, {given.count}")
    assert min(given.count, moved.count) > 200
    assert given.median_px[1] < -0.15
    assert abs(moved.median_px[1]) < 0.5 * abs(given.median_px[1])


def test_tuniu_gimbal_differs_by_a_degree_and_check_says_so(data_folder, tmp_path, capsys):
    source = data_folder / "odm_tuniu"
    keys = (
        'angles = "grid"\nadjusted_in = "space"\n[photos.compare]\nangles = "rph"\n'
        f'orientation = "{source}/odm_lla_rpy.csv"\n'
    )
    project = tuniu_project(tmp_path / "both", data_folder, source / "odm_xyz_opk.csv", keys)
    code, said, err = command(capsys, "check", project)
    assert code == 0
    text = " ".join((said + err).split())
    assert "is not the same as the one used" in text
    assert "angles differ by 1.13° on average" in text
