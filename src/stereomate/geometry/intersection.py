"""Forward intersection: object points from rays of oriented photographs.

Linear (smallest sum of squared distances to the rays) as a start, then least squares of the image residuals,
for all points at once. Image coordinates are ideal ones, reduced to the principal point and freed of
distortion, in units of the principal distance: (x, y) = (u, v) of the ray direction (u, v, -1).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import InputError
from stereomate.geometry.collinearity import photo_jacobians

Array = NDArray[np.float64]

# Condition of a scaled 3x3 normal matrix beyond which the rays are taken as parallel.
_PARALLEL = 1e13


@dataclass(frozen=True)
class TwoRayIntersection:
    """Points midway between two rays, and by how much the rays miss each other.

    Attributes
    ----------
    points : ndarray, shape (..., 3)
        Midpoints of the shortest connections; NaN for parallel rays.
    miss : ndarray, shape (..., 3)
        From the right ray to the left: left minus right.
    depths : ndarray, shape (..., 2)
        Along the left and the right direction, in their lengths; negative behind a camera.
    """

    points: Array
    miss: Array
    depths: Array

    @property
    def miss_distance(self) -> Array:
        """Length of `miss`."""
        result: Array = np.linalg.norm(self.miss, axis=-1)
        return result


def intersect_two_rays(
    left_centre: ArrayLike, left_direction: ArrayLike, right_centre: ArrayLike, right_direction: ArrayLike
) -> TwoRayIntersection:
    """Midpoints of pairs of rays; all arguments (..., 3), broadcast, directions of any length."""
    left, right = np.asarray(left_centre, dtype=np.float64), np.asarray(right_centre, dtype=np.float64)
    a = np.asarray(left_direction, dtype=np.float64)
    b = np.asarray(right_direction, dtype=np.float64)
    base = right - left
    normal = np.cross(a, b)
    square = np.sum(normal * normal, axis=-1)
    parallel = square <= 1e-28 * np.sum(a * a, axis=-1) * np.sum(b * b, axis=-1)
    square = np.where(parallel, np.nan, square)
    s = np.sum(np.cross(base, b) * normal, axis=-1) / square
    t = np.sum(np.cross(base, a) * normal, axis=-1) / square
    on_left, on_right = left + s[..., None] * a, right + t[..., None] * b
    return TwoRayIntersection((on_left + on_right) / 2.0, on_left - on_right, np.stack([s, t], axis=-1))


@dataclass(frozen=True)
class Intersections:
    """Intersected points with their statistics.

    Attributes
    ----------
    points : ndarray, shape (k, 3)
        NaN where fewer than two rays, parallel rays or a point behind a camera determine nothing.
    residuals : ndarray, shape (m, 2)
        Observed minus computed, in the units of the observations.
    cofactors : ndarray, shape (k, 3, 3)
        Inverse normal matrices: covariances for observations with the stated standard deviations.
    redundancy : ndarray of int, shape (k,)
        Two per ray minus three.
    sigma0 : ndarray, shape (k,)
        Standard deviation of unit weight of each point.
    converged : ndarray of bool, shape (k,)
    """

    points: Array
    residuals: Array
    cofactors: Array
    redundancy: NDArray[np.int64]
    sigma0: Array
    converged: NDArray[np.bool_]

    @property
    def covariances(self) -> Array:
        """Covariances (k, 3, 3) scaled with each point's own `sigma0`."""
        return self.cofactors * self.sigma0[:, None, None] ** 2


@dataclass(frozen=True)
class Rays:
    """Image observations of object points, one row per ray.

    Parameters
    ----------
    point : ndarray of int, shape (m,)
        Index of the object point, 0 to k - 1.
    centres : ndarray, shape (m, 3)
    object_from_camera : ndarray, shape (m, 3, 3)
    image : ndarray, shape (m, 2)
        Ideal image coordinates in units of the principal distance.
    sigma : ndarray, shape (m,)
        A priori standard deviations of the image coordinates, same unit.
    """

    point: NDArray[np.int64]
    centres: Array
    object_from_camera: Array
    image: Array
    sigma: Array

    def __post_init__(self) -> None:
        m = len(self.point)
        shapes = {"centres": (m, 3), "object_from_camera": (m, 3, 3), "image": (m, 2), "sigma": (m,)}
        for name, shape in shapes.items():
            array = getattr(self, name)
            if np.shape(array) != shape:
                raise InputError(f"must have shape {shape}", field=f"rays.{name}", value=np.shape(array))
            if not np.isfinite(array).all():
                raise InputError("must be finite", field=f"rays.{name}")
        if m and not (np.asarray(self.sigma) > 0.0).all():
            raise InputError("must be positive", field="rays.sigma")
        if m and np.min(self.point) < 0:
            raise InputError("must be indices from 0", field="rays.point", value=int(np.min(self.point)))


def _sum_by_point(values: Array, point: NDArray[np.int64], count: int) -> Array:
    flat = values.reshape(len(values), int(np.prod(values.shape[1:])))
    sums = [np.bincount(point, column, count) for column in flat.T]
    result: Array = np.stack(sums, axis=-1).astype(np.float64).reshape(count, *values.shape[1:])
    return result


def _solve3(normal: Array, right: Array) -> tuple[Array, Array]:
    """Solutions (k, 3) and inverses (k, 3, 3) of symmetric 3x3 systems; NaN where singular."""
    scale = np.sqrt(np.einsum("kii->ki", normal))
    good = np.isfinite(scale).all(axis=1) & (scale > 0.0).all(axis=1)
    outer = scale[:, :, None] * scale[:, None, :]
    scaled = np.where(good[:, None, None], normal / np.where(good[:, None, None], outer, 1.0), np.eye(3))
    values = np.linalg.eigvalsh(scaled)
    good &= values[:, 0] * _PARALLEL > values[:, 2]
    inverse = np.linalg.inv(np.where(good[:, None, None], scaled, np.eye(3)))
    inverse = np.where(good[:, None, None], inverse / np.where(outer > 0.0, outer, 1.0), np.nan)
    return np.einsum("kij,kj->ki", inverse, right), inverse


def intersect_linear(rays: Rays, count: int) -> Array:
    """Points (count, 3) with the smallest sum of squared distances to their rays; NaN where undetermined."""
    directions = np.concatenate([rays.image, -np.ones((len(rays.image), 1))], axis=1)
    directions = np.einsum("mij,mj->mi", rays.object_from_camera, directions)
    directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    origin = rays.centres.mean(axis=0) if len(rays.centres) else np.zeros(3)
    projectors = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    normal = _sum_by_point(projectors, rays.point, count)
    right = _sum_by_point(np.einsum("mij,mj->mi", projectors, rays.centres - origin), rays.point, count)
    solution, _ = _solve3(normal, right)
    return solution + origin


def intersect_rays(
    rays: Rays, count: int | None = None, start: ArrayLike | None = None, max_iterations: int = 20
) -> Intersections:
    """Multi-ray forward intersection minimising the weighted image residuals.

    Parameters
    ----------
    rays : Rays
        All observations of all points.
    count : int, optional
        Number of points k; one more than the largest index if not given.
    start : array_like, shape (k, 3), optional
        Approximate points; from `intersect_linear` if not given.
    max_iterations : int

    Returns
    -------
    Intersections
    """
    count = (int(rays.point.max()) + 1 if len(rays.point) else 0) if count is None else count
    # Coordinates of a map grid would lose digits: work about the mean centre.
    origin = rays.centres.mean(axis=0) if len(rays.centres) else np.zeros(3)
    rays = replace(rays, centres=rays.centres - origin)
    points = intersect_linear(rays, count) if start is None else np.asarray(start, dtype=np.float64) - origin
    weights = 1.0 / rays.sigma**2
    converged = np.zeros(count, dtype=np.bool_)
    for _ in range(max_iterations):
        _, normal, right, cost = _linearise(rays, points, weights, count)
        step, _ = _solve3(normal, right)
        promised = np.einsum("ki,ki->k", right, step)
        # No descent left, or a step below the rounding of the coordinates.
        small = np.linalg.norm(step, axis=1) <= 1e-12 * (1.0 + np.linalg.norm(points, axis=1))
        converged |= (promised <= 1e-12 * cost) | small
        points = points + step
        if np.all(converged | ~np.isfinite(points).all(axis=1)):
            break
    residuals, normal, _, cost = _linearise(rays, points, weights, count)
    _, cofactors = _solve3(normal, np.zeros((count, 3)))
    redundancy = 2 * np.bincount(rays.point, minlength=count).astype(np.int64) - 3
    lost = ~np.isfinite(points).all(axis=1) | ~np.isfinite(cost) | ~np.isfinite(cofactors[:, 0, 0])
    points = np.where(lost[:, None], np.nan, points)
    with np.errstate(invalid="ignore", divide="ignore"):
        sigma0 = np.where(redundancy > 0, np.sqrt(cost / np.maximum(redundancy, 1)), np.nan)
    return Intersections(points + origin, residuals, cofactors, redundancy, sigma0, converged & ~lost)


def _linearise(rays: Rays, points: Array, weights: Array, count: int) -> tuple[Array, Array, Array, Array]:
    """Residuals (m, 2), normal matrices, right-hand sides and weighted squares per point."""
    computed, by_point, _, _ = photo_jacobians(points[rays.point], rays.centres, rays.object_from_camera, 1.0)
    residuals = rays.image - computed
    weighted = by_point * weights[:, None, None]
    normal = _sum_by_point(np.einsum("mai,maj->mij", weighted, by_point), rays.point, count)
    right = _sum_by_point(np.einsum("mai,ma->mi", weighted, residuals), rays.point, count)
    cost = _sum_by_point(weights * np.sum(residuals**2, axis=1), rays.point, count)
    return residuals, normal, right, cost
