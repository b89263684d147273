"""Which model serves which ground, and seams on least-cost paths."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.ndimage
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from stereomate.parallax.laws import ParallaxLaw
from stereomate.parallax.residual import residual_parallax
from stereomate.raster import Window
from stereomate.rectify import arcs as on_edges
from stereomate.rectify import junctions, seamlines
from stereomate.rectify.disagreement import Disagreement
from stereomate.rectify.layout import StereoModel
from stereomate.rectify.seampolygons import region_polygons, shared_edges
from stereomate.rectify.serving_ground import _absorb_small_regions, everywhere, law_reading_errors

PAIR = StereoModel(0, 1)


def test_reading_errors_are_the_limit_of_the_theory():
    """Equations (9) to (11) with an object of a millimetre, written out in `parallax.residual`."""
    rng = np.random.default_rng(2)
    law = ParallaxLaw("logarithmic", 600.0, 1500.0, 100.0)
    for _ in range(20):
        base = np.array([*rng.uniform([500, -120], [700, 120]), rng.uniform(-30, 30)])
        place, depth = rng.uniform(-400, 400, 2), rng.uniform(1200, 1600)
        slopes = rng.uniform(-0.5, 0.5, 2)
        h = 100.0 + 1500.0 - depth
        x, y = law_reading_errors(base, place, np.array(depth), slopes, np.asarray(law.slope(h)))
        found = residual_parallax([*place, depth], base, slopes, 1e-3, law)
        read = found.stereo_m / 1e-3 / float(law.slope(h))
        assert float(x) == pytest.approx(read[0] - 1.0, abs=2e-5)
        assert float(y) == pytest.approx(read[1], abs=2e-5)


def scene(shape, cost, monkeypatch):
    """Overviews of which only the size is asked, with a given cost of cells."""

    def made(_overviews, _first, _second, window, _scale):
        at = (slice(window.row0, window.row1), slice(window.col0, window.col1))
        nothing = np.zeros((window.rows, window.cols))
        shown = np.ones((window.rows, window.cols), bool)
        return Disagreement(4.0 * cost[at].astype(np.float32), nothing, nothing > 0, shown, shown)

    for module in (seamlines, junctions):
        monkeypatch.setattr(module, "disagreement", made)
    return SimpleNamespace(shape=shape)


def test_a_seam_goes_around_a_building(monkeypatch):
    cost = np.zeros((60, 80))
    cost[20:40, 34:43] = 8.0
    label = np.zeros((60, 80), np.int32)
    label[:, 40:] = 1
    moved = seamlines.improved_regions(scene(label.shape, cost, monkeypatch), (PAIR,) * 2, label, 1.0)
    inside = moved[20:40, 34:43]
    assert (inside == inside[0, 0]).all()
    assert (moved != label).any()
    assert (moved[:10, :36] == 0).all()
    assert (moved[:10, 46:] == 1).all()


def test_a_junction_leaves_a_building(monkeypatch):
    cost = np.zeros((90, 90))
    cost[38:50, 38:50] = 8.0
    label = np.zeros((90, 90), np.int32)
    label[:45, 45:] = 1
    label[45:] = 2
    moved = seamlines.improved_regions(scene(label.shape, cost, monkeypatch), (PAIR,) * 3, label, 1.0)
    inside = moved[38:50, 38:50]
    assert (inside == inside[0, 0]).all()
    assert set(np.unique(moved)) == {0, 1, 2}


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 100_000))
def test_whatever_the_costs_regions_stay_whole(seed):
    """No seam crosses another: each region keeps its core in as many pieces; polygons cover the product."""
    rng = np.random.default_rng(seed)
    rows, cols = 70, 90
    seeds = rng.uniform([8, 8], [rows - 8, cols - 8], (5, 2))
    at = np.stack(np.mgrid[:rows, :cols], -1)[:, :, None]
    label = np.argmin(np.hypot(*(at - seeds).transpose(3, 0, 1, 2)), axis=2).astype(np.int32)
    with pytest.MonkeyPatch.context() as patch:
        overviews = scene((rows, cols), rng.exponential(2.0, (rows, cols)), patch)
        moved = seamlines.improved_regions(overviews, (PAIR,) * 5, label, 1.0)
    assert (np.unique(moved) == np.unique(label)).all()
    for k in np.unique(label):
        assert scipy.ndimage.label(moved == k)[1] <= scipy.ndimage.label(label == k)[1]
        assert ((moved == k) & (label == k)).any()
    polygons = region_polygons(moved, 2, (180, 140))
    assert all(p.is_valid for _, p in polygons)
    assert sum(p.area for _, p in polygons) == pytest.approx(180 * 140, rel=2e-4)
    union = shapely.union_all([p for _, p in polygons], grid_size=1 / 64)
    assert shapely.box(0, 0, 180, 140).difference(union.buffer(0.1)).area == 0.0
    for pair, line in shared_edges(polygons):
        assert pair[0] != pair[1]
        assert line.length > 0.0


def grids_of_labels(rng):
    """A small grid of regions: thin grids, regions of one cell, regions and junctions on the border."""
    rows, cols = rng.integers(1, 36, 2)
    models = int(rng.integers(1, 12))
    kind = rng.integers(4)
    if kind == 0:
        return rng.integers(0, models, (rows, cols)).astype(np.int32)
    seeds = rng.uniform([0, 0], [rows, cols], (models, 2))
    at = np.stack(np.mgrid[:rows, :cols], -1)[:, :, None] + 0.5
    label = np.argmin(np.hypot(*(at - seeds).transpose(3, 0, 1, 2)), axis=2).astype(np.int32)
    if kind == 1:  # Regions of one cell, some on the border.
        single = rng.integers([rows, cols], size=(12, 2))
        label[single[:, 0], single[:, 1]] = rng.integers(0, models, 12)
    if kind == 2:  # Long straight seams whose junctions are some cells apart.
        side = int(rng.integers(2, 6))
        label = np.kron(label[::side, ::side], np.ones((side, side), np.int32))[:rows, :cols]
    return np.ascontiguousarray(label)


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 100_000))
def test_any_grid_of_labels_has_seams(seed):
    """Whatever regions look like: a known model in every cell, and polygons that cover the product."""
    rng = np.random.default_rng(seed)
    label = grids_of_labels(rng)
    rows, cols = label.shape
    with pytest.MonkeyPatch.context() as patch:
        overviews = scene(label.shape, rng.exponential(2.0, label.shape), patch)
        moved = seamlines.improved_regions(overviews, (PAIR,) * 12, label, 1.0)
    assert moved.shape == label.shape
    assert np.isin(moved, label).all()
    polygons = region_polygons(moved, 2, (2 * cols, 2 * rows))
    assert all(p.is_valid for _, p in polygons)
    assert sum(p.area for _, p in polygons) == pytest.approx(4.0 * rows * cols, rel=2e-4)
    assert {model for model, _ in polygons} == set(np.unique(moved).tolist())


@pytest.mark.parametrize("turns", range(4))
def test_two_junctions_as_one_where_a_way_follows_the_edge_of_their_corners(turns, monkeypatch):
    """Seams that turn where they are farthest from the other junction, for either of the two as the first."""
    label = np.zeros((60, 60), np.int32)
    label[30:] = 1  # Junctions at column 27 and 33 of row 30; seams along it turn at 19 and 41.
    label[:, :19] = label[:30, :27] = 2
    label[:, 41:] = label[30:, 33:] = 3
    label = np.ascontiguousarray(np.rot90(label, turns))
    cost = np.random.default_rng(turns).exponential(2.0, label.shape)
    moved = seamlines.improved_regions(scene(label.shape, cost, monkeypatch), (PAIR,) * 4, label, 1.0)
    assert set(np.unique(moved)) == {0, 1, 2, 3}
    for k in range(4):
        assert scipy.ndimage.label(moved == k)[1] == 1


def test_the_ways_to_a_junction_have_cells_on_both_sides():
    """But for the border of the grid, which no seam follows."""
    rng = np.random.default_rng(4)
    for _ in range(50):
        vertices = rng.integers(1, 29, (6, 2))
        window = junctions._window(vertices, 3, vertices[0], (30, 30))
        low, high = np.array([window.col0, window.row0]), np.array([window.col1, window.row1])
        assert (vertices > low).all()
        assert (vertices < high).all()
        assert (low >= 0).all()
        assert (high <= 30).all()


def test_steps_without_cells_on_both_sides_are_closed():
    """Along the border there is no way, and none appears on the other side of the grid."""
    border = np.array([[0, 0], [3, 0], [3, 3], [0, 3], [0, 0]])
    along = [np.linspace(a, b, 4).astype(int) for a, b in itertools.pairwise(border)]
    beyond = np.array([[2, 3], [2, 4], [-1, 4]])
    closed = np.zeros((4, 4), bool)
    graph = on_edges.step_graph(np.ones((3, 3), np.float32), closed[1:, 1:], closed, [*along, beyond])
    assert graph.nnz == 0
    assert np.isinf(on_edges.cheapest(graph, 0)[0][3])


def test_a_line_without_a_way_stays(monkeypatch):
    """Costs that are no numbers leave no way: regions are those of the nearest models."""
    label = np.zeros((40, 40), np.int32)
    label[:20, 20:] = 1
    label[20:] = 2
    overviews = scene(label.shape, np.full(label.shape, np.nan), monkeypatch)
    moved = seamlines.improved_regions(overviews, (PAIR,) * 3, label, 1.0)
    np.testing.assert_array_equal(moved, label)


def test_the_cheapest_way_is_the_cheapest():
    """Against all ways of a tiny grid."""
    rng = np.random.default_rng(1)
    cost = rng.uniform(0.1, 5.0, (3, 3)).astype(np.float32)
    chain = np.array([[1, 0], [1, 1], [1, 2], [1, 3]])
    graph = on_edges.step_graph(cost, np.ones((3, 3), bool), np.ones((4, 4), bool), [chain])
    price, before = on_edges.cheapest(graph, 1)
    dense = graph.toarray()
    dense = np.maximum(dense, dense.T)
    best = np.where(dense > 0, dense, np.inf)
    np.fill_diagonal(best, 0.0)
    for k in range(16):  # Floyd and Warshall
        best = np.minimum(best, best[:, k : k + 1] + best[k])
    np.testing.assert_allclose(price[13], best[1, 13], rtol=1e-6)
    way = on_edges.walk(before, 1, 13, 4)
    assert tuple(way[0]) == (1, 0)
    assert tuple(way[-1]) == (1, 3)
    assert np.abs(np.diff(way, axis=0)).sum(axis=1).tolist() == [1] * (len(way) - 1)


def test_small_regions_are_given_away_and_gaps_are_filled():
    label = np.zeros((20, 20), np.int32)
    label[5:7, 5:7] = 1
    label[:, 15:] = 2
    label[:, 19] = -1
    _absorb_small_regions(label, 9)
    assert set(np.unique(label)) == {-1, 0, 2}
    assert (everywhere(label)[:, 19] == 2).all()


def test_windows_beyond_a_photograph_are_not_valid():
    from stereomate.rectify.overviews import PhotoOverview

    overview = PhotoOverview(
        Window(3, 2, 4, 3),
        np.full((3, 4, 1), 7, np.uint8),
        np.ones((3, 4), bool),
        np.zeros((3, 4, 2), np.uint16),
    )
    pixels, valid = overview.within(Window(5, 0, 6, 4))
    assert valid.sum() == 4
    assert (pixels[valid] == 7).all()
    assert not overview.within(Window(40, 40, 2, 2))[1].any()
