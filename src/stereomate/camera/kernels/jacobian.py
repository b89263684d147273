"""Derivatives of the pixel with respect to the camera-frame point and to the parameter array."""

from __future__ import annotations

import math

import numpy as np

from stereomate.camera.kernels.distortion import (
    distortion_derivatives,
    homography,
    opencv_core,
    undistort,
)
from stereomate.camera.kernels.film import film_jacobian, lens_model
from stereomate.camera.kernels.layout import (
    B1,
    B2,
    BROWN_INVERSE,
    COLUMNS,
    D1,
    FILM,
    FISHEYE,
    K1,
    K4,
    LENGTH,
    OPENCV,
    P1,
    P2,
    PINHOLE,
    R0,
    R2_MAX,
    ROWS,
    S1,
    S2,
    S3,
    S4,
    Array,
    E,
    Flags,
    Indices,
    P,
    T,
)
from stereomate.camera.kernels.projection import affine
from stereomate.jit import kernel


@kernel
def opencv_coefficients(p: Array, x: float, y: float, out: Array) -> None:
    """d D / d (coefficients) of OpenCV's model, through the tilt, into columns of `out` (2, LENGTH)."""
    s = x * x + y * y
    bottom = 1.0 + s * (p[D1] + s * (p[D1 + 1] + s * p[D1 + 2]))
    top = p[R0] + s * (p[K1] + s * (p[K1 + 1] + s * p[K1 + 2]))
    power = 1.0
    for i in range(3):
        power *= s
        out[0, K1 + i], out[1, K1 + i] = x * power / bottom, y * power / bottom
        shrink = -top * power / (bottom * bottom)
        out[0, D1 + i], out[1, D1 + i] = x * shrink, y * shrink
    out[0, S1], out[0, S2], out[1, S3], out[1, S4] = s, s * s, s, s * s
    decentring(x, y, out)
    cx, cy, _, _, _, _ = opencv_core(p, x, y)
    hx, hy, w = homography(p, T, cx, cy)
    for i in range(LENGTH):
        a, b = out[0, i], out[1, i]
        if a != 0.0 or b != 0.0:
            out[0, i] = ((p[T] - hx * p[T + 6]) * a + (p[T + 1] - hx * p[T + 7]) * b) / w
            out[1, i] = ((p[T + 3] - hy * p[T + 6]) * a + (p[T + 4] - hy * p[T + 7]) * b) / w
    for i, value in enumerate((cx, cy, 1.0)):
        out[0, T + i] = out[1, T + 3 + i] = value / w
        out[0, T + 6 + i], out[1, T + 6 + i] = -hx * value / w, -hy * value / w


@kernel
def decentring(x: float, y: float, out: Array) -> None:
    """d D / d (P1, P2)."""
    s = x * x + y * y
    out[0, P1], out[1, P1] = s + 2.0 * x * x, 2.0 * x * y
    out[0, P2], out[1, P2] = 2.0 * x * y, s + 2.0 * y * y


@kernel
def coefficients(model: int, p: Array, x: float, y: float, out: Array) -> None:
    """d D / d (coefficients) at a fixed (x, y), into columns of `out` (2, LENGTH), zero elsewhere."""
    if model == PINHOLE:
        return
    if model == OPENCV:
        opencv_coefficients(p, x, y, out)
        return
    s = x * x + y * y
    power = 1.0
    if model == FISHEYE:
        r = math.sqrt(s)
        theta = math.atan(r)
        s = theta * theta
        power = theta / r if r > 1e-8 else 1.0
    else:
        out[0, R0], out[1, R0] = x, y
        out[0, B1], out[0, B2] = x, y
        decentring(x, y, out)
    for i in range(K1, K4 + 1):
        power *= s
        out[0, i], out[1, i] = x * power, y * power


@kernel
def lens_jacobian_point(
    model: int, parameters: Array, x: float, y: float, z: float, d_point: Array, d_parameters: Array
) -> tuple[float, float, bool]:
    """`image_jacobian_point` of every model but film."""
    p = parameters
    d_point[:] = np.nan
    d_parameters[:] = 0.0
    if not z < 0.0:
        return np.nan, np.nan, False
    w = -1.0 / z
    u, v = x * w, y * w
    a, b = affine(p, E, u, v)
    if model == BROWN_INVERSE:
        mx, my, found = undistort(model, p, a, b)
        if not found:
            return np.nan, np.nan, False
        _, _, g00, g01, g10, g11 = distortion_derivatives(model, p, mx, my)
        determinant = g00 * g11 - g01 * g10
        j00, j01, j10, j11 = g11 / determinant, -g01 / determinant, -g10 / determinant, g00 / determinant
        coefficients(model, p, mx, my, d_parameters)
        for i in range(LENGTH):  # implicit function: D(m; k) stays where it is
            dx, dy = d_parameters[0, i], d_parameters[1, i]
            if dx != 0.0 or dy != 0.0:
                d_parameters[0, i], d_parameters[1, i] = -(j00 * dx + j01 * dy), -(j10 * dx + j11 * dy)
    else:
        if not a * a + b * b <= p[R2_MAX]:
            return np.nan, np.nan, False
        mx, my, j00, j01, j10, j11 = distortion_derivatives(model, p, a, b)
        coefficients(model, p, a, b, d_parameters)
    for i, value in enumerate((u, v, 1.0)):
        d_parameters[0, E + i], d_parameters[1, E + i] = j00 * value, j10 * value
        d_parameters[0, E + 3 + i], d_parameters[1, E + 3 + i] = j01 * value, j11 * value
    for i in range(LENGTH):  # from the measured point to the pixel
        dx, dy = d_parameters[0, i], d_parameters[1, i]
        if dx != 0.0 or dy != 0.0:
            d_parameters[0, i] = p[P] * dx + p[P + 1] * dy
            d_parameters[1, i] = p[P + 3] * dx + p[P + 4] * dy
    for i, value in enumerate((mx, my, 1.0)):
        d_parameters[0, P + i] = d_parameters[1, P + 3 + i] = value
    for i in range(2):
        du = d_parameters[i, E + 2] * p[E] + d_parameters[i, E + 5] * p[E + 3]
        dv = d_parameters[i, E + 2] * p[E + 1] + d_parameters[i, E + 5] * p[E + 4]
        d_point[i, 0], d_point[i, 1] = du * w, dv * w
        d_point[i, 2] = (du * u + dv * v) * w
    column, row = affine(p, P, mx, my)
    inside = (column >= 0.0) & (column < p[COLUMNS]) & (row >= 0.0) & (row < p[ROWS])
    return column, row, inside


@kernel
def image_jacobian_point(
    model: int, parameters: Array, x: float, y: float, z: float, d_point: Array, d_parameters: Array
) -> tuple[float, float, bool]:
    """Pixel of a camera-frame point and its derivatives: (column, row, inside).

    Writes `d_point` (2, 3) by the point and `d_parameters` (2, LENGTH) by the parameter array. Off the pixel
    array the derivatives are still right; where column is NaN they are NaN.
    """
    if model < FILM:
        return lens_jacobian_point(model, parameters, x, y, z, d_point, d_parameters)
    u, v, _ = lens_jacobian_point(lens_model(model), parameters, x, y, z, d_point, d_parameters)
    if np.isnan(u):
        return np.nan, np.nan, False
    return film_jacobian(parameters, u, v, d_point, d_parameters)


@kernel
def interior_derivatives(d_parameters: Array, active: Indices, jacobian: Array, out: Array) -> None:
    """Chain rule from the parameter array to the interior parameters.

    `jacobian` (LENGTH, n) is ``Camera.parameter_jacobian()``, `active` its rows that are not zero.
    Writes `out` (2, n).
    """
    out[:] = 0.0
    for index in active:
        a, b = d_parameters[0, index], d_parameters[1, index]
        for j in range(jacobian.shape[1]):
            out[0, j] += a * jacobian[index, j]
            out[1, j] += b * jacobian[index, j]


@kernel
def image_jacobians(
    model: int,
    parameters: Array,
    points: Array,
    active: Indices,
    jacobian: Array,
    pixels: Array,
    inside: Flags,
    d_points: Array,
    d_interior: Array,
) -> None:
    """`image_jacobian_point` over points (n, 3), with the derivatives by the interior parameters."""
    d_parameters = np.empty((2, LENGTH))
    for i in range(points.shape[0]):
        pixels[i, 0], pixels[i, 1], inside[i] = image_jacobian_point(
            model, parameters, points[i, 0], points[i, 1], points[i, 2], d_points[i], d_parameters
        )
        interior_derivatives(d_parameters, active, jacobian, d_interior[i])
        if np.isnan(pixels[i, 0]):
            d_interior[i] = np.nan


@kernel
def smallest_determinant(model: int, parameters: Array, radius: float, directions: int) -> float:
    """Smallest Jacobian determinant of D on a circle, NaN where D is undefined somewhere on it."""
    smallest = np.inf
    for i in range(directions):
        angle = 2.0 * math.pi * i / directions
        x, y = radius * math.cos(angle), radius * math.sin(angle)
        _, _, a, b, c, d = distortion_derivatives(model, parameters, x, y)
        determinant = a * d - b * c
        if not determinant >= smallest:
            smallest = determinant
        if np.isnan(determinant):
            return np.nan
    return smallest
