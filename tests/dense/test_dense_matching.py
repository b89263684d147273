"""The dense matcher on textures whose parallaxes are known."""

from __future__ import annotations

import numpy as np
import pytest

from stereomate.dense.matching import DenseOptions, match_dense
from stereomate.dense.semiglobal import SemiglobalOptions, semiglobal_parallax
from stereomate.errors import InputError

NOISE = 2.0


def texture(x, y, seed=3):
    """A smooth random function of position, with power down to 2.5 px."""
    rng = np.random.default_rng(seed)
    out = np.zeros(np.broadcast(x, y).shape)
    for _ in range(160):
        k = rng.uniform(0.02, 0.2)
        turn, phase = rng.uniform(0.0, 2.0 * np.pi, 2)
        out += np.cos(2.0 * np.pi * k * (x * np.cos(turn) + y * np.sin(turn)) + phase)
    return 128.0 + 4.0 * out


def pair(parallax, row_parallax=0.0, shape=(120, 200), noise=NOISE, seed=1):
    """Left and right image of a surface with parallaxes that are a function of right (x, y)."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]].astype(float)
    left = texture(x, y)
    right = 1.1 * texture(x + parallax(x, y), y + row_parallax) - 9.0
    return [(im + noise * rng.standard_normal(shape)).astype(np.float32) for im in (left, right)]


@pytest.mark.parametrize("shift", [0.0, 0.37, -7.81])
def test_constant_parallax(shift):
    """To a few thousandths on average, the scatter as the match itself says, and the same across the rows."""
    left, right = pair(lambda x, y: shift, row_parallax=-0.25)
    found = match_dense(left, right, (-12.0, 8.0), DenseOptions(window_px=9))
    inner = (slice(20, -20), slice(30, -30))
    known = np.isfinite(found.parallax[inner])
    assert known.mean() > 0.98
    for value, truth, variance in (
        (found.parallax, shift, found.variance),
        (found.row_parallax, -0.25, found.row_variance),
    ):
        error = value[inner][known].astype(np.float64) - truth
        sigma = np.sqrt(np.mean(variance[inner][known]))
        assert abs(error.mean()) < 0.01
        assert error.std() < 0.06
        assert 0.7 < error.std() / sigma < 1.4
    assert np.median(found.correlation[inner][known]) > 0.98


def test_inclined_surface():
    """A plane of parallaxes, as a roof shows: no bias, and steps of more than one pixel give the same."""
    left, right = pair(lambda x, y: 2.0 + 0.2 * (x - 100.0) / 1.2 + 0.1 * (y - 60.0))
    y, x = np.mgrid[0:120, 0:200].astype(float)
    # the parallax is given at the right position; at the left one x_left = x + p(x)
    base = 2.0 + 0.1 * (y - 60.0)
    at_right = (x - base + 0.2 / 1.2 * 100.0) / (1.0 + 0.2 / 1.2)
    truth = x - at_right
    options = DenseOptions(largest_row_parallax_px=1.0)
    found = match_dense(left, right, (-30.0, 30.0), options)
    inner = (slice(20, -20), slice(45, -45))
    error = (found.parallax - truth)[inner]
    known = np.isfinite(error)
    assert known.mean() > 0.9
    assert abs(np.mean(error[known])) < 0.01
    assert np.std(error[known]) < 0.08
    coarse = match_dense(left, right, (-30.0, 30.0), DenseOptions(largest_row_parallax_px=1.0, step_px=3))
    assert coarse.parallax.shape == (40, 67)
    both = np.isfinite(coarse.parallax[10:-10, 15:-15]) & np.isfinite(
        found.parallax[1::3, 1::3][10:-10, 15:-15]
    )
    gap = (coarse.parallax - found.parallax[1::3, 1::3])[10:-10, 15:-15][both]
    assert np.sqrt(np.mean(gap**2)) < 0.02


def test_wide_range_is_searched_from_coarse_to_fine():
    left, right = pair(lambda x, y: 60.0 + 25.0 * np.tanh((x - 200.0) / 80.0), shape=(200, 420))
    images = [np.clip(image, 0, 255).astype(np.uint8) for image in (left, right)]
    narrow = semiglobal_parallax(*images, (20.0, 100.0))
    wide = semiglobal_parallax(*images, (-120.0, 140.0), SemiglobalOptions(widest_px=64))
    inner = (slice(20, -20), slice(120, -20))
    both = np.isfinite(narrow[inner]) & np.isfinite(wide[inner])
    assert both.mean() > 0.9
    assert np.median(np.abs(narrow[inner] - wide[inner])[both]) < 0.2


def test_what_one_image_does_not_show_is_not_matched():
    """Left and right are checked against each other; empty parts and other textures give nothing."""
    left, right = pair(lambda x, y: 1.5)
    right[:, 60:100] = texture(*np.meshgrid(np.arange(40.0), np.arange(120.0)), seed=9)
    valid = np.ones(left.shape, bool), np.ones(left.shape, bool)
    valid[1][:, 150:] = False
    found = match_dense(left, right, (-8.0, 8.0), valid=valid)
    assert np.isfinite(found.parallax[20:-20, 70:90]).mean() < 0.15
    assert not np.isfinite(found.parallax[:, 152:]).any()
    assert np.isfinite(found.parallax[20:-20, 115:140]).mean() > 0.9


def test_labels_keep_surfaces_apart():
    """Beside the border of a label only its own side is matched: a step of the parallax does not blur."""
    left, right = pair(lambda x, y: np.where(x < 98.0, 0.0, 1.4))
    labels = np.zeros(left.shape, np.uint16)
    labels[:, 98:] = 1
    found = match_dense(left, right, (-4.0, 6.0), labels=labels)
    blurred = match_dense(left, right, (-4.0, 6.0))
    beside = (slice(20, -20), slice(95, 97))
    assert np.nanmedian(np.abs(found.parallax[beside])) < 0.1
    assert np.nanmedian(np.abs(found.parallax[beside])) < np.nanmedian(np.abs(blurred.parallax[beside]))


def test_types_of_pixels_do_not_matter():
    left, right = pair(lambda x, y: 0.5)
    plain = match_dense(left, right, (-4.0, 4.0))
    scaled = match_dense((left * 200).astype(np.uint16), (right * 200).astype(np.uint16), (-4.0, 4.0))
    both = np.isfinite(plain.parallax) & np.isfinite(scaled.parallax)
    assert both.mean() > 0.8
    # the semi-global step sees them stretched differently
    assert np.quantile(np.abs(plain.parallax - scaled.parallax)[both], 0.9) < 0.01


def test_nothing_to_see():
    flat = np.full((80, 90), 100.0, np.float32)
    assert not np.isfinite(match_dense(flat, flat, (-4.0, 4.0)).parallax).any()


def test_arguments_are_checked():
    image = np.zeros((40, 50), np.uint8)
    with pytest.raises(InputError, match="one size"):
        match_dense(image, image[:, 1:], (-1.0, 1.0))
    with pytest.raises(InputError, match="search_px"):
        match_dense(image, image, (1.0, -1.0))
    with pytest.raises(InputError, match="window_px"):
        DenseOptions(window_px=4)
    with pytest.raises(InputError, match="block_px"):
        SemiglobalOptions(block_px=2)
