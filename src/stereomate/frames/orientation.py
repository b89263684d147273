"""Exterior orientation as a value: where a camera was and which way it looked, in a tangent frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import OrientationError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ExteriorOrientation:
    """Projection centre and rotation of one photograph in tangent axes.

    Attributes
    ----------
    centre : tuple of 3 floats
        Metres in the tangent frame.
    object_from_camera : ndarray (3, 3)
        Camera axes (x right, y up, z backwards) as columns; read-only.

    Raises
    ------
    OrientationError
        If the matrix is not a rotation to 1e-9 or a number is not finite.
    """

    centre: tuple[float, float, float]
    object_from_camera: Array

    def __post_init__(self) -> None:
        rotation = np.array(self.object_from_camera, dtype=np.float64)
        centre = tuple(float(value) for value in self.centre)
        if rotation.shape != (3, 3) or len(centre) != 3:
            raise OrientationError("needs a centre of 3 numbers and a 3 x 3 matrix", value=rotation.shape)
        if not (np.isfinite(rotation).all() and np.isfinite(centre).all()):
            raise OrientationError("centre and rotation must be finite numbers", value=centre)
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-9 or np.linalg.det(rotation) < 0.0:
            raise OrientationError(
                "must be a rotation: orthonormal, determinant +1",
                field="object_from_camera",
                value=rotation.round(6).tolist(),
            )
        rotation.flags.writeable = False
        object.__setattr__(self, "object_from_camera", rotation)
        object.__setattr__(self, "centre", centre)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, ExteriorOrientation):
            return NotImplemented
        return self.centre == other.centre and np.array_equal(
            self.object_from_camera, other.object_from_camera
        )

    def __hash__(self) -> int:
        return hash((self.centre, self.object_from_camera.tobytes()))

    @property
    def viewing_direction(self) -> Array:
        """Unit vector of the optical axis, forwards, in tangent axes (3,)."""
        return np.asarray(-self.object_from_camera[:, 2], dtype=np.float64)

    def camera_from_tangent(self, points: ArrayLike) -> Array:
        """Tangent points (..., 3) in the camera frame."""
        out: Array = (np.asarray(points, dtype=np.float64) - np.array(self.centre)) @ self.object_from_camera
        return out

    def tangent_from_camera(self, points: ArrayLike) -> Array:
        """Camera-frame points (..., 3) in the tangent frame."""
        out: Array = np.asarray(points, dtype=np.float64) @ self.object_from_camera.T + np.array(self.centre)
        return out
