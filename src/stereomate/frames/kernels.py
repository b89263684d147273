"""Kernels of the frames: geocentric and geodetic coordinates, tangent frames, geoid grids.

Points come as three rows of an array (3, n), so that each coordinate is contiguous for PROJ. Longitudes and
latitudes are in degrees in arrays and in radians between the small functions.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import inline_kernel, kernel

Array = NDArray[np.float64]
Triple = tuple[float, float, float]

_DEGREE = math.pi / 180.0


@inline_kernel
def geocentric_point(longitude: float, latitude: float, h: float, a: float, e2: float) -> Triple:
    """Geocentric x, y, z of geodetic coordinates in radians and metres."""
    sin_lat, cos_lat = math.sin(latitude), math.cos(latitude)
    n = a / math.sqrt(1.0 - e2 * sin_lat * sin_lat)
    p = (n + h) * cos_lat
    return p * math.cos(longitude), p * math.sin(longitude), (n * (1.0 - e2) + h) * sin_lat


@inline_kernel
def geodetic_point(x: float, y: float, z: float, a: float, e2: float) -> Triple:
    """Longitude, latitude in radians and ellipsoidal height of a geocentric point.

    Bowring's parametric latitude as sine and cosine, iterated twice (rounding level from -10 km to
    satellites), and the height by projection on the normal, which is well conditioned at the equator and at
    the poles.
    """
    p = math.sqrt(x * x + y * y)
    r = math.sqrt(p * p + z * z)
    axis_ratio = math.sqrt(1.0 - e2)
    b = a * axis_ratio
    ep2b = e2 / (1.0 - e2) * b
    e2a = e2 * a
    s, c = axis_ratio * z * (1.0 + ep2b / r), p
    sin_lat, cos_lat = s, c
    for _ in range(2):
        norm = 1.0 / math.sqrt(s * s + c * c)
        s *= norm
        c *= norm
        sin_lat = z + ep2b * s * s * s
        cos_lat = p - e2a * c * c * c
        s, c = axis_ratio * sin_lat, cos_lat
    norm = 1.0 / math.sqrt(sin_lat * sin_lat + cos_lat * cos_lat)
    sin_lat *= norm
    cos_lat *= norm
    h = p * cos_lat + z * sin_lat - a * math.sqrt(1.0 - e2 * sin_lat * sin_lat)
    return math.atan2(y, x), math.atan2(sin_lat, cos_lat), h


@kernel
def geocentric_from_geodetic(points: Array, a: float, e2: float, out: Array) -> None:
    """(3, n) degrees and metres to (3, n) geocentric."""
    for i in range(points.shape[1]):
        out[0, i], out[1, i], out[2, i] = geocentric_point(
            points[0, i] * _DEGREE, points[1, i] * _DEGREE, points[2, i], a, e2
        )


@kernel
def geodetic_from_geocentric(points: Array, a: float, e2: float, out: Array) -> None:
    """(3, n) geocentric to (3, n) degrees and metres."""
    for i in range(points.shape[1]):
        lon, lat, h = geodetic_point(points[0, i], points[1, i], points[2, i], a, e2)
        out[0, i], out[1, i], out[2, i] = lon / _DEGREE, lat / _DEGREE, h


@kernel
def tangent_from_geodetic(points: Array, a: float, e2: float, origin: Array, axes: Array, out: Array) -> None:
    """(3, n) degrees and metres to (3, n) tangent; `axes` (3, 3) has east, north, up as rows."""
    for i in range(points.shape[1]):
        x, y, z = geocentric_point(points[0, i] * _DEGREE, points[1, i] * _DEGREE, points[2, i], a, e2)
        x -= origin[0]
        y -= origin[1]
        z -= origin[2]
        for k in range(3):
            out[k, i] = axes[k, 0] * x + axes[k, 1] * y + axes[k, 2] * z


@kernel
def geodetic_from_tangent(points: Array, a: float, e2: float, origin: Array, axes: Array, out: Array) -> None:
    """(3, n) tangent to (3, n) degrees and metres; `axes` (3, 3) has east, north, up as rows."""
    for i in range(points.shape[1]):
        e, n, u = points[0, i], points[1, i], points[2, i]
        x = origin[0] + axes[0, 0] * e + axes[1, 0] * n + axes[2, 0] * u
        y = origin[1] + axes[0, 1] * e + axes[1, 1] * n + axes[2, 1] * u
        z = origin[2] + axes[0, 2] * e + axes[1, 2] * n + axes[2, 2] * u
        lon, lat, h = geodetic_point(x, y, z, a, e2)
        out[0, i], out[1, i], out[2, i] = lon / _DEGREE, lat / _DEGREE, h


@kernel
def grid_values(
    values: Array,
    west_deg: float,
    north_deg: float,
    step_lon_deg: float,
    step_lat_deg: float,
    longitude: Array,
    latitude: Array,
    out: Array,
) -> None:
    """Bilinear value of a geoid grid; NaN outside its nodes or where a used node is NaN.

    `values` (rows, cols) run from the north-west node east and south; longitudes are taken modulo 360.
    """
    rows, cols = values.shape
    # A point on the border, but for rounding, is inside.
    slack = 1e-9
    for i in range(longitude.shape[0]):
        turn = longitude[i] - west_deg
        turn -= 360.0 * math.floor((turn + slack) / 360.0)
        u = turn / step_lon_deg
        v = (north_deg - latitude[i]) / step_lat_deg
        if not (-slack <= u <= cols - 1 + slack and -slack <= v <= rows - 1 + slack):
            out[i] = math.nan
            continue
        col = min(max(int(u), 0), cols - 2)
        row = min(max(int(v), 0), rows - 2)
        fu, fv = u - col, v - row
        top = values[row, col] * (1.0 - fu) + values[row, col + 1] * fu
        bottom = values[row + 1, col] * (1.0 - fu) + values[row + 1, col + 1] * fu
        out[i] = top * (1.0 - fv) + bottom * fv


@inline_kernel
def image_point(
    x: float, y: float, z: float, photo: int, centres: Array, rotations: Array, c: float
) -> tuple[float, float]:
    """Image coordinates of an object point in a photograph; NaN if it is not before the camera."""
    x -= centres[photo, 0]
    y -= centres[photo, 1]
    z -= centres[photo, 2]
    r = rotations[photo]
    depth = r[0, 2] * x + r[1, 2] * y + r[2, 2] * z
    if not depth < 0.0:
        return math.nan, math.nan
    s = -c / depth
    return s * (r[0, 0] * x + r[1, 0] * y + r[2, 0] * z), s * (r[0, 1] * x + r[1, 1] * y + r[2, 1] * z)


@kernel
def collinearity_difference(
    grid_points: Array,
    true_points: Array,
    point_of: NDArray[np.int64],
    photo_of: NDArray[np.int64],
    grid_centres: Array,
    grid_rotations: Array,
    true_centres: Array,
    true_rotations: Array,
    principal_distances: Array,
    out: Array,
) -> None:
    """Image coordinates in the grid minus those in space, (n, 2), for observations of points in
    photographs."""
    for i in range(point_of.size):
        k, p = point_of[i], photo_of[i]
        c = principal_distances[p]
        gx, gy = image_point(
            grid_points[k, 0], grid_points[k, 1], grid_points[k, 2], p, grid_centres, grid_rotations, c
        )
        tx, ty = image_point(
            true_points[k, 0], true_points[k, 1], true_points[k, 2], p, true_centres, true_rotations, c
        )
        out[i, 0], out[i, 1] = gx - tx, gy - ty
