"""Two hundred simulated blocks: errors against what is stated, of all groups of unknowns and observations.

The same statistics over blocks whose standard deviations are stated 1.25 times too small, group by group,
show that a wrong one is seen.
"""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest
from blocks import make_block
from scipy.stats import chi2

from stereomate.block.adjustment import adjust_block
from stereomate.block.network import Attitudes, BlockCamera
from stereomate.block.options import BlockOptions
from stereomate.block.unknowns import vector_from_rotation
from stereomate.block.whole import full_covariance
from stereomate.geometry.rotations import rotation_from_vector

pytestmark = pytest.mark.slow

FREE = {
    "principal_distance_mm": math.inf,
    "principal_point_x_mm": math.inf,
    "k1": math.inf,
    "p1": 1e-4,
    "pixel_aspect": 1e-3,
}
PRIOR = BlockOptions(scale_by="prior")
OBSERVED = ("image", "control", "positions", "attitudes")
WITH_PRIORS = ("drone: p1", "drone: pixel_aspect")
UNDERSTATED = 1.25


def _simulated(seed):
    """A block, its network with noise in every kind of observation, and the true shared unknowns."""
    block = make_block(gnss=0.05, control=5, free=FREE, noise_seed=seed, start=(0.2, 0.002), per_photo=30)
    n = len(block.centres)
    rng = np.random.default_rng([9, seed])
    # Priors are observations: their values err too.
    entry = block.network.cameras[0]
    values = np.array(entry.camera.parameters)
    names = entry.camera.parameter_names
    values[names.index("p1")] += 1e-4 * rng.normal()
    camera = entry.camera.with_parameters(values)
    affine = np.array(camera.pixel_from_photo)
    aspect = 1e-3 * rng.normal()
    affine[:, 0] *= 1.0 + aspect
    camera = replace(camera, pixel_from_photo=tuple(map(tuple, affine.tolist())))
    arm = 0.1 * rng.normal(size=3)
    positions = replace(block.network.positions, lever_arm=arm, lever_arm_sigma=0.1)
    beta = np.array([0.01, -0.02, 0.005])
    turned = rotation_from_vector(1e-4 * rng.normal(size=(n, 3))) @ block.rotations
    attitudes = Attitudes(np.arange(n), turned @ rotation_from_vector(beta), 1e-4, boresight=True)
    network = replace(
        block.network, cameras=(BlockCamera(camera, FREE),), positions=positions, attitudes=attitudes
    )
    true = dict(zip(names, entry.camera.parameters, strict=True))
    own = [true[name] for name in names if name in FREE]
    return block, network, np.concatenate([own, [1.0 / (1.0 + aspect) - 1.0], -arm, beta])


def _understated(network, group):
    """The network with the standard deviations of one group stated too small."""
    part = getattr(network, group, None)
    if part is not None:
        return replace(network, **{group: replace(part, sigma=part.sigma / UNDERSTATED)})
    if group == "interior priors":
        (entry,) = network.cameras
        free = {name: sigma / UNDERSTATED for name, sigma in entry.free.items()}
        return replace(network, cameras=(BlockCamera(entry.camera, free),))
    assert group == "lever arm"
    sigma = network.positions.lever_arm_sigma / UNDERSTATED
    return replace(network, positions=replace(network.positions, lever_arm_sigma=sigma))


def _compare(count, group=None):
    """Sums of squares and their degrees of freedom over `count` blocks, by name.

    Errors of unknowns against their stated covariance: chi-square. Weighted residuals of a kind
    of observations against the sum of its redundancy numbers: their variance is at most that of chi-square.
    """
    totals = defaultdict(lambda: np.zeros(2))
    for seed in range(count):
        block, network, truth = _simulated(seed)
        result = adjust_block(network if group is None else _understated(network, group), PRIOR)
        n, j = len(block.centres), seed % len(block.points)
        turns = vector_from_rotation(block.rotations @ np.swapaxes(result.rotations, 1, 2))
        photos = np.concatenate([block.centres - result.centres, turns], axis=1)
        names = result.shared_names
        shared = result.shared - truth
        at = names.index("boresight x")
        boresight = rotation_from_vector(truth[at:]).T @ result.solution.state.boresight[0]
        shared[at:] = vector_from_rotation(boresight)
        error = np.concatenate([photos.ravel(), -shared])
        whole = full_covariance(result.solution)
        number = np.arange(6 * n).reshape(n, 6)
        at = 6 * n
        parts = {
            "everything": np.arange(len(error)),
            "centres": number[:, :3].ravel(),
            "rotations": number[:, 3:].ravel(),
            "camera": at + np.array([k for k, name in enumerate(names) if name.startswith("drone")]),
            "lever arm": at + np.array([k for k, name in enumerate(names) if name.startswith("lever")]),
            "boresight": at + np.array([k for k, name in enumerate(names) if name.startswith("bore")]),
            "with priors": at + np.array([k for k, name in enumerate(names) if name in WITH_PRIORS]),
        }
        for name, rows in parts.items():
            square = error[rows] @ np.linalg.solve(whole[np.ix_(rows, rows)], error[rows])
            totals[name] += square, len(rows)
        point = block.points[j] - result.points[j]
        totals["points"] += point @ np.linalg.solve(result.statistics.cofactors.points[j], point), 3
        statistics = result.statistics
        observed = {kind: (getattr(statistics, kind), slice(None)) for kind in OBSERVED}
        observed["interior priors"] = statistics.priors, np.isin(names, WITH_PRIORS)
        observed["prior of the lever arm"] = statistics.priors, np.char.startswith(names, "lever")
        for kind, (part, rows) in observed.items():
            square = (part.residuals[rows] / part.sigma[rows]) ** 2
            totals[kind] += np.nansum(square), np.nansum(part.redundancy[rows])
        totals["sigma0"] += result.test.statistic, result.redundancy
        totals["rejected"] += not result.test.passed, 1
    return totals


def _refused(totals):
    """Names of what does not agree: chi-square at 1 %."""
    refused = set()
    for name, (total, degrees) in totals.items():
        if name != "rejected" and not chi2.ppf(0.005, degrees) < total < chi2.ppf(0.995, degrees):
            refused.add(name)
    return refused


def test_two_hundred_blocks_agree_with_their_standard_deviations():
    totals = _compare(200)
    assert not _refused(totals), {name: tuple(totals[name]) for name in _refused(totals)}
    assert len(totals) == 16
    assert totals["rejected"][0] <= 8  # binomial limit of 200 tests at 1 %


@pytest.mark.parametrize(
    ("group", "count", "seen_in"),
    [
        ("image", 40, {"image", "rotations", "everything", "sigma0"}),
        ("control", 40, {"control"}),
        ("positions", 40, {"positions", "sigma0"}),
        # What carries much of a group of unknowns has little redundancy of its own: it is seen in these.
        ("attitudes", 40, {"rotations", "everything"}),
        ("interior priors", 200, {"interior priors", "with priors"}),
        ("lever arm", 200, {"lever arm"}),
    ],
)
def test_a_standard_deviation_stated_too_small_is_seen(group, count, seen_in):
    refused = _refused(_compare(count, group))
    assert seen_in <= refused, (group, refused)
