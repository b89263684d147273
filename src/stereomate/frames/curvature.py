"""Earth curvature of image coordinates, for those who adjust in a map grid as if it were Cartesian.

Corrected coordinates are those a flat Earth would have given. Plumb lines diverge (P1): the horizontal
distance seen from the camera is the arc on the sphere, not the chord. Everything happens in the levelled
frame of the photograph, so tilts are exact; heights are per point. stereomate itself never needs this: it
works in a tangent frame.

Georeferencing theory, section 3. With central angle theta = s / R, nadir angle z and ``sin(zeta) = (R +
h0)/(R + h) sin z``: ``theta = zeta - z``; the horizontal distance is ``(R + h) theta`` at ground level, ``R
theta`` reduced to the ellipsoid. The classical formula is its first term, ``r H tan² z / (2R)``; the
reduction adds ``-r h / R``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import InputError, OrientationError

Array = NDArray[np.float64]
CurvatureMethod = Literal["classical", "sphere"]
CurvatureLevel = Literal["ground", "ellipsoid"]


@dataclass(frozen=True)
class CurvatureOptions:
    """How to correct for Earth curvature.

    Attributes
    ----------
    radius_m : float
        Radius of the sphere: the Gaussian mean radius at the block.
    method : str
        ``classical``: the r³ term, levelled; ``sphere``: exact on the sphere.
    level : str
        ``ground``: distances are kept at ground level, and the grid's scale is then tau_e; ``ellipsoid``:
        they are reduced to the ellipsoid, and the scale is then tau.
    """

    radius_m: float
    method: CurvatureMethod = "sphere"
    level: CurvatureLevel = "ground"

    def __post_init__(self) -> None:
        if self.method not in get_args(CurvatureMethod):
            raise InputError("must be classical or sphere", field="method", value=self.method)
        if self.level not in get_args(CurvatureLevel):
            raise InputError("must be ground or ellipsoid", field="level", value=self.level)
        if not 6.0e6 < self.radius_m < 6.5e6:
            raise InputError("must be an Earth radius in metres", field="radius_m", value=self.radius_m)


def curvature_corrected(
    xy: ArrayLike,
    principal_distance: float,
    level_from_camera: ArrayLike,
    h_camera: ArrayLike,
    h_ground: ArrayLike,
    options: CurvatureOptions,
) -> Array:
    """Image coordinates as a flat Earth would have given them.

    Parameters
    ----------
    xy : array_like (..., 2)
        Measured coordinates from the principal point, in any unit of length.
    principal_distance : float
        In the same unit.
    level_from_camera : array_like (..., 3, 3)
        Rotation to the level frame at the projection centre (grid or east-north-up).
    h_camera, h_ground : array_like (...)
        Ellipsoidal heights of the centre and of each point.

    Raises
    ------
    OrientationError
        If a ray does not go down, or the ground is not below the camera.
    """
    t, height, ground = _levelled(xy, principal_distance, level_from_camera, h_camera, h_ground)
    radius = options.radius_m
    tangent = np.hypot(t[..., 0], t[..., 1])
    if options.method == "classical":
        factor = 1.0 + height * tangent**2 / (2.0 * radius)
        if options.level == "ellipsoid":
            factor = factor - ground / radius
    else:
        factor = _arc(tangent, height, ground, options) / np.where(tangent > 0.0, height * tangent, 1.0)
        factor = np.where(tangent > 0.0, factor, 1.0)
    return project_level(t * factor[..., None], principal_distance, level_from_camera)


def curvature_restored(
    xy: ArrayLike,
    principal_distance: float,
    level_from_camera: ArrayLike,
    h_camera: ArrayLike,
    h_ground: ArrayLike,
    options: CurvatureOptions,
) -> Array:
    """Measured image coordinates from corrected ones: the inverse of `curvature_corrected`, same
    parameters."""
    t, height, ground = _levelled(xy, principal_distance, level_from_camera, h_camera, h_ground)
    radius = options.radius_m
    tangent = np.hypot(t[..., 0], t[..., 1])
    if options.method == "classical":
        k = height / (2.0 * radius)
        one = 1.0 - ground / radius if options.level == "ellipsoid" else np.ones(np.shape(ground))
        found = tangent / one
        # tan (one + k tan²) = tangent; k tan² is below 1e-3, so Newton is at rounding after three steps.
        for _ in range(4):
            found = found - (found * (one + k * found**2) - tangent) / (one + 3.0 * k * found**2)
    else:
        base = radius + ground if options.level == "ground" else radius
        theta = tangent * height / base
        found = (
            (radius + ground) * np.sin(theta) / (height + 2.0 * (radius + ground) * np.sin(theta / 2.0) ** 2)
        )
    factor = np.where(tangent > 0.0, found / np.where(tangent > 0.0, tangent, 1.0), 1.0)
    return project_level(t * factor[..., None], principal_distance, level_from_camera)


def level_tangents(xy: ArrayLike, principal_distance: float, level_from_camera: ArrayLike) -> Array:
    """Horizontal over downward component of the rays of image points, in level axes, shape (..., 2).

    Raises
    ------
    OrientationError
        If a ray does not go down.
    """
    xy = np.asarray(xy, dtype=np.float64)
    ray = np.concatenate([xy, np.full((*xy.shape[:-1], 1), -float(principal_distance))], axis=-1)
    level = np.einsum("...ij,...j->...i", np.asarray(level_from_camera, dtype=np.float64), ray)
    if np.any(level[..., 2] >= 0.0):
        raise OrientationError(
            "a ray does not go down: a correction by height needs ground below", field="xy"
        )
    tangents: Array = level[..., :2] / -level[..., 2:]
    return tangents


def project_level(tangents: ArrayLike, principal_distance: float, level_from_camera: ArrayLike) -> Array:
    """Image coordinates of level directions ``(tangents, -1)``: the inverse of `level_tangents`."""
    t = np.asarray(tangents, dtype=np.float64)
    level = np.concatenate([t, np.full((*t.shape[:-1], 1), -1.0)], axis=-1)
    ray = np.einsum("...ji,...j->...i", np.asarray(level_from_camera, dtype=np.float64), level)
    xy: Array = -principal_distance * ray[..., :2] / ray[..., 2:]
    return xy


def _levelled(
    xy: ArrayLike,
    principal_distance: float,
    level_from_camera: ArrayLike,
    h_camera: ArrayLike,
    h_ground: ArrayLike,
) -> tuple[Array, Array, Array]:
    t = level_tangents(xy, principal_distance, level_from_camera)
    ground = np.broadcast_to(np.asarray(h_ground, dtype=np.float64), t.shape[:-1])
    height = np.broadcast_to(np.asarray(h_camera, dtype=np.float64), t.shape[:-1]) - ground
    if np.any(height <= 0.0):
        raise OrientationError("the ground must lie below the projection centre", field="h_ground")
    return t, height, ground


def _arc(tangent: Array, height: Array, ground: Array, options: CurvatureOptions) -> Array:
    """Horizontal distance of the point a ray meets on the sphere through it."""
    radius = options.radius_m
    epsilon = height / (radius + ground)
    cosine = 1.0 / np.sqrt(1.0 + tangent**2)
    sine = tangent * cosine
    cosine2 = 1.0 - ((1.0 + epsilon) * sine) ** 2
    if np.any(cosine2 <= 0.0):
        raise OrientationError("a ray passes over the horizon", field="xy")
    # sin(zeta - z) without the cancellation of nearly equal angles
    theta = np.arcsin(sine * epsilon * (2.0 + epsilon) / ((1.0 + epsilon) * cosine + np.sqrt(cosine2)))
    base = radius + ground if options.level == "ground" else radius
    return np.asarray(base * theta, dtype=np.float64)
