"""Kernels of reading and encoding against numpy and against imagecodecs, also with bounds checks."""

from __future__ import annotations

import imagecodecs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stereomate.raster.cog import kernels
from stereomate.raster.kernels import interleave

DTYPES = ("uint8", "uint16", "int16", "float32")
shapes = st.tuples(st.integers(1, 40), st.integers(1, 40), st.integers(1, 5))


def noise(shape, dtype, seed=0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    if dtype == "float32":
        return rng.normal(0, 1000, shape).astype(dtype)
    limits = np.iinfo(dtype)
    return rng.integers(limits.min, limits.max, shape, dtype, endpoint=True)


def window_of(image: np.ndarray, row0: int, col0: int, edge: int) -> np.ndarray:
    return image[row0 : row0 + edge, col0 : col0 + edge]


@given(shapes, st.sampled_from(DTYPES[:3]), st.integers(0, 39), st.integers(0, 39))
@settings(deadline=None, max_examples=60)
def test_differences_are_those_of_imagecodecs(shape, dtype, row0, col0):
    image = noise(shape, dtype)
    row0, col0 = row0 % shape[0], col0 % shape[1]
    out = np.empty((16, 16, shape[2]), dtype)
    kernels.take_differences(image, row0, col0, out)
    inside = np.ascontiguousarray(window_of(image, row0, col0, 16))
    rows, cols = inside.shape[:2]
    np.testing.assert_array_equal(out[:rows, :cols], imagecodecs.delta_encode(inside, axis=1))
    assert not out[rows:].any()
    assert not out[:, cols:].any()


@given(st.integers(1, 5), st.integers(0, 9))
@settings(deadline=None, max_examples=20)
def test_float_differences_are_those_of_imagecodecs(bands, seed):
    tile = noise((16, 16, bands), "float32", seed)
    width = 16 * bands * 4
    out = np.empty((16, width), np.uint8)
    kernels.take_float_differences(tile.view(np.uint8).reshape(16, width), bands, out)
    np.testing.assert_array_equal(
        imagecodecs.floatpred_decode(out.view(np.float32).reshape(tile.shape), axis=-2), tile
    )


@given(shapes, st.sampled_from(DTYPES), st.sampled_from(["none", "all", "some"]), st.integers(0, 9))
@settings(deadline=None, max_examples=80)
def test_halves_are_means_of_what_is_valid(shape, dtype, validity, seed):
    image = noise(shape, dtype, seed)
    rng = np.random.default_rng(seed)
    valid = (rng.random(shape[:2]) < {"none": 0, "all": 1, "some": 0.5}[validity]).astype(np.uint8)
    rows, cols = -(-shape[0] // 2), -(-shape[1] // 2)
    out, out_valid = np.empty((rows, cols, shape[2]), dtype), np.empty((rows, cols), np.uint8)
    if dtype == "float32":
        kernels.halve_floats(image, valid, True, out, out_valid)
    else:
        sums = np.empty(shape[1] * shape[2], np.uint16 if dtype == "uint8" else np.int32)
        kernels.halve_integers(image, valid, True, sums, out, out_valid)
    for r in range(rows):
        for c in range(cols):
            block = (slice(2 * r, 2 * r + 2), slice(2 * c, 2 * c + 2))
            samples = image[block][valid[block] == 1].astype(float)
            assert out_valid[r, c] == (len(samples) > 0)
            if not len(samples):
                assert np.isnan(out[r, c]).all() if dtype == "float32" else not out[r, c].any()
            elif dtype == "float32":
                np.testing.assert_allclose(out[r, c], samples.mean(0), rtol=1e-6, atol=1e-4)
            else:
                np.testing.assert_array_equal(out[r, c], np.floor(samples.mean(0) + 0.5))


def test_halves_without_a_mask_do_not_look_at_it():
    image = noise((7, 9, 3), "uint8")
    nothing = np.empty((0, 0), np.uint8)
    out, masked = np.empty((4, 5, 3), np.uint8), np.empty((4, 5, 3), np.uint8)
    sums = np.empty(27, np.uint16)
    kernels.halve_integers(image, nothing, False, sums, out, nothing)
    kernels.halve_integers(image, np.ones((7, 9), np.uint8), True, sums, masked, np.empty((4, 5), np.uint8))
    np.testing.assert_array_equal(out, masked)


@given(shapes, st.sampled_from(DTYPES[:3]), st.integers(0, 9))
@settings(deadline=None, max_examples=40)
def test_the_nearest_half_is_the_first_valid_pixel(shape, dtype, seed):
    image = noise(shape, dtype, seed)
    valid = (np.random.default_rng(seed).random(shape[:2]) < 0.4).astype(np.uint8)
    rows, cols = -(-shape[0] // 2), -(-shape[1] // 2)
    out, out_valid = np.empty((rows, cols, shape[2]), dtype), np.empty((rows, cols), np.uint8)
    kernels.halve_nearest(image, valid, True, out, out_valid)
    for r in range(rows):
        for c in range(cols):
            block = (slice(2 * r, 2 * r + 2), slice(2 * c, 2 * c + 2))
            samples = image[block][valid[block] == 1]
            assert out_valid[r, c] == (len(samples) > 0)
            if len(samples):
                np.testing.assert_array_equal(out[r, c], samples[0])


@pytest.mark.parametrize("dtype", DTYPES)
def test_filling_keeps_valid_samples_apart_from_the_fill(dtype):
    image = noise((20, 23, 2), dtype)
    fill = np.dtype(dtype).type(7)
    image[3:9, 4:8] = fill
    valid = np.ones((20, 23), np.uint8)
    valid[5:15, 6:10] = 0
    out = np.empty((16, 16, 2), dtype)
    kernels.fill_tile(image, valid, True, 8, 10, fill, fill + 1, out)
    kernels.fill_tile(image, valid, True, 2, 3, fill, fill + 1, out)
    expected = np.where(image == fill, fill + 1, image)
    expected[valid == 0] = fill
    np.testing.assert_array_equal(out, expected[2:18, 3:19])
    kernels.fill_tile(image, valid, False, 12, 12, fill, fill, out)
    np.testing.assert_array_equal(out, np.pad(image[12:20, 12:23], ((0, 8), (0, 5), (0, 0)), "edge"))


@given(shapes, st.sampled_from(DTYPES[:3]), st.floats(0, 1), st.integers(0, 9))
@settings(deadline=None, max_examples=60)
def test_sums_are_exact(shape, dtype, share, seed):
    image = noise(shape, dtype, seed)
    valid = (np.random.default_rng(seed).random(shape[:2]) < share).astype(np.uint8)
    accumulator = np.uint32 if dtype == "uint8" else np.int64
    width = shape[1] * shape[2]
    total, squares = np.zeros(width, accumulator), np.zeros(width, accumulator)
    limits = np.iinfo(dtype)
    low, high = np.full(width, limits.max, dtype), np.full(width, limits.min, dtype)
    count = kernels.add_statistics(image, valid, True, total, squares, low, high)
    samples = image[valid == 1].astype(np.int64)
    assert count == len(samples)
    by_band = total.reshape(-1, shape[2]).sum(0, dtype=np.int64)
    np.testing.assert_array_equal(by_band, samples.sum(0))
    np.testing.assert_array_equal(squares.reshape(-1, shape[2]).sum(0, dtype=np.int64), (samples**2).sum(0))
    if count:
        np.testing.assert_array_equal(low.reshape(-1, shape[2]).min(0), samples.min(0))
        np.testing.assert_array_equal(high.reshape(-1, shape[2]).max(0), samples.max(0))


def test_the_largest_sums_of_a_chunk_do_not_overflow():
    rows = 32768
    for dtype, accumulator in (("uint8", np.uint32), ("uint16", np.int64), ("int16", np.int64)):
        limits = np.iinfo(dtype)
        worst = limits.max if limits.min == 0 else limits.min
        image = np.full((rows, 1, 1), worst, dtype)
        sums = np.zeros((2, 1), accumulator)
        low, high = np.zeros(1, dtype), np.zeros(1, dtype)
        kernels.add_statistics(image, np.empty((0, 0), np.uint8), False, sums[0], sums[1], low, high)
        assert [int(s) for s in sums[:, 0]] == [rows * int(worst), rows * int(worst) ** 2]


def test_sums_of_floats_leave_out_nan():
    image = noise((30, 20, 2), "float32")
    image[3:5, :, 0] = np.nan
    valid = np.ones((30, 20), np.uint8)
    valid[10:] = 0
    counts, sums = np.zeros(2, np.int64), np.zeros((2, 2))
    limits = np.tile([np.inf, -np.inf], (2, 1))
    kernels.add_float_statistics(image, valid, True, counts, sums, limits)
    part = image[:10].astype(float)
    assert counts.tolist() == [160, 200]
    np.testing.assert_allclose(sums[:, 0], np.nansum(part, (0, 1)), rtol=1e-12)
    np.testing.assert_allclose(sums[:, 1], np.nansum(part**2, (0, 1)), rtol=1e-12)
    np.testing.assert_array_equal(limits[:, 0], np.nanmin(part, (0, 1)))
    np.testing.assert_array_equal(limits[:, 1], np.nanmax(part, (0, 1)))


@pytest.mark.parametrize("bands", [1, 2, 3, 4])
def test_bands_are_interleaved(bands):
    planes = noise((bands, 11, 13), "uint16")
    out = np.empty((11, 13, bands), np.uint16)
    interleave(planes, out)
    np.testing.assert_array_equal(out, planes.transpose(1, 2, 0))


@pytest.mark.parametrize("dtype", DTYPES)
def test_a_pixel_is_valid_if_any_sample_is(dtype):
    image = noise((20, 23, 3), dtype)
    nodata = np.dtype(dtype).type(np.nan if dtype == "float32" else 7)
    image[3:9, 4:8] = nodata
    image[5, 5, 1] = 8
    image[12, :, :2] = nodata
    out = np.empty((20, 23), np.uint8)
    count = kernels.valid_by_nodata(image, nodata, out)
    expected = np.ones((20, 23), np.uint8)
    expected[3:9, 4:8] = 0
    expected[5, 5] = 1
    np.testing.assert_array_equal(out, expected)
    assert count == expected.sum()
