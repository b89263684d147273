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
from stereomate.stereo.exact import ground_of_stereomate
from stereomate.stereo.lineage import LineageRule
from stereomate.stereo.measure import measure
from stereomate.stereo.measured import Flag
from stereomate.stereo.surface import JobSurface
from stereomate.synthetic.options import SurveyOptions
from stereomate.synthetic.survey import make_survey
from stereomate.terrain.model import HeightModel
from stereomate.tiles import Threads, TilePlan, map_items

# Both centres stand 250 m from a wall of 120 m and 1000 m above the ground: its shadow is 36 m wide.
SHADOW = 265.0 * 120.0 / 880.0
GROUND_OF_TOWN, HOUSES = 300.0, 30.0


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
    plan = TilePlan(size=job.grid.size, block=256, chunk_tiles=1)
    task = ChunkTask(job, plan, product_profile(job))
    chunks = list(plan.chunks)
    there = map_items(task, chunks, Threads(1))
    again = map_items(task, chunks[::-1], Threads(2))[::-1]
    assert [{k: bytes(v) for k, v in blobs.items()} for blobs in there] == [
        {k: bytes(v) for k, v in blobs.items()} for blobs in again
    ]


def is_house(x, y):
    """A town of square blocks, streets of 14 m between them."""
    return (np.abs(np.mod(x, 30.0) - 15.0) < 8.0) & (np.abs(np.mod(y, 30.0) - 15.0) < 8.0)


@pytest.fixture(scope="module")
def town():
    """Jobs over a surface model of high blocks on a plain, with wide angles in two strips, and its origin."""
    survey = make_survey(
        SurveyOptions(
            seed=11, strips=2, photos_per_strip=4, size_px=(400, 300), gsd_m=0.5, flying_height_m=110.0,
            pixel_pitch_mm=0.12, relief_m=1.0, terrain_step_m=2.0, buildings=0, trees=0, control_points=0,
            check_points=0, forward_overlap=0.7, side_overlap=0.5,
        )
    )  # fmt: skip
    plain = HeightModel.from_array(survey.world.heights, survey.world.affine, survey.world.frame)
    west, north = np.array(plain.affine)[[2, 5]]
    col, row = np.meshgrid(np.arange(2 * plain.shape[1]) + 0.5, np.arange(2 * plain.shape[0]) + 0.5)
    surface = np.where(is_house(col, -row), GROUND_OF_TOWN + HOUSES, GROUND_OF_TOWN)
    affine = (1.0, 0.0, west, 0.0, -1.0, north)
    heights = HeightModel.from_array(surface, affine, plain.frame)
    coverage = survey_coverage(survey.survey, heights)
    jobs = {
        hidden: plan_products(
            survey.survey, heights, coverage, RectifyOptions(gsd=0.5, hidden=hidden), Request()
        )[0]
        for hidden in ("nodata", "fill")
    }
    return jobs, np.array([west, north])


def seen_in_town(job, origin, points, grown):
    """Per photograph whether points are seen between the blocks, grown by so many metres; and on it."""
    seen, held = [], []
    for photograph, centre in zip(job.photographs, job.centres_map, strict=True):
        at = tangent_from_map(job.tangent, job.frame, points)
        pixel, _ = photograph.camera.image_from_camera(photograph.orientation.camera_from_tangent(at))
        inside = ((pixel > grown) & (pixel < np.array(photograph.camera.size_px) - grown)).all(axis=1)
        # up to the roofs, in steps of 25 cm
        rise = np.linspace(0.0, HOUSES, 120)[1:]
        way = points[:, None, :2] - origin
        way = way + (rise[:, None] / (centre[2] - points[0, 2])) * (centre[:2] - points[:, :2])[:, None]
        hidden = [
            is_house(way[..., 0] + dx, way[..., 1] + dy) for dx in (-grown, grown) for dy in (-grown, grown)
        ]
        hidden = np.any(hidden, axis=0) if grown > 0.0 else np.all(hidden, axis=0)
        held.append(inside)
        seen.append(inside & ~hidden.any(axis=1))
    return np.array(seen), np.array(held)


@pytest.mark.slow
def test_filled_ground_of_a_town_is_seen_by_both_photographs(town):
    """Against rays past upright walls, stepped through here."""
    jobs, origin = town
    job = jobs["fill"]
    rng = np.random.default_rng(1)
    xy = job.grid.map_from_pixel(rng.uniform(0.1, 0.9, (2_000, 2)) * job.grid.size)
    corners = [(-1.5, -1.5), (-1.5, 1.5), (1.5, -1.5), (1.5, 1.5)]
    xy = xy[~np.any([is_house(*(xy - origin + d).T) for d in corners], axis=0)]
    points = np.column_stack([xy, np.full(len(xy), GROUND_OF_TOWN)])
    # the surface model's walls lean over a metre: what they leave open is not asked
    (seen, _), (surely, held_by) = (seen_in_town(job, origin, points, grown) for grown in (-1.0, 1.5))
    certain = (seen == surely).all(axis=0)
    xy, points, seen, held_by = xy[certain], points[certain], seen[:, certain], held_by[:, certain]
    uv = job.grid.uv_from_map(xy)
    mate = job.grid.map_from_uv(uv - np.column_stack([job.law.q(points[:, 2]), np.zeros(len(xy))]))
    shown = {}
    for hidden, one in jobs.items():
        rule = LineageRule(one)
        shown[hidden] = np.column_stack(
            [rule.photographs(side, one.grid.pixel_from_map(at)) for side, at in enumerate((xy, mate))]
        )
    left, right = shown["fill"].T - 1
    # where the stereomate folds it shows other ground: roofs
    uvh = ground_of_stereomate(JobSurface(job), job.law, job.grid.uv_from_map(mate)).uvh
    unfolded = np.abs(uvh[:, 2] - GROUND_OF_TOWN) < 0.1
    index = np.arange(len(xy))
    assert seen[left, index][left >= 0].all()
    both = (left >= 0) & (right >= 0) & unfolded
    assert seen[right, index][both].all()
    assert (left != right)[both].all()
    # whatever two photographs see and a model holds is there for both eyes
    models = [m for m in job.models if m.right >= 0]
    held = np.any([held_by[m.left] & held_by[m.right] for m in models], axis=0)
    assert both[unfolded & held & (seen.sum(axis=0) >= 2)].all()
    filled = (shown["nodata"] == 0).any(axis=1) & both
    assert filled.sum() > 15
    found = measure(job, LineageRule(job), xy[filled], mate[filled])
    assert not (found.flags & int(Flag.NO_BASE)).any()
    assert np.abs(found.points - points[filled]).max() < 1e-3
