"""Ground hidden from the photographs of every model: each eye takes another that sees it, never the same."""

from dataclasses import replace

import numpy as np
import pytest
from rectify_scenes import BASE, CENTRE, FLYING_HEIGHT, GROUND, height_model, make_job, write_noise

from stereomate.coverage.summary import survey_coverage
from stereomate.frames.orientation import ExteriorOrientation
from stereomate.frames.transform import tangent_from_map
from stereomate.raster import Window
from stereomate.rectify.engine import rectify_window
from stereomate.rectify.layout import StereoModel
from stereomate.rectify.options import RectifyOptions
from stereomate.rectify.planning import Request, plan_products
from stereomate.rectify.task import ChunkTask, product_profile
from stereomate.stereo.lineage import LineageRule
from stereomate.stereo.measure import Flag, measure
from stereomate.synthetic.options import SurveyOptions
from stereomate.synthetic.survey import make_survey
from stereomate.terrain.model import HeightModel
from stereomate.tiles import Threads, TilePlan, map_items

# Both centres stand 250 m from a wall of 120 m and 1000 m above the ground: its shadow is 36 m wide.
SHADOW = 265.0 * 120.0 / 880.0


def walled_job(folder, third=None):
    """A model over a wall; a third photograph, if any, stands `third` metres east of the wall."""

    def wall(x, y):
        return GROUND + np.where(np.abs(x) < 15.0, 120.0, 0.0) + 0.0 * y

    job = make_job(folder, heights=height_model(5.0, wall, 400))
    photographs, centres = job.photographs, job.centres_in_height_model
    if third is not None:
        path = folder / "third.tif"
        write_noise(path, 9)
        at = [CENTRE[0] + third, CENTRE[1], GROUND + FLYING_HEIGHT]
        orientation = ExteriorOrientation(
            tuple(tangent_from_map(job.tangent, job.frame, at)), photographs[1].orientation.object_from_camera
        )
        photographs += (replace(photographs[1], name="third", path=path, orientation=orientation),)
        centres = np.vstack([centres, [*job.heights.pixel_from_map(np.array([at[:2]]))[0], at[2]]])
    used = len(photographs)
    return replace(
        job,
        photographs=photographs,
        reductions=(1,) * used,
        centres_in_height_model=centres,
        models=(
            StereoModel(0, 1, BASE, 0.0, 6.0, FLYING_HEIGHT),
            *(StereoModel(p, -1, penalty=100.0) for p in range(used)),
        ),
    )


def middle_row(job):
    """Photographs (from 1) of both eyes along the row through the middle, by ground position."""
    cols, rows = job.grid.size
    window = Window(0, rows // 2, cols, 1)
    ortho, _ = rectify_window(job, window)
    left = ortho.photograph[0].astype(int)
    xy = job.grid.map_from_pixel(np.column_stack([np.arange(cols) + 0.5, np.full(cols, rows // 2 + 0.5)]))
    x = xy[:, 0] - CENTRE[0]
    shown = np.column_stack([job.grid.uv_from_map(xy)])
    shown[:, 0] -= job.law.q(job.heights.heights_at(xy))
    right = LineageRule(job).photographs(1, job.grid.pixel_from_map(job.grid.map_from_uv(shown)))
    return x, left, right


def test_one_photograph_that_sees_the_ground_serves_the_orthophoto_alone(tmp_path):
    x, left, right = middle_row(walled_job(tmp_path))
    east, west = (x > 22.0) & (x < 12.0 + SHADOW), (x < -22.0) & (x > -12.0 - SHADOW)
    assert (left[east] == 2).all()
    assert (right[east] == 0).all()
    assert (left[west] == 1).all()
    assert (right[west] == 0).all()
    clear = (np.abs(x) > 18.0 + SHADOW) & (np.abs(x) < 150.0)
    assert (left[clear] == 1).all()
    assert (right[clear] == 2).all()


def test_another_photograph_fills_an_eye_and_the_one_further_along_the_rows_is_the_right_one(tmp_path):
    # the third sees what the second does, from further east: both show the ground that the first does not see
    x, left, right = middle_row(walled_job(tmp_path, third=500.0))
    east = (x > 22.0) & (x < 12.0 + SHADOW)
    assert (left[east] == 2).all()
    assert (right[east] == 3).all()
    # from west of the second one it is the left eye that it fills; even closer than any model's base
    x, left, right = middle_row(walled_job(tmp_path, third=120.0))
    assert (left[east] == 3).all()
    assert (right[east] == 2).all()


def test_filled_chunks_are_the_same_whatever_threads_make_them_in_whatever_order(tmp_path):
    job = walled_job(tmp_path, third=500.0)
    plan = TilePlan(size=job.grid.size, block=128, chunk_tiles=2)
    task = ChunkTask(job, plan, product_profile(job))
    chunks = list(plan.chunks)
    there = map_items(task, chunks, Threads(1))
    again = map_items(task, chunks[::-1], Threads(2))[::-1]
    assert [{k: bytes(v) for k, v in blobs.items()} for blobs in there] == [
        {k: bytes(v) for k, v in blobs.items()} for blobs in again
    ]


@pytest.fixture(scope="module")
def town():
    """High houses under wide angles, rectified over a surface model of them."""
    survey = make_survey(
        SurveyOptions(
            seed=11, strips=2, photos_per_strip=4, size_px=(400, 300), gsd_m=0.5, flying_height_m=150.0,
            pixel_pitch_mm=0.12, relief_m=20.0, terrain_step_m=1.0, buildings=30, trees=0, control_points=0,
            check_points=0, forward_overlap=0.7, side_overlap=0.5,
        )
    )  # fmt: skip
    world = survey.world
    heights = HeightModel.from_array(world.surface_model(), world.affine, world.frame)
    coverage = survey_coverage(survey.survey, heights)
    jobs = {}
    for hidden in ("nodata", "fill"):
        options = RectifyOptions(gsd=0.5, hidden=hidden, heights_interpolation="bilinear")
        jobs[hidden] = plan_products(survey.survey, heights, coverage, options, Request())[0]
    return survey, jobs


def test_filled_ground_of_a_town_is_seen_by_both_photographs(town):
    """Against rays through the world itself: houses with upright walls, not their height model."""
    survey, jobs = town
    job = jobs["fill"]
    cols, rows = job.grid.size
    rng = np.random.default_rng(1)
    xy = job.grid.map_from_pixel(rng.uniform(20, np.array([cols, rows]) - 20.0, (40_000, 2)))
    points = np.column_stack([xy, survey.world.height(xy)])
    ring = [(3.0 * np.cos(a), 3.0 * np.sin(a)) for a in np.arange(8) * np.pi / 4.0]
    above = [job.heights.heights_at(xy + d) - survey.world.height(xy + d) for d in ring]
    beside = (np.abs(above) < 0.05).all(axis=0)
    xy, points = xy[beside], points[beside]
    names = [p.name for p in survey.survey.photographs]
    numbers = [names.index(p.name) for p in job.photographs]
    # seen or not for certain: all around, too
    around = [np.array([dx, dy, 0.0]) for dx, dy in ((0, 0), (2, 0), (-2, 0), (0, 2), (0, -2))]
    seen = np.array([[survey.visible(n, points + d) for d in around] for n in numbers])
    certain = (seen.all(axis=1) | ~seen.any(axis=1)).all(axis=0)
    points, xy, seen = points[certain], xy[certain], seen[:, 0, certain]
    uv = job.grid.uv_from_map(xy)
    mate = job.grid.map_from_uv(uv - np.column_stack([job.law.q(points[:, 2]), np.zeros(len(xy))]))
    shown = {}
    for hidden, one in jobs.items():
        rule = LineageRule(one)
        shown[hidden] = np.column_stack(
            [rule.photographs(side, one.grid.pixel_from_map(at)) for side, at in enumerate((xy, mate))]
        )
    left, right = shown["fill"].T - 1
    found = measure(job, LineageRule(job), xy, mate)
    # of ground that the stereomate does not show, the fold is told
    apart = np.hypot(*(found.points - points)[:, :2].T)
    index = np.arange(len(xy))
    both = (left >= 0) & (right >= 0)
    assert (left != right)[both].all()
    assert seen[left, index][left >= 0].mean() > 0.999
    unfolded = (found.flags & int(Flag.FOLD)) == 0
    assert seen[right, index][both & unfolded].mean() > 0.999
    there = both & unfolded
    assert np.quantile(apart[there], 0.99) < 0.02
    in_model = np.any([seen[m.left] | seen[m.right] for m in job.models if m.right >= 0], axis=0)
    filled = (shown["nodata"] == 0).any(axis=1) & both & unfolded
    print(len(xy), both.mean(), filled.sum(), ((seen.sum(axis=0) >= 2) & in_model & ~both & unfolded).sum())
