"""The pixel array of a camera: its size, and how the photo system lies on it."""

from __future__ import annotations

import numpy as np

from stereomate.camera.packing import Affine2
from stereomate.errors import InputError


def check_size(size_px: tuple[int, int], where: str) -> None:
    """Refuse a size that is no positive number of columns and rows."""
    if np.shape(size_px) != (2,) or not all(float(v).is_integer() and v > 0 for v in size_px):
        raise InputError(
            "must be two positive integers (columns, rows)", field=where + "size_px", value=size_px
        )


def pixel_from_photo_of_array(
    size_px: tuple[int, int], pitch_mm: tuple[float, float], rotation: int = 0, mirrored: bool = False
) -> Affine2:
    """Affine from the photo system (mm, origin at the centre of the array) to stored pixels.

    `rotation` in degrees clockwise of the stored array against the calibration; `mirrored` left to right
    before that.

    Raises
    ------
    InputError
        If `rotation` is not 0, 90, 180 or 270.
    """
    # Clockwise turn of an image: right (col +) becomes down (row +), down becomes left.
    turns = {0: ((1, 0), (0, 1)), 90: ((0, -1), (1, 0)), 180: ((-1, 0), (0, -1)), 270: ((0, 1), (-1, 0))}
    if rotation not in turns:
        raise InputError("must be 0, 90, 180 or 270 degrees", field="rotation", value=rotation)
    (a, b), (c, d) = turns[rotation]
    side = -1.0 if mirrored else 1.0
    columns, rows = size_px
    # (right, down) of the calibration in mm is (side * x, -y).
    return (
        (a * side / pitch_mm[0], -b / pitch_mm[0], columns / 2.0),
        (c * side / pitch_mm[1], -d / pitch_mm[1], rows / 2.0),
    )
