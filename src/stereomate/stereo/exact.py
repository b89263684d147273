"""Exact points from a stereo-orthophoto: lineage back to two rays, their intersection, and its covariance.

A position on the orthophoto is a ground point G_L; one on the stereomate, by inverting x - q(h(x)) along its
row, a ground point G_R. The rays from the two projection centres through them meet in the object, for any
law, any slope, and any terrain model as long as it is the one the product was made with. The camera is not
needed: what the photograph shows at the image of G lies on the ray through G.

The four measured coordinates carry one redundancy, the condition that the rays meet. The estimate is the
optimal one in the product: least squares of the four product coordinates, with the slope of the ground and
the inversion of the row in the derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from stereomate.geometry.intersection import intersect_two_rays
from stereomate.parallax.laws import ParallaxLaw

Floats = NDArray[np.float64]

# Newton steps of the row inversion on the rigorous surface, and of the condition that the rays meet.
_ROW_STEPS: Final = 8
_CONDITION_STEPS: Final = 5


class MeasuringSurface(Protocol):
    """The ground that a product was made with, in the axes (u, v) of the product."""

    def heights(self, uv: Floats) -> Floats:
        """(h, dh/du, dh/dv) at positions (n, 2), height system of the law; (n, 3), NaN = void."""
        ...

    def shown(self, law: ParallaxLaw, uv: Floats) -> tuple[Floats, NDArray[np.int64]]:
        """Column u of the ground that stereomate positions (n, 2) show, nearly; and how many branches."""
        ...

    def points(self, uvh: Floats) -> tuple[Floats, Floats]:
        """Points (n, 3) in the frame of the rays, and derivatives (n, 3, 3) by u, v and h as columns."""
        ...


@dataclass(frozen=True, eq=False)
class GroundPoints:
    """Ground that measured positions lie on.

    Attributes
    ----------
    uvh : ndarray (n, 3)
        Product axes and height.
    points : ndarray (n, 3)
        Frame of the rays.
    jacobian : ndarray (n, 3, 2)
        Of `points` by the two measured coordinates.
    steepness : ndarray (n,)
        dU/du = 1 - q' dh/du along the row; 1 on the orthophoto. The stereomate folds where it is 0.
    branches : ndarray of int (n,)
        How many positions of the row share the measured one.
    """

    uvh: Floats
    points: Floats
    jacobian: Floats
    steepness: Floats
    branches: NDArray[np.int64]


def ground_of_orthophoto(surface: MeasuringSurface, uv: Floats) -> GroundPoints:
    """Ground points of positions (n, 2) on the orthophoto."""
    heights = surface.heights(uv)
    uvh = np.column_stack([uv, heights[:, 0]])
    points, by = surface.points(uvh)
    jacobian = by[:, :, :2] + by[:, :, 2:] * heights[:, None, 1:]
    count = len(uv)
    return GroundPoints(uvh, points, jacobian, np.ones(count), np.ones(count, np.int64))


def ground_of_stereomate(surface: MeasuringSurface, law: ParallaxLaw, uv: Floats) -> GroundPoints:
    """Ground points of positions (n, 2) on the stereomate: the exact inverse of the row."""
    column, branches = surface.shown(law, uv)
    at = np.column_stack([column, uv[:, 1]])
    heights = surface.heights(at)
    for _ in range(_ROW_STEPS):
        excess = at[:, 0] - law.q(heights[:, 0]) - uv[:, 0]
        steepness = 1.0 - law.slope(heights[:, 0]) * heights[:, 1]
        # beside a kink of the surface Newton's step may look at the wrong side: it is never longer than 1
        with np.errstate(divide="ignore", invalid="ignore"):
            step = np.clip(np.where(np.abs(steepness) > 1e-6, excess / steepness, excess), -1.0, 1.0)
        if not (np.abs(step) > 1e-10 * (1.0 + np.abs(column))).any():
            break
        at[:, 0] -= step
        heights = surface.heights(at)
    steepness = 1.0 - law.slope(heights[:, 0]) * heights[:, 1]
    uvh = np.column_stack([at, heights[:, 0]])
    points, by = surface.points(uvh)
    along = by[:, :, :2] + by[:, :, 2:] * heights[:, None, 1:]
    # du = (dU + q' h_v dv) / (1 - q' h_u)
    with np.errstate(divide="ignore", invalid="ignore"):
        by_shown = along[:, :, 0] / steepness[:, None]
        by_row = along[:, :, 1] + by_shown * (law.slope(heights[:, 0]) * heights[:, 2])[:, None]
    return GroundPoints(uvh, points, np.stack([by_shown, by_row], axis=-1), steepness, branches)


@dataclass(frozen=True, eq=False)
class ExactPoints:
    """Intersected points with their statistics, frame of the rays; NaN where nothing is determined.

    Attributes
    ----------
    points : ndarray (n, 3)
    covariance : ndarray (n, 3, 3)
        From the noise of the four measured coordinates.
    corrections : ndarray (n, 4)
        Adjusted minus measured u_L, v_L, U_R, v_R.
    standardized : ndarray (n,)
        The one residual over its standard deviation; its square has one degree of freedom. Positive when
        v_L is measured too large.
    check : ndarray (n, 4)
        Unit vector in units of the standard deviations whose product with the measured coordinates is that
        residual.
    miss : ndarray (n,)
        Shortest distance of the two rays as measured.
    depths : ndarray (n, 2)
        Along the left and right ray in lengths of centre to ground; below 1 for an object above the ground.
    design : ndarray (n, 4, 3)
        Derivatives of the product coordinates by the point.
    """

    points: Floats
    covariance: Floats
    corrections: Floats
    standardized: Floats
    check: Floats
    miss: Floats
    depths: Floats
    design: Floats


def intersect_grounds(
    left: GroundPoints, right: GroundPoints, centres: tuple[Floats, Floats], sigma: tuple[float, ...]
) -> ExactPoints:
    """Meet the rays from two centres through the ground points of both products.

    Parameters
    ----------
    left, right : GroundPoints
    centres : (n, 3), (n, 3)
        Projection centres of the left and right photograph of each point.
    sigma : 4 floats
        Standard deviations of u_L, v_L, U_R, v_R.
    """
    variance = np.square(np.asarray(sigma, np.float64))
    base = centres[1] - centres[0]
    a, b = left.points - centres[0], right.points - centres[1]
    delta = np.zeros((len(base), 4))
    first: tuple[Floats, Floats] | None = None
    with np.errstate(divide="ignore", invalid="ignore"):
        for _ in range(_CONDITION_STEPS):
            ray_a = a + np.einsum("nij,nj->ni", left.jacobian, delta[:, :2])
            ray_b = b + np.einsum("nij,nj->ni", right.jacobian, delta[:, 2:])
            excess, by = _coplanarity(base, ray_a, ray_b, left.jacobian, right.jacobian)
            if first is None:
                first = (excess, by)
            square = np.einsum("ni,i,ni->n", by, variance, by)
            factor = (excess - np.einsum("ni,ni->n", by, delta)) / square
            delta = -variance * by * factor[:, None]
        assert first is not None
        spread = np.sqrt(np.einsum("ni,i,ni->n", first[1], variance, first[1]))
        sign = np.where(first[1][:, 1] < 0.0, -1.0, 1.0)
        check = sign[:, None] * first[1] * np.sqrt(variance)
        check /= np.linalg.norm(check, axis=1, keepdims=True)
        standardized = sign * first[0] / spread
    ray_a = a + np.einsum("nij,nj->ni", left.jacobian, delta[:, :2])
    ray_b = b + np.einsum("nij,nj->ni", right.jacobian, delta[:, 2:])
    met = intersect_two_rays(centres[0], ray_a, centres[1], ray_b)
    design = _design(left, right, (ray_a, ray_b), met.depths)
    covariance = _inverse(np.einsum("nki,k,nkj->nij", design, 1.0 / variance, design))
    miss = intersect_two_rays(centres[0], a, centres[1], b).miss_distance
    return ExactPoints(met.points, covariance, delta, standardized, check, miss, met.depths, design)


def _coplanarity(
    base: Floats, a: Floats, b: Floats, jacobian_a: Floats, jacobian_b: Floats
) -> tuple[Floats, Floats]:
    """base . (a x b), and its derivatives (n, 4) by the measured coordinates."""
    excess = np.einsum("ni,ni->n", base, np.cross(a, b))
    by_a = np.einsum("ni,nij->nj", np.cross(b, base), jacobian_a)
    by_b = np.einsum("ni,nij->nj", np.cross(base, a), jacobian_b)
    return excess, np.concatenate([by_a, by_b], axis=1)


def _design(left: GroundPoints, right: GroundPoints, rays: tuple[Floats, Floats], depths: Floats) -> Floats:
    """d(u_L, v_L, U_R, v_R) / d(point): the ground behind a point that moves, in product coordinates."""
    parts = []
    for k, (side, ray) in enumerate(zip((left, right), rays, strict=True)):
        # J dl = dA / depth + mu ray
        matrix = np.concatenate([side.jacobian, -ray[:, :, None]], axis=2)
        parts.append(_inverse(matrix)[:, :2] / depths[:, k, None, None])
    return np.concatenate(parts, axis=1)


def _inverse(matrices: Floats) -> Floats:
    """Inverses (n, 3, 3); NaN where there is none."""
    scale = np.abs(matrices).max(axis=1, keepdims=True)
    good = np.isfinite(matrices).all(axis=(1, 2)) & (scale > 0.0).all(axis=(1, 2))
    scaled = np.where(good[:, None, None], matrices / np.where(scale > 0.0, scale, 1.0), np.eye(3))
    good &= np.abs(np.linalg.det(scaled)) > 1e-14
    inverse = np.linalg.inv(np.where(good[:, None, None], scaled, np.eye(3)))
    inverse = inverse / np.where(good[:, None, None], np.swapaxes(scale, 1, 2), 1.0)
    return np.where(good[:, None, None], inverse, np.nan)


def orientation_jacobians(
    exact: ExactPoints, centres: tuple[Floats, Floats], sigma: tuple[float, ...]
) -> tuple[Floats, Floats]:
    """Change of the points by errors of the left and of the right orientation, (n, 3, 6) each.

    Columns: true minus used centre (X, Y, Z), then a small rotation theta with true R = exp(theta) R used,
    radians. For observations weighted with `sigma` as in `intersect_grounds`.
    """
    weights = 1.0 / np.square(np.asarray(sigma, np.float64))
    gain = np.einsum("nij,nkj,k->nik", exact.covariance, exact.design, weights)
    parts = []
    for k, centre in enumerate(centres):
        rows = slice(2 * k, 2 * k + 2)
        # an image of A is that of A - dO - theta x (A - O) under the orientation in use
        moved = -np.einsum("nik,nkj->nij", gain[:, :, rows], exact.design[:, rows])
        arm = exact.points - centre
        parts.append(np.concatenate([moved, -np.einsum("nij,njk->nik", moved, _cross_matrix(arm))], axis=2))
    return parts[0], parts[1]


def _cross_matrix(vectors: Floats) -> Floats:
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
