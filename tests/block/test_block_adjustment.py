"""The bundle adjustment against a second, dense one, against truth, and against its own statements."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from blocks import make_block
from dense_adjustment import Dense
from scipy.stats import binom

from stereomate.block import prepared
from stereomate.block.adjustment import adjust_block
from stereomate.block.equations import build
from stereomate.block.navigation import groups_of
from stereomate.block.network import Attitudes, BlockCamera, Control, ImagePoints, Network, Positions
from stereomate.block.options import BlockOptions, TestOptions
from stereomate.block.statistics import detection_limit
from stereomate.block.unknowns import layout_of, moved, start_of, vector_from_rotation
from stereomate.block.whole import full_covariance
from stereomate.errors import InputError, NotDeterminedError
from stereomate.geometry.rotations import rotation_from_vector

FREE = {
    "principal_distance_mm": math.inf,
    "principal_point_x_mm": math.inf,
    "k1": math.inf,
    "p1": 1e-4,
    "pixel_aspect": 1e-3,
}
PRIOR = BlockOptions(scale_by="prior")


@pytest.fixture(scope="module")
def calibrated():
    block = make_block(gnss=0.05, control=6, free=FREE, per_photo=24)
    return block, adjust_block(block.network, PRIOR)


@pytest.fixture(scope="module")
def dense(calibrated):
    """Residuals, sigmas, design, cofactor of the same network at the same state, by other means."""
    _, result = calibrated
    other = Dense(result.network)
    state = result.solution.state
    residual, sigma, design = other.at(state.centres, state.rotations, state.points, state.cameras[0])
    cofactor = np.linalg.inv(design.T @ (design / sigma[:, None] ** 2))
    return other, residual, sigma, design, cofactor


def test_gradient_vanishes_for_the_second_adjustment(calibrated, dense):
    _, residual, sigma, design, cofactor = dense
    step = cofactor @ (design.T @ (residual / sigma**2))
    # What is left to correct, in standard deviations of each unknown.
    assert np.abs(step / np.sqrt(np.diag(cofactor))).max() < 1e-4
    assert calibrated[1].converged


def test_counts_and_sigma0_agree(calibrated, dense):
    result = calibrated[1]
    _, residual, sigma, design, _ = dense
    assert result.redundancy == design.shape[0] - design.shape[1]
    cost = float(np.sum((residual / sigma) ** 2))
    assert result.sigma0 == pytest.approx(math.sqrt(cost / result.redundancy), rel=1e-9)
    assert result.test is not None
    assert result.test.passed


def test_covariances_agree_with_the_whole_inverse(calibrated, dense):
    result = calibrated[1]
    other, _, _, _, cofactor = dense
    n, p = other.n, other.p
    cofactors = result.statistics.cofactors
    scale = np.sqrt(np.diag(cofactor))
    for k in range(n):
        block, size = cofactor[6 * k : 6 * k + 6, 6 * k : 6 * k + 6], scale[6 * k : 6 * k + 6]
        assert np.abs((cofactors.photos[k] - block) / np.outer(size, size)).max() < 1e-5
    for j in range(p):
        at = slice(6 * n + 3 * j, 6 * n + 3 * j + 3)
        size = scale[at]
        assert np.abs((cofactors.points[j] - cofactor[at, at]) / np.outer(size, size)).max() < 1e-5
    tail = slice(6 * n + 3 * p, None)
    size = scale[tail]
    assert np.abs((cofactors.shared - cofactor[tail, tail]) / np.outer(size, size)).max() < 1e-5
    pair = cofactors.photo_pair(0, 1)
    assert np.abs((pair - cofactor[:6, 6:12]) / np.outer(scale[:6], scale[6:12])).max() < 1e-5
    whole = full_covariance(result.solution)
    keep = np.r_[0 : 6 * n, 6 * n + 3 * p : len(cofactor)]
    expected = cofactor[np.ix_(keep, keep)]
    assert np.abs((whole - expected) / np.outer(scale[keep], scale[keep])).max() < 1e-5


def test_redundancy_numbers_agree_and_sum_to_the_redundancy(calibrated, dense):
    result = calibrated[1]
    _, residual, sigma, design, cofactor = dense
    expected = 1.0 - np.einsum("ij,jk,ik->i", design, cofactor, design) / sigma**2
    s = result.statistics
    got = np.concatenate(
        [
            s.image.redundancy.ravel(),
            s.control.redundancy.ravel(),
            s.positions.redundancy.ravel(),
            s.priors.redundancy[np.isfinite(s.priors.redundancy)],
        ]
    )
    np.testing.assert_allclose(got, expected, atol=1e-6)
    assert got.sum() == pytest.approx(result.redundancy, abs=1e-6)
    standardized = residual / sigma / np.sqrt(expected)
    m = 2 * len(result.used)
    inside = expected[:m] > 1e-3
    np.testing.assert_allclose(s.image.standardized.ravel()[inside], standardized[:m][inside], rtol=1e-3)


def test_minimal_detectable_error_and_its_influence(calibrated, dense):
    result = calibrated[1]
    other, _, sigma, design, cofactor = dense
    s = result.statistics
    row = int(np.argmin(np.abs(s.image.redundancy.ravel() - 0.5)))
    size = s.image.minimal_detectable.ravel()[row]
    assert size == pytest.approx(4.1321 * 0.5 / math.sqrt(s.image.redundancy.ravel()[row]), rel=1e-4)
    motion = cofactor @ design[row] / sigma[row] ** 2 * size
    m, axis = divmod(row, 2)
    j, k = result.network.image.point[m], result.network.image.photo[m]
    at = 6 * other.n + 3 * j
    assert s.on_point[m, axis] == pytest.approx(np.linalg.norm(motion[at : at + 3]), rel=1e-4)
    assert s.on_photo[m, axis] == pytest.approx(np.linalg.norm(motion[6 * k : 6 * k + 3]), rel=1e-4)


def test_several_cameras_are_told_apart():
    """Three cameras, one of them held: redundancy numbers sum up, and there is no better place near."""
    block = make_block(columns=4, rows=3, per_photo=30, gnss=0.05, control=6)
    camera = block.network.cameras[0].camera
    free = {"principal_distance_mm": math.inf, "k1": math.inf}
    cameras = (
        BlockCamera(camera, free),
        BlockCamera(replace(camera, name="held")),
        BlockCamera(replace(camera, name="other"), {"principal_distance_mm": 0.01, "p1": math.inf}),
    )
    photographs = replace(block.network.photographs, camera=np.arange(12) % 3)
    network = replace(block.network, cameras=cameras, photographs=photographs)
    result = adjust_block(network, PRIOR)
    s = result.statistics
    total = sum(np.nansum(part.redundancy) for part in (s.image, s.control, s.positions, s.priors))
    assert total == pytest.approx(result.redundancy, abs=1e-6)
    assert result.shared_names == (
        "drone: principal_distance_mm", "drone: k1", "other: principal_distance_mm", "other: p1",
    )  # fmt: skip
    state, prepared = result.solution.state, result.solution.prepared

    def cost(shared):
        there = moved(state, prepared.layout, np.zeros((12, 6)), np.zeros_like(state.points), shared)
        return build(prepared, there, result.solution.start).cost

    for k, sigma in enumerate(s.shared_sigma):
        step = np.zeros(4)
        step[k] = 1e-3 * sigma
        assert abs(cost(step) - cost(-step)) < 1e-4 * cost(step - step)
        assert cost(step) > cost(step - step)


def test_detection_limit_is_baardas():
    assert detection_limit(0.001, 0.80) == pytest.approx(4.132, abs=5e-4)
    assert detection_limit(0.05, 0.80) == pytest.approx(2.802, abs=5e-4)


def test_band_and_dense_form_agree(monkeypatch):
    monkeypatch.setattr(prepared, "_SMALL", 8)
    long = make_block(columns=12, rows=1, gnss=0.05, control=5, per_photo=20)
    a = adjust_block(long.network, PRIOR)
    assert a.solution.prepared.skew == 1
    other = Dense(long.network)
    state = a.solution.state
    _, sigma, design = other.at(state.centres, state.rotations, state.points, state.cameras[0])
    cofactor = np.linalg.inv(design.T @ (design / sigma[:, None] ** 2))
    scale = np.sqrt(np.diag(cofactor))[: 6 * other.n].reshape(-1, 6)
    np.testing.assert_allclose(a.statistics.photo_sigma, scale, rtol=1e-5)
    with pytest.raises(NotDeterminedError, match="full matrix"):
        a.statistics.cofactors.photo_pair(0, 11)


def test_no_noise_gives_back_the_truth():
    block = make_block(noise=0.0, gnss=0.05, control=4, free=FREE)
    result = adjust_block(block.network)
    assert np.abs(result.centres - block.centres).max() < 1e-6
    assert np.abs(vector_from_rotation(result.rotations @ np.swapaxes(block.rotations, 1, 2))).max() < 1e-8
    assert result.cameras[0].principal_distance_mm == pytest.approx(24.0, abs=1e-7)


def test_lever_arm_shift_drift_and_boresight_are_found():
    block = make_block(columns=5, rows=2, noise=0.0, control=8)
    n = len(block.centres)
    arm, shift, drift = np.array([0.3, -0.2, 0.5]), np.array([[1.0, -2.0, 3.0], [0.5, 0.2, -0.4]]), 0.02
    strip, time = np.repeat([3, 7], 5), np.tile(np.arange(5.0), 2)
    antenna = block.centres + block.rotations @ arm + shift[strip // 7] + drift * (time - 2.0)[:, None]
    positions = Positions(np.arange(n), antenna, 0.02, arm, strip, time, shift=True, drift=True)
    beta = np.array([0.01, -0.02, 0.005])
    attitudes = Attitudes(np.arange(n), block.rotations @ rotation_from_vector(beta), 1e-4, boresight=True)
    result = adjust_block(replace(block.network, positions=positions, attitudes=attitudes))
    values = dict(zip(result.shared_names, result.shared, strict=True))
    assert values["strip 3: shift y"] == pytest.approx(-2.0, abs=1e-6)
    assert values["strip 7: drift z"] == pytest.approx(0.02, abs=1e-6)
    found = vector_from_rotation(result.solution.state.boresight[0])
    np.testing.assert_allclose(found, beta, atol=1e-8)
    s = result.statistics
    total = np.nansum(s.image.redundancy) + np.nansum(s.control.redundancy)
    total += np.nansum(s.positions.redundancy) + np.nansum(s.attitudes.redundancy)
    assert total == pytest.approx(result.redundancy, abs=1e-6)


def test_derivatives_of_navigation_are_those_of_differences():
    """Positions with everything that can be unknown, and attitudes with a boresight, at a state off zero."""
    block = make_block(columns=3, rows=2, per_photo=8)
    n = len(block.centres)
    rng = np.random.default_rng(3)
    positions = Positions(
        np.arange(n), block.centres, 0.02, (0.3, -0.2, 0.5), np.repeat([0, 1], 3), None, True, True,
        lever_arm_sigma=0.1,
    )  # fmt: skip
    turned = rotation_from_vector(0.02 * rng.normal(size=(n, 3))) @ block.rotations
    attitudes = Attitudes(np.arange(n), turned, 1e-3, boresight=True)
    network = replace(block.network, positions=positions, attitudes=attitudes)
    layout = layout_of(network)
    q = len(layout.names)
    none = np.zeros((len(block.points), 3))
    state = moved(start_of(network, layout), layout, np.zeros((n, 6)), none, 0.02 * rng.normal(size=q))
    groups = groups_of(network, layout, state)
    for column in range(6 + q):
        step, shared = np.zeros((n, 6)), np.zeros(q)
        if column < 6:
            step[:, column] = 1e-5
        else:
            shared[column - 6] = 1e-5
        ahead = groups_of(network, layout, moved(state, layout, step, none, shared))
        behind = groups_of(network, layout, moved(state, layout, -step, none, -shared))
        for name, group in groups.items():
            numeric = (behind[name].residual - ahead[name].residual) / 2e-5
            if column < 6:
                exact = group.by_photo[:, :, column]
            else:
                mine = group.columns == column - 6
                exact = np.einsum("gis,gs->gi", group.by_shared, mine)
            # The series of the inverse Jacobian of a rotation ends at the third order of the residual.
            np.testing.assert_allclose(exact, numeric, atol=2e-6)


def test_unknown_lever_arm_is_found():
    """Found beside control; without it as well as a prior and the tilts of the camera tell it."""
    block = make_block(columns=5, rows=2, noise=0.0, control=6)
    n = len(block.centres)
    arm, error = np.array([0.3, -0.2, 0.5]), np.array([0.04, -0.03, 0.06])
    positions = Positions(np.arange(n), block.centres + block.rotations @ (arm + error), 0.02, arm)
    free = replace(positions, lever_arm_sigma=math.inf)
    result = adjust_block(replace(block.network, positions=free))
    at = result.shared_names.index("lever arm x")
    np.testing.assert_allclose(result.shared[at : at + 3], error, atol=1e-7)
    s = result.statistics
    total = sum(np.nansum(part.redundancy) for part in (s.image, s.control, s.positions))
    assert total == pytest.approx(result.redundancy, abs=1e-6)
    held = adjust_block(replace(block.network, positions=positions))
    assert held.sigma0 > result.sigma0
    # Without control only the tilts of a few degrees tell an arm from a shift of the block; a prior holds it.
    prior = replace(positions, lever_arm_sigma=0.1)
    alone, known = (
        adjust_block(replace(block.network, positions=p, control=None), PRIOR) for p in (free, prior)
    )
    assert known.statistics.shared_sigma[at + 2] < 0.1 < alone.statistics.shared_sigma[at + 2]


def test_free_network_is_the_pseudoinverse():
    block = make_block(columns=3, rows=2, per_photo=44)
    result = adjust_block(block.network, PRIOR)
    assert any("inner constraints" in note for note in result.notes)
    other = Dense(block.network)
    state = result.solution.state
    residual, sigma, design = other.at(state.centres, state.rotations, state.points, state.cameras[0])
    n = other.n
    picked = np.ones(other.size, bool)
    picked[: 6 * n] = np.tile([True] * 3 + [False] * 3, n)
    # Bordered with the constraints over centres and points, written down from the similarity itself.
    normal = design.T @ (design / sigma[:, None] ** 2)
    null = np.zeros((other.size, 7))
    for at, place in [(6 * k, c) for k, c in enumerate(state.centres)] + [
        (6 * n + 3 * j, x) for j, x in enumerate(state.points)
    ]:
        x, y, z = (place - state.centres[0]) / 100.0
        null[at : at + 3, :3] = np.eye(3)
        null[at : at + 3, 3:] = [[0.0, z, -y, x], [-z, 0.0, x, y], [y, -x, 0.0, z]]
    for k in range(n):
        null[6 * k + 3 : 6 * k + 6, 3:6] = np.eye(3) / 100.0
    assert np.abs(design @ null).max() < 1e-5 * np.abs(design).max()
    unit = 1.0 / np.sqrt(np.diag(normal))
    # In units of each unknown: the constraint on the corrections themselves is the same one.
    constraint = null * picked[:, None] * unit[:, None]
    constraint /= np.linalg.norm(constraint, axis=0)
    bordered = np.block([[normal * np.outer(unit, unit), constraint], [constraint.T, np.zeros((7, 7))]])
    cofactor = np.linalg.inv(bordered)[: other.size, : other.size]
    size = unit * np.sqrt(np.diag(cofactor))
    np.testing.assert_allclose(result.statistics.photo_sigma.ravel(), size[: 6 * n], rtol=2e-4, atol=1e-9)
    np.testing.assert_allclose(result.statistics.point_sigma.ravel(), size[6 * n :], rtol=2e-4)
    assert result.redundancy == 2 * len(residual) // 2 - other.size + 7
    # Mean motion against the start is none: shift, turn, scale.
    here = np.concatenate([result.centres, result.points])
    there = np.concatenate([block.network.photographs.centres, block.network.points.xyz])
    moves, middle = here - there, there - there.mean(axis=0)
    assert np.abs(moves.mean(axis=0)).max() < 1e-9
    assert np.abs(np.cross(middle, moves).sum(axis=0)).max() < 1e-3 * np.abs(middle).sum()


def test_open_datum_is_refused_where_it_is_not_allowed():
    block = make_block(columns=2, rows=1)
    with pytest.raises(InputError, match="datum; open: shift x"):
        adjust_block(block.network, BlockOptions(free_network="none"))


def test_single_strip_with_positions_only_keeps_what_is_open():
    block = make_block(columns=6, rows=1, gnss=0.02)
    line = block.network.positions.xyz.copy()
    line[:, 0] = line[0, 0]
    line[:, 2] = 100.0
    photographs = replace(block.network.photographs, centres=line)
    network = replace(
        block.network, positions=replace(block.network.positions, xyz=line), photographs=photographs
    )
    result = adjust_block(network)
    assert result.notes == ("datum by inner constraints: open were turn about the line through p0 and p5",)


def test_what_is_open_of_a_datum_is_named_exactly():
    """Two control points leave one turn about their line; one point three turns about it, and the scale."""
    block = make_block(columns=3, rows=2, control=2)
    known = [block.network.points.names[k] for k in block.network.control.point]
    (note,) = adjust_block(block.network).notes
    assert note.startswith("datum by inner constraints: open were turn about the line through ")
    assert all(name in note for name in known)
    control = block.network.control
    one = Control(control.point[:1], control.xyz[:1], control.sigma[:1])
    (note,) = adjust_block(replace(block.network, control=one)).notes
    turns = ", ".join(f"turn {axis} about {known[0]}" for axis in "xyz")
    assert note == f"datum by inner constraints: open were {turns}, scale"


def test_shifts_of_all_strips_without_control_leave_the_place_open_and_move_with_the_block():
    """What does not hang on the datum of them has the covariance of the whole inverse."""
    block = make_block(columns=5, rows=2, gnss=0.05, seed=6)
    strips = np.repeat([0, 1], 5)
    positions = replace(
        block.network.positions, strip=strips, shift=True, strip_names=("north", "south"),
        xyz=block.network.positions.xyz + np.where(strips, 0.7, 0.0)[:, None],
    )  # fmt: skip
    network = replace(block.network, positions=positions)
    result = adjust_block(network, PRIOR)
    (note,) = result.notes
    assert note == "datum by inner constraints: open were shift x, shift y, shift z"
    assert result.shared_names[3] == "strip south: shift x"
    # Put onto its start, the residuals of positions are those of the adjustment, which sum up to none.
    residuals = result.statistics.positions.residuals
    assert np.abs(residuals.reshape(2, 5, 3).sum(axis=1)).max() < 1e-6
    s = result.statistics
    assert np.nansum(s.image.redundancy) + np.nansum(s.positions.redundancy) == pytest.approx(
        result.redundancy, abs=1e-5
    )
    # What does not hang on the datum: the difference of both shifts, with its standard deviation.
    pick = np.zeros((3, 6))
    pick[:, :3], pick[:, 3:] = -np.eye(3), np.eye(3)
    difference = pick @ result.shared
    variance = np.diag(pick @ s.cofactors.shared @ pick.T)
    assert (np.abs(difference - 0.7) < 4.0 * np.sqrt(variance)).all()
    # The same with the whole inverse, of minimal constraints.
    whole = full_covariance(result.solution)[-6:, -6:]
    np.testing.assert_allclose(np.diag(pick @ whole @ pick.T), variance, rtol=1e-6)
    # A shift and the centre of a photograph of its strip move together: their difference is determined.
    k = 7
    apart = (
        s.cofactors.photos[k, :3, :3]
        + s.cofactors.shared[3:6, 3:6]
        + 2 * s.cofactors.photo_shared[k, :3, 3:6]
    )
    held = full_covariance(result.solution)
    rows = np.r_[6 * k : 6 * k + 3, len(held) - 3 : len(held)]
    sum_of = np.concatenate([np.eye(3), np.eye(3)], axis=1)
    expected = np.diag(sum_of @ held[np.ix_(rows, rows)] @ sum_of.T)
    np.testing.assert_allclose(np.diag(apart), expected, rtol=1e-5)


def test_cameras_may_have_lever_arms_and_misalignments_of_their_own():
    block = make_block(columns=5, rows=2, noise=0.0, control=6)
    n, mount = len(block.centres), np.repeat([0, 1], 5)
    arms = np.array([[0.3, -0.2, 0.5], [0.1, 0.4, 0.2]])
    beta = np.array([[0.01, -0.02, 0.005], [-0.003, 0.001, 0.02]])
    antenna = block.centres + np.einsum("nij,nj->ni", block.rotations, arms[mount])
    positions = Positions(
        np.arange(n), antenna, 0.02, lever_arm_sigma=math.inf, mount=mount, mount_names=("nadir", "oblique")
    )
    turned = block.rotations @ rotation_from_vector(beta[mount])
    attitudes = Attitudes(np.arange(n), turned, 1e-4, True, mount=mount, mount_names=("nadir", "oblique"))
    result = adjust_block(replace(block.network, positions=positions, attitudes=attitudes))
    values = dict(zip(result.shared_names, result.shared, strict=True))
    for m, name in enumerate(("nadir", "oblique")):
        found = [values[f"lever arm of {name} {axis}"] for axis in "xyz"]
        np.testing.assert_allclose(found, arms[m], atol=1e-6)
    found = vector_from_rotation(result.solution.state.boresight)
    np.testing.assert_allclose(found, beta, atol=1e-8)


def test_control_by_axis_fixed_and_check_points():
    block = make_block(control=8, gnss=0.05)
    control = block.network.control
    sigma = control.sigma.copy()
    sigma[0, 2] = math.inf
    sigma[1, :2] = math.inf
    sigma[2] = 0.0
    xyz = control.xyz.copy()
    xyz[0, 2] = np.nan
    check = np.zeros(8, bool)
    check[3:5] = True
    network = replace(block.network, control=Control(control.point, xyz, sigma, check=check))
    result = adjust_block(network, PRIOR)
    np.testing.assert_array_equal(result.points[control.point[2]], xyz[2])
    assert np.all(result.statistics.point_sigma[control.point[2]] == 0.0)
    r = result.statistics.control
    assert np.isnan(r.redundancy[0, 2])
    assert np.isfinite(r.redundancy[0, 0])
    assert np.isnan(r.redundancy[3]).all()
    assert np.isfinite(r.residuals[3]).all()
    # A check point's difference agrees with what is stated for it.
    sigma = np.hypot(result.statistics.point_sigma[control.point[3:5]], 0.02)
    assert np.abs(r.residuals[3:5] / sigma).max() < 4.0


def test_correlated_control_is_weighted_with_its_covariance():
    block = make_block(control=5, gnss=0.05)
    control = block.network.control
    diagonal = np.broadcast_to(np.diag([4e-4] * 3), (5, 3, 3))
    same = adjust_block(replace(block.network, control=replace(control, covariance=diagonal)))
    plain = adjust_block(block.network)
    np.testing.assert_allclose(same.centres, plain.centres, atol=1e-9)
    np.testing.assert_allclose(
        same.statistics.control.minimal_detectable, plain.statistics.control.minimal_detectable, rtol=1e-9
    )


def test_observation_outside_its_photograph_is_left_out_and_named():
    block = make_block(gnss=0.05, control=4)
    xy = block.network.image.xy.copy()
    xy[7] = (-500.0, 9000.0)
    result = adjust_block(replace(block.network, image=replace(block.network.image, xy=xy)))
    assert not result.used[7]
    image = block.network.image
    place = f"t{image.point[7]} in p{image.photo[7]}"
    assert result.notes == (f"1 image observations left out, outside their photograph: {place}",)
    assert result.sigma0 < 1.2


def test_points_seen_once_and_unordered_input_change_nothing():
    block = make_block(gnss=0.05, control=4)
    image, points = block.network.image, block.network.points
    plain = adjust_block(block.network)
    more = Network(
        block.network.cameras,
        block.network.photographs,
        replace(points, names=(*points.names, "lonely"), xyz=np.vstack([points.xyz, [10.0, 10.0, 0.0]])),
        ImagePoints(
            np.append(image.photo, 0)[::-1],
            np.append(image.point, len(points.names))[::-1],
            np.vstack([image.xy, [3000.0, 2000.0]])[::-1],
            0.5,
        ),
        block.network.control,
        block.network.positions,
    )
    result = adjust_block(more)
    assert not result.used[0]
    assert np.isnan(result.points[-1]).all()
    np.testing.assert_allclose(result.centres, plain.centres, atol=1e-8)
    assert result.redundancy == plain.redundancy


def test_damping_brings_a_bad_start_home():
    block = make_block(gnss=0.5, control=4, start=(15.0, 0.2), seed=3)
    near = adjust_block(make_block(gnss=0.5, control=4, seed=3).network)
    far = adjust_block(block.network, BlockOptions(max_iterations=200))
    assert far.converged
    assert far.damped > 0
    assert far.sigma0 == pytest.approx(near.sigma0, rel=1e-6)


@pytest.mark.parametrize("robust", ["snooping", "l1"])
def test_gross_errors_in_all_kinds_are_found(robust):
    block = make_block(columns=4, rows=4, per_photo=60, gnss=0.05, control=8)
    rng = np.random.default_rng(5)
    image = block.network.image
    bad = rng.random(len(image.photo)) < 0.03
    direction = rng.normal(size=(len(bad), 2))
    direction *= (rng.uniform(10.0, 500.0, len(bad)) / np.linalg.norm(direction, axis=1))[:, None]
    xy = np.where(bad[:, None], image.xy + direction, image.xy)
    positions, control = block.network.positions, block.network.control
    place, ground = positions.xyz.copy(), control.xyz.copy()
    place[5, 2] += 3.0
    ground[2, 0] -= 2.0
    network = replace(
        block.network,
        image=replace(image, xy=xy),
        positions=replace(positions, xyz=place),
        control=replace(control, xyz=ground),
    )
    result = adjust_block(network, BlockOptions(robust=robust, scale_by="prior"))
    clean = adjust_block(block.network, PRIOR)
    controlled = (clean.statistics.image.minimal_detectable * 1.5 < np.abs(direction)).any(axis=1)
    assert not np.any(result.used & bad & controlled)
    assert result.test.passed
    others = {(g.kind, g.row): g for g in result.gross_errors if g.kind != "image"}
    assert set(others) == {("positions", 5), ("control", 2)}
    assert others["positions", 5].size[2] == pytest.approx(3.0, abs=0.3)
    assert others["control", 2].size[0] == pytest.approx(-2.0, abs=0.3)
    # A good observation is lost only where two rays leave open which of them is wrong, or by chance.
    rays = np.bincount(image.point[~bad])[image.point]
    good = ~bad & (rays > 2)
    assert np.count_nonzero(~result.used[good]) <= binom.ppf(0.999, good.sum(), 2 * 0.001)


def test_huber_stays_near_with_gross_errors():
    block = make_block(columns=4, rows=3, gnss=0.05, control=4)
    xy = block.network.image.xy.copy()
    xy[::40] += 60.0
    network = replace(block.network, image=replace(block.network.image, xy=xy))
    plain = adjust_block(network, BlockOptions(statistics=False))
    robust = adjust_block(network, BlockOptions(statistics=False, robust="huber"))
    error = [np.abs(a.centres - block.centres).max() for a in (plain, robust)]
    assert error[1] < 0.4 * error[0]


def test_inseparable_principal_distance_is_named():
    block = make_block(columns=4, rows=3, control=6, free={"principal_distance_mm": math.inf}, seed=2)
    flat = block.points.copy()
    flat[:, 2] = 0.0
    camera, photos = block.network.cameras[0].camera, block.network.image.photo
    level = np.broadcast_to(np.eye(3), block.rotations.shape)
    local = flat[block.network.image.point] - block.centres[photos]
    pixels, _ = camera.image_from_camera(local)
    rng = np.random.default_rng(1)
    network = replace(
        block.network,
        image=replace(block.network.image, xy=pixels + 0.3 * rng.normal(size=pixels.shape)),
        control=replace(block.network.control, xyz=flat[block.network.control.point]),
        photographs=replace(block.network.photographs, rotations=level),
    )
    result = adjust_block(network)
    assert any("not separable" in note for note in result.notes)


def test_wrong_input_is_named():
    block = make_block(columns=2, rows=1)
    image = block.network.image
    with pytest.raises(InputError, match="observed twice in p"):
        replace(block.network, image=ImagePoints(
            np.append(image.photo, image.photo[0]), np.append(image.point, image.point[0]),
            np.vstack([image.xy, image.xy[:1]]), 0.5,
        ))  # fmt: skip
    with pytest.raises(InputError, match=r"free\.focal"):
        BlockCamera(block.network.cameras[0].camera, {"focal": 1.0})
    with pytest.raises(InputError, match="two cameras of one name"):
        replace(block.network, cameras=block.network.cameras * 2)
    with pytest.raises(InputError, match=r"tests\.alpha"):
        TestOptions(alpha=0.0)


def test_weak_datum_converges():
    """Tilts that positions of 10 m hardly hold: steps are long, and their path bends."""
    lens = {"k1": 0.2, "k2": 0.2}
    block = make_block(columns=3, rows=2, per_photo=60, seed=4, sigma=0.3, gnss=10.0, free=lens)
    result = adjust_block(block.network, BlockOptions(statistics=False))
    assert result.converged
    # One and the same minimum from elsewhere: the truth.
    known = block.network.moved_to(block.centres, block.rotations, block.points)
    again = adjust_block(known, BlockOptions(statistics=False))
    assert again.converged
    assert again.solution.cost == pytest.approx(result.solution.cost, rel=1e-9)
