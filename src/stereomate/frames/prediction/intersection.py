"""Forward intersection of many points by least squares on image residuals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def intersect(xy: Array, centres: Array, rotations: Array, principal_distances: Array) -> Array:
    """Points whose images fit best, all of them seen in all photographs.

    Parameters
    ----------
    xy : ndarray (n, k, 2)
        Image coordinates of n points in k photographs.
    centres : (k, 3)
    rotations : (k, 3, 3)
        Camera to object.
    principal_distances : (k,)

    Returns
    -------
    ndarray (n, 3)
    """
    n, k, _ = xy.shape
    c = np.broadcast_to(principal_distances[None, :, None], (n, k, 1))
    ray = np.einsum("kij,nkj->nki", rotations, np.concatenate([xy, -c], axis=-1))
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    # Start: the point nearest to all rays.
    across = np.eye(3) - ray[..., :, None] * ray[..., None, :]
    middle = centres.mean(axis=0)  # large grid coordinates would cost digits
    right = np.einsum("nkij,kj->ni", across, centres - middle)
    points = np.linalg.solve(across.sum(axis=1), right[..., None])[..., 0]
    camera_from_object = np.swapaxes(rotations, -1, -2)
    for _ in range(6):
        local = np.einsum("kij,nkj->nki", camera_from_object, points[:, None, :] - (centres - middle))
        image = -principal_distances[:, None] * local[..., :2] / local[..., 2:]
        # d image / d point = -c / z (rows 0, 1 of R^T - image direction times row 2)
        factor = -principal_distances[None, :, None, None] / local[..., 2][..., None, None]
        ratio = (local[..., :2] / local[..., 2:])[..., None]
        jacobian = factor * (camera_from_object[None, :, :2, :] - ratio * camera_from_object[None, :, 2:3, :])
        residual = xy - image
        normal = np.einsum("nkai,nkaj->nij", jacobian, jacobian)
        step = np.linalg.solve(normal, np.einsum("nkai,nka->ni", jacobian, residual)[..., None])[..., 0]
        points = points + step
    out: Array = points + middle
    return out
