"""A written survey is a project that loads back to the truth, and its products keep the promised figures."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import tifffile

from stereomate.camera.distortion import BrownDistortion, NoDistortion, OpenCVDistortion
from stereomate.errors import InputError, StorageError
from stereomate.frames.transform import tangent_from_map
from stereomate.project import load
from stereomate.project.run import RunOptions, run
from stereomate.raster import open_heights, open_photo
from stereomate.synthetic.files import project_text, write_heights, write_survey
from stereomate.synthetic.options import SurveyOptions
from stereomate.synthetic.survey import make_survey
from stereomate.synthetic.truth import error_of_mean, matched_error, true_mate_ground, warp_error
from stereomate.tiles.executor import Threads


@pytest.fixture(scope="module")
def written(small_survey, tmp_path_factory):
    return write_survey(small_survey, tmp_path_factory.mktemp("survey"))


@pytest.fixture(scope="module")
def made(written, tmp_path_factory):
    return run(load(written.project), tmp_path_factory.mktemp("products"), RunOptions())


def test_photographs_read_back(small_survey, written):
    with open_photo(written.photographs[2]) as reader:
        assert reader.size == small_survey.options.size_px
        assert reader.bands == 3
        assert reader.is_windowed
        pixels, _ = reader.read_window(0, 0, *reader.size)
    assert np.array_equal(pixels, small_survey.render(2))


def test_height_model_reads_back(small_survey, written):
    with open_heights(written.heights) as reader:
        cols, rows = reader.size
        heights, _ = reader.read_window(0, 0, cols, rows)
    assert np.array_equal(heights, small_survey.world.heights)


def test_height_model_with_planted_errors(small_survey, tmp_path):
    wrong = small_survey.world.heights + 3.0
    wrong[5, 7] = np.nan
    write_heights(tmp_path / "wrong.tif", small_survey, wrong)
    with open_heights(tmp_path / "wrong.tif") as reader:
        heights, _ = reader.read_window(0, 0, *reader.size)
    assert np.array_equal(np.isnan(heights), np.isnan(wrong))
    assert np.nanmax(np.abs(heights - wrong)) < 1e-4
    with pytest.raises(InputError, match="heights"):
        write_heights(tmp_path / "other.tif", small_survey, wrong[1:])


def test_project_loads_to_the_truth(small_survey, written):
    project = load(written.project)
    assert project.survey.frame.heights.kind == "ellipsoidal"
    for true, read in zip(small_survey.survey.photographs, project.survey.photographs, strict=True):
        assert read.name == true.name
        # two tangent frames: compare where a ray of each camera goes, in the map
        pixels = np.array([[0.0, 0.0], [480.0, 0.0], [300.0, 200.0], [0.0, 360.0]])
        rays = true.camera.rays_from_image(pixels)
        assert np.abs(read.camera.rays_from_image(pixels) - rays).max() < 1e-12
        points = small_survey.world.map_from_tangent(true.orientation.tangent_from_camera(300.0 * rays))
        heights = project.require_heights()
        xy = points[:, :2]
        known = np.isfinite(heights.heights_at(xy))
        assert np.abs(heights.heights_at(xy) - small_survey.world.height(xy))[known].max() < 1e-9
        again, _ = read.camera.image_from_camera(
            read.orientation.camera_from_tangent(
                tangent_from_map(project.survey.tangent, project.survey.frame, points)
            )
        )
        assert np.abs(again - pixels).max() < 1e-5


def test_truth_is_written(small_survey, written):
    document = json.loads(written.truth.read_text())
    assert document["format"] == 1
    assert document["options"]["seed"] == small_survey.options.seed
    corners = np.concatenate([house["roof_corners"] for house in document["buildings"]])
    assert np.array_equal(corners, small_survey.roof_corners())
    assert np.array_equal(document["tree_tops"], small_survey.tree_tops())
    assert len(document["signalised_points"]) == 8
    point = document["signalised_points"][0]
    for name, pixel in point["image"].items():
        number = small_survey.survey.index(name)
        assert np.allclose(small_survey.project(number, point["position"])[0], pixel, rtol=0.0, atol=1e-9)


def test_computed_warps_keep_to_a_twentieth_of_a_pixel(small_survey, made):
    """The promise is 0.05 px rms; the lattice's own bound is 0.01 px, and float32 positions add 0.0001."""
    for product in made.products:
        for kind in ("orthophoto", "stereomate"):
            found = warp_error(small_survey, product.product.job, kind, 1500)
            assert found.count > 1000
            assert found.rms_px < 0.005
            assert found.largest_px < 0.02


def test_a_wrong_orientation_shows_in_the_warp(small_survey, made):
    """The comparison can fail: a centre moved by 10 cm is 0.2 px at this scale."""
    job = made.products[0].product.job
    first = job.photographs[job.models[0].left]
    x, y, z = first.orientation.centre
    moved = replace(first, orientation=replace(first.orientation, centre=(x + 0.1, y, z)))
    others = tuple(moved if p is first else p for p in job.photographs)
    found = warp_error(small_survey, replace(job, photographs=others), "orthophoto", 1500)
    assert found.largest_px > 0.15


def test_true_ground_of_the_stereomate_shows_where_asked(small_survey, made):
    job = made.products[0].product.job
    rng = np.random.default_rng(5)
    pixels = rng.uniform(0.0, 1.0, (500, 2)) * job.grid.size
    ground = true_mate_ground(small_survey, job, pixels)
    heights = small_survey.world.height(job.grid.map_from_pixel(ground))
    known = np.isfinite(ground[:, 0]) & np.isfinite(heights)
    assert known.mean() > 0.9
    shown = ground[known, 0] - job.law.q(heights[known]) / job.grid.gsd
    assert np.abs(shown - pixels[known, 0]).max() < 1e-8


def test_matched_parallaxes_on_open_ground(small_survey, made):
    for product in made.products:
        found = matched_error(small_survey, product.product.job, product.agreement)
        assert found.count > 25  # most of the small survey is village and wood
        assert np.abs(found.median_px).max() < 0.05
        assert np.max(found.nmad_px) < 0.2
        assert abs(found.height_mean_m) < found.height_bound_m


def test_jpeg_and_surface_on_request(small_survey, tmp_path):
    few = make_survey(replace(small_survey.options, strips=1, photos_per_strip=1))
    found = write_survey(few, tmp_path, photos="jpg", surface="surface")
    with open_photo(found.photographs[0]) as reader:
        pixels, _ = reader.read_window(0, 0, *reader.size)
    assert np.abs(pixels.astype(int) - few.render(0)).mean() < 4.0
    assert "strip*.jpg" in found.project.read_text()
    assert np.abs(tifffile.imread(found.heights) - few.world.surface_model()).max() < 1e-4


def test_two_writings_are_the_same_bytes(small_survey, written, tmp_path):
    again = write_survey(small_survey, tmp_path)
    for path in sorted(written.folder.iterdir()):
        assert path.read_bytes() == (again.folder / path.name).read_bytes(), path.name


def test_a_place_that_cannot_be_written(small_survey, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError):
        write_survey(small_survey, tmp_path / "file" / "below")


def test_distortion_without_words(small_survey):
    plain = replace(small_survey.options, distortion=NoDistortion())
    assert "distortion" not in project_text(make_survey(plain))
    for distortion in (OpenCVDistortion(k1=0.01), BrownDistortion(k1=0.01, k4=1e-3)):
        other = make_survey(replace(small_survey.options, distortion=distortion))
        with pytest.raises(InputError, match="distortion"):
            project_text(other)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_the_survey_of_the_demo_keeps_every_promise(seed, tmp_path):
    """The figures of the main job: warps 0.05 px rms, matches 0.05 and 0.2 px, heights without bias."""
    survey = make_survey(SurveyOptions(seed=seed))
    project = load(write_survey(survey, tmp_path, executor=Threads(2)).project)
    result = run(project, tmp_path / "products", RunOptions(threads=2))
    assert len(result.products) == 1
    job, agreement = result.products[0].product.job, result.products[0].agreement
    for kind in ("orthophoto", "stereomate"):
        found = warp_error(survey, job, kind)
        assert found.count > 3000
        assert found.rms_px < 0.002
        assert found.largest_px < 0.02
    match = matched_error(survey, job, agreement)
    assert match.count > 1500
    assert np.abs(match.median_px).max() < 0.02
    assert np.max(match.nmad_px) < 0.12
    assert abs(match.height_mean_m) < match.height_bound_m


def test_the_error_of_a_mean_counts_blocks_of_ground_that_err_alike():
    rng = np.random.default_rng(3)
    pixels = rng.uniform(0.0, 20 * 256.0, (8000, 2))
    alone = rng.normal(0.0, 0.02, 8000)
    assert error_of_mean(alone, pixels) == pytest.approx(0.02 / np.sqrt(8000), rel=0.15)
    cell = np.floor(pixels / 256.0).astype(int)
    together = rng.normal(0.0, 0.02, (20, 20))[cell[:, 0], cell[:, 1]]
    assert error_of_mean(together, pixels) == pytest.approx(0.02 / np.sqrt(400), rel=0.15)
    assert np.isnan(error_of_mean(alone[:5], np.zeros((5, 2))))
