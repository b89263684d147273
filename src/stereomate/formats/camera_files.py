"""Files that describe cameras only, as other programs write them.

- OpenSfM and OpenDroneMap: ``cameras.json``, ``camera_models.json``, as in ``reconstruction.json``.
- Agisoft Metashape: the XML of Tools > Camera Calibration > Save, and the sensors of a camera XML.
- orthority: interior parameters as YAML, and ``config.yaml`` of simple-ortho. The YAML is a table of
  tables of numbers and words; other YAML is refused.

None of them says in which unit a focal length is, but that it is that of the sensor size, if one is given.
"""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from stereomate.camera.distortion import (
    BrownDistortion,
    Distortion,
    FisheyeDistortion,
    NoDistortion,
    OpenCVDistortion,
)
from stereomate.camera.model import Camera
from stereomate.errors import FormatError
from stereomate.formats.metashape import camera_of_sensor
from stereomate.formats.opensfm import camera_of_record
from stereomate.formats.text_files import read_text

SUFFIXES: Final = (".json", ".xml", ".yaml", ".yml")

_TYPES: Final = ("pinhole", "brown", "fisheye", "opencv")
_COEFFICIENTS: Final[dict[str, tuple[str, ...]]] = {
    "pinhole": (),
    "brown": ("k1", "k2", "p1", "p2", "k3"),
    "fisheye": ("k1", "k2", "k3", "k4"),
    "opencv": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tx", "ty"),
}
_OPENCV_NAMES: Final = {"tx": "taux", "ty": "tauy"}
_LINE: Final = re.compile(r"(?P<indent> *)(?P<key>[^:#\[\]{}]+?) *:(?: +(?P<value>.*))?")


@dataclass(frozen=True)
class CameraFile:
    """Cameras of a file.

    Attributes
    ----------
    path : Path
    cameras : tuple of Camera
    program : str
        Whose form it is.
    nominal : bool
        Only pixels are known: the millimetres of the cameras are those of a sensor 36 mm wide.
    """

    path: Path
    cameras: tuple[Camera, ...]
    program: str
    nominal: bool


def read_camera_file(path: Path) -> CameraFile:
    """Read a file of cameras; which form it has is told from its suffix.

    Raises
    ------
    FormatError
        If it is none of the forms above, or a camera breaks a rule of its form.
    """
    suffix = path.suffix.lower()
    if suffix == ".json":
        return CameraFile(path, _opensfm(path), "OpenSfM", True)
    if suffix == ".xml":
        return CameraFile(path, _metashape(path), "Metashape", True)
    if suffix in SUFFIXES:
        tables = _interior_tables(path)
        cameras = tuple(_orthority(path, name, record) for name, record in tables.items())
        nominal = not all("sensor_size" in record for record in tables.values())
        return CameraFile(path, cameras, "orthority", nominal)
    raise FormatError(f"must be a file of cameras: {', '.join(SUFFIXES)}", file=path)


def _opensfm(path: Path) -> tuple[Camera, ...]:
    try:
        document = json.loads(read_text(path))
    except json.JSONDecodeError as error:
        raise FormatError(f"must be JSON: {error.msg}", file=path) from error
    if not isinstance(document, dict) or not document:
        raise FormatError("must be cameras of OpenSfM: an object of objects", file=path)
    for name, record in document.items():
        if not isinstance(record, dict) or "projection_type" not in record:
            raise FormatError("must be a camera of OpenSfM, with projection_type", file=path, field=name)
    return tuple(camera_of_record(path, name, record) for name, record in document.items())


def _metashape(path: Path) -> tuple[Camera, ...]:
    try:
        root = ElementTree.fromstring(read_text(path))
    except ElementTree.ParseError as error:
        raise FormatError(f"must be XML: {error}", file=path) from error
    sensors = root.findall("chunk/sensors/sensor")
    if root.tag == "calibration" and root.find("projection") is not None:
        # The form of a camera by itself says the same in other places.
        kind = (root.findtext("projection") or "").strip()
        sensor = ElementTree.Element("sensor", label=path.stem)
        calibration = ElementTree.SubElement(sensor, "calibration", type=kind)
        size = {key: (root.findtext(key) or "").strip() for key in ("width", "height")}
        ElementTree.SubElement(calibration, "resolution", size)
        calibration.extend(root)
        sensors = [sensor]
    cameras = [camera for sensor in sensors if (camera := camera_of_sensor(path, sensor)) is not None]
    if not cameras:
        raise FormatError("must be a calibration or cameras of Metashape", file=path, value=root.tag)
    return tuple(cameras)


def _interior_tables(path: Path) -> dict[str, dict[str, Any]]:
    """The cameras' records; the one of simple-ortho is called ``camera`` and says its name inside."""
    tables = _flat_yaml(path)
    legacy = tables.get("camera", {})
    if "focal_len" in legacy:
        return {str(legacy.get("name", "camera")): legacy}
    for name, record in tables.items():
        if "focal_len" not in record or "type" not in record:
            raise FormatError(
                "must be a camera of orthority: type, im_size, focal_len", file=path, field=name
            )
    return tables


def _flat_yaml(path: Path) -> dict[str, dict[str, Any]]:
    tables: dict[str, dict[str, Any]] = {}
    name = None
    for number, line in enumerate(read_text(path).splitlines(), 1):
        text = re.sub(r"(^|\s)#.*", "", line).rstrip()
        if not text or text == "---":
            continue
        match = _LINE.fullmatch(text)
        key = match["key"].strip("'\" ") if match else ""
        if match is None or (match["indent"] and name is None):
            raise FormatError("must be a table of cameras: name, then keys and values", file=path, value=line)
        if match["indent"]:
            assert name is not None
            tables[name][key] = _scalar(match["value"])
        elif match["value"] or key in tables:
            raise FormatError(f"must be a name of its own and a table, line {number}", file=path, value=line)
        else:
            name, tables[key] = key, {}
    if not tables:
        raise FormatError("holds no camera", file=path)
    return tables


def _scalar(text: str | None) -> Any:
    """A number, a list of numbers, or the text as it is."""
    value = (text or "").strip()
    listed = value.startswith("[") and value.endswith("]")
    try:
        numbers = [float(part) for part in (value[1:-1] if listed else value).split(",")]
    except ValueError:
        return value.strip("'\"")
    return numbers if listed else numbers[0] if len(numbers) == 1 else value


def _orthority(path: Path, name: str, record: Mapping[str, Any]) -> Camera:
    def numbers(key: str, count: int) -> list[float]:
        value = record.get(key)
        listed: list[Any] = value if isinstance(value, list) else [value] * count
        if len(listed) != count or not all(isinstance(v, float) for v in listed):
            raise FormatError(f"must be {count} numbers", file=path, field=f"{name}.{key}", value=value)
        return listed

    kind = record.get("type")
    if kind not in _TYPES:
        raise FormatError(f"must be one of {', '.join(_TYPES)}", file=path, field=f"{name}.type", value=kind)
    columns, rows = (int(v) for v in numbers("im_size", 2))
    focal = numbers("focal_len", 2)
    longer = float(max(columns, rows))
    per_pixel = (1.0 / longer, 1.0 / longer)
    if "sensor_size" in record:
        width, height = numbers("sensor_size", 2)
        per_pixel = (width / columns, height / rows)
    cx, cy = (numbers(key, 1)[0] if key in record else 0.0 for key in ("cx", "cy"))
    return Camera.from_focal_lengths(
        name,
        (columns, rows),
        (focal[0] / per_pixel[0], focal[1] / per_pixel[1]),
        (columns / 2.0 + cx * longer, rows / 2.0 + cy * longer),
        _distortion(kind, {key: numbers(key, 1)[0] for key in _COEFFICIENTS[kind] if key in record}),
        per_pixel[0] * columns if "sensor_size" in record else 36.0,
    )


def _distortion(kind: str, terms: Mapping[str, float]) -> Distortion:
    if kind == "pinhole":
        return NoDistortion()
    if kind == "fisheye":
        return FisheyeDistortion(**terms)
    if kind == "brown":
        return BrownDistortion(**terms)  # type: ignore[arg-type]
    return OpenCVDistortion(**{_OPENCV_NAMES.get(key, key): value for key, value in terms.items()})
