"""Geoid grids: undulation rasters in geographic coordinates (GeoTIFF, GTX and whatever else GDAL reads)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.errors import RasterioError

from stereomate.errors import HeightSystemError, MissingGridError
from stereomate.raster import settings

# Values beyond this are no undulation on Earth (the geoid stays within ±110 m): no-data or another quantity.
_LARGEST_UNDULATION_M = 200.0
# GTX writes this for no-data.
_GTX_NODATA = -88.8888


@dataclass(frozen=True, eq=False)
class GeoidGrid:
    """Geoid undulations on nodes from the north-west corner east and south.

    Attributes
    ----------
    path : str
    values : float64 array (rows, cols)
        Undulation in metres: ellipsoidal height minus height above the geoid. NaN where there is none. A grid
        around the whole Earth has its first column repeated at the end.
    west_deg, north_deg : float
        The first node.
    step_lon_deg, step_lat_deg : float
        Both positive.
    description : str
        What the file says about itself.
    """

    path: str
    values: NDArray[np.float64]
    west_deg: float
    north_deg: float
    step_lon_deg: float
    step_lat_deg: float
    description: str

    @property
    def bounds_deg(self) -> tuple[float, float, float, float]:
        """West, south, east, north of the outer nodes."""
        rows, cols = self.values.shape
        return (
            self.west_deg,
            self.north_deg - (rows - 1) * self.step_lat_deg,
            self.west_deg + (cols - 1) * self.step_lon_deg,
            self.north_deg,
        )


def read_geoid_grid(path: str | Path) -> GeoidGrid:
    """Read a geoid grid file whole.

    Raises
    ------
    MissingGridError
        If the file is not there.
    HeightSystemError
        If it is not one north-up grid of undulations in geographic coordinates.
    """
    if not Path(path).is_file():
        raise MissingGridError("the geoid grid is not on this machine", file=path, field="heights")
    settings.current()
    try:
        with rasterio.open(path) as grid:
            values = grid.read(1).astype(np.float64) * grid.scales[0] + grid.offsets[0]
            mask = grid.read_masks(1) == 0
            t, crs, kind = grid.transform, grid.crs, grid.tags().get("TYPE", "")
            text = grid.tags().get("TIFFTAG_IMAGEDESCRIPTION", "") or Path(path).name
            parts = len(grid.subdatasets)
            gtx = grid.driver == "GTX"
    except (RasterioError, OSError) as error:
        raise HeightSystemError(
            f"is not a readable geoid grid: {error}", file=path, field="heights"
        ) from error
    if gtx:
        mask |= np.abs(values - _GTX_NODATA) < 1e-3
    values[mask] = np.nan
    if parts > 1:
        raise HeightSystemError("must be one grid, not several in one file", file=path, value=parts)
    if crs is not None and not crs.is_geographic:
        raise HeightSystemError("a geoid grid is in longitude and latitude", file=path, value=crs.to_string())
    if kind and not kind.startswith("VERTICAL_OFFSET_GEOGRAPHIC_TO"):
        raise HeightSystemError("must hold vertical offsets", file=path, field="TYPE", value=kind)
    if t.b != 0.0 or t.d != 0.0 or t.a <= 0.0 or t.e >= 0.0 or min(values.shape) < 2:
        raise HeightSystemError("a geoid grid is north-up with at least 2 x 2 nodes", file=path)
    if not np.nanmax(np.abs(values), initial=0.0) < _LARGEST_UNDULATION_M:
        raise HeightSystemError(
            f"undulations in metres stay below {_LARGEST_UNDULATION_M:.0f}",
            file=path,
            value=float(np.nanmax(np.abs(values))),
        )
    if abs(values.shape[1] * t.a - 360.0) < 0.5 * t.a:
        values = np.concatenate([values, values[:, :1]], axis=1)
    values.flags.writeable = False
    # GDAL gives the outer corner of the first pixel; the node is its centre.
    return GeoidGrid(str(path), values, t.c + 0.5 * t.a, t.f + 0.5 * t.e, t.a, -t.e, text)
