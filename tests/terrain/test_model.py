"""Height models: windows, voids, units, positions, memory, and features burned in."""

from __future__ import annotations

import hashlib
import pickle
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import rasterio
import shapely
from rasterio.transform import Affine
from scipy.interpolate import RegularGridInterpolator

from stereomate.errors import CoverageError, CrsError, HeightSystemError, ImageError, InputError
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.terrain.breaklines import BurnedSurface, SurfaceFeature
from stereomate.terrain.model import HeightModel, windows

UTM = "EPSG:32631"
AFFINE = (5.0, 0.0, 500000.0, 0.0, -5.0, 4900000.0)
FRAME = MapFrame(UTM, HeightSystem.ellipsoidal())


def written(
    path: Path, heights: np.ndarray, *, nodata=None, units=None, crs=UTM, transform=AFFINE, **more
) -> Path:
    count = heights.shape[0] if heights.ndim == 3 else 1
    profile = {
        "driver": "GTiff",
        "width": heights.shape[-1],
        "height": heights.shape[-2],
        "count": count,
        "dtype": heights.dtype,
        "nodata": nodata,
        "crs": crs,
        **more,
    }
    if transform is not None:
        profile["transform"] = Affine(*transform)
    with rasterio.open(path, "w", **profile) as target:
        target.write(heights if heights.ndim == 3 else heights[None])
        if units:
            target.units = (units,) * count
    return path


@pytest.fixture
def hills() -> np.ndarray:
    rng = np.random.default_rng(11)
    return rng.uniform(200.0, 260.0, (60, 80)).astype(np.float32)


def test_windows_are_clamped_and_padded(tmp_path: Path, hills: np.ndarray) -> None:
    hills[10:12, 20:23] = -9999.0
    model = HeightModel.open(written(tmp_path / "dem.tif", hills, nodata=-9999.0), HeightSystem.ellipsoidal())
    truth = np.where(hills == -9999.0, np.nan, hills.astype(float))
    assert model.shape == (60, 80)
    np.testing.assert_array_equal(model.patch(15, 5, 20, 12).heights, truth[5:17, 15:35])
    outer = model.patch(-3, -2, 90, 70)
    assert (outer.col0, outer.row0) == (-3, -2)
    np.testing.assert_array_equal(outer.heights[2:62, 3:83], truth)
    outside = np.ones(outer.heights.shape, bool)
    outside[2:62, 3:83] = False
    assert np.isnan(outer.heights[outside]).all()
    assert model.patch(500, 500, 4, 3).is_void
    assert model.patch(0, 0, 0, 0).heights.shape == (0, 0)
    assert model.range == (np.nanmin(truth), np.nanmax(truth)) == (model.min, model.max)


def test_positions_on_a_rotated_model(hills: np.ndarray) -> None:
    affine = (3.0, 1.0, 500000.0, -1.0, 3.0, 4900000.0)  # turned, rows going north
    model = HeightModel.from_array(hills, affine, FRAME)
    pixels = np.random.default_rng(1).uniform(-5, 90, (50, 2))
    xy = model.map_from_pixel(pixels)
    np.testing.assert_allclose(model.pixel_from_map(xy), pixels, atol=1e-9)
    expected = np.column_stack(rasterio.transform.xy(Affine(*affine), *pixels[:, ::-1].T, offset="ul"))
    np.testing.assert_allclose(xy, expected, rtol=0, atol=1e-9)
    reference = RegularGridInterpolator(
        (np.arange(60) + 0.5, np.arange(80) + 0.5), hills.astype(float), bounds_error=False
    )
    np.testing.assert_allclose(model.heights_at(xy), reference(pixels[:, ::-1]), rtol=0, atol=1e-6)
    np.testing.assert_allclose(model.heights_at(xy.reshape(5, 10, 2)).ravel(), model.heights_at(xy))


@pytest.mark.parametrize("method", ["bilinear", "cubic"])
def test_blockwise_sampling_does_not_depend_on_blocks(
    hills: np.ndarray, method, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = HeightModel.from_array(hills, AFFINE, FRAME)
    xy = model.map_from_pixel(np.random.default_rng(2).uniform(-2, 82, (800, 2)))
    whole = model.heights_at(xy, method)
    monkeypatch.setattr("stereomate.terrain.model._BLOCK", 7)
    # counting columns from another origin costs a rounding, and no more
    np.testing.assert_allclose(model.heights_at(xy, method), whole, rtol=0, atol=1e-11)
    assert 100 < np.isnan(whole).sum() < 500


def test_unknown_method(hills: np.ndarray) -> None:
    with pytest.raises(InputError, match="'bilinear' or 'cubic', got 'spline'"):
        HeightModel.from_array(hills, AFFINE, FRAME).heights_at([(500100.0, 4899900.0)], "spline")


@pytest.mark.parametrize(
    "written_unit, asked, factor",
    [
        ("ft", None, 0.3048),
        ("US survey foot", None, 1200 / 3937),
        ("metre", None, 1.0),
        (None, None, 1.0),
        (None, "us-survey-foot", 1200 / 3937),
        ("metre", "foot", 0.3048),
    ],
)
def test_units(tmp_path: Path, hills: np.ndarray, written_unit, asked, factor: float) -> None:
    path = written(tmp_path / "dem.tif", hills, units=written_unit)
    model = HeightModel.open(path, HeightSystem.ellipsoidal(), unit=asked)
    np.testing.assert_allclose(model.patch(0, 0, 80, 60).heights, hills.astype(float) * factor, rtol=1e-14)


def test_a_vertical_crs_keeps_its_unit(tmp_path: Path, hills: np.ndarray) -> None:
    feet = HeightSystem.vertical_crs("EPSG:6360")  # NAVD88 height in US survey feet
    path = written(tmp_path / "dem.tif", hills, units="metre")
    model = HeightModel.open(path, feet)
    np.testing.assert_allclose(model.patch(0, 0, 80, 60).heights * 1200 / 3937, hills, rtol=1e-6)
    plain = HeightModel.open(written(tmp_path / "ft.tif", hills), feet)
    np.testing.assert_array_equal(plain.patch(0, 0, 80, 60).heights, hills)


def test_scaled_integers_and_a_stated_nodata(tmp_path: Path) -> None:
    stored = np.array([[100, 200, 0], [300, -5, 400]], np.int16)
    path = written(tmp_path / "dem.tif", stored)
    with rasterio.open(path, "r+") as target:
        target.scales, target.offsets = (0.1,), (50.0,)
    model = HeightModel.open(path, HeightSystem.ellipsoidal(), nodata=0)
    expected = np.array([[60.0, 70.0, np.nan], [80.0, 49.5, 90.0]])
    np.testing.assert_allclose(model.patch(0, 0, 3, 2).heights, expected, rtol=1e-14)
    odd = written(tmp_path / "odd.tif", np.array([[-3.4028235e38, 7.0]], np.float32))
    heights = (
        HeightModel.open(odd, HeightSystem.ellipsoidal(), nodata=-3.4028235e38).patch(0, 0, 2, 1).heights
    )
    assert np.isnan(heights[0, 0])
    assert heights[0, 1] == 7.0


def test_pickle_hash_and_cell_size(tmp_path: Path, hills: np.ndarray) -> None:
    path = written(tmp_path / "dem.tif", hills)
    model = HeightModel.open(path, HeightSystem.ellipsoidal())
    assert model.content_hash == hashlib.sha256(path.read_bytes()).hexdigest()
    again = pickle.loads(pickle.dumps(model))
    assert again.content_hash == model.content_hash
    np.testing.assert_array_equal(again.patch(3, 4, 9, 8).heights, model.patch(3, 4, 9, 8).heights)
    assert len(pickle.dumps(model)) < 3000
    # near the central meridian of UTM the grid is 0.9996 of the ground
    assert model.cell_size_m == pytest.approx((5.0 / 0.9996, 5.0 / 0.9996), rel=1e-6)
    degrees = HeightModel.from_array(
        hills, (0.001, 0.0, 3.0, 0.0, -0.001, 60.0), MapFrame("EPSG:4326", HeightSystem.ellipsoidal())
    )
    assert degrees.cell_size_m == pytest.approx((55.8, 111.41), abs=0.1)
    assert degrees.resolution_m == degrees.cell_size_m[0]


def test_array_hash_tells_contents_and_shape(hills: np.ndarray) -> None:
    one = HeightModel.from_array(hills, AFFINE, FRAME)
    assert one.content_hash == HeightModel.from_array(hills.copy(), AFFINE, FRAME).content_hash
    assert one.content_hash != HeightModel.from_array(hills.reshape(80, 60), AFFINE, FRAME).content_hash
    assert one.content_hash != HeightModel.from_array(hills + 1, AFFINE, FRAME).content_hash


def test_bad_models(tmp_path: Path, hills: np.ndarray) -> None:
    ellipsoidal = HeightSystem.ellipsoidal()
    with pytest.raises(CrsError, match="states no CRS"):
        HeightModel.open(written(tmp_path / "a.tif", hills, crs=None), ellipsoidal)
    assert HeightModel.open(tmp_path / "a.tif", ellipsoidal, crs=UTM).shape == (60, 80)
    with pytest.raises(ImageError, match="geotransform"):
        HeightModel.open(written(tmp_path / "b.tif", hills, transform=None), ellipsoidal)
    with pytest.raises(HeightSystemError, match="unit of the heights must be metre"):
        HeightModel.open(written(tmp_path / "c.tif", hills, units="fathom"), ellipsoidal)
    with pytest.raises(ImageError, match="one band"):
        HeightModel.open(written(tmp_path / "d.tif", np.stack([hills, hills])), ellipsoidal)
    with pytest.raises(ImageError, match="no such file"):
        HeightModel.open(tmp_path / "none.tif", ellipsoidal)
    with pytest.raises(CoverageError, match="all of it is nodata"):
        _ = HeightModel.open(
            written(tmp_path / "e.tif", np.full_like(hills, -1), nodata=-1), ellipsoidal
        ).range
    with pytest.raises(ImageError, match="invertible geotransform"):
        HeightModel.from_array(hills, (1, 1, 0, 1, 1, 0), FRAME)
    with pytest.raises(HeightSystemError, match="upwards"):
        HeightModel.open(tmp_path / "a.tif", HeightSystem.vertical_crs("EPSG:5715"), crs=UTM)


def test_windows_cover_once() -> None:
    count = np.zeros((23, 31), int)
    for col0, row0, cols, rows in windows((23, 31), 7):
        count[row0 : row0 + rows, col0 : col0 + cols] += 1
    assert (count == 1).all()


@pytest.mark.slow
def test_a_large_model_stays_on_disk(tmp_path: Path) -> None:
    """400 million heights, 1.6 GB: range, hash and scattered heights within 100 MB."""
    path = tmp_path / "large.tif"
    rows = cols = 20000
    profile = {"driver": "GTiff", "width": cols, "height": rows, "count": 1, "dtype": "float32", "crs": UTM}
    with rasterio.open(
        path,
        "w",
        **profile,
        transform=Affine(*AFFINE),
        tiled=True,
        blockxsize=512,
        blockysize=512,
        sparse_ok=True,
    ) as target:
        target.write(np.full((1, 700, 700), 123.0, np.float32), window=((19000, 19700), (100, 800)))
    model = HeightModel.open(path, HeightSystem.ellipsoidal())
    tracemalloc.start()
    assert model.range == (0.0, 123.0)
    pixels = np.random.default_rng(3).uniform(0, 20000, (20000, 2))
    heights = model.heights_at(model.map_from_pixel(pixels))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert np.nanmax(heights) == 123.0
    assert peak < 100e6


def test_a_bridge_replaces_the_valley() -> None:
    heights = np.tile(np.abs(np.arange(40.0) - 20) * 2, (30, 1))
    model = HeightModel.from_array(heights, (1.0, 0.0, 500000.0, 0.0, -1.0, 4900030.0), FRAME)
    deck = shapely.Polygon(
        [
            (500005.0, 4900010.0, 31.0),
            (500035.0, 4900010.0, 37.0),
            (500035.0, 4900014.0, 37.0),
            (500005.0, 4900014.0, 31.0),
        ]
    )
    burned = BurnedSurface.of(model, [SurfaceFeature(deck)])
    patch = burned.patch(0, 0, 40, 30).heights
    changed = patch != heights
    assert changed[16:20, 5:35].all()
    assert changed.sum() == 4 * 30
    expected = 31.0 + 6.0 * (np.arange(5, 35) + 0.5 - 5) / 30
    np.testing.assert_allclose(patch[17, 5:35], expected, atol=1e-9)
    # any window shows the same surface
    np.testing.assert_array_equal(burned.patch(7, 15, 20, 4).heights, patch[15:19, 7:27])
    assert burned.heights_at([(500020.0, 4900012.0)])[0] == pytest.approx(34.0)
    assert burned.content_hash != model.content_hash
    assert burned.max == 40.0
    assert pickle.loads(pickle.dumps(burned)).content_hash == burned.content_hash


def test_raise_lower_lines_and_voids() -> None:
    heights = np.full((20, 20), 50.0)
    heights[8, 8] = np.nan
    model = HeightModel.from_array(heights, (2.0, 0.0, 0.0, 0.0, -2.0, 40.0), FRAME)
    square = shapely.box(10.0, 18.0, 20.0, 28.0)
    for rule, height, expected in (("raise", 45.0, 50.0), ("lower", 45.0, 45.0), ("raise", 55.0, 55.0)):
        patch = BurnedSurface.of(model, [SurfaceFeature(square, rule, height)]).patch(0, 0, 20, 20).heights
        assert patch[7, 6] == expected
        assert patch[8, 8] == height  # a void is filled in any case
        assert patch[3, 3] == 50.0
    wall = SurfaceFeature(shapely.LineString([(5.0, 31.0, 60.0), (35.0, 31.0, 75.0)]))
    patch = BurnedSurface.of(model, [wall]).patch(0, 0, 20, 20).heights
    # cells centred at x = 7 .. 33 on the line y = 31; one cell wide
    x = 2.0 * np.arange(3, 17) + 1.0
    np.testing.assert_allclose(patch[4, 3:17], 60.0 + (x - 5.0) / 2.0, atol=1e-9)
    assert (patch[[3, 5], :] == 50.0).all()


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: SurfaceFeature(shapely.Point(0, 0)), "must be a polygon or a line"),
        (lambda: SurfaceFeature(shapely.box(0, 0, 1, 1)), "height at every vertex"),
        (lambda: SurfaceFeature(shapely.box(0, 0, 1, 1), "add", 3.0), "feature.rule"),
        (
            lambda: SurfaceFeature(shapely.Polygon([(0, 0), (1, 1), (1, 0), (0, 1)]), height=3.0),
            "valid geometry",
        ),
        (lambda: SurfaceFeature(shapely.box(0, 0, 1, 1), height=np.inf), "feature.height"),
        (
            lambda: SurfaceFeature(shapely.LineString([(0, 0), (1, 1)]), height=1.0, width=0.0),
            "feature.width",
        ),
    ],
)
def test_bad_features(make, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()


@pytest.mark.real
def test_real_models(data_folder: Path) -> None:
    dtm = HeightModel.open(data_folder / "dem/dtm_philondenx_32630_nan.tif", HeightSystem.undeclared())
    heights = dtm.patch(0, 0, 512, 512).heights
    with rasterio.open(dtm.path) as source:
        band = source.read(1)
    void = ~np.isfinite(band) | (band == 0.0)
    np.testing.assert_array_equal(np.isnan(heights), void)
    assert 205.0 < dtm.min < dtm.max < 250.0
    srtm = HeightModel.open(
        data_folder / "dem/srtm90_ventoux_utm31.tif", HeightSystem.vertical_crs("EPSG:5773")
    )
    assert (srtm.min, srtm.max) == (33.0, 2745.0)
    assert srtm.resolution_m == pytest.approx(90.0, abs=0.05)
    with rasterio.open(srtm.path) as source:
        band = source.read(1).astype(float)
    band[band == -32768] = np.nan
    assert 0.0 < np.isnan(band).mean() < 0.2
    pixels = np.random.default_rng(0).uniform((0.5, 0.5), (921.5, 1261.5), (5000, 2))
    reference = RegularGridInterpolator((np.arange(1262) + 0.5, np.arange(922) + 0.5), band)
    linear = srtm.heights_at(srtm.map_from_pixel(pixels))
    np.testing.assert_allclose(linear, reference(pixels[:, ::-1]), rtol=0, atol=1e-6)
    cubic = srtm.heights_at(srtm.map_from_pixel(pixels), "cubic")
    # bicubic heights need more nodes, and overshoot by little
    assert not (np.isnan(linear) & np.isfinite(cubic)).any()
    assert np.nanmax(np.abs(cubic - linear)) < 60.0
    ngi = HeightModel.open(data_folder / "ngi_strip05/dem.tif", HeightSystem.undeclared())
    assert ngi.frame.vertical_name == "EGM2008 height"
    assert (round(ngi.min), round(ngi.max)) == (149, 781)
