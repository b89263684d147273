"""Photographs that tie points cannot join, placed by the orientation that a table states for them.

A resection needs more points than an adjustment that knows the position: what a few points and a GNSS
position determine together is adjusted, starting from the stated orientation.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.geometry.rotations import rotation_angle
from stereomate.project.orient_inputs import OrientInputs
from stereomate.project.orient_measure import Measured

Array = NDArray[np.float64]

# Stated angles that are farther off in the joined photographs are about other axes.
_ANGLES_AGREE: Final = math.radians(5.0)
# Of the longer side: how far from its place a point may be expected.
_EXPECTED: Final = 0.1
_LEAST_POINTS: Final = 2


def placed_by_table(
    inputs: OrientInputs, measured: Measured, centres: Array, rotations: Array
) -> dict[int, int]:
    """Give photographs that could not be joined the orientation of their table, in place.

    Parameters
    ----------
    centres, rotations : ndarray, shape (n, 3) and (n, 3, 3)
        In the tangent frame; NaN for photographs without orientation. Changed.

    Returns
    -------
    dict of int to int
        Photograph -> number of known points it sees where the table expects them.
    """
    stated, angles = inputs.positions.tangent, inputs.positions.attitudes
    joined = np.isfinite(centres[:, 0]) & np.isfinite(angles).all(axis=(1, 2))
    if inputs.positions.source != "table" or not joined.any():
        return {}
    turns = [rotation_angle(angles[k].T @ rotations[k]) for k in np.flatnonzero(joined).tolist()]
    if float(np.median(turns)) > _ANGLES_AGREE:
        return {}
    placed = {}
    for k in sorted(measured.not_joined):
        if not (np.isfinite(stated[k]).all() and np.isfinite(angles[k]).all()):
            continue
        rows = np.flatnonzero(measured.ties.photo == k)
        points = measured.points[measured.ties.point[rows]]
        camera = inputs.photos[k].of_pixels
        seen, inside = camera.image_from_camera((np.nan_to_num(points) - stated[k]) @ angles[k])
        off = np.linalg.norm(seen - measured.ties.pixels[rows], axis=1)
        good = inside & np.isfinite(points[:, 0]) & (off < _EXPECTED * max(camera.size_px))
        if np.count_nonzero(good) >= max(_LEAST_POINTS, len(rows) // 2):
            centres[k], rotations[k] = stated[k], angles[k]
            placed[k] = int(np.count_nonzero(good))
    return placed
