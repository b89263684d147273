"""Corresponding points of two photographs, and the relative orientation of a pair as a value.

Frame: the left camera's, x right, y up, looking along -z. The base points from the left to the right
projection centre; only its direction can be known, its length is one. Photo coordinates are reduced to the
principal point and free of distortion; the core sees them divided by the principal distance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.camera.distortion import NoDistortion
from stereomate.camera.model import Camera
from stereomate.errors import InputError
from stereomate.geometry.rotations import rotation_angle

Array = NDArray[np.float64]

# Beyond this slope (84° off axis) numbers are pixels taken for millimetres rather than photo coordinates.
_STEEPEST = 10.0


@dataclass(frozen=True)
class RelativePose:
    """Where the right camera stands and how it is turned, in the left camera's frame.

    Parameters
    ----------
    base : ndarray, shape (3,)
        Unit vector from the left to the right projection centre.
    left_from_right : ndarray, shape (3, 3)
        Rotation from right camera axes to left camera axes.
    """

    base: Array
    left_from_right: Array

    def __post_init__(self) -> None:
        base = np.array(self.base, dtype=np.float64)
        rotation = np.array(self.left_from_right, dtype=np.float64)
        if base.shape != (3,) or not abs(np.linalg.norm(base) - 1.0) < 1e-6:
            raise InputError("must be a unit vector", field="base", value=self.base)
        if rotation.shape != (3, 3) or not np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-6:
            raise InputError("must be a rotation matrix", field="left_from_right", value=self.left_from_right)
        base.setflags(write=False)
        rotation.setflags(write=False)
        object.__setattr__(self, "base", base)
        object.__setattr__(self, "left_from_right", rotation)

    @classmethod
    def from_exterior(
        cls, left_centre: ArrayLike, left: ArrayLike, right_centre: ArrayLike, right: ArrayLike
    ) -> RelativePose:
        """From projection centres (3,) and rotations camera to object (3, 3) in one Cartesian frame.

        Raises
        ------
        InputError
            If both centres are the same point.
        """
        rotation = np.asarray(left, dtype=np.float64)
        base = rotation.T @ (np.asarray(right_centre, dtype=np.float64) - np.asarray(left_centre))
        length = float(np.linalg.norm(base))
        if not length > 0.0:
            raise InputError("must be two points", field="projection centres", value=left_centre)
        return cls(base / length, rotation.T @ np.asarray(right, dtype=np.float64))

    @property
    def essential(self) -> Array:
        """The matrix E of ``l' E r = 0``, shape (3, 3)."""
        x, y, z = self.base
        return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ self.left_from_right

    def angles_to(self, other: RelativePose) -> tuple[float, float]:
        """Angle between the two rotations and between the two bases, radians."""
        turn = float(rotation_angle(self.left_from_right.T @ other.left_from_right))
        cross = np.linalg.norm(np.cross(self.base, other.base))
        return turn, math.atan2(float(cross), float(self.base @ other.base))


@dataclass(frozen=True)
class Correspondences:
    """Image points of the same ground points in two photographs.

    Parameters
    ----------
    left, right : ndarray, shape (n, 2)
        Photo coordinates over the principal distance, x right, y up, distortion removed.
    left_covariance, right_covariance : ndarray, shape (1, 3) or (n, 3)
        (xx, xy, yy) of the same, one for all points or one each.
    principal_distances : (float, float)
        Of the left and right photograph in `unit`: what residuals are multiplied with to be read.
    unit : {"mm", "px"}
        Unit of residuals and parallaxes.
    weights : ndarray, shape (n,), or None
        Factors of the inverse covariances.
    """

    left: Array
    right: Array
    left_covariance: Array
    right_covariance: Array
    principal_distances: tuple[float, float]
    unit: Literal["mm", "px"]
    weights: Array | None = None

    def __post_init__(self) -> None:
        left, right = _points(self.left, "left"), _points(self.right, "right")
        n = len(left)
        if len(right) != n:
            raise InputError("must have as many rows as left", field="right", value=len(right))
        object.__setattr__(self, "left", left)
        object.__setattr__(self, "right", right)
        for name in ("left_covariance", "right_covariance"):
            object.__setattr__(self, name, _covariance(getattr(self, name), n, name))
        for value in self.principal_distances:
            if not (math.isfinite(value) and value > 0.0):
                raise InputError("must be positive", field="principal_distances", value=value)
        if self.weights is not None:
            weights = np.ascontiguousarray(self.weights, dtype=np.float64)
            if weights.shape != (n,) or not (np.isfinite(weights).all() and (weights >= 0.0).all()):
                raise InputError(f"must be {n} finite numbers, none negative", field="weights")
            object.__setattr__(self, "weights", weights)

    def __len__(self) -> int:
        return len(self.left)

    @property
    def sigmas(self) -> tuple[float, float]:
        """Typical standard deviation of a coordinate, left and right, in `unit`."""
        left, right = (
            float(np.sqrt(np.median(c[:, 0] + c[:, 2]) / 2.0)) * f
            for c, f in zip(
                (self.left_covariance, self.right_covariance), self.principal_distances, strict=True
            )
        )
        return left, right

    def select(self, rows: ArrayLike) -> Correspondences:
        """The correspondences of some rows (indices or a mask)."""
        rows = np.asarray(rows)
        return replace(
            self,
            left=self.left[rows],
            right=self.right[rows],
            left_covariance=_rows(self.left_covariance, rows),
            right_covariance=_rows(self.right_covariance, rows),
            weights=None if self.weights is None else self.weights[rows],
        )


def correspondences_from_photo(
    left_mm: ArrayLike,
    right_mm: ArrayLike,
    principal_distance_mm: float | tuple[float, float],
    sigma_mm: float | tuple[float, float] = 0.005,
    weights: ArrayLike | None = None,
) -> Correspondences:
    """Correspondences from photo coordinates in millimetres.

    Parameters
    ----------
    left_mm, right_mm : array_like, shape (n, 2)
        Reduced to the principal point, x right, y up, corrected for distortion (and refraction).
    principal_distance_mm : float or (float, float)
        One for both photographs, or left and right.
    sigma_mm : float or (float, float)
        Standard deviation of a coordinate.
    weights : array_like, shape (n,), optional
        One weight per point.

    Raises
    ------
    InputError
        If shapes differ, a number is not finite, or coordinates are so large for the principal distance that
        they must be pixels.
    """
    distances = _two(principal_distance_mm, "principal_distance_mm")
    sigmas = _two(sigma_mm, "sigma_mm")
    sides = []
    for name, points, c in zip(("left_mm", "right_mm"), (left_mm, right_mm), distances, strict=True):
        scaled = _points(points, name) / c
        if scaled.size and np.abs(scaled).max() > _STEEPEST:
            raise InputError(
                f"photo coordinates must be millimetres within {_STEEPEST:g} principal distances ({c:g} mm)",
                field=name,
                value=float(np.abs(scaled).max() * c),
                hint="these look like pixels: transform them by the fiducials or the pixel pitch first",
            )
        sides.append(scaled)
    covariances = [
        np.array([[(s / c) ** 2, 0.0, (s / c) ** 2]]) for s, c in zip(sigmas, distances, strict=True)
    ]
    return Correspondences(
        sides[0],
        sides[1],
        covariances[0],
        covariances[1],
        distances,
        "mm",
        None if weights is None else np.asarray(weights, dtype=np.float64),
    )


def correspondences_from_pixels(
    left_camera: Camera,
    right_camera: Camera,
    left_px: ArrayLike,
    right_px: ArrayLike,
    sigma_px: float | tuple[float, float] = 0.5,
    covariances_px: tuple[ArrayLike | None, ArrayLike | None] = (None, None),
    weights: ArrayLike | None = None,
) -> Correspondences:
    """Correspondences from pixels of calibrated cameras.

    Parameters
    ----------
    left_px, right_px : array_like, shape (n, 2)
        (column, row), pixel centres at +0.5.
    sigma_px : float or (float, float)
        Standard deviation of a measured coordinate, left and right.
    covariances_px : pair of array_like, shape (n, 3), or None
        (column column, column row, row row) per point instead of `sigma_px`, as least-squares matching gives.
    weights : array_like, shape (n,), optional
        One weight per point.

    Raises
    ------
    InputError
        If shapes differ, a number is not finite, or a point is outside its photograph or where its
        distortion has no inverse.
    """
    sigmas = _two(sigma_px, "sigma_px")
    rays, covariances, distances = [], [], []
    sides = zip(("left_px", "right_px"), (left_camera, right_camera), (left_px, right_px), strict=True)
    for k, (name, camera, given) in enumerate(sides):
        pixels = _points(given, name)
        _require_on_photo(pixels, camera, name)
        directions = camera.rays_from_image(pixels)
        bad = ~np.isfinite(directions).all(axis=1)
        if bad.any():
            raise InputError(
                "must be where the distortion can be inverted",
                field=f"{name}[{int(np.argmax(bad))}]",
                value=tuple(pixels[bad][0].tolist()),
            )
        rays.append(np.ascontiguousarray(directions[:, :2]))
        distances.append(camera.principal_distance_mm / _pitch(camera))
        s2 = sigmas[k] ** 2
        of_point = covariances_px[k]
        in_pixels = np.array([[s2, 0.0, s2]]) if of_point is None else np.asarray(of_point, dtype=np.float64)
        covariances.append(_ray_covariance(camera, pixels, in_pixels))
    return Correspondences(
        rays[0],
        rays[1],
        covariances[0],
        covariances[1],
        (distances[0], distances[1]),
        "px",
        None if weights is None else np.asarray(weights, dtype=np.float64),
    )


def _require_on_photo(pixels: Array, camera: Camera, name: str) -> None:
    outside = ~((pixels >= 0.0) & (pixels <= np.array(camera.size_px))).all(axis=1)
    if outside.any():
        raise InputError(
            f"must lie on the photograph of {camera.size_px[0]} x {camera.size_px[1]} px",
            field=f"{name}[{int(np.argmax(outside))}]",
            value=tuple(pixels[outside][0].tolist()),
        )


def _pitch(camera: Camera) -> float:
    matrix = np.asarray(camera.pixel_from_photo)[:, :2]
    return 1.0 / math.sqrt(abs(float(np.linalg.det(matrix))))


def _ray_covariance(camera: Camera, pixels: Array, covariance: Array) -> Array:
    """Covariance of rays (x/c, y/c) from that of pixels; one for all where the camera has no distortion."""
    if isinstance(camera.distortion, NoDistortion) and camera.film_stage is None:
        inverse = np.linalg.inv(np.asarray(camera.pixel_from_photo)[:, :2]) / camera.principal_distance_mm
        jacobian = inverse[None]
    elif len(pixels) == 0:
        return np.ones((1, 3))
    else:
        # The scale of a lens changes slowly: one pixel to either side is exact enough for a covariance.
        step = np.array([[0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]])
        rays = camera.rays_from_image(pixels[:, None] + step)[..., :2]
        jacobian = np.stack([rays[:, 0] - rays[:, 1], rays[:, 2] - rays[:, 3]], axis=-1)
        if not np.isfinite(jacobian).all():
            jacobian = np.where(np.isfinite(jacobian), jacobian, np.nanmedian(jacobian, axis=0))
    full = np.empty((len(covariance), 2, 2))
    full[:, 0, 0], full[:, 1, 1] = covariance[:, 0], covariance[:, 2]
    full[:, 0, 1] = full[:, 1, 0] = covariance[:, 1]
    turned = jacobian @ full @ np.swapaxes(jacobian, -1, -2)
    return np.stack([turned[:, 0, 0], turned[:, 0, 1], turned[:, 1, 1]], axis=1)


def _rows(covariance: Array, rows: NDArray[np.generic]) -> Array:
    return covariance if len(covariance) == 1 else covariance[rows]


def _points(given: ArrayLike, name: str) -> Array:
    points = np.ascontiguousarray(given, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError("must have the shape (n, 2)", field=name, value=points.shape)
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        row = int(np.argmin(finite))
        raise InputError("must be finite", field=f"{name}[{row}]", value=tuple(points[row].tolist()))
    return points


def _covariance(given: ArrayLike, n: int, name: str) -> Array:
    covariance = np.ascontiguousarray(given, dtype=np.float64)
    if covariance.ndim != 2 or covariance.shape[1] != 3 or len(covariance) not in (1, n):
        raise InputError(f"must have the shape (1, 3) or ({n}, 3)", field=name, value=covariance.shape)
    xx, xy, yy = covariance.T
    if not (
        np.isfinite(covariance).all() and (xx > 0.0).all() and (yy > 0.0).all() and (xy * xy < xx * yy).all()
    ):
        raise InputError("must be positive definite (xx, xy, yy)", field=name)
    return covariance


def _two(value: float | tuple[float, float], name: str) -> tuple[float, float]:
    pair = (float(value[0]), float(value[1])) if isinstance(value, tuple) else (float(value), float(value))
    if not all(math.isfinite(v) and v > 0.0 for v in pair):
        raise InputError("must be positive", field=name, value=value)
    return pair
