"""Variance components: standard deviations that were stated wrongly are found, beside gross errors."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from blocks import make_block

from stereomate.block.adjustment import adjust_block
from stereomate.block.network import Attitudes
from stereomate.block.options import BlockOptions
from stereomate.block.variance import estimate_variance_components
from stereomate.geometry.rotations import rotation_from_vector

# What was stated, over what is true.
STATED = {"image": 0.5, "positions": (3.0, 3.0, 0.4), "attitudes": 0.5, "control": (1.0, 1.0, 0.25)}


@pytest.fixture(scope="module")
def block():
    block = make_block(columns=5, rows=5, per_photo=60, gnss=0.05, control=24, seed=14)
    n, rng = len(block.centres), np.random.default_rng(2)
    turned = rotation_from_vector(2e-4 * rng.normal(size=(n, 3))) @ block.rotations
    return replace(block.network, attitudes=Attitudes(np.arange(n), turned, 2e-4))


def _misstated(network):
    return replace(
        network,
        **{
            kind: replace(getattr(network, kind), sigma=getattr(network, kind).sigma * factor)
            for kind, factor in STATED.items()
        },
    )


@pytest.mark.parametrize("robust", ["none", pytest.param("snooping", marks=pytest.mark.slow)])
def test_misstated_standard_deviations_are_found(block, robust):
    network, gross = _misstated(block), set()
    if robust == "snooping":
        xyz, xy = network.control.xyz.copy(), network.image.xy.copy()
        xyz[4, 2] += 3.0
        of_ties = np.flatnonzero(~np.isin(network.image.point, network.control.point))
        xy[of_ties[:40]] += (15.0, 30.0)
        network = replace(
            network,
            control=replace(network.control, xyz=xyz),
            image=replace(network.image, xy=xy),
        )
        gross = {("control", 4)}
    found = estimate_variance_components(network, BlockOptions(robust=robust))
    assert found.converged
    expected = {
        "image": 2.0, "control images": 2.0, "control plan": 1.0, "control height": 4.0,
        "positions plan": 1.0 / 3.0, "positions height": 2.5, "attitudes": 2.0,
    }  # fmt: skip
    assert [c.group for c in found.components] == list(expected)
    for component in found.components:
        # Standard deviation of a factor: 1 / √(2 r).
        off = math.log(component.factor / expected[component.group]) * math.sqrt(2.0 * component.redundancy)
        assert abs(off) < 3.5, component
    result = found.adjustment
    assert result.sigma0 == pytest.approx(1.0, abs=0.03)
    # What was rejected while its standard deviation was stated far too small comes back, but for one at most.
    named = {(g.kind, g.row) for g in result.gross_errors if g.kind != "image"}
    assert gross <= named
    assert len(named - gross) <= 1
    # With what was fitted it is nearly the adjustment of right statements: weights are known to 10 %.
    right = adjust_block(block)
    assert np.abs(result.centres - right.centres).max() < right.statistics.photo_sigma[:, :3].max()
    np.testing.assert_allclose(result.statistics.photo_sigma, right.statistics.photo_sigma, rtol=0.25)
