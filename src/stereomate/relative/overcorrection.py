"""The over-correction factor of relative orientation on any terrain (Kasper 1956, eqs. 1-10).

A *section* is the cross-section of a model perpendicular to its base: three points with y across the strip
and z the depth below the projection centre, down, both in metres. To first order in the orientation elements
the y-parallax at a point of the section is

    p = A + K dω + t C        with t = y/z, K = (y² + z²)/z

(A: by and κ, C: bz and φ, dω: lateral tilt). von Gruber's procedure removes p at two of the points with the
elements in A and C, and what then remains at the third, p*, with the tilt alone. That takes dω* = p*/K; the
tilt really wrong is dω = n dω*. n does not exist when O and the three points lie on one circle, because
there K is linear in t: the critical circle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import InputError
from stereomate.relative.kernels import overcorrection as kernels

FloatArray = NDArray[np.float64]

# Row of a section by the number of its point.
_ROW: Final = {1: 0, 3: 1, 5: 2, 2: 0, 4: 1, 6: 2}


def overcorrection_factor(section: ArrayLike, corrected: int = 5) -> Any:
    """Over-correction factor n of one or many cross-sections, exactly, for any three points.

    Parameters
    ----------
    section : array_like, shape (..., 3, 2)
        Rows are the points 1, 3, 5 (or 2, 4, 6 of the section under the other projector), columns y and z in
        metres from the projection centre, z down and positive. Point 1 need not be at the nadir.
    corrected : {5, 3, 1, 6, 4, 2}
        Number of the point at which the tilt is over-corrected; at the other two of its section the
        y-parallax has been removed with the other motions, whichever they were.

    Returns
    -------
    float or ndarray, shape (...)
        n; ±inf where the three points lie on the critical circle (to rounding; the sign then means nothing);
        nan where the two other points lie on one ray, so that their y-parallaxes cannot both be removed.

    Raises
    ------
    InputError
        If the shape is not (..., 3, 2), a value is not finite, or a point is not below the projection centre.

    Notes
    -----
    Kasper (1956), eq. (8), in its general form
    ``n = K5 / [(K5 - K1) - (t5 - t1)(K3 - K1)/(t3 - t1)]``.
    """
    sections, leading = _checked(section)
    row = _row(corrected)
    return _shaped(_factors(sections, row), leading)


def overcorrection_factors(section: ArrayLike) -> FloatArray:
    """Over-correction factors with each point of the section in turn as the one that is over-corrected.

    Parameters
    ----------
    section : array_like, shape (..., 3, 2)
        As for `overcorrection_factor`.

    Returns
    -------
    ndarray, shape (..., 3)
        n at the first, second and third point (1, 3, 5 or 2, 4, 6).
    """
    sections, leading = _checked(section)
    return np.stack([_factors(sections, row) for row in range(3)], axis=-1).reshape(*leading, 3)


def flat_overcorrection_factor(principal_distance: ArrayLike, ordinate: ArrayLike) -> Any:
    """Over-correction factor of flat terrain and symmetric points, n = ½ (1 + f²/y²) (eq. 1).

    Parameters
    ----------
    principal_distance, ordinate : array_like
        Principal distance and image ordinate of point 5 in one unit (or z and y in the model).

    Raises
    ------
    InputError
        If the ordinate is zero, the principal distance not positive, or a value not finite.
    """
    f, y = np.broadcast_arrays(np.asarray(principal_distance, float), np.asarray(ordinate, float))
    if not (np.isfinite(f).all() and (f > 0).all()):
        raise InputError("must be finite and positive", field="principal_distance", value=f.tolist())
    if not (np.isfinite(y).all() and (y != 0).all()):
        raise InputError("must be finite and not zero", field="ordinate", value=y.tolist())
    return _shaped(0.5 * (1.0 + (f / y) ** 2).reshape(-1), f.shape)


def corrected_overcorrection_factor(factor: float, first: float, second: float) -> float:
    """Factor for the next pass from what the last one left, n' = n p*/(p* - Δp*) (eq. 2).

    Parameters
    ----------
    factor : float
        n that was applied.
    first, second : float
        y-parallax at point 5 (the four others cleared) before it was applied, and when the whole procedure
        has been repeated.

    Returns
    -------
    float
        n'; inf if the first pass changed nothing, which is the mark of the critical circle.

    Raises
    ------
    InputError
        If a value is not finite, or `first` is zero: then there was nothing to correct.
    """
    for name, value in (("factor", factor), ("first", first), ("second", second)):
        if not np.isfinite(value):
            raise InputError("must be finite", field=name, value=value)
    if first == 0.0:
        raise InputError("must not be zero: no y-parallax was corrected", field="first", value=first)
    removed = first - second
    return float(np.inf if removed == 0.0 else factor * first / removed)


def tilt_from_parallaxes(section: ArrayLike, parallaxes: ArrayLike) -> Any:
    """Lateral tilt dω directly from the y-parallaxes at three points of a section (eq. 4).

    Parameters
    ----------
    section : array_like, shape (..., 3, 2)
        As for `overcorrection_factor`.
    parallaxes : array_like, shape (..., 3)
        y-parallaxes at its points in metres in the model, in the sign of eq. (3): the parallax that the error
        dω causes at the nadir is +z dω.

    Returns
    -------
    float or ndarray, shape (...)
        dω in radians, to first order; nan where the section does not determine it (critical circle).
    """
    coefficients = tilt_coefficients(section)
    given = np.asarray(parallaxes, dtype=np.float64)
    if given.ndim < 1 or given.shape[-1] != 3:
        raise InputError("must have shape (..., 3)", field="parallaxes", value=given.shape)
    if not np.isfinite(given).all():
        raise InputError("must be finite", field="parallaxes", value=given.tolist())
    tilt = np.asarray((coefficients * given).sum(axis=-1))
    return _shaped(tilt.reshape(-1), tilt.shape)


def tilt_coefficients(section: ArrayLike) -> FloatArray:
    """Coefficients c of dω = Σ c p (eq. 4) for one or many sections; n at a point is its c times its K.

    Returns
    -------
    ndarray, shape (..., 3)
        Radians per metre of y-parallax; nan on the critical circle. Two points on one ray but not in one
        place do determine the tilt, though none of them has an over-correction factor to be found with.
    """
    sections, leading = _checked(section)
    terms = _terms(sections)
    critical = terms.curvature == 0.0
    coefficients = terms.weights / np.where(critical, np.nan, terms.curvature)
    return coefficients.T.reshape(*leading, 3)


def tilt_standard_deviation(section: ArrayLike, parallax_std: ArrayLike = 1.0) -> Any:
    """Standard deviation of dω (eq. 4) from independent errors of the three y-parallaxes.

    Parameters
    ----------
    section : array_like, shape (..., 3, 2)
        As for `overcorrection_factor`.
    parallax_std : array_like, broadcast against (..., 3)
        Standard deviation of the y-parallaxes in metres in the model; 1 gives radians per metre. A
        parallax measured in the image with s has s z/f in the model.

    Returns
    -------
    float or ndarray, shape (...)
        Radians; inf on the critical circle.
    """
    std = np.asarray(parallax_std, dtype=np.float64)
    if not (np.isfinite(std).all() and (std >= 0).all()):
        raise InputError("must be finite and not negative", field="parallax_std", value=std.tolist())
    coefficients = tilt_coefficients(section)
    spread = np.sqrt(((coefficients * std) ** 2).sum(axis=-1))
    spread = np.where(np.isnan(spread), np.inf, spread)
    return _shaped(spread.reshape(-1), spread.shape)


def factor_change_per_metre(section: ArrayLike, corrected: int = 5) -> FloatArray:
    """Change of n per metre of height error at each point of the section, its y held.

    Parameters
    ----------
    section, corrected
        As for `overcorrection_factor`.

    Returns
    -------
    ndarray, shape (..., 3)
        dn/dh at the three points, h up; nan where n is not finite.
    """
    sections, leading = _checked(section)
    row = _row(corrected)
    terms = _terms(sections)
    t, k, n = terms.t, terms.k, _factors(sections, row)
    # n = K w / Σ w K: the derivatives by K at each point and, through the weights w, by t.
    with np.errstate(divide="ignore", invalid="ignore"):
        by_k = -n * terms.weights
        by_k[row] += terms.weights[row]
        by_t = n * _cyclic_difference(k)
        by_t[(row + 2) % 3] += k[row]
        by_t[(row + 1) % 3] -= k[row]
        # h = -z: one metre of z changes K by 1 - t² and t by -t/z.
        change = -(by_k * (1.0 - t * t) - by_t * t / sections[:, :, 1].T) / terms.curvature
    change[:, ~np.isfinite(n)] = np.nan
    return change.T.reshape(*leading, 3)


@dataclass(frozen=True)
class _Terms:
    """What every formula of sections (N, 3, 2) is made of; arrays (3, N) but the last, (N,)."""

    t: FloatArray
    k: FloatArray
    weights: FloatArray  # w of the second difference over t: Σ w = 0, Σ w t = 0
    curvature: FloatArray  # Σ w K: zero, to rounding set to exactly zero, on the critical circle


def _checked(section: ArrayLike) -> tuple[FloatArray, tuple[int, ...]]:
    """Sections as an array (N, 3, 2), and the leading axes they came with."""
    try:
        array = np.asarray(section, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError("must be numbers of shape (..., 3, 2)", field="section", value=section) from None
    if array.ndim < 2 or array.shape[-2:] != (3, 2):
        raise InputError(
            "must have shape (..., 3, 2): points 1, 3, 5 by y, z", field="section", value=array.shape
        )
    return array.reshape(-1, 3, 2), array.shape[:-2]


def _row(corrected: int) -> int:
    if corrected not in _ROW:
        raise InputError("must be the number of a point, 1 to 6", field="corrected", value=corrected)
    return _ROW[corrected]


def _shaped(values: FloatArray, leading: tuple[int, ...]) -> Any:
    return values.reshape(leading) if leading else float(values[0])


def _cyclic_difference(values: FloatArray) -> FloatArray:
    """Second next minus next of three rows: (v5 - v3, v1 - v5, v3 - v1)."""
    return np.stack((values[2] - values[1], values[0] - values[2], values[1] - values[0]))


def _terms(sections: FloatArray) -> _Terms:
    count = len(sections)
    terms = _Terms(np.empty((3, count)), np.empty((3, count)), np.empty((3, count)), np.empty(count))
    bad = kernels.all_section_terms(sections, terms.t, terms.k, terms.weights, terms.curvature)
    _require_valid(sections, bad)
    return terms


def _factors(sections: FloatArray, row: int) -> FloatArray:
    """n (N,) with the point of `row` as the corrected one."""
    factors = np.empty(len(sections))
    bad = kernels.overcorrection_factors(sections, row, factors)
    _require_valid(sections, bad)
    return factors


def _require_valid(sections: FloatArray, bad: int) -> None:
    if bad >= 0:
        raise InputError(
            "must be finite, with every z positive (points below the projection centre)",
            field="section" if len(sections) == 1 else f"section {bad}",
            value=sections[bad].tolist(),
        )
