"""Start of a block without approximate values, against blocks whose truth is known."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import pytest

from stereomate.block.joining import join
from stereomate.block.models import BlockImages, JoiningOptions, PairPose
from stereomate.block.start import KnownPoints, KnownPositions, find_start
from stereomate.block.start_datum import Places, find_datum
from stereomate.block.start_pairs import Approximation, PairOptions, select_pairs
from stereomate.camera.model import Camera
from stereomate.errors import NotDeterminedError
from stereomate.geometry.rotations import rotation_angle, rotation_from_opk, rotation_from_vector
from stereomate.geometry.similarity import estimate_space_transform
from stereomate.measurement.tracks import TiePoints
from stereomate.relative.pair import RelativePose

CAMERA = Camera.from_pixel_pitch("c", (4000, 3000), 10.0, 0.003)
HEIGHT, BASE = 100.0, 45.0


@dataclass(frozen=True)
class Truth:
    centres: np.ndarray
    rotations: np.ndarray
    ground: np.ndarray
    ties: TiePoints
    pairs: tuple[PairPose, ...]


def block(
    strips: int = 3,
    per_strip: int = 6,
    seed: int = 0,
    spacing: float = 55.0,
    noise: float = 0.3,
    count: int = 700,
) -> Truth:
    """Strips flown to and fro over rough ground, measured with noise."""
    rng = np.random.default_rng(seed)
    centres, rotations = [], []
    for strip, k in itertools.product(range(strips), range(per_strip)):
        along = k if strip % 2 == 0 else per_strip - 1 - k
        heading = 0.0 if strip % 2 == 0 else np.pi
        centres.append(np.array([along * BASE, strip * spacing, HEIGHT]) + rng.normal(0, 2.0, 3))
        rotations.append(rotation_from_opk([*rng.normal(0, 0.03, 2), heading + rng.normal(0, 0.05)]))
    centres, rotations = np.array(centres), np.array(rotations)
    ground = rng.uniform([-60, -50, -12], [per_strip * BASE + 20, strips * spacing + 10, 12], (count, 3))
    point, photo, pixels = [], [], []
    for j, (centre, rotation) in enumerate(zip(centres, rotations, strict=True)):
        seen, inside = CAMERA.image_from_camera((ground - centre) @ rotation)
        rows = np.flatnonzero(inside)
        point += rows.tolist()
        photo += [j] * len(rows)
        pixels += (seen[rows] + rng.normal(0, noise, (len(rows), 2))).tolist()
    order = np.lexsort((photo, point))
    point, photo, pixels = np.array(point)[order], np.array(photo)[order], np.array(pixels)[order]
    ties = TiePoints(
        tuple(f"p{j}" for j in range(len(centres))), point, photo, pixels,
        np.full(len(point), noise), np.full(len(point), -1),
    ).with_rays(2).numbered()  # fmt: skip
    pairs = []
    for a, b in itertools.combinations(range(len(centres)), 2):
        common = np.intersect1d(ties.point[ties.photo == a], ties.point[ties.photo == b])
        if len(common) >= 30:
            pose = RelativePose.from_exterior(centres[a], rotations[a], centres[b], rotations[b])
            wobble = rotation_from_vector(rng.normal(0, 3e-4, 3))
            base = rotation_from_vector(rng.normal(0, 1e-3, 3)) @ pose.base
            pairs.append(PairPose(a, b, base, wobble @ pose.left_from_right))
    return Truth(centres, rotations, ground, ties, tuple(pairs))


@pytest.fixture(scope="module")
def truth() -> Truth:
    return block()


def cameras(truth: Truth) -> list[Camera]:
    return [CAMERA] * len(truth.centres)


def test_joined_from_pairs_and_placed_by_positions(truth: Truth) -> None:
    """All photographs, those flown the other way too, to what the noise of the measurements allows."""
    rng = np.random.default_rng(5)
    gnss = truth.centres + rng.normal(0, 0.5, truth.centres.shape)
    gnss[4] += [40.0, -25.0, 10.0]
    start = find_start(truth.ties, cameras(truth), truth.pairs, KnownPositions(gnss, (0.5, 0.5, 0.5)))
    (part,) = start.parts
    assert not start.reasons
    assert part.datum.kind == "positions"
    assert part.datum.outliers == ("4",)
    shift = part.centres - truth.centres
    # 17 positions of 0.5 m: the datum itself is known to a decimetre or two, the model is far better.
    assert np.abs(shift).max() < 1.0
    turns = [rotation_angle(a.T @ b) for a, b in zip(part.rotations, truth.rotations, strict=True)]
    assert max(turns) < 0.01
    known = np.isfinite(part.points[:, 0])
    assert known.mean() > 0.95


def test_a_growing_block_does_not_drift() -> None:
    """Adjusted while it grows it keeps its form; by resection and intersection alone it bends."""
    truth = block(per_strip=8, noise=2.0, count=500, seed=1)
    worst = []
    for adjuster in (None, lambda images: lambda model: None):
        (part,) = find_start(truth.ties, cameras(truth), truth.pairs, adjuster=adjuster).parts
        found = estimate_space_transform(part.centres[part.photos], truth.centres[part.photos])
        worst.append(np.abs(found.residuals).max())
    assert worst[0] < 0.5 * worst[1]


def test_gross_errors_are_left_out_on_the_way(truth: Truth) -> None:
    """One in fifty measurements is 30 px or more wrong: they are not used, the orientation is as good."""
    rng = np.random.default_rng(2)
    ties = truth.ties
    bad = rng.choice(len(ties), len(ties) // 50, replace=False)
    pixels = ties.pixels.copy()
    pixels[bad] += rng.choice([-1, 1], (len(bad), 2)) * rng.uniform(30, 400, (len(bad), 2))
    wrong = TiePoints(ties.photographs, ties.point, ties.photo, pixels, ties.sigma_px, ties.feature)
    start = find_start(wrong, cameras(truth), truth.pairs, KnownPositions(truth.centres, (0.1, 0.1, 0.1)))
    part = start.parts[0]
    assert len(part.photos) == len(truth.centres)
    assert np.abs(part.centres - truth.centres).max() < 0.8
    used = part.used[bad]
    # An error along the ray of a two-ray point stays inside its epipolar plane: nothing shows it.
    assert used.mean() < 0.25
    good = np.ones(len(ties), dtype=bool)
    good[bad] = False
    assert part.used[good].mean() > 0.9


def test_a_photograph_without_ties_and_one_with_wrong_ones_say_why() -> None:
    # Dense enough that the rest holds together without the two.
    truth = block(count=1100)
    ties = truth.ties
    rng = np.random.default_rng(0)
    pixels = ties.pixels.copy()
    mine = ties.photo == 7
    pixels[mine] = rng.uniform(0, 3000, (int(mine.sum()), 2))
    wrong = TiePoints(ties.photographs, ties.point, ties.photo, pixels, ties.sigma_px, ties.feature)
    wrong = wrong.select(wrong.photo != 3)
    pairs = [pair for pair in truth.pairs if not {3, 7} & {pair.first, pair.second}]
    start = find_start(wrong, cameras(truth), pairs, KnownPositions(truth.centres, (0.1, 0.1, 0.1)))
    assert set(start.reasons) == {3, 7}
    assert "no tie points" in start.reasons[3]
    assert "agree with the model" in start.reasons[7]
    assert len(start.parts[0].photos) == len(truth.centres) - 2


def test_a_block_that_falls_apart_gives_its_parts() -> None:
    """Two strips too far apart to share ground: two parts, both brought to the same datum."""
    truth = block(strips=2, spacing=400.0, seed=3, count=3000)
    start = find_start(
        truth.ties, cameras(truth), truth.pairs, KnownPositions(truth.centres, (0.1, 0.1, 0.1))
    )
    assert sorted(sorted(part.photos.tolist()) for part in start.parts) == [
        list(range(6)),
        list(range(6, 12)),
    ]
    for part in start.parts:
        assert np.abs(part.centres[part.photos] - truth.centres[part.photos]).max() < 1.5


def test_nothing_to_begin_with(truth: Truth) -> None:
    with pytest.raises(NotDeterminedError, match="no pair of photographs gives a model"):
        find_start(truth.ties, cameras(truth), ())


def test_control_points_determine_the_datum_and_one_with_swapped_coordinates_is_named(truth: Truth) -> None:
    rng = np.random.default_rng(8)
    # Signals stand where several photographs see them.
    rays = sum(
        CAMERA.image_from_camera((truth.ground - c) @ r)[1].astype(int)
        for c, r in zip(truth.centres, truth.rotations, strict=True)
    )
    chosen = rng.choice(np.flatnonzero(rays >= 3), 8, replace=False)
    xyz = truth.ground[chosen] + rng.normal(0, 0.02, (8, 3))
    xyz[2, :2] = xyz[2, 1::-1]
    point, photo, pixels = [], [], []
    for j, (centre, rotation) in enumerate(zip(truth.centres, truth.rotations, strict=True)):
        seen, inside = CAMERA.image_from_camera((truth.ground[chosen] - centre) @ rotation)
        for k in np.flatnonzero(inside):
            point.append(k)
            photo.append(j)
            pixels.append(seen[k])
    control = KnownPoints(
        tuple("ABCDEFGH"), xyz, np.full((8, 3), 0.02), np.array(point), np.array(photo), np.array(pixels)
    )
    start = find_start(truth.ties, cameras(truth), truth.pairs, None, control)
    part = start.parts[0]
    assert part.datum.kind == "control"
    assert part.datum.outliers == ("C",)
    assert np.abs(part.centres - truth.centres).max() < 0.8


def test_a_single_strip_is_levelled_by_its_photographs() -> None:
    """Positions on a line leave the tilt about it open: the mean camera axis stands in, and it is said."""
    truth = block(strips=1, per_strip=7, seed=4)
    line = truth.centres.copy()
    line[:, 1:] = line[:, 1:].mean(axis=0)
    start = find_start(truth.ties, cameras(truth), truth.pairs, KnownPositions(line, (1.0, 1.0, 1.0)))
    datum = start.parts[0].datum
    assert "plumb line" in datum.notes[0]
    turns = [rotation_angle(a.T @ b) for a, b in zip(start.parts[0].rotations, truth.rotations, strict=True)]
    # Seven photographs tilted by 0.03 rad: their mean axis is vertical to 0.03 / sqrt(7).
    assert max(turns) < 0.05


def test_without_any_datum_the_model_is_level_and_says_so(truth: Truth) -> None:
    start = find_start(truth.ties, cameras(truth), truth.pairs)
    part = start.parts[0]
    assert part.datum.kind == "none"
    assert "arbitrary" in part.datum.notes[0]
    axis = part.rotations[:, :, 2].mean(axis=0)
    assert axis[2] / np.linalg.norm(axis) > 0.9999


def test_plan_and_height_control_determine_a_datum_together() -> None:
    """Two points in plan and one height, with the photographs' vertical: scale, direction and place."""
    rng = np.random.default_rng(1)
    model = rng.uniform(-1, 1, (3, 3))
    turned = rotation_from_opk([0.0, 0.0, 0.7])
    target = 50.0 * model @ turned.T + [100.0, 200.0, 30.0]
    target[:2, 2] = np.nan
    target[2, :2] = np.nan
    places = Places("control", ("a", "b", "c"), model, target, np.full((3, 3), 0.01))
    datum = find_datum(np.repeat(np.eye(3)[None], 4, axis=0), (places,))
    assert datum.transform.scale == pytest.approx(50.0)
    np.testing.assert_allclose(datum.transform.rotation, turned, atol=1e-12)
    np.testing.assert_allclose(datum.transform.translation, [100.0, 200.0, 30.0], atol=1e-9)


def test_models_that_share_points_are_joined_by_a_similarity(truth: Truth) -> None:
    """Nothing but pairs inside two halves: photographs between them are added by resection all the same."""
    images = BlockImages(
        len(truth.centres),
        truth.ties.count,
        truth.ties.photo,
        truth.ties.point,
        CAMERA.rays_from_image(truth.ties.pixels)[:, :2],
        np.full(len(truth.ties), 0.3 * 0.003 / 10.0),
    )
    halves = [p for p in truth.pairs if (p.first < 9) == (p.second < 9)]
    joining = join(images, halves, lambda model: None, JoiningOptions(limit_sigmas=20.0))
    assert len(joining.models) == 1
    assert joining.models[0].joined.all()


def test_pairs_by_footprints_by_distance_and_each_with_each(truth: Truth) -> None:
    known = Approximation(truth.centres, truth.rotations, 0.0)
    wanted = {(p.first, p.second) for p in truth.pairs}
    chosen = select_pairs(cameras(truth), known)
    assert chosen is not None
    assert wanted <= set(chosen.pairs)
    assert len(chosen.pairs) < len(truth.centres) * (len(truth.centres) - 1) / 2
    nothing = np.full_like(truth.rotations, np.nan)
    small = PairOptions(exhaustive=3)
    by_distance = select_pairs(cameras(truth), Approximation(truth.centres, nothing, 0.0), small)
    assert by_distance is not None
    assert wanted <= set(by_distance.pairs)
    nearest = select_pairs(cameras(truth), Approximation(truth.centres, nothing), small)
    assert nearest is not None
    assert len(nearest.pairs) <= 14 * len(truth.centres)
    without = Approximation(np.full_like(truth.centres, np.nan), nothing)
    everything = select_pairs(cameras(truth), without)
    assert everything is not None
    assert len(everything.pairs) == 18 * 17 // 2
    assert select_pairs(cameras(truth), without, small) is None
