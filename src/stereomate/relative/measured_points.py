"""Correspondences from a table of measured points, checked for other units and origins."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.model import Camera
from stereomate.errors import InputError
from stereomate.relative.pair import (
    Correspondences,
    correspondences_from_photo,
    correspondences_from_pixels,
)
from stereomate.relative.point_table import PointTable

Array = NDArray[np.float64]

# Photo coordinates of frame cameras stay below two principal distances, those of super-wide angle included.
_LARGEST_SLOPE: Final = 3.0


def photo_coordinates(
    table: PointTable, file: Path, principal_distances_mm: tuple[float, float]
) -> tuple[Array, Array]:
    """Left and right photo coordinates (n, 2) of a table of kind "image".

    Raises
    ------
    InputError
        If they cannot be millimetres from the principal point: too large for the principal distance (pixels,
        micrometres), or all on one side of both axes of both photographs (counted from a corner).
    """
    sides = table.values[:, :2], table.values[:, 2:]
    for side, points, c in zip(("left", "right"), sides, principal_distances_mm, strict=True):
        worst = int(np.argmax(np.abs(points).max(axis=1)))
        if np.abs(points[worst]).max() > _LARGEST_SLOPE * c:
            raise InputError(
                f"must be millimetres, within {_LARGEST_SLOPE:g} principal distances of {c:g} mm",
                file=file,
                field=f"point {table.names[worst]}, {side}",
                value=tuple(points[worst].tolist()),
                hint="pixels or fiducial units? transform them by the fiducials or the pixel pitch first",
            )
    positive = [(points > 0.0).all(axis=0) | (points < 0.0).all(axis=0) for points in sides]
    same_quadrant = positive[0].all() and positive[1].all()
    if same_quadrant and (np.sign(sides[0][0]) == np.sign(sides[1][0])).all():
        raise InputError(
            "must be counted from the principal point",
            file=file,
            field="image coordinates",
            value=f"all points in one and the same quadrant of both photographs, as {sides[0][0].tolist()}",
            hint="counted from a corner? subtract the fiducial centre and the principal point",
        )
    return sides


def correspondences_of_table(
    table: PointTable,
    file: Path,
    calibration: tuple[Camera, Camera] | tuple[float, float],
    sigma: float | None = None,
) -> Correspondences:
    """Correspondences of a table of kind "image" or "pixels".

    Parameters
    ----------
    table : PointTable
    file : Path
        Of the table, for messages.
    calibration : two cameras or two numbers
        Cameras for pixels; principal distances (mm) for image coordinates.
    sigma : float, optional
        Standard deviation of a coordinate of weight one, in the unit of the table: 0.005 mm or 0.5 px.

    Raises
    ------
    InputError
        If the calibration does not belong to the kind, or a coordinate breaks a rule.
    """
    left, right = calibration
    if isinstance(left, Camera) and isinstance(right, Camera):
        if table.kind != "pixels":
            raise InputError("must be given for columns in millimetres", field="--principal-distance")
        points = table.values[:, :2], table.values[:, 2:]
        return correspondences_from_pixels(left, right, *points, sigma or 0.5, weights=table.weights)
    assert not isinstance(left, Camera)
    assert not isinstance(right, Camera)
    if table.kind != "image":
        raise InputError("must be given for columns in pixels", field="--camera")
    sides = photo_coordinates(table, file, (left, right))
    return correspondences_from_photo(*sides, (left, right), sigma or 0.005, table.weights)
