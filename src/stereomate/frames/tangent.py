"""Topocentric (tangent) frames: east, north and up at an origin on or above the ellipsoid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import CrsError
from stereomate.frames import kernels
from stereomate.frames.crs import Geodetic, geodetic_of
from stereomate.frames.mapframe import MapFrame

Array = NDArray[np.float64]


def geocentric_from_geodetic(lon_lat_h: ArrayLike, semi_major_m: float, flattening: float) -> Array:
    """Geocentric coordinates (..., 3) in metres of longitude, latitude in degrees and ellipsoidal height."""
    return _apply(kernels.geocentric_from_geodetic, lon_lat_h, semi_major_m, _e2(flattening))


def geodetic_from_geocentric(xyz: ArrayLike, semi_major_m: float, flattening: float) -> Array:
    """Longitude, latitude in degrees and ellipsoidal height of geocentric points (..., 3): the inverse."""
    return _apply(kernels.geodetic_from_geocentric, xyz, semi_major_m, _e2(flattening))


def rotation_geocentric_from_enu(lon_deg: ArrayLike, lat_deg: ArrayLike) -> Array:
    """Columns east, north and up in geocentric axes, shape (..., 3, 3)."""
    lon = np.deg2rad(np.asarray(lon_deg, dtype=np.float64))
    lat = np.deg2rad(np.asarray(lat_deg, dtype=np.float64))
    lon, lat = np.broadcast_arrays(lon, lat)
    sl, cl, sp, cp = np.sin(lon), np.cos(lon), np.sin(lat), np.cos(lat)
    zero = np.zeros(lon.shape)
    east = np.stack([-sl, cl, zero], axis=-1)
    north = np.stack([-sp * cl, -sp * sl, cp], axis=-1)
    up = np.stack([cp * cl, cp * sl, sp], axis=-1)
    return np.stack([east, north, up], axis=-1)


@dataclass(frozen=True)
class TangentFrame:
    """A topocentric frame. All ray geometry of a block happens in one.

    Attributes
    ----------
    longitude_deg, latitude_deg, height_m : float
        The origin, ellipsoidal.
    semi_major_m, flattening : float
        The ellipsoid.
    geodetic_crs : str
        The geographic CRS that says on which datum the frame lies. Empty: on the datum of whatever map frame
        it is used with, whose ellipsoid must then be the same.
    """

    longitude_deg: float
    latitude_deg: float
    height_m: float
    semi_major_m: float
    flattening: float
    geodetic_crs: str = ""

    def __post_init__(self) -> None:
        if not (-90.0 <= self.latitude_deg <= 90.0 and np.isfinite(self.longitude_deg + self.height_m)):
            raise CrsError(
                "the origin of a tangent frame needs a latitude within ±90 degrees and finite numbers",
                field="tangent",
                value=(self.longitude_deg, self.latitude_deg, self.height_m),
            )

    @classmethod
    def at_geodetic(cls, geodetic: Geodetic, lon_deg: float, lat_deg: float, height_m: float) -> TangentFrame:
        """Frame with its origin at a geodetic point on a datum."""
        return cls(lon_deg, lat_deg, height_m, geodetic.semi_major_m, geodetic.flattening, geodetic.crs)

    @classmethod
    def at_map(cls, frame: MapFrame, xyz: ArrayLike) -> TangentFrame:
        """Frame with its origin at a map point (3,), on the datum of the map."""
        lon, lat, h = frame.geodetic_from_map(np.asarray(xyz, dtype=np.float64))
        return cls.at_geodetic(frame.geodetic, float(lon), float(lat), float(h))

    @property
    def geodetic(self) -> Geodetic | None:
        """The datum, or None where the frame does not say."""
        return geodetic_of(self.geodetic_crs) if self.geodetic_crs else None

    @property
    def origin_geocentric(self) -> Array:
        """Origin in geocentric coordinates, (3,)."""
        origin = (self.longitude_deg, self.latitude_deg, self.height_m)
        return geocentric_from_geodetic(origin, self.semi_major_m, self.flattening)

    @property
    def rotation_geocentric_from_tangent(self) -> Array:
        """(3, 3), columns east, north, up of the origin."""
        return rotation_geocentric_from_enu(self.longitude_deg, self.latitude_deg)

    def tangent_from_geodetic(self, lon_lat_h: ArrayLike) -> Array:
        """Tangent coordinates (..., 3) of longitude, latitude in degrees and ellipsoidal height."""
        return _apply(kernels.tangent_from_geodetic, lon_lat_h, *self._kernel_parameters())

    def geodetic_from_tangent(self, xyz: ArrayLike) -> Array:
        """Longitude, latitude in degrees and ellipsoidal height of tangent points (..., 3)."""
        return _apply(kernels.geodetic_from_tangent, xyz, *self._kernel_parameters())

    def geodetic_rows(self, rows: Array) -> Array:
        """As `geodetic_from_tangent` for an array (3, n)."""
        out = np.empty(rows.shape)
        kernels.geodetic_from_tangent(rows, *self._kernel_parameters(), out)
        return out

    def tangent_from_geocentric(self, xyz: ArrayLike) -> Array:
        """Tangent coordinates (..., 3) of geocentric points."""
        return (
            np.asarray(xyz, dtype=np.float64) - self.origin_geocentric
        ) @ self.rotation_geocentric_from_tangent

    def geocentric_from_tangent(self, xyz: ArrayLike) -> Array:
        """Geocentric coordinates (..., 3) of tangent points."""
        points = np.asarray(xyz, dtype=np.float64)
        return points @ self.rotation_geocentric_from_tangent.T + self.origin_geocentric

    def rotation_tangent_from_enu(self, lon_deg: ArrayLike, lat_deg: ArrayLike) -> Array:
        """East, north, up at given points as columns in tangent axes, shape (..., 3, 3).

        The plumb lines diverge: this is not the identity away from the origin (0.009 degrees per kilometre).
        """
        return self.rotation_geocentric_from_tangent.T @ rotation_geocentric_from_enu(lon_deg, lat_deg)

    def _kernel_parameters(self) -> tuple[float, float, Array, Array]:
        axes = np.ascontiguousarray(self.rotation_geocentric_from_tangent.T)
        return self.semi_major_m, _e2(self.flattening), self.origin_geocentric, axes


def _e2(flattening: float) -> float:
    return flattening * (2.0 - flattening)


def _apply(function: Callable[..., None], points: ArrayLike, *parameters: object) -> Array:
    points = np.asarray(points, dtype=np.float64)
    rows = np.array(points.reshape(-1, 3).T, order="C")
    out = np.empty(rows.shape)
    function(rows, *parameters, out)
    return np.ascontiguousarray(out.T).reshape(points.shape)
