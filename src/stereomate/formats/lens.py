"""A camera as other programs write it: focal lengths and principal point in pixels, OpenCV's coefficients."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from stereomate.camera.distortion import (
    BrownDistortion,
    Distortion,
    FisheyeDistortion,
    NoDistortion,
    OpenCVDistortion,
)
from stereomate.camera.model import Camera
from stereomate.errors import FormatError


@dataclass(frozen=True)
class Lens:
    """Interior orientation in pixels, y down, principal point from the outer corner of the first pixel.

    Attributes
    ----------
    kind : str
        ``pinhole``, ``brown`` or ``fisheye``.
    fx, fy, cx, cy : float
    radial : (k1, k2, k3, k4)
    p1, p2 : float
        In OpenCV's order.
    shear : float
        Coefficient of y in the x coordinate, divided by the focal length.
    """

    kind: Literal["pinhole", "brown", "fisheye"]
    size_px: tuple[int, int]
    fx: float
    fy: float
    cx: float
    cy: float
    radial: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    p1: float = 0.0
    p2: float = 0.0
    shear: float = 0.0

    def camera(self, name: str) -> Camera:
        """The camera as a value; millimetres are nominal (a sensor 36 mm wide)."""
        distortion: Distortion = NoDistortion()
        if self.kind == "fisheye":
            distortion = FisheyeDistortion(*self.radial)
        elif self.kind == "brown":
            k1, k2, k3, k4 = self.radial
            b2 = self.shear
            distortion = BrownDistortion(k1=k1, k2=k2, k3=k3, k4=k4, p1=self.p1, p2=self.p2, b2=b2)
        focal = (self.fx, self.fy)
        return Camera.from_focal_lengths(name, self.size_px, focal, (self.cx, self.cy), distortion)


def lens_of(camera: Camera) -> Lens:
    """The camera in pixels.

    Raises
    ------
    FormatError
        If its distortion or its stored pixels cannot be written that way exactly.
    """
    if camera.deformation is not None:
        raise _not_writable(camera, "Ebner's deformation of film")
    (a00, a01, a02), (a10, a11, a12) = camera.pixel_from_photo
    if camera.projective_per_mm != (0.0, 0.0) or a01 != 0.0 or a10 != 0.0 or not (a00 > 0.0 > a11):
        rule = (
            "has turned, mirrored or sheared pixels (film or rotated storage), which this format cannot hold"
        )
        raise FormatError(rule, field=f"camera {camera.name!r}")
    c = camera.principal_distance_mm
    x0, y0 = camera.principal_point_mm
    size, fx, fy, cx, cy = camera.size_px, c * a00, -c * a11, a02 + a00 * x0, a12 + a11 * y0
    d = camera.distortion
    if isinstance(d, NoDistortion):
        return Lens("pinhole", size, fx, fy, cx, cy)
    if isinstance(d, FisheyeDistortion):
        return Lens("fisheye", size, fx, fy, cx, cy, (d.k1, d.k2, d.k3, d.k4))
    if isinstance(d, OpenCVDistortion):
        rest = (d.k4, d.k5, d.k6, d.s1, d.s2, d.s3, d.s4, d.taux, d.tauy)
        if any(rest):
            raise _not_writable(camera, "rational, prism or tilt terms of OpenCV's full model")
        return Lens("brown", size, fx, fy, cx, cy, (d.k1, d.k2, d.k3, 0.0), d.p1, d.p2)
    if d.convention not in ("opencv", "agisoft") or d.direction != "ideal_to_measured":
        raise _not_writable(camera, f"distortion {d.convention}, {d.direction}")
    if d.units != "normalised" or d.symmetry_mm is not None or d.k0 != 0.0:
        raise _not_writable(camera, "distortion in millimetres, about its own point, or with k0")
    p1, p2 = (d.p1, d.p2) if d.convention == "opencv" else (d.p2, d.p1)
    radial = (d.k1, d.k2, d.k3, d.k4)
    return Lens("brown", size, fx * (1.0 + d.b1), fy, cx, cy, radial, p1, p2, d.b2 / (1.0 + d.b1))


def _not_writable(camera: Camera, what: str) -> FormatError:
    return FormatError(f"has {what}, which this format cannot hold exactly", field=f"camera {camera.name!r}")
