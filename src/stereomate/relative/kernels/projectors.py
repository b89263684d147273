"""y-parallaxes of two projectors and their derivatives by all ten motions."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import inline_kernel, kernel

FloatArray = NDArray[np.float64]


@inline_kernel
def rotate(omega: float, phi: float, kappa: float, v: FloatArray) -> tuple[float, float, float]:
    """Rx(ω) Ry(φ) Rz(κ) v."""
    cw, sw = math.cos(omega), math.sin(omega)
    cp, sp = math.cos(phi), math.sin(phi)
    ck, sk = math.cos(kappa), math.sin(kappa)
    x, y, z = ck * v[0] - sk * v[1], sk * v[0] + ck * v[1], v[2]
    x, z = cp * x + sp * z, cp * z - sp * x
    return x, cw * y - sw * z, sw * y + cw * z


@inline_kernel
def cross(a: tuple[float, float, float], b: tuple[float, float, float]) -> tuple[float, float, float]:
    """a × b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inline_kernel
def dot(a: tuple[float, float, float], b: tuple[float, float, float]) -> float:
    """a · b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def measure(
    left: FloatArray, right: FloatArray, setting: FloatArray, points: FloatArray, jacobian: FloatArray
) -> None:
    """Model of two projectors: `points` (n, 4) receives p, x, y, z, `jacobian` (n, 10) the derivatives of p.

    `setting` (11,): by, bz, ω, φ, κ of the left, of the right projector, base. With g = dL × dR scaled to
    g_y = 1 the parallax is p = g · (OL - OR), and g does not see changes of the rays along themselves; so
    dp = g · (λ δdL + δOL - μ δdR - δOR). nan where the rays do not meet below both projectors.
    """
    for row in range(left.shape[0]):
        a = rotate(setting[2], setting[3], setting[4], left[row])
        b = rotate(setting[7], setting[8], setting[9], right[row])
        normal = cross(a, b)
        base = (setting[10], setting[5] - setting[0], setting[6] - setting[1])
        p = -dot(normal, base) / normal[1]
        # λ a - μ b = base + (0, p, 0)
        link = (base[0], base[1] + p, base[2])
        square = dot(normal, normal)
        one = dot(cross(link, b), normal) / square
        other = dot(cross(link, a), normal) / square
        if not (one > 0.0 and other > 0.0 and a[2] < 0.0 and b[2] < 0.0 and math.isfinite(p)):
            points[row, :] = np.nan
            jacobian[row, :] = np.nan
            continue
        points[row, 0] = p
        points[row, 1] = one * a[0]
        points[row, 2] = setting[0] + one * a[1] - 0.5 * p
        points[row, 3] = setting[1] + one * a[2]
        g = (normal[0] / normal[1], 1.0, normal[2] / normal[1])
        for side in range(2):
            ray, factor, sign = (a, one, 1.0) if side == 0 else (b, -other, -1.0)
            omega, phi = setting[5 * side + 2], setting[5 * side + 3]
            about_phi = (0.0, math.cos(omega), math.sin(omega))
            about_kappa = (
                math.sin(phi),
                -math.sin(omega) * math.cos(phi),
                math.cos(omega) * math.cos(phi),
            )
            jacobian[row, 5 * side] = sign
            jacobian[row, 5 * side + 1] = sign * g[2]
            jacobian[row, 5 * side + 2] = factor * dot(g, cross((1.0, 0.0, 0.0), ray))
            jacobian[row, 5 * side + 3] = factor * dot(g, cross(about_phi, ray))
            jacobian[row, 5 * side + 4] = factor * dot(g, cross(about_kappa, ray))
