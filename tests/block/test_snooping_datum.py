"""Data snooping where control points are the only datum: it must not take the datum out with the errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from blocks import make_block

from stereomate.block.adjustment import adjust_block
from stereomate.block.datum import find_defect
from stereomate.block.network import Control
from stereomate.block.options import BlockOptions

SNOOPING = BlockOptions(robust="snooping")


def test_tie_points_better_than_stated_do_not_condemn_the_control():
    """Tie points are 20 times as good as stated, measurements of control points exactly as good."""
    block = make_block(columns=3, rows=2, per_photo=120, control=6, noise=0.05, seed=4)
    image, control = block.network.image, block.network.control
    assert control is not None
    of_control = np.isin(image.point, control.point)
    rng = np.random.default_rng(11)
    xy = image.xy + np.where(of_control[:, None], rng.normal(0, 0.5, image.xy.shape), 0.0)
    # One height is unknown, as of a point of which only the plan was found.
    sigma, xyz = control.sigma.copy(), control.xyz.copy()
    sigma[2, 2], xyz[2, 2] = np.inf, np.nan
    bad = int(np.flatnonzero(of_control)[0])
    xy[bad] += (40.0, 0.0)
    network = replace(
        block.network, image=replace(image, xy=xy), control=replace(control, xyz=xyz, sigma=sigma)
    )
    result = adjust_block(network, SNOOPING)
    assert result.converged
    assert result.statistics is not None
    # Of the control only the gross error went, and it did go.
    assert np.flatnonzero(of_control & ~result.used).tolist() == [bad]
    assert not [g for g in result.gross_errors if g.kind == "control"]
    assert not [note for note in result.notes if "contradict" in note]
    # Off the truth by what is stated: chi-square of 18 coordinates, 0.1 % on each side.
    off = (result.centres - block.centres) / (result.statistics.photo_sigma[:, :3] / result.statistics.scale)
    assert np.sum(off**2) < 42.3


def test_contradicting_control_stays_where_nothing_else_holds_the_datum():
    """Coordinates stated to a millimetre that are wrong by decimetres: named, but the datum stays."""
    block = make_block(columns=3, rows=2, per_photo=80, control=3, noise=0.2, seed=6)
    control = block.network.control
    assert control is not None
    rng = np.random.default_rng(2)
    xyz = control.xyz + rng.normal(0, 0.3, control.xyz.shape)
    network = replace(block.network, control=Control(control.point, xyz, 0.001))
    result = adjust_block(network, SNOOPING)
    assert result.converged
    assert result.statistics is not None
    assert np.isfinite(result.statistics.photo_sigma).all()
    assert not [note for note in result.notes if "inner constraints" in note]
    (note,) = [note for note in result.notes if "not determined without them" in note]
    assert any(network.points.names[point] in note for point in control.point)
    assert len({g.row for g in result.gross_errors if g.kind == "control"}) < 3
    assert np.abs(result.centres - block.centres).max() < 5.0


def test_control_that_no_photograph_sees_holds_no_datum():
    block = make_block(columns=3, rows=2, control=3)
    image, control = block.network.image, block.network.control
    assert control is not None
    assert find_defect(block.network).size == 0
    used = ~np.isin(image.point, control.point[:1])
    # Two points leave the turn about the line through them.
    assert find_defect(block.network, used).size == 1
    assert find_defect(block.network, ~np.isin(image.point, control.point)).size == 7
    assert any("inner constraints" in note for note in adjust_block(unseen(block.network)).notes)


def unseen(network):
    """Without the measurements of the control points."""
    image, control = network.image, network.control
    keep = ~np.isin(image.point, control.point)
    fewer = type(image)(image.photo[keep], image.point[keep], image.xy[keep], image.sigma[keep])
    return replace(network, image=fewer)


def _one_strip(**more):
    """Points of three rays of one strip: along it they control each other in one number only."""
    block = make_block(columns=1, rows=5, per_photo=60, gnss=0.05, seed=8, **more)
    rays = np.bincount(block.network.image.point)
    return block, np.flatnonzero(rays == 3)


def test_a_ray_that_no_test_can_place_takes_its_whole_point_out():
    """An error of 60 px along the base of three rays: any of them may be it, and none is believed."""
    block, points = _one_strip()
    image = block.network.image
    rows = np.flatnonzero(image.point == points[0])
    xy = image.xy.copy()
    xy[rows[0], 0] += 60.0
    network = replace(block.network, image=replace(image, xy=xy))
    result = adjust_block(network, replace(SNOOPING, scale_by="prior"))
    assert not result.used[rows].any()
    assert np.isnan(result.points[points[0]]).all()
    doubted = [g.row for g in result.gross_errors if g.in_doubt]
    assert len(doubted) >= 2
    assert set(doubted) <= set(rows.tolist())
    (note,) = [note for note in result.notes if "no test can place" in note]
    assert network.points.names[points[0]] in note
    # Across the base it can be placed: that ray goes and nothing else.
    xy = image.xy.copy()
    xy[rows[0], 1] += 60.0
    result = adjust_block(replace(network, image=replace(image, xy=xy)), replace(SNOOPING, scale_by="prior"))
    assert np.flatnonzero(~result.used[rows]).tolist() == [0]
    assert not any(g.in_doubt for g in result.gross_errors)


def test_a_wrong_height_is_not_laid_at_the_door_of_the_rays():
    """Huber's start weights the rays down where a height contradicts them; the smallest explanation wins."""
    block = make_block(columns=4, rows=4, per_photo=60, gnss=0.05, control=12, seed=9)
    control, image = block.network.control, block.network.image
    rays = np.bincount(image.point, minlength=len(block.points))[control.point]
    row = int(np.flatnonzero(rays >= 4)[0])
    xyz = control.xyz.copy()
    xyz[row, 2] += 4.0
    for robust in ("snooping", "l1"):
        options = BlockOptions(robust=robust, scale_by="prior")
        result = adjust_block(replace(block.network, control=replace(control, xyz=xyz)), options)
        (found,) = [g for g in result.gross_errors if g.kind == "control"]
        assert (found.row, found.in_doubt) == (row, False)
        assert np.isnan(found.size[:2]).all()
        assert abs(found.size[2] - 4.0) < 0.3
        assert result.used[image.point == control.point[row]].all()
