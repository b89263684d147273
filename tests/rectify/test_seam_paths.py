"""Which model serves which ground, and seams on least-cost paths."""

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
from stereomate.rectify.seampolygons import region_polygons, shared_edges
from stereomate.rectify.serving_ground import _absorb_small_regions, everywhere, law_reading_errors


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
    moved = seamlines.improved_regions(scene(label.shape, cost, monkeypatch), (None, None), label, 1.0)
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
    moved = seamlines.improved_regions(scene(label.shape, cost, monkeypatch), (None,) * 3, label, 1.0)
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
        moved = seamlines.improved_regions(overviews, (None,) * 5, label, 1.0)
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
