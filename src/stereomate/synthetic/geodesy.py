"""From the tangent frame to the map as one polynomial over the block, with its error stated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import CrsError
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import tangent_from_map
from stereomate.synthetic.kernels.curve import DEGREE, EXPONENTS

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MapPolynomial:
    """Local map coordinates (east, north of an origin, ellipsoidal height) of tangent-frame points.

    The map is reached over a polynomial of degree 3 or 4 in the tangent coordinates, fitted to the rigorous
    transformation. It is another way than the lattice by which products are rectified, so that an error
    of one does not hide in the other.

    Attributes
    ----------
    origin : ndarray (3,)
        Map position of local (0, 0); its height is 0.
    exponents : ndarray of int (20 or 35, 3)
        Exponents (i, j, k) of each term.
    terms : ndarray (20 or 35, 3)
        Coefficients for tangent coordinates divided by ``scale``.
    scale : float
        Metres.
    error_m : float
        Largest difference to the rigorous transformation at points between those of the fit.
    """

    origin: Array
    exponents: NDArray[np.int64]
    terms: Array
    scale: float
    error_m: float

    def __call__(self, tangent_points: ArrayLike) -> Array:
        """Local map coordinates (..., 3) of tangent points (..., 3)."""
        points = np.asarray(tangent_points, dtype=np.float64) / self.scale
        result: Array = _monomials(points, self.exponents) @ self.terms
        return result


def _monomials(points: Array, exponents: NDArray[np.int64]) -> Array:
    powers = points[..., None, :] ** np.arange(DEGREE + 1)[:, None]  # (..., degree, axis)
    axes = np.arange(3)
    monomials: Array = powers[..., exponents, axes].prod(axis=-1)
    return monomials


def fit_map_polynomial(
    frame: MapFrame, tangent: TangentFrame, lowest: ArrayLike, highest: ArrayLike, allowed_m: float = 1e-6
) -> MapPolynomial:
    """Fit the polynomial over a box of map coordinates and heights.

    Parameters
    ----------
    lowest, highest : array_like (3,)
        Opposite corners of the box: easting, northing, ellipsoidal height.

    Raises
    ------
    CrsError
        If the box is so large that the polynomial misses ``allowed_m``.
    """
    lowest, highest = np.asarray(lowest, dtype=np.float64), np.asarray(highest, dtype=np.float64)
    origin = np.array([lowest[0], highest[1], 0.0])

    def nodes(count: int) -> Array:
        unit = 0.5 - 0.5 * np.cos(np.pi * (np.arange(count) + 0.5) / count)
        grid = np.stack(np.meshgrid(unit, unit, unit, indexing="ij"), axis=-1).reshape(-1, 3)
        result: Array = lowest + grid * (highest - lowest)
        return result

    fitted, between = nodes(9), nodes(8)
    points = tangent_from_map(tangent, frame, fitted)
    scale = float(np.abs(points).max())
    checked = tangent_from_map(tangent, frame, between) / scale

    def fit(degree: int) -> MapPolynomial:
        exponents = np.ascontiguousarray(EXPONENTS[EXPONENTS.sum(axis=1) <= degree])
        terms = np.linalg.lstsq(_monomials(points / scale, exponents), fitted - origin, rcond=None)[0]
        error = float(np.abs(_monomials(checked, exponents) @ terms - (between - origin)).max())
        return MapPolynomial(origin, exponents, np.ascontiguousarray(terms), scale, error)

    polynomial = fit(DEGREE - 1)
    if not polynomial.error_m <= 0.1 * allowed_m:
        polynomial = fit(DEGREE)
    if not polynomial.error_m <= allowed_m:
        raise CrsError(
            f"the block is too large for one synthetic world: its map polynomial misses {allowed_m} m",
            field="crs",
            value=polynomial.error_m,
            hint="fewer strips or photographs, or a lower flight",
        )
    return polynomial
