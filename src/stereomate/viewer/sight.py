"""How far beside a product the height model may hide its ground from a photograph."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.rectify.job import RectifyJob
from stereomate.terrain.model import height_unit_m

Floats = NDArray[np.float64]

# Rays flatter than this (tangent of the angle off the nadir) are not followed further.
_FLATTEST: Final = 5.0
_ROUNDS: Final = 3


def sight_reach_m(job: RectifyJob, corners: Floats) -> float:
    """Horizontal distance within which ground can stand before ground of the product, metres.

    Parameters
    ----------
    corners : ndarray (n, 2)
        Corners of the product in pixels of the height model.
    """
    model = job.heights
    flatness = _flattest_ray(job)
    unit = height_unit_m(model.frame.heights)
    cell = min(model.cell_size_m)
    reach = 0.0
    for _ in range(_ROUNDS):
        room = math.ceil(reach / cell) + 1
        low = np.maximum(np.floor(corners.min(axis=0)).astype(int) - room, 0)
        high = np.minimum(np.ceil(corners.max(axis=0)).astype(int) + room, model.shape[::-1])
        if not (high > low).all():
            return reach
        lowest, highest = model.range_around(int(low[0]), int(low[1]), *(int(n) for n in high - low))
        if not lowest < highest:
            return reach
        wider = (highest - lowest) * unit * flatness
        if wider <= reach:
            break
        reach = wider
    return reach


def _flattest_ray(job: RectifyJob) -> float:
    """Largest tangent of the angle between a ray at a photograph's corner and the vertical."""
    flattest = 0.0
    for photograph in job.photographs:
        corners = photograph.camera.picture_px([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
        rays = photograph.camera.rays_from_image(corners) @ photograph.orientation.object_from_camera.T
        known = np.isfinite(rays).all(axis=1)
        down = -rays[known, 2]
        with np.errstate(divide="ignore"):
            flat = np.where(down > 0.0, np.hypot(rays[known, 0], rays[known, 1]) / down, math.inf)
        flattest = max(flattest, float(flat.max(initial=0.0)))
    return min(flattest, _FLATTEST)
