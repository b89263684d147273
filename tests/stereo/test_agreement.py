"""Measured agreement: windows that cover, medians with an honest error."""

from __future__ import annotations

import numpy as np
import pytest

from stereomate.raster import Window
from stereomate.stereo.agreement import sample_windows, statistics


@pytest.mark.parametrize("size", [(1299, 1398), (512, 512), (5, 2000), (513, 1)])
def test_windows_cover_the_product_once(size):
    cover = np.zeros(size[::-1], int)
    for w in sample_windows(size, 512):
        assert max(w.cols, w.rows) <= 512
        cover[w.row0 : w.row1, w.col0 : w.col1] += 1
    assert (cover == 1).all()


def test_the_first_windows_are_spread_over_the_product():
    first = sample_windows((10_240, 10_240), 512)[:12]
    assert first[0] == Window(0, 0, 512, 512)
    quadrants = {(w.col0 >= 5120, w.row0 >= 5120) for w in first}
    assert len(quadrants) == 4


def correlated(rng, blocks: int, points: int, of_block: float, of_point: float):
    """Residuals (n, 2) whose errors have a part that all points of a 256 px block share."""
    at = rng.uniform(0, 256, (blocks, points, 2)) + 256 * np.arange(blocks)[:, None, None]
    shared = of_block * rng.standard_normal((blocks, 1, 2))
    residuals = shared + of_point * rng.standard_normal((blocks, points, 2))
    return residuals.reshape(-1, 2), at.reshape(-1, 2)


@pytest.mark.parametrize("of_block", [0.0, 0.2])
def test_error_of_the_median_is_that_of_many_samples(of_block):
    rng = np.random.default_rng(3)
    found = [statistics(*correlated(rng, 40, 25, of_block, 0.2)) for _ in range(30)]
    scatter = np.std([s.median_px for s in found])
    stated = np.mean([s.standard_error_px for s in found])
    assert stated == pytest.approx(scatter, rel=0.3)
    if of_block:
        # What independence would have said is several times too small.
        naive = 1.2533 * np.mean([s.nmad_px for s in found]) / np.sqrt(40 * 25)
        assert scatter > 2.5 * naive


def test_too_few_points_have_no_stated_error():
    s = statistics(np.zeros((5, 2)), np.arange(10.0).reshape(5, 2))
    assert s.count == 5
    assert np.isnan(s.standard_error_px).all()
    assert np.isnan(statistics(np.empty((0, 2)), np.empty((0, 2))).median_px).all()
