"""Many points at a time, written so that the compiler vectorises them."""

from __future__ import annotations

import numpy as np

from stereomate.camera.kernels.film import film_row
from stereomate.camera.kernels.layout import (
    B1,
    B2,
    BROWN,
    BROWN_INVERSE,
    COLUMNS,
    FILM,
    FILM_INVERSE,
    K1,
    K2,
    K3,
    K4,
    P1,
    P2,
    PINHOLE,
    R0,
    R2_MAX,
    ROWS,
    Array,
    E,
    Flags,
    P,
)
from stereomate.camera.kernels.projection import general_point, lens_point
from stereomate.jit import kernel


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
def brown_inverse_row(
    parameters: Array, x: Array, y: Array, z: Array, column: Array, row: Array, inside: Flags
) -> None:
    """`lens_point` of ``BROWN_INVERSE`` over 1-D arrays.

    Three Newton steps without branches, which is one more than film distortion needs; the points that ask for
    more are done again one by one.
    """
    p = parameters
    e0, e1, e2, e3, e4, e5 = p[E], p[E + 1], p[E + 2], p[E + 3], p[E + 4], p[E + 5]
    m0, m1, m2, m3, m4, m5 = p[P], p[P + 1], p[P + 2], p[P + 3], p[P + 4], p[P + 5]
    r0, k1, k2, k3, k4 = p[R0], p[K1], p[K2], p[K3], p[K4]
    p1, p2, b1, b2 = p[P1], p[P2], p[B1], p[B2]
    columns, rows, limit = p[COLUMNS], p[ROWS], p[R2_MAX]
    for i in range(x.shape[0]):
        w = -1.0 / z[i]
        u, v = x[i] * w, y[i] * w
        tx = e0 * u + e1 * v + e2
        ty = e3 * u + e4 * v + e5
        a, b, moved = tx, ty, 0.0
        positive = z[i] < 0.0
        for _ in range(3):
            s = a * a + b * b
            radial = r0 + s * (k1 + s * (k2 + s * (k3 + s * k4)))
            slope = 2.0 * (k1 + s * (2.0 * k2 + s * (3.0 * k3 + s * 4.0 * k4)))
            ab = 2.0 * a * b
            cross = 0.5 * ab * slope + 2.0 * (p1 * b + p2 * a)
            ex = a * radial + p1 * (s + 2.0 * a * a) + p2 * ab + b1 * a + b2 * b - tx
            ey = b * radial + p2 * (s + 2.0 * b * b) + p1 * ab - ty
            j00 = radial + a * a * slope + 6.0 * p1 * a + 2.0 * p2 * b + b1
            j01 = cross + b2
            j11 = radial + b * b * slope + 6.0 * p2 * b + 2.0 * p1 * a
            determinant = j00 * j11 - j01 * cross
            positive = positive & (determinant > 0.0)
            factor = 1.0 / determinant
            dx = (j11 * ex - j01 * ey) * factor
            dy = (j00 * ey - cross * ex) * factor
            a, b = a - dx, b - dy
            moved = dx * dx + dy * dy
        s = a * a + b * b
        c = m0 * a + m1 * b + m2
        r = m3 * a + m4 * b + m5
        done = positive & (s <= limit) & (moved <= 1e-14 * (s + 1e-6))
        column[i], row[i] = c if done else np.inf, r
        inside[i] = done & (c >= 0.0) & (c < columns) & (r >= 0.0) & (r < rows)
    for i in range(x.shape[0]):
        if column[i] == np.inf:
            column[i], row[i], inside[i] = lens_point(BROWN_INVERSE, parameters, x[i], y[i], z[i])


@kernel
def image_from_camera_row(
    model: int, parameters: Array, x: Array, y: Array, z: Array, column: Array, row: Array, inside: Flags
) -> None:
    """`image_from_camera_point` over 1-D contiguous arrays, branched once; writes column, row, inside."""
    if model == PINHOLE:
        pinhole_row(parameters, x, y, z, column, row, inside)
    elif model == BROWN:
        brown_row(parameters, x, y, z, column, row, inside)
    elif model == BROWN_INVERSE:
        brown_inverse_row(parameters, x, y, z, column, row, inside)
    elif model == FILM:
        brown_row(parameters, x, y, z, column, row, inside)
        film_row(parameters, column, row, inside)
    elif model == FILM_INVERSE:
        brown_inverse_row(parameters, x, y, z, column, row, inside)
        film_row(parameters, column, row, inside)
    else:
        for i in range(x.shape[0]):
            column[i], row[i], inside[i] = general_point(model, parameters, x[i], y[i], z[i])
