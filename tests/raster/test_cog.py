"""Cloud Optimized GeoTIFFs: what is read back is what was given, in a layout that validates."""

from __future__ import annotations

import math

import numpy as np
import pytest
import rasterio
from cog_checks import require_valid
from hypothesis import given, settings
from hypothesis import strategies as st
from rasterio.enums import MaskFlags

from stereomate.errors import CrsError, InputError
from stereomate.raster.cog import CogProfile, Georeference, assemble_cog, encode_chunk
from stereomate.tiles import Ledger, Threads, TilePlan, run

NORTH_UP = Georeference("EPSG:32633", (0.5, 0.0, 500000.0, 0.0, -0.5, 5000000.0))


def smooth(rows: int, cols: int, bands: int, dtype: str, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    image = rng.integers(-5, 6, (rows, cols, bands)).cumsum(0).cumsum(1) / 20.0
    low, high = (-1e4, 1e4) if dtype in ("float32", "int16") else (0, np.iinfo(dtype).max)
    middle = (low + high) / 2
    return np.clip(image + middle, low, high).astype(dtype)


def make(folder, profile, pixels, valid=None, georeference=NORTH_UP, plan=None, threads=1, name="cog.tif"):
    plan = plan or TilePlan((pixels.shape[1], pixels.shape[0]), 64, 2)

    def task(chunk):
        w = chunk.window
        part = (slice(w.row0, w.row1), slice(w.col0, w.col1))
        return {"image": encode_chunk(profile, plan, pixels[part], None if valid is None else valid[part])}

    ledger = Ledger.open(folder / f"{name}.ledger", "k")
    run(plan, task, ledger, Threads(threads))
    path = folder / name
    statistics = assemble_cog(path, profile, plan, ledger, "image", georeference)
    return path, statistics


def overview_of(pixels: np.ndarray, valid: np.ndarray, integers: bool) -> tuple[np.ndarray, np.ndarray]:
    """2 x 2 means of valid pixels, the slow and plain way."""
    rows, cols = -(-pixels.shape[0] // 2), -(-pixels.shape[1] // 2)
    pad = ((0, pixels.shape[0] % 2), (0, pixels.shape[1] % 2))
    weight = np.pad(valid.astype(float), pad)[..., None]
    value = np.pad(np.where(valid[..., None], pixels.astype(float), 0.0), (*pad, (0, 0)))
    total = value.reshape(rows, 2, cols, 2, -1).sum((1, 3))
    count = weight.reshape(rows, 2, cols, 2, 1).sum((1, 3))
    mean = np.divide(total, count, out=np.zeros_like(total), where=count > 0)
    return (np.floor(mean + 0.5) if integers else mean.astype(np.float32)), count[..., 0] > 0


def test_what_is_read_is_what_was_written(tmp_path):
    pixels = smooth(301, 403, 3, "uint8")
    path, statistics = make(tmp_path, CogProfile("uint8", 3), pixels)
    images = require_valid(path)
    assert [image.shape[:2] for image in images] == [(301, 403), (151, 202), (76, 101), (38, 51)]
    with rasterio.open(path) as dataset:
        np.testing.assert_array_equal(dataset.read().transpose(1, 2, 0), pixels)
        assert dataset.overviews(1) == [2, 4, 8]
        assert dataset.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert dataset.compression.value == "ZSTD"
        assert [c.name for c in dataset.colorinterp] == ["red", "green", "blue"]
        assert dataset.crs.to_epsg() == 32633
        assert tuple(dataset.transform)[:6] == NORTH_UP.transform
        assert dataset.nodata is None
    for band, of_band in enumerate(statistics):
        assert of_band.count == pixels[..., band].size
        assert of_band.mean == pytest.approx(pixels[..., band].mean(), rel=1e-14)
        assert of_band.standard_deviation == pytest.approx(pixels[..., band].std(), rel=1e-12)


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "int16", "float32"])
@pytest.mark.parametrize("compression", ["zstd", "deflate", "none"])
@pytest.mark.parametrize("bands", [1, 3, 5])
def test_every_lossless_kind_comes_back_with_its_mask(tmp_path, dtype, compression, bands):
    pixels = smooth(150, 170, bands, dtype)
    valid = np.hypot(*np.mgrid[-75:75, -85:85]) < 80
    profile = CogProfile(dtype, bands, mask=True, compression=compression)
    path, _ = make(tmp_path, profile, pixels, valid)
    require_valid(path)
    with rasterio.open(path) as dataset:
        assert dataset.mask_flag_enums[0] == [MaskFlags.per_dataset]
        np.testing.assert_array_equal(dataset.dataset_mask() != 0, valid)
        back = dataset.read().transpose(1, 2, 0)
        np.testing.assert_array_equal(back[valid], pixels[valid])
        assert (back[~valid] == 0).all()


@pytest.mark.parametrize("dtype", ["uint8", "int16", "float32"])
def test_overviews_are_means_of_the_valid_pixels_through_all_levels(tmp_path, dtype):
    pixels = smooth(517, 390, 3, dtype)
    valid = np.random.default_rng(3).random(pixels.shape[:2]) < 0.6
    valid[:200, :250] = False
    valid[300:, 200:] = True
    path, _ = make(tmp_path, CogProfile(dtype, 3, mask=True), pixels, valid)
    require_valid(path)
    expected, mask = pixels, valid
    for level in range(4):
        expected, mask = overview_of(expected, mask, dtype != "float32")
        with rasterio.open(path, overview_level=level) as dataset:
            np.testing.assert_array_equal(dataset.dataset_mask() != 0, mask)
            back = dataset.read().transpose(1, 2, 0)
            np.testing.assert_array_equal(back[mask], expected[mask].astype(dtype))


@given(st.integers(1, 300), st.integers(1, 300), st.sampled_from([1, 2, 4]), st.booleans(), st.integers(0, 9))
@settings(deadline=None, max_examples=25)
def test_any_size_validates_and_comes_back(tmp_path_factory, rows, cols, chunk_tiles, masked, seed):
    folder = tmp_path_factory.mktemp("cog")
    pixels = smooth(rows, cols, 3, "uint8", seed)
    rng = np.random.default_rng(seed)
    valid = np.kron(rng.random((10, 10)) < 0.5, np.ones((30, 30), bool))[:rows, :cols] if masked else None
    plan = TilePlan((cols, rows), 32, chunk_tiles)
    path, _ = make(folder, CogProfile("uint8", 3, mask=masked), pixels, valid, plan=plan)
    images = require_valid(path)
    expected, mask = pixels, np.ones((rows, cols), bool) if valid is None else valid
    for level in range(sum(not image.is_mask for image in images)):
        options = {} if level == 0 else {"overview_level": level - 1}
        with rasterio.open(path, **options) as dataset:
            np.testing.assert_array_equal(dataset.dataset_mask() != 0, mask)
            np.testing.assert_array_equal(dataset.read().transpose(1, 2, 0)[mask], expected[mask])
        expected, mask = overview_of(expected, mask, True)


def test_the_size_of_a_chunk_changes_no_pixel_and_no_tile(tmp_path):
    pixels = smooth(500, 700, 3, "uint8")
    valid = smooth(500, 700, 1, "uint8", 5)[..., 0] > 120
    files = []
    for chunk_tiles in (1, 2, 8):
        plan = TilePlan((700, 500), 64, chunk_tiles)
        profile = CogProfile("uint8", 3, mask=True)
        path, _ = make(tmp_path, profile, pixels, valid, plan=plan, name=f"{chunk_tiles}.tif")
        files.append(path.read_bytes())
    assert files[0] == files[1] == files[2]


def test_two_runs_give_the_same_bytes_whatever_the_threads(tmp_path):
    pixels = smooth(500, 700, 3, "uint8")
    one, _ = make(tmp_path, CogProfile("uint8", 3), pixels, name="one.tif")
    two, _ = make(tmp_path, CogProfile("uint8", 3), pixels, name="two.tif", threads=4)
    assert one.read_bytes() == two.read_bytes()


@pytest.mark.parametrize("nodata", [0, 255, 7])
def test_valid_samples_equal_to_nodata_stay_valid(tmp_path, nodata):
    pixels = np.full((100, 90, 3), nodata, np.uint8)
    pixels[..., 1] = 100
    valid = np.zeros((100, 90), bool)
    valid[20:80, 30:70] = True
    path, statistics = make(tmp_path, CogProfile("uint8", 3, nodata=nodata), pixels, valid)
    require_valid(path)
    with rasterio.open(path) as dataset:
        assert dataset.nodata == nodata
        for band in (1, 2, 3):
            np.testing.assert_array_equal(dataset.read_masks(band) != 0, valid)
        assert set(np.unique(dataset.read(1)[valid])) == {nodata + 1 if nodata == 0 else nodata - 1}
    assert statistics[1].count == valid.sum()


def test_nan_marks_what_floats_do_not_know(tmp_path):
    pixels = smooth(200, 300, 1, "float32")
    pixels[50:90, :100] = np.nan
    path, statistics = make(tmp_path, CogProfile("float32", 1, nodata=math.nan), pixels)
    require_valid(path)
    with rasterio.open(path) as dataset:
        assert math.isnan(dataset.nodata)
        np.testing.assert_array_equal(dataset.read(1), pixels[..., 0])
        items = dataset.tags(1)
    assert (
        float(items["STATISTICS_MEAN"])
        == statistics[0].mean
        == pytest.approx(np.nanmean(pixels, dtype=float))
    )
    assert float(items["STATISTICS_MINIMUM"]) == np.nanmin(pixels)
    assert statistics[0].standard_deviation == pytest.approx(np.nanstd(pixels.astype(float)), rel=1e-9)


def test_overviews_of_categories_hold_only_categories(tmp_path):
    pixels = np.kron(np.random.default_rng(0).integers(0, 4, (40, 50)), np.ones((7, 7)))[..., None]
    pixels = (pixels * 100).astype(np.uint16)
    profile = CogProfile("uint16", 1, nodata=0, overviews="nearest", statistics=False)
    path, statistics = make(tmp_path, profile, pixels)
    require_valid(path)
    assert statistics[0].count == 0
    with rasterio.open(path, overview_level=1) as dataset:
        small = dataset.read(1)
        assert "STATISTICS_MEAN" not in dataset.tags(1)
    assert set(np.unique(small)) <= {0, 100, 200, 300}
    blocks = pixels[:280, :348, 0].reshape(70, 4, 87, 4)
    np.testing.assert_array_equal(small[:70, :87] == 0, (blocks == 0).all((1, 3)))


def test_tiles_without_a_valid_pixel_take_no_room(tmp_path):
    pixels = smooth(600, 600, 3, "uint8")
    valid = np.zeros((600, 600), bool)
    valid[500:, 500:] = True
    path, _ = make(tmp_path, CogProfile("uint8", 3, mask=True), pixels, valid)
    main = require_valid(path)[0]
    assert sum(size > 0 for size in main.sizes) == 9
    empty, statistics = make(
        tmp_path, CogProfile("uint8", 3, mask=True), pixels, valid & False, name="empty.tif"
    )
    require_valid(empty)
    assert empty.stat().st_size < 6000
    assert statistics[0].count == 0
    with rasterio.open(empty) as dataset:
        assert not dataset.dataset_mask().any()


@pytest.mark.parametrize(
    ("compression", "bands", "level", "worst"),
    [("jpeg", 3, 95, 12), ("jpeg", 1, 95, 6), ("webp", 3, 95, 25), ("webp", 3, 100, 0), ("webp", 4, 100, 0)],
)
def test_lossy_codecs_come_close_and_the_mask_stays_exact(tmp_path, compression, bands, level, worst):
    pixels = smooth(200, 300, bands, "uint8")
    valid = np.hypot(*np.mgrid[-100:100, -150:150]) < 140
    profile = CogProfile("uint8", bands, mask=True, compression=compression, level=level)
    path, _ = make(tmp_path, profile, pixels, valid)
    require_valid(path)
    inner = np.hypot(*np.mgrid[-100:100, -150:150]) < 120
    with rasterio.open(path) as dataset:
        assert dataset.profile["compress"] == compression
        np.testing.assert_array_equal(dataset.dataset_mask() != 0, valid)
        back = dataset.read().transpose(1, 2, 0)
    difference = np.abs(back.astype(int) - pixels)[inner]
    assert np.median(difference) <= worst / 3
    assert difference.max() <= worst


@pytest.mark.parametrize(
    ("crs", "transform"),
    [
        ("+proj=tmerc +lat_0=0 +lon_0=25 +k=1 +x_0=0 +y_0=0 +ellps=WGS84 +units=m", (2, 0, 1e5, 0, -2, 3e6)),
        ("EPSG:2154", (0.3, 0.1, 7e5, 0.1, -0.3, 6.6e6)),
        ("EPSG:32633+5773", (1, 0, 5e5, 0, -1, 5e6)),
        ("EPSG:2193", (1, 0, 1.5e6, 0, -1, 5.4e6)),
        ("", (1, 0, 10, 0, -1, 20)),
    ],
)
def test_crs_and_rotated_geotransforms_come_back(tmp_path, crs, transform):
    pixels = smooth(70, 80, 1, "uint8")
    georeference = Georeference(
        crs, tuple(map(float, transform)), {"LAW": "logarithmic", "TIFFTAG_SOFTWARE": "stereomate"}
    )
    path, _ = make(tmp_path, CogProfile("uint8", 1), pixels, georeference=georeference)
    require_valid(path)
    with rasterio.open(path) as dataset:
        assert tuple(dataset.transform)[:6] == pytest.approx(transform, rel=1e-15)
        assert dataset.tags()["LAW"] == "logarithmic"
        assert dataset.tags()["TIFFTAG_SOFTWARE"] == "stereomate"
        expected = rasterio.CRS.from_user_input(crs) if crs else None
        assert dataset.crs == expected


def test_an_unknown_crs_is_an_error_and_leaves_no_file(tmp_path):
    with pytest.raises(CrsError, match="must be a coordinate reference system"):
        make(
            tmp_path,
            CogProfile("uint8", 1),
            smooth(10, 10, 1, "uint8"),
            georeference=Georeference("no crs", None),
        )
    assert [path.name for path in tmp_path.iterdir()] == ["cog.tif.ledger"]


def test_roles_descriptions_and_statistics_of_bands(tmp_path):
    pixels = smooth(100, 100, 4, "uint16")
    profile = CogProfile(
        "uint16",
        4,
        roles=("red", "green", "blue", "undefined"),
        descriptions=("R", "G", "B", "near infrared"),
    )
    path, statistics = make(tmp_path, profile, pixels)
    require_valid(path)
    with rasterio.open(path) as dataset:
        assert dataset.descriptions == ("R", "G", "B", "near infrared")
        assert [c.name for c in dataset.colorinterp] == ["red", "green", "blue", "undefined"]
        for band in range(4):
            items = dataset.tags(band + 1)
            assert float(items["STATISTICS_STDDEV"]) == pytest.approx(
                pixels[..., band].std(dtype=float), rel=1e-12
            )
            assert float(items["STATISTICS_MAXIMUM"]) == pixels[..., band].max() == statistics[band].maximum


def test_a_file_beyond_4_gib_becomes_a_bigtiff(tmp_path, monkeypatch):
    from stereomate.raster.cog import assemble

    monkeypatch.setattr(assemble, "_CLASSIC_LIMIT", 10000)
    pixels = smooth(300, 300, 3, "uint8")
    path, _ = make(tmp_path, CogProfile("uint8", 3, mask=True), pixels)
    require_valid(path)
    assert path.read_bytes()[:4] == b"II\x2b\x00"
    with rasterio.open(path) as dataset:
        np.testing.assert_array_equal(dataset.read().transpose(1, 2, 0), pixels)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"dtype": "float64"}, "dtype: must be one of"),
        ({"bands": 0}, "bands: must be 1 or more"),
        ({"mask": True, "nodata": 0}, "nodata: must not have a mask as well"),
        ({"nodata": 256}, "nodata: must be a value of uint8"),
        ({"nodata": math.nan}, "nodata: must be a value of uint8"),
        ({"roles": ("red",)}, "roles: must be 3"),
        ({"compression": "jpeg", "bands": 4}, "compression: must be lossless"),
        ({"compression": "jpeg", "nodata": 0}, "nodata: must be a mask with lossy tiles"),
        ({"level": 99}, "level: must be 1 to 22 for zstd"),
    ],
)
def test_profiles_that_cannot_be_written_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        CogProfile(**{"dtype": "uint8", "bands": 3} | arguments)


def test_pixels_that_do_not_fit_the_profile_are_refused():
    plan = TilePlan((100, 100), 64, 1)
    profile = CogProfile("uint8", 3)
    with pytest.raises(InputError, match="pixels: must be uint8, got 'uint16'"):
        encode_chunk(profile, plan, np.zeros((10, 10, 3), np.uint16))
    with pytest.raises(InputError, match=r"must be \(rows, cols, 3\)"):
        encode_chunk(profile, plan, np.zeros((10, 10), np.uint8))
    with pytest.raises(InputError, match="must have 1 to 64"):
        encode_chunk(profile, plan, np.zeros((65, 10, 3), np.uint8))
    with pytest.raises(InputError, match="must be all valid"):
        encode_chunk(profile, plan, np.zeros((10, 10, 3), np.uint8), np.zeros((10, 10), bool))
