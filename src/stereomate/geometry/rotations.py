"""Rotation matrices and the angles, quaternions and vectors they are written as.

The convention of stereomate is ``R = Rx(omega) Ry(phi) Rz(kappa)``, camera to object, right-handed,
active rotations. All functions are vectorised over leading axes; angles in radians.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def rotation_x(angle: ArrayLike) -> Array:
    """Rotation about the x axis, shape (..., 3, 3)."""
    return _about(0, angle)


def rotation_y(angle: ArrayLike) -> Array:
    """Rotation about the y axis, shape (..., 3, 3)."""
    return _about(1, angle)


def rotation_z(angle: ArrayLike) -> Array:
    """Rotation about the z axis, shape (..., 3, 3)."""
    return _about(2, angle)


def _about(axis: int, angle: ArrayLike) -> Array:
    angle = np.asarray(angle, dtype=np.float64)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.zeros((*angle.shape, 3, 3))
    matrix[..., axis, axis] = 1.0
    matrix[..., i, i] = matrix[..., j, j] = np.cos(angle)
    matrix[..., j, i] = np.sin(angle)
    matrix[..., i, j] = -matrix[..., j, i]
    return matrix


def rotation_from_opk(opk: ArrayLike) -> Array:
    """``Rx(omega) Ry(phi) Rz(kappa)`` from angles (..., 3) in radians; shape (..., 3, 3)."""
    opk = np.asarray(opk, dtype=np.float64)
    return rotation_x(opk[..., 0]) @ rotation_y(opk[..., 1]) @ rotation_z(opk[..., 2])


def opk_from_rotation(rotation: ArrayLike) -> Array:
    """Angles (omega, phi, kappa) of ``R = Rx Ry Rz``, shape (..., 3), phi in [-pi/2, pi/2].

    At phi = ±pi/2 only the sum or difference of omega and kappa is determined; omega is then 0.
    """
    r = np.asarray(rotation, dtype=np.float64)
    level = np.hypot(r[..., 0, 0], r[..., 0, 1])
    # Not the arcsine, which near ±pi/2 turns a rounding of 1e-16 into an angle of 1.5e-8.
    phi = np.arctan2(r[..., 0, 2], level)
    omega = np.arctan2(-r[..., 1, 2], r[..., 2, 2])
    kappa = np.arctan2(-r[..., 0, 1], r[..., 0, 0])
    locked = level < 1e-12
    if np.any(locked):
        omega = np.where(locked, 0.0, omega)
        kappa = np.where(locked, np.arctan2(r[..., 1, 0], r[..., 1, 1]), kappa)
    return np.stack([omega, phi, kappa], axis=-1)


def rotation_from_pok(pok: ArrayLike) -> Array:
    """``Ry(phi) Rx(omega) Rz(kappa)`` from angles (phi, omega, kappa), shape (..., 3, 3)."""
    pok = np.asarray(pok, dtype=np.float64)
    return rotation_y(pok[..., 0]) @ rotation_x(pok[..., 1]) @ rotation_z(pok[..., 2])


def pok_from_rotation(rotation: ArrayLike) -> Array:
    """Angles (phi, omega, kappa) of ``R = Ry Rx Rz``, shape (..., 3), omega in [-pi/2, pi/2].

    At omega = ±pi/2 only the sum or difference of phi and kappa is determined; phi is then 0.
    """
    r = np.asarray(rotation, dtype=np.float64)
    level = np.hypot(r[..., 1, 0], r[..., 1, 1])
    omega = np.arctan2(-r[..., 1, 2], level)
    phi = np.arctan2(r[..., 0, 2], r[..., 2, 2])
    kappa = np.arctan2(r[..., 1, 0], r[..., 1, 1])
    locked = level < 1e-12
    if np.any(locked):
        phi = np.where(locked, 0.0, phi)
        kappa = np.where(locked, np.arctan2(-r[..., 0, 1], r[..., 0, 0]), kappa)
    return np.stack([phi, omega, kappa], axis=-1)


def rotation_from_quaternion(wxyz: ArrayLike) -> Array:
    """Rotation of a quaternion (w, x, y, z), normalised first; shape (..., 3, 3)."""
    q = np.asarray(wxyz, dtype=np.float64)
    w, x, y, z = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quaternion_from_rotation(rotation: ArrayLike) -> Array:
    """Unit quaternion (w, x, y, z), w >= 0, shape (..., 4)."""
    r = np.asarray(rotation, dtype=np.float64)
    m00, m11, m22 = r[..., 0, 0], r[..., 1, 1], r[..., 2, 2]
    # Four candidates, each well conditioned where its own component is the largest (Shepperd's method).
    a = r[..., 2, 1] - r[..., 1, 2]
    b = r[..., 0, 2] - r[..., 2, 0]
    c = r[..., 1, 0] - r[..., 0, 1]
    d = r[..., 1, 0] + r[..., 0, 1]
    e = r[..., 0, 2] + r[..., 2, 0]
    f = r[..., 2, 1] + r[..., 1, 2]
    candidates = np.stack(
        [
            np.stack([1 + m00 + m11 + m22, a, b, c], axis=-1),
            np.stack([a, 1 + m00 - m11 - m22, d, e], axis=-1),
            np.stack([b, d, 1 - m00 + m11 - m22, f], axis=-1),
            np.stack([c, e, f, 1 - m00 - m11 + m22], axis=-1),
        ],
        axis=-2,
    )
    diagonal = np.diagonal(candidates, axis1=-2, axis2=-1)
    best = np.argmax(diagonal, axis=-1)
    q = np.take_along_axis(candidates, best[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    result: Array = np.where(q[..., :1] < 0, -q, q)
    return result


def skew(vector: ArrayLike) -> Array:
    """Cross-product matrix: ``skew(a) @ b == cross(a, b)``; shape (..., 3, 3)."""
    v = np.asarray(vector, dtype=np.float64)
    zero = np.zeros(v.shape[:-1])
    x, y, z = np.moveaxis(v, -1, 0)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def rotation_from_vector(vector: ArrayLike) -> Array:
    """Rodrigues: rotation by the length of `vector` (radians) about it, shape (..., 3, 3)."""
    v = np.asarray(vector, dtype=np.float64)
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    k = skew(v)
    small = angle < 1e-8
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 1.0 - angle**2 / 6.0, np.sin(safe) / safe)
    second = np.where(small, 0.5 - angle**2 / 24.0, (1.0 - np.cos(safe)) / safe**2)
    result: Array = np.eye(3) + first * k + second * (k @ k)
    return result


def rotation_angle(rotation: ArrayLike) -> Array:
    """Angle of a rotation in radians, accurate for small angles too."""
    r = np.asarray(rotation, dtype=np.float64)
    axis = np.stack(
        [r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0], r[..., 1, 0] - r[..., 0, 1]], axis=-1
    )
    result: Array = np.arctan2(
        np.linalg.norm(axis, axis=-1) / 2.0, (np.trace(r, axis1=-2, axis2=-1) - 1.0) / 2.0
    )
    return result
