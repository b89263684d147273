"""Cameras from the `[[camera]]` sections of a project file or of a camera file of its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Final

from pydantic import Field

from stereomate.camera.distortion import (
    BrownDistortion,
    Distortion,
    EbnerDeformation,
    FisheyeDistortion,
    NoDistortion,
    OpenCVDistortion,
)
from stereomate.camera.model import Camera
from stereomate.errors import InputError, ProjectError
from stereomate.project.reading import read_toml, validated
from stereomate.project.schema import COEFFICIENTS, CameraSection, DistortionSection, Section

# Where only pixels are known the millimetres are nominal: the width of a full-frame sensor.
NOMINAL_SENSOR_WIDTH_MM: Final = 36.0
# Pixels of aerial cameras are square; more than this is sensor_mm and size_px in different orders.
_LARGEST_PIXEL_RATIO: Final = 1.1


class CameraFile(Section):
    """A file of cameras only."""

    camera: Annotated[tuple[CameraSection, ...], Field(strict=False, min_length=1)]


def load_cameras(path: Path) -> tuple[Camera, ...]:
    """Cameras of a TOML file with one ``[[camera]]`` table each, as in a project file.

    Raises
    ------
    ProjectError
        Naming file, key, rule and value.
    """
    cameras = []
    for number, section in enumerate(validated(CameraFile, read_toml(path), path).camera, 1):
        cameras.append(camera_from_section(section, path, f"camera[{number}]")[0])
    return tuple(cameras)


def camera_from_section(section: CameraSection, path: Path, field: str) -> tuple[Camera, tuple[str, ...]]:
    """The camera of a section, and what was assumed.

    Raises
    ------
    ProjectError
        If a value breaks a rule of the camera.
    """
    notes: list[str] = []
    pitch = _pixel_pitch(section, path, field, notes)
    distance = section.principal_distance_mm
    if distance is None:
        assert section.principal_distance_px is not None  # the schema asks for one of the two
        distance = section.principal_distance_px * pitch[0]
    try:
        camera = Camera.from_pixel_pitch(
            section.name,
            section.size_px,
            distance,
            pitch,
            section.principal_point_mm or (0.0, 0.0),
            _distortion(section.distortion),
            section.rotation,
            section.mirrored,
        )
    except InputError as error:
        where = f"{field}.{(error.field or '').rsplit(' ', 1)[-1]}".rstrip(".")
        raise ProjectError(error.rule, file=path, field=where, value=error.value) from error
    if section.ebner is not None:
        camera = replace(camera, deformation=EbnerDeformation(**section.ebner.model_dump()))
    if section.principal_point_px is not None:
        x, y = camera.photo_from_image(section.principal_point_px)
        camera = replace(camera, principal_point_mm=(float(x), float(y)))
    if not camera.covers_whole_array():
        notes.append(
            f"the distortion of camera {camera.name} is not monotonic up to the corners: "
            "pixels beyond that are not used"
        )
    return camera, tuple(notes)


def _pixel_pitch(section: CameraSection, path: Path, field: str, notes: list[str]) -> tuple[float, float]:
    columns, rows = section.size_px
    if section.pixel_pitch_mm is not None:
        pitch = section.pixel_pitch_mm
        return pitch if isinstance(pitch, tuple) else (pitch, pitch)
    if section.sensor_mm is None:
        nominal = NOMINAL_SENSOR_WIDTH_MM / columns
        notes.append(
            f"the pixel pitch of camera {section.name} is unknown: millimetres are nominal, for a sensor "
            f"{NOMINAL_SENSOR_WIDTH_MM:g} mm wide (angles and products do not depend on it)"
        )
        return nominal, nominal
    width, height = section.sensor_mm
    pitch = (width / columns, height / rows)
    if max(pitch) / min(pitch) > _LARGEST_PIXEL_RATIO:
        raise ProjectError(
            "must be in the order of size_px: pixels would be "
            f"{pitch[0] * 1e3:.2f} by {pitch[1] * 1e3:.2f} µm",
            file=path,
            field=f"{field}.sensor_mm",
            value=list(section.sensor_mm),
            hint="pixel_pitch_mm = [x, y] states pixels that are not square",
        )
    return pitch


def _distortion(section: DistortionSection | None) -> Distortion:
    if section is None:
        return NoDistortion()
    values = {name: float(getattr(section, name)) for name in COEFFICIENTS[section.model]}
    if section.model == "opencv":
        return OpenCVDistortion(**values)
    if section.model == "fisheye":
        return FisheyeDistortion(**values)
    return replace(
        BrownDistortion(
            convention=section.convention,
            direction=section.direction,
            units=section.units,
            symmetry_mm=section.point_of_symmetry_mm,
        ),
        **values,  # type: ignore[arg-type]
    )
