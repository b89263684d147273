"""Photographs: windows, masks, formats without windows, files that are missing or cut off."""

from __future__ import annotations

import os
import pickle
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import rasterio
from hypothesis import given, settings
from hypothesis import strategies as st

from stereomate.errors import ImageError
from stereomate.raster import Window, open_photo
from stereomate.raster.decoded import DECODED, DecodedCache, Decoder
from stereomate.raster.settings import Resources, configure, current

SIZE = (301, 203)


def write(path: Path, pixels: np.ndarray, driver: str = "GTiff", **options: object) -> Path:
    rows, cols, bands = pixels.shape
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with rasterio.open(
            path, "w", driver=driver, width=cols, height=rows, count=bands, dtype=pixels.dtype, **options
        ) as dataset:
            dataset.write(pixels.transpose(2, 0, 1))
    return path


@pytest.fixture(scope="module")
def pixels() -> np.ndarray:
    return np.random.default_rng(1).integers(0, 256, (SIZE[1], SIZE[0], 3), dtype=np.uint8)


@pytest.fixture(scope="module")
def tiled(tmp_path_factory: pytest.TempPathFactory, pixels: np.ndarray) -> Path:
    path = tmp_path_factory.mktemp("photos") / "tiled.tif"
    return write(path, pixels, tiled=True, blockxsize=64, blockysize=64, compress="deflate")


@given(st.integers(-50, 350), st.integers(-50, 250), st.integers(0, 400), st.integers(0, 300))
@settings(deadline=None, max_examples=50)
def test_a_window_is_clamped_and_holds_the_pixels_of_the_file(tiled, pixels, col0, row0, cols, rows):
    with open_photo(tiled) as photo:
        part, window = photo.read_window(col0, row0, cols, rows)
    inside_cols = [c for c in range(col0, col0 + cols) if 0 <= c < SIZE[0]]
    inside_rows = [r for r in range(row0, row0 + rows) if 0 <= r < SIZE[1]]
    assert (window.cols, window.rows) == (len(inside_cols), len(inside_rows)) == part.shape[1::-1]
    assert part.flags.c_contiguous
    if part.size:
        assert (window.col0, window.row0) == (inside_cols[0], inside_rows[0])
        np.testing.assert_array_equal(part, pixels[np.ix_(inside_rows, inside_cols)])


@pytest.mark.parametrize(
    ("options", "windowed"),
    [
        ({"tiled": True, "blockxsize": 64, "blockysize": 64}, True),
        ({"blockysize": 16}, True),
        ({"interleave": "band"}, True),
        ({"driver": "PNG"}, False),
    ],
)
def test_every_layout_gives_the_same_pixels(tmp_path, pixels, options, windowed):
    path = write(tmp_path / "photo", pixels, **options)
    with open_photo(path) as photo:
        assert photo.is_windowed is windowed
        part, window = photo.read_window(20, 30, 100, 50)
    assert window == (20, 30, 100, 50)
    np.testing.assert_array_equal(part, pixels[30:80, 20:120])


def test_a_tiff_of_one_large_strip_is_decoded_once(tmp_path):
    big = np.arange(1200 * 1000 * 3, dtype=np.uint32).astype(np.uint8).reshape(1200, 1000, 3)
    path = write(tmp_path / "strip.tif", big, blockysize=1200, compress="deflate")
    with open_photo(path) as photo:
        assert not photo.is_windowed
        part, _ = photo.read_window(900, 1100, 500, 500)
    np.testing.assert_array_equal(part, big[1100:, 900:])


def test_a_jpeg_is_decoded_once_for_many_threads_and_forgotten_on_close(tmp_path, pixels):
    path = write(tmp_path / "photo.jpg", pixels, driver="JPEG")
    held = DECODED.held_bytes(in_memory=True)
    with open_photo(path) as photo:
        assert not photo.is_windowed
        with ThreadPoolExecutor(4) as pool:
            parts = list(pool.map(lambda _: photo.read_window(0, 0, 50, 50)[0], range(16)))
        assert DECODED.held_bytes(in_memory=True) == held + pixels.nbytes
    assert DECODED.held_bytes(in_memory=True) == held
    assert all((part == parts[0]).all() for part in parts)


def decoder_of(image: np.ndarray, log: list[str] | None = None, name: str = "") -> Decoder:
    def slabs():
        if log is not None:
            log.append(name)
        for row in range(0, image.shape[0], 7):
            yield image[row : row + 7]

    return Decoder(image.shape, image.dtype, slabs)


def test_what_does_not_fit_in_memory_goes_to_disk_and_reads_the_same(pixels):
    cache = DecodedCache(lambda: pixels.nbytes + 10, lambda: 10**12)
    where = [cache.get(name, decoder_of(pixels)).in_memory for name in ("a", "b", "a", "c")]
    assert where == [True, False, True, False]
    for window in (Window(5, 6, 100, 50), Window(0, 10, SIZE[0], 20), Window(SIZE[0] - 1, 0, 1, SIZE[1])):
        part = np.empty((window.rows, window.cols, 3), np.uint8)
        for name in ("a", "b"):
            part[...] = 0
            cache.get(name, decoder_of(pixels)).read(window, part)
            np.testing.assert_array_equal(part, pixels[window.row0 : window.row1, window.col0 : window.col1])
    cache.discard("b")
    assert (cache.held_bytes(True), cache.held_bytes(False)) == (pixels.nbytes, pixels.nbytes)


@pytest.mark.parametrize("in_memory", [True, False])
def test_without_room_the_photograph_not_used_for_longest_is_forgotten(in_memory):
    image = np.zeros((10, 10, 1), np.uint8)
    cache: DecodedCache
    if in_memory:
        cache = DecodedCache(lambda: 250, lambda: 0)
    else:
        cache = DecodedCache(lambda: 0, lambda: 250 - cache.held_bytes(False))
    decoded: list[str] = []
    for name in ("a", "b", "a", "c", "a", "b"):
        assert cache.get(name, decoder_of(image, decoded, name)).in_memory is in_memory
    assert decoded == ["a", "b", "c", "b"]
    assert cache.held_bytes(in_memory) == 200


def test_a_photograph_larger_than_all_limits_is_still_read():
    image = np.ones((10, 10, 1), np.uint8)
    cache = DecodedCache(lambda: 50, lambda: 50)
    assert cache.get("a", decoder_of(image)).in_memory


@pytest.mark.parametrize("driver", ["PNG", "GTiff"])
def test_the_alpha_band_of_a_photograph_says_what_is_valid(tmp_path, pixels, driver):
    alpha = np.zeros((*pixels.shape[:2], 1), np.uint8)
    alpha[20:90, 30:200] = 255
    options = {"photometric": "RGB", "alpha": "YES"} if driver == "GTiff" else {}
    path = write(tmp_path / "photo", np.dstack([pixels, alpha]), driver=driver, **options)
    with open_photo(path) as photo:
        valid, window = photo.read_mask(25, 10, 100, 100)
        assert photo.info.colour_bands == (0, 1, 2)
    np.testing.assert_array_equal(valid, alpha[10:110, 25:125, 0] != 0)
    assert window == (25, 10, 100, 100)


def test_threads_read_different_windows_side_by_side(tiled, pixels):
    windows = [(c, r, 70, 60) for c in range(0, 300, 37) for r in range(0, 200, 41)]
    with open_photo(tiled) as photo, ThreadPoolExecutor(8) as pool:
        parts = list(pool.map(lambda w: photo.read_window(*w), windows * 4))
    for part, window in parts:
        np.testing.assert_array_equal(part, pixels[window.row0 : window.row1, window.col0 : window.col1])


def test_facts_of_a_georeferenced_raster(tmp_path):
    path = write(
        tmp_path / "map.tif",
        np.ones((4, 5, 4), np.uint16),
        crs="EPSG:32633",
        transform=rasterio.Affine(2, 1, 500000, 1, -2, 5000000),
        photometric="RGB",
        alpha="YES",
    )
    with open_photo(path) as photo:
        info = photo.info
    assert (info.size, info.bands, info.dtype) == ((5, 4), 4, np.dtype("uint16"))
    assert info.roles == ("red", "green", "blue", "alpha")
    assert info.alpha_band == 3
    assert info.colour_bands == (0, 1, 2)
    assert info.has_mask
    assert info.transform == (2, 1, 500000, 1, -2, 5000000)
    assert "32633" in info.crs_wkt


def test_a_photograph_without_georeference_says_so(tiled):
    with open_photo(tiled) as photo:
        assert photo.info.crs_wkt == ""
        assert photo.info.transform is None
        assert photo.nodata is None
        valid, _ = photo.read_mask(0, 0, 10, 10)
    assert valid.all()


def test_valid_pixels_by_nodata_and_by_internal_mask(tmp_path):
    pixels = np.full((40, 50, 1), 9, np.uint8)
    pixels[:10] = 0
    by_nodata = write(tmp_path / "nodata.tif", pixels, nodata=0)
    by_mask = tmp_path / "mask.tif"
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
        write(by_mask, pixels)
        with rasterio.open(by_mask, "r+") as dataset:
            dataset.write_mask(pixels[..., 0] != 0)
    for path in (by_nodata, by_mask):
        with open_photo(path) as photo:
            valid, window = photo.read_mask(0, 5, 50, 40)
            assert photo.info.has_mask is (path == by_mask)
        assert window.rows == 35
        np.testing.assert_array_equal(valid, pixels[5:, :, 0] != 0)


def test_a_reader_travels_to_another_process_as_its_path(tiled, pixels):
    with open_photo(tiled) as photo:
        other = pickle.loads(pickle.dumps(photo))
    with other:
        np.testing.assert_array_equal(other.read_window(0, 0, *SIZE)[0], pixels)


def test_a_missing_file_is_named():
    with pytest.raises(ImageError, match=r"nowhere\.tif: no such file"):
        open_photo("nowhere.tif")


def test_a_url_is_no_file():
    with pytest.raises(ImageError, match="no such file"):
        open_photo("/vsicurl/http://localhost/x.tif")


def test_a_file_that_is_no_raster_is_named(tmp_path):
    path = tmp_path / "notes.tif"
    path.write_text("not a raster")
    with pytest.raises(ImageError, match=r"notes\.tif: cannot be read"):
        open_photo(path)


@pytest.mark.parametrize("driver", ["GTiff", "JPEG", "PNG"])
def test_a_file_cut_off_in_the_middle_is_an_error_that_names_it(tmp_path, driver):
    smooth = np.cumsum(np.random.default_rng(0).integers(-3, 4, (400, 500, 3)), axis=1) % 200
    options = {"tiled": True, "blockxsize": 64, "blockysize": 64} if driver == "GTiff" else {}
    path = write(tmp_path / "whole", smooth.astype(np.uint8), driver=driver, **options)
    cut = tmp_path / "cut"
    data = path.read_bytes()
    cut.write_bytes(data[: len(data) * 6 // 10])
    with open_photo(path) as photo:
        photo.require_complete()
    with pytest.raises(ImageError, match="cut: "), open_photo(cut) as photo:
        photo.read_window(0, 0, 500, 400)
    with pytest.raises(ImageError, match="cut: "), open_photo(cut) as photo:
        photo.require_complete()


def test_limits_come_from_the_environment_and_govern_gdal(monkeypatch):
    before = current()
    monkeypatch.setenv("STEREOMATE_THREADS", "3")
    monkeypatch.setenv("STEREOMATE_MEMORY", str(384 * 1024**2))
    try:
        configure(Resources.from_environment())
        assert current() == Resources(384 * 1024**2, 3)
        assert os.environ["PROJ_NETWORK"] == "OFF"
        assert rasterio.env.get_gdal_config("GDAL_CACHEMAX") == 32 * 1024**2
        assert rasterio.env.get_gdal_config("GDAL_NUM_THREADS") == 1
    finally:
        configure(before)


def test_pixels_come_into_a_buffer_that_is_used_again(tiled, pixels):
    buffer = np.empty(300 * 300 * 3, np.uint8)
    with open_photo(tiled) as photo:
        part, _ = photo.read_window(10, 20, 200, 100, out=buffer)
        assert np.shares_memory(part, buffer)
        np.testing.assert_array_equal(part, pixels[20:120, 10:210])
        too_small, _ = photo.read_window(0, 0, *SIZE, out=np.empty(5, np.uint8))
        np.testing.assert_array_equal(too_small, pixels)


@pytest.mark.parametrize("dtype", ["uint16", "float32"])
@pytest.mark.parametrize("bands", [1, 2, 3, 4])
def test_large_windows_of_any_type_are_read_slab_by_slab(tmp_path, monkeypatch, dtype, bands):
    from stereomate.raster import handles

    monkeypatch.setattr(handles, "_SLAB_BYTES", 5000)
    image = np.random.default_rng(2).integers(0, 2000, (203, 301, bands)).astype(dtype)
    path = write(tmp_path / "photo.tif", image, tiled=True, blockxsize=32, blockysize=16)
    with open_photo(path) as photo:
        part, _ = photo.read_window(7, 9, 280, 190)
    np.testing.assert_array_equal(part, image[9:199, 7:287])
