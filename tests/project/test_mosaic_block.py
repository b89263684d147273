"""Four strips of eight photographs, flown to and fro, with planted differences of light: no break is seen."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
import shapely

from stereomate.project import load
from stereomate.project.mosaic import edited_polygons, write_seam_file
from stereomate.project.run import RunOptions, plan
from stereomate.raster import Window
from stereomate.rectify.engine import orthophoto_part, rectify_window, stereomate_part
from stereomate.rectify.ground import ground_of, heights_of
from stereomate.rectify.mosaic import plan_mosaics
from stereomate.rectify.overviews import _BlockTask, coarse_job
from stereomate.rectify.radiometry import TABLE_NODES
from stereomate.rectify.seams import seams_record
from stereomate.stereo.lineage import LineageRule
from stereomate.stereo.measure import measure
from stereomate.stereo.measured import Flag
from stereomate.synthetic.files import write_survey
from stereomate.synthetic.options import SurveyOptions
from stereomate.synthetic.render import light_of_photograph
from stereomate.synthetic.survey import make_survey
from stereomate.tiles import Threads

pytestmark = pytest.mark.slow

BLOCK = SurveyOptions(
    seed=5,
    strips=4,
    photos_per_strip=8,
    size_px=(280, 210),
    gsd_m=0.5,
    flying_height_m=210.0,
    pixel_pitch_mm=0.1,
    relief_m=30.0,
    terrain_step_m=3.0,
    buildings=24,
    trees=120,
    control_points=0,
    check_points=0,
    forward_overlap=0.65,
    side_overlap=0.35,
    exposure_sigma=0.06,
    colour_sigma=0.03,
    gradient_sigma=0.04,
    vignetting=0.25,
)


@pytest.fixture(scope="module")
def survey():
    return make_survey(BLOCK)


@pytest.fixture(scope="module")
def written(survey, tmp_path_factory):
    return write_survey(survey, tmp_path_factory.mktemp("block"), executor=Threads(2))


@pytest.fixture(scope="module")
def plain(written):
    """The job without seams and balance."""
    (job,) = plan(load(written.project), RunOptions())[1]
    return job


@pytest.fixture(scope="module")
def planned(plain):
    ((job, summary),) = plan_mosaics([plain])
    return job, summary


def whole(job):
    return [
        (np.array(p.pixels, float), np.array(p.valid) != 0, np.array(p.photograph, int))
        for p in rectify_window(job, Window(0, 0, *job.grid.size))
    ]


@pytest.fixture(scope="module")
def before(plain):
    """Products without seams and balance."""
    return whole(plain)


@pytest.fixture(scope="module")
def products(planned):
    return whole(planned[0])


def steps_across(seams, pixels, valid):
    """Mean steps across lines of pixels, signed along segments of 16 pixels so that texture falls out.

    Parameters
    ----------
    seams : (rows, cols) int
        Lines are where this changes.
    """
    found = {}
    for axis in (0, 1):
        p, v, f = (np.moveaxis(a, axis, 0) for a in (pixels, valid, seams))
        a, b = f[1:-2], f[2:-1]
        line = (a != b) & v[:-3] & v[1:-2] & v[2:-1] & v[3:] & (f[:-3] == a) & (f[3:] == b)
        step = 0.5 * (p[2:-1] + p[3:] - p[1:-2] - p[:-3])
        for i, j in np.argwhere(line):
            first, last = sorted((a[i, j], b[i, j]))
            sign = 1.0 if a[i, j] == first else -1.0
            found.setdefault((first, last, i // 16, j // 16, axis), []).append(sign * step[i, j])
    return np.median([np.abs(np.mean(s, axis=0)).max() for s in found.values() if len(s) >= 8])


def seen_steps(products):
    """Median step across seams less that across the same lines moved by 13 pixels, where there is no seam."""
    seen = []
    for pixels, valid, photograph in products:
        moved = np.roll(photograph, (13, 13), (0, 1))
        inner = valid & (moved > 0)
        seen.append(steps_across(photograph, pixels, inner) - steps_across(moved, pixels, inner))
    return np.array(seen)


def test_no_step_is_seen_across_seams(before, products):
    """Beyond what the texture of the ground does anyway."""
    assert seen_steps(before).min() > 4.0
    assert seen_steps(products).max() < 0.5


def test_both_sides_of_a_seam_are_equally_bright(plain, planned, survey):
    """The two photographs at the same pixels: under 2 digital numbers in the median, in both products."""
    job, summary = planned
    steps = {True: [], False: []}
    for models, at in seam_places(job, survey, 40):
        for balanced in steps:
            used = job if balanced else plain
            pairs = pictures_of_both(used, job, models, at, 9)
            for a, b in pairs:
                steps[balanced].append(np.abs((a - b).mean(axis=(0, 1))).max())
    assert len(steps[True]) > 40
    assert np.median(steps[False]) > 8.0
    assert np.median(steps[True]) < 2.0
    assert np.percentile(steps[True], 90) < 4.0
    assert max(summary.balance.after) < 0.2 * min(summary.balance.before)
    assert summary.mixed_length > 0.5 * summary.seam_length


def test_balance_is_the_light_that_was_planted(planned):
    """What photographs are multiplied by, times their light, is one number over the block, to 3 %."""
    job, _ = planned
    cols, rows = BLOCK.size_px
    at = np.stack(
        np.meshgrid(np.linspace(0, rows, TABLE_NODES), np.linspace(0, cols, TABLE_NODES), indexing="ij"), -1
    )
    inside = tuple(np.clip(at.astype(int), 0, [rows - 1, cols - 1]).transpose(2, 0, 1))
    products = []
    for k, photograph in enumerate(job.photographs):
        number = (int(photograph.name[5]) - 1) * BLOCK.photos_per_strip + int(photograph.name[7:]) - 1
        light = light_of_photograph(BLOCK, BLOCK.size_px, number, 0, rows)
        products.append(np.log(light[inside] * job.balance.table(k, BLOCK.size_px)))
    assert np.std(np.array(products), axis=(0, 1, 2)).max() < 0.03
    lights = [light_of_photograph(BLOCK, BLOCK.size_px, n, 0, rows)[::10, ::10] for n in range(32)]
    assert np.std(np.log(lights)) > 0.09


def seam_places(job, survey, count, reach=16):
    """Places on seams of models with both eyes, on open ground all around, with the models on both sides."""
    found = []
    for line in job.seams.lines:
        if min(job.models[m].right for m in line.models) < 0:
            continue
        points = np.array(line.points)
        for at in points[np.linspace(0, len(points) - 1, 6).astype(int)][1:-1, :2]:
            offsets = np.array([(x, y) for x in (-reach, 0, reach) for y in (-reach, 0, reach)])
            around = job.grid.map_from_pixel(at + offsets)
            if survey.world.is_clear(around).all():
                found.append((line.models, at))
    step = max(1, len(found) // count)
    return found[::step]


def pictures_of_both(used, job, models, at, half):
    """Pictures around a place by both models at a seam: of the orthophoto, and of the stereomate."""
    alone = [replace(used, models=(job.models[m],), seams=None) for m in models]
    edge = 2 * half + 1
    window = Window(int(at[0]) - half, int(at[1]) - half, edge, edge)
    heights = heights_of(job, ground_of(job, window), "test heights")
    q = float(job.law.q(float(heights[half, half]))) / job.grid.gsd
    shown = Window(window.col0 - round(q), window.row0, edge, edge)
    pairs = []
    for side in ("left", "right"):
        parts = []
        for single in alone:
            part = (
                orthophoto_part(single, window, "left") if side == "left" else stereomate_part(single, shown)
            )
            if part.valid.all():
                parts.append(np.array(part.pixels, float))
        if len(parts) == 2:
            pairs.append(tuple(parts))
    return pairs


def shift_between(a, b, half=10):
    """Shift of `b` against `a` in pixels by normalised correlation around the middle, sub-pixel."""
    grey = [part.mean(axis=2) for part in (a, b)]
    middle = grey[0].shape[0] // 2

    def cut(image, dx, dy):
        rows = slice(middle - half + dy, middle + half + 1 + dy)
        return image[rows, middle - half + dx : middle + half + 1 + dx].ravel()

    def correlation(dx, dy):
        return np.corrcoef(cut(grey[0], 0, 0), cut(grey[1], dx, dy))[0, 1]

    best = {(dx, dy): correlation(dx, dy) for dx in range(-2, 3) for dy in range(-2, 3)}
    dx, dy = max(best, key=best.get)
    if abs(dx) == 2 or abs(dy) == 2 or best[dx, dy] < 0.6:
        return None

    def vertex(before, at, after):
        return 0.5 * (before - after) / (before - 2.0 * at + after)

    return (
        dx + vertex(best[dx - 1, dy], best[dx, dy], best[dx + 1, dy]),
        dy + vertex(best[dx, dy - 1], best[dx, dy], best[dx, dy + 1]),
    )


def test_no_break_in_parallax_on_open_ground(planned, survey):
    """Both models at a seam show open ground at the same place, in both products: under 0.3 px in x and y."""
    job, _ = planned
    shifts = []
    for models, at in seam_places(job, survey, 60):
        shifts += [shift_between(a, b) for a, b in pictures_of_both(job, job, models, at, 20)]
    found = np.array([s for s in shifts if s is not None])
    assert len(found) > 40
    assert len(found) > 0.9 * len(shifts)
    assert np.abs(np.median(found, axis=0)).max() < 0.05
    assert np.median(np.abs(found)) < 0.1
    assert np.percentile(np.abs(found), 95) < 0.3


def test_seams_keep_out_of_buildings(planned, before, survey):
    """Length of seams on true roof outlines, against that where the nearest model serves."""
    job, _ = planned
    houses = [house.corners()[:, :2] for house in survey.world.buildings]
    roofs = shapely.union_all([shapely.convex_hull(shapely.multipoints(house)) for house in houses])
    _, valid, photograph = before[0]
    seam = (photograph[:, 1:] != photograph[:, :-1]) & valid[:, 1:] & valid[:, :-1]
    row, col = np.nonzero(seam)
    xy = job.grid.map_from_pixel(np.column_stack([col + 1.0, row + 0.5]))
    nearest = shapely.contains_xy(roofs, xy[:, 0], xy[:, 1]).sum() * job.grid.gsd
    lines = [
        shapely.transform(polygon.boundary, job.grid.map_from_pixel) for _, polygon in job.seams.polygons
    ]
    assert nearest > 20.0
    assert shapely.union_all(lines).intersection(roofs).length < 0.1 * nearest


def test_lineage_is_that_of_both_products_own_pixels(planned, products):
    job, _ = planned
    rule = LineageRule(job)
    rng = np.random.default_rng(1)
    pixels = rng.uniform((0, 0), job.grid.size, (3000, 2))
    col, row = pixels.astype(int).T
    for side, (_, valid, photograph) in enumerate(products):
        there = valid[row, col]
        found = rule.photographs(side, pixels)
        assert (found[there] == photograph[row, col][there]).all()
        assert there.sum() > 1500


def test_one_photograph_in_both_eyes_is_refused(planned, products):
    """An object at a seam may come from one photograph in both products: there is nothing to intersect."""
    job, _ = planned
    (_, left_valid, left), (_, right_valid, right) = products
    col, row, other = [], [], []
    for r in range(20, left.shape[0] - 20, 3):
        for c in np.flatnonzero(left_valid[r]):
            q = 6
            if c - q >= 0 and right_valid[r, c - q] and left[r, c] == right[r, c - q]:
                col.append(c), row.append(r), other.append(c - q)
    assert len(col) > 5
    left_xy = job.grid.map_from_pixel(np.column_stack([col, row]) + 0.5)
    right_xy = job.grid.map_from_pixel(np.column_stack([other, row]) + 0.5)
    # with measurements elsewhere, as a person would have them
    found = measure(job, LineageRule(job), left_xy, right_xy)
    assert (found.flags & int(Flag.NO_BASE)).all()
    assert not found.measured.any()
    assert np.isnan(found.heights).all()


def test_threads_and_processes_find_the_same(plain, planned):
    ((again, summary),) = plan_mosaics([plain], Threads(2))
    assert seams_record(again.seams) == seams_record(planned[0].seams)
    assert again.balance == planned[0].balance
    assert summary == planned[1]
    task = pickle.loads(pickle.dumps(_BlockTask(coarse_job(plain)[0])))
    heights, found = task(Window(0, 0, 64, 64))
    assert heights.shape == (64, 64)
    assert isinstance(found, list)


def test_seams_written_and_read_back_are_the_same(planned, plain, tmp_path):
    job, _ = planned
    path = tmp_path / "seams.gpkg"
    assert write_seam_file(path, [job])
    first = path.read_bytes()
    assert write_seam_file(path, [job])
    assert path.read_bytes() == first
    polygons = edited_polygons(path, [plain])
    ((again, _),) = plan_mosaics([plain], None, polygons)
    assert seams_record(again.seams) == seams_record(job.seams)
