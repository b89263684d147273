"""Height models: voids, scale and offset, units."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio

from stereomate.errors import ImageError
from stereomate.raster import open_heights


def write(path, stored, **options):
    scale, offset, units = (options.pop(k, None) for k in ("scale", "offset", "units"))
    options = {"crs": "EPSG:32633", "transform": rasterio.Affine(10, 0, 5e5, 0, -10, 5e6)} | options
    rows, cols = stored.shape
    with rasterio.open(
        path, "w", driver="GTiff", width=cols, height=rows, count=1, dtype=stored.dtype, **options
    ) as dataset:
        dataset.write(stored, 1)
        if scale is not None:
            dataset.scales, dataset.offsets = (scale,), (offset,)
        if units is not None:
            dataset.units = (units,)
    return path


@pytest.mark.parametrize("nodata", [-32768.0, float("nan"), -3.4028234663852886e38])
def test_voids_are_nan_whatever_stands_for_them(tmp_path, nodata):
    stored = np.arange(60, dtype=np.float32).reshape(6, 10)
    stored[2, 3] = nodata
    stored[4, 4] = np.inf
    path = write(tmp_path / "dem.tif", stored, nodata=nodata)
    with open_heights(path) as reader:
        heights, window = reader.read_window(1, -3, 50, 50)
    assert window == (1, 0, 9, 6)
    assert heights.dtype == np.float64
    expected = stored[:, 1:].astype(float)
    expected[2, 2] = expected[4, 3] = np.nan
    np.testing.assert_array_equal(heights, expected)


def test_scale_offset_and_units(tmp_path):
    stored = np.array([[0, 100], [2000, 65535]], np.uint16)
    path = write(tmp_path / "dem.tif", stored, nodata=65535, scale=0.01, offset=-50.0, units="metre")
    with open_heights(path) as reader:
        heights, _ = reader.read_window(0, 0, 2, 2)
        assert reader.scale.units == "metre"
    np.testing.assert_allclose(heights, [[-50, -49], [-30, np.nan]])


def test_the_vertical_part_of_a_crs_is_kept(tmp_path):
    path = write(tmp_path / "dem.tif", np.zeros((2, 2), np.float32), crs="EPSG:32633+5773")
    with open_heights(path) as reader:
        assert "VERTCRS" in reader.info.crs_wkt
        assert "5773" in reader.info.crs_wkt


def test_more_than_one_band_is_no_height_model(tmp_path):
    path = tmp_path / "rgb.tif"
    with rasterio.open(path, "w", driver="GTiff", width=2, height=2, count=3, dtype="uint8") as dataset:
        dataset.write(np.zeros((3, 2, 2), np.uint8))
    with pytest.raises(ImageError, match=r"rgb\.tif: must have one band to be a height model, got 3"):
        open_heights(path)
