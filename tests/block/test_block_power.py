"""Planted gross errors: those the statistics call detectable are found, as often as they say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from blocks import make_block
from scipy.stats import binom, norm

from stereomate.block.adjustment import adjust_block
from stereomate.block.options import BlockOptions

PRIOR = BlockOptions(scale_by="prior")
SNOOPING = BlockOptions(scale_by="prior", robust="snooping")


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.01, 0.05])
def test_detectable_errors_are_found_and_good_observations_kept(share):
    """Errors of 5 to 500 px along one coordinate in `share` of the image points, over four blocks."""
    detectable = found = good = lost = 0
    for seed in range(4):
        block = make_block(columns=6, rows=5, per_photo=80, gnss=0.05, control=6, seed=20 + seed)
        clean = adjust_block(block.network, PRIOR)
        image = block.network.image
        rng = np.random.default_rng(seed)
        m = len(image.photo)
        bad = rng.random(m) < share
        axis = rng.integers(0, 2, m)
        size = np.exp(rng.uniform(np.log(5.0), np.log(500.0), m)) * rng.choice([-1.0, 1.0], m)
        xy = image.xy.copy()
        xy[np.flatnonzero(bad), axis[bad]] += size[bad]
        # Not controlled is what has hardly a residual of its own, and points that lose their other rays.
        limit = clean.statistics.image.minimal_detectable[np.arange(m), axis]
        rays = np.bincount(image.point[~bad], minlength=len(block.points))[image.point]
        over = bad & (np.abs(size) > 1.5 * limit) & (rays >= 2)
        result = adjust_block(replace(block.network, image=replace(image, xy=xy)), SNOOPING)
        detectable += int(over.sum())
        found += int((over & ~result.used).sum())
        # A good observation of a point with three good rays can be told from a bad one.
        kept = ~bad & (rays >= 3)
        good += int(kept.sum())
        lost += int((kept & ~result.used).sum())
    assert detectable > (60 if share < 0.02 else 300)
    assert found >= 0.99 * detectable
    # Two coordinates, each tested at alpha.
    assert lost <= binom.ppf(0.999, good, 2.0 * SNOOPING.tests.alpha)


@pytest.mark.slow
def test_power_below_the_limit_is_the_stated_one():
    """One error of 0.7 to 1 minimal detectable error at a time: found as often as the normal law says."""
    block = make_block(columns=4, rows=4, per_photo=60, gnss=0.05, control=6, seed=31, noise=0.0)
    clean = adjust_block(block.network, PRIOR)
    image = block.network.image
    limit = clean.statistics.image.minimal_detectable
    redundancy = clean.statistics.image.redundancy
    rng = np.random.default_rng(4)
    chosen = rng.choice(np.flatnonzero(redundancy[:, 0] > 0.3), 120, replace=False)
    critical = float(norm.isf(PRIOR.tests.alpha / 2.0))
    found, expected = 0, []
    for row in chosen.tolist():
        factor = rng.uniform(0.7, 1.0)
        xy = image.xy + 0.5 * rng.normal(size=image.xy.shape)
        xy[row, 0] += factor * limit[row, 0]
        network = replace(clean.adjusted_network(), image=replace(image, xy=xy))
        result = adjust_block(network, PRIOR)
        found += bool(abs(result.statistics.image.standardized[row, 0]) > critical)
        expected.append(norm.sf(critical - factor * 4.1321))
    mean = float(np.mean(expected))
    low, high = binom.ppf(0.005, 120, mean), binom.ppf(0.995, 120, mean)
    assert low <= found <= high
