"""What film does after the lens: Ebner's deformation, and the projective transformation of the scan.

Film coordinates are photo coordinates divided by the spacing of Ebner's grid, so that his nine points are at
-1, 0 and 1.
"""

from __future__ import annotations

import math

import numpy as np

from stereomate.camera.kernels.layout import (
    BROWN,
    BROWN_INVERSE,
    COLUMNS,
    F_R2_MAX,
    FILM_INVERSE,
    HALF,
    LENGTH,
    ROWS,
    A,
    Array,
    F,
    Flags,
    Q,
    Six,
)
from stereomate.jit import kernel

_MEAN = 2.0 / 3.0  # of x² over the nine points


@kernel
def lens_model(model: int) -> int:
    """The model of the lens of a film camera."""
    return BROWN_INVERSE if model == FILM_INVERSE else BROWN


@kernel
def deformed(p: Array, x: float, y: float) -> Six:
    """Film coordinates after deformation, with derivative: (x', y', dx'/dx, dx'/dy, dy'/dx, dy'/dy)."""
    sx, sy, xy = x * x - _MEAN, y * y - _MEAN, x * y
    b1, b2, b3, b4, b5, b6 = p[F], p[F + 1], p[F + 2], p[F + 3], p[F + 4], p[F + 5]
    b7, b8, b9, b10, b11, b12 = p[F + 6], p[F + 7], p[F + 8], p[F + 9], p[F + 10], p[F + 11]
    return (
        x + b1 * x + b2 * y - 2.0 * b3 * sx + b4 * xy + b5 * sy + b7 * x * sy + b9 * y * sx + b11 * sx * sy,
        y - b1 * y + b2 * x + b3 * xy - 2.0 * b4 * sy + b6 * sx + b8 * y * sx + b10 * x * sy + b12 * sx * sy,
        1.0 + b1 - 4.0 * b3 * x + b4 * y + b7 * sy + 2.0 * xy * b9 + 2.0 * b11 * x * sy,
        b2 + b4 * x + 2.0 * b5 * y + 2.0 * b7 * xy + b9 * sx + 2.0 * b11 * sx * y,
        b2 + b3 * y + 2.0 * b6 * x + 2.0 * b8 * xy + b10 * sy + 2.0 * b12 * x * sy,
        1.0 - b1 + b3 * x - 4.0 * b4 * y + b8 * sx + 2.0 * b10 * xy + 2.0 * b12 * sx * y,
    )


@kernel
def pixel_of_film(p: Array, u: float, v: float) -> tuple[float, float, bool]:
    """Pixel of film coordinates before deformation; NaN if there is none.

    And whether it is on the array and in the picture, not on the frame of the film around it.
    """
    x, y, _, _, _, _ = deformed(p, u, v)
    w = 1.0 + p[Q] * x + p[Q + 1] * y
    # Behind the horizon of the scan, or where the polynomial folds the film back, is nowhere.
    w = 1.0 / w if (w > 0.0) & (u * u + v * v <= p[F_R2_MAX]) else np.nan
    column, row = (p[A] * x + p[A + 1] * y + p[A + 2]) * w, (p[A + 3] * x + p[A + 4] * y + p[A + 5]) * w
    inside = (column >= 0.0) & (column < p[COLUMNS]) & (row >= 0.0) & (row < p[ROWS])
    return column, row, inside & (abs(x) <= p[HALF]) & (abs(y) <= p[HALF + 1])


@kernel
def film_of_pixel(p: Array, column: float, row: float) -> tuple[float, float]:
    """Film coordinates before deformation of a pixel position; NaN where there are none."""
    a, b = p[A] - column * p[Q], p[A + 1] - column * p[Q + 1]
    c, d = p[A + 3] - row * p[Q], p[A + 4] - row * p[Q + 1]
    e, f = column - p[A + 2], row - p[A + 5]
    determinant = a * d - b * c
    tx, ty = (d * e - b * f) / determinant, (a * f - c * e) / determinant
    if not 1.0 + p[Q] * tx + p[Q + 1] * ty > 0.0:
        return np.nan, np.nan
    x, y = tx, ty
    for _ in range(20):
        fx, fy, a, b, c, d = deformed(p, x, y)
        determinant = a * d - b * c
        if not determinant > 0.0:
            break
        e, f = fx - tx, fy - ty
        dx, dy = (d * e - b * f) / determinant, (a * f - c * e) / determinant
        x -= dx
        y -= dy
        # Quadratic convergence: after a step of 1e-7 the error is of the order of 1e-14.
        s = x * x + y * y
        if dx * dx + dy * dy <= 1e-14 * (s + 1e-6):
            return (x, y) if s <= p[F_R2_MAX] else (np.nan, np.nan)
    return np.nan, np.nan


@kernel
def film_limit(p: Array, reach: float, radii: int, directions: int) -> float:
    """Radius up to which the deformation is monotonic in every direction; no further than `reach`."""
    for i in range(1, radii + 1):
        radius = reach * i / radii
        for j in range(directions):
            angle = 2.0 * math.pi * j / directions
            _, _, a, b, c, d = deformed(p, radius * math.cos(angle), radius * math.sin(angle))
            if not a * d - b * c > 0.0:
                return reach * (i - 1) / radii
    return reach


@kernel
def film_row(parameters: Array, column: Array, row: Array, inside: Flags) -> None:
    """`pixel_of_film` over 1-D arrays that hold film coordinates and take the pixels; vectorised."""
    p = parameters
    b1, b2, b3, b4, b5, b6 = p[F], p[F + 1], p[F + 2], p[F + 3], p[F + 4], p[F + 5]
    b7, b8, b9, b10, b11, b12 = p[F + 6], p[F + 7], p[F + 8], p[F + 9], p[F + 10], p[F + 11]
    m0, m1, m2, m3, m4, m5 = p[A], p[A + 1], p[A + 2], p[A + 3], p[A + 4], p[A + 5]
    q0, q1, limit, half_x, half_y = p[Q], p[Q + 1], p[F_R2_MAX], p[HALF], p[HALF + 1]
    columns, rows = p[COLUMNS], p[ROWS]
    for i in range(column.shape[0]):
        u, v = column[i], row[i]
        su, sv, uv = u * u - _MEAN, v * v - _MEAN, u * v
        x = u + b1 * u + b2 * v - 2.0 * b3 * su + b4 * uv + sv * (b5 + b7 * u + b11 * su) + b9 * v * su
        y = v - b1 * v + b2 * u + b3 * uv - 2.0 * b4 * sv + su * (b6 + b8 * v + b12 * sv) + b10 * u * sv
        w = 1.0 + q0 * x + q1 * y
        w = 1.0 / w if (w > 0.0) & (u * u + v * v <= limit) else np.nan
        c, r = (m0 * x + m1 * y + m2) * w, (m3 * x + m4 * y + m5) * w
        column[i], row[i] = c, r
        on = (c >= 0.0) & (c < columns) & (r >= 0.0) & (r < rows)
        inside[i] = on & (abs(x) <= half_x) & (abs(y) <= half_y)


@kernel
def film_jacobian(
    p: Array, u: float, v: float, d_point: Array, d_parameters: Array
) -> tuple[float, float, bool]:
    """`pixel_of_film` with derivatives: those of the film coordinates in place become those of the pixel.

    `d_point` (2, 3) and `d_parameters` (2, LENGTH) as `image_jacobian_point` writes them.
    """
    x, y, j00, j01, j10, j11 = deformed(p, u, v)
    w = 1.0 + p[Q] * x + p[Q + 1] * y
    column, row, inside = pixel_of_film(p, u, v)
    g00, g01 = (p[A] - column * p[Q]) / w, (p[A + 1] - column * p[Q + 1]) / w
    g10, g11 = (p[A + 3] - row * p[Q]) / w, (p[A + 4] - row * p[Q + 1]) / w
    h00, h01, h10, h11 = (
        g00 * j00 + g01 * j10,
        g00 * j01 + g01 * j11,
        g10 * j00 + g11 * j10,
        g10 * j01 + g11 * j11,
    )
    for i in range(3):
        dx, dy = d_point[0, i], d_point[1, i]
        d_point[0, i], d_point[1, i] = h00 * dx + h01 * dy, h10 * dx + h11 * dy
    for i in range(LENGTH):
        dx, dy = d_parameters[0, i], d_parameters[1, i]
        if dx != 0.0 or dy != 0.0:
            d_parameters[0, i], d_parameters[1, i] = h00 * dx + h01 * dy, h10 * dx + h11 * dy
    sx, sy, xy = u * u - _MEAN, v * v - _MEAN, u * v
    by_x = (u, v, -2.0 * sx, xy, sy, 0.0, u * sy, 0.0, v * sx, 0.0, sx * sy, 0.0)
    by_y = (-v, u, xy, -2.0 * sy, 0.0, sx, 0.0, v * sx, 0.0, u * sy, 0.0, sx * sy)
    for i in range(12):
        d_parameters[0, F + i] = g00 * by_x[i] + g01 * by_y[i]
        d_parameters[1, F + i] = g10 * by_x[i] + g11 * by_y[i]
    for i, value in enumerate((x, y, 1.0)):
        d_parameters[0, A + i] = d_parameters[1, A + 3 + i] = value / w
    for i, value in enumerate((x, y)):
        d_parameters[0, Q + i], d_parameters[1, Q + i] = -column * value / w, -row * value / w
    return column, row, inside
