"""The surface of a block by dense matching: epipolar geometry, fusion, and a block with known truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from scipy.ndimage import map_coordinates

from stereomate.dense.epipolar import epipolar_pair
from stereomate.dense.fusion import FILLED, MEASURED, VOID, FusionOptions, filled, fuse, holes
from stereomate.dense.ground_filter import GroundOptions
from stereomate.dense.pair_surface import CellGrid, laid
from stereomate.dense.surface import SurfaceModelOptions, SurfaceResult, make_surface
from stereomate.dense.surface_plan import PlanOptions, SurfacePlan, plan_surface
from stereomate.dense.terrain_model import TerrainOptions, reduced, terrain_window
from stereomate.project import load
from stereomate.synthetic.files import write_survey
from stereomate.synthetic.options import SurveyOptions
from stereomate.synthetic.survey import SyntheticSurvey, make_survey
from stereomate.terrain.model import HeightModel
from stereomate.tiles import Threads

SURVEY = SurveyOptions(
    seed=3, strips=1, photos_per_strip=3, size_px=(360, 270), gsd_m=0.5, flying_height_m=260.0,
    pixel_pitch_mm=0.1, relief_m=40.0, terrain_step_m=3.0, buildings=4, trees=10,
    control_points=0, check_points=0,
)  # fmt: skip
OPTIONS = SurfaceModelOptions(terrain=TerrainOptions(factor=2, ground=GroundOptions(largest_object_m=30.0)))


@pytest.fixture(scope="module")
def block(tmp_path_factory: pytest.TempPathFactory) -> tuple[SyntheticSurvey, SurfacePlan]:
    """Three photographs as they were written, and the plan of their surface above level ground."""
    made = make_survey(SURVEY)
    written = write_survey(made, tmp_path_factory.mktemp("block"))
    survey = load(written.project).survey
    heights = made.world.heights
    level = HeightModel.from_array(
        np.full(heights.shape, float(np.mean(heights))), made.world.affine, survey.frame
    )
    return made, plan_surface(survey, level, PlanOptions(pairs_per_photo=2))


@pytest.fixture(scope="module")
def surface(
    block: tuple[SyntheticSurvey, SurfacePlan], tmp_path_factory: pytest.TempPathFactory
) -> SurfaceResult:
    return make_surface(block[1], tmp_path_factory.mktemp("surface"), "key", OPTIONS)


def against_truth(made: SyntheticSurvey, path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Heights of a raster minus the bare ground, and the raster."""
    with rasterio.open(path) as file:
        heights = file.read(1, masked=True).filled(np.nan).astype(np.float64)
        col, row = np.meshgrid(np.arange(file.width) + 0.5, np.arange(file.height) + 0.5)
        x, y = file.transform @ (col, row)
    col, row = ~rasterio.Affine(*made.world.affine) @ (x, y)
    truth = map_coordinates(made.world.heights, [row - 0.5, col - 0.5], order=1, cval=np.nan)
    return heights - truth, heights


def test_object_points_have_one_row_and_the_parallax_of_their_depth(
    block: tuple[SyntheticSurvey, SurfacePlan],
) -> None:
    """Against the package's own projection: pixels of a point in both epipolar images, by its photographs."""
    survey, ground = block[1].survey, block[1].ground
    first, second = survey.photographs[0], survey.photographs[1]
    pair = epipolar_pair(first, second, ground, 1)
    assert pair is not None
    np.testing.assert_allclose(pair.axes.T @ pair.axes, np.eye(3), atol=1e-12)
    rng = np.random.default_rng(2)
    points = ground[rng.integers(0, len(ground), 50)] + rng.normal(0.0, 8.0, (50, 3))
    found = []
    for photo, centre_px in ((pair.left, pair.centres_px[0]), (pair.right, pair.centres_px[1])):
        local = (points - np.array(photo.orientation.centre)) @ pair.axes
        col = centre_px + pair.focal_px * local[:, 0] / -local[:, 2]
        row = pair.centre_row_px - pair.focal_px * local[:, 1] / -local[:, 2]
        found.append((col, row))
    (left, rows), (right, other) = found
    np.testing.assert_allclose(rows, other, atol=1e-8)
    np.testing.assert_allclose(pair.points(left, rows, left - right), points, atol=1e-6)
    depth = -((points - np.array(pair.left.orientation.centre)) @ pair.axes)[:, 2]
    np.testing.assert_allclose(pair.parallax(depth), left - right, atol=1e-8)
    # Ground of a middle depth has none.
    assert abs(float(np.median(left - right))) < 4.0
    # A pixel more of parallax is what its standard deviation says.
    one = pair.depth(left - right) - pair.depth(left - right + 0.01)
    np.testing.assert_allclose(pair.sigma_m(left - right, np.full(50, 0.01)), one, rtol=1e-3)


def test_photographs_that_share_no_ground_make_no_pair(block: tuple[SyntheticSurvey, SurfacePlan]) -> None:
    survey, ground = block[1].survey, block[1].ground
    far = ground + np.array([5000.0, 0.0, 0.0])
    assert epipolar_pair(survey.photographs[0], survey.photographs[1], far, 1) is None


@pytest.mark.slow
def test_surface_and_terrain_of_a_block_with_known_truth(
    block: tuple[SyntheticSurvey, SurfacePlan], surface: SurfaceResult
) -> None:
    """Heights to a tenth of a pixel of parallax; houses and trees on the surface, not on the terrain."""
    difference, _ = against_truth(block[0], surface.surface)
    known = np.isfinite(difference)
    assert abs(float(np.median(difference[known]))) < 0.03
    nmad = 1.4826 * float(np.median(np.abs(difference[known] - np.median(difference[known]))))
    weakest = max(pair.sigma_m(np.zeros(1), np.array([0.1]))[0] for pair in block[1].pairs)
    assert nmad < weakest
    # Houses and trees stand on it.
    assert difference[known].max() > 3.0
    terrain, _ = against_truth(block[0], surface.terrain)
    ground = terrain[np.isfinite(terrain)]
    assert ground.size > 0.9 * np.isfinite(difference).mean() * terrain.size
    assert float(np.sqrt(np.mean(ground**2))) < 0.2 * float(np.sqrt(np.mean(difference[known] ** 2)))
    # Where a house or a tree stands, the ground below it.
    rows, cols = terrain.shape
    above = difference[1::2, 1::2][:rows, :cols]
    below = terrain[: above.shape[0], : above.shape[1]][above > 2.0]
    below = below[np.isfinite(below)]
    assert len(below) > 30
    assert float(np.median(np.abs(below))) < 0.1 * float(np.median(above[above > 2.0]))
    assert np.abs(ground).max() < 0.4 * difference[known].max()


@pytest.mark.slow
def test_stated_standard_deviations_hold_and_what_is_filled_is_marked(
    block: tuple[SyntheticSurvey, SurfacePlan], surface: SurfaceResult
) -> None:
    difference, heights = against_truth(block[0], surface.surface)
    with rasterio.open(surface.quality) as file:
        sigma, pairs, kind = file.read()
        assert "standard deviation" in file.descriptions[0]
    known = np.isfinite(heights)
    assert ((kind == MEASURED) | (kind == FILLED))[known].all()
    measured = kind == MEASURED
    assert (pairs[measured] >= 1).all()
    assert (pairs[kind == FILLED] == 0).all()
    standardized = np.abs(difference[measured] / sigma[measured])
    # Two thirds within one, on open ground; at the edges of objects more may be off.
    assert 0.5 < float(np.mean(standardized < 1.0)) < 0.95
    assert float(np.mean(standardized < 3.0)) > 0.93
    figures = surface.figures
    assert figures["measured_cells"] == measured.sum()
    assert all(abs(pair["y_parallax_px"]) < 0.05 for pair in figures["pairs"])


@pytest.mark.slow
def test_a_run_that_was_killed_goes_on_and_gives_the_same_bytes(
    block: tuple[SyntheticSurvey, SurfacePlan], surface: SurfaceResult, tmp_path: Path
) -> None:
    """Stopped at every boundary and inside; the second half with two threads."""
    stops = [("matching", 1), ("matching", len(block[1].pairs)), ("surface", 1), ("terrain", 1)]
    reached = 0
    for stage, at in stops:
        begun: list[int] = []

        def stop(
            name: str, done: int, total: int, stage: str = stage, at: int = at, begun: list[int] = begun
        ) -> None:
            if name == "matching":
                begun.append(done)
            if name == stage and done == at:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            make_surface(block[1], tmp_path, "key", OPTIONS, progress=stop)
        assert begun[0] >= reached
        reached = begun[-1]
    again = make_surface(block[1], tmp_path, "key", OPTIONS, Threads(2))
    for one, other in ((surface.surface, again.surface), (surface.terrain, again.terrain),
                       (surface.quality, again.quality)):  # fmt: skip
        assert one.read_bytes() == other.read_bytes()
    assert not list(tmp_path.glob(".*"))


def test_points_are_laid_by_their_cell() -> None:
    grid = CellGrid(100.0, 200.0, 2.0, (5, 4))
    xyz = np.array([[101.0, 199.0, 3.0], [101.5, 198.5, 5.0], [100.1, 199.9, 100.0], [107.0, 195.0, 7.0],
                    [99.0, 199.0, 1.0], [105.0, 199.0, np.nan]])  # fmt: skip
    window, heights, sigma = laid(xyz, np.array([0.1, 0.2, 0.3, 0.4, 9.0, 9.0]), grid)
    assert window == (0, 0, 4, 3)
    assert heights[0, 0] == 5.0
    assert heights[2, 3] == 7.0
    assert sigma[0, 0] == pytest.approx(0.2)
    assert np.isfinite(heights).sum() == 2


def test_fusion_takes_what_pairs_agree_on() -> None:
    rng = np.random.default_rng(1)
    sigma = np.full((5, 40, 50), 0.1, np.float32)
    heights = (10.0 + 0.1 * rng.normal(size=(5, 40, 50))).astype(np.float32)
    heights[0, 10:20, 10:20] += 6.0  # one pair of five is wrong
    heights[1:, 30:36, 40:46] = np.nan
    heights[0, 30:36, 40:46] += 9.0  # alone and far off: a small patch
    heights[2:, 0:5, 0:5] = np.nan
    heights[0, 0:5, 0:5] += 5.0  # two that contradict each other
    heights[:, 25, 25] = np.nan
    heights[:, :, 30:] = np.where(np.arange(50)[30:] > 47, np.nan, heights[:, :, 30:])
    found = fuse(heights, sigma, FusionOptions(speckle_cells=50, room=1.0, filled_cells=3))
    good = found.kind == MEASURED
    assert np.abs(found.heights[good] - 10.0).max() < 0.5
    assert (found.pairs[10:20, 10:20] == 4).mean() > 0.8
    assert (found.kind[30:36, 40:46] != MEASURED).all()
    assert (found.kind[1:4, 1:4] != MEASURED).all()
    assert found.kind[25, 25] == FILLED
    # Nothing grows outwards.
    assert (found.kind[10:30, 48:] == VOID).all()
    # The median of five of 0.1: 0.1 * 1.2533 / sqrt(5).
    inner = found.sigma[good & (found.pairs == 5)]
    assert float(np.median(inner)) == pytest.approx(0.056, rel=0.3)
    error = found.heights[good & (found.pairs == 5)] - 10.0
    assert float(error.std()) == pytest.approx(float(np.sqrt(np.mean(inner**2))), rel=0.25)


def test_holes_are_filled_as_their_rim_says_and_margins_are_not() -> None:
    col = np.mgrid[0:60, 0:60][1].astype(np.float32)
    heights = (5.0 + 0.05 * col).astype(np.float32)
    heights[20:26, 20:26] = np.nan
    heights[:, 55:] = np.nan
    hole = holes(np.isfinite(heights), 5)
    assert hole[20:26, 20:26].all()
    assert hole.sum() == 36
    out = filled(heights, hole, 5)
    np.testing.assert_allclose(out[20:26, 20:26], (5.0 + 0.05 * col)[20:26, 20:26], atol=0.1)
    assert np.isnan(out[:, 55:]).all()


def test_terrain_goes_below_a_house_and_keeps_a_slope() -> None:
    col = np.mgrid[0:120, 0:120][1].astype(np.float32)
    slope = 0.15 * col
    heights = slope.copy()
    heights[50:62, 50:62] += 7.0
    heights[:, 115:] = np.nan
    options = TerrainOptions(ground=GroundOptions(largest_object_m=20.0))
    terrain, ground = terrain_window(heights, np.full_like(heights, 5.0), 1.0, options)
    assert not ground[51:61, 51:61].any()
    assert np.abs((terrain - slope)[:, :115]).max() < 0.6
    assert np.isnan(terrain[:, 115:]).all()


def test_reduced_cells_are_medians_of_what_is_known() -> None:
    heights = np.arange(24, dtype=np.float32).reshape(4, 6)
    heights[0, :] = np.nan
    heights[1, 4:] = np.nan
    out = reduced(heights, 2)
    assert out.shape == (2, 3)
    assert out[0, 0] == 6.0
    assert np.isnan(out[0, 2])
    assert out[1, 1] == 15.0
