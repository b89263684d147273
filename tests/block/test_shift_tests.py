"""A shift of the positions of one strip, tested as an alternative hypothesis."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from blocks import make_block
from scipy.stats import binom, chi2, ncx2

from stereomate.block.adjustment import adjust_block
from stereomate.block.influence import influences
from stereomate.block.network import Attitudes
from stereomate.block.options import BlockOptions
from stereomate.block.shift_tests import noncentrality, shift_tests
from stereomate.geometry.rotations import rotation_from_vector

PRIOR = BlockOptions(scale_by="prior")


def _shifted(rows, shift, control=0, noise_seed=None, **more):
    """A block of strips of five; the positions of strip 1 are shifted."""
    block = make_block(columns=5, rows=rows, gnss=0.05, control=control, noise_seed=noise_seed, **more)
    strips = np.repeat(np.arange(rows), 5)
    positions = block.network.positions
    xyz = positions.xyz + np.where(strips == 1, 1.0, 0.0)[:, None] * np.asarray(shift)
    return replace(block.network, positions=replace(positions, xyz=xyz)), strips


def test_the_same_as_with_the_shift_as_an_unknown():
    """Estimate, standard deviation and statistic against a second adjustment that has the shift unknown."""
    network, strips = _shifted(3, (0.02, -0.01, 0.05), control=3)
    plain = adjust_block(network, PRIOR)
    tests = shift_tests(plain, strips)
    assert [(test.kind, test.strip) for test in tests] == [
        ("strip", 0), ("strip", 1), ("strip", 2), ("mount", 0), ("all", -1),
    ]  # fmt: skip
    for test in tests:
        of = np.zeros(15, int) if test.kind == "all" else np.where(strips == test.strip, 0, -1)
        unknown = replace(network.positions, strip=of, shift=True)
        if test.kind == "mount":
            unknown = replace(network.positions, lever_arm_sigma=math.inf)
        again = adjust_block(replace(network, positions=unknown), PRIOR)
        np.testing.assert_allclose(test.shift, again.shared[-3:], atol=2e-4)
        np.testing.assert_allclose(test.sigma, again.statistics.shared_sigma[-3:], rtol=2e-3)
        assert test.statistic == pytest.approx(plain.test.statistic - again.test.statistic, abs=0.05)
        assert test.limit == pytest.approx(16.27, abs=0.01)
        # A shift along one axis of the size that can be seen has the non-centrality of the power asked for.
        size = noncentrality(0.001, 0.8, 3)
        assert ncx2.sf(test.limit, 3, size) == pytest.approx(0.8, abs=1e-9)
        information = np.linalg.inv(again.statistics.cofactors.shared[-3:, -3:])
        np.testing.assert_allclose(test.detectable, np.sqrt(size / np.diag(information)), rtol=2e-3)


def test_one_dimension_is_the_limit_of_baarda():
    assert np.sqrt(noncentrality(0.001, 0.8, 1)) == pytest.approx(4.132, abs=1e-3)


def test_two_strips_without_control_cannot_say_which_and_hardly_see_a_height():
    """A metre of height of one strip turns the block; a metre along it shows, but not in which strip."""
    for height, seen in ((1.0, False), (8.0, True)):
        network, strips = _shifted(2, (0.0, 0.0, height))
        first, second, _, every = shift_tests(adjust_block(network, PRIOR), strips)
        # Eight metres tilt the block so that it is another one.
        assert seen or 1.5 < first.detectable[2] < 6.0
        assert (first.significant, second.significant) == (seen, seen)
        np.testing.assert_allclose(first.shift, -second.shift, atol=1e-3)
        # What is common to all positions is the datum.
        assert every.dimension == 0
        assert np.isinf(every.detectable).all()
        assert (first.alike, second.alike) == (((1,), (0,)) if seen else ((), ()))


def test_the_strip_that_is_shifted_stands_out_and_is_told_apart():
    network, strips = _shifted(4, (0.0, 0.0, 1.0))
    tests = shift_tests(adjust_block(network, PRIOR), strips)
    found = max(tests[:5], key=lambda test: test.statistic)
    assert (found.strip, found.alike) == (1, ())
    assert abs(found.shift[2] - 1.0) < 4.0 * found.sigma[2]
    assert max(found.detectable) < 0.2
    np.testing.assert_array_equal(found.photo, np.arange(5, 10))


def test_strips_flown_there_and_back_tell_a_lever_arm_from_shifts_of_strips():
    """An antenna 0.3 m to the side shifts every second strip to the other one: one offset explains all."""
    block = make_block(columns=5, rows=4, gnss=0.05, control=3)
    back = np.repeat([0, 1, 0, 1], 5)
    half_turn = np.diag([-1.0, -1.0, 1.0])
    rotations = np.where(back[:, None, None] == 1, block.rotations @ half_turn, block.rotations)
    image = block.network.image
    cols, rows = block.network.cameras[0].camera.size_px
    camera = make_block(columns=2, rows=1).network.cameras[0].camera
    seen = np.einsum(
        "mji,mj->mi", rotations[image.photo], block.points[image.point] - block.centres[image.photo]
    )
    xy, _ = camera.image_from_camera(seen)
    assert (xy > -300.0).all()
    assert (xy < (cols + 300.0, rows + 300.0)).all()
    xy += np.random.default_rng(9001).normal(0.0, 0.5, xy.shape)
    photographs = block.network.photographs
    positions = block.network.positions
    network = replace(
        block.network,
        image=replace(image, xy=xy),
        photographs=replace(photographs, rotations=rotations),
        positions=replace(positions, xyz=positions.xyz + rotations @ np.array([0.0, 0.3, 0.0])),
    )
    tests = shift_tests(adjust_block(network, PRIOR), np.repeat(np.arange(4), 5))
    best = max(tests, key=lambda test: test.statistic)
    assert best.kind == "mount"
    assert best.shift[1] == pytest.approx(0.3, abs=4.0 * best.sigma[1])


def test_influence_is_what_an_error_of_that_size_does():
    """Errors of minimal detectable size, one at a time, in a linear block: the motion of the own unknowns."""
    block = make_block(columns=4, rows=2, gnss=0.05, control=4, noise=0.0, free={"k1": 1e-3})
    attitudes = Attitudes(np.arange(8), block.rotations, 2e-4, boresight=True)
    plain = adjust_block(replace(block.network, attitudes=attitudes), PRIOR)
    network, s, found = plain.adjusted_network(), plain.statistics, influences(plain)
    for k, axis in ((1, 0), (3, 2)):
        size = s.positions.minimal_detectable[k, axis]
        xyz = network.positions.xyz.copy()
        xyz[k, axis] += size
        again = adjust_block(replace(network, positions=replace(network.positions, xyz=xyz)), PRIOR)
        assert np.linalg.norm(again.centres[k] - plain.centres[k]) == pytest.approx(
            found.positions[k, axis, 0], rel=0.01
        )
        turn = np.arccos((np.trace(again.rotations[k].T @ plain.rotations[k]) - 1.0) / 2.0)
        assert turn == pytest.approx(found.positions[k, axis, 1], rel=0.02)
        size = s.control.minimal_detectable[k, axis]
        xyz = network.control.xyz.copy()
        xyz[k, axis] += size
        again = adjust_block(replace(network, control=replace(network.control, xyz=xyz)), PRIOR)
        point = network.control.point[k]
        assert np.linalg.norm(again.points[point] - plain.points[point]) == pytest.approx(
            found.control[k, axis], rel=0.01
        )
        error = np.zeros(3)
        error[axis] = s.attitudes.minimal_detectable[k, axis]
        turned = network.attitudes.rotations.copy()
        turned[k] = rotation_from_vector(error) @ turned[k]
        again = adjust_block(replace(network, attitudes=replace(attitudes, rotations=turned)), PRIOR)
        turn = np.arccos((np.trace(again.rotations[k].T @ plain.rotations[k]) - 1.0) / 2.0)
        assert turn == pytest.approx(found.attitudes[k, axis, 1], rel=0.02)
    prior = s.priors
    assert found.priors[0] == pytest.approx(
        (1.0 - prior.redundancy[0, 0]) * prior.minimal_detectable[0, 0], rel=1e-9
    )


@pytest.mark.slow
def test_level_and_power_are_those_stated():
    """120 blocks without a shift, and with one of the size that can be seen: chi-square, and the power."""
    exact, strips = _shifted(3, (0.0, 0.0, 0.0), control=3, noise=0.0)
    clean = {(test.kind, test.strip): test for test in shift_tests(adjust_block(exact, PRIOR), strips)}
    total, found, count = 0.0, 0, 120
    for seed in range(count):
        network, _ = _shifted(3, (0.0, 0.0, 0.0), control=3, noise_seed=9000 + seed)
        total += {(t.kind, t.strip): t for t in shift_tests(adjust_block(network, PRIOR), strips)}[
            "strip", 1
        ].statistic
        network, _ = _shifted(
            3, (0.0, 0.0, clean["strip", 1].detectable[2]), control=3, noise_seed=9000 + seed
        )
        found += {(t.kind, t.strip): t for t in shift_tests(adjust_block(network, PRIOR), strips)}[
            "strip", 1
        ].significant
    assert chi2.ppf(0.005, 3 * count) < total < chi2.ppf(0.995, 3 * count)
    assert binom.ppf(0.005, count, 0.8) <= found <= binom.ppf(0.995, count, 0.8)
