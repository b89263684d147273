"""Audit: orientations spoilt on purpose in known ways are found out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stereomate.camera.model import Camera
from stereomate.errors import InputError
from stereomate.frames.adjusted import grid_from_space_centres
from stereomate.frames.attitude import AttitudeConvention, rotation_tangent_from_axes, written_attitude
from stereomate.frames.audit.findings import audit
from stereomate.frames.audit.observations import AuditObservations, WrittenBlock
from stereomate.frames.audit.ranking import pattern_slope
from stereomate.frames.audit.readings import HeightCandidate
from stereomate.frames.audit.vertical import vertical_names
from stereomate.frames.heights import HeightSystem
from stereomate.frames.prediction.plan import FlightPlan, simulated_block
from stereomate.frames.transform import map_from_tangent, tangent_from_map
from stereomate.geometry.rotations import rotation_z

GRID = AttitudeConvention("opk", "grid")
GROUND = 300.0
C_PX = 10000.0
ELLIPSOIDAL = HeightCandidate("ellipsoidal", "ellipsoidal heights", HeightSystem.ellipsoidal())


@pytest.fixture(scope="module")
def world():
    """Fifteen photographs 1500 m above UTM ground near the edge of the zone, noise of 0.3 px."""
    plan = FlightPlan(
        "EPSG:25832", 600_000.0, 5_400_000.0, 1500.0, GROUND, 100.0, heading_deg=70.0, tilt_deg=2.0
    )
    block = simulated_block(plan)
    random = np.random.default_rng(5)
    image = block.xy / (1e-3 * plan.principal_distance_mm)
    image = image + random.normal(0.0, 0.3 / C_PX, image.shape)
    reference = map_from_tangent(plan.tangent, plan.frame, block.points)
    reference[~block.control] = np.nan
    observations = AuditObservations(
        block.point_of,
        block.photo_of,
        image,
        np.full(len(image), C_PX),
        tuple(map(str, range(len(reference)))),
        reference,
        block.control,
    )
    return plan, block, observations


def written(world, convention, *, positions=None, rotations=None, read_as=GRID):
    plan, block, _ = world
    centres = map_from_tangent(plan.tangent, plan.frame, block.centres)
    turned = block.rotations if rotations is None else rotations
    attitudes = written_attitude(turned, convention, plan.tangent, block.centres, plan.frame)
    return WrittenBlock(plan.crs, centres if positions is None else positions, attitudes, read_as)


def result_of(world, block, observations=None, candidates=(ELLIPSOIDAL,)):
    return audit(block, observations or world[2], candidates, candidates)


def finding(result, key):
    return next(f for f in result.findings if key in f.key)


def test_true_positions(world):
    result = result_of(world, written(world, GRID))
    assert result.best.work == "space"
    assert finding(result, "adjusted_in").value == '"space"'
    assert finding(result, "adjusted_in").sure == "very likely"  # 0.5 m, GSD 0.15 m
    assert finding(result, "photos.angles").value == '"grid"'
    assert result.best.control.count == 15
    assert np.abs(result.best.control.mean).max() < 0.03
    # The other way heights would be off by (tau_e - 1) H, which is what the audit says.
    plan = world[0]
    assert result.scale_excess_m == pytest.approx((plan.tau_e - 1.0) * 1500.0, rel=0.02)
    assert abs(result.turn.about_deg[2]) < 4 * result.turn.sigma_deg[2]
    assert np.all(np.array(result.turn.sigma_deg) < 0.01)


def test_adjusted_in_the_grid(world):
    plan, block, _ = world
    centres = map_from_tangent(plan.tangent, plan.frame, block.centres)
    adjusted = grid_from_space_centres(plan.frame, centres, GROUND)
    result = result_of(world, written(world, GRID, positions=adjusted))
    assert finding(result, "adjusted_in").value == '"grid"'
    assert result.best.work in ("adjusted", "curvature")
    true_reading = next(h for h in result.ranked if h.work == "space")
    assert true_reading.control.mean[2] == pytest.approx(result.scale_excess_m, abs=0.02)
    assert any("look the same" in line for line in result.undecided)


@pytest.mark.parametrize(
    ("convention", "name", "key", "value"),
    [
        (AttitudeConvention("opk", "local"), "about true north", "photos.angles", '"local"'),
        (AttitudeConvention("opk", "grid", "gon"), "angles in gon", "photos.angle_unit", '"gon"'),
        (
            AttitudeConvention("pok", "grid"),
            "phi-omega-kappa",
            "photos.angle_order",
            '"phi-omega-kappa"',
        ),
    ],
)
def test_angles_that_mean_something_else(world, convention, name, key, value):
    block = written(world, convention)
    if convention.kind == "pok":
        block = replace(block, attitudes=block.attitudes[:, [1, 0, 2]])  # the columns are named as they are
    result = result_of(world, block)
    assert name in result.attitudes[0].reading.name
    assert finding(result, key).value == value
    assert finding(result, "photos.angles").sure == "practically certain"


def test_convergence_of_the_wrong_sign(world):
    plan, block, _ = world
    up = rotation_tangent_from_axes("local", plan.tangent, block.centres, plan.frame)
    wrong = up @ rotation_z(-2.0 * plan.convergence) @ np.swapaxes(up, -1, -2) @ block.rotations
    result = result_of(world, written(world, GRID, rotations=wrong))
    assert "wrong sign" in result.attitudes[0].reading.name
    assert result.turn.about_deg[2] == pytest.approx(2.0 * np.rad2deg(plan.convergence), abs=0.05)
    assert finding(result, "photos").value.startswith("#")


@pytest.mark.parametrize("angle", [90, 180, 270])
def test_pixels_that_are_turned(world, angle):
    """The key is that of a camera whose stored pixels are turned clockwise."""
    _, _, observations = world
    camera = Camera.from_pixel_pitch("made", (1000, 1000), 50.0, 0.1, rotation=angle)
    upright = Camera.from_pixel_pitch("upright", (1000, 1000), 50.0, 0.1)
    rays = np.column_stack([observations.image, -np.ones(len(observations.image))])
    stored, _ = camera.image_from_camera(rays)
    wrongly = replace(observations, image=upright.rays_from_image(stored)[:, :2])
    result = result_of(world, written(world, GRID), wrongly)
    assert f"turned by {angle}" in result.attitudes[0].reading.name
    assert finding(result, "camera.rotation").value == str(angle)


def test_heights_in_feet(world):
    plan, block, _ = world
    feet = HeightCandidate("feet", "heights in feet", HeightSystem.ellipsoidal(unit_m=0.3048))
    centres = map_from_tangent(plan.tangent, plan.frame, block.centres)
    centres[:, 2] /= 0.3048
    result = result_of(world, written(world, GRID, positions=centres), candidates=(ELLIPSOIDAL, feet))
    assert finding(result, "photos.heights").value == '"feet"'
    assert finding(result, "control.heights").value == '"ellipsoidal"'
    assert result.explained


def test_several_errors_at_once(world):
    """Gon for degrees, phi first, about true north, pixels turned by 180, heights in feet: all named."""
    plan, block, observations = world
    feet = ELLIPSOIDAL.in_unit(0.3048, "feet")
    centres = map_from_tangent(plan.tangent, plan.frame, block.centres)
    centres[:, 2] += 40.0 * np.sin(np.arange(len(centres)))  # photographs of one flight are not all level
    spoilt = replace(
        written(world, AttitudeConvention("pok", "local", "gon"), positions=centres),
        convention=GRID,
    )
    spoilt = replace(spoilt, attitudes=spoilt.attitudes[:, [1, 0, 2]])
    # Images that belong to those centres, seen by a camera whose pixels are stored upside down.
    true = tangent_from_map(plan.tangent, plan.frame, centres)
    photo, point = observations.photo_of, observations.point_of
    rays = np.einsum("mji,mj->mi", block.rotations[photo], block.points[point] - true[photo])
    turned = replace(observations, image=-(rays[:, :2] / -rays[:, 2:]))
    spoilt.positions[:, 2] /= 0.3048
    result = result_of(world, spoilt, turned, (ELLIPSOIDAL, feet))
    assert result.attitudes[0].total_px < 0.01
    says = {f.key: f for f in result.findings}
    assert says["photos.angles"].value == '"local"'
    assert says["photos.angle_unit"].value == '"gon"'
    assert says["photos.angle_order"].value == '"phi-omega-kappa"'
    assert says["camera.rotation"].value == "180"
    assert "feet" in says["photos.heights"].value
    assert says["control.heights"].value == '"ellipsoidal"'
    assert says["photos.adjusted_in"].value == '"space"'
    assert result.explained
    assert np.abs(result.best.control.mean).max() < 0.01


@pytest.mark.slow
def test_an_error_no_key_can_say_beside_one_that_can(world):
    spoilt = written(world, AttitudeConvention("opk", "grid", "gon"))
    result = result_of(world, replace(spoilt, attitudes=spoilt.attitudes * np.array([1.0, 1.0, -1.0])))
    assert result.attitudes[0].reading.mistakes == 2
    assert finding(result, "no key").value == "# kappa counts clockwise"
    assert finding(result, "photos.angle_unit").value == '"gon"'


def test_a_shift_that_no_candidate_explains(world):
    plan, block, _ = world
    centres = map_from_tangent(plan.tangent, plan.frame, block.centres)
    centres[:, 2] -= 47.3
    result = result_of(world, written(world, GRID, positions=centres))
    assert not result.explained
    assert result.best.control.mean[2] == pytest.approx(-47.3, abs=0.5)
    assert finding(result, "photos.heights").sure == "undecided"
    assert finding(result, "adjusted_in").sure == "undecided"
    assert finding(result, "photos.angles").sure == "practically certain"
    assert any("no pair of height systems" in line for line in result.undecided)
    assert any("DHHN2016" in name for name in vertical_names(11.6, 48.7))


def test_without_known_points(world):
    observations = replace(world[2], reference=np.full_like(world[2].reference, np.nan))
    result = result_of(world, written(world, GRID), observations)
    assert [f.key for f in result.findings] == ["photos.angles"]
    assert any("without points of known ground" in line for line in result.undecided)
    assert result.scale_excess_m != 0.0


def test_what_cannot_be_audited(world):
    observations = world[2]
    first = np.unique(observations.point_of, return_index=True)[1]
    single = replace(
        observations,
        point_of=observations.point_of[first],
        photo_of=observations.photo_of[first],
        image=observations.image[first],
        c_px=observations.c_px[first],
    )
    with pytest.raises(InputError, match="seen in two photographs"):
        result_of(world, written(world, GRID), single)
    with pytest.raises(InputError, match="must have shape"):
        replace(observations, c_px=np.ones(3))


@pytest.mark.slow
def test_attitudes_that_nothing_explains(world):
    """Attitudes at random: what fits best is not called certain."""
    random = np.random.default_rng(8)
    block = written(world, GRID)
    turned = replace(block, attitudes=block.attitudes + random.normal(0.0, 1.0, block.attitudes.shape))
    result = result_of(world, turned)
    assert result.attitudes[0].total_px > 20.0
    assert {f.sure for f in result.findings} <= {"undecided", "likely"}
    assert any("miss each other" in line for line in result.undecided)


def test_slope_of_a_pattern():
    random = np.random.default_rng(3)
    pattern = np.linspace(0.3, 0.5, 200)
    noise = random.normal(0.0, 0.01, 200)
    follows, constant = pattern_slope(pattern + noise, pattern), pattern_slope(0.4 + noise, pattern)
    assert follows.told
    assert follows.slope == pytest.approx(1.0, abs=3 * follows.sigma)
    assert constant.slope == pytest.approx(0.0, abs=3 * constant.sigma)
    assert pattern_slope(noise, np.full(200, 0.4)) is None
    assert pattern_slope(noise[:5], pattern[:5]) is None
