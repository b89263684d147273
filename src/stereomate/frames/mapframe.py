"""A map CRS together with its heights: from map coordinates to geodetic ones and back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import CrsError
from stereomate.frames import crs as crs_module
from stereomate.frames import factors
from stereomate.frames.crs import Geodetic
from stereomate.frames.heights import HeightSystem

Array = NDArray[np.float64]


@dataclass(frozen=True)
class MapFrame:
    """A projected or geographic CRS with its heights, checked once when built.

    Map coordinates are in PROJ's ``always_xy`` order: easting before northing, longitude before latitude, but
    west and south axes as they are. A vertical part of a compound CRS is not applied; `vertical_name` tells
    it.

    Attributes
    ----------
    crs : str
        As the user wrote it: anything PROJ reads.
    heights : HeightSystem

    Raises
    ------
    CrsError
        If the CRS is unknown, or neither projected nor geographic.
    """

    crs: str
    heights: HeightSystem

    def __post_init__(self) -> None:
        horizontal = crs_module.horizontal_part(crs_module.parse(self.crs))
        if not (horizontal.is_projected or horizontal.is_geographic):
            raise CrsError("must be a projected or geographic CRS", field="crs", value=self.crs)
        crs_module.geodetic_of(self.crs)

    @property
    def geodetic(self) -> Geodetic:
        """The geodetic datum under the map."""
        return crs_module.geodetic_of(self.crs)

    @property
    def is_geographic(self) -> bool:
        """Whether the map coordinates are longitude and latitude."""
        return bool(crs_module.horizontal_part(crs_module.parse(self.crs)).is_geographic)

    @property
    def name(self) -> str:
        """Name of the CRS; where it has none, what the user wrote."""
        name = str(crs_module.parse(self.crs).name)
        return self.crs if name == "unknown" else name

    @property
    def unit_m(self) -> float:
        """Metres per unit of the map axes.

        Raises
        ------
        CrsError
            If the axes are angles.
        """
        if self.is_geographic:
            raise CrsError("has degrees, not lengths, as its unit", field="crs", value=self.crs)
        return float(
            crs_module.horizontal_part(crs_module.parse(self.crs)).axis_info[0].unit_conversion_factor
        )

    @property
    def vertical_name(self) -> str | None:
        """Name of a vertical CRS inside a compound CRS. It is noted, not applied."""
        vertical = crs_module.vertical_part(crs_module.parse(self.crs))
        return None if vertical is None else str(vertical.name)

    def geodetic_from_map(self, xyz: ArrayLike) -> Array:
        """Longitude, latitude (degrees) and ellipsoidal height of map points, shape (..., 3).

        Parameters
        ----------
        xyz : array_like (..., 3)
            Map coordinates in the units of the CRS and heights of the height system. NaN gives NaN.

        Raises
        ------
        CrsError
            If a point is outside the domain of the projection.
        HeightSystemError, MissingGridError
            As `HeightSystem.ellipsoidal_from_system`.
        """
        points = np.asarray(xyz, dtype=np.float64)
        rows = np.array(points.reshape(-1, 3).T, order="C")
        return self.geodetic_rows(rows).T.reshape(points.shape)

    def map_from_geodetic(self, lon_lat_h: ArrayLike) -> Array:
        """Map points of longitude, latitude (degrees) and ellipsoidal height: the inverse of
        `geodetic_from_map`."""
        points = np.asarray(lon_lat_h, dtype=np.float64)
        rows = np.array(points.reshape(-1, 3).T, order="C")
        return self.map_rows(rows).T.reshape(points.shape)

    def geodetic_rows(self, rows: Array) -> Array:
        """As `geodetic_from_map` for an array (3, n), which is overwritten."""
        asked = np.isfinite(rows[0] + rows[1])
        if not self.is_geographic:
            projection = crs_module.projection(self.crs)
            projection.transform(rows[0], rows[1], direction="INVERSE", inplace=True)
        rows[0], rows[1] = self.geodetic.normal(rows[0], rows[1])
        self._require_finite(rows, asked, "map coordinates")
        rows[2] = self.heights.ellipsoidal_from_system(rows[0], rows[1], rows[2], self.geodetic)
        return rows

    def map_rows(self, rows: Array) -> Array:
        """As `map_from_geodetic` for an array (3, n), which is overwritten."""
        rows[2] = self.heights.system_from_ellipsoidal(rows[0], rows[1], rows[2], self.geodetic)
        asked = np.isfinite(rows[0] + rows[1])
        rows[0], rows[1] = self.geodetic.native(rows[0], rows[1])
        if not self.is_geographic:
            crs_module.projection(self.crs).transform(rows[0], rows[1], inplace=True)
        self._require_finite(rows, asked, "longitudes and latitudes")
        return rows

    def require_conformal(self) -> None:
        """Check that orientation angles make sense in this grid.

        Raises
        ------
        CrsError
            If the CRS is geographic or its projection is not conformal, with the reason.
        """
        factors.require_conformal(self.crs)

    def _require_finite(self, rows: Array, asked: NDArray[np.bool_], what: str) -> None:
        bad = asked & ~np.isfinite(rows[0] + rows[1])
        if bad.any():
            raise CrsError(
                f"{int(bad.sum())} of {bad.size} {what} are outside the domain of the projection "
                f"(first: number {int(np.argmax(bad)) + 1})",
                field="crs",
                value=self.crs,
            )
