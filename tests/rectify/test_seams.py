"""Seams in the engine: polygons asked on the ground, mixing beside them, balance; records of them."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import shapely
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from rectify_scenes import BASE, FLYING_HEIGHT, make_job

from stereomate.raster import Window
from stereomate.rectify.balance_solution import solve_balance
from stereomate.rectify.engine import rectify_window
from stereomate.rectify.ground import mate_positions, shown_ground
from stereomate.rectify.layout import StereoModel
from stereomate.rectify.radiometry import (
    Balance,
    Samples,
    balance_from_record,
    balance_record,
    design,
)
from stereomate.rectify.seam_steps import measured_seam_steps
from stereomate.rectify.seams import SeamLine, Seams, seams_from_record, seams_record

SEAM = 380.25  # column of the seam in the scene's product


def labels_of(seams: Seams, columns: np.ndarray, rows: int, row0: int = 0) -> np.ndarray:
    columns = np.atleast_2d(columns).astype(np.float32)
    out = np.empty((rows, columns.shape[1]), np.int16)
    seams.labels(Window(0, row0, columns.shape[1], rows), columns, out)
    return out


@settings(deadline=None, max_examples=12)
@given(st.integers(0, 10_000))
def test_labels_are_the_polygons_that_hold_the_points(seed):
    rng = np.random.default_rng(seed)
    cells = shapely.get_parts(shapely.voronoi_polygons(shapely.multipoints(rng.uniform(0, 60, (7, 2)))))
    hole = shapely.box(20.3, 20.3, 33.3, 31.3)
    polygons = [
        (k, part)
        for k, cell in enumerate(cells)
        for part in shapely.get_parts(shapely.intersection(cell, shapely.box(0, 0, 60, 50)))
        if part.area > 0
    ]
    polygons = [
        (k, part) for k, cell in polygons for part in shapely.get_parts(shapely.difference(cell, hole))
    ]
    polygons.append((99, hole.buffer(-4.0, join_style="mitre")))
    columns = np.sort(rng.uniform(-2, 62, 70)).astype(np.float32)
    found = labels_of(Seams(tuple(polygons)), columns, 50)
    for row in range(0, 50, 7):
        for col, label in zip(columns, found[row], strict=True):
            point = shapely.Point(float(col), row + 0.5)
            holders = [k for k, p in polygons if p.distance(point) < 1e-4]
            inside = [k for k, p in polygons if p.contains(point) and p.exterior.distance(point) > 1e-4]
            assert label in (inside or holders or [-1])


def two_models(folder, **changes):
    """A job with a model and the same one exchanged: their photographs differ in both eyes."""
    job = make_job(folder, **changes)
    exchanged = StereoModel(1, 0, -BASE, 0.0, -6.0, FLYING_HEIGHT, 0.3)
    cols, rows = job.grid.size
    seams = Seams(
        ((0, shapely.box(0, 0, SEAM, rows)), (1, shapely.box(SEAM, 0, cols, rows))),
        (SeamLine((0, 1), ((SEAM, 0.0, 6.0), (SEAM, float(rows), 6.0))),),
    )
    return replace(job, models=(*job.models, exchanged), seams=seams)


def test_one_ground_line_for_orthophoto_and_stereomate(tmp_path):
    job = two_models(tmp_path)
    window = Window(250, 100, 300, 160)
    ortho, mate = rectify_window(job, window)
    left = ortho.photograph[ortho.valid != 0]
    assert set(np.unique(left)) == {1, 2}
    cols = np.arange(window.cols) + 0.5 + window.col0
    expected = np.where(cols < SEAM, 1, 2)
    assert (ortho.photograph == np.where(ortho.valid != 0, expected, 0)).all()
    ground = shown_ground(job, window)
    shown, _, _ = mate_positions(job, window, ground)
    there = mate.valid != 0
    right = np.where(shown + window.col0 < SEAM, 2, 1)
    assert there.mean() > 0.9
    assert (mate.photograph[there] == right[there]).all()
    # it lies at the ground line less q(h), pixels to the left of it
    change = np.argmax(mate.photograph == 1, axis=1) + window.col0
    q = job.law.q(np.array([400.0, 800.0])) / job.grid.gsd
    assert (change < SEAM - q[0]).all()
    assert (change > SEAM - q[1]).all()


def test_chunks_make_what_the_whole_makes(tmp_path):
    flat = ((0.05, 0.01, -0.02, -0.1, -0.12, 0.02),) * 3
    other = ((-0.03, 0.02, 0.01, -0.1, -0.12, 0.02),) * 3
    job = replace(two_models(tmp_path), balance=Balance((flat, other)))
    whole = [
        (np.array(part.pixels, int), np.array(part.photograph))
        for part in rectify_window(job, Window(320, 64, 128, 128))
    ]
    for col in (320, 384):
        for row in (64, 128):
            parts = rectify_window(job, Window(col, row, 64, 64))
            cut = (slice(row - 64, row), slice(col - 320, col - 256))
            for part, (pixels, photograph) in zip(parts, whole, strict=True):
                np.testing.assert_array_equal(part.photograph, photograph[cut])
                # positions in the stereomate are rounded to 32 bits from the first column of the window
                difference = np.abs(part.pixels - pixels[cut])
                assert difference.max() <= (0 if part is parts[0] else 2)
                assert (difference > 0).mean() < 1e-3


def test_pixels_beside_a_seam_are_weighted_means(tmp_path):
    job = two_models(tmp_path)
    window = Window(360, 100, 40, 30)
    mixed = np.array(rectify_window(job, window)[0].pixels, float)
    alone = [
        np.array(rectify_window(replace(job, models=(m,), seams=None), window)[0].pixels, float)
        for m in job.models
    ]
    d = np.abs(np.arange(window.cols) + 0.5 + window.col0 - SEAM) / 6.0
    share = np.where(d < 1.0, 0.5 * (1.0 - d * d * (3.0 - 2.0 * d)), 0.0)[None, :, None]
    first = (np.arange(window.cols) + 0.5 + window.col0 < SEAM)[None, :, None]
    own, other = np.where(first, alone[0], alone[1]), np.where(first, alone[1], alone[0])
    assert np.abs(mixed - ((1.0 - share) * own + share * other)).max() <= 0.5 + 1e-3
    assert np.abs(own - other).mean() > 20.0  # two photographs of noise


def test_both_sides_of_a_levelled_seam_go_half_the_way(tmp_path):
    """By its logarithm, falling off to the reach; nothing where both are mixed half and half."""
    job = two_models(tmp_path)
    rows = float(job.grid.size[1])
    levels = ((12.0, 0.2, 0.2, 0.2, 0.0, 0.0, 0.0),) * 2
    for width in (0.0, 6.0):
        ends = ((SEAM, 0.0, width), (SEAM, rows, width))
        plain, levelled = (
            replace(job, seams=Seams(job.seams.polygons, (SeamLine((0, 1), ends, made),)))
            for made in ((), levels)
        )
        window = Window(360, 100, 40, 30)
        before, after = (np.array(rectify_window(j, window)[0].pixels, float) for j in (plain, levelled))
        mates = [np.array(rectify_window(j, window)[1].pixels) for j in (plain, levelled)]
        np.testing.assert_array_equal(*mates)  # its logarithms are 0
        signed = np.arange(window.cols) + 0.5 + window.col0 - SEAM
        d, m = np.abs(signed) / 12.0, np.abs(signed) / 6.0
        half = np.where(d < 1.0, 0.5 * (1.0 - d * d * (3.0 - 2.0 * d)), 0.0) * 0.2
        mixed = np.where((m < 1.0) & (width > 0.0), 0.5 * (1.0 - m * m * (3.0 - 2.0 * m)), 0.0)
        factor = np.exp(np.where(signed < 0.0, half, -half) * (1.0 - 2.0 * mixed))[None, :, None]
        dark = before < 200.0  # nothing is cut off at 255
        np.testing.assert_allclose(after[dark], (before * factor)[dark], atol=0.51)
        assert np.abs(after - before).max() > 3.0
    record = json.loads(json.dumps(seams_record(levelled.seams)))
    assert seams_from_record(record).lines == levelled.seams.lines


def test_balance_multiplies_by_its_model(tmp_path):
    job = make_job(tmp_path)
    coefficients = tuple((0.1 + 0.02 * b, 0.04, -0.06, -0.2, -0.15, 0.05) for b in range(3))
    window = Window(100, 100, 50, 40)
    plain = np.array(rectify_window(job, window)[0].pixels, float)
    made = np.array(
        rectify_window(replace(job, balance=Balance((coefficients, coefficients))), window)[0].pixels, float
    )
    inside = (plain > 20) & (plain < 200)
    ratio = np.median((made / np.maximum(plain, 1.0))[inside])
    # the window lies in the left photograph near this place; gains differ by band in steps of 2 %
    by_band = [np.median((made[..., b] / np.maximum(plain[..., b], 1))[inside[..., b]]) for b in range(3)]
    assert np.allclose(np.diff(np.log(by_band)), -0.02, atol=0.004)
    assert 0.7 < ratio < 1.1


def test_floats_are_not_rounded_or_limited():
    from stereomate.rectify.kernels.seams import balance

    pixels = np.full((2, 2, 1), 0.3, np.float32)
    at = np.array([[1.0, 5.0], [1.0, 5.0]], np.float32)
    table = np.full((3, 3, 1), 2.5, np.float32)
    balance(pixels, np.array([[1, 1], [1, 0]], np.uint8), at, at, 0.0, 0.0, table, 4.0, 4.0, 1.0, 0.0)
    assert pixels[..., 0] == pytest.approx(np.array([[0.75, 0.75], [0.75, 0.3]]))


def test_gains_gradients_and_vignetting_are_found_again():
    """Planted light on photographs of a strip flown to and fro; 3 % of the ground differs wildly."""
    rng = np.random.default_rng(4)
    strips, count = 3, 6
    planted = np.column_stack([0.1 * rng.standard_normal(18), *(0.02 * rng.standard_normal((2, 18)))])
    planted -= planted.mean(axis=0)
    shared = np.array([-0.15, -0.22, 0.03])
    ground = rng.uniform([0, 0], [4.0, 2.6], (6000, 2))
    light = np.log(rng.uniform(40, 150, 6000))
    places, numbers, positions, values = [], [], [], []
    for p in range(strips * count):
        strip, k = divmod(p, count)
        turn = 1.0 if strip % 2 == 0 else -1.0
        at = turn * (ground - [0.5 + 0.6 * k, 0.5 + 0.8 * strip])
        inside = (np.abs(at) < [0.8, 0.6]).all(axis=1)
        terms = design(at)
        logs = light + terms @ np.concatenate([planted[p], shared]) + 0.01 * rng.standard_normal(6000)
        logs[rng.random(6000) < 0.03] += 0.5
        places.append(np.flatnonzero(inside))
        numbers.append(np.full(inside.sum(), p))
        positions.append(at[inside])
        values.append(np.exp(logs[inside])[:, None])
    place, number, position, value = map(np.concatenate, (places, numbers, positions, values))
    order = np.lexsort((number, place))
    samples = Samples(
        place[order], ground[place[order]], number[order], position[order], value[order],
        np.full(value.shape, 0.01),
    )  # fmt: skip
    size = [(800, 600)] * 18
    balance, summary = solve_balance(samples, [0] * 18, size)
    found = np.array(balance.coefficients)[:, 0]
    assert summary.before[0] > 0.07
    assert summary.after[0] < 0.012
    assert summary.sigma[0] == pytest.approx(0.01 * np.sqrt(2), rel=0.15)
    # what a photograph is multiplied by, against the truth, over its whole area
    t = np.stack(np.meshgrid(np.linspace(-0.8, 0.8, 9), np.linspace(-0.6, 0.6, 7)), -1)
    wrong = np.array([design(t) @ (found[p] - np.concatenate([planted[p], shared])) for p in range(18)])
    assert np.sqrt(np.mean(np.square(wrong - wrong.mean()))) < 0.012
    # photographs of another camera have a vignetting of their own
    two, _ = solve_balance(samples, [0] * 9 + [1] * 9, size)
    first, last = (np.array(two.coefficients)[p, 0, 3:] for p in (0, -1))
    assert (first != last).all()


def test_without_overlaps_nothing_changes():
    none, two = np.empty(0, np.int64), np.empty((0, 2))
    nothing = Samples(none, two, none, two, np.empty((0, 3)), np.empty((0, 3)))
    balance, summary = solve_balance(nothing, [0, 0], [(800, 600)] * 2)
    assert not np.array(balance.coefficients).any()
    assert not np.array(balance.local).any()
    assert summary.samples == 0


def test_records_give_seams_and_balance_back(tmp_path):
    job = two_models(tmp_path)
    record = json.loads(json.dumps(seams_record(job.seams)))
    again = seams_from_record(record)
    assert again.lines == job.seams.lines
    assert [k for k, _ in again.polygons] == [0, 1]
    for (_, a), (_, b) in zip(again.polygons, job.seams.polygons, strict=True):
        assert a.equals_exact(b, 0.0)
    balance = Balance((((0.1, 1 / 3, -0.2, 0.3, 0.1, -0.4),),), ((tuple(0.01 * k for k in range(81)),),))
    assert balance_from_record(json.loads(json.dumps(balance_record(balance)))) == balance
    assert seams_from_record(None) is None
    assert balance_from_record(None) is None


def test_steps_across_seams_are_told_from_those_of_the_ground(tmp_path):
    """A step of 9 planted along a cut seam, none along a mixed one, on ground that has steps of its own."""
    rng = np.random.default_rng(2)
    rows, cols, at = 400, 200, 100
    own = np.cumsum(rng.choice([-2.0, 2.0], cols))
    ortho = 100.0 + own[None, :, None] + rng.normal(0.0, 1.0, (rows, cols, 3))
    ortho[:200, at:] += 9.0
    lineage = np.where(np.arange(cols) < at, 1, 2)[None, :, None] * np.ones((rows, 1, 2))
    tifffile.imwrite(tmp_path / "ortho.tif", np.clip(ortho, 0, 255).astype(np.uint8), photometric="rgb")
    tifffile.imwrite(
        tmp_path / "lineage.tif", lineage.astype(np.uint16), photometric="minisblack", planarconfig="contig"
    )
    line = [(float(at), float(y), 0.0 if y < 200 else 6.0) for y in range(0, rows, 4)]
    heights = SimpleNamespace(heights_at=lambda xy: np.zeros(len(xy)))
    grid = SimpleNamespace(map_from_pixel=lambda at: at, gsd=1.0)
    law = SimpleNamespace(q=lambda h: np.zeros(len(h)))
    job = SimpleNamespace(
        seams=Seams((), (SeamLine((0, 1), tuple(line)),)), law=law, heights=heights, grid=grid
    )
    found = measured_seam_steps(job, tmp_path / "ortho.tif", None, tmp_path / "lineage.tif")
    mixed, cut = found
    assert [(s.product, s.mixed) for s in found] == [("orthophoto", True), ("orthophoto", False)]
    assert min(mixed.places, cut.places) >= 8
    planted = 0.5 * (own[at] + own[at + 1] - own[at - 1] - own[at - 2])
    assert mixed.across == pytest.approx(abs(planted), abs=0.8)
    assert cut.across == pytest.approx(abs(planted + 9.0), abs=0.8)
    beside = [0.5 * abs(own[c] + own[c + 1] - own[c - 1] - own[c - 2]) for c in (at - 13, at + 13)]
    assert min(beside) - 0.8 < cut.beside < max(beside) + 0.8
    assert cut.net == pytest.approx(cut.across - cut.beside)
