"""Planted gross errors: those the statistics call detectable are found, as often as they say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from blocks import make_block
from scipy.stats import binom, norm

from stereomate.block.adjustment import adjust_block
from stereomate.block.network import Attitudes
from stereomate.block.options import BlockOptions
from stereomate.geometry.rotations import rotation_from_vector

PRIOR = BlockOptions(scale_by="prior")
SNOOPING = BlockOptions(scale_by="prior", robust="snooping")


@pytest.mark.slow
@pytest.mark.parametrize(("share", "robust"), [(0.01, "snooping"), (0.05, "snooping"), (0.05, "l1")])
def test_detectable_errors_are_found_and_good_observations_kept(share, robust):
    """Errors of 5 to 500 px along one coordinate in `share` of the image points, over four blocks."""
    search = replace(SNOOPING, robust=robust)
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
        result = adjust_block(replace(block.network, image=replace(image, xy=xy)), search)
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


def _with_error(network, kind, row, axis, size, rng):
    """The network with noise in all observations and one gross error."""
    image, control, positions, attitudes = (
        network.image, network.control, network.positions, network.attitudes,
    )  # fmt: skip
    noise = {
        "image": image.sigma * rng.normal(size=image.xy.shape),
        "control": control.sigma * rng.normal(size=control.xyz.shape),
        "positions": positions.sigma * rng.normal(size=positions.xyz.shape),
        "attitudes": attitudes.sigma * rng.normal(size=attitudes.sigma.shape),
    }
    noise[kind][row, axis] += size
    turned = rotation_from_vector(noise["attitudes"]) @ attitudes.rotations
    return replace(
        network,
        image=replace(image, xy=image.xy + noise["image"]),
        control=replace(control, xyz=control.xyz + noise["control"]),
        positions=replace(positions, xyz=positions.xyz + noise["positions"]),
        attitudes=replace(attitudes, rotations=turned),
    )


@pytest.fixture(scope="module")
def exact():
    """A block without errors, and its adjustment."""
    block = make_block(columns=4, rows=4, per_photo=40, gnss=0.05, control=8, seed=31, noise=0.0)
    attitudes = Attitudes(np.arange(16), block.rotations, 2e-4)
    clean = adjust_block(replace(block.network, attitudes=attitudes), PRIOR)
    return clean, clean.adjusted_network()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["image", "control", "positions", "attitudes"])
def test_power_below_the_limit_is_the_stated_one(exact, kind):
    """One error of 0.7 to 1 minimal detectable error at a time: found as often as the normal law says."""
    clean, network = exact
    part = getattr(clean.statistics, kind)
    rng = np.random.default_rng(4)
    rows, axes = np.nonzero(part.redundancy > 0.2)
    count = 120
    chosen = rng.choice(len(rows), count, replace=len(rows) < count)
    critical = float(norm.isf(PRIOR.tests.alpha / 2.0))
    found, expected = 0, []
    for row, axis in zip(rows[chosen].tolist(), axes[chosen].tolist(), strict=True):
        factor = rng.uniform(0.7, 1.0)
        size = factor * part.minimal_detectable[row, axis]
        result = adjust_block(_with_error(network, kind, row, axis, size, rng), PRIOR)
        found += bool(abs(getattr(result.statistics, kind).standardized[row, axis]) > critical)
        expected.append(norm.sf(critical - factor * 4.1321))
    mean = float(np.mean(expected))
    low, high = binom.ppf(0.005, count, mean), binom.ppf(0.995, count, mean)
    assert low <= found <= high
