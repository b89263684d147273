"""Atmospheric refraction of near-vertical photographs, as part of the distortion.

``δr = K (r + r³ / c²)``, away from the nadir point. K of the ARDC 1959 standard atmosphere (Bertram 1966;
Manual of Photogrammetry; also Wolf & Dewitt), heights in km above sea level, K in microradians:

    K = 2410 H / (H² - 6 H + 250) - 2410 h / (h² - 6 h + 250) · h / H
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.camera.distortion import BrownDistortion, NoDistortion
from stereomate.camera.model import Camera
from stereomate.errors import InputError

Array = NDArray[np.float64]


def refraction_constant(flying_height_m: float, ground_height_m: float) -> float:
    """K in radians, for heights above sea level.

    Raises
    ------
    InputError
        If the camera is not above the ground, or beyond 11 km, where the formula ends.
    """
    if not ground_height_m < flying_height_m <= 11_000.0:
        raise InputError(
            "must be above the ground and at most 11000 m", field="flying_height_m", value=flying_height_m
        )
    return float(ardc_constant(flying_height_m, ground_height_m))


def ardc_constant(h_camera: ArrayLike, h_ground: ArrayLike) -> Array:
    """K, the refraction at 45°, in radians (...); heights (...) in metres above sea level, not checked."""
    high = np.asarray(h_camera, dtype=np.float64) / 1000.0
    low = np.asarray(h_ground, dtype=np.float64) / 1000.0
    k = 2410.0 * high / (high * high - 6.0 * high + 250.0)
    k = k - 2410.0 * low / (low * low - 6.0 * low + 250.0) * (low / high)
    return np.asarray(1e-6 * k, dtype=np.float64)


def with_refraction(camera: Camera, constant: float) -> Camera:
    """The camera with refraction about the principal point folded into its distortion.

    Only for near-vertical photographs; the product of refraction and distortion (1e-9) is neglected.

    Raises
    ------
    InputError
        If the distortion is not Brown's.
    """
    model = camera.distortion
    if isinstance(model, NoDistortion):
        model = BrownDistortion()
    if not isinstance(model, BrownDistortion):
        raise InputError(
            "must be none or Brown's to take up refraction", field=f"camera {camera.name!r}: distortion"
        )
    sign = 1.0 if model.direction == "ideal_to_measured" else -1.0
    if model.convention == "usgs":
        sign = -sign
    unit = camera.principal_distance_mm**2 if model.units == "mm" else 1.0
    changed = replace(model, k0=model.k0 + sign * constant, k1=model.k1 + sign * constant / unit)
    return replace(camera, distortion=changed)
