"""Georeference, colours and metadata as TIFF tags: taken from a tiny file that GDAL writes.

So a CRS given as EPSG code, WKT or PROJ text, rotated geotransforms, colour interpretation and statistics are
written exactly as GDAL reads them.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import rasterio
from rasterio.enums import ColorInterp
from rasterio.errors import CRSError, NotGeoreferencedWarning
from rasterio.io import MemoryFile

from stereomate.errors import CrsError
from stereomate.raster import settings
from stereomate.raster.cog.profile import CogProfile
from stereomate.raster.cog.statistics import BandStatistics
from stereomate.raster.cog.tags import Tag
from stereomate.raster.info import Affine6

# Tags that say how the pixels of the tiny file are stored; all others are taken over.
_STORAGE_TAGS: Final = frozenset(
    {254, 256, 257, 258, 259, 273, 277, 278, 279, 284, 317, 322, 323, 324, 325, 339}
)
PHOTOMETRIC, EXTRA_SAMPLES, GDAL_METADATA, GDAL_NODATA = 262, 338, 42112, 42113
_TEMPLATE_PX: Final = 16


@dataclass(frozen=True)
class Georeference:
    """Where a raster lies, and what else is to be known about it.

    Parameters
    ----------
    crs : str
        Anything GDAL takes: "EPSG:32633", WKT, a PROJ string; "" for none.
    transform : tuple of 6 floats or None
        (a, b, c, d, e, f): x = a col + b row + c, y = d col + e row + f; may be rotated.
    metadata : mapping of str to str
        Items of the dataset.
    """

    crs: str
    transform: Affine6 | None
    metadata: Mapping[str, str] = field(default_factory=dict)


def template_tags(
    profile: CogProfile, georeference: Georeference, statistics: Sequence[BandStatistics]
) -> dict[int, Tag]:
    """Tags of the main image that do not depend on its size, by number.

    Raises
    ------
    CrsError
        If GDAL does not know the CRS, or a GeoTIFF cannot hold it.
    """
    settings.current()
    data = _template(profile, georeference, statistics)
    # Loaded while rasters are assembled, not while a run waits to begin.
    import tifffile

    with tifffile.TiffFile(io.BytesIO(data)) as file:
        found = {tag.code: tag for tag in file.pages[0].tags if tag.code not in _STORAGE_TAGS}
        return {code: Tag.of_values(code, tag.dtype, tag.value) for code, tag in found.items()}


def _template(profile: CogProfile, georeference: Georeference, statistics: Sequence[BandStatistics]) -> bytes:
    options: dict[str, Any] = {"photometric": "RGB" if "red" in profile.band_roles else "MINISBLACK"}
    if "alpha" in profile.band_roles:
        options["alpha"] = "YES"
    if georeference.transform is not None:
        options["transform"] = rasterio.Affine(*georeference.transform)
    if profile.nodata is not None:
        options["nodata"] = profile.nodata
    crs = _crs_of(georeference.crs)
    with warnings.catch_warnings(), MemoryFile() as memory:
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with memory.open(
            driver="GTiff",
            width=_TEMPLATE_PX,
            height=_TEMPLATE_PX,
            count=profile.bands,
            dtype=profile.dtype,
            crs=crs,
            **options,
        ) as dataset:
            dataset.colorinterp = [ColorInterp[role] for role in profile.band_roles]
            for band, text in enumerate(profile.descriptions, start=1):
                dataset.set_band_description(band, text)
            dataset.update_tags(**dict(sorted(georeference.metadata.items())))
            for band, of_band in enumerate(statistics, start=1):
                dataset.update_tags(band, **_statistics_items(of_band))
        with memory.open() as dataset:
            if crs is not None and (dataset.crs is None or dataset.crs.to_wkt() == ""):
                raise CrsError("cannot be held by a GeoTIFF", field="crs", value=georeference.crs)
        return bytes(memory.read())


def _crs_of(text: str) -> Any:
    if not text:
        return None
    try:
        return rasterio.CRS.from_user_input(text)
    except CRSError as error:
        raise CrsError("must be a coordinate reference system", field="crs", value=text) from error


def _statistics_items(statistics: BandStatistics) -> dict[str, str]:
    if not statistics.count:
        return {}
    return {
        "STATISTICS_MAXIMUM": repr(statistics.maximum),
        "STATISTICS_MEAN": repr(statistics.mean),
        "STATISTICS_MINIMUM": repr(statistics.minimum),
        "STATISTICS_STDDEV": repr(statistics.standard_deviation),
    }
