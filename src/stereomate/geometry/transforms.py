"""Transforms as values: similarity, affine and projective in the plane, rigid and similarity in space.

Least squares minimises residuals in the target system: observed - computed, target coordinates observed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import InputError, NotDeterminedError
from stereomate.geometry.adjustment import AdjustmentOptions, AdjustmentSummary, adjust

Array = NDArray[np.float64]
PlaneKind = Literal["similarity", "affine", "projective"]
Matrix3 = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]

_PARAMETERS = {"similarity": 4, "affine": 6, "projective": 8}


def nested3(matrix: Array) -> Matrix3:
    a, b, c = (tuple(float(v) for v in row) for row in matrix)
    return ((a[0], a[1], a[2]), (b[0], b[1], b[2]), (c[0], c[1], c[2]))


@dataclass(frozen=True)
class PlaneTransform:
    """``target ~ M (x, y, 1)``: a similarity, affine or projective transform of the plane.

    Parameters
    ----------
    kind : {"similarity", "affine", "projective"}
    matrix : 3x3 nested tuples
        Homogeneous, last element 1; last row (0, 0, 1) unless projective.
    """

    kind: PlaneKind
    matrix: Matrix3

    def __post_init__(self) -> None:
        if self.kind not in get_args(PlaneKind):
            raise InputError("must be similarity, affine or projective", field="kind", value=self.kind)
        m = np.asarray(self.matrix, dtype=np.float64)
        if m.shape != (3, 3) or not np.isfinite(m).all():
            raise InputError("must be 3x3 finite numbers", field="matrix", value=self.matrix)
        if self.kind != "projective" and self.matrix[2] != (0.0, 0.0, 1.0):
            raise InputError("must end in the row (0, 0, 1)", field="matrix", value=self.matrix[2])
        if not np.linalg.cond(m / np.abs(m).max()) < 1e14:
            raise InputError("must be invertible", field="matrix", value=self.matrix)

    @classmethod
    def from_array(cls, kind: PlaneKind, matrix: ArrayLike) -> PlaneTransform:
        """From a (2, 3) or (3, 3) array, scaled to a last element of 1."""
        m = np.asarray(matrix, dtype=np.float64)
        if m.shape == (2, 3):
            m = np.vstack([m, [0.0, 0.0, 1.0]])
        if m.shape != (3, 3) or m[2, 2] == 0.0:
            raise InputError("must be 2x3 or 3x3 with a last element that is not 0", field="matrix")
        return cls(kind, nested3(m / m[2, 2]))

    def apply(self, points: ArrayLike) -> Array:
        """Transform points (..., 2)."""
        m = np.array(self.matrix)
        points = np.asarray(points, dtype=np.float64)
        top: Array = points @ m[:2, :2].T + m[:2, 2]
        if self.kind != "projective":
            return top
        result: Array = top / (points @ m[2, :2] + 1.0)[..., None]
        return result

    def inverse(self) -> PlaneTransform:
        """The transform back."""
        m = np.array(self.matrix)
        if self.kind == "projective":
            return PlaneTransform.from_array("projective", np.linalg.inv(m))
        linear = np.linalg.inv(m[:2, :2])
        return PlaneTransform.from_array(self.kind, np.column_stack([linear, -linear @ m[:2, 2]]))

    def compose(self, first: PlaneTransform) -> PlaneTransform:
        """``self.compose(first)`` applies `first`, then `self`."""
        kinds = get_args(PlaneKind)
        kind: PlaneKind = kinds[max(kinds.index(self.kind), kinds.index(first.kind))]
        return PlaneTransform.from_array(kind, np.array(self.matrix) @ np.array(first.matrix))

    @property
    def affine(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """The upper two rows; of a projective transform only its part at the origin's side."""
        return self.matrix[0], self.matrix[1]

    @property
    def scales(self) -> tuple[float, float]:
        """Scale of the x and of the y axis."""
        (a, b, _), (c, d, _) = self.affine
        return math.hypot(a, c), math.hypot(b, d)

    @property
    def rotation(self) -> float:
        """Direction of the transformed x axis, radians."""
        (a, _, _), (c, _, _) = self.affine
        return math.atan2(c, a)

    @property
    def non_orthogonality(self) -> float:
        """Rotation of the x axis minus rotation of the y axis, radians; about ±pi for a mirroring."""
        (_, b, _), (_, d, _) = self.affine
        difference = self.rotation - math.atan2(-b, d)
        return math.atan2(math.sin(difference), math.cos(difference))

    @property
    def mirrored(self) -> bool:
        """Whether the transform turns the plane over."""
        (a, b, _), (c, d, _) = self.affine
        return a * d - b * c < 0.0


@dataclass(frozen=True)
class PlaneEstimate:
    """An estimated plane transform with its statistics.

    Attributes
    ----------
    transform : PlaneTransform
    residuals : ndarray, shape (n, 2)
        Observed minus computed, target units.
    rms : (float, float)
        Root mean square residual in x and y.
    summary : AdjustmentSummary
        Over the observations x1, y1, x2, y2, …; parameters row by row of the matrix: (a, b, tx, ty) of a
        similarity, (a, b, tx, c, d, ty) of an affine, with (g, h) at the end of a projective transform.
    """

    transform: PlaneTransform
    residuals: Array
    rms: tuple[float, float]
    summary: AdjustmentSummary


def _plane_design(kind: PlaneKind, source: Array, parameters: Array) -> tuple[Array, Array]:
    """Computed target coordinates (2n,) and d computed / d parameters (2n, u)."""
    x, y = source.T
    zero, one = np.zeros_like(x), np.ones_like(x)
    if kind == "similarity":
        rows = np.stack([np.stack([x, -y, one, zero], -1), np.stack([y, x, zero, one], -1)], axis=1)
    else:
        first = np.stack([x, y, one, zero, zero, zero], -1)
        rows = np.stack([first, np.roll(first, 3, axis=1)], axis=1)
    linear = rows.reshape(2 * len(x), -1)
    computed = linear @ parameters[: linear.shape[1]]
    if kind != "projective":
        return computed, linear
    w = np.repeat(1.0 + source @ parameters[6:8], 2)
    computed = computed / w
    perspective = -computed[:, None] * np.repeat(source, 2, axis=0)
    return computed, np.column_stack([linear, perspective]) / w[:, None]


def _plane_matrix(kind: PlaneKind, p: Any) -> Any:
    if kind == "similarity":
        return np.array([[p[0], -p[1], p[2]], [p[1], p[0], p[3]], [0.0, 0.0, 1.0]])
    g, h = (p[6], p[7]) if kind == "projective" else (0.0, 0.0)
    return np.array([[p[0], p[1], p[2]], [p[3], p[4], p[5]], [g, h, 1.0]])


def estimate_plane_transform(
    kind: PlaneKind,
    source: ArrayLike,
    target: ArrayLike,
    sigma: ArrayLike = 1.0,
    options: AdjustmentOptions | None = None,
) -> PlaneEstimate:
    """Least-squares transform of the plane from common points.

    Parameters
    ----------
    kind : {"similarity", "affine", "projective"}
    source, target : array_like, shape (n, 2)
    sigma : array_like, broadcast to (n, 2)
        A priori standard deviations of the target coordinates.
    options : AdjustmentOptions, optional

    Raises
    ------
    InputError
        If the points do not go together.
    NotDeterminedError
        If there are too few points or they lie on a line.
    """
    source, target = point_pairs(source, target, 2)
    if kind not in _PARAMETERS:
        raise InputError("must be similarity, affine or projective", field="kind", value=kind)
    u = _PARAMETERS[kind]
    if 2 * len(source) < u:
        raise NotDeterminedError(f"a {kind} transform needs {u // 2} points, got {len(source)}")
    deviations = np.broadcast_to(np.asarray(sigma, dtype=np.float64), source.shape).reshape(-1)
    if not (deviations > 0.0).all():
        raise InputError("must be positive", field="sigma")
    # About the centroid and in units of the extent: the normal matrix is as good as the geometry.
    centre, extent = source.mean(axis=0), float(np.ptp(source, axis=0).max()) or 1.0
    reduced = (source - centre) / extent
    observed = target.reshape(-1)

    def linearise(parameters: Array) -> tuple[Array, Array]:
        computed, design = _plane_design(kind, reduced, parameters)
        return observed - computed, design

    start = _algebraic(kind, reduced, observed)
    parameters, summary = adjust(linearise, lambda p, step: p + step, start, deviations, options)
    reduction = np.array(
        [[1 / extent, 0, -centre[0] / extent], [0, 1 / extent, -centre[1] / extent], [0, 0, 1]]
    )
    transform = PlaneTransform.from_array(kind, _plane_matrix(kind, parameters) @ reduction)
    jacobian = _given_jacobian(kind, parameters, reduction)
    summary = replace(summary, cofactor=jacobian @ summary.cofactor @ jacobian.T)
    residuals = summary.residuals.reshape(-1, 2)
    rms = np.sqrt(np.mean(residuals**2, axis=0))
    return PlaneEstimate(transform, residuals, (float(rms[0]), float(rms[1])), summary)


def _algebraic(kind: PlaneKind, source: Array, observed: Array) -> Array:
    """One linear solution; of a projective transform with the equations multiplied by their denominators."""
    u = _PARAMETERS[kind]
    _, design = _plane_design(kind, source, np.zeros(u))
    if kind == "projective":
        design[:, 6:] = -observed[:, None] * np.repeat(source, 2, axis=0)
    scale = np.abs(design).max(axis=0)
    scale[scale == 0.0] = 1.0
    solution: Array = np.linalg.lstsq(design / scale, observed, rcond=None)[0] / scale
    return solution


def algebraic_projective(source: ArrayLike, target: ArrayLike) -> PlaneTransform:
    """Projective transform by one linear solution of the equations multiplied by their denominators.

    What textbooks compute by hand. It does not minimise the residuals in the target, which
    `estimate_plane_transform` does; for fiducial marks of film the two agree to some nanometres.
    """
    source, target = point_pairs(source, target, 2)
    if len(source) < 4:
        raise NotDeterminedError(f"a projective transform needs 4 points, got {len(source)}")
    parameters = _algebraic("projective", source, target.reshape(-1))
    return PlaneTransform.from_array("projective", _plane_matrix("projective", parameters))


def _given_jacobian(kind: PlaneKind, parameters: Array, reduction: Array) -> Array:
    """d (parameters of unreduced coordinates) / d (reduced), by complex steps: exact to rounding."""
    u = len(parameters)
    result = np.empty((u, u))
    for i in range(u):
        stepped = parameters.astype(np.complex128)
        stepped[i] += 1e-30j
        matrix = _plane_matrix(kind, stepped) @ reduction
        matrix = matrix / matrix[2, 2]
        if kind == "similarity":
            given = np.array([matrix[0, 0], matrix[1, 0], matrix[0, 2], matrix[1, 2]])
        else:
            given = matrix.reshape(-1)[:u]
        result[:, i] = np.imag(given) / 1e-30
    return result


def point_pairs(source: ArrayLike, target: ArrayLike, dimension: int) -> tuple[Array, Array]:
    """Both point sets as finite arrays of one shape."""
    source = np.asarray(source, dtype=np.float64)
    target = np.asarray(target, dtype=np.float64)
    if source.ndim != 2 or source.shape[1] != dimension or source.shape != target.shape:
        raise InputError(
            f"must be two arrays of shape (n, {dimension})",
            field="source and target",
            value=(source.shape, target.shape),
        )
    for name, points in (("source", source), ("target", target)):
        if not np.isfinite(points).all():
            raise InputError("must be finite", field=name)
    return source, target
