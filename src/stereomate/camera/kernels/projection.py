"""One point at a time: camera frame to pixel and back."""

from __future__ import annotations

import numpy as np

from stereomate.camera.kernels.distortion import brown, fisheye, opencv, undistort
from stereomate.camera.kernels.film import film_of_pixel, lens_model, pixel_of_film
from stereomate.camera.kernels.layout import (
    BROWN,
    BROWN_INVERSE,
    COLUMNS,
    E_INV,
    FILM,
    FISHEYE,
    OPENCV,
    P_INV,
    PINHOLE,
    R2_MAX,
    ROWS,
    Array,
    E,
    Flags,
    P,
)
from stereomate.jit import kernel


@kernel
def affine(p: Array, at: int, x: float, y: float) -> tuple[float, float]:
    return p[at] * x + p[at + 1] * y + p[at + 2], p[at + 3] * x + p[at + 4] * y + p[at + 5]


@kernel
def on_array(p: Array, column: float, row: float) -> bool:
    # Without short circuits: smooth code is cheaper than four branches.
    inside: bool = (column >= 0.0) & (column < p[COLUMNS]) & (row >= 0.0) & (row < p[ROWS])
    return inside


@kernel
def pinhole_point(parameters: Array, x: float, y: float, z: float) -> tuple[float, float, bool]:
    """`image_from_camera_point` of a pinhole: no branches, small enough to be inlined and vectorised."""
    p = parameters
    w = -1.0 / z if z < 0.0 else np.nan
    column, row = affine(p, P, x * w, y * w)
    return column, row, on_array(p, column, row)


@kernel
def brown_point(parameters: Array, x: float, y: float, z: float) -> tuple[float, float, bool]:
    """`image_from_camera_point` of Brown's model, ideal to measured."""
    p = parameters
    w = -1.0 / z if z < 0.0 else np.nan
    u, v = affine(p, E, x * w, y * w)
    if not u * u + v * v <= p[R2_MAX]:
        return np.nan, np.nan, False
    u, v = brown(p, u, v)
    column, row = affine(p, P, u, v)
    return column, row, on_array(p, column, row)


@kernel
def lens_point(model: int, parameters: Array, x: float, y: float, z: float) -> tuple[float, float, bool]:
    """`image_from_camera_point` of every model but film."""
    p = parameters
    if not z < 0.0:
        return np.nan, np.nan, False
    u, v = x / -z, y / -z
    if model != PINHOLE:
        u, v = affine(p, E, u, v)
        if model == BROWN_INVERSE:
            u, v, found = undistort(model, p, u, v)
            if not found:
                return np.nan, np.nan, False
        else:
            if not u * u + v * v <= p[R2_MAX]:
                return np.nan, np.nan, False
            if model == OPENCV:
                u, v = opencv(p, u, v)
            elif model == FISHEYE:
                u, v = fisheye(p, u, v)
            else:
                u, v = brown(p, u, v)
    column, row = affine(p, P, u, v)
    return column, row, on_array(p, column, row)


@kernel
def general_point(model: int, parameters: Array, x: float, y: float, z: float) -> tuple[float, float, bool]:
    """`image_from_camera_point` of every model."""
    if model >= FILM:
        u, v, _ = lens_point(lens_model(model), parameters, x, y, z)
        return pixel_of_film(parameters, u, v)
    return lens_point(model, parameters, x, y, z)


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
    if model >= FILM:
        column, row = film_of_pixel(p, column, row)
        if np.isnan(column):
            return np.nan, np.nan, False
        model = lens_model(model)
    x, y = affine(p, P_INV, column, row)
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
    x, y = affine(p, E_INV, x, y)
    return x, y, True


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
