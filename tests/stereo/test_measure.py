"""Exact measuring on a synthetic survey: real CRS, seams, slopes, wrong height models, noise, bad input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_products import OPTIONS, height_model, make_job, product_positions
from scipy.stats import chi2

from stereomate.errors import InputError
from stereomate.stereo.lineage import LineageRule
from stereomate.stereo.measure import measure
from stereomate.stereo.measured import Flag, MeasureOptions, ObjectHeights
from stereomate.synthetic.survey import make_survey
from stereomate.terrain.model import HeightModel

SIGMA_PX = 0.3


@pytest.fixture(scope="module")
def survey():
    return make_survey(OPTIONS)


@pytest.fixture(scope="module")
def points(survey):
    """Roof corners, tree tops and ground points."""
    rng = np.random.default_rng(1)
    spots = np.array(OPTIONS.centre) + rng.uniform(-1.0, 1.0, (60, 2)) * [280.0, 130.0]
    return np.concatenate(
        [survey.roof_corners()[:90], survey.tree_tops()[:60], survey.world.on_ground(spots)]
    )


def slope(survey) -> HeightModel:
    """A plane that rises by 20 degrees along the rows and 30 degrees across them."""
    model = height_model(survey)
    rows, cols = model.shape
    row, col = np.mgrid[0:rows, 0:cols]
    cell = OPTIONS.terrain_step_m
    along, across = (col - 0.5 * cols) * cell, -(row - 0.5 * rows) * cell
    heights = 300.0 + np.tan(np.radians(20.0)) * along + np.tan(np.radians(30.0)) * across
    return HeightModel.from_array(np.clip(heights, 0.0, 560.0), model.affine, model.frame)


@pytest.fixture(scope="module")
def true_product(survey, points):
    job = make_job(survey, height_model(survey))
    return job, points, *product_positions(job, points)


@pytest.fixture(scope="module")
def wrong_product(survey, points):
    job = make_job(survey, height_model(survey, 10.0, 2.0), law="natural")
    return job, points, *product_positions(job, points)


@pytest.fixture(scope="module")
def steep_product(survey):
    model = slope(survey)
    job = make_job(survey, model)
    rng = np.random.default_rng(2)
    spots = np.array(OPTIONS.centre) + rng.uniform(-1.0, 1.0, (90, 2)) * [180.0, 90.0]
    heights = model.heights_at(spots) + rng.uniform(0.0, 25.0, len(spots))
    points = np.column_stack([spots, heights])
    return job, points, *product_positions(job, points)


PRODUCTS = ("true_product", pytest.param("wrong_product", marks=pytest.mark.slow), "steep_product")


@pytest.mark.parametrize("name", PRODUCTS)
def test_without_noise(name, request):
    """Errors under a micrometre, over the seam, though the law alone is off by metres."""
    job, points, kept, left, right, photographs = request.getfixturevalue(name)
    assert len(kept) > 60
    found = measure(job, LineageRule(job), left, right)
    np.testing.assert_array_equal(found.photographs, photographs)
    assert len(np.unique(photographs, axis=0)) >= 2
    # beside a seam one photograph may serve as left and as right: refused, and nothing else is
    same = photographs[:, 0] == photographs[:, 1]
    assert same.mean() < 0.1
    np.testing.assert_array_equal(found.measured, ~same)
    np.testing.assert_allclose(found.points[~same], points[kept][~same], atol=1e-6)
    assert np.nanmax(found.miss_m) < 1e-6
    assert np.nanmax(np.abs(found.differences)) > 0.5


@pytest.mark.parametrize("name", PRODUCTS)
def test_with_noise(name, request):
    """0.3 px in every coordinate: chi-square of all points at 1 %, and no bias."""
    job, points, kept, left, right, photographs = request.getfixturevalue(name)
    rng = np.random.default_rng(5)
    sigma = SIGMA_PX * job.grid.gsd
    noisy = [xy + sigma * rng.standard_normal(xy.shape) for xy in (left, right)]
    found = measure(job, LineageRule(job), *noisy, MeasureOptions(SIGMA_PX, check_hidden=False))
    good = found.reliable
    assert good.sum() > 0.8 * len(good)
    # a position that noise carries over a seam belongs to another photograph: those are flagged
    carried = (found.photographs != photographs).any(axis=1)
    assert not (carried & good).any()
    error = (found.points - points[kept])[good]
    form = np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.covariance[good]), error).sum()
    low, high = chi2.ppf([0.005, 0.995], 3 * good.sum())
    assert low < form < high
    low, high = chi2.ppf([0.005, 0.995], good.sum())
    assert low < np.sum(found.standardized[good] ** 2) < high
    spread = np.sqrt(np.einsum("nii->ni", found.covariance[good]).mean(axis=0) / good.sum())
    assert (np.abs(error.mean(axis=0)) < 3.0 * spread).all()


@pytest.mark.slow
def test_the_map_frame_of_the_covariance(true_product):
    """Covariance in the map against differences of the whole chain by each measured coordinate."""
    job, _, _, left, right, _ = true_product
    left, right = left[:40], right[:40]
    options = MeasureOptions(0.3, check_hidden=False)
    rule = LineageRule(job)
    found = measure(job, rule, left, right, options)
    sigma, step = 0.3 * job.grid.gsd, 1e-4
    total = np.zeros((40, 3, 3))
    for side in range(2):
        for k in range(2):
            ends = []
            for sign in (1.0, -1.0):
                moved = [left.copy(), right.copy()]
                moved[side][:, k] += sign * step
                ends.append(measure(job, rule, *moved, options).points)
            by = (ends[0] - ends[1]) / (2.0 * step)
            total += sigma**2 * by[:, :, None] * by[:, None, :]
    # where a step crosses a line of the bilinear surface the two slopes mix
    close = np.isclose(total, found.covariance, rtol=1e-3, atol=1e-6).all(axis=(1, 2))
    assert close.mean() > 0.9


def test_objects(survey, true_product):
    """Tree tops over the ground below them."""
    job = true_product[0]
    tops = survey.tree_tops()[:25]
    feet = survey.world.on_ground(tops[:, :2])
    kept, left, right, _ = product_positions(job, np.concatenate([tops, feet]))
    here = [k for k in range(25) if k in kept and k + 25 in kept]
    place = {int(k): n for n, k in enumerate(kept)}
    assert len(here) >= 10
    rule = LineageRule(job)

    def at(offset):
        rows = [place[k + offset] for k in here]
        return measure(job, rule, left[rows], right[rows])

    found = ObjectHeights(at(25), at(0))
    np.testing.assert_allclose(found.heights, (tops - feet)[here, 2], atol=1e-6)
    np.testing.assert_allclose(found.leaning_m, 0.0, atol=1e-6)
    np.testing.assert_allclose(found.heights + found.differences, found.law_heights, atol=1e-9)
    assert (found.sigma > found.top.sigma[:, 2]).all()


def test_share_of_the_orientation(true_product):
    """A wrong centre height lifts all points alike: the share is apart, and does not shrink with sigma_px."""
    job, _, _, left, right, _ = true_product
    rule = LineageRule(job)
    fine = measure(job, rule, left[:5], right[:5], MeasureOptions(0.01, 0.1, 1e-5, check_hidden=False))
    coarse = measure(job, rule, left[:5], right[:5], MeasureOptions(1.0, 0.1, 1e-5, check_hidden=False))
    np.testing.assert_allclose(fine.orientation_covariance, coarse.orientation_covariance, rtol=1e-3)
    assert (np.sqrt(fine.orientation_covariance[:, 2, 2]) > 0.05).all()
    none = measure(job, rule, left[:5], right[:5])
    assert not none.orientation_covariance.any()


def test_exchanged_eyes_are_noticed(true_product):
    job, _, _, left, right, _ = true_product
    with pytest.raises(InputError, match="exchanged"):
        measure(job, LineageRule(job), right, left)


def test_places_that_cannot_be_measured(true_product):
    job, _, _, left, right, _ = true_product
    far = job.grid.map_from_pixel([[-50.0, 10.0]])
    found = measure(
        job, LineageRule(job), np.concatenate([left[:3], far]), np.concatenate([right[:3], right[:1]])
    )
    assert found.reasons(3)[0] == "outside"
    assert np.isnan(found.points[3]).all()
    assert np.isfinite(found.points[:3]).all()
    assert found.summary()["refused"] == 1


def test_left_and_right_from_one_photograph(true_product):
    """Refused, with the reason."""
    job, _, _, left, right, _ = true_product

    class OnePhotograph:
        def photographs(self, side, pixels):
            return np.full(len(pixels), 2)

    found = measure(job, OnePhotograph(), left[:2], right[:2])
    assert (found.flags & int(Flag.NO_BASE)).all()
    assert np.isnan(found.points).all()
    assert np.isnan(found.covariance).all()


def test_a_wrong_pair_is_flagged(true_product):
    job, _, _, left, right, _ = true_product
    moved = right[:5] + np.array([0.0, 6.0 * job.grid.gsd])
    found = measure(job, LineageRule(job), left[:5], moved)
    assert (found.flags & int(Flag.MISSED)).all()


def test_photographs_from_one_place_have_no_base(true_product):
    job, _, _, left, right, _ = true_product
    first, *others = job.photographs
    same = tuple(
        replace(p, orientation=replace(p.orientation, centre=first.orientation.centre)) for p in others
    )
    found = measure(replace(job, photographs=(first, *same)), LineageRule(job), left[:5], right[:5])
    assert (found.flags & int(Flag.NO_BASE)).all()
    assert not found.measured.any()
    assert np.isnan(found.points).all()


def test_a_fold_is_flagged(survey):
    """A ridge whose side rises along the rows more steeply than 1 / q': its noise grows, and it is said."""
    model = height_model(survey)
    rows, cols = model.shape
    col = np.broadcast_to(np.arange(cols), (rows, cols))
    ridge = 300.0 + 60.0 * np.clip((col - 0.5 * cols) * 2.0 / 15.0, 0.0, 1.0)
    heights = HeightModel.from_array(ridge, model.affine, model.frame)
    job = replace(make_job(survey, heights), heights=heights)
    middle = model.map_from_pixel([[0.5 * cols, 0.5 * rows]])[0]
    x = middle[0] + np.array([-60.0, -2.0, 21.0, 60.0])
    spots = np.column_stack([x, np.full(4, middle[1])])
    points = np.column_stack([spots, heights.heights_at(spots)])
    shown = job.grid.map_from_uv(
        job.grid.uv_from_map(spots) - np.stack([job.law.q(points[:, 2]), np.zeros(4)], axis=-1)
    )
    found = measure(job, LineageRule(job), spots, shown, MeasureOptions(check_hidden=False))
    folded = (found.flags & int(Flag.FOLD)) != 0
    np.testing.assert_array_equal(folded, [False, True, True, False])


def test_arguments_are_checked(true_product):
    job, _, _, left, right, _ = true_product
    rule = LineageRule(job)
    with pytest.raises(InputError, match="right_xy"):
        measure(job, rule, left[:3], right[:2])
    with pytest.raises(InputError, match="finite"):
        measure(job, rule, left[:1] * np.nan, right[:1])
    with pytest.raises(InputError, match="stereomate"):
        measure(replace(job, law=type(job.law)("none", 1.0, 1.0)), rule, left[:1], right[:1])
    with pytest.raises(InputError, match="sigma_px"):
        MeasureOptions(0.0)
