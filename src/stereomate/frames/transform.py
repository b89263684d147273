"""Points between map frames and tangent frames, datum differences included."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import CrsError
from stereomate.frames.crs import Geodetic, convert_geodetic
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame

Array = NDArray[np.float64]


def tangent_from_map(tangent: TangentFrame, frame: MapFrame, xyz: ArrayLike) -> Array:
    """Tangent coordinates (..., 3) of map points (..., 3) with heights of the frame's height system.

    Raises
    ------
    CrsError, HeightSystemError, MissingGridError
        If a point is outside the projection, the geoid grid or the datum transformation.
    """
    points = np.asarray(xyz, dtype=np.float64)
    rows = frame.geodetic_rows(np.array(points.reshape(-1, 3).T, order="C"))
    rows = _other_datum(frame.geodetic, _datum_of(tangent, frame), rows, frame)
    return tangent.tangent_from_geodetic(rows.T).reshape(points.shape)


def map_from_tangent(tangent: TangentFrame, frame: MapFrame, xyz: ArrayLike) -> Array:
    """Map points (..., 3) of tangent points (..., 3): the inverse of `tangent_from_map`."""
    points = np.asarray(xyz, dtype=np.float64)
    rows = tangent.geodetic_rows(np.array(points.reshape(-1, 3).T, order="C"))
    rows = _other_datum(_datum_of(tangent, frame), frame.geodetic, rows, frame)
    return np.ascontiguousarray(frame.map_rows(rows).T).reshape(points.shape)


def map_from_map(target: MapFrame, source: MapFrame, xyz: ArrayLike) -> Array:
    """Points (..., 3) of one map frame in another: projection, datum and height system."""
    points = np.asarray(xyz, dtype=np.float64)
    rows = source.geodetic_rows(np.array(points.reshape(-1, 3).T, order="C"))
    rows = _other_datum(source.geodetic, target.geodetic, rows, source)
    return np.ascontiguousarray(target.map_rows(rows).T).reshape(points.shape)


def _datum_of(tangent: TangentFrame, frame: MapFrame) -> Geodetic:
    """Datum of the tangent frame, which may leave it to the map frame."""
    datum = tangent.geodetic
    if datum is not None:
        return datum
    geodetic = frame.geodetic
    same = (
        abs(geodetic.semi_major_m - tangent.semi_major_m) < 1e-3
        and abs(geodetic.flattening - tangent.flattening) < 1e-12
    )
    if not same:
        raise CrsError(
            "lies on another ellipsoid than the tangent frame, which does not say its datum",
            field="crs",
            value=frame.crs,
        )
    return geodetic


def _other_datum(source: Geodetic, target: Geodetic, rows: Array, frame: MapFrame) -> Array:
    if source is target:
        return rows
    lon, lat, h = convert_geodetic(source, target, rows[0], rows[1], rows[2])
    if frame.heights.kind == "undeclared":
        h = rows[2]  # one unknown system, taken as it is: a change of datum moves only the plan
    return np.stack([lon, lat, h])
