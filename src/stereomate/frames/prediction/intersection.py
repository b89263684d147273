"""Forward intersection of points that are all seen in the same number of photographs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.geometry.intersection import Rays, intersect_rays

Array = NDArray[np.float64]


def intersect(xy: Array, centres: Array, rotations: Array, principal_distances: Array) -> Array:
    """Points whose images fit best, each seen in k photographs.

    Parameters
    ----------
    xy : ndarray (n, k, 2)
        Image coordinates of n points in k photographs.
    centres : (k, 3) or (n, k, 3)
        Projection centres, the same photographs for all points or their own.
    rotations : (k, 3, 3) or (n, k, 3, 3)
        Camera to object.
    principal_distances : (k,) or (n, k)

    Returns
    -------
    ndarray (n, 3)
    """
    n, k, _ = xy.shape
    c = np.ascontiguousarray(np.broadcast_to(principal_distances, (n, k))).reshape(-1)
    rays = Rays(
        np.repeat(np.arange(n), k),
        np.broadcast_to(centres, (n, k, 3)).reshape(-1, 3),
        np.broadcast_to(rotations, (n, k, 3, 3)).reshape(-1, 3, 3),
        xy.reshape(-1, 2) / c[:, None],
        1.0 / c,  # equal weights in the image, whatever the principal distances
    )
    return intersect_rays(rays, n).points


def image_coordinates(points: Array, centres: Array, rotations: Array, principal_distances: Array) -> Array:
    """Image coordinates (n, k, 2) of points (n, 3) in photographs as in `intersect`."""
    c = np.broadcast_to(principal_distances, (len(points), centres.shape[-2]))[..., None]
    local = (np.swapaxes(rotations, -1, -2) @ (points[:, None, :] - centres)[..., None])[..., 0]
    out: Array = -c * local[..., :2] / local[..., 2:]
    return out
