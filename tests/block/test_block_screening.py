"""Coordinates that cannot be right: left out before the adjustment, and check points that stand out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from blocks import make_block

from stereomate.block.adjustment import adjust_block
from stereomate.block.network import Control
from stereomate.block.options import BlockOptions
from stereomate.block.screening import implausible

PRIOR = BlockOptions(scale_by="prior")


@pytest.fixture(scope="module")
def block():
    return make_block(columns=4, rows=4, per_photo=40, gnss=0.05, control=10, seed=12)


@pytest.mark.parametrize("robust", ["snooping", "l1"])
def test_exchanged_coordinates_and_a_position_of_another_place_do_no_harm(block, robust):
    """Thousands of kilometres, as of exchanged easting and northing; two control points exchanged."""
    network = block.network
    ground, place = network.control.xyz.copy(), network.positions.xyz.copy()
    ground[3] += (4.8e6, -4.8e6, 0.0)
    place[5] += (30_000.0, 0.0, 0.0)
    ground[[0, 1]] = ground[[1, 0]]
    wrong = replace(
        network,
        control=replace(network.control, xyz=ground),
        positions=replace(network.positions, xyz=place),
    )
    result = adjust_block(wrong, replace(PRIOR, robust=robust))
    assert result.converged
    assert result.test.passed
    named = {(g.kind, g.row) for g in result.gross_errors if g.kind != "image"}
    assert named == {("control", 0), ("control", 1), ("control", 3), ("positions", 5)}
    (note,) = [note for note in result.notes if "left out from the start" in note]
    assert network.points.names[network.control.point[3]] in note
    assert "p5 (positions, 3e+04 m)" in note
    clean = adjust_block(network, PRIOR)
    assert np.abs(result.centres - clean.centres).max() < 0.05


def test_what_all_have_in_common_and_a_rough_start_are_no_gross_errors(block):
    network = block.network
    shifted = replace(network.positions, xyz=network.positions.xyz + 500.0)
    assert implausible(replace(network, positions=shifted)) == {}
    rough = make_block(columns=4, rows=4, per_photo=40, gnss=0.05, control=10, seed=12, start=(8.0, 0.1))
    assert implausible(rough.network) == {}


def test_a_check_point_that_cannot_be_right_is_named_and_counted_apart(block):
    control = block.network.control
    check = np.arange(10) >= 4
    xyz = control.xyz.copy()
    xyz[7, :2] = xyz[7, 1::-1]  # x and y exchanged
    network = replace(block.network, control=Control(control.point, xyz, control.sigma, check=check))
    result = adjust_block(network, PRIOR)
    assert [c.row for c in result.check_points] == [4, 5, 6, 7, 8, 9]
    (wrong,) = [c for c in result.check_points if c.stands_out]
    assert wrong.row == 7
    np.testing.assert_allclose(wrong.difference, xyz[7] - result.points[control.point[7]])
    (note,) = [note for note in result.notes if "counted apart" in note]
    assert note.startswith(f"check point {wrong.name} contradicts the block")
    # It does not touch the adjustment, and neither its residual nor its name is lost.
    same = adjust_block(replace(network, control=replace(network.control, xyz=control.xyz)), PRIOR)
    np.testing.assert_array_equal(result.centres, same.centres)
    assert not [c for c in same.check_points if c.stands_out]
    assert np.isfinite(result.statistics.control.residuals[7]).all()


def test_two_check_points_under_each_others_names_are_told(block):
    control = block.network.control
    check = np.arange(10) >= 4
    xyz = control.xyz.copy()
    xyz[[5, 6]] = xyz[[6, 5]]
    network = replace(block.network, control=Control(control.point, xyz, control.sigma, check=check))
    wrong = {c.row: c for c in adjust_block(network, PRIOR).check_points if c.stands_out}
    names = [block.network.points.names[j] for j in control.point]
    assert set(wrong) == {5, 6}
    assert wrong[5].reason == f"its rays meet at {names[6]}"
    assert wrong[6].reason == f"its rays meet at {names[5]}"


def test_a_block_that_is_wrong_is_not_laid_at_the_door_of_its_check_points(block):
    """All check points 2 m off in height: that is said by their rms, no point is singled out."""
    control = block.network.control
    check = np.arange(10) >= 2
    xyz = control.xyz + np.where(check[:, None], (0.0, 0.0, 2.0), 0.0)
    network = replace(block.network, control=Control(control.point, xyz, control.sigma, check=check))
    result = adjust_block(network, PRIOR)
    assert not [c for c in result.check_points if c.stands_out]
    assert min(abs(c.standardized[2]) for c in result.check_points) > 10.0
