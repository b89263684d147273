"""Space resection: exterior orientation of one photograph from control points.

Three points give up to four orientations in closed form (Grunert's quartic, in the form of Haralick et al.
1994); the best over all points starts the least squares of the image residuals.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import InputError, NotDeterminedError
from stereomate.geometry.adjustment import AdjustmentOptions, AdjustmentSummary, adjust
from stereomate.geometry.collinearity import (
    camera_from_object,
    perturbation_from_opk,
    photo_from_camera,
    photo_jacobians,
)
from stereomate.geometry.rotations import opk_from_rotation, rotation_from_vector
from stereomate.geometry.similarity import closed_form

Array = NDArray[np.float64]

# Triples tried for a start: the largest ones, or with gross errors to be expected (which make large ones) all
# of up to nine points, else a sample.
_LARGEST_TRIPLES, _SAMPLED_TRIPLES = 12, 84


@dataclass(frozen=True)
class Resection:
    """Exterior orientation of a photograph with its statistics.

    Attributes
    ----------
    centre : ndarray, shape (3,)
    object_from_camera : ndarray, shape (3, 3)
    residuals : ndarray, shape (n, 2)
        Observed minus computed image coordinates.
    summary : AdjustmentSummary
        Parameters: centre (3), left rotation about the axes of the object frame (3, radians).
    """

    centre: Array
    object_from_camera: Array
    residuals: Array
    summary: AdjustmentSummary

    @property
    def opk(self) -> Array:
        """Angles (ω, φ, κ) in radians."""
        return opk_from_rotation(self.object_from_camera)

    @property
    def covariance_opk(self) -> Array:
        """Covariance (6, 6) of centre and (ω, φ, κ), scaled with the a posteriori ``sigma0``."""
        jacobian = np.eye(6)
        jacobian[3:, 3:] = np.linalg.inv(perturbation_from_opk(self.opk))
        result: Array = jacobian @ self.summary.covariance @ jacobian.T
        return result


def resect_three_points(directions: ArrayLike, points: ArrayLike) -> list[tuple[Array, Array]]:
    """Orientations that put three object points exactly on three rays.

    Parameters
    ----------
    directions : array_like, shape (3, 3)
        Rays in the camera frame, any length, one per row.
    points : array_like, shape (3, 3)
        Object points, one per row.

    Returns
    -------
    list of (centre, object_from_camera)
        Up to four; empty for points on a line or coinciding rays.
    """
    d = np.asarray(directions, dtype=np.float64)
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    p = np.asarray(points, dtype=np.float64)
    p = p - p.mean(axis=0)
    a2, b2, c2 = (float(np.sum((p[i] - p[j]) ** 2)) for i, j in ((1, 2), (0, 2), (0, 1)))
    # Rounding never makes three points exactly collinear: compare the area with the sides.
    area = float(np.linalg.norm(np.cross(p[1] - p[0], p[2] - p[0])))
    if area <= 1e-9 * max(a2, b2, c2) or min(a2, b2, c2) == 0.0:
        return []
    cos_a, cos_b, cos_g = float(d[1] @ d[2]), float(d[0] @ d[2]), float(d[0] @ d[1])
    solutions = []
    for v in _grunert_roots(a2, b2, c2, cos_a, cos_b, cos_g):
        distances = _distances(v, (a2, b2, c2), (cos_a, cos_b, cos_g))
        if distances is None:
            continue
        transform = closed_form(d * distances[:, None], p, True, np.ones(3))
        rotation = np.array(transform.rotation)
        mean = np.asarray(points, dtype=np.float64).mean(axis=0)
        solutions.append((np.array(transform.translation) + mean, rotation))
    return solutions


def _grunert_roots(a2: float, b2: float, c2: float, cos_a: float, cos_b: float, cos_g: float) -> list[float]:
    """Real positive ratios v = s3 / s1 of the distances to the third and the first point."""
    q = (a2 - c2) / b2
    r = (a2 + c2) / b2
    coefficients = [
        (q - 1.0) ** 2 - 4.0 * c2 / b2 * cos_a**2,
        4.0 * (q * (1.0 - q) * cos_b - (1.0 - r) * cos_a * cos_g + 2.0 * c2 / b2 * cos_a**2 * cos_b),
        2.0
        * (
            q * q - 1.0 + 2.0 * q * q * cos_b**2 + 2.0 * (b2 - c2) / b2 * cos_a**2
            - 4.0 * r * cos_a * cos_b * cos_g + 2.0 * (b2 - a2) / b2 * cos_g**2
        ),
        4.0 * (-q * (1.0 + q) * cos_b + 2.0 * a2 / b2 * cos_g**2 * cos_b - (1.0 - r) * cos_a * cos_g),
        (1.0 + q) ** 2 - 4.0 * a2 / b2 * cos_g**2,
    ]  # fmt: skip
    roots = np.asarray(np.roots(coefficients), dtype=np.complex128)
    # Double roots (the danger cylinder) come as close complex pairs: their real part is the start.
    return [float(v.real) for v in roots if abs(v.imag) <= 1e-3 * abs(v) and v.real > 0.0]


def _distances(
    v: float, squares: tuple[float, float, float], cosines: tuple[float, float, float]
) -> Array | None:
    """Distances of the three points for the ratio v, polished by Newton on the law of cosines."""
    (a2, b2, c2), (cos_a, cos_b, cos_g) = squares, cosines
    q = (a2 - c2) / b2
    bottom = 2.0 * (cos_g - v * cos_a)
    if bottom == 0.0:
        return None
    u = ((q - 1.0) * v * v - 2.0 * q * cos_b * v + 1.0 + q) / bottom
    square = 1.0 + v * v - 2.0 * v * cos_b
    if u <= 0.0 or square <= 0.0:
        return None
    first = math.sqrt(b2 / square)
    s = np.array([first, u * first, v * first])
    pairs = ((1, 2, a2, cos_a), (0, 2, b2, cos_b), (0, 1, c2, cos_g))
    for _ in range(5):
        jacobian, misfit = np.zeros((3, 3)), np.zeros(3)
        for row, (i, j, square, cosine) in enumerate(pairs):
            misfit[row] = s[i] ** 2 + s[j] ** 2 - 2.0 * s[i] * s[j] * cosine - square
            jacobian[row, i] = 2.0 * (s[i] - s[j] * cosine)
            jacobian[row, j] = 2.0 * (s[j] - s[i] * cosine)
        if abs(np.linalg.det(jacobian)) <= 1e-12 * np.abs(jacobian).max() ** 3:
            break
        s = s - np.linalg.solve(jacobian, misfit)
    return s if (s > 0.0).all() else None


def _triples(image: Array, robust: bool) -> NDArray[np.int64]:
    """Triples of points (m, 3) to start from."""
    n = len(image)
    if robust and math.comb(n, 3) > _SAMPLED_TRIPLES:
        rng = np.random.default_rng(0)  # fixed: the same points give the same orientation
        return np.array([rng.choice(n, 3, replace=False) for _ in range(_SAMPLED_TRIPLES)])
    # Of many points the outermost in eight directions are enough.
    angles = np.arange(8) * (math.pi / 4.0)
    outermost = (image @ np.stack([np.cos(angles), np.sin(angles)])).argmax(axis=0)
    chosen = np.arange(n) if n <= 9 else np.unique(outermost)
    triples = np.array(list(itertools.combinations(chosen.tolist(), 3)), dtype=np.int64).reshape(-1, 3)
    if robust:
        return triples
    a, b = image[triples[:, 1]] - image[triples[:, 0]], image[triples[:, 2]] - image[triples[:, 0]]
    area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    return triples[np.argsort(-area, kind="stable")[:_LARGEST_TRIPLES]]


def _start(image: Array, points: Array, robust: bool) -> tuple[Array, Array]:
    """The three-point orientation with the smallest median residual over all points."""
    n = len(points)
    directions = np.column_stack([image, -np.ones(n)])
    best, best_misfit = None, math.inf
    for rows in _triples(image, robust):
        for centre, rotation in resect_three_points(directions[rows], points[rows]):
            computed = photo_from_camera(camera_from_object(points, centre, rotation), 1.0)
            misfit = np.nan_to_num(np.linalg.norm(image - computed, axis=1), nan=1e6)
            # Three points always fit: the median is over the others.
            score = float(np.median(np.delete(misfit, rows))) if n > 3 else float(misfit.sum())
            if score < best_misfit:
                best, best_misfit = (centre, rotation), score
    if best is None:
        raise NotDeterminedError(
            "no orientation fits three of the control points: they are on a line or wrong"
        )
    return best


def resect(
    image: ArrayLike,
    points: ArrayLike,
    *,
    principal_distance: float = 1.0,
    sigma: ArrayLike = 1.0,
    start: tuple[ArrayLike, ArrayLike] | None = None,
    options: AdjustmentOptions | None = None,
) -> Resection:
    """Exterior orientation by least squares of the image residuals.

    Parameters
    ----------
    image : array_like, shape (n, 2)
        Ideal image coordinates, reduced to the principal point, in units of `principal_distance`.
    points : array_like, shape (n, 3)
        Control points in a Cartesian frame.
    principal_distance : float
    sigma : array_like, broadcast to (n, 2)
        A priori standard deviations of the image coordinates.
    start : (centre, object_from_camera), optional
        Approximate orientation; found from triples of points otherwise.
    options : AdjustmentOptions, optional
        ``loss="huber"`` weights gross errors down.

    Raises
    ------
    InputError
        If the arrays do not go together.
    NotDeterminedError
        If the points do not determine the orientation (fewer than three, on a line, the danger cylinder), or
        if four of three points' orientations cannot be told apart (three points without a start).
    """
    image, points = np.asarray(image, dtype=np.float64), np.asarray(points, dtype=np.float64)
    n = len(points)
    if points.shape != (n, 3) or image.shape != (n, 2):
        raise InputError(
            "must have shapes (n, 2) and (n, 3)", field="image and points", value=(image.shape, points.shape)
        )
    if not (np.isfinite(image).all() and np.isfinite(points).all()):
        raise InputError("must be finite", field="image and points")
    if not principal_distance > 0.0:
        raise InputError("must be positive", field="principal_distance", value=principal_distance)
    if n < 3 or (n == 3 and start is None):
        raise NotDeterminedError(f"a resection needs 4 points, or 3 and a start, got {n}")
    deviations = np.broadcast_to(np.asarray(sigma, dtype=np.float64), (n, 2)).reshape(-1)
    origin = points.mean(axis=0)
    local = points - origin
    if start is None:
        first = _start(image / principal_distance, local, options is not None and options.loss == "huber")
    else:
        first = (np.asarray(start[0], dtype=np.float64) - origin, np.asarray(start[1], dtype=np.float64))
    observed = image.reshape(-1)

    def linearise(state: tuple[Array, Array]) -> tuple[Array, Array]:
        computed, _, by_centre, by_rotation = photo_jacobians(local, *state, principal_distance)
        design = np.concatenate([by_centre, by_rotation], axis=2).reshape(2 * n, 6)
        return observed - computed.reshape(-1), design

    def update(state: tuple[Array, Array], step: Array) -> tuple[Array, Array]:
        return state[0] + step[:3], rotation_from_vector(step[3:]) @ state[1]

    (centre, rotation), summary = adjust(linearise, update, first, deviations, options)
    return Resection(centre + origin, rotation, summary.residuals.reshape(n, 2), summary)
