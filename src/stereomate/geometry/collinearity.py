"""The collinearity equations and their derivatives.

``object = X0 + s R (x, y, -c)``: R (``object_from_camera``) turns the camera frame (x right, y up, camera
looks along -z) into the object frame. Rotations are perturbed on the left, about the axes of the object
frame: ``R -> exp(θ) R``; `perturbation_from_opk` turns derivatives by θ into derivatives by (ω, φ, κ).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.geometry.rotations import rotation_x, rotation_y, skew

Array = NDArray[np.float64]


def camera_from_object(points: ArrayLike, centre: ArrayLike, object_from_camera: ArrayLike) -> Array:
    """Points (..., 3) of the object frame in the camera frame."""
    offset = np.asarray(points, dtype=np.float64) - np.asarray(centre, dtype=np.float64)
    result: Array = np.einsum("...ji,...j->...i", np.asarray(object_from_camera, dtype=np.float64), offset)
    return result


def object_from_camera_points(points: ArrayLike, centre: ArrayLike, object_from_camera: ArrayLike) -> Array:
    """Points (..., 3) of the camera frame in the object frame: the inverse of `camera_from_object`."""
    rotation = np.asarray(object_from_camera, dtype=np.float64)
    turned = np.einsum("...ij,...j->...i", rotation, np.asarray(points, dtype=np.float64))
    result: Array = turned + np.asarray(centre, dtype=np.float64)
    return result


def photo_from_camera(points: ArrayLike, principal_distance: float) -> Array:
    """Ideal photo coordinates (..., 2), reduced to the principal point, in units of `principal_distance`.

    NaN for points that are not before the camera (z >= 0).
    """
    p = np.asarray(points, dtype=np.float64)
    depth = np.where(p[..., 2] < 0.0, -p[..., 2], np.nan)
    result: Array = principal_distance * p[..., :2] / depth[..., None]
    return result


def photo_from_camera_jacobian(points: ArrayLike, principal_distance: float) -> Array:
    """d photo / d (camera-frame point), shape (..., 2, 3)."""
    p = np.asarray(points, dtype=np.float64)
    depth = np.where(p[..., 2] < 0.0, -p[..., 2], np.nan)
    result = np.zeros((*p.shape[:-1], 2, 3))
    result[..., 0, 0] = result[..., 1, 1] = 1.0
    result[..., :, 2] = p[..., :2] / depth[..., None]
    return principal_distance * result / depth[..., None, None]


def camera_jacobians(
    points: ArrayLike, centre: ArrayLike, object_from_camera: ArrayLike
) -> tuple[Array, Array, Array]:
    """Derivatives of the camera-frame point: by the object point, by the centre and by the left rotation θ.

    Each of shape (..., 3, 3).
    """
    offset = np.asarray(points, dtype=np.float64) - np.asarray(centre, dtype=np.float64)
    rotation = np.asarray(object_from_camera, dtype=np.float64)
    transposed = np.swapaxes(rotation, -1, -2)
    by_point = np.broadcast_to(transposed, (*offset.shape[:-1], 3, 3))
    # p = Rᵀ exp(-θ) d, and exp(-θ) d = d - θ x d = d + [d]x θ to first order.
    return by_point, -by_point, transposed @ skew(offset)


def photo_from_object(
    points: ArrayLike, centre: ArrayLike, object_from_camera: ArrayLike, principal_distance: float
) -> Array:
    """Collinearity: ideal photo coordinates (..., 2) of object points, NaN behind the camera."""
    return photo_from_camera(camera_from_object(points, centre, object_from_camera), principal_distance)


def photo_jacobians(
    points: ArrayLike, centre: ArrayLike, object_from_camera: ArrayLike, principal_distance: float
) -> tuple[Array, Array, Array, Array]:
    """Ideal photo coordinates (..., 2) with derivatives (..., 2, 3) by point, centre and left rotation."""
    in_camera = camera_from_object(points, centre, object_from_camera)
    outer = photo_from_camera_jacobian(in_camera, principal_distance)
    by_point, by_centre, by_rotation = camera_jacobians(points, centre, object_from_camera)
    photo = photo_from_camera(in_camera, principal_distance)
    return photo, outer @ by_point, outer @ by_centre, outer @ by_rotation


def perturbation_from_opk(opk: ArrayLike) -> Array:
    """dθ / d(ω, φ, κ), shape (..., 3, 3): left rotation vector of a change of the angles of R = Rx Ry Rz.

    Its columns are the axes the three angles turn about: the x axis, the y axis turned by ω, the z axis
    turned by ω and φ. Singular at φ = ±90°.
    """
    opk = np.asarray(opk, dtype=np.float64)
    rx, ry = rotation_x(opk[..., 0]), rotation_y(opk[..., 1])
    first = np.broadcast_to(np.array([1.0, 0.0, 0.0]), (*opk.shape[:-1], 3))
    return np.stack([first, rx[..., :, 1], (rx @ ry)[..., :, 2]], axis=-1)
