"""The orientation's share of a point: covariances of an adjustment carried through to a product."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from made_products import OPTIONS, height_model, make_job, product_positions

from stereomate.block.adjustment import adjust_block
from stereomate.block.network import (
    BlockCamera,
    Control,
    ImagePoints,
    Network,
    Photographs,
    Points,
    Positions,
)
from stereomate.block.options import BlockOptions
from stereomate.camera.model import Camera
from stereomate.coverage.covariance import OrientationCovariance
from stereomate.errors import FormatError
from stereomate.frames.tangent import TangentFrame
from stereomate.geometry.rotations import rotation_from_vector
from stereomate.stereo.lineage import LineageRule
from stereomate.stereo.measure import measure
from stereomate.stereo.measured import MeasureOptions
from stereomate.synthetic.survey import make_survey

CAMERA = Camera.from_pixel_pitch("c", (6000, 4000), 24.0, 0.004)
WEAK_PX = 40.0


@pytest.fixture(scope="module")
def product():
    survey = make_survey(OPTIONS)
    job = make_job(survey, height_model(survey))
    rng = np.random.default_rng(1)
    spots = np.array(OPTIONS.centre) + rng.uniform(-1.0, 1.0, (40, 2)) * [280.0, 130.0]
    points = survey.world.on_ground(spots)
    return job, *product_positions(job, points)[1:3]


def covariances(job, together, own=1.0):
    """Every photograph alike; every two photographs have the part `together` of their errors in common."""
    names = [p.name for p in job.photographs]
    six = own * np.diag([0.02**2] * 3 + [3e-5**2] * 3)
    pairs = {(a, b): together * six for k, a in enumerate(names) for b in names[k + 1 :]}
    return OrientationCovariance(dict.fromkeys(names, six), pairs)


def shares(product, known, **stated):
    job, left, right = product
    return measure(job, LineageRule(job), left, right, MeasureOptions(check_hidden=False, **stated), known)


def test_independent_orientations_are_those_that_one_states(product):
    stated = shares(product, None, centre_sigma_m=0.02, angle_sigma_rad=3e-5)
    known = shares(product, covariances(product[0], 0.0))
    assert known.measured.sum() > 30
    np.testing.assert_allclose(
        known.orientation_covariance, stated.orientation_covariance, rtol=1e-9, atol=1e-18
    )
    # what is stated goes before what is known, and neither is in the noise of measuring
    both = shares(product, covariances(product[0], 0.0, own=25.0), centre_sigma_m=0.02, angle_sigma_rad=3e-5)
    np.testing.assert_array_equal(both.orientation_covariance, stated.orientation_covariance)
    np.testing.assert_array_equal(known.covariance, stated.covariance)


def test_what_two_photographs_err_by_together_hardly_makes_heights_wrong(product):
    """Of a shift of both alike the whole goes into the point; their independent part is gone."""
    job = product[0]
    names = [p.name for p in job.photographs]
    six = np.diag([0.05**2] * 3 + [1e-20] * 3)
    pairs = {(a, b): six for k, a in enumerate(names) for b in names[k + 1 :]}
    found = shares(product, OrientationCovariance(dict.fromkeys(names, six), pairs))
    good = found.measured
    expected = np.tile(0.05**2 * np.eye(3), (int(good.sum()), 1, 1))
    # the scale of the map differs from 1 by a thousandth or two
    np.testing.assert_allclose(found.orientation_covariance[good], expected, rtol=5e-3, atol=1e-5)
    sigma = [
        np.sqrt(shares(product, covariances(job, part)).orientation_covariance[good, 2, 2])
        for part in (0.0, 0.9)
    ]
    assert np.median(sigma[1] / sigma[0]) < 0.5


def test_points_of_unknown_pairs_say_so(product):
    job = product[0]
    known = replace(covariances(job, 0.5), pairs={})
    found = shares(product, known)
    assert np.isnan(found.orientation_covariance[found.measured]).all()
    assert np.isfinite(found.covariance[found.measured]).all()


def test_covariances_are_written_and_read_back(product):
    job = product[0]
    known = covariances(job, 0.7)
    record = json.loads(json.dumps(known.as_record()))
    back = OrientationCovariance.from_record(record)
    a, b = (p.name for p in job.photographs[:2])
    np.testing.assert_allclose(back.of_pair(b, a), known.of_pair(a, b), rtol=1e-9)
    assert set(back.among([a], [(b, a)]).pairs) == {(a, b)}
    record["photographs"][0][1][1] = 1.0
    with pytest.raises(FormatError, match=f"photographs: {a}: must be a covariance matrix"):
        OrientationCovariance.from_record(record)


def test_axes_turn_with_the_tangent_frame():
    """A quarter of the globe further east, up is where east was before."""
    a = TangentFrame(0.0, 0.0, 0.0, 6378137.0, 0.0)
    b = TangentFrame(90.0, 0.0, 0.0, 6378137.0, 0.0)
    known = OrientationCovariance({"p": np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])}, {})
    turned = known.in_frame(b, a).photographs["p"]
    np.testing.assert_allclose(turned, np.diag([3.0, 2.0, 1.0, 6.0, 5.0, 4.0]), atol=1e-12)


def network(rng):
    """Five photographs in two strips, positions, control, and a point measured badly in two of them."""
    centres = np.array([[0, 0, 100], [35, 2, 103], [70, -1, 98], [10, 40, 101], [45, 41, 99]], float)
    rotations = rotation_from_vector(rng.normal(0, 0.04, (5, 3)))
    points = np.column_stack([rng.uniform(-30, 100, 160), rng.uniform(-30, 70, 160), rng.normal(0, 6, 160)])
    points[0] = (30.0, 10.0, 4.0)
    photo, point, xy = [], [], []
    for k in range(5):
        pixels, inside = CAMERA.image_from_camera((points - centres[k]) @ rotations[k])
        seen = [j for j in np.flatnonzero(inside) if j > 0 or k in (0, 1)]
        photo += [k] * len(seen)
        point += seen
        xy += list(pixels[seen])
    counts = np.bincount(point, minlength=160)
    keep = [i for i, j in enumerate(point) if counts[j] >= 2]
    photo, point, xy = (np.array(v)[keep] for v in (photo, point, xy))
    names, point = np.unique(point, return_inverse=True)
    points = points[names]
    sigma = np.where(point == 0, WEAK_PX, 0.4)[:, None] * np.ones((1, 2))
    strong = np.where(point == 0, 0.0, 0.4)[:, None]
    image = ImagePoints(photo, point, xy + strong * rng.normal(size=xy.shape), sigma)
    control = Control(np.array([3, 9, 20, 33]), points[[3, 9, 20, 33]], 0.03)
    return Network(
        (BlockCamera(CAMERA),),
        Photographs(tuple("abcde"), np.zeros(5, int), centres, rotations),
        Points(tuple(map(str, names)), points),
        image,
        control,
        Positions(np.arange(5), centres + 0.03 * rng.normal(size=(5, 3)), 0.03),
    )


def test_blocks_and_points_mean_the_same_by_an_orientation():
    """A point measured so badly that it says nothing of the orientations: its covariance in the adjustment is
    its noise and the share of the two orientations, by their covariances and derivatives of its images."""
    result = adjust_block(network(np.random.default_rng(5)), BlockOptions(scale_by="prior"))
    cofactors, image = result.statistics.cofactors, result.network.image
    point, pair = result.points[0], np.sort(image.photo[image.point == 0])
    assert pair.tolist() == [0, 1]

    def pixels(k, shift, turn, at):
        rotation = rotation_from_vector(turn) @ result.rotations[k]
        return CAMERA.image_from_camera((at - result.centres[k] - shift) @ rotation)[0]

    zero = np.zeros(3)
    by_point, by_orientation = np.zeros((4, 3)), np.zeros((4, 12))
    for k in range(2):
        rows = slice(2 * k, 2 * k + 2)
        for i in range(3):
            e = 1e-4 * np.eye(3)[i]
            by_point[rows, i] = (pixels(k, zero, zero, point + e) - pixels(k, zero, zero, point - e)) / 2e-4
            moved = pixels(k, e, zero, point) - pixels(k, -e, zero, point)
            by_orientation[rows, 6 * k + i] = moved / 2e-4
            turned = pixels(k, zero, 1e-3 * e, point) - pixels(k, zero, -1e-3 * e, point)
            by_orientation[rows, 6 * k + 3 + i] = turned / 2e-7
    solve = np.linalg.inv(by_point.T @ by_point)
    gain = -solve @ by_point.T @ by_orientation
    known = OrientationCovariance(
        {"a": cofactors.photos[0], "b": cofactors.photos[1]}, {("a", "b"): cofactors.photo_pair(0, 1)}
    )
    share = gain @ known.of_pair("a", "b") @ gain.T
    expected = WEAK_PX**2 * solve + share
    np.testing.assert_allclose(cofactors.points[0], expected, rtol=2e-3, atol=1e-6)
    # the share itself is what is tested: without the noise, and other than with independent photographs
    found = cofactors.points[0] - WEAK_PX**2 * solve
    np.testing.assert_allclose(np.diagonal(found), np.diagonal(share), rtol=0.05)
    apart = known.of_pair("a", "b") * np.kron(np.eye(2), np.ones((6, 6)))
    assert (gain @ apart @ gain.T)[2, 2] > 1.3 * share[2, 2]
