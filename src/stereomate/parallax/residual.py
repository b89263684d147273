"""Natural residual parallax of an object above a slope, and what a stereomate makes of it.

An object point A stands at height Δh above the terrain point T. Its images in the two orthophotos lie where
the two rays of A meet the terrain, here the plane tangent at T. Equations (3) to (7) and (9) to (11) of
Jachimski 1980 for any base vector; the formulas of the plane are exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.parallax.laws import ParallaxLaw

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ResidualParallax:
    """Parallaxes of object points against the terrain points below them: left minus right, ground metres.

    NaN where a ray of the object point does not meet the plane.

    Attributes
    ----------
    ortho_m : ndarray (..., 2)
        Between two plain orthophotos, along the rows and across them; (3), (10).
    stereo_m : ndarray (..., 2)
        Between orthophoto and stereomate, shifted along the rows; (6).
    artificial_m : ndarray (...)
        Difference of artificial parallax between the ground seen behind A and T; (7).
    ideal_m : ndarray (...)
        What the object would show on level ground, along the rows; (5).
    mu_left, mu_right : ndarray (...)
        (9)
    ground_left_m, ground_right_m : ndarray (...)
        Height above T of the ground that hides behind A in the left and right photograph; (11).
    """

    ortho_m: Floats
    stereo_m: Floats
    artificial_m: Floats
    ideal_m: Floats
    mu_left: Floats
    mu_right: Floats
    ground_left_m: Floats
    ground_right_m: Floats

    @property
    def relaxation(self) -> Floats:
        """Homogeneity relaxation (t_x, t_y) as fractions of the ideal parallax, (..., 2)."""
        t = self.stereo_m / self.ideal_m[..., None]
        t[..., 0] -= 1.0
        return t


def residual_parallax(
    ground_m: ArrayLike,
    base_m: ArrayLike,
    slope: ArrayLike,
    object_height_m: ArrayLike,
    law: ParallaxLaw,
    level_m: ArrayLike | None = None,
) -> ResidualParallax:
    """Residual parallaxes of objects on planes, by the closed formulas.

    Parameters
    ----------
    ground_m : array_like (..., 3)
        (X_T, Y_T, w_T): terrain point from the left projection centre, X along the rows, Y to the left of X,
        w_T how far below the centre.
    base_m : array_like (..., 3)
        Right centre minus left.
    slope : array_like (..., 2)
        Tangents of the slope along X and Y, positive where the ground rises.
    object_height_m : array_like (...)
        Δh.
    law : ParallaxLaw
        Gives the artificial part; "none" for a pair of orthophotos.
    level_m : array_like (...), optional
        Height h_T of T above the reference level; w0 - w_T if absent, which holds where the left centre is
        at w0.
    """
    ground, base = np.asarray(ground_m, np.float64), np.asarray(base_m, np.float64)
    tangents, dh = np.asarray(slope, np.float64), np.asarray(object_height_m, np.float64)
    depth = ground[..., 2]
    level = law.w0_m - depth if level_m is None else np.asarray(level_m, np.float64)
    a = ground[..., 0] * tangents[..., 0] + ground[..., 1] * tangents[..., 1] + depth - dh
    b = base[..., 0] * tangents[..., 0] + base[..., 1] * tangents[..., 1] - base[..., 2]
    a, right = _positive(a), _positive(a - b)
    mu_left, mu_right = dh / a, dh / right
    ortho = ground[..., :2] * mu_left[..., None] - (ground[..., :2] - base[..., :2]) * mu_right[..., None]
    ground_left = dh * (1.0 - (depth - dh) / a)
    ground_right = dh * (1.0 - (depth + base[..., 2] - dh) / right)
    at = law.reference_m + level
    artificial = law.q(at + ground_right) - law.q(at)
    stereo = ortho.copy()
    stereo[..., 0] += artificial
    return ResidualParallax(
        ortho_m=ortho,
        stereo_m=stereo,
        artificial_m=artificial,
        ideal_m=np.asarray(base[..., 0] * dh / _positive(law.w0_m - level - dh), np.float64),
        mu_left=mu_left,
        mu_right=mu_right,
        ground_left_m=ground_left,
        ground_right_m=ground_right,
    )


def _positive(value: Floats) -> Floats:
    """The values that are positive; where they are not, the ray does not meet the plane: NaN."""
    return np.where(value > 0.0, value, np.nan)
