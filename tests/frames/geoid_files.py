"""Geoid grid files made for tests."""

import struct

import numpy as np
import rasterio
from rasterio.transform import Affine


def bilinear_surface(lon, lat):
    """Undulations that bilinear interpolation reproduces exactly."""
    return 40.0 + 0.5 * lon - 0.3 * (lat - 45.0) + 0.02 * lon * (lat - 45.0)


def write_gtx(path, west=-2.0, south=43.0, step=0.25, rows=17, cols=25):
    lat = south + step * np.arange(rows)
    lon = west + step * np.arange(cols)
    values = bilinear_surface(lon[None, :], lat[:, None]).astype(">f4")
    path.write_bytes(struct.pack(">4d2i", south, west, step, step, rows, cols) + values.tobytes())
    return path


def write_geotiff(path, west=-2.0, south=43.0, step=0.25, rows=17, cols=25, **extra):
    lat = south + step * np.arange(rows)[::-1]
    lon = west + step * np.arange(cols)
    values = bilinear_surface(lon[None, :], lat[:, None]).astype(np.float32)
    transform = Affine(step, 0.0, west - step / 2, 0.0, -step, lat[0] + step / 2)
    profile = {"driver": "GTiff", "height": rows, "width": cols, "count": 1, "dtype": "float32"}
    profile |= {"crs": "EPSG:4326", "transform": transform} | extra
    with rasterio.open(path, "w", **profile) as out:
        out.write(values, 1)
    return path
