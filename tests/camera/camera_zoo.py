"""Cameras of every model, for the tests of this folder and of the kernels."""

from __future__ import annotations

from dataclasses import replace

from stereomate.camera.distortion import (
    BrownDistortion,
    Distortion,
    EbnerDeformation,
    FisheyeDistortion,
    NoDistortion,
    OpenCVDistortion,
)
from stereomate.camera.model import Camera

_BROWN = {
    "k0": 2e-3, "k1": -0.264, "k2": 0.101, "k3": -0.026, "k4": 1e-3, "p1": 7e-4,
    "p2": 2.6e-4, "b1": 1e-3, "b2": -2e-3,
}  # fmt: skip
# The same size of distortion for millimetres about c = 24 mm.
_BROWN_MM = {
    "k0": 2e-3, "k1": 2e-4, "k2": -1.5e-7, "k3": 2e-10, "k4": 1e-14, "p1": 3e-5,
    "p2": -1e-5, "b1": 1e-3, "b2": 5e-4,
}  # fmt: skip

DISTORTIONS: dict[str, Distortion] = {
    "pinhole": NoDistortion(),
    "fisheye": FisheyeDistortion(0.01, -0.005, 0.001, -0.0003),
    "opencv14": OpenCVDistortion(
        -0.2, 0.05, 1e-3, -2e-3, 0.01, 0.02, 0.01, 0.003, 1e-3, -1e-3, 2e-3, 5e-4, 0.02, -0.03
    ),
    "opencv8": OpenCVDistortion(0.3, 0.02, 1e-3, -2e-3, 0.01, 0.5, 0.05, 0.003),
    "opencv5": OpenCVDistortion(-0.28, 0.09, 1e-3, -2e-3, 0.01),
}
for _convention in ("opencv", "agisoft", "usgs", "australis"):
    for _direction in ("ideal_to_measured", "measured_to_ideal"):
        for _units, _numbers in (("normalised", _BROWN), ("mm", _BROWN_MM)):
            for _symmetry in (None, (0.3, -0.2)):
                _numbers_signed = {
                    name: -value if _convention == "usgs" and name[0] in "kp" else value
                    for name, value in _numbers.items()
                }
                DISTORTIONS[f"{_convention}-{_direction}-{_units}-{_symmetry is not None}"] = BrownDistortion(
                    **_numbers_signed,
                    convention=_convention,
                    direction=_direction,
                    units=_units,
                    symmetry_mm=_symmetry,
                )


# Cameras whose film is deformed or whose scan is projective: distortion, Ebner's twelve, projective part.
FILMS: dict[str, tuple[str, tuple[float, ...] | None, tuple[float, float]]] = {
    "ebner": (
        "pinhole",
        (0.02, -0.01, 0.015, -0.02, 0.01, 0.02, -0.01, 0.02, 0.01, -0.02, 0.01, 0.01),
        (0, 0),
    ),
    "projective": ("pinhole", None, (2e-4, -3e-4)),
    "ebner-opencv": ("opencv-ideal_to_measured-normalised-True", (0.02, -0.01, *(0.01,) * 10), (1e-4, 2e-4)),
    "ebner-usgs": ("usgs-measured_to_ideal-mm-True", (-0.02, 0.03, *(-0.01,) * 10), (-1e-4, 2e-4)),
}


def camera(name: str, size_px: tuple[int, int] = (4000, 3000)) -> Camera:
    """A camera of 32 x 24 mm, c = 24 mm, with the named distortion."""
    if name in FILMS:
        lens, twelve, projective = FILMS[name]
        deformation = None if twelve is None else EbnerDeformation(11.0, *twelve)
        return replace(camera(lens, size_px), deformation=deformation, projective_per_mm=projective)
    return Camera.from_pixel_pitch(name, size_px, 24.0, 32.0 / size_px[0], (0.1, -0.05), DISTORTIONS[name])
