"""Heights of objects and the check of the height model, on a small survey that is really photographed."""

from __future__ import annotations

import json

import numpy as np
import pytest
import rasterio
from typer.testing import CliRunner

from stereomate.cli.main import application
from stereomate.dense.ground_filter import GroundOptions, ground_cells, window_widths
from stereomate.dense.matching import DenseOptions
from stereomate.errors import InputError
from stereomate.frames.transform import map_from_tangent
from stereomate.raster import Window
from stereomate.rectify.ground import method_code
from stereomate.stereo.exact import ground_of_orthophoto, intersect_grounds
from stereomate.stereo.ground_pair import folded_away
from stereomate.stereo.kernels import dense_points
from stereomate.stereo.matched_surface import SurfaceOptions, match_window
from stereomate.stereo.model_quality import ModelTally, quality_of
from stereomate.stereo.product import StereoProduct
from stereomate.stereo.rays import ray_nodes
from stereomate.stereo.surface import JobSurface
from stereomate.synthetic.files import write_survey
from stereomate.synthetic.options import SurveyOptions
from stereomate.synthetic.survey import make_survey
from surveys import stereomate_says as run

OPTIONS = SurveyOptions(
    seed=7,
    strips=1,
    photos_per_strip=3,
    size_px=(800, 600),
    gsd_m=0.4,
    flying_height_m=500.0,
    pixel_pitch_mm=0.12,
    relief_m=40.0,
    buildings=14,
    trees=60,
    control_points=2,
    check_points=2,
)
ERRORS = {"hill": -8.0, "step": 3.0, "tilt": 0.004}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The survey with its true height model, its products, and its matched surface with the check."""
    folder = tmp_path_factory.mktemp("surface")
    survey = make_survey(OPTIONS)
    files = write_survey(survey, folder)
    run("--quiet", "run", files.project, "--out", folder / "out")
    text = run("terrain", folder / "out", "--json")
    return survey, files, folder / "out", json.loads(text[text.index("{") :])


def surface_of(out):
    """Layers of the matched surface, and map positions of its cells."""
    with rasterio.open(out / "surface.tif") as file:
        layers = file.read().astype(np.float64)
        row, col = np.mgrid[0 : file.height, 0 : file.width]
        xy = np.stack(file.transform @ (col + 0.5, row + 0.5), axis=-1)
    return layers, xy


@pytest.mark.slow
def test_open_ground_has_no_bias(made):
    """|mean| below three standard deviations of the mean of independent windows; sigma as it is predicted."""
    survey, _, out, record = made
    (height, above, sigma, miss, *_), xy = surface_of(out)
    assert record["surface"]["matched"] > 0.9
    # windows of 9 pixels do not overlap on every fifth cell of two pixels
    thin = np.zeros(height.shape, bool)
    thin[::5, ::5] = True
    ground = np.isfinite(height) & thin & survey.world.is_clear(xy)
    error = height[ground] - survey.world.height(xy[ground])
    assert ground.sum() > 1000
    assert abs(error.mean()) < 3.0 * error.std() / np.sqrt(ground.sum())
    assert error.std() < 1.3 * np.sqrt(np.mean(sigma[ground] ** 2))
    np.testing.assert_allclose(above[ground], error, atol=2e-3)
    assert np.sqrt(np.mean(miss[ground] ** 2)) < 0.1 * OPTIONS.gsd_m


@pytest.mark.slow
def test_building_heights_as_predicted(made):
    """Roofs, a metre inside their edges: rms of all cells not flagged within 1.5 times the prediction."""
    survey, _, out, record = made
    (height, _, sigma, _, _, jump), xy = surface_of(out)
    errors, sigmas, medians, flagged = [], [], [], []
    for house in survey.world.buildings:
        c, s = np.cos(house.azimuth), np.sin(house.azimuth)
        d = xy - np.array(house.centre)
        along, across = c * d[..., 0] + s * d[..., 1], -s * d[..., 0] + c * d[..., 1]
        inside = (abs(along) < house.half_length - 1.0) & (abs(across) < house.half_width - 1.0)
        inside &= np.isfinite(height)
        flagged.append(jump[inside])
        inside &= jump == 0.0
        if inside.sum() < 20:
            continue
        roof = house.ridge - house.roof_slope * abs(across[inside])
        errors.append(height[inside] - roof)
        sigmas.append(sigma[inside])
        medians.append(np.median(errors[-1]))
    assert len(medians) >= 8
    predicted = np.sqrt(np.mean(np.concatenate(sigmas) ** 2))
    assert np.sqrt(np.mean(np.concatenate(errors) ** 2)) < 1.5 * predicted
    assert np.sqrt(np.mean(np.square(medians))) < 1.5 * predicted
    assert np.mean(np.concatenate(flagged)) < 0.15
    assert record["surface"]["beside_jumps"] == pytest.approx(np.nanmean(jump), abs=1e-3)
    assert record["surface"]["beside_jumps"] < 0.03


@pytest.mark.slow
def test_dense_geometry_is_that_of_measuring(made):
    """The kernel against the exact chain of `measure` at the same positions, for the same noise."""
    _, _, out, _ = made
    product = StereoProduct.open(out, verify=False)
    job = product.job
    options = SurfaceOptions(dense=DenseOptions(step_px=7))
    window = Window(job.grid.size[0] // 2 - 200, job.grid.size[1] // 2 - 150, 400, 300)
    found = match_window(product, window, options)
    match, lattice = found.match, found.pair.ground.lattice
    points, photographs = np.empty_like(found.points), np.empty_like(found.photographs)
    one, zero = np.ones_like(match.variance), np.zeros_like(match.variance)
    dense_points.intersect_matches(
        match.parallax, match.row_parallax, one, zero, one, found.pair.photographs, 7, 0.0,
        method_code(job), found.pair.ground.patch, found.pair.ground.surface_nodes,
        ray_nodes(job, found.pair.ground), float(lattice.col0 - window.col0),
        float(lattice.row0 - window.row0), float(lattice.step), job.grid.gsd, points, photographs,
    )  # fmt: skip
    m, n = np.nonzero(np.isfinite(points[dense_points.HEIGHT]))
    assert (points[dense_points.ABOVE, m, n] > 3.0).sum() > 20
    pixel = np.stack([n, m], axis=-1) * 7 + 3.5 + np.array([window.col0, window.row0])
    right = pixel - np.stack([match.parallax[m, n], match.row_parallax[m, n]], axis=-1)
    surface = JobSurface(job)
    ground = [
        ground_of_orthophoto(surface, job.grid.uv_from_map(job.grid.map_from_pixel(xy)))
        for xy in (pixel, right)
    ]
    centres = job.centres_tangent[photographs[0, m, n]], job.centres_tangent[photographs[1, m, n]]
    gsd = job.grid.gsd
    exact = intersect_grounds(ground[0], ground[1], centres, (1e-5 * gsd, 1e-5 * gsd, gsd, gsd))
    truth = map_from_tangent(job.tangent, job.frame, exact.points)
    place = points[[dense_points.COL, dense_points.ROW]][:, m, n].T.astype(np.float64)
    at = job.grid.map_from_pixel(place + np.array([window.col0, window.row0]))
    # rays that miss by much are corrected across creases of the height model: one step instead of several
    near = exact.miss < 0.2 * gsd
    assert near.mean() > 0.9
    found_heights = points[dense_points.HEIGHT, m, n]
    np.testing.assert_allclose(at[near], truth[near, :2], atol=3e-3)
    np.testing.assert_allclose(found_heights[near], truth[near, 2], atol=3e-3)
    np.testing.assert_allclose(found_heights, truth[:, 2], atol=0.05)
    np.testing.assert_allclose(abs(points[dense_points.MISS, m, n]), exact.miss, atol=2e-3)
    sigma = np.sqrt(exact.covariance[:, 2, 2])
    np.testing.assert_allclose(points[dense_points.SIGMA, m, n][near], sigma[near], rtol=5e-3)
    above = truth[:, 2] - job.heights.heights_at(truth[:, :2])
    np.testing.assert_allclose(points[dense_points.ABOVE, m, n][near], above[near], atol=5e-3)


@pytest.mark.slow
def test_planted_errors_are_found_and_repaired(made, tmp_path):
    """A missing hill, a step of 3 m and a tilt: repaired to 0.3 m, and the products made anew show it."""
    survey, files, _, _ = made
    planted = tmp_path / "planted"
    planted.mkdir()
    for path in files.folder.glob("*.*"):
        if path.is_file():
            (planted / path.name).write_bytes(path.read_bytes())
    world = survey.world
    rows, cols = world.heights.shape
    a, _, c, _, e, f = world.affine
    x = c + a * (np.arange(cols) + 0.5) - OPTIONS.centre[0]
    y = (f + e * (np.arange(rows) + 0.5) - OPTIONS.centre[1])[:, None]
    wrong = ERRORS["hill"] * np.exp(-((x + 60.0) ** 2 + (y - 10.0) ** 2) / (2.0 * 22.0**2))
    wrong = wrong + ERRORS["step"] * (x > 70.0) + ERRORS["tilt"] * y
    with rasterio.open(planted / "heights.tif", "r+") as file:
        file.write((world.heights + wrong).astype(np.float32), 1)
    run("--quiet", "run", planted / "project.toml", "--out", planted / "out")
    text = run(
        "terrain", planted / "out", "--repair", planted / "repaired.tif", "--remake", planted / "again"
    )
    assert "corrected height model" in text
    with rasterio.open(planted / "repaired.tif") as file:
        repaired = file.read(1).astype(np.float64)
    with rasterio.open(planted / "out" / "terrain.tif") as file:
        checked = np.isfinite(file.read(1))
    assert checked.sum() > 10_000
    before = np.sqrt(np.mean(wrong[checked] ** 2))
    error = (repaired - world.heights)[checked]
    assert before > 1.5
    assert np.sqrt(np.mean(error**2)) < 0.3
    assert np.quantile(abs(error), 0.95) < 0.3
    for part in (x[None, :] > 75.0, np.hypot(x + 60.0, y - 10.0) < 30.0):
        here = checked & np.broadcast_to(part, checked.shape)
        assert abs(np.median((repaired - world.heights)[here])) < 0.05
    assert (planted / "out" / "terrain.png").stat().st_size > 10_000
    again = StereoProduct.open(planted / "again")
    rasters = {"ortho.tif", "mate.tif", "lineage.tif", "stereo.json", "run.log"}
    beside = {"report.html", "report.json", "item.json", "seams.gpkg"}
    assert {path.name for path in (planted / "again").iterdir()} == rasters | beside
    assert set(json.loads((planted / "again" / "stereo.json").read_text())["run"]["documents"]) == beside
    assert "repaired" in (planted / "again" / "report.html").read_text()
    assert again.job.heights.path == planted / "repaired.tif"
    residual = again.agreement["orthophoto_against_stereomate"]
    first = StereoProduct.open(planted / "out").agreement["orthophoto_against_stereomate"]
    assert residual["nmad_px"][0] < 0.5 * first["nmad_px"][0]


@pytest.mark.slow
def test_refusals_of_the_commands(made, tmp_path):
    _, files, out, _ = made
    result = CliRunner().invoke(application(), ["terrain", str(out), "--remake", str(tmp_path / "x")])
    assert isinstance(result.exception, InputError)
    result = CliRunner().invoke(application(), ["terrain", str(out), "--repair", str(files.heights)])
    assert isinstance(result.exception, InputError)
    with pytest.raises(InputError, match="above_m"):
        SurfaceOptions(above_m=0.0)


def test_ground_among_objects():
    """Houses and trees are taken off; a hill and a step of the height model's error stay."""
    rng = np.random.default_rng(4)
    rows, cols = 160, 200
    y, x = np.mgrid[0:rows, 0:cols].astype(float)
    ground = 6.0 * np.exp(-((x - 50.0) ** 2 + (y - 80.0) ** 2) / (2.0 * 20.0**2)) + 3.0 * (x > 140.0)
    surface = ground + 0.05 * rng.standard_normal(ground.shape)
    objects = np.zeros(ground.shape, bool)
    for r, c, half, height in ((40, 60, 8, 6.0), (100, 45, 5, 4.0), (90, 160, 12, 9.0), (30, 120, 2, 12.0)):
        place = (slice(r - half, r + half), slice(c - half, c + half))
        surface[place] += height
        objects[place] = True
    surface[10:20, 10:20] = np.nan
    found = ground_cells(surface.astype(np.float32), 1.0, GroundOptions(largest_object_m=30.0))
    assert not (found & objects).any()
    assert not found[10:20, 10:20].any()
    beside = np.isfinite(surface) & ~objects
    assert found[beside].mean() > 0.98
    assert window_widths(3.0) == [3]
    with pytest.raises(InputError, match="slope"):
        GroundOptions(slope=0.0)


def test_folded_ground():
    shown = np.array([[0.0, 1.0, 2.0, 1.5, 2.5, np.nan, 3.0]])
    np.testing.assert_array_equal(folded_away(shown), [[False, False, True, False, False, False, False]])


def test_tally_of_models():
    """Medians from classes agree with those of the values; tallies of chunks add up."""
    rng = np.random.default_rng(2)
    miss, y = 0.02 + 0.05 * rng.standard_normal(4000), 0.1 * rng.standard_normal(4000)
    photographs = np.stack([np.full(4000, 1), np.full(4000, 2)]).astype(np.int16)
    first, second = ModelTally(0.3), ModelTally(0.3)
    first.add(photographs[:, :1500], miss[:1500], y[:1500])
    second.add(photographs[:, 1500:], miss[1500:], y[1500:])
    second.merge(json.loads(json.dumps(first.counts)))
    (found,) = second.qualities(["a", "b", "c"], 1.0)
    exact = quality_of(("b", "c"), miss, y)
    assert (found.left, found.right, found.count) == ("b", "c", 4000)
    for name in ("miss_median_m", "miss_nmad_m", "miss_rms_m", "y_median_m", "y_nmad_m", "y_rms_m"):
        assert getattr(found, name) == pytest.approx(getattr(exact, name), abs=3e-3)


def test_points_on_cells():
    """The highest points of a cell count, taken along their slope to its centre; walls stay sharp."""
    points = np.full((dense_points.POINT_LAYERS, 12, 12), np.nan, np.float32)
    n, m = np.meshgrid(np.arange(12), np.arange(12))
    points[dense_points.COL] = 2 * n + 1.9
    points[dense_points.ROW] = 2 * m + 1.2
    points[dense_points.HEIGHT] = 100.0 + 0.25 * points[dense_points.COL]
    points[dense_points.SIGMA] = 0.05
    points[dense_points.MISS] = 0.0
    # one point of a roof in the cell of a ground point
    points[dense_points.HEIGHT, 6, 6] = 112.0
    points[dense_points.COL, 6, 6] = 2 * 7 + 1.4
    out = np.empty((12, 12, 5), np.float32)
    dense_points.lay_points(points, np.ones((12, 12), np.float32), 2, 0, 0, 1.0, out)
    assert out[6, 7, 0] == pytest.approx(112.0)
    assert np.isnan(out[6, 6, 0])
    centre = 100.0 + 0.25 * (2 * np.arange(12) + 1.5)
    np.testing.assert_allclose(out[3, 2:10, 0], centre[2:10], atol=1e-4)
    out[..., 1] = out[..., 0]
    filled = np.empty_like(out)
    dense_points.fill_small_gaps(out, 5, filled)
    assert filled[6, 6, 0] == pytest.approx(centre[6], abs=0.3)
