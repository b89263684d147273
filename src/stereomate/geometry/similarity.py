"""Rigid and seven-parameter similarity transforms in space."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import InputError, NotDeterminedError
from stereomate.geometry.adjustment import AdjustmentOptions, AdjustmentSummary, adjust
from stereomate.geometry.rotations import rotation_from_vector, skew
from stereomate.geometry.transforms import Array, Matrix3, nested3, point_pairs

# Triples of points that a robust start is chosen from, and rows that are transformed at a time.
_TRIPLES = 500
_ROWS = 100_000

__all__ = ["SimilarityEstimate", "SpaceTransform", "estimate_space_transform"]


@dataclass(frozen=True)
class SpaceTransform:
    """``target = scale * rotation @ source + translation``; rigid when the scale is 1.

    Parameters
    ----------
    rotation : 3x3 nested tuples
        Orthogonal with determinant 1.
    translation : (float, float, float)
    scale : float
        Positive.
    """

    rotation: Matrix3
    translation: tuple[float, float, float]
    scale: float = 1.0

    def __post_init__(self) -> None:
        r = np.asarray(self.rotation, dtype=np.float64)
        if r.shape != (3, 3) or not np.allclose(r @ r.T, np.eye(3), atol=1e-8) or np.linalg.det(r) < 0.0:
            raise InputError("must be a rotation matrix", field="rotation", value=self.rotation)
        if np.shape(self.translation) != (3,) or not np.isfinite(self.translation).all():
            raise InputError("must be three finite numbers", field="translation", value=self.translation)
        if not (math.isfinite(self.scale) and self.scale > 0.0):
            raise InputError("must be positive", field="scale", value=self.scale)

    @classmethod
    def from_arrays(cls, rotation: ArrayLike, translation: ArrayLike, scale: float = 1.0) -> SpaceTransform:
        """From arrays (3, 3) and (3,)."""
        t = np.asarray(translation, dtype=np.float64)
        r = nested3(np.asarray(rotation, dtype=np.float64))
        return cls(r, (float(t[0]), float(t[1]), float(t[2])), float(scale))

    def apply(self, points: ArrayLike) -> Array:
        """Transform points (..., 3)."""
        turned = np.asarray(points, dtype=np.float64) @ np.array(self.rotation).T
        result: Array = self.scale * turned + np.array(self.translation)
        return result

    def inverse(self) -> SpaceTransform:
        """The transform back."""
        r = np.array(self.rotation).T
        return SpaceTransform.from_arrays(r, -(r @ self.translation) / self.scale, 1.0 / self.scale)

    def compose(self, first: SpaceTransform) -> SpaceTransform:
        """``self.compose(first)`` applies `first`, then `self`."""
        rotation = np.array(self.rotation) @ np.array(first.rotation)
        return SpaceTransform.from_arrays(rotation, self.apply(first.translation), self.scale * first.scale)


@dataclass(frozen=True)
class SimilarityEstimate:
    """An estimated transform in space with its statistics.

    Attributes
    ----------
    transform : SpaceTransform
    residuals : ndarray, shape (n, 3)
        Observed minus computed target coordinates.
    rms : (float, float, float)
    summary : AdjustmentSummary
        Parameters: translation of the centroid of the source points (3), left rotation about the axes of
        the target (3, radians), and, unless rigid, the logarithm of the scale.
    """

    transform: SpaceTransform
    residuals: Array
    rms: tuple[float, float, float]
    summary: AdjustmentSummary


def closed_form(source: Array, target: Array, rigid: bool, weights: NDArray[np.float64]) -> SpaceTransform:
    """Weighted closed solution by singular values (Umeyama 1991); weights per point (n,)."""
    return SpaceTransform.from_arrays(*similarity_arrays(source, target, rigid, weights))


def similarity_arrays(
    source: Array, target: Array, rigid: bool, weights: NDArray[np.float64]
) -> tuple[Array, Array, float]:
    """As `closed_form`: rotation (3, 3), translation (3,) and scale."""
    w = weights / weights.sum()
    mean_source, mean_target = w @ source, w @ target
    a, b = source - mean_source, target - mean_target
    u, singular, vt = np.linalg.svd((w[:, None] * b).T @ a)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = (u * sign) @ vt
    spread = float(w @ np.sum(a * a, axis=1))
    scale = 1.0 if rigid else float(singular @ sign) / spread
    return rotation, mean_target - scale * (rotation @ mean_source), scale


def estimate_space_transform(
    source: ArrayLike,
    target: ArrayLike,
    *,
    rigid: bool = False,
    sigma: ArrayLike = 1.0,
    options: AdjustmentOptions | None = None,
) -> SimilarityEstimate:
    """Least-squares rigid (6) or similarity (7 parameters) transform from common points.

    Parameters
    ----------
    source, target : array_like, shape (n, 3)
    rigid : bool
        Keep the scale at 1.
    sigma : array_like, broadcast to (n, 3)
        A priori standard deviations of the target coordinates, per point and axis.
    options : AdjustmentOptions, optional
        ``loss="huber"`` weights gross errors down; the start is then the best of many point triples.

    Raises
    ------
    InputError
        If the points do not go together.
    NotDeterminedError
        If there are fewer than three points or they lie on a line.
    """
    source, target = point_pairs(source, target, 3)
    options = options or AdjustmentOptions()
    n = len(source)
    if n < 3:
        raise NotDeterminedError(f"a transform in space needs 3 points, got {n}")
    deviations = np.broadcast_to(np.asarray(sigma, dtype=np.float64), source.shape)
    if not (deviations > 0.0).all():
        raise InputError("must be positive", field="sigma")
    centred = source - source.mean(axis=0)
    singular = np.linalg.svd(centred, compute_uv=False)
    if singular[1] <= 1e-9 * singular[0]:
        raise NotDeterminedError("the points of a transform in space lie on a line")
    if options.loss == "huber" and n > 3:
        start = _best_triple(source, target, rigid, deviations)
    else:
        start = closed_form(source, target, rigid, 1.0 / np.mean(deviations**2, axis=1))
    centre = source.mean(axis=0)

    def linearise(state: tuple[Array, Array, float]) -> tuple[Array, Array]:
        rotation, shift, scale = state
        turned = scale * (centred @ rotation.T)
        design = np.zeros((n, 3, 6 if rigid else 7))
        design[:, :, :3] = np.eye(3)
        design[:, :, 3:6] = -skew(turned)
        if not rigid:
            design[:, :, 6] = turned
        return (target - turned - shift).reshape(-1), design.reshape(3 * n, -1)

    def update(state: tuple[Array, Array, float], step: Array) -> tuple[Array, Array, float]:
        rotation, shift, scale = state
        factor = 1.0 if rigid else math.exp(step[6])
        return rotation_from_vector(step[3:6]) @ rotation, shift + step[:3], scale * factor

    first = (np.array(start.rotation), start.apply(centre), start.scale)
    (rotation, shift, scale), summary = adjust(linearise, update, first, deviations.reshape(-1), options)
    transform = SpaceTransform.from_arrays(rotation, shift - scale * (rotation @ centre), scale)
    residuals = summary.residuals.reshape(n, 3)
    x, y, z = np.sqrt(np.mean(residuals**2, axis=0))
    return SimilarityEstimate(transform, residuals, (float(x), float(y), float(z)), summary)


def _best_triple(source: Array, target: Array, rigid: bool, deviations: Array) -> SpaceTransform:
    """Closed solution of the three points with the smallest median residual over all points."""
    rng = np.random.default_rng(0)  # fixed: the same points give the same transform
    n = len(source)
    triples = np.array([rng.choice(n, 3, replace=False) for _ in range(_TRIPLES)])
    start = closed_form(source, target, rigid, np.ones(n))
    best, best_median = start, math.inf
    for chosen in np.array_split(triples, -(-_TRIPLES * n // _ROWS)):
        rotations, shifts, scales, good = _closed_forms(source[chosen], target[chosen], rigid)
        moved = scales[:, None, None] * (source @ np.swapaxes(rotations, 1, 2)) + shifts[:, None, :]
        misfit = np.linalg.norm((target - moved) / deviations, axis=2)
        median = np.where(good, np.median(misfit, axis=1), math.inf)
        k = int(median.argmin())
        if median[k] < best_median:
            best = SpaceTransform.from_arrays(rotations[k], shifts[k], float(scales[k]))
            best_median = float(median[k])
    return best


def _closed_forms(source: Array, target: Array, rigid: bool) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """`closed_form` of many triples (m, 3, 3) at once; those that lie on a line or mismatch are not good."""
    mean_source, mean_target = source.mean(axis=1), target.mean(axis=1)
    a, b = source - mean_source[:, None, :], target - mean_target[:, None, :]
    extent = np.linalg.svd(a, compute_uv=False)
    u, singular, vt = np.linalg.svd(np.swapaxes(b, 1, 2) @ a)
    signs = np.ones((len(a), 3))
    signs[:, 2] = np.sign(np.linalg.det(u @ vt))
    rotations = (u * signs[:, None, :]) @ vt
    good = extent[:, 1] > 1e-3 * extent[:, 0]
    scales = np.ones(len(a))
    if not rigid:
        spread = np.sum(a * a, axis=(1, 2))
        scales = np.sum(singular * signs, axis=1) / np.where(good, spread, 1.0)
        good &= scales > 0.0
    shifts = mean_target - scales[:, None] * (rotations @ mean_source[:, :, None])[..., 0]
    return rotations, shifts, scales, good
