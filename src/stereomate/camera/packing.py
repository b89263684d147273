"""From a camera as a value to the parameter array of the kernels.

Everything that can be folded is folded here, once: units, signs and axes of the convention, principal
distance, principal point, point of symmetry, affinity, pixel pitch and turns.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.distortion import (
    BrownDistortion,
    Distortion,
    EbnerDeformation,
    FisheyeDistortion,
    NoDistortion,
    OpenCVDistortion,
    coefficients,
)
from stereomate.camera.kernels import layout as k
from stereomate.camera.kernels.distortion import radial_inverse
from stereomate.camera.kernels.film import film_limit
from stereomate.camera.kernels.jacobian import smallest_determinant
from stereomate.errors import InputError

Affine2 = tuple[tuple[float, float, float], tuple[float, float, float]]
Array = NDArray[np.float64]

# How far beyond the corners of the pixel array the Jacobian of the distortion is searched for a fold.
_SEARCH_MARGIN = 1.25
# Radii beyond this many principal distances (89.99° off the axis) are of no camera.
_FAR = 1e4


# Of a derivative by a complex step, which loses no digits.
_STEP = 1e-30
# Of film alone: how finely the polynomial is searched for a fold.
_FILM_RADII, _FILM_DIRECTIONS = 32, 48


class FilmStage(NamedTuple):
    """What stands between the lens and the pixels of film: all that is not one of the parameters.

    `spacing_mm` of Ebner's grid, whether his twelve are parameters, the denominator of a projective scan, and
    half the width and height of the picture in mm (infinite: no frame is known).
    """

    spacing_mm: float
    deformed: bool
    projective: tuple[float, float]
    half_mm: tuple[float, float] = (math.inf, math.inf)


def model_code(distortion: Distortion, film: FilmStage | None = None) -> int:
    """Model code of the kernels; OpenCV models without rational, prism and tilt terms are Brown's."""
    if film is not None:
        inverse = isinstance(distortion, BrownDistortion) and distortion.direction == "measured_to_ideal"
        return k.FILM_INVERSE if inverse else k.FILM
    if isinstance(distortion, NoDistortion):
        return k.PINHOLE
    if isinstance(distortion, BrownDistortion):
        return k.BROWN if distortion.direction == "ideal_to_measured" else k.BROWN_INVERSE
    if isinstance(distortion, FisheyeDistortion):
        return k.FISHEYE
    return k.OPENCV if any(coefficients(distortion)[5:]) else k.BROWN


def interior_vector(
    principal_distance_mm: float,
    principal_point_mm: tuple[float, float],
    distortion: Distortion,
    deformation: EbnerDeformation | None = None,
) -> tuple[float, ...]:
    """Interior parameters in the order of ``Camera.parameter_names``."""
    symmetry = distortion.symmetry_mm if isinstance(distortion, BrownDistortion) else None
    twelve = () if deformation is None else coefficients(deformation)
    return (principal_distance_mm, *principal_point_mm, *(symmetry or ()), *coefficients(distortion), *twelve)


def _brown_into(packed: Any, c: Any, values: Any, model: BrownDistortion) -> Any:
    """Write Brown's coefficients; return the output affinity (b1, b2) that is folded elsewhere."""
    unit = c if model.units == "mm" else 1.0
    sign = -1.0 if model.convention == "usgs" else 1.0
    k0, k1, k2, k3, k4, p1, p2, b1, b2 = values
    packed[k.R0] = 1.0 + sign * k0
    for at, value, power in ((k.K1, k1, 2), (k.K2, k2, 4), (k.K3, k3, 6), (k.K4, k4, 8)):
        packed[at] = sign * value * unit**power
    if model.convention == "opencv":
        p1, p2 = p2, p1
    packed[k.P1], packed[k.P2] = sign * p1 * unit, sign * p2 * unit
    if model.convention in ("usgs", "australis"):
        packed[k.B1], packed[k.B2] = sign * b1, sign * b2
        return 0.0, 0.0
    return b1, b2


def _tilt(taux: Any, tauy: Any) -> Any:
    """OpenCV's matrix of the tilted sensor, row by row."""
    cx, sx, cy, sy = np.cos(taux), np.sin(taux), np.cos(tauy), np.sin(tauy)
    r = ((cy, sy * sx, -sy * cx), (0.0 * cx, cx, sx), (sy, -cy * sx, cy * cx))
    w = r[2][2]
    first = tuple(w * r[0][i] - r[0][2] * r[2][i] for i in range(3))
    second = tuple(w * r[1][i] - r[1][2] * r[2][i] for i in range(3))
    return (*first, *second, *r[2])


def _opencv_into(packed: Any, values: Any) -> None:
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, taux, tauy = values
    packed[k.R0] = 1.0
    packed[k.K1], packed[k.K2], packed[k.K3] = k1, k2, k3
    packed[k.P1], packed[k.P2] = p2, p1
    packed[k.D1], packed[k.D2], packed[k.D3] = k4, k5, k6
    packed[k.S1], packed[k.S2], packed[k.S3], packed[k.S4] = s1, s2, s3, s4
    packed[k.T : k.T + 9] = _tilt(taux, tauy)


def pack_parameters(vector: Any, affine: Any, distortion: Distortion, film: FilmStage | None = None) -> Any:
    """The parameter array without its inverses and limits; also for complex `vector` (derivatives).

    `vector` (n,), or a list of numbers, for a list of LENGTH numbers: few numbers are faster without arrays.
    `affine` 2x3.
    """
    packed: Any = [0.0] * k.LENGTH
    if not isinstance(vector, list):
        vector = np.asarray(vector)
        packed = np.zeros(k.LENGTH, dtype=np.result_type(vector.dtype, np.float64))
    c, xp, yp = vector[:3]
    xs, ys, values = xp, yp, vector[3:]
    if isinstance(distortion, BrownDistortion) and distortion.symmetry_mm is not None:
        xs, ys, values = vector[3], vector[4], vector[5:]
    values, twelve = _split(values, distortion)
    if film is not None:
        affine = _film_into(packed, twelve, affine, film)
    packed[k.R0] = 1.0
    b1: Any = 0.0
    b2: Any = 0.0
    flip = -1.0
    if isinstance(distortion, BrownDistortion):
        b1, b2 = _brown_into(packed, c, values, distortion)
        flip = -1.0 if distortion.convention in ("opencv", "agisoft") else 1.0
    elif isinstance(distortion, OpenCVDistortion):
        _opencv_into(packed, values)
    elif isinstance(distortion, FisheyeDistortion):
        packed[k.K1 : k.K4 + 1] = values
    else:
        flip = 1.0
    # Ideal point about the point of symmetry, in the axes of the convention.
    e = k.E
    packed[e], packed[e + 2] = 1.0, (xp - xs) / c
    packed[e + 4], packed[e + 5] = flip, flip * (yp - ys) / c
    # The output's affinity [[1 + b1, b2], [0, 1]] goes to the side of the measured point.
    if model_code(distortion) == k.BROWN_INVERSE:  # of film too
        for i in range(3):
            packed[e + i] = (packed[e + i] - b2 * packed[e + 3 + i]) / (1.0 + b1)
        b1 = b2 = 0.0
    for row, (ax, ay, a0) in zip((k.P, k.P + 3), affine, strict=True):
        packed[row] = ax * (c * (1.0 + b1))
        packed[row + 1] = ax * (c * b2) + ay * (c * flip)
        packed[row + 2] = ax * xs + ay * ys + a0
    return packed


def _split(values: Any, distortion: Distortion) -> tuple[Any, Any]:
    """Coefficients of the distortion and Ebner's twelve, if there are any."""
    n = len(distortion.coefficient_names)
    return values[:n], values[n:]


def _film_into(packed: Any, twelve: Any, affine: Any, film: FilmStage) -> Any:
    """Write what comes behind the film coordinates; return the affine from the photo system to these."""
    s = film.spacing_mm
    if film.deformed:
        packed[k.F : k.F + 12] = [v / s for v in twelve]
    for row, (ax, ay, a0) in zip((k.A, k.A + 3), affine, strict=True):
        packed[row], packed[row + 1], packed[row + 2] = ax * s, ay * s, a0
    packed[k.Q], packed[k.Q + 1] = film.projective[0] * s, film.projective[1] * s
    packed[k.F_R2_MAX] = math.inf
    packed[k.HALF], packed[k.HALF + 1] = film.half_mm[0] / s, film.half_mm[1] / s
    return ((1.0 / s, 0.0, 0.0), (0.0, 1.0 / s, 0.0))


def _inverse2(m: Any) -> Any:
    return np.array([[m[1, 1], -m[0, 1]], [-m[1, 0], m[0, 0]]]) / (m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0])


def _inverse_affine(flat: Array) -> Array:
    m = flat.reshape(2, 3)
    inverse = _inverse2(m[:, :2])
    return np.column_stack([inverse, -inverse @ m[:, 2]]).ravel()


def _radial_limit(model: int, packed: Array) -> float:
    """Radius up to which the radial function rises: its first stationary point or pole, else infinity."""
    numerator = np.polynomial.Polynomial(packed[[k.R0, k.K1, k.K2, k.K3, k.K4]])
    s = np.polynomial.Polynomial([0.0, 1.0])
    if model == k.FISHEYE:
        theta = _first_root(numerator + 2 * s * numerator.deriv(), (math.pi / 2) ** 2)
        return math.tan(math.sqrt(theta)) if theta < (math.pi / 2) ** 2 else math.inf
    denominator = np.polynomial.Polynomial([1.0, *packed[[k.D1, k.D2, k.D3]]])
    slope = (numerator + 2 * s * numerator.deriv()) * denominator - 2 * s * numerator * denominator.deriv()
    return math.sqrt(min(_first_root(slope, math.inf), _first_root(denominator, math.inf)))


def _first_root(polynomial: np.polynomial.Polynomial, end: float) -> float:
    """Smallest positive real root below `end`, else `end`; the constant term is not zero."""
    # Roots of the reversed polynomial are the reciprocals: well conditioned where roots are small, and
    # coefficients next to nothing cannot spoil them.
    reciprocals = np.asarray(np.roots(polynomial.coef), dtype=np.complex128)
    # A stationary point of inflection (a double root) counts as a limit: the slope vanishes there.
    real = reciprocals.real[np.abs(reciprocals.imag) <= 1e-7 * np.abs(reciprocals)]
    largest = float(real.max(initial=0.0))
    return min(1.0 / largest, end) if largest > 1.0 / (_FAR * _FAR) else end


def _fold_limit(model: int, packed: Array, limit: float, reach: float) -> float:
    """Radius below `limit` at which the Jacobian of D stops being positive in some direction.

    Decentring, prism, affinity and tilt can fold the image before the radial terms do. Sampled on
    72 directions out to `reach`, then bisected.
    """
    # Up to just below the limit: at the limit itself radial terms alone have a determinant of zero.
    radii = np.linspace(0.0, min(limit * (1.0 - 1e-9), reach), 129)[1:]

    def smallest(radius: float) -> float:
        return float(smallest_determinant(model, packed, radius, 72))

    good = 0.0
    for radius in radii:
        if smallest(radius) > 0.0:
            good = float(radius)
            continue
        bad = float(radius)
        for _ in range(50):
            middle = 0.5 * (good + bad)
            good, bad = (middle, bad) if smallest(middle) > 0.0 else (good, middle)
        return good
    return limit


def _reach(packed: Array, size: tuple[int, int], model: int) -> float:
    """Radius of the argument of D that certainly covers the pixel array."""
    inverse = packed[k.P_INV : k.P_INV + 6].reshape(2, 3)
    corners = _corners(size)
    if model >= k.FILM:
        corners[:, :2] = _film_corners(packed, size)
    furthest = float(np.linalg.norm(corners @ inverse.T, axis=1).max())
    if model in (k.BROWN_INVERSE, k.FILM_INVERSE):
        return furthest * _SEARCH_MARGIN
    return float(radial_inverse(model, packed, furthest)) * _SEARCH_MARGIN


def _corners(size: tuple[int, int]) -> Array:
    columns, rows = size
    return np.array([[0, 0, 1], [columns, 0, 1], [0, rows, 1], [columns, rows, 1]], dtype=np.float64)


def _film_corners(packed: Array, size: tuple[int, int]) -> Array:
    """Film coordinates of the corners of the pixel array, as if the film were not deformed: (4, 2)."""
    forward = np.vstack([packed[k.A : k.A + 6].reshape(2, 3), [packed[k.Q], packed[k.Q + 1], 1.0]])
    found = _corners(size) @ np.linalg.inv(forward).T
    result: Array = found[:, :2] / found[:, 2:]
    return result


def _film_limit(packed: Array, size: tuple[int, int]) -> float:
    """Radius in film coordinates up to which the deformation is monotonic, no further than the array goes."""
    reach = float(np.linalg.norm(_film_corners(packed, size), axis=1).max()) * _SEARCH_MARGIN
    return float(film_limit(packed, reach, _FILM_RADII, _FILM_DIRECTIONS))


@lru_cache(maxsize=1024)
def pack(
    size_px: tuple[int, int],
    vector: tuple[float, ...],
    affine: Affine2,
    distortion: Distortion,
    film: FilmStage | None = None,
) -> tuple[int, Array]:
    """Model code and read-only parameter array.

    Raises
    ------
    InputError
        If the distortion has no monotonic range at all (it folds at its centre).
    """
    model = model_code(distortion, film)
    packed = pack_parameters(vector, affine, distortion, film)
    packed[k.COLUMNS], packed[k.ROWS] = size_px
    packed[k.P_INV : k.P_INV + 6] = _inverse_affine(packed[k.P : k.P + 6])
    packed[k.E_INV : k.E_INV + 6] = _inverse_affine(packed[k.E : k.E + 6])
    limit = math.inf
    if isinstance(distortion, OpenCVDistortion):
        packed[k.T_INV : k.T_INV + 9] = np.linalg.inv(packed[k.T : k.T + 9].reshape(3, 3)).ravel()
    if model != k.PINHOLE:
        if packed[k.R0] <= 0.0:
            raise InputError("must leave the image its orientation: 1 + k0 > 0", field="distortion.k0")
        limit = _radial_limit(model, packed)
        packed[k.R_START] = min(limit, _FAR)
        limit = _fold_limit(model, packed, limit, _reach(packed, size_px, model))
        if limit == 0.0:
            raise InputError("must not fold the image at its centre", field="distortion")
        packed[k.R_START] = min(limit, _FAR)
    packed[k.R2_MAX] = limit * limit
    if film is not None and film.deformed:
        packed[k.F_R2_MAX] = _film_limit(packed, size_px) ** 2
        if packed[k.F_R2_MAX] == 0.0:
            raise InputError("must not fold the picture at its centre", field="deformation")
    packed.flags.writeable = False
    return model, packed


def pack_jacobian(
    vector: tuple[float, ...], affine: Affine2, distortion: Distortion, film: FilmStage | None = None
) -> Array:
    """d (parameter array) / d (interior parameters), shape (LENGTH, n).

    By complex steps through the same folding: exact to rounding, no difference is taken.
    """
    result = np.zeros((k.LENGTH, len(vector)))
    for entry, i, derivative in moved_entries(
        lambda now: pack_parameters(now, affine, distortion, film), vector, range(len(vector))
    ):
        result[entry, i] = derivative
    return result


def moved_entries(
    packed_at: Callable[[list[Any]], list[Any]], vector: Iterable[float], chosen: Iterable[int]
) -> list[tuple[int, int, float]]:
    """How some numbers of a vector move the entries of what is packed from it: what is not zero.

    Returns
    -------
    list of (entry, number, derivative)
        The number by its place among the chosen; by complex steps.
    """
    start, found = list(vector), []
    for place, i in enumerate(chosen):
        stepped: list[Any] = start.copy()
        stepped[i] += _STEP * 1j
        found += [(e, place, float(v.imag) / _STEP) for e, v in enumerate(packed_at(stepped)) if v.imag]
    return found
