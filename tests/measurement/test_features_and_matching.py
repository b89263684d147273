"""Features, matching with and without prediction, least-squares matching against known displacements."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import cKDTree

from stereomate.errors import ImageError, InputError
from stereomate.measurement.features import (
    FeatureOptions,
    Features,
    detect_features,
    grey_image,
    reduced_image,
)
from stereomate.measurement.least_squares_matching import (
    STATES,
    LeastSquaresOptions,
    match_least_squares,
)
from stereomate.measurement.matching import MatchOptions, match_features, match_features_near


def texture(rows: int, cols: int, seed: int = 0) -> np.ndarray:
    """Random ground: fine and coarse detail, band-limited so that it can be resampled truly."""
    rng = np.random.default_rng(seed)
    total = sum(gaussian_filter(rng.normal(size=(rows, cols)), s) * s for s in (1.5, 3.0, 8.0))
    return 120.0 + 40.0 * total / total.std()


def view(image: np.ndarray, affine: np.ndarray, shift: np.ndarray, gain=1.0, offset=0.0) -> np.ndarray:
    """Image whose pixel ``affine p + shift`` shows what `image` shows at p (pixels, centres at +0.5)."""
    rows, cols = np.mgrid[: image.shape[0], : image.shape[1]] + 0.5
    target = np.stack([cols, rows], axis=-1) - shift
    source = target @ np.linalg.inv(affine).T
    return gain * map_coordinates(image, [source[..., 1] - 0.5, source[..., 0] - 0.5], order=5) + offset


def as_bytes(image: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def test_features_are_found_at_their_pixels_and_spread():
    image = np.full((300, 400), 90.0)
    rows, cols = np.mgrid[:300, :400] + 0.5
    centres = [(60.5, 40.5), (200.0, 151.25), (333.3, 250.7)]
    for x, y in centres:
        image += 100.0 * np.exp(-((cols - x) ** 2 + (rows - y) ** 2) / (2 * 3.0**2))
    found = detect_features(as_bytes(image), FeatureOptions(tile_px=200))
    for centre in centres:
        nearest = np.linalg.norm(found.pixels - centre, axis=1).min()
        assert nearest < 0.1
    np.testing.assert_allclose(np.linalg.norm(found.descriptors, axis=1), 1.0, atol=1e-5)


def test_tiles_change_nothing_but_the_edges():
    image = as_bytes(texture(300, 420))
    whole = detect_features(image, FeatureOptions(max_features=10**6, contrast=0.05))
    tiled = detect_features(image, FeatureOptions(max_features=10**6, contrast=0.05, tile_px=210))
    assert len(whole) > 300
    distance = cKDTree(tiled.pixels).query(whole.pixels)[0]
    assert np.mean(distance < 0.02) > 0.95
    assert abs(len(whole) - len(tiled)) < 0.03 * len(whole)


def test_few_features_are_spread_over_the_image():
    image = texture(400, 400)
    image[:, 200:] = 120.0 + (image[:, 200:] - 120.0) * 0.3
    few = detect_features(as_bytes(image), FeatureOptions(max_features=200, cells=10))
    assert len(few) == 200
    counts = np.histogram2d(few.pixels[:, 0], few.pixels[:, 1], bins=4, range=[[0, 400]] * 2)[0]
    assert counts.min() >= 5
    strongest = np.mean(few.pixels[:, 0] < 200)
    assert strongest < 0.75


def test_mask_keeps_features_away():
    image = as_bytes(texture(200, 200))
    mask = np.zeros((200, 200), dtype=bool)
    mask[:, :100] = True
    found = detect_features(image, mask=mask)
    assert len(found) > 50
    assert found.pixels[:, 0].max() < 101.0


def test_grey_images_of_every_kind():
    rgb = np.zeros((4, 5, 3), np.uint8)
    rgb[..., 1] = 200
    assert grey_image(rgb)[0, 0] == round(0.587 * 200)
    assert grey_image(rgb[..., :1]).shape == (4, 5)
    ramp = np.linspace(0.0, 4000.0, 5000).reshape(50, 100)
    stretched = grey_image(ramp)
    assert stretched.dtype == np.uint8
    assert (stretched.min(), stretched.max()) == (0, 255)
    ramp[0, 0] = np.nan
    assert grey_image(ramp)[0, 0] == 0
    with pytest.raises(ImageError, match="rows x columns"):
        grey_image(np.zeros(7))
    with pytest.raises(ImageError, match="bytes"):
        detect_features(ramp)
    assert reduced_image(np.full((7, 9), 8, np.uint8), 2).shape == (3, 4)


def features_at(pixels: np.ndarray, descriptors: np.ndarray) -> Features:
    n = len(pixels)
    unit = (descriptors / np.linalg.norm(descriptors, axis=1, keepdims=True)).astype(np.float32)
    return Features(pixels, np.ones(n), np.zeros(n), np.ones(n), unit)


@settings(deadline=None, max_examples=25)
@given(st.integers(1, 60), st.integers(2, 60), st.integers(0, 1000))
def test_matching_against_brute_force(n, m, seed):
    rng = np.random.default_rng(seed)
    left = features_at(rng.uniform(0, 100, (n, 2)), rng.uniform(size=(n, 128)))
    right = features_at(rng.uniform(0, 100, (m, 2)), rng.uniform(size=(m, 128)))
    copied = min(n, m) // 2
    right.descriptors[:copied] = left.descriptors[:copied]
    predicted = rng.uniform(0, 100, (n, 2))
    predicted[rng.random(n) < 0.1] = np.nan
    options = MatchOptions(ratio=0.9)
    distance = np.linalg.norm(left.descriptors[:, None].astype(float) - right.descriptors[None], axis=2)
    near = np.linalg.norm(right.pixels[None] - predicted[:, None], axis=2) <= 30.0
    for matches, allowed in (
        (match_features(left, right, options), np.ones((n, m), dtype=bool)),
        (match_features_near(left, right, predicted, 30.0, MatchOptions(ratio=0.9, mutual=False)), near),
    ):
        d = np.where(allowed, distance, np.inf)
        expected = []
        for i in range(n):
            order = np.argsort(d[i])
            best = order[0]
            second = d[i, order[1]] if np.isfinite(d[i, order[1]]) else 1.0
            good = d[i, best] <= 0.9 * second and d[i, best] <= 0.7
            if allowed.all():
                good = good and np.argmin(distance[:, best]) == i
            if good:
                expected.append((i, int(best)))
        assert list(zip(matches.left.tolist(), matches.right.tolist(), strict=True)) == expected


def test_guided_matching_keeps_one_left_point_per_right_point():
    rng = np.random.default_rng(1)
    base = rng.uniform(size=(1, 128))
    left = features_at(np.zeros((3, 2)), base + rng.normal(0, [[0.001], [0.02], [0.1]], (3, 128)))
    right = features_at(np.zeros((1, 2)), base)
    matches = match_features_near(left, right, np.zeros((3, 2)), 5.0)
    assert matches.left.tolist() == [0]


def test_matching_nothing():
    empty = features_at(np.empty((0, 2)), np.empty((0, 128)))
    some = features_at(np.zeros((2, 2)), np.ones((2, 128)))
    assert len(match_features(empty, some)) == len(match_features(some, empty)) == 0
    assert len(match_features_near(some, empty, np.zeros((2, 2)), 3.0)) == 0
    with pytest.raises(InputError, match="shape"):
        match_features_near(some, some, np.zeros((3, 2)), 3.0)


@pytest.mark.parametrize("both", [False, True])
@pytest.mark.parametrize(
    ("affine", "gain", "offset"),
    [
        (np.eye(2), 1.0, 0.0),
        (np.array([[1.04, 0.03], [-0.02, 0.97]]), 0.8, 15.0),
        (np.array([[-0.99, 0.05], [-0.06, -1.01]]), 1.1, -10.0),
    ],
)
def test_least_squares_matching_finds_known_places(affine, gain, offset, both):
    """Errors against truth, and the covariance predicts them."""
    image = texture(420, 420, 3)
    shift = np.array([420.0, 420.0]) / 2 - affine @ np.array([210.0, 210.0]) + np.array([3.37, -2.61])
    other = view(image, affine, shift, gain, offset)
    rng = np.random.default_rng(0)
    noise = 2.0
    left = (image + rng.normal(0, noise, image.shape)).astype(np.float32)
    right = (other + rng.normal(0, noise if both else 0.0, image.shape)).astype(np.float32)
    places = rng.uniform(80, 340, (150, 2))
    truth = (np.floor(places) + 0.5) @ affine.T + shift
    start = places @ affine.T + shift + rng.uniform(-1.2, 1.2, places.shape)
    options = LeastSquaresOptions(radius_px=8, smoothing_px=0.0, last_step_px=0.001)
    found = match_least_squares(left, right, places, start, affine, options)
    good = found.matched
    assert good.mean() > 0.97
    error = (found.right_px - truth)[good]
    deviation = np.sqrt(found.covariance_px[good][:, [0, 2]])
    assert np.sqrt(np.mean(error**2)) < 0.06
    # Overlapping windows are not independent: the root mean square of 300 numbers is known to 5 % at best.
    # Without smoothing, noise as large as that of the texture's finest detail bends the linearisation.
    normalised = np.sqrt(np.mean((error / deviation) ** 2))
    assert 0.85 < normalised < (1.3 if both else 1.15)
    # Noise of the right image drags positions towards half pixels, where interpolation smooths it.
    assert np.abs(np.mean(error, axis=0)).max() < (0.01 if both else 0.003)
    assert np.median(np.abs(found.affine[good] - affine)) < 0.02
    np.testing.assert_allclose(found.left_px, np.floor(places) + 0.5)


@pytest.mark.parametrize(("smoothing", "noise"), [(0.7, 1.0), (0.7, 4.0), (1.2, 4.0), (0.0, 1.0)])
def test_standard_deviations_are_those_of_white_noise(smoothing, noise):
    """Noise in both images, all fractions of a pixel: errors over standard deviations have unit size."""
    image = texture(420, 420, 3)
    affine = np.array([[1.01, 0.02], [-0.015, 0.99]])
    options = LeastSquaresOptions(smoothing_px=smoothing, last_step_px=0.001)
    normalised = []
    for seed in range(2):
        rng = np.random.default_rng(100 + seed)
        shift = rng.uniform(-3.0, 3.0, 2)
        left = image + rng.normal(0.0, noise, image.shape)
        right = view(image, affine, shift) + rng.normal(0.0, noise, image.shape)
        # A lattice of windows that hardly overlap.
        places = np.stack(np.meshgrid(np.arange(40, 380, 16), np.arange(40, 380, 16)), axis=-1).reshape(-1, 2)
        truth = (places + 0.5) @ affine.T + shift
        start = truth + rng.uniform(-0.5, 0.5, truth.shape)
        found = match_least_squares(left, right, places, start, affine, options)
        good = found.matched
        assert good.mean() > 0.98
        error = (found.right_px - truth)[good]
        xx, xy, yy = found.covariance_px[good].T
        # Both coordinates and their correlation: the square form has two degrees of freedom.
        form = yy * error[:, 0] ** 2 - 2.0 * xy * error[:, 0] * error[:, 1] + xx * error[:, 1] ** 2
        normalised.append(form / (xx * yy - xy * xy))
    assert 0.9 < np.sqrt(np.mean(np.concatenate(normalised)) / 2.0) < 1.1


@pytest.mark.parametrize("fraction", [0.1, 0.25, 0.4, 0.5, 0.75])
def test_no_fraction_of_a_pixel_is_favoured(fraction):
    """Without noise what is left is the interpolation: below a thousandth of a pixel on fine texture."""
    image = texture(260, 260, 3)
    shift = np.array([2.0 + fraction, -1.0 + 0.5 * fraction])
    places = np.random.default_rng(5).uniform(40, 220, (60, 2))
    truth = np.floor(places) + 0.5 + shift
    found = match_least_squares(image, view(image, np.eye(2), shift), places, truth)
    assert found.matched.all()
    assert np.abs(found.right_px - truth).max() < 0.003
    assert np.abs((found.right_px - truth).mean(axis=0)).max() < 0.001


def test_whole_pixel_shift_is_exact():
    image = texture(120, 120, 4).astype(np.float32)
    right = np.roll(image, (2, -3), axis=(0, 1))
    found = match_least_squares(
        image, right, [[60.2, 55.9]], [[57.9, 57.1]], options=LeastSquaresOptions(smoothing_px=0.0)
    )
    np.testing.assert_allclose(found.right_px, [[57.5, 57.5]], atol=1e-4)
    assert found.correlation[0] == pytest.approx(1.0, abs=1e-9)


def test_what_cannot_be_matched_says_why():
    image = texture(160, 160, 5)
    flat = np.full((160, 160), 100.0)
    other = texture(160, 160, 6)
    inside = [[80.0, 80.0]]
    reasons = {
        "no texture": match_least_squares(flat, image, inside, inside),
        "the window leaves a photograph": match_least_squares(image, image, [[3.0, 80.0]], inside),
        "wandered off": match_least_squares(
            image, image, inside, [[86.5, 80.0]], options=LeastSquaresOptions(largest_way_px=0.5)
        ),
    }
    for reason, found in reasons.items():
        assert STATES[int(found.state[0])] == reason
        assert np.isnan(found.right_px).all()
        assert found.failures() == {reason: 1}
    many = np.random.default_rng(0).uniform(30, 130, (40, 2))
    unlike = match_least_squares(image, other, many, many)
    assert unlike.matched.mean() < 0.1
    missing = match_least_squares(image, image, inside, [[np.nan, 80.0]])
    assert not missing.matched[0]


def test_bad_input():
    image = texture(40, 40)
    with pytest.raises(ImageError, match="grey"):
        match_least_squares(np.zeros((4, 4, 3)), image, [[1, 1]], [[1, 1]])
    with pytest.raises(InputError, match="shape"):
        match_least_squares(image, image, [[1, 1]], [[1, 1], [2, 2]])
    with pytest.raises(InputError, match="finite"):
        match_least_squares(image, image, [[np.nan, 1]], [[1, 1]])
    with pytest.raises(InputError, match="radius_px"):
        LeastSquaresOptions(radius_px=1)
    with pytest.raises(InputError, match="ratio"):
        MatchOptions(ratio=0.0)
