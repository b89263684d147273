"""Fixed orientations: software that takes the grid as Cartesian gets right points from them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stereomate.errors import InputError
from stereomate.frames.fixing import ImageRays, fixed_block
from stereomate.frames.prediction.plan import FlightPlan, simulated_block
from stereomate.frames.refraction import refraction_corrected
from stereomate.frames.remedies import GridBlock, cartesian_from_map
from stereomate.frames.transform import map_from_tangent
from stereomate.geometry.intersection import Rays, intersect_rays


@pytest.fixture(scope="module")
def world():
    plan = FlightPlan("EPSG:25832", 600_000.0, 5_400_000.0, 1500.0, 300.0, 100.0, tilt_deg=0.5)
    block = simulated_block(plan)
    rays = ImageRays(block.point_of, block.photo_of, block.xy / 0.15, len(block.points))
    truth = cartesian_from_map(plan.frame, map_from_tangent(plan.tangent, plan.frame, block.points))
    count = len(block.centres)
    return (
        plan,
        GridBlock(plan.tangent, plan.frame, block.centres, block.rotations, np.ones(count)),
        rays,
        truth,
    )


def cartesian_points(fixed, rays):
    """What software makes of it that knows no Earth."""
    p = rays.photo_of
    made = Rays(
        rays.point_of,
        fixed.centres[p],
        fixed.rotations[p],
        fixed.image / fixed.c_factor[p, None],
        np.full(len(p), 1e-4),
    )
    return intersect_rays(made, rays.count).points


@pytest.mark.parametrize(
    ("remedy", "per_image", "worst"),
    [("M2", False, 0.02), ("M3", False, 0.03), ("M3", True, 0.03), ("M4", False, 1e-4)],
)
def test_software_in_the_grid_gets_right_points(world, remedy, per_image, worst):
    plan, block, rays, truth = world
    fixed = fixed_block(block, rays, remedy, per_image=per_image)
    found = cartesian_points(fixed, rays)
    if remedy == "M2":
        found[:, 2] /= fixed.scale[0]
    error = np.abs(found - truth)
    assert np.nanmax(error) < worst
    assert fixed.scale.mean() == pytest.approx(plan.tau_e, abs=2e-5)
    assert fixed.ground_m == pytest.approx(350.0, abs=30.0)


def test_without_a_remedy_the_points_are_wrong(world):
    _, block, rays, truth = world
    fixed = fixed_block(block, rays, "M4")
    untouched = intersect_rays(
        Rays(rays.point_of, fixed.centres[rays.photo_of], fixed.rotations[rays.photo_of], rays.image,
             np.full(len(rays.photo_of), 1e-4)),
        rays.count,
    ).points  # fmt: skip
    assert np.nanmedian((untouched - truth)[:, 2]) > 0.4


def test_refraction_is_taken_out_first(world):
    """As if the observations had been made in a vacuum: corrected with the true heights of their points."""
    _, block, rays, truth = world
    p = rays.photo_of
    heights = block.grid_centres[p, 2], truth[rays.point_of, 2]
    in_vacuum = refraction_corrected(rays.image, 1.0, block.grid_rotations[p], *heights, "icao")
    shift = np.abs(in_vacuum - rays.image).max()
    assert 1e-6 < shift < 1e-4
    expected = fixed_block(block, replace(rays, image=in_vacuum), "M4").image
    found = fixed_block(block, rays, "M4", refraction="icao").image
    # The heights it was taken at are those of refracted rays: 2 cm in 1500 m.
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-4 * shift)
    with pytest.raises(InputError, match="icao, ardc or none"):
        fixed_block(block, rays, "M4", refraction="moon")


def test_what_cannot_be_fixed(world):
    _, block, rays, _ = world
    with pytest.raises(InputError, match="must be one of M2, M3, M4"):
        fixed_block(block, rays, "M5")
    with pytest.raises(InputError, match="M3 only"):
        fixed_block(block, rays, "M2", per_image=True)
    none = ImageRays(rays.point_of[:0], rays.photo_of[:0], rays.image[:0], 1)
    with pytest.raises(InputError, match="no point is seen twice"):
        fixed_block(block, none, "M2")
    assert fixed_block(block, none, "M2", 300.0).image.shape == (0, 2)
