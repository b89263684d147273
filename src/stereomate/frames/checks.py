"""Coordinates at the gate: outside the area of the map, exchanged axes, feet for metres, below the ground."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import CrsError, HeightSystemError
from stereomate.frames.crs import geodetic_of, horizontal_part, parse, projection
from stereomate.frames.mapframe import MapFrame
from stereomate.units import FOOT, US_SURVEY_FOOT

Array = NDArray[np.float64]

# Maps are used a little beyond the area they are registered for (a neighbouring zone, the sea).
_MARGIN_DEG: Final = 2.0
# A height that is 3.28 times another within this share was probably written in feet.
_FEET_TOLERANCE: Final = 0.01


def check_coordinates(
    frame: MapFrame, xy: ArrayLike, what: str, file: object | None = None, *, tolerated: float = 0.0
) -> None:
    """Check that map positions lie in the area of use of their CRS.

    Parameters
    ----------
    frame : MapFrame
    xy : array_like (..., 2) or (..., 3)
        Map coordinates; heights are not looked at. NaN is passed over.
    what : str
        What they are, for the message: "projection centres".
    file : path, optional
        Where they come from.
    tolerated : float
        Share of them that may lie outside.

    Raises
    ------
    CrsError
        If a position is outside. The message names the mistake that would explain it, where one does:
        exchanged axes, axes to the west and south, feet for metres, metres for feet.
    """
    points = np.asarray(xy, dtype=np.float64)[..., :2].reshape(-1, 2)
    points = points[np.isfinite(points).all(axis=1)]
    inside = _inside(frame.crs, points)
    if inside.all() or np.mean(~inside) <= tolerated:
        return
    for reason, changed in _mistakes(frame, points):
        if _inside(frame.crs, changed).all():
            raise CrsError(
                f"{int((~inside).sum())} of {len(points)} {what} lie outside the area of {frame.name}",
                file=file,
                field="crs",
                value=tuple(points[~inside][0].tolist()),
                hint=f"they would lie inside with {reason}",
            )
    outside = f"{int((~inside).sum())} of {len(points)} {what} lie outside"
    raise CrsError(
        f"{outside} the area of {frame.name}{_area_text(frame.crs)}",
        file=file,
        field="crs",
        value=tuple(points[~inside][0].tolist()),
    )


def _mistakes(frame: MapFrame, points: Array) -> list[tuple[str, Array]]:
    swapped = points[:, ::-1]
    mistakes = [("x and y exchanged", swapped)]
    if not frame.is_geographic:
        mistakes += [
            ("both signs changed: axes to the west and south", -points),
            ("x and y exchanged and both signs changed: axes to the south and west", -swapped),
        ]
        unit = frame.unit_m
        for name, factor in (("feet", FOOT), ("US survey feet", US_SURVEY_FOOT), ("metres", 1.0)):
            if abs(unit / factor - 1.0) > 0.1:
                mistakes.append(
                    (f"coordinates in {name}, not in the unit of the CRS", points * factor / unit)
                )
    return mistakes


def _inside(crs: str, points: Array) -> NDArray[np.bool_]:
    horizontal = horizontal_part(parse(crs))
    datum = geodetic_of(crs)
    if horizontal.is_geographic:
        lon, lat = datum.normal(points[:, 0], points[:, 1])
    else:
        found = projection(crs).transform(points[:, 0], points[:, 1], direction="INVERSE")
        lon, lat = datum.normal(*(np.asarray(part, dtype=np.float64) for part in found))
        # A projection may wrap: what does not come back to itself was outside its domain.
        again = projection(crs).transform(*datum.native(lon, lat))
        miss = np.hypot(np.asarray(again[0]) - points[:, 0], np.asarray(again[1]) - points[:, 1])
        lon = np.where(np.isfinite(miss) & (miss < 1.0), lon, np.nan)
    good: NDArray[np.bool_] = np.isfinite(lon + lat) & (np.abs(lat) <= 90.0)
    area = horizontal.area_of_use
    if area is None:
        return good & (np.abs(lon) <= 540.0)
    width = (area.east - area.west) % 360.0 or 360.0
    east_of_west = (lon - area.west + _MARGIN_DEG) % 360.0
    good &= (lat >= area.south - _MARGIN_DEG) & (lat <= area.north + _MARGIN_DEG)
    return np.asarray(good & ((width + 2 * _MARGIN_DEG >= 360.0) | (east_of_west <= width + 2 * _MARGIN_DEG)))


def _area_text(crs: str) -> str:
    area = horizontal_part(parse(crs)).area_of_use
    if area is None:
        return ""
    return (
        f" (longitude {area.west:g} to {area.east:g}, latitude {area.south:g} to {area.north:g}, "
        f"and {_MARGIN_DEG:g} degrees around)"
    )


def check_height_units(
    heights: ArrayLike, reference_m: ArrayLike, what: str, file: object | None = None
) -> None:
    """Check heights against others of the same points, in metres, for a mistaken unit.

    Parameters
    ----------
    heights : array_like (n,)
        As written, taken to be metres.
    reference_m : array_like (n,)
        Heights of the same points from the height model or the control.

    Raises
    ------
    HeightSystemError
        If they are 3.28 times the reference, or the reverse.
    """
    h, reference = np.asarray(heights, dtype=np.float64), np.asarray(reference_m, dtype=np.float64)
    use = np.isfinite(h + reference) & (np.abs(reference) > 20.0)
    if not use.any():
        return
    ratio = float(np.median(h[use] / reference[use]))
    for factor, word in ((1.0 / FOOT, "feet"), (FOOT, "metres while the others are in feet")):
        if abs(ratio / factor - 1.0) < _FEET_TOLERANCE:
            raise HeightSystemError(
                f"heights of {what} are {ratio:.3f} times those of the same points elsewhere: "
                f"they look like {word}",
                file=file,
                field="heights",
                value=float(h[use][0]),
            )
