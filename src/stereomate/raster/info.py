"""Facts of a raster that are known without reading a pixel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
from rasterio.enums import MaskFlags

from stereomate.errors import ImageError

Affine6 = tuple[float, float, float, float, float, float]

# Reading part of such a file decodes it from its start.
_SEQUENTIAL_DRIVERS: Final = frozenset({"JPEG", "PNG", "GIF", "BIGGIF", "WEBP", "XPM"})
_LARGEST_STRIP_BYTES: Final = 2 * 1024**2


@dataclass(frozen=True)
class RasterInfo:
    """Facts of a raster, read without a pixel.

    Attributes
    ----------
    path : Path
        The file.
    driver : str
        GDAL's name of the format.
    size : (int, int)
        Columns and rows.
    bands : int
        Bands, an alpha band included.
    dtype : numpy dtype
        Of the pixels, the widest where bands differ.
    nodata : float or None
        Value that means no data (NaN possible).
    has_mask : bool
        Whether a mask or an alpha band says which pixels are valid.
    roles : tuple of str
        Colour interpretation of each band: "red", "green", "gray", "alpha", "undefined", ...
    descriptions : tuple of str
        Band descriptions, "" where there is none.
    is_windowed : bool
        Whether a window can be read without decoding the rest (tiles, or small strips).
    crs_wkt : str
        WKT2 of the horizontal (or compound) CRS, "" where the file states none.
    transform : tuple of 6 floats or None
        (a, b, c, d, e, f): x = a col + b row + c, y = d col + e row + f; None where the file states none.
    tags : mapping of str to str
        Metadata of the file.
    """

    path: Path
    driver: str
    size: tuple[int, int]
    bands: int
    dtype: np.dtype[Any]
    nodata: float | None
    has_mask: bool
    roles: tuple[str, ...]
    descriptions: tuple[str, ...]
    is_windowed: bool
    crs_wkt: str
    transform: Affine6 | None
    tags: Mapping[str, str]

    @property
    def alpha_band(self) -> int | None:
        """Index (from 0) of the alpha band, if there is one."""
        return self.roles.index("alpha") if "alpha" in self.roles else None

    @property
    def colour_bands(self) -> tuple[int, ...]:
        """Indices (from 0) of the bands that are not alpha."""
        return tuple(i for i, role in enumerate(self.roles) if role != "alpha")


def dtype_of(path: Path, handle: Any) -> np.dtype[Any]:
    """The widest type of a handle's bands; ImageError when it is not a plain number."""
    dtype = np.result_type(*(np.dtype(name) for name in handle.dtypes))
    if dtype.kind not in "uif":
        raise ImageError("must have integer or floating-point pixels", file=path, value=str(dtype))
    return dtype


def info_of(path: Path, handle: Any) -> RasterInfo:
    """The facts of an open rasterio dataset."""
    flags = [flag for band in handle.mask_flag_enums for flag in band]
    has_mask = MaskFlags.per_dataset in flags or MaskFlags.alpha in flags
    crs = handle.crs
    transform = tuple(float(value) for value in tuple(handle.transform)[:6])
    return RasterInfo(
        path=path,
        driver=handle.driver,
        size=(handle.width, handle.height),
        bands=handle.count,
        dtype=dtype_of(path, handle),
        nodata=None if handle.nodata is None else float(handle.nodata),
        has_mask=has_mask,
        roles=tuple(interpretation.name for interpretation in handle.colorinterp),
        descriptions=tuple(text or "" for text in handle.descriptions),
        is_windowed=_is_windowed(handle),
        crs_wkt=crs.to_wkt(version="WKT2_2019") if crs else "",
        transform=None if handle.transform.is_identity else cast(Affine6, transform),
        tags=dict(handle.tags()),
    )


def _is_windowed(handle: Any) -> bool:
    if handle.driver in _SEQUENTIAL_DRIVERS:
        return False
    rows, cols = handle.block_shapes[0]
    if cols < handle.width:
        return True
    strip_bytes = rows * cols * np.dtype(handle.dtypes[0]).itemsize * handle.count
    return bool(strip_bytes <= _LARGEST_STRIP_BYTES)
