"""OpenSfM's ``reconstruction.json``: cameras, shots, and the frame they are in.

OpenSfM maps world to camera, ``X_cam = R X + t`` with R an angle-axis vector and camera axes x right, y
down, z forward. Focal lengths and principal point are in units of the longer image side, from its middle.

The trap: OpenSfM itself works topocentrically, east north up about ``reference_lla``. OpenDroneMap's
georeferenced export has the same form, but its centres are projected coordinates minus those of
``reference_lla``, and its axes are those of the grid. Nothing in the file says which. ``gps_position`` of
the shots stays topocentric in both, so positions of the shots tell the two apart wherever the frames differ
by more than the positions do.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.distortion import BrownDistortion, Distortion, FisheyeDistortion
from stereomate.camera.model import Camera
from stereomate.errors import FormatError
from stereomate.frames.crs import WGS84, geodetic_of
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import map_from_tangent
from stereomate.geometry.rotations import rotation_from_vector

Array = NDArray[np.float64]
OpenSfmFrame = Literal["projected", "topocentric"]

# x right, y down, z forward -> x right, y up, z backwards.
_FLIP: Final = np.diag([1.0, -1.0, -1.0])
# One hypothesis must fit the positions this many times better than the other to be believed.
_DECISIVE: Final = 3.0


@dataclass(frozen=True)
class OpenSfmShot:
    """One oriented photograph, in the frame of the file.

    Attributes
    ----------
    name : str
        File name of the photograph.
    centre : (3,) tuple
        Projection centre, metres.
    object_from_camera : ndarray (3, 3)
        Rotation from the camera frame (x right, y up, z backwards) to the axes of the file.
    camera : str
    gps_position : (3,) tuple or None
        Measured position, topocentric about the reference.
    """

    name: str
    centre: tuple[float, float, float]
    object_from_camera: Array
    camera: str
    gps_position: tuple[float, float, float] | None


@dataclass(frozen=True)
class OpenSfmReconstruction:
    """What a ``reconstruction.json`` holds; `reference` is longitude, latitude (degrees), altitude."""

    path: Path
    cameras: Mapping[str, Camera]
    shots: tuple[OpenSfmShot, ...]
    reference: tuple[float, float, float]


@dataclass(frozen=True)
class FrameEvidence:
    """Which frame the centres are in, and how well measured positions fit each hypothesis (rms in metres)."""

    frame: OpenSfmFrame
    rms_topocentric_m: float
    rms_projected_m: float

    @property
    def sentence(self) -> str:
        """The finding in words, for reports."""
        meaning = {
            "projected": "projected coordinates minus those of reference_lla, axes of the grid",
            "topocentric": "topocentric, east north up about reference_lla",
        }[self.frame]
        return (
            f"centres of the reconstruction are {meaning}: measured positions fit to "
            f"{self.rms_projected_m:.2f} m rms as projected, {self.rms_topocentric_m:.2f} m as topocentric"
        )


def read_opensfm(path: Path) -> OpenSfmReconstruction:
    """Read a reconstruction; several of them in one file are joined when they share a reference.

    Raises
    ------
    FormatError
        If the file is not such a reconstruction; the key is named.
    """
    parts = _json(path)
    references = {_reference(path, part) for part in parts}
    if len(references) != 1:
        raise FormatError(
            "holds reconstructions of different reference_lla", file=path, value=len(references)
        )
    cameras: dict[str, Camera] = {}
    shots: dict[str, OpenSfmShot] = {}
    for part in parts:
        for name, record in _table(path, part, "cameras").items():
            cameras[name] = camera_of_record(path, name, record)
        for name, record in _table(path, part, "shots").items():
            if name in shots:
                raise FormatError("is in more than one reconstruction", file=path, field=f"shots.{name}")
            shots[name] = _shot(path, name, record, cameras)
    if not shots:
        raise FormatError("holds no shot", file=path)
    return OpenSfmReconstruction(path, cameras, tuple(shots.values()), references.pop())


def frame_of(reconstruction: OpenSfmReconstruction, grid: MapFrame) -> FrameEvidence:
    """Tell from the measured positions which frame the centres are in.

    Parameters
    ----------
    reconstruction : OpenSfmReconstruction
    grid : MapFrame
        The projected CRS the centres would be in.

    Raises
    ------
    FormatError
        If the positions are missing, too few or too rough to tell: both meanings are named.
    """
    measured = [shot for shot in reconstruction.shots if shot.gps_position is not None]
    rule = (
        "does not say whether its centres are topocentric about reference_lla or projected coordinates minus "
        "those of reference_lla"
    )
    hint = (
        'set opensfm_frame = "projected" (georeferenced by OpenDroneMap; crs is then its UTM zone) or '
        '"topocentric" (OpenSfM itself)'
    )
    if len(measured) < 3:
        few = f"{rule}, and only {len(measured)} shots have a gps_position"
        raise FormatError(few, file=reconstruction.path, hint=hint)
    centres = np.array([shot.centre for shot in measured])
    topocentric = np.array([shot.gps_position for shot in measured])
    projected = projected_from_topocentric(reconstruction.reference, topocentric, grid)
    # A common shift (antenna, datum) says nothing about the axes; the pattern does.
    rms = [_pattern_rms(centres - expected) for expected in (topocentric, projected)]
    if min(rms) * _DECISIVE > max(rms):
        close = f"{rule}: measured positions fit to {rms[0]:.3f} m and {rms[1]:.3f} m rms"
        raise FormatError(close, file=reconstruction.path, hint=hint)
    return FrameEvidence("topocentric" if rms[0] < rms[1] else "projected", rms[0], rms[1])


def projected_from_topocentric(reference: tuple[float, float, float], points: Array, grid: MapFrame) -> Array:
    """Topocentric points (n, 3) as projected coordinates minus those of the reference (ellipsoidal)."""
    plain = MapFrame(grid.crs, HeightSystem.ellipsoidal())
    ground = map_from_tangent(tangent_at(reference), plain, points)
    return np.asarray(ground - [*reference_in_map(reference, plain), reference[2]], dtype=np.float64)


def reference_in_map(reference: tuple[float, float, float], grid: MapFrame) -> tuple[float, float]:
    """Easting and northing of the reference, which is on WGS 84."""
    plain = MapFrame(grid.crs, HeightSystem.ellipsoidal())
    x, y, _ = map_from_tangent(tangent_at((*reference[:2], 0.0)), plain, np.zeros(3))
    return float(x), float(y)


def tangent_at(reference: tuple[float, float, float]) -> TangentFrame:
    """The topocentric frame OpenSfM works in: about the reference, on WGS 84."""
    return TangentFrame.at_geodetic(geodetic_of(WGS84), *reference)


def _pattern_rms(difference: Array) -> float:
    plan = (difference - difference.mean(axis=0))[:, :2]
    return float(np.sqrt((plan**2).sum(axis=1).mean()))


def _json(path: Path) -> list[dict[str, Any]]:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise FormatError("does not exist", file=path) from None
    except OSError as error:
        raise FormatError(f"cannot be read: {error.strerror}", file=path) from error
    except UnicodeDecodeError as error:
        raise FormatError("must be UTF-8 text", file=path) from error
    except json.JSONDecodeError as error:
        where = f"line {error.lineno} column {error.colno}"
        raise FormatError(f"must be JSON: {error.msg} at {where}", file=path) from error
    parts = document if isinstance(document, list) else [document]
    if not parts or not all(isinstance(part, dict) and "shots" in part for part in parts):
        raise FormatError("must be a reconstruction of OpenSfM: a list of objects with shots", file=path)
    return parts


def _table(path: Path, part: Mapping[str, Any], key: str) -> dict[str, Any]:
    value = part.get(key)
    if not isinstance(value, dict) or not all(isinstance(record, dict) for record in value.values()):
        raise FormatError("must be an object of objects", file=path, field=key)
    return value


def _reference(path: Path, part: Mapping[str, Any]) -> tuple[float, float, float]:
    record = part.get("reference_lla")
    if not isinstance(record, dict):
        raise FormatError(
            "must be given: without it the reconstruction is nowhere on Earth",
            file=path,
            field="reference_lla",
        )
    keys = ("longitude", "latitude", "altitude")
    first, second, third = _numbers(path, "reference_lla", [record.get(key) for key in keys], 3)
    return first, second, third


def _numbers(path: Path, field: str, value: Any, count: int) -> list[float]:
    good = isinstance(value, Sequence) and len(value) == count
    good = good and all(
        isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v) for v in value
    )
    if not good:
        raise FormatError(f"must be {count} numbers", file=path, field=field, value=value)
    return [float(v) for v in value]


def _shot(path: Path, name: str, record: Mapping[str, Any], cameras: Mapping[str, Camera]) -> OpenSfmShot:
    field = f"shots.{name}"
    rotation = rotation_from_vector(np.array(_numbers(path, f"{field}.rotation", record.get("rotation"), 3)))
    translation = np.array(_numbers(path, f"{field}.translation", record.get("translation"), 3))
    camera = record.get("camera")
    if camera not in cameras:
        raise FormatError(
            "must be one of the cameras of the file", file=path, field=f"{field}.camera", value=camera
        )
    gps = record.get("gps_position")
    position = None
    if gps is not None:
        x, y, z = _numbers(path, f"{field}.gps_position", gps, 3)
        position = (x, y, z)
    cx, cy, cz = (float(value) for value in -rotation.T @ translation)
    object_from_camera = rotation.T @ _FLIP
    object_from_camera.setflags(write=False)
    return OpenSfmShot(name, (cx, cy, cz), object_from_camera, str(camera), position)


def camera_of_record(path: Path, name: str, record: Mapping[str, Any]) -> Camera:
    """A camera of OpenSfM, by its documentation of camera models: a record of ``cameras``.

    Raises
    ------
    FormatError
        If the record is not one, or of a model that is not known here.
    """
    field = f"cameras.{name}"
    kind = record.get("projection_type")

    def number(key: str, default: float | None = None) -> float:
        return _numbers(path, f"{field}.{key}", [record.get(key, default)], 1)[0]

    width, height = (
        int(v) for v in _numbers(path, f"{field}.size", [record.get("width"), record.get("height")], 2)
    )
    distortion: Distortion
    if kind in ("brown", "perspective", "simple_radial", "radial"):
        k1, k2, k3, p1, p2 = (number(key, 0.0) for key in ("k1", "k2", "k3", "p1", "p2"))
        distortion = BrownDistortion(k1=k1, k2=k2, k3=k3, p1=p1, p2=p2)
    elif kind in ("fisheye", "fisheye_opencv"):
        distortion = FisheyeDistortion(*(number(key, 0.0) for key in ("k1", "k2", "k3", "k4")))
    else:
        rule = "must be perspective, simple_radial, radial, brown, fisheye or fisheye_opencv"
        raise FormatError(rule, file=path, field=f"{field}.projection_type", value=kind)
    longer = float(max(width, height))
    shared = "focal" in record
    focal = (
        number("focal" if shared else "focal_x") * longer,
        number("focal" if shared else "focal_y") * longer,
    )
    middle = (width / 2.0 + number("c_x", 0.0) * longer, height / 2.0 + number("c_y", 0.0) * longer)
    return Camera.from_focal_lengths(name, (width, height), focal, middle, distortion)
