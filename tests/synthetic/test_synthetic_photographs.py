"""Photographs show what the geometry says, to a fraction of a pixel, and look like photographs."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from stereomate.frames.attitude import AttitudeConvention, object_from_camera
from stereomate.synthetic.options import SurveyOptions
from stereomate.synthetic.render import render_photograph
from stereomate.synthetic.survey import make_survey
from stereomate.tiles.executor import Threads


@pytest.fixture(scope="module")
def photographs(small_survey):
    return [small_survey.render(number) for number in range(len(small_survey.survey.photographs))]


def test_pixel_ray_and_projection_are_inverse(small_survey):
    world = small_survey.world
    rng = np.random.default_rng(1)
    for number, photograph in enumerate(small_survey.survey.photographs):
        pixels = rng.uniform(0.0, 1.0, (1000, 2)) * photograph.camera.size_px
        rays = photograph.camera.rays_from_image(pixels) @ photograph.orientation.object_from_camera.T
        hits = world.first_hit(np.array(photograph.orientation.centre), rays)
        again, inside = small_survey.project(number, hits.points)
        assert inside.all()
        # 1e-7 m of the polynomial and 1e-9 of map coordinates are 1e-6 px
        assert np.abs(again - pixels).max() < 1e-6


def test_projection_by_hand_with_opencv(small_survey):
    """The whole chain without our camera and attitude code: OpenCV's projection instead."""
    options, number = small_survey.options, 4
    photograph = small_survey.survey.photographs[number]
    ground = small_survey.world.on_ground(
        np.array(options.centre) + np.random.default_rng(0).uniform(-100.0, 100.0, (200, 2))
    )
    rotation = np.array(photograph.orientation.object_from_camera) @ np.diag([1.0, -1.0, -1.0])
    camera_points = (small_survey.world.tangent_from_map(ground) - photograph.orientation.centre) @ rotation
    focal = options.principal_distance_mm / options.pixel_pitch_mm
    offset = np.array(options.principal_point_mm) / options.pixel_pitch_mm
    size = np.array(options.size_px)
    # OpenCV counts from the centre of the first pixel
    matrix = np.array(
        [
            [focal, 0.0, 0.5 * size[0] + offset[0] - 0.5],
            [0.0, focal, 0.5 * size[1] - offset[1] - 0.5],
            [0.0, 0.0, 1.0],
        ]
    )
    d = options.distortion
    found, _ = cv2.projectPoints(
        camera_points, np.zeros(3), np.zeros(3), matrix, np.array([d.k1, d.k2, d.p1, d.p2, d.k3])
    )
    pixels, inside = small_survey.project(number, ground)
    assert inside.sum() > 50
    assert np.abs(found[:, 0] + 0.5 - pixels)[inside].max() < 1e-8


def test_written_angles_mean_the_true_rotations(small_survey):
    """The rotations were built from differences of points; the attitude code reads the angles with γ."""
    tangent = small_survey.survey.tangent
    centres = small_survey.world.tangent_from_map(small_survey.centres)
    read = object_from_camera(
        small_survey.angles_deg,
        AttitudeConvention("opk", "grid", unit="deg"),
        tangent,
        centres,
        small_survey.survey.frame,
    )
    true = np.stack([p.orientation.object_from_camera for p in small_survey.survey.photographs])
    assert np.abs(read - true).max() < 1e-10


def test_discs_lie_where_their_centres_project(small_survey, photographs):
    """Centroids of the rendered targets against exact projections."""
    offsets = []
    for number, image in enumerate(photographs):
        grey = image.astype(float).mean(axis=2)
        for point in (*small_survey.control_points, *small_survey.check_points):
            if not small_survey.visible(number, point.position):
                continue
            (col, row), _ = small_survey.project(number, point.position)
            c, r = int(col), int(row)
            window = grey[r - 4 : r + 5, c - 4 : c + 5]
            if window.shape != (9, 9):
                continue
            y, x = np.mgrid[r - 4 : r + 5, c - 4 : c + 5] + 0.5
            weight = np.where(np.hypot(x - col, y - row) < 4.4, np.maximum(window - 60.0, 0.0), 0.0)
            offsets.append(((weight * x).sum() / weight.sum() - col, (weight * y).sum() / weight.sum() - row))
    offsets = np.array(offsets)
    assert len(offsets) > 8
    assert np.abs(np.median(offsets, axis=0)).max() < 0.03
    assert np.abs(offsets).max() < 0.12


def edge_offset(grey, start, end, normal):
    """Where a step across a straight edge lies, in pixels along its normal; NaN if it is no step."""
    along = np.linspace(0.25, 0.75, 25)[:, None]
    across = np.arange(-2.5, 2.51, 0.1)
    spots = start + along * (end - start)
    columns = spots[:, None, :] + across[:, None] * normal
    samples = cv2.remap(
        grey,
        (columns[..., 0] - 0.5).astype(np.float32),
        (columns[..., 1] - 0.5).astype(np.float32),
        cv2.INTER_LINEAR,
    )
    profile = samples.mean(axis=0)
    left, right = profile[:10].mean(), profile[-10:].mean()
    flat = max(np.std(profile[:10]), np.std(profile[-10:]))
    if abs(right - left) < 35.0 or flat > 0.03 * abs(right - left):
        return np.nan
    # area under the step gives the position of its edge
    share = (profile - left) / (right - left)
    return float(across[-1] - np.sum(share) * 0.1 + 0.05)


def test_roof_edges_are_where_their_corners_project(small_survey):
    """Eaves of the rendered houses, against lines between projected corners, without noise."""
    close = replace(
        small_survey.options,
        strips=1,
        photos_per_strip=2,
        size_px=(900, 700),
        pixel_pitch_mm=0.06,
        gsd_m=0.2,
        flying_height_m=250.0,
        relief_m=25.0,
        buildings=30,
        noise_dn=0.0,
        trees=0,
        samples=5,
    )
    survey = make_survey(close)
    # white roofs on dark walls, and no detail: only geometry
    texture = survey.world.scene.texture
    plain = texture._replace(
        fine=np.zeros_like(texture.fine),
        coarse=np.zeros_like(texture.coarse),
        building_look=np.tile(np.float32([230, 230, 230, 10, 10, 10]), (len(survey.world.buildings), 1)),
    )
    world = replace(survey.world, scene=survey.world.scene._replace(texture=plain))
    survey = replace(survey, world=world)
    offsets = []
    for number in range(len(survey.survey.photographs)):
        grey = survey.render(number).astype(np.float32).mean(axis=2)
        for house in survey.world.buildings:
            corners = house.corners()[:4]
            pixels, inside = survey.project(number, corners)
            if not inside.all() or not survey.visible(number, corners + np.array([0.0, 0.0, 1e-3])).all():
                continue
            middle = pixels.mean(axis=0)
            for i in range(4):
                start, end = pixels[i], pixels[(i + 1) % 4]
                if np.linalg.norm(end - start) < 25.0:
                    continue
                normal = np.array([start[1] - end[1], end[0] - start[0]]) / np.linalg.norm(end - start)
                if normal @ (middle - start) > 0.0:
                    normal = -normal
                offsets.append(edge_offset(grey, start, end, normal))
    offsets = np.array(offsets)
    offsets = offsets[np.isfinite(offsets)]
    # a few edges have a shadow or another wall beside them
    assert len(offsets) > 8
    assert abs(np.median(offsets)) < 0.03
    assert (np.abs(offsets) < 0.06).mean() > 0.6


def test_photographs_are_well_exposed(photographs):
    for image in photographs:
        assert image.dtype == np.uint8
        assert image.shape == (360, 480, 3)
        assert 70.0 < image.mean() < 150.0
        assert image.std() > 18.0
        assert (image <= 5).mean() < 1e-3
        assert (image >= 250).mean() < 2e-3


def test_detail_is_limited_before_the_nyquist_frequency(small_survey):
    """On open ground without noise: much detail at a third of it, hardly any where it would alias."""
    quiet = make_survey(
        replace(small_survey.options, noise_dn=0.0, buildings=0, trees=0, control_points=0, check_points=0)
    )
    grey = quiet.render(1).astype(float).mean(axis=2)
    window = np.hanning(256)[:, None] * np.hanning(256)
    patch = grey[50:306, 100:356]
    power = np.abs(np.fft.fft2((patch - patch.mean()) * window)) ** 2
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(256), np.fft.fftfreq(256)))

    def mean_power(low, high):
        return power[(frequency >= low) & (frequency < high)].mean()

    assert mean_power(0.14, 0.2) > 50.0 * mean_power(0.44, 0.5)


def test_the_same_seed_gives_the_same_bytes(small_survey, photographs):
    again = make_survey(small_survey.options)
    assert np.array_equal(again.render(2, Threads(2)), photographs[2])
    assert np.array_equal(again.centres, small_survey.centres)
    other = make_survey(replace(small_survey.options, seed=8))
    assert not np.array_equal(other.world.heights, small_survey.world.heights)
    assert not np.array_equal(other.render(2), photographs[2])


def test_flight_is_as_ordered():
    survey = make_survey(
        SurveyOptions(
            strips=4, photos_per_strip=8, size_px=(400, 300), heading_deg=63.0, buildings=0, trees=0
        )
    )
    options = survey.options
    assert len(survey.survey.photographs) == 32
    along = np.array([np.sin(np.radians(63.0)), np.cos(np.radians(63.0))])
    for strip in range(1, 5):
        centres = survey.centres[survey.strips == strip]
        steps = np.diff(centres[:, :2], axis=0) @ along * (1.0 if strip % 2 else -1.0)
        assert np.abs(steps - options.base_m).max() < 5.0 * options.position_sigma_m
    strips = [survey.centres[survey.strips == s, :2].mean(axis=0) for s in range(1, 5)]
    across = np.array([-along[1], along[0]])
    spacing = np.diff(np.array(strips) @ across)
    assert np.abs(spacing + options.strip_spacing_m).max() < 4.0 * options.position_sigma_m
    tilts = survey.angles_deg[:, :2]
    assert 0.6 < tilts.std() / options.tilt_sigma_deg < 1.4
    # image x looks along the flight: forth on odd strips, back on even ones
    heading = 90.0 - survey.angles_deg[:, 2]
    expected = np.where(survey.strips % 2 == 1, 63.0, 243.0)
    assert np.abs((heading - expected + 180.0) % 360.0 - 180.0).max() < 2.6 * options.tilt_sigma_deg


def test_overlap_lets_every_inner_point_be_seen_twice(small_survey):
    points = small_survey.world.on_ground(
        np.array(small_survey.options.centre) + np.random.default_rng(4).uniform(-70.0, 70.0, (300, 2))
    )
    seen = sum(
        small_survey.project(number, points)[1].astype(int)
        for number in range(len(small_survey.survey.photographs))
    )
    assert (seen >= 2).mean() > 0.97


def test_rays_and_shadows_are_looked_for_wherever_they_are(small_survey):
    photograph, world = small_survey.survey.photographs[1], small_survey.world
    objects = world.scene.objects
    assert 0.05 < objects.hides.mean() < 0.9
    assert 0.02 < objects.shades.mean() < 0.9
    quick = render_photograph(world, photograph, 1)
    everywhere = objects._replace(hides=np.ones_like(objects.hides), shades=np.ones_like(objects.shades))
    slow = render_photograph(replace(world, scene=world.scene._replace(objects=everywhere)), photograph, 1)
    np.testing.assert_array_equal(quick, slow)
    nowhere = objects._replace(shades=np.zeros_like(objects.shades))
    unlit = render_photograph(replace(world, scene=world.scene._replace(objects=nowhere)), photograph, 1)
    assert (quick != unlit).any(axis=-1).mean() > 0.001
