"""COLMAP models as text and binary: cameras and images.

COLMAP maps world to camera, ``X_cam = R(q) X + t``, with q = (w, x, y, z) and camera axes x right, y down,
z forward. Pixels count from the outer corner of the first one. A COLMAP world is Cartesian and
says nothing of where it is: its frame must be declared, and large coordinates should be written with an
offset.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.model import Camera
from stereomate.errors import FormatError
from stereomate.formats.declared import Declared
from stereomate.formats.lens import Lens, lens_of
from stereomate.formats.orientation_set import OrientationSet
from stereomate.formats.text_files import read_bytes, read_text, write_bytes, write_text
from stereomate.frames.attitude import AttitudeConvention, axes_from_camera, written_from_axes
from stereomate.measurement.database import MeasurementDatabase

Array = NDArray[np.float64]

_CONVENTION: Final = AttitudeConvention("quaternion", "tangent", camera_axes="computer_vision", inverse=True)


def _pinhole(p: Sequence[float], size: tuple[int, int]) -> Lens:
    return Lens("pinhole", size, p[0], p[1], p[2], p[3])


def _opencv(p: Sequence[float], size: tuple[int, int]) -> Lens:
    return Lens("brown", size, p[0], p[1], p[2], p[3], (p[4], p[5], 0.0, 0.0), p[6], p[7])


def _fisheye(p: Sequence[float], size: tuple[int, int]) -> Lens:
    return Lens("fisheye", size, p[0], p[1], p[2], p[3], (p[4], p[5], p[6], p[7]))


def _full(p: Sequence[float], size: tuple[int, int]) -> Lens:
    if any(p[9:12]):
        raise FormatError("has rational terms k4 to k6, which are not read", field="FULL_OPENCV")
    return Lens("brown", size, p[0], p[1], p[2], p[3], (p[4], p[5], p[8], 0.0), p[6], p[7])


@dataclass(frozen=True)
class _Model:
    """A camera model: its number in binary files, its parameters, and how they become a lens."""

    number: int
    parameters: int
    lens: Callable[[Sequence[float], tuple[int, int]], Lens]


_MODELS: Final = {
    "SIMPLE_PINHOLE": _Model(0, 3, lambda p, s: _pinhole([p[0], *p], s)),
    "PINHOLE": _Model(1, 4, _pinhole),
    "SIMPLE_RADIAL": _Model(2, 4, lambda p, s: _opencv([p[0], *p[:3], p[3], 0.0, 0.0, 0.0], s)),
    "RADIAL": _Model(3, 5, lambda p, s: _opencv([p[0], *p[:3], p[3], p[4], 0.0, 0.0], s)),
    "OPENCV": _Model(4, 8, _opencv),
    "OPENCV_FISHEYE": _Model(5, 8, _fisheye),
    "FULL_OPENCV": _Model(6, 12, _full),
    "SIMPLE_RADIAL_FISHEYE": _Model(8, 4, lambda p, s: _fisheye([p[0], *p[:4], 0.0, 0.0, 0.0], s)),
    "RADIAL_FISHEYE": _Model(9, 5, lambda p, s: _fisheye([p[0], *p[:5], 0.0, 0.0], s)),
}


def read_colmap(path: Path, declared: Declared) -> OrientationSet:
    """Read the cameras and images of a COLMAP model folder; binary files first, as COLMAP does.

    Parameters
    ----------
    path : Path
        Folder with images.bin and cameras.bin, or images.txt and cameras.txt.
    declared : Declared
        Frame of the world, and the offset that was taken off its coordinates; `axes` if they are not the
        usual ones of the frame.

    Raises
    ------
    FormatError
        If it is no such model or the frame is not declared.
    """
    place = declared.require_place(path)
    axes = declared.require_axes(path, place)
    binary = (path / "images.bin").is_file()
    suffix = "bin" if binary else "txt"
    files = path / f"cameras.{suffix}", path / f"images.{suffix}"
    cameras = (_cameras_binary if binary else _cameras_text)(files[0])
    images = (_images_binary if binary else _images_text)(files[1])
    if not images:
        raise FormatError("holds no image", file=files[1])
    unknown = [image.camera for image in images if image.camera not in cameras]
    if unknown:
        raise FormatError("names a camera that cameras does not have", file=files[1], value=unknown[0])
    inverse = axes_from_camera(np.array([image.quaternion for image in images]), _CONVENTION)
    # t = -R C with R camera-from-world in COLMAP's own axes; the flip of axes is undone here.
    flip = np.array([1.0, -1.0, -1.0])
    translations = np.array([image.translation for image in images]) * flip
    centres = -np.einsum("nij,nj->ni", inverse, translations)
    return OrientationSet(
        tuple(image.name for image in images),
        centres + declared.offset,
        inverse,
        place,
        axes,
        tuple(cameras[image.camera].name for image in images),
        {camera.name: camera for camera in cameras.values()},
    )


def write_colmap(
    path: Path, orientations: OrientationSet, declared: Declared, binary: bool = False
) -> tuple[str, ...]:
    """Write cameras, images and an empty list of points into a folder; returns notes.

    Raises
    ------
    FormatError
        If a photograph has no camera, or a camera cannot be written as a COLMAP model.
    """
    values = {**orientations.camera_values, **declared.cameras}
    numbers = {name: k for k, name in enumerate(dict.fromkeys(orientations.cameras), 1)}
    records = [(k, *_model_of(path, name, values)) for name, k in numbers.items()]
    q = written_from_axes(orientations.rotations, _CONVENTION)
    centres = orientations.positions - np.array(declared.offset)
    t = -np.einsum("nji,nj->ni", orientations.rotations, centres) * np.array([1.0, -1.0, -1.0])
    images = [
        (k, q[k - 1], t[k - 1], numbers[camera], name)
        for k, (name, camera) in enumerate(zip(orientations.names, orientations.cameras, strict=True), 1)
    ]
    path.mkdir(parents=True, exist_ok=True)
    if binary:
        write_bytes(path / "cameras.bin", _binary_cameras(records))
        write_bytes(path / "images.bin", _binary_images(images))
        write_bytes(path / "points3D.bin", struct.pack("<Q", 0))
    else:
        write_text(path / "cameras.txt", _text_cameras(records))
        write_text(path / "images.txt", _text_images(images))
        write_text(path / "points3D.txt", "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[]\n")
    notes = ["a COLMAP model holds no frame: keep the declaration beside it"]
    largest = float(np.abs(centres).max())
    if largest > 1e5:
        notes.append(
            f"coordinates up to {largest:.0f} m lose digits in single precision: write with an offset"
        )
    return tuple(notes)


@dataclass(frozen=True)
class _Image:
    name: str
    camera: int
    quaternion: tuple[float, ...]
    translation: tuple[float, ...]


def _lens_camera(file: Path, number: int, model: str, size: tuple[int, int], p: Sequence[float]) -> Camera:
    if model not in _MODELS:
        rule = f"must be one of {', '.join(_MODELS)}"
        raise FormatError(rule, file=file, field=f"camera {number}", value=model)
    if len(p) != _MODELS[model].parameters:
        rule = f"needs {_MODELS[model].parameters} parameters for {model}"
        raise FormatError(rule, file=file, field=f"camera {number}", value=len(p))
    return _MODELS[model].lens(p, size).camera(f"camera {number}")


def _rows(file: Path) -> list[list[str]]:
    """Lines that are no comments; empty ones stay, because images without points have one."""
    return [line.split() for line in read_text(file).splitlines() if not line.startswith("#")]


def _cameras_text(file: Path) -> dict[int, Camera]:
    cameras = {}
    for cells in _rows(file):
        if cells:
            try:
                number, size = int(cells[0]), (int(cells[2]), int(cells[3]))
                p = [float(cell) for cell in cells[4:]]
            except (ValueError, IndexError):
                raise FormatError(
                    "must be CAMERA_ID MODEL WIDTH HEIGHT PARAMS", file=file, value=" ".join(cells)
                ) from None
            cameras[number] = _lens_camera(file, number, cells[1], size, p)
    return cameras


def _images_text(file: Path) -> list[_Image]:
    images = []
    rows = _rows(file)
    while rows and not rows[0]:
        rows.pop(0)
    # Two lines an image: the pose, and its points, which may be none at all.
    for cells in rows[::2]:
        if not cells:
            continue
        try:
            numbers = [float(cell) for cell in cells[1:8]]
            camera, name = int(cells[8]), " ".join(cells[9:])
        except (ValueError, IndexError):
            raise FormatError(
                "must be IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME", file=file, value=" ".join(cells[:12])
            ) from None
        images.append(_Image(name, camera, tuple(numbers[:4]), tuple(numbers[4:])))
    return images


class _Bytes:
    """Little-endian values from the bytes of a file, one after the other."""

    def __init__(self, file: Path) -> None:
        self.file, self.data, self.at = file, read_bytes(file), 0

    def take(self, layout: str) -> tuple[float, ...]:
        size = struct.calcsize("<" + layout)
        if self.at + size > len(self.data):
            raise FormatError("is cut off", file=self.file, field=f"byte {self.at}")
        values = struct.unpack_from("<" + layout, self.data, self.at)
        self.at += size
        return values

    def integer(self, layout: str) -> int:
        return int(self.take(layout)[0])

    def name(self) -> str:
        end = self.data.find(b"\0", self.at)
        if end < 0:
            raise FormatError("is cut off in a name", file=self.file, field=f"byte {self.at}")
        text = self.data[self.at : end].decode("utf-8", errors="replace")
        self.at = end + 1
        return text

    def skip(self, size: int) -> None:
        self.at += size
        if self.at > len(self.data):
            raise FormatError("is cut off", file=self.file, field=f"byte {len(self.data)}")


def database_cameras(path: Path) -> dict[str, Camera]:
    """Cameras of the photographs of a COLMAP database, by the names of the photographs.

    Raises
    ------
    FormatError
        If it is no such database, or a camera is of a model that is not read.
    """
    by_number = {model.number: name for name, model in _MODELS.items()}
    with MeasurementDatabase.open(path, read_only=True) as database:
        cameras = {
            number: _lens_camera(
                path, number, by_number.get(row.model, str(row.model)), row.size_px, row.parameters
            )
            for number, row in database.cameras().items()
        }
        return {image.name: cameras[image.camera_id] for image in database.images()}


def _cameras_binary(file: Path) -> dict[int, Camera]:
    source = _Bytes(file)
    cameras = {}
    by_number = {model.number: name for name, model in _MODELS.items()}
    for _ in range(source.integer("Q")):
        number, code = (int(value) for value in source.take("ii"))
        size = (source.integer("Q"), source.integer("Q"))
        name = by_number.get(code)
        if name is None:
            raise FormatError(
                "has a camera model that is not read", file=file, field=f"camera {number}", value=code
            )
        p = source.take(f"{_MODELS[name].parameters}d")
        cameras[number] = _lens_camera(file, number, name, size, p)
    return cameras


def _images_binary(file: Path) -> list[_Image]:
    source = _Bytes(file)
    images = []
    for _ in range(source.integer("Q")):
        source.integer("i")
        numbers = source.take("7d")
        camera = source.integer("i")
        name = source.name()
        source.skip(24 * source.integer("Q"))
        images.append(_Image(name, camera, numbers[:4], numbers[4:]))
    return images


def _model_of(
    path: Path, name: str | None, cameras: Mapping[str, Camera]
) -> tuple[str, tuple[int, int], tuple[float, ...]]:
    camera = cameras.get(name or "")
    if camera is None and len(cameras) == 1 and name is None:
        camera = next(iter(cameras.values()))
    if camera is None:
        raise FormatError(
            "needs the camera of every photograph",
            file=path,
            field="camera",
            value=name,
            hint="declare cameras",
        )
    lens = lens_of(camera)
    focal = (lens.fx, lens.fy, lens.cx, lens.cy)
    k1, k2, k3, k4 = lens.radial
    if lens.shear:
        raise FormatError("has a shear that COLMAP cannot hold", file=path, field=f"camera {camera.name!r}")
    if lens.kind == "pinhole":
        return "PINHOLE", lens.size_px, focal
    if lens.kind == "fisheye":
        return "OPENCV_FISHEYE", lens.size_px, (*focal, k1, k2, k3, k4)
    if k4:
        raise FormatError("has a k4 that COLMAP cannot hold", file=path, field=f"camera {camera.name!r}")
    if k3:
        full = (*focal, k1, k2, lens.p1, lens.p2, k3, 0.0, 0.0, 0.0)
        return "FULL_OPENCV", lens.size_px, full
    return "OPENCV", lens.size_px, (*focal, k1, k2, lens.p1, lens.p2)


_CameraRecord = tuple[int, str, tuple[int, int], tuple[float, ...]]
_ImageRecord = tuple[int, Array, Array, int, str]


def _text_cameras(records: Sequence[_CameraRecord]) -> str:
    lines = ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"]
    for number, model, (width, height), p in records:
        lines.append(f"{number} {model} {width} {height} " + " ".join(repr(float(value)) for value in p))
    return "\n".join(lines) + "\n"


def _text_images(images: Sequence[_ImageRecord]) -> str:
    lines = ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME", "# POINTS2D[] as (X, Y, POINT3D_ID)"]
    for number, q, t, camera, name in images:
        numbers = " ".join(repr(float(value)) for value in (*q, *t))
        lines += [f"{number} {numbers} {camera} {name}", ""]
    return "\n".join(lines) + "\n"


def _binary_cameras(records: Sequence[_CameraRecord]) -> bytes:
    out = [struct.pack("<Q", len(records))]
    for number, model, (width, height), p in records:
        out.append(struct.pack("<iiQQ", number, _MODELS[model].number, width, height))
        out.append(struct.pack(f"<{len(p)}d", *p))
    return b"".join(out)


def _binary_images(images: Sequence[_ImageRecord]) -> bytes:
    out = [struct.pack("<Q", len(images))]
    for number, q, t, camera, name in images:
        out.append(struct.pack("<i7di", number, *q, *t, camera))
        out.append(name.encode("utf-8") + b"\0" + struct.pack("<Q", 0))
    return b"".join(out)
