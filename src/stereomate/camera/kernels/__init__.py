"""Kernels of the camera model: camera frame to pixel and back, with derivatives.

All models share one parameter array of `LENGTH` numbers, made by `stereomate.camera.packing`:

- E, 2x3: ideal (u, v, 1) with u = x/-z, v = y/-z to the argument or value of the distortion function D,
  in the axes and about the point of symmetry of its convention;
- D: the distortion function, by model code;
- P, 2x3: from the other side of D to the pixel.

``BROWN``, ``OPENCV`` and ``FISHEYE`` are pixel = P D(E(u, v)); ``BROWN_INVERSE`` (measured to ideal) is
D(P⁻¹ pixel) = E(u, v). ``FILM`` and ``FILM_INVERSE`` are the same two up to film coordinates in place of
pixels, which then are deformed (`film`) and go through a projective transformation. The radius up to which D
is monotonic is part of the array: a point beyond is nowhere.
"""

from stereomate.camera.kernels.distortion import undistort
from stereomate.camera.kernels.jacobian import image_jacobian_point, image_jacobians, interior_derivatives
from stereomate.camera.kernels.layout import (
    BROWN,
    BROWN_INVERSE,
    FILM,
    FILM_INVERSE,
    FISHEYE,
    LENGTH,
    OPENCV,
    PINHOLE,
)
from stereomate.camera.kernels.projection import (
    image_from_camera_point,
    image_from_camera_points,
    ray_from_pixel,
    rays_from_pixels,
)
from stereomate.camera.kernels.rows import image_from_camera_row

__all__ = [
    "BROWN",
    "BROWN_INVERSE",
    "FILM",
    "FILM_INVERSE",
    "FISHEYE",
    "LENGTH",
    "OPENCV",
    "PINHOLE",
    "image_from_camera_point",
    "image_from_camera_points",
    "image_from_camera_row",
    "image_jacobian_point",
    "image_jacobians",
    "interior_derivatives",
    "ray_from_pixel",
    "rays_from_pixels",
    "undistort",
]
