"""Radial distortion from the table of a camera certificate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.camera.distortion import BrownDistortion
from stereomate.errors import InputError, NotDeterminedError
from stereomate.geometry.adjustment import adjust

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RadialTable:
    """Polynomial through a distortion table.

    Attributes
    ----------
    coefficients : tuple of float
        k0, k1, … of ``δr = k0 r + k1 r³ + …`` (mm).
    residuals_mm : ndarray
        Table minus polynomial.
    sigma0_mm : float
        Standard deviation of a value of the table; NaN without redundancy.
    """

    coefficients: tuple[float, ...]
    residuals_mm: Array
    sigma0_mm: float

    def distortion(self, symmetry_mm: tuple[float, float] | None = None) -> BrownDistortion:
        """The model of the ``usgs`` form: measured to ideal, corrections subtracted."""
        return BrownDistortion.from_certificate(self.coefficients, symmetry_mm=symmetry_mm)


def radial_from_table(
    distortion_mm: ArrayLike,
    *,
    radii_mm: ArrayLike | None = None,
    field_angles: ArrayLike | None = None,
    principal_distance_mm: float | None = None,
    terms: int = 4,
) -> RadialTable:
    """Fit k0 … k(terms-1) to radial distortions, positive away from the centre.

    Parameters
    ----------
    distortion_mm : array_like, shape (n,)
        Displacement of the measured point away from the point of symmetry.
    radii_mm : array_like, shape (n,), optional
        Radii of the measured points; or
    field_angles : array_like, shape (n,), optional
        Angles to the axis in radians, with the calibrated `principal_distance_mm`.
    terms : int
        1 to 5.

    Raises
    ------
    InputError
        If neither or both of radii and field angles are given, or they do not fit the distortions.
    NotDeterminedError
        If the table has fewer rows than terms.
    """
    distortion = np.asarray(distortion_mm, dtype=np.float64)
    if (radii_mm is None) == (field_angles is None):
        raise InputError("must be either radii or field angles", field="radii_mm, field_angles")
    if radii_mm is not None:
        radii = np.asarray(radii_mm, dtype=np.float64)
    else:
        if principal_distance_mm is None:
            raise InputError("is needed with field angles", field="principal_distance_mm")
        radii = principal_distance_mm * np.tan(np.asarray(field_angles, dtype=np.float64)) + distortion
    if radii.shape != distortion.shape or radii.ndim != 1 or not (radii > 0.0).all():
        raise InputError("must be positive, one for each distortion", field="radii_mm", value=radii.shape)
    if not 1 <= terms <= 5:
        raise InputError("must be 1 to 5", field="terms", value=terms)
    if len(radii) < terms:
        raise NotDeterminedError(f"{len(radii)} radii do not determine {terms} coefficients")
    largest = float(radii.max())
    reduced = radii / largest
    design = np.stack([reduced ** (2 * i + 1) for i in range(terms)], axis=-1)

    def linearise(k: Array) -> tuple[Array, Array]:
        return distortion - design @ k, design

    solution, summary = adjust(linearise, lambda k, step: k + step, np.zeros(terms), np.ones(len(radii)))
    scale = largest ** -(2.0 * np.arange(terms) + 1.0)
    return RadialTable(tuple(float(v) for v in solution * scale), summary.residuals, summary.sigma0)
