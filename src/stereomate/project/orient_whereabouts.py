"""Where photographs and control points say they are, looked at before anything is computed from it.

A single position that lies elsewhere (no fix, a longitude of the wrong sign) would choose wrong pairs and
carry the tangent frame away: it is not used, and named. Control far from all photographs is in another unit
or CRS.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import CrsError
from stereomate.frames.mapframe import MapFrame
from stereomate.units import FOOT

Array = NDArray[np.float64]

_EARTH_KM: Final = 6371.0
# No photograph is taken from farther than this: a position is another place then. In blocks of a country it
# must also be so many times as far from the middle as the others are.
_FAR_KM: Final = 50.0
_FAR_TIMES: Final = 20.0
_NO_FIX_KM: Final = 1.0


def far_positions(lon_lat: Array, names: Sequence[str]) -> dict[int, str]:
    """Positions that lie elsewhere than most, with what explains it.

    Parameters
    ----------
    lon_lat : ndarray, shape (n, 2)
        Degrees; NaN for photographs without.
    names : sequence of str

    Returns
    -------
    dict
        Index of a photograph -> a sentence about it. Empty where no majority says where the block is.
    """
    known = np.flatnonzero(np.isfinite(lon_lat).all(axis=1))
    if len(known) < 3:
        return {}
    middle = _middle(lon_lat[known])
    away = _kilometres(lon_lat[known], middle)
    limit = max(_FAR_KM, _FAR_TIMES * float(np.median(away)))
    far = away > limit
    if 2 * int(far.sum()) >= len(known):
        return {}
    found = {}
    for k, distance in zip(known[far].tolist(), away[far].tolist(), strict=True):
        lon, lat = lon_lat[k].tolist()
        others = (
            ("the sign of its longitude is wrong", (-lon, lat)),
            ("the sign of its latitude is wrong", (lon, -lat)),
            ("its longitude and latitude are exchanged", (lat, lon)),
        )
        why = [word for word, place in others if _kilometres(np.array([place]), middle)[0] <= limit]
        if _kilometres(np.array([[lon, lat]]), np.zeros(2))[0] < _NO_FIX_KM:
            why = ["0°, 0°: the receiver had no fix"]
        reason = f": {why[0]}" if why else ""
        found[k] = (
            f"positions: that of {names[k]} ({lon:.6f}°, {lat:.6f}°) lies {distance:.0f} km from the others "
            f"and is not used{reason}"
        )
    return found


def check_control_place(frame: MapFrame, xyz: Array, lon_lat: Array, source: Path) -> None:
    """Refuse control points of which most lie far from all photographs.

    Parameters
    ----------
    frame : MapFrame
        Of the control points.
    xyz : ndarray, shape (n, 3)
        As written; NaN for an axis that is not known.
    lon_lat : ndarray, shape (m, 2)
        Degrees, of the photographs; NaN for those without.
    source : Path
        Of the control points.

    Raises
    ------
    CrsError
        With the mistake that explains it, where one does: degrees, kilometres, feet, exchanged axes.
    """
    points = xyz[np.isfinite(xyz[:, :2]).all(axis=1), :2]
    photos = lon_lat[np.isfinite(lon_lat).all(axis=1)]
    if not len(points):
        return
    if not len(photos):
        if not frame.is_geographic and _are_degrees(points):
            raise CrsError(
                f"{len(points)} control points look like degrees, not like coordinates of {frame.name}",
                file=source,
                field="crs",
                value=tuple(points[0].tolist()),
            )
        return
    middle = _middle(photos)
    limit = max(_FAR_KM, _FAR_TIMES * float(np.median(_kilometres(photos, middle))))

    def near(candidates: Array) -> bool:
        away = _kilometres(candidates, middle)
        return bool(2 * np.count_nonzero(away <= limit) >= len(candidates))

    def geographic(changed: Array) -> Array:
        flat = np.column_stack([changed, np.zeros(len(changed))])
        try:
            return np.asarray(frame.geodetic_from_map(flat))[:, :2]
        except CrsError:
            # Outside the domain of the projection: nowhere.
            return np.full((len(changed), 2), np.nan)

    if near(geographic(points)):
        return
    mistakes: list[tuple[str, Callable[[], Array]]] = [
        ("x and y exchanged", lambda: geographic(points[:, ::-1]))
    ]
    if not frame.is_geographic:
        unit = frame.unit_m
        mistakes += [
            ("coordinates in kilometres", lambda: geographic(points * 1000.0 / unit)),
            ("coordinates in feet", lambda: geographic(points * FOOT / unit)),
            ("coordinates in metres", lambda: geographic(points / unit)),
            ("coordinates in millimetres", lambda: geographic(points * 0.001 / unit)),
        ]
        if _are_degrees(points):
            mistakes += [
                ("longitude and latitude in degrees", lambda: points),
                ("latitude and longitude in degrees", lambda: points[:, ::-1]),
            ]
    why = next((word for word, changed in mistakes if near(changed())), None)
    away = float(np.nanmedian(_kilometres(geographic(points), middle)))
    distance = f"{away:.0f} km from" if np.isfinite(away) else "nowhere near"
    raise CrsError(
        f"the control points lie {distance} the positions of the photographs",
        file=source,
        field="crs",
        value=tuple(points[0].tolist()),
        hint=None if why is None else f"they would lie there with {why}",
    )


def _are_degrees(points: Array) -> bool:
    return bool((np.abs(points) <= (180.0, 90.0)).all() or (np.abs(points) <= (90.0, 180.0)).all())


def _unit_vectors(lon_lat: Array) -> Array:
    lon, lat = np.radians(lon_lat).T
    return np.column_stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])


def _middle(lon_lat: Array) -> Array:
    """Longitude and latitude of the middle: medians of vectors know no date line."""
    x, y, z = np.median(_unit_vectors(lon_lat), axis=0)
    middle: Array = np.degrees(np.array([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))]))
    return middle


def _kilometres(lon_lat: Array, middle: Array) -> Array:
    """Distances on the sphere; infinite where a place is none."""
    chord = np.linalg.norm(_unit_vectors(np.asarray(lon_lat)) - _unit_vectors(middle[None]), axis=1)
    away: Array = 2.0 * _EARTH_KM * np.arcsin(np.minimum(chord / 2.0, 1.0))
    away[~np.isfinite(away)] = np.inf
    return away
