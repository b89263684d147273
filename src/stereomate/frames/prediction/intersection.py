"""Forward intersection of many points by least squares on image residuals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
    c = np.broadcast_to(principal_distances, xy.shape[:2])[..., None]
    ray = (rotations @ np.concatenate([xy, -c], axis=-1)[..., None])[..., 0]
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    # Start: the point nearest to all rays.
    across = np.eye(3) - ray[..., :, None] * ray[..., None, :]
    middle = centres.reshape(-1, 3).mean(axis=0)  # large grid coordinates would cost digits
    local_centres = centres - middle
    right = (across @ local_centres[..., None]).sum(axis=1)
    points = np.linalg.solve(across.sum(axis=1), right)[..., 0]
    camera_from_object = np.swapaxes(rotations, -1, -2)
    for _ in range(6):
        local = (camera_from_object @ (points[:, None, :] - local_centres)[..., None])[..., 0]
        ratio = local[..., :2] / local[..., 2:]
        # d image / d point = -c / z (rows 0, 1 of R^T - image direction times row 2)
        jacobian = (-c / local[..., 2:])[..., None] * (
            camera_from_object[..., :2, :] - ratio[..., None] * camera_from_object[..., 2:3, :]
        )
        residual = xy + c * ratio
        normal = np.einsum("nkai,nkaj->nij", jacobian, jacobian)
        right = np.einsum("nkai,nka->ni", jacobian, residual)[..., None]
        points = points + np.linalg.solve(normal, right)[..., 0]
    out: Array = points + middle
    return out


def image_coordinates(points: Array, centres: Array, rotations: Array, principal_distances: Array) -> Array:
    """Image coordinates (n, k, 2) of points (n, 3) in photographs as in `intersect`."""
    c = np.broadcast_to(principal_distances, (len(points), centres.shape[-2]))[..., None]
    local = (np.swapaxes(rotations, -1, -2) @ (points[:, None, :] - centres)[..., None])[..., 0]
    out: Array = -c * local[..., :2] / local[..., 2:]
    return out
