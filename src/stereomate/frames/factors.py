"""Point scale and grid convergence of any conformal map CRS, and which way its axes look."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import CrsError
from stereomate.frames.crs import geodetic_of, horizontal_part, parse, projection
from stereomate.frames.perthread import per_thread

Array = NDArray[np.float64]

# Step of the five-point stencil along the meridian. 5 km balances truncation (step/R)^4 against rounding 1e-9
# m / step: it agrees with closed forms to 3e-13 in scale and 2e-13 rad in convergence (2e-12 beyond 79
# degrees of latitude).
_STENCIL_STEP_M = 5000.0
# Largest relative departure of the Jacobian from a similarity that counts as conformal.
_CONFORMAL = 1e-7


@dataclass(frozen=True)
class GridAxes:
    """How the axes of a map CRS (``always_xy`` order) lie towards its grid east and grid north.

    Attributes
    ----------
    east_north_from_map : ((float, float), (float, float))
        Signed permutation: ``(east, north) = P @ (x, y)``.
    unit_m : float
        Metres per map unit.
    """

    east_north_from_map: tuple[tuple[float, float], tuple[float, float]]
    unit_m: float

    @property
    def left_handed(self) -> bool:
        """True where x, y, up is a left-handed frame: its right-handed twin exchanges x and y."""
        (a, b), (c, d) = self.east_north_from_map
        return a * d - b * c < 0.0

    @property
    def working_from_map(self) -> Array:
        """(2, 2): the right-handed working frame of the map: x and y themselves, exchanged if left-handed."""
        identity = np.eye(2)
        return identity[::-1].copy() if self.left_handed else identity

    @property
    def working_from_east_north(self) -> Array:
        """(2, 2) rotation by a multiple of 90° from grid east-north axes to the working frame."""
        turn: Array = self.working_from_map @ np.array(self.east_north_from_map).T
        return turn


_DIRECTIONS = {"east": (1.0, 0.0), "west": (-1.0, 0.0), "north": (0.0, 1.0), "south": (0.0, -1.0)}


def grid_axes(crs: str) -> GridAxes:
    """Axes of a projected CRS as they come from PROJ with ``always_xy``.

    PROJ exchanges a (north, east) pair but leaves west and south axes as they are. Polar projections, both of
    whose axes point south (or north), count x as east and y as north.

    Raises
    ------
    CrsError
        If the CRS is not projected, or its axes differ in unit.
    """
    axes: GridAxes = per_thread(("axes", crs), lambda: _grid_axes(crs))
    return axes


def _grid_axes(text: str) -> GridAxes:
    crs = horizontal_part(parse(text))
    if not crs.is_projected:
        raise CrsError(
            "is not projected: its axes are angles, so orientation angles and map scale have no meaning",
            field="crs",
            value=text,
        )
    units = [axis.unit_conversion_factor for axis in crs.axis_info[:2]]
    if units[0] != units[1]:
        raise CrsError("has axes in two units", field="crs", value=text)
    directions = [axis.direction.lower() for axis in crs.axis_info[:2]]
    if directions == ["north", "east"]:
        directions = ["east", "north"]
    if all(direction in _DIRECTIONS for direction in directions):
        x, y = (_DIRECTIONS[direction] for direction in directions)
    else:
        x, y = _DIRECTIONS["east"], _DIRECTIONS["north"]
    if abs(x[0] * y[1] - x[1] * y[0]) != 1.0:
        x, y = _DIRECTIONS["east"], _DIRECTIONS["north"]
    return GridAxes(((x[0], y[0]), (x[1], y[1])), float(units[0]))


def grid_factors(crs: str, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
    """Point scale and grid convergence of a conformal map CRS.

    Parameters
    ----------
    crs : str
        Projected CRS: anything PROJ reads.
    x, y : array_like
        Map coordinates in pyproj's ``always_xy`` order and in the units of the CRS; broadcast together.

    Returns
    -------
    tau : ndarray
        Length in the grid over length on the ellipsoid.
    gamma : ndarray
        Convergence in radians, Gauss-Bomford sign: positive where grid north lies east of true north. A grid
        bearing is the azimuth minus gamma.

    Raises
    ------
    CrsError
        If the CRS is geographic, not conformal, or a point is outside its domain.

    Notes
    -----
    Derivative along the meridian by a five-point stencil: ``gamma = -atan2(dE/dphi, dN/dphi)``,
    ``tau = |d(E, N)/dphi| / M``, with E and N the grid east and north whatever the axes of the CRS. Good to
    1e-10 (3e-13 is usual).
    """
    axes = require_conformal(crs)
    x, y = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
    lon, lat = _geodetic(crs, x, y)
    return _factors_at(crs, axes, lon, lat)


def grid_factors_geodetic(crs: str, lon: ArrayLike, lat: ArrayLike) -> tuple[Array, Array]:
    """As `grid_factors`, at longitude and latitude in degrees on the datum of the CRS."""
    axes = require_conformal(crs)
    lon, lat = np.broadcast_arrays(np.asarray(lon, dtype=np.float64), np.asarray(lat, dtype=np.float64))
    return _factors_at(crs, axes, lon, lat)


def effective_scale(tau: ArrayLike, h: ArrayLike, radius: ArrayLike) -> Array:
    """Horizontal over vertical scale of the grid at ellipsoidal height `h`: ``tau / (1 + h/R)``."""
    return np.asarray(np.asarray(tau) / (1.0 + np.asarray(h) / np.asarray(radius)), dtype=np.float64)


def gauss_radius(semi_major: float, flattening: float, lat_deg: ArrayLike) -> Array:
    """Gaussian mean radius ``sqrt(M N)`` in metres at a latitude in degrees."""
    e2 = flattening * (2.0 - flattening)
    w2 = 1.0 - e2 * np.sin(np.deg2rad(np.asarray(lat_deg, dtype=np.float64))) ** 2
    return np.asarray(semi_major * np.sqrt(1.0 - e2) / w2, dtype=np.float64)


def meridian_radius(semi_major: float, flattening: float, lat_deg: ArrayLike) -> Array:
    """Meridian radius of curvature M in metres at a latitude in degrees."""
    e2 = flattening * (2.0 - flattening)
    w2 = 1.0 - e2 * np.sin(np.deg2rad(np.asarray(lat_deg, dtype=np.float64))) ** 2
    return np.asarray(semi_major * (1.0 - e2) / w2**1.5, dtype=np.float64)


def _geodetic(crs: str, x: Array, y: Array) -> tuple[Array, Array]:
    lon, lat = projection(crs).transform(x, y, direction="INVERSE")
    # PROJ answers for points far beyond the map too; they do not come back.
    x1, y1 = projection(crs).transform(lon, lat)
    miss = np.hypot(np.asarray(x1) - x, np.asarray(y1) - y)
    lon, lat = geodetic_of(crs).normal(np.asarray(lon, dtype=np.float64), np.asarray(lat, dtype=np.float64))
    bad = np.isfinite(x + y) & ~(np.isfinite(lon + lat) & (miss < 1.0))
    if bad.any():
        raise CrsError("a point is outside the domain of the projection", field="crs", value=crs)
    return lon, lat


def _east_north(crs: str, axes: GridAxes, lon: Array, lat: Array) -> tuple[Array, Array]:
    """Grid east and north in metres; latitudes beyond a pole go on down the opposite meridian."""
    over = np.abs(lat) > 90.0
    lon = np.where(over, lon + 180.0, lon)
    lat = np.where(over, np.copysign(180.0, lat) - lat, lat)
    x, y = projection(crs).transform(*geodetic_of(crs).native(lon, lat))
    (a, b), (c, d) = axes.east_north_from_map
    x, y = np.asarray(x) * axes.unit_m, np.asarray(y) * axes.unit_m
    return a * x + b * y, c * x + d * y


def _meridian_derivative(crs: str, axes: GridAxes, lon: Array, lat: Array) -> tuple[Array, Array]:
    """d(E, N) per metre of ellipsoidal length northwards."""
    datum = geodetic_of(crs)
    radius = meridian_radius(datum.semi_major_m, datum.flattening, lat)
    step = np.rad2deg(_STENCIL_STEP_M / radius)
    east, north = np.zeros(np.shape(lat)), np.zeros(np.shape(lat))
    # f' = (f(-2) - 8 f(-1) + 8 f(1) - f(2)) / 12 step, as differences of symmetric pairs
    for offset, weight in ((1.0, 8.0), (2.0, -1.0)):
        e1, n1 = _east_north(crs, axes, lon, lat + offset * step)
        e0, n0 = _east_north(crs, axes, lon, lat - offset * step)
        east += weight * (e1 - e0)
        north += weight * (n1 - n0)
    return east / (12.0 * _STENCIL_STEP_M), north / (12.0 * _STENCIL_STEP_M)


def _factors_at(crs: str, axes: GridAxes, lon: Array, lat: Array) -> tuple[Array, Array]:
    east, north = _meridian_derivative(crs, axes, lon, lat)
    bad = np.isfinite(lon + lat) & ~np.isfinite(east + north)
    if bad.any():
        raise CrsError("a point is outside the domain of the projection", field="crs", value=crs)
    return np.hypot(east, north), -np.arctan2(east, north)


def require_conformal(crs: str) -> GridAxes:
    """Check that a CRS is projected and conformal; its axes.

    The Jacobian from the ellipsoid to the grid is taken at points around the middle of the area of use (or
    around the origin of the projection) and must be a similarity to 1e-7.

    Raises
    ------
    CrsError
        With the reason and the size of the distortion.
    """
    axes: GridAxes = per_thread(("conformal", crs), lambda: _require_conformal(crs))
    return axes


def _require_conformal(crs: str) -> GridAxes:
    axes = grid_axes(crs)
    lon, lat = _sample_points(crs)
    datum = geodetic_of(crs)
    e_north, n_north = _meridian_derivative(crs, axes, lon, lat)
    # Along the parallel: step in longitude of the same length; second order suffices for 1e-7 with 1 km.
    e2 = datum.flattening * (2.0 - datum.flattening)
    prime_vertical = datum.semi_major_m / np.sqrt(1.0 - e2 * np.sin(np.deg2rad(lat)) ** 2)
    length = 1000.0
    step = np.rad2deg(length / (prime_vertical * np.cos(np.deg2rad(lat))))
    e1, n1 = _east_north(crs, axes, lon + step, lat)
    e0, n0 = _east_north(crs, axes, lon - step, lat)
    e_east, n_east = (e1 - e0) / (2.0 * length), (n1 - n0) / (2.0 * length)
    if not np.all(np.isfinite(e_east + n_east + e_north + n_north)):
        raise CrsError(
            "its projection cannot be evaluated around its own area of use", field="crs", value=crs
        )
    if np.any(e_east * n_north - e_north * n_east <= 0.0):
        raise CrsError("its axes do not point where its definition says", field="crs", value=crs)
    # A similarity has e_east = n_north and n_east = -e_north.
    departure = np.hypot(e_east - n_north, n_east + e_north) / np.hypot(e_north, n_north)
    worst = float(departure.max())
    if worst > _CONFORMAL:
        at = int(departure.argmax())
        raise CrsError(
            f"is not conformal: at longitude {lon[at]:.2f} latitude {lat[at]:.2f} its scale differs by "
            f"{worst * 1e6:.3g} ppm between directions, so orientation angles have no meaning in it",
            field="crs",
            value=crs,
        )
    return axes


def _sample_points(crs: str) -> tuple[Array, Array]:
    """Points that tell a conformal projection from others: none of them at its origin."""
    horizontal = horizontal_part(parse(crs))
    area = horizontal.area_of_use
    if area is not None and area.east > area.west:
        west, east = area.west, area.east
        south, north = max(area.south, -85.0), min(area.north, 85.0)
        lon = np.array([0.3, 0.6, 0.45, 0.55, 0.71]) * (east - west) + west
        lat = np.array([0.35, 0.3, 0.52, 0.68, 0.61]) * (north - south) + south
        return lon, lat
    operation = horizontal.coordinate_operation
    values: dict[str, float] = {}
    for parameter in operation.params if operation else []:
        values[parameter.name.lower()] = float(parameter.value) * float(parameter.unit_conversion_factor)
    lon0 = _first(values, "longitude")
    lat0 = _first(values, "latitude")
    offsets = np.array([[1.1, 0.7], [-0.9, 0.8], [0.7, -0.9], [-1.3, -0.6], [2.1, 1.4]])
    lon_deg, lat_deg = np.rad2deg(lon0), np.rad2deg(lat0)
    lat = np.clip(lat_deg + offsets[:, 1], -88.0, 88.0)
    return lon_deg + offsets[:, 0] + geodetic_of(crs).prime_meridian_deg, lat


def _first(values: dict[str, float], word: str) -> float:
    return next((value for name, value in values.items() if word in name), 0.0)
