"""The distortion functions D of every model, their derivatives and their inverses."""

from __future__ import annotations

import math

import numpy as np

from stereomate.camera.kernels.layout import (
    B1,
    B2,
    D1,
    D2,
    D3,
    FISHEYE,
    K1,
    K2,
    K3,
    K4,
    OPENCV,
    P1,
    P2,
    PINHOLE,
    R0,
    R2_MAX,
    R_START,
    S1,
    S2,
    S3,
    S4,
    T_INV,
    Array,
    Six,
    T,
)
from stereomate.jit import inline_kernel, kernel


@kernel
def brown(p: Array, x: float, y: float) -> tuple[float, float]:
    """D of Brown's model."""
    s = x * x + y * y
    radial = p[R0] + s * (p[K1] + s * (p[K2] + s * (p[K3] + s * p[K4])))
    xy = 2.0 * x * y
    return (
        x * radial + p[P1] * (s + 2.0 * x * x) + p[P2] * xy + p[B1] * x + p[B2] * y,
        y * radial + p[P2] * (s + 2.0 * y * y) + p[P1] * xy,
    )


@inline_kernel
def brown_terms(coefficients: tuple[float, ...], x: float, y: float) -> Six:
    """D of Brown's model and its derivative from (R0, K1, K2, K3, K4, P1, P2, B1, B2): as those below."""
    r0, k1, k2, k3, k4, p1, p2, b1, b2 = coefficients
    s = x * x + y * y
    radial = r0 + s * (k1 + s * (k2 + s * (k3 + s * k4)))
    slope = 2.0 * (k1 + s * (2.0 * k2 + s * (3.0 * k3 + s * 4.0 * k4)))
    xy = 2.0 * x * y
    cross = x * y * slope + 2.0 * (p1 * y + p2 * x)
    return (
        x * radial + p1 * (s + 2.0 * x * x) + p2 * xy + b1 * x + b2 * y,
        y * radial + p2 * (s + 2.0 * y * y) + p1 * xy,
        radial + x * x * slope + 6.0 * p1 * x + 2.0 * p2 * y + b1,
        cross + b2,
        cross,
        radial + y * y * slope + 6.0 * p2 * y + 2.0 * p1 * x,
    )


@inline_kernel
def brown_derivatives(p: Array, x: float, y: float) -> Six:
    """D of Brown's model and its derivative: (x', y', dx'/dx, dx'/dy, dy'/dx, dy'/dy)."""
    return brown_terms((p[R0], p[K1], p[K2], p[K3], p[K4], p[P1], p[P2], p[B1], p[B2]), x, y)


@kernel
def opencv_core(p: Array, x: float, y: float) -> Six:
    """OpenCV's rational, decentring and thin prism terms, with derivative, before the tilt."""
    s = x * x + y * y
    top = p[R0] + s * (p[K1] + s * (p[K2] + s * p[K3]))
    bottom = 1.0 + s * (p[D1] + s * (p[D2] + s * p[D3]))
    radial = top / bottom
    top_slope = p[K1] + s * (2.0 * p[K2] + s * 3.0 * p[K3])
    bottom_slope = p[D1] + s * (2.0 * p[D2] + s * 3.0 * p[D3])
    slope = 2.0 * (top_slope - radial * bottom_slope) / bottom
    xy = 2.0 * x * y
    cross = x * y * slope + 2.0 * (p[P1] * y + p[P2] * x)
    prism_x = 2.0 * (p[S1] + 2.0 * p[S2] * s)
    prism_y = 2.0 * (p[S3] + 2.0 * p[S4] * s)
    return (
        x * radial + p[P1] * (s + 2.0 * x * x) + p[P2] * xy + s * (p[S1] + s * p[S2]),
        y * radial + p[P2] * (s + 2.0 * y * y) + p[P1] * xy + s * (p[S3] + s * p[S4]),
        radial + x * x * slope + 6.0 * p[P1] * x + 2.0 * p[P2] * y + prism_x * x,
        cross + prism_x * y,
        cross + prism_y * x,
        radial + y * y * slope + 6.0 * p[P2] * y + 2.0 * p[P1] * x + prism_y * y,
    )


@kernel
def homography(p: Array, at: int, x: float, y: float) -> tuple[float, float, float]:
    """Point through the 3x3 matrix at index `at`; NaN behind its horizon."""
    w = p[at + 6] * x + p[at + 7] * y + p[at + 8]
    if not w > 0.0:
        return np.nan, np.nan, w
    return (p[at] * x + p[at + 1] * y + p[at + 2]) / w, (p[at + 3] * x + p[at + 4] * y + p[at + 5]) / w, w


@kernel
def opencv_derivatives(p: Array, x: float, y: float) -> Six:
    """D of OpenCV's full model and its derivative."""
    cx, cy, j00, j01, j10, j11 = opencv_core(p, x, y)
    hx, hy, w = homography(p, T, cx, cy)
    h00 = (p[T] - hx * p[T + 6]) / w
    h01 = (p[T + 1] - hx * p[T + 7]) / w
    h10 = (p[T + 3] - hy * p[T + 6]) / w
    h11 = (p[T + 4] - hy * p[T + 7]) / w
    return (
        hx,
        hy,
        h00 * j00 + h01 * j10,
        h00 * j01 + h01 * j11,
        h10 * j00 + h11 * j10,
        h10 * j01 + h11 * j11,
    )


@kernel
def opencv(p: Array, x: float, y: float) -> tuple[float, float]:
    """D of OpenCV's full model."""
    s = x * x + y * y
    top = p[R0] + s * (p[K1] + s * (p[K2] + s * p[K3]))
    radial = top / (1.0 + s * (p[D1] + s * (p[D2] + s * p[D3])))
    xy = 2.0 * x * y
    cx = x * radial + p[P1] * (s + 2.0 * x * x) + p[P2] * xy + s * (p[S1] + s * p[S2])
    cy = y * radial + p[P2] * (s + 2.0 * y * y) + p[P1] * xy + s * (p[S3] + s * p[S4])
    hx, hy, _ = homography(p, T, cx, cy)
    return hx, hy


@kernel
def fisheye_derivatives(p: Array, x: float, y: float) -> Six:
    """D of the equidistant model and its derivative."""
    s = x * x + y * y
    r = math.sqrt(s)
    if r < 1e-6:  # theta/r and its slope by their series
        ratio, ratio_slope = 1.0 - s / 3.0, -2.0 / 3.0
        theta = r * ratio
    else:
        theta = math.atan(r)
        ratio = theta / r
        ratio_slope = (1.0 / (1.0 + s) - ratio) / s  # (d ratio / d r) / r
    t = theta * theta
    poly = 1.0 + t * (p[K1] + t * (p[K2] + t * (p[K3] + t * p[K4])))
    # d poly / (theta d theta)
    poly_slope = 2.0 * (p[K1] + t * (2.0 * p[K2] + t * (3.0 * p[K3] + t * 4.0 * p[K4])))
    radial = ratio * poly
    slope = ratio_slope * poly + ratio * poly_slope * ratio / (1.0 + s)
    return (
        x * radial,
        y * radial,
        radial + x * x * slope,
        x * y * slope,
        x * y * slope,
        radial + y * y * slope,
    )


@kernel
def fisheye(p: Array, x: float, y: float) -> tuple[float, float]:
    """D of the equidistant model."""
    s = x * x + y * y
    r = math.sqrt(s)
    theta = math.atan(r)
    t = theta * theta
    ratio = theta / r if r > 1e-8 else 1.0
    radial = ratio * (1.0 + t * (p[K1] + t * (p[K2] + t * (p[K3] + t * p[K4]))))
    return x * radial, y * radial


@kernel
def distortion_derivatives(model: int, p: Array, x: float, y: float) -> Six:
    """D of any model and its derivative: (x', y', dx'/dx, dx'/dy, dy'/dx, dy'/dy)."""
    if model == PINHOLE:
        return x, y, 1.0, 0.0, 0.0, 1.0
    if model == OPENCV:
        return opencv_derivatives(p, x, y)
    if model == FISHEYE:
        return fisheye_derivatives(p, x, y)
    return brown_derivatives(p, x, y)


@kernel
def radial_function(model: int, p: Array, r: float) -> tuple[float, float]:
    """Radius after D from the radius before, radial terms only, and its derivative."""
    if model == FISHEYE:
        theta = math.atan(r)
        t = theta * theta
        value = theta * (1.0 + t * (p[K1] + t * (p[K2] + t * (p[K3] + t * p[K4]))))
        inner = 1.0 + t * (3.0 * p[K1] + t * (5.0 * p[K2] + t * (7.0 * p[K3] + t * 9.0 * p[K4])))
        return value, inner / (1.0 + r * r)
    s = r * r
    top = p[R0] + s * (p[K1] + s * (p[K2] + s * (p[K3] + s * p[K4])))
    top_slope = p[K1] + s * (2.0 * p[K2] + s * (3.0 * p[K3] + s * 4.0 * p[K4]))
    bottom = 1.0 + s * (p[D1] + s * (p[D2] + s * p[D3]))
    bottom_slope = p[D1] + s * (2.0 * p[D2] + s * 3.0 * p[D3])
    radial = top / bottom
    return r * radial, radial + 2.0 * s * (top_slope - radial * bottom_slope) / bottom


@kernel
def radial_inverse(model: int, p: Array, target: float) -> float:
    """Radius before D from the radius after: Newton within a shrinking bracket."""
    low, high = 0.0, p[R_START]
    r: float = min(target, high)
    for _ in range(100):
        value, slope = radial_function(model, p, r)
        if value > target:
            high = r
        else:
            low = r
        step = (value - target) / slope
        following = r - step
        if not low <= following <= high:
            following = 0.5 * (low + high)
        moved = abs(following - r)
        r = following
        if moved <= 1e-6 * r:
            break
    return r


@kernel
def newton(model: int, p: Array, tx: float, ty: float, x: float, y: float) -> tuple[float, float, bool]:
    """Newton for D(x, y) = (tx, ty), before the tilt, from a start; stays in the monotonic range or fails."""
    for _ in range(12):
        if model == OPENCV:
            fx, fy, a, b, c, d = opencv_core(p, x, y)
        elif model == FISHEYE:
            fx, fy, a, b, c, d = fisheye_derivatives(p, x, y)
        else:
            fx, fy, a, b, c, d = brown_derivatives(p, x, y)
        determinant = a * d - b * c
        if not determinant > 0.0:
            break
        ex, ey = fx - tx, fy - ty
        dx = (d * ex - b * ey) / determinant
        dy = (a * ey - c * ex) / determinant
        x -= dx
        y -= dy
        s = x * x + y * y
        if not s <= p[R2_MAX]:
            break
        # Quadratic convergence: after a step of 1e-7 the error is of the order of 1e-14.
        if dx * dx + dy * dy <= 1e-14 * (s + 1e-6):
            return x, y, True
    return np.nan, np.nan, False


@kernel
def undistort(model: int, p: Array, xd: float, yd: float) -> tuple[float, float, bool]:
    """The (x, y) in the monotonic range with D(x, y) = (xd, yd), and whether there is one.

    Newton from the point itself; where that leaves the monotonic range, the radial part is inverted first,
    safely in one dimension.
    """
    if model == PINHOLE:
        return xd, yd, True
    tx, ty = xd, yd
    if model == OPENCV:
        tx, ty, _ = homography(p, T_INV, xd, yd)
    x, y, found = newton(model, p, tx, ty, tx, ty)
    if found:
        return x, y, True
    rd = math.sqrt(tx * tx + ty * ty)
    if not 0.0 < rd < np.inf:
        return np.nan, np.nan, False
    scale = radial_inverse(model, p, rd) / rd
    return newton(model, p, tx, ty, tx * scale, ty * scale)
