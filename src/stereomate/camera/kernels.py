"""Kernels of the camera model: camera frame to pixel and back, with derivatives.

All models share one parameter array of `LENGTH` numbers, made by `stereomate.camera.packing`:

- E, 2x3: ideal (u, v, 1) with u = x/-z, v = y/-z to the argument or value of the distortion function D,
  in the axes and about the point of symmetry of its convention;
- D: the distortion function, by model code;
- P, 2x3: from the other side of D to the pixel.

``BROWN``, ``OPENCV`` and ``FISHEYE`` are pixel = P D(E(u, v)); ``BROWN_INVERSE`` (measured to ideal) is
D(P⁻¹ pixel) = E(u, v). The radius up to which D is monotonic is part of the array: a point beyond is nowhere.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import kernel

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Six = tuple[float, float, float, float, float, float]

PINHOLE, BROWN, BROWN_INVERSE, OPENCV, FISHEYE = 0, 1, 2, 3, 4

COLUMNS, ROWS = 0, 1
P = 2  # 2..7 pixel from measured, row by row
P_INV = 8
E = 14
E_INV = 20
R2_MAX = 26  # squared radius of the argument of D up to which D is monotonic
R_START = 27  # finite upper end of the bracket of the radial inversion
R0, K1, K2, K3, K4 = 28, 29, 30, 31, 32  # R = R0 + K1 r² + ...
P1, P2, B1, B2 = 33, 34, 35, 36
D1, D2, D3 = 37, 38, 39  # denominator 1 + D1 r² + ...
S1, S2, S3, S4 = 40, 41, 42, 43
T = 44  # 3x3 homography of the tilted sensor
T_INV = 53
LENGTH = 62


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


@kernel
def brown_derivatives(p: Array, x: float, y: float) -> Six:
    """D of Brown's model and its derivative: (x', y', dx'/dx, dx'/dy, dy'/dx, dy'/dy)."""
    s = x * x + y * y
    radial = p[R0] + s * (p[K1] + s * (p[K2] + s * (p[K3] + s * p[K4])))
    slope = 2.0 * (p[K1] + s * (2.0 * p[K2] + s * (3.0 * p[K3] + s * 4.0 * p[K4])))
    xy = 2.0 * x * y
    cross = x * y * slope + 2.0 * (p[P1] * y + p[P2] * x)
    return (
        x * radial + p[P1] * (s + 2.0 * x * x) + p[P2] * xy + p[B1] * x + p[B2] * y,
        y * radial + p[P2] * (s + 2.0 * y * y) + p[P1] * xy,
        radial + x * x * slope + 6.0 * p[P1] * x + 2.0 * p[P2] * y + p[B1],
        cross + p[B2],
        cross,
        radial + y * y * slope + 6.0 * p[P2] * y + 2.0 * p[P1] * x,
    )


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
def undistort(model: int, p: Array, xd: float, yd: float) -> tuple[float, float, bool]:
    """The (x, y) in the monotonic range with D(x, y) = (xd, yd), and whether there is one.

    The radial part is inverted first, safely in one dimension; Newton in two dimensions finishes.
    """
    if model == PINHOLE:
        return xd, yd, True
    tx, ty = xd, yd
    if model == OPENCV:
        tx, ty, _ = homography(p, T_INV, xd, yd)
    rd = math.sqrt(tx * tx + ty * ty)
    if not rd < np.inf:
        return np.nan, np.nan, False
    scale = 1.0
    if rd > 0.0:
        scale = radial_inverse(model, p, rd) / rd
    x, y = tx * scale, ty * scale
    for _ in range(20):
        if model == OPENCV:
            fx, fy, a, b, c, d = opencv_core(p, x, y)
        else:
            fx, fy, a, b, c, d = distortion_derivatives(model, p, x, y)
        ex, ey = fx - tx, fy - ty
        determinant = a * d - b * c
        dx = (d * ex - b * ey) / determinant
        dy = (a * ey - c * ex) / determinant
        x -= dx
        y -= dy
        s = x * x + y * y
        # Quadratic convergence: after a step of 1e-8 the error is of the order of 1e-16.
        if dx * dx + dy * dy <= 1e-16 * (s + 1e-8):
            return x, y, determinant > 0.0 and s <= p[R2_MAX]
    return np.nan, np.nan, False


@kernel
def _affine(p: Array, at: int, x: float, y: float) -> tuple[float, float]:
    return p[at] * x + p[at + 1] * y + p[at + 2], p[at + 3] * x + p[at + 4] * y + p[at + 5]


@kernel
def _on_array(p: Array, column: float, row: float) -> bool:
    # Without short circuits: smooth code is cheaper than four branches.
    inside: bool = (column >= 0.0) & (column < p[COLUMNS]) & (row >= 0.0) & (row < p[ROWS])
    return inside


@kernel
def pinhole_point(parameters: Array, x: float, y: float, z: float) -> tuple[float, float, bool]:
    """`image_from_camera_point` of a pinhole: no branches, small enough to be inlined and vectorised."""
    p = parameters
    w = -1.0 / z if z < 0.0 else np.nan
    column, row = _affine(p, P, x * w, y * w)
    return column, row, _on_array(p, column, row)


@kernel
def brown_point(parameters: Array, x: float, y: float, z: float) -> tuple[float, float, bool]:
    """`image_from_camera_point` of Brown's model, ideal to measured."""
    p = parameters
    w = -1.0 / z if z < 0.0 else np.nan
    u, v = _affine(p, E, x * w, y * w)
    if not u * u + v * v <= p[R2_MAX]:
        return np.nan, np.nan, False
    u, v = brown(p, u, v)
    column, row = _affine(p, P, u, v)
    return column, row, _on_array(p, column, row)


@kernel
def general_point(model: int, parameters: Array, x: float, y: float, z: float) -> tuple[float, float, bool]:
    """`image_from_camera_point` of every model."""
    p = parameters
    if not z < 0.0:
        return np.nan, np.nan, False
    u, v = x / -z, y / -z
    if model != PINHOLE:
        u, v = _affine(p, E, u, v)
        if model == BROWN_INVERSE:
            u, v, found = undistort(model, p, u, v)
            if not found:
                return np.nan, np.nan, False
        else:
            if not u * u + v * v <= p[R2_MAX]:
                return np.nan, np.nan, False
            u, v, _, _, _, _ = distortion_derivatives(model, p, u, v)
    column, row = _affine(p, P, u, v)
    return column, row, _on_array(p, column, row)


@kernel
def image_from_camera_point(
    model: int, parameters: Array, x: float, y: float, z: float
) -> tuple[float, float, bool]:
    """Pixel of a point in the camera frame: (column, row, inside).

    `inside` is False outside the pixel array (0 <= column < columns), at z >= 0 and beyond the monotonic
    range of the distortion; in the last two cases column and row are NaN. Where many points share
    one model, `image_from_camera_row` is several times faster.
    """
    if model == PINHOLE:
        return pinhole_point(parameters, x, y, z)
    if model == BROWN:
        return brown_point(parameters, x, y, z)
    return general_point(model, parameters, x, y, z)


@kernel
def ray_from_pixel(model: int, parameters: Array, column: float, row: float) -> tuple[float, float, bool]:
    """Direction (x, y, -1) in the camera frame of a pixel position: (x, y, ok).

    `ok` is False (and x, y NaN) where the position is beyond the monotonic range of the distortion.
    """
    p = parameters
    x, y = _affine(p, P_INV, column, row)
    if model == PINHOLE:
        return x, y, True
    if model == BROWN_INVERSE:
        if not x * x + y * y <= p[R2_MAX]:
            return np.nan, np.nan, False
        x, y = brown(p, x, y)
    else:
        x, y, found = undistort(model, p, x, y)
        if not found:
            return np.nan, np.nan, False
    x, y = _affine(p, E_INV, x, y)
    return x, y, True


@kernel
def pinhole_row(
    parameters: Array, x: Array, y: Array, z: Array, column: Array, row: Array, inside: Flags
) -> None:
    """`pinhole_point` over 1-D arrays, written so that it is vectorised."""
    p = parameters
    m0, m1, m2, m3, m4, m5 = p[P], p[P + 1], p[P + 2], p[P + 3], p[P + 4], p[P + 5]
    columns, rows = p[COLUMNS], p[ROWS]
    for i in range(x.shape[0]):
        w = -1.0 / z[i] if z[i] < 0.0 else np.nan
        u, v = x[i] * w, y[i] * w
        c = m0 * u + m1 * v + m2
        r = m3 * u + m4 * v + m5
        column[i], row[i] = c, r
        inside[i] = (c >= 0.0) & (c < columns) & (r >= 0.0) & (r < rows)


@kernel
def brown_row(
    parameters: Array, x: Array, y: Array, z: Array, column: Array, row: Array, inside: Flags
) -> None:
    """`brown_point` over 1-D arrays: parameters in registers and no branches, six times as fast."""
    p = parameters
    e0, e1, e2, e3, e4, e5 = p[E], p[E + 1], p[E + 2], p[E + 3], p[E + 4], p[E + 5]
    m0, m1, m2, m3, m4, m5 = p[P], p[P + 1], p[P + 2], p[P + 3], p[P + 4], p[P + 5]
    r0, k1, k2, k3, k4 = p[R0], p[K1], p[K2], p[K3], p[K4]
    p1, p2, b1, b2 = p[P1], p[P2], p[B1], p[B2]
    columns, rows, limit = p[COLUMNS], p[ROWS], p[R2_MAX]
    for i in range(x.shape[0]):
        w = -1.0 / z[i]
        u, v = x[i] * w, y[i] * w
        a = e0 * u + e1 * v + e2
        b = e3 * u + e4 * v + e5
        s = a * a + b * b
        radial = r0 + s * (k1 + s * (k2 + s * (k3 + s * k4)))
        radial = radial if (z[i] < 0.0) & (s <= limit) else np.nan
        ab = 2.0 * a * b
        xd = a * radial + p1 * (s + 2.0 * a * a) + p2 * ab + b1 * a + b2 * b
        yd = b * radial + p2 * (s + 2.0 * b * b) + p1 * ab
        c = m0 * xd + m1 * yd + m2
        r = m3 * xd + m4 * yd + m5
        column[i], row[i] = c, r
        inside[i] = (c >= 0.0) & (c < columns) & (r >= 0.0) & (r < rows)


@kernel
def image_from_camera_row(
    model: int, parameters: Array, x: Array, y: Array, z: Array, column: Array, row: Array, inside: Flags
) -> None:
    """`image_from_camera_point` over 1-D contiguous arrays, branched once; writes column, row, inside."""
    if model == PINHOLE:
        pinhole_row(parameters, x, y, z, column, row, inside)
    elif model == BROWN:
        brown_row(parameters, x, y, z, column, row, inside)
    else:
        for i in range(x.shape[0]):
            column[i], row[i], inside[i] = general_point(model, parameters, x[i], y[i], z[i])


@kernel
def image_from_camera_points(
    model: int, parameters: Array, points: Array, pixels: Array, inside: Flags
) -> None:
    """`image_from_camera_point` over points (n, 3) into pixels (n, 2) and inside (n)."""
    for i in range(points.shape[0]):
        pixels[i, 0], pixels[i, 1], inside[i] = image_from_camera_point(
            model, parameters, points[i, 0], points[i, 1], points[i, 2]
        )


@kernel
def rays_from_pixels(model: int, parameters: Array, pixels: Array, rays: Array) -> None:
    """`ray_from_pixel` over pixels (n, 2) into rays (n, 3) with z = -1."""
    for i in range(pixels.shape[0]):
        rays[i, 0], rays[i, 1], _ = ray_from_pixel(model, parameters, pixels[i, 0], pixels[i, 1])
        rays[i, 2] = -1.0
