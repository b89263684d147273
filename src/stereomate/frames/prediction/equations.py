"""The equations of the paper (Ressl 2002) in closed form, and the limits of its tables.

With tau_e = tau / (1 + h/R) instead of tau they hold for ground at any height; with tau they are the paper's,
which are those for ground on the ellipsoid or for a curvature correction that reduces to it (georeferencing
theory, section 2).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def centre_height_shift(scale: ArrayLike, h_centre: ArrayLike, h_control: ArrayLike) -> Array:
    """Equation (2): indirect georeferencing, c fixed: how much too high the projection centre comes out.

    ``(scale - 1)(H_PRC - H_GCP)``: the plan of the control forces the model's scale.
    """
    return _scaled(scale, np.asarray(h_centre, dtype=np.float64) - np.asarray(h_control, dtype=np.float64))


def indirect_point_error(scale: ArrayLike, h_point: ArrayLike, h_control: ArrayLike) -> Array:
    """Equation (3): indirect georeferencing, c fixed: height error of a new point, ``(scale - 1)(H_N -
    H_GCP)``."""
    return _scaled(scale, np.asarray(h_point, dtype=np.float64) - np.asarray(h_control, dtype=np.float64))


def direct_point_error(scale: ArrayLike, h_point: ArrayLike, h_centre: ArrayLike) -> Array:
    """Equation (4): direct georeferencing: height error of a new point, ``(scale - 1)(H_N - H_PRC)``."""
    return _scaled(scale, np.asarray(h_point, dtype=np.float64) - np.asarray(h_centre, dtype=np.float64))


def _scaled(scale: ArrayLike, difference: Array) -> Array:
    return np.asarray((np.asarray(scale, dtype=np.float64) - 1.0) * difference, dtype=np.float64)


def ground_level_relief_error(
    h_point: ArrayLike, h_control: ArrayLike, h_centre: ArrayLike, radius: float
) -> Array:
    """What a curvature correction that keeps distances at ground level adds to equation (3): (metres).

    ``(h_N - h_GCP)/R (h_PRC - h_N)``: the scale of the control's height is forced on a point of another
    height.
    """
    point = np.asarray(h_point, dtype=np.float64)
    above = point - np.asarray(h_control, dtype=np.float64)
    return np.asarray(above / radius * (np.asarray(h_centre, dtype=np.float64) - point), dtype=np.float64)


def curvature_deformation(s1: ArrayLike, base: ArrayLike, across: ArrayLike, radius: float) -> Array:
    """Height error of a point of a pair if Earth curvature is not corrected (metres).

    ``-(s1³ + s2³)/(2 R b) - y²/(2 R)`` with the point at s1 from the first nadir and s2 = b - s1 from the
    second, and y across the base.
    """
    first, b = np.asarray(s1, dtype=np.float64), np.asarray(base, dtype=np.float64)
    y = np.asarray(across, dtype=np.float64)
    along = (first**3 + (b - first) ** 3) / (2.0 * radius * b)
    return np.asarray(-along - y * y / (2.0 * radius), dtype=np.float64)


def m3_planar_limit_mm(tau: float, tilt_1: float, tilt_2: float, image_error_mm: float) -> float:
    """Table 5: principal distance below which M3's image shift stays under `image_error_mm` for two tilts
    (radians).

    ``c < error / (eps hypot(sin t1, sin t2))`` with ``eps = |1/tau - 1|``.
    """
    return image_error_mm / (abs(1.0 / tau - 1.0) * math.hypot(math.sin(tilt_1), math.sin(tilt_2)))


def m3_height_limit_mm(
    tau: float, tilt_1: float, tilt_2: float, relative_height_error: float, image_radius_mm: float
) -> float:
    """Table 5: principal distance above which M3's height error stays under a share of H for two tilts
    (radians).

    ``c > x eps (sin t1 + sin t2) / share`` with x the largest image coordinate.
    """
    epsilon = abs(1.0 / tau - 1.0)
    return image_radius_mm * epsilon * (math.sin(tilt_1) + math.sin(tilt_2)) / relative_height_error


def block_width_m(distance_m: float, share: float, radius_m: float) -> float:
    """Table 6: full width of a block for which one scale serves, error below `share` of the flying height.

    ``2 q R² / X`` at the distance X from the central meridian, ``2 R sqrt(2 q)`` on it.
    """
    if distance_m == 0.0:
        return 2.0 * radius_m * math.sqrt(2.0 * share)
    return 2.0 * share * radius_m**2 / abs(distance_m)
