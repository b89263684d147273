"""Atmospheric refraction of image coordinates: rays bend, and are seen too far from the nadir.

Two models. ``icao``: the ray through the ICAO standard atmosphere, flat layers, Snell's law by quadrature:
right for any tilt and height. ``ardc``: the closed formula of the ARDC standard atmosphere that is common in
textbooks and in calibration software (`camera.refraction`).
"""

from __future__ import annotations

from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.camera.refraction import ardc_constant
from stereomate.errors import InputError, OrientationError
from stereomate.frames.curvature import level_tangents, project_level

Array = NDArray[np.float64]
RefractionModel = Literal["none", "icao", "ardc"]

# ICAO standard atmosphere (ISO 2533): up to 11 km a lapse of 6.5 K/km, above it isothermal.
_T0: Final = 288.15
_LAPSE: Final = 0.0065
_TROPOPAUSE_M: Final = 11_000.0
_ATMOSPHERE_RADIUS_M: Final = 6_356_766.0
_GRAVITY_OVER_GAS: Final = 9.80665 / 287.05287
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)


def refractive_index(height_m: ArrayLike, wavelength_um: float = 0.55) -> Array:
    """Refractive index of the standard atmosphere at heights above sea level.

    Dry air at 15 °C and 1013.25 hPa by Edlén (1966), times the relative density of the ICAO atmosphere.
    """
    geometric = np.asarray(height_m, dtype=np.float64)
    h = geometric * _ATMOSPHERE_RADIUS_M / (_ATMOSPHERE_RADIUS_M + geometric)  # geopotential
    sigma2 = wavelength_um**-2
    sea_level = 1e-8 * (8342.13 + 2_406_030.0 / (130.0 - sigma2) + 15_997.0 / (38.9 - sigma2))
    low = np.minimum(h, _TROPOPAUSE_M)
    temperature = _T0 - _LAPSE * low
    density = (temperature / _T0) ** (_GRAVITY_OVER_GAS / _LAPSE - 1.0)
    density = density * np.exp(-_GRAVITY_OVER_GAS * (h - low) / temperature)
    return np.asarray(1.0 + sea_level * density, dtype=np.float64)


def refraction_corrected(
    xy: ArrayLike,
    principal_distance: float,
    level_from_camera: ArrayLike,
    h_camera: ArrayLike,
    h_ground: ArrayLike,
    model: RefractionModel = "icao",
) -> Array:
    """Image coordinates as a vacuum would have given them.

    Parameters
    ----------
    xy : array_like (..., 2)
        Measured coordinates from the principal point, in any unit of length.
    principal_distance : float
        In the same unit.
    level_from_camera : array_like (..., 3, 3)
        Rotation to the level frame at the projection centre.
    h_camera, h_ground : array_like (...)
        Heights above sea level of the centre and of each point (ellipsoidal ones serve: 50 m change 0.5 %).
    model : str
        ``icao``, ``ardc`` or ``none``.

    Raises
    ------
    OrientationError
        If a ray does not go down, or the ground is not below the camera.
    """
    if model not in get_args(RefractionModel):
        raise InputError("must be icao, ardc or none", field="refraction", value=model)
    if model == "none":
        return np.array(xy, dtype=np.float64)
    t = level_tangents(xy, principal_distance, level_from_camera)
    camera = np.broadcast_to(np.asarray(h_camera, dtype=np.float64), t.shape[:-1])
    ground = np.broadcast_to(np.asarray(h_ground, dtype=np.float64), t.shape[:-1])
    if np.any(camera <= ground):
        raise OrientationError("the ground must lie below the projection centre", field="h_ground")
    tangent2 = np.sum(t * t, axis=-1)
    if model == "ardc":
        factor = 1.0 - ardc_constant(camera, ground) * (1.0 + tangent2)
    else:
        factor = _straightened(tangent2, camera, ground)
    return project_level(t * factor[..., None], principal_distance, level_from_camera)


def _straightened(tangent2: Array, camera: Array, ground: Array) -> Array:
    """Tangent of the straight line from camera to ground over the tangent of the ray at the camera."""
    sine2 = tangent2 / (1.0 + tangent2)
    index = refractive_index(camera)
    ratio = np.zeros(np.shape(sine2))
    for node, weight in zip(_NODES, _WEIGHTS, strict=True):
        here = refractive_index(ground + 0.5 * (1.0 + node) * (camera - ground))
        # sin z = (n_camera / n) sin z_camera, and tan z over tan z_camera from it without cancellation
        scale = index / here
        ratio = ratio + 0.5 * weight * scale * np.sqrt((1.0 - sine2) / (1.0 - scale**2 * sine2))
    return np.asarray(ratio, dtype=np.float64)
