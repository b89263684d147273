"""Planted gross errors: those the statistics call detectable are found, as often as they say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from blocks import make_block
from scipy.stats import binom, norm

from stereomate.block.adjustment import adjust_block
from stereomate.block.network import Attitudes, Control
from stereomate.block.options import BlockOptions
from stereomate.geometry.rotations import rotation_from_vector

PRIOR = BlockOptions(scale_by="prior")
SNOOPING = BlockOptions(scale_by="prior", robust="snooping")
CRITICAL = float(norm.isf(PRIOR.tests.alpha / 2.0))


# One pixel in the units of each kind: on the ground, and as an angle.
UNIT = {"image": 1.0, "control": 1.0 / 60.0, "positions": 1.0 / 60.0, "attitudes": 1.0 / 6000.0}
LARGEST_PX = 500.0


def _full_network(seed):
    """48 photographs with positions and attitudes, 30 control points and 30 known in height only."""
    block = make_block(columns=8, rows=6, per_photo=40, gnss=0.05, control=60, seed=20 + seed)
    control, n = block.network.control, len(block.centres)
    rng = np.random.default_rng([3, seed])
    sigma, xyz = control.sigma.copy(), control.xyz.copy()
    sigma[30:, :2], xyz[30:, :2] = np.inf, np.nan
    turned = rotation_from_vector(3e-4 * rng.normal(size=(n, 3))) @ block.rotations
    return replace(
        block.network,
        control=Control(control.point, xyz, sigma),
        attitudes=Attitudes(np.arange(n), turned, 3e-4),
    )


def _planted(network, statistics, share, rng):
    """Errors of half a minimal detectable error to 500 px along one coordinate of `share` of every kind."""
    of_control = np.isin(network.image.point, network.control.point)
    errors = {}
    for kind, unit in UNIT.items():
        detectable = getattr(statistics, kind).minimal_detectable
        size = np.zeros(detectable.shape)
        known = np.isfinite(detectable).any(axis=1)
        for group in (of_control, ~of_control) if kind == "image" else (known,):
            rows = np.flatnonzero(known & group)
            for row in rows[rng.random(len(rows)) < share].tolist():
                axis = rng.choice(np.flatnonzero(np.isfinite(detectable[row])))
                low = np.log(0.5 * detectable[row, axis])
                high = max(np.log(LARGEST_PX * unit), low)
                size[row, axis] = np.exp(rng.uniform(low, high)) * rng.choice([-1.0, 1.0])
        errors[kind] = size
    image, control = network.image, network.control
    positions, attitudes = network.positions, network.attitudes
    turned = rotation_from_vector(errors["attitudes"]) @ attitudes.rotations
    return errors, replace(
        network,
        image=replace(image, xy=image.xy + errors["image"]),
        control=replace(control, xyz=control.xyz + errors["control"]),
        positions=replace(positions, xyz=positions.xyz + errors["positions"]),
        attitudes=replace(attitudes, rotations=turned),
    )


def _taken_out(network, result):
    """What is out of every kind; control of points that kept no ray takes no part either."""
    out = {kind: np.zeros(getattr(network, kind).sigma.shape, bool) for kind in UNIT}
    out["image"][:] = ~result.used[:, None]
    for error in result.gross_errors:
        if error.kind != "image":
            out[error.kind][error.row] |= np.isfinite(error.size)
    rays = np.bincount(network.image.point[result.used], minlength=len(network.points.names))
    out["control"] |= (rays[network.control.point] == 0)[:, None]
    return out


class _Tally:
    """Counts of one kind over several blocks."""

    def __init__(self):
        self.detectable = self.found = self.small = self.small_found = self.good = self.lost = 0
        self.expected = 0.0

    def add(self, error, limit, out, judged, kept):
        """Errors, limits and what is out; rows whose errors and whose good observations count."""
        with np.errstate(invalid="ignore"):
            part = np.abs(error) / limit
            over = (part > 1.5) & judged
            small = (part > 0.0) & (part <= 1.5) & judged
        good = (error == 0.0) & np.isfinite(limit) & kept
        self.detectable += int(over.sum())
        self.found += int((over & out).sum())
        self.small += int(small.sum())
        self.small_found += int((small & out).sum())
        self.expected += float(norm.sf(CRITICAL - 4.1321 * part[small]).sum())
        self.good += int(good.sum())
        self.lost += int((good & out).sum())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("share", "robust", "blocks"), [(0.01, "snooping", 4), (0.05, "snooping", 8), (0.05, "l1", 4)]
)
def test_errors_planted_in_all_kinds_are_found_and_good_observations_kept(share, robust, blocks):
    """Tie points, marks and coordinates of control points, heights, positions, attitudes: all at once."""
    tallies = {name: _Tally() for name in ("ties", "marks", "control", "heights", "positions", "attitudes")}
    for seed in range(blocks):
        network = _full_network(seed)
        clean = adjust_block(network, PRIOR).statistics
        errors, bad = _planted(network, clean, share, np.random.default_rng(seed))
        out = _taken_out(network, adjust_block(bad, replace(SNOOPING, robust=robust)))
        image, control = network.image, network.control
        wrong = (errors["image"] != 0.0).any(axis=1)
        rays = np.bincount(image.point[~wrong], minlength=len(network.points.names))
        of_control = np.isin(image.point, control.point)
        height = np.isinf(control.sigma[:, 0])
        every = np.ones(len(network.positions.photo), bool)
        groups = {
            "ties": ("image", ~of_control), "marks": ("image", of_control),
            "control": ("control", ~height), "heights": ("control", height),
            "positions": ("positions", every), "attitudes": ("attitudes", every),
        }  # fmt: skip
        for name, (kind, rows) in groups.items():
            limit = getattr(clean, kind).minimal_detectable
            judged, kept = rows, rows & (~wrong if kind == "image" else True)
            if kind in ("image", "control"):
                # Not controlled are points that lose their other rays. A good observation of a point with
                # three good rays can be told from a bad one.
                others = rays[getattr(network, kind).point]
                judged, kept = judged & (others >= 2), kept & (others >= 3)
            tallies[name].add(errors[kind], limit, out[kind], judged[:, None], kept[:, None])
    total = {key: sum(vars(t)[key] for t in tallies.values()) for key in vars(tallies["ties"])}
    assert total["detectable"] > (50 if share < 0.02 else 300)
    assert total["found"] >= 0.99 * total["detectable"]
    for name, tally in tallies.items():
        # Of ten errors of a kind one missed would be ten per cent.
        assert tally.found >= 0.99 * tally.detectable - 0.5, name
        # An image point goes with both its coordinates, each of them tested.
        pair = 2 if name in ("ties", "marks") else 1
        assert tally.lost // pair <= binom.ppf(0.999, tally.good // pair, pair * SNOOPING.tests.alpha), name
    if share > 0.02:
        assert all(tally.detectable >= blocks // 2 for tally in tallies.values())
    # Below the limit as many are found as the normal law says.
    power = total["expected"] / max(total["small"], 1)
    low, high = binom.ppf(0.005, total["small"], power), binom.ppf(0.995, total["small"], power)
    assert low <= total["small_found"] <= high


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
    found, expected = 0, []
    for row, axis in zip(rows[chosen].tolist(), axes[chosen].tolist(), strict=True):
        factor = rng.uniform(0.7, 1.0)
        size = factor * part.minimal_detectable[row, axis]
        result = adjust_block(_with_error(network, kind, row, axis, size, rng), PRIOR)
        found += bool(abs(getattr(result.statistics, kind).standardized[row, axis]) > CRITICAL)
        expected.append(norm.sf(CRITICAL - factor * 4.1321))
    mean = float(np.mean(expected))
    low, high = binom.ppf(0.005, count, mean), binom.ppf(0.995, count, mean)
    assert low <= found <= high
