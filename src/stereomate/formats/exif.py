"""What a camera wrote into its photograph: EXIF (JPEG, TIFF) with exact rationals, and the XMP packet.

Read without decoding a pixel. GDAL's EXIF tags are rounded to six digits (0.2 m in a latitude written in
minutes), so the tags are read here.

DJI writes the angles of its gimbal into XMP: yaw from true north, pitch -90 when the camera looks down, roll
about the optical axis. They become the roll, pitch and heading of a body whose camera looks down with the
top of the image forward, exactly and for every angle: a roll of 180 at pitch -90 is a heading turned by 180.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np

from stereomate.errors import ImageError
from stereomate.geometry.rotations import rotation_x, rotation_y, rotation_z

_TYPE_SIZES: Final = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4}
_TYPE_CODES: Final = {3: "H", 4: "I", 6: "b", 8: "h", 9: "i", 11: "f", 12: "d", 13: "I"}
_EXIF_IFD: Final = 0x8769
_GPS_IFD: Final = 0x8825
_NAMES: Final = {
    0x010F: "Make",
    0x0110: "Model",
    0x0112: "Orientation",
    0x9003: "DateTimeOriginal",
    0x9291: "SubSecTimeOriginal",
    0x920A: "FocalLength",
    0xA405: "FocalLengthIn35mmFilm",
    0xA002: "PixelXDimension",
    0xA003: "PixelYDimension",
}
_GPS_NAMES: Final = {
    1: "LatitudeRef",
    2: "Latitude",
    3: "LongitudeRef",
    4: "Longitude",
    5: "AltitudeRef",
    6: "Altitude",
}
_GDAL_METADATA: Final = 42112
_XMP_TAG: Final = 700
_XMP_MARK: Final = b"http://ns.adobe.com/xap/1.0/\0"
# Metadata are at the front of a JPEG; a TIFF may keep them at its end.
_LARGEST_SEGMENTS: Final = 4 << 20


@dataclass(frozen=True)
class Gimbal:
    """Roll, pitch, heading in degrees of a body whose camera looks down, top of the image forward."""

    roll_deg: float
    pitch_deg: float
    heading_deg: float


@dataclass(frozen=True)
class CameraTags:
    """What a photograph says about itself; None where it says nothing.

    Attributes
    ----------
    make, model : str
    focal_length_mm, focal_length_35mm : float or None
        As written; the second for a frame 36 mm wide.
    size_px : (int, int) or None
        Size when taken, before any reduction.
    longitude, latitude : float or None
        Degrees; from XMP where it has more digits.
    altitude : float or None
        Metres; "above sea level" by the EXIF standard, above the ellipsoid with most drones.
    height_above_start : float or None
        Metres above the place of take-off (DJI).
    gimbal : Gimbal or None
    time : float or None
        Seconds since 1970, the camera's clock taken as UTC.
    turned : int
        EXIF Orientation: 1 where stored pixels are upright.
    calibrated_focal_px : float or None
        DJI's CalibratedFocalLength at `size_px`.
    dewarp : tuple of 9 floats or None
        DJI's DewarpData at `size_px`: fx, fy, cx, cy, k1, k2, p1, p2, k3; (cx, cy) from the middle.
    dewarped : bool
        The camera has removed its distortion already.
    """

    make: str = ""
    model: str = ""
    focal_length_mm: float | None = None
    focal_length_35mm: float | None = None
    size_px: tuple[int, int] | None = None
    longitude: float | None = None
    latitude: float | None = None
    altitude: float | None = None
    height_above_start: float | None = None
    gimbal: Gimbal | None = None
    time: float | None = None
    turned: int = 1
    calibrated_focal_px: float | None = None
    dewarp: tuple[float, ...] | None = None
    dewarped: bool = False


def read_camera_tags(path: Path) -> CameraTags:
    """Tags of a JPEG or TIFF; empty for other files and for photographs without.

    Raises
    ------
    ImageError
        If the file cannot be read.
    """
    try:
        with path.open("rb") as file:
            tags, xmp = _tags_and_xmp(file)
    except OSError as error:
        raise ImageError(f"cannot be read: {error.strerror}", file=path) from error
    return _camera_tags(tags, _xmp_values(xmp))


def gimbal_from_dji(roll_deg: float, pitch_deg: float, yaw_deg: float) -> Gimbal:
    """DJI's gimbal angles as roll, pitch, heading of a body whose camera looks down, image top forward.

    The camera axis is the gimbal's x axis: ``Rz(yaw) Ry(pitch) Rx(roll) = Rz(ψ) Ry(θ) Rx(r) Ry(-90°)``.
    """
    roll, pitch, yaw = np.deg2rad([roll_deg, pitch_deg, yaw_deg])
    body = rotation_z(yaw) @ rotation_y(pitch) @ rotation_x(roll) @ rotation_y(np.pi / 2)
    heading = math.degrees(math.atan2(body[1, 0], body[0, 0]))
    theta = math.degrees(math.atan2(-body[2, 0], math.hypot(body[0, 0], body[1, 0])))
    bank = math.degrees(math.atan2(body[2, 1], body[2, 2]))
    # Rounded to what the camera writes, so that noise of 1e-15 does not reach a table.
    return Gimbal(round(bank, 6) + 0.0, round(theta, 6) + 0.0, round(heading, 6) + 0.0)


def _tags_and_xmp(file: Any) -> tuple[dict[str, Any], str]:
    head = file.read(4)
    if head[:2] == b"\xff\xd8":
        return _of_jpeg(file)
    if head in (b"II*\0", b"MM\0*"):
        tags, raw = _of_tiff(_FileBytes(file))
        xmp = raw.get(_XMP_TAG, b"")
        if isinstance(raw.get(_GDAL_METADATA), str):
            tags = {**_of_gdal(raw[_GDAL_METADATA]), **tags}
        return tags, bytes(xmp).decode("utf-8", "replace") if isinstance(xmp, bytes | bytearray) else ""
    return {}, ""


def _of_jpeg(file: Any) -> tuple[dict[str, Any], str]:
    tags: dict[str, Any] = {}
    xmp = ""
    file.seek(2)
    data = file.read(_LARGEST_SEGMENTS)
    for marker, segment in _segments(data):
        if marker == 0xE1 and segment.startswith(b"Exif\0\0") and not tags:
            tags = _of_tiff(segment[6:])[0]
        elif marker == 0xE1 and segment.startswith(_XMP_MARK) and not xmp:
            xmp = segment[len(_XMP_MARK) :].decode("utf-8", "replace")
    return tags, xmp


def _segments(data: bytes) -> Iterator[tuple[int, bytes]]:
    at = 0
    while at + 4 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker in (0xDA, 0xD9):
            return
        length = int.from_bytes(data[at + 2 : at + 4], "big")
        yield marker, data[at + 4 : at + 2 + length]
        at += 2 + length


class _FileBytes:
    """A file that can be sliced like bytes: a TIFF is not read whole for its tags."""

    def __init__(self, file: Any) -> None:
        self._file = file

    def __getitem__(self, part: slice) -> bytes:
        start, stop = part.start or 0, part.stop
        self._file.seek(start)
        data: bytes = self._file.read(stop - start)
        return data


def _of_tiff(data: Any) -> tuple[dict[str, Any], dict[int, Any]]:
    """Named tags of a TIFF structure, and the raw ones of its first directory."""
    order = "<" if data[0:2] == b"II" else ">"
    try:
        first = _directory(data, order, struct.unpack(order + "I", data[4:8])[0])
        tags = {_NAMES[tag]: value for tag, value in first.items() if tag in _NAMES}
        if _EXIF_IFD in first:
            exif = _directory(data, order, int(first[_EXIF_IFD]))
            tags |= {_NAMES[tag]: value for tag, value in exif.items() if tag in _NAMES}
        if _GPS_IFD in first:
            gps = _directory(data, order, int(first[_GPS_IFD]))
            tags |= {f"GPS{_GPS_NAMES[tag]}": value for tag, value in gps.items() if tag in _GPS_NAMES}
    except (struct.error, TypeError):
        return {}, {}  # damaged metadata are no metadata; the pixels may be fine
    return tags, first


def _directory(data: Any, order: str, offset: int) -> dict[int, Any]:
    count = struct.unpack(order + "H", data[offset : offset + 2])[0]
    block = data[offset + 2 : offset + 2 + 12 * count]
    values: dict[int, Any] = {}
    for index in range(count):
        tag, kind, number = struct.unpack(order + "HHI", block[12 * index : 12 * index + 8])
        size = _TYPE_SIZES.get(kind, 0) * number
        if size == 0 or size > _LARGEST_SEGMENTS:
            continue
        raw = block[12 * index + 8 : 12 * index + 12]
        if size > 4:
            start = struct.unpack(order + "I", raw)[0]
            raw = data[start : start + size]
        values[tag] = _value(raw[:size], kind, number, order)
    return values


def _value(raw: bytes, kind: int, number: int, order: str) -> Any:
    if kind == 2:
        return raw.split(b"\0")[0].decode("utf-8", "replace").strip()
    if kind in (1, 7):
        return raw[0] if number == 1 else raw
    if kind in (5, 10):
        pairs = struct.unpack(f"{order}{2 * number}{'I' if kind == 5 else 'i'}", raw)
        values = [a / b if b else math.nan for a, b in zip(pairs[::2], pairs[1::2], strict=True)]
    else:
        values = list(struct.unpack(f"{order}{number}{_TYPE_CODES[kind]}", raw))
    return values[0] if number == 1 else values


def _of_gdal(text: str) -> dict[str, Any]:
    """EXIF tags that GDAL kept as text when it converted a JPEG to TIFF (rounded to six digits by it)."""
    wanted = {*_NAMES.values(), *(f"GPS{name}" for name in _GPS_NAMES.values())}
    tags: dict[str, Any] = {}
    for name, value in re.findall(r'<Item name="EXIF_(\w+)">([^<]*)</Item>', text):
        if name not in wanted:
            continue
        numbers = [float(number) for number in re.findall(r"\(([-+0-9.eE]+)\)", value)]
        if numbers:
            tags[name] = numbers[0] if len(numbers) == 1 else numbers
        elif re.fullmatch(r"0x[0-9a-fA-F]{2}", value):
            tags[name] = int(value, 16)
        else:
            tags[name] = int(value) if value.isdigit() else value
    return tags


def _xmp_values(packet: str) -> dict[str, str]:
    """Values of an XMP packet by local name, written as attributes or as elements."""
    values = {name: value for _, name, value in re.findall(r'([\w-]+):(\w+)\s*=\s*"([^"]*)"', packet)}
    values |= {name: value for _, name, value in re.findall(r"<([\w-]+):(\w+)>\s*([^<>]+?)\s*</", packet)}
    return values


def _camera_tags(tags: Mapping[str, Any], xmp: Mapping[str, str]) -> CameraTags:
    latitude = _coordinate(tags.get("GPSLatitude"), tags.get("GPSLatitudeRef"), "S")
    longitude = _coordinate(tags.get("GPSLongitude"), tags.get("GPSLongitudeRef"), "W")
    precise = _number(xmp.get("GpsLatitude")), _number(xmp.get("GpsLongitude", xmp.get("GpsLongtitude")))
    if None not in precise and precise != (0.0, 0.0):
        latitude, longitude = precise
    altitude = _number(tags.get("GPSAltitude"))
    if altitude is not None and tags.get("GPSAltitudeRef") == 1:
        altitude = -altitude
    if "AbsoluteAltitude" in xmp:
        altitude = _number(xmp["AbsoluteAltitude"])
    angles = [_number(xmp.get(f"Gimbal{name}Degree")) for name in ("Roll", "Pitch", "Yaw")]
    gimbal = None
    if angles[0] is not None and angles[1] is not None and angles[2] is not None:
        gimbal = gimbal_from_dji(angles[0], angles[1], angles[2])
    width, height = _number(tags.get("PixelXDimension")), _number(tags.get("PixelYDimension"))
    return CameraTags(
        make=str(tags.get("Make", "")),
        model=str(tags.get("Model", "")),
        focal_length_mm=_positive(tags.get("FocalLength")),
        focal_length_35mm=_positive(tags.get("FocalLengthIn35mmFilm")),
        size_px=(int(width), int(height)) if width and height else None,
        longitude=longitude,
        latitude=latitude,
        altitude=altitude,
        height_above_start=_number(xmp.get("RelativeAltitude")),
        gimbal=gimbal,
        time=_time(tags),
        turned=int(_number(tags.get("Orientation")) or 1),
        calibrated_focal_px=_positive(xmp.get("CalibratedFocalLength")),
        dewarp=_dewarp(xmp.get("DewarpData", "")),
        dewarped=xmp.get("DewarpFlag") == "1",
    )


def _coordinate(value: Any, reference: Any, negative: str) -> float | None:
    if not isinstance(value, list) or len(value) != 3 or not all(math.isfinite(part) for part in value):
        return None
    degrees = float(value[0] + value[1] / 60.0 + value[2] / 3600.0)
    return -degrees if str(reference).upper().startswith(negative) else degrees


def _number(value: Any) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError):
        return None
    return number if math.isfinite(number) else None


def _positive(value: Any) -> float | None:
    number = _number(value)
    return number if number is not None and number > 0.0 else None


def _time(tags: Mapping[str, Any]) -> float | None:
    try:
        taken = datetime.strptime(str(tags.get("DateTimeOriginal", "")), "%Y:%m:%d %H:%M:%S")
    except ValueError:
        return None
    fraction = str(tags.get("SubSecTimeOriginal", "")).strip()
    return taken.replace(tzinfo=UTC).timestamp() + (float(f"0.{fraction}") if fraction.isdigit() else 0.0)


def _dewarp(text: str) -> tuple[float, ...] | None:
    numbers = [_number(part) for part in text.rpartition(";")[2].split(",")]
    if len(numbers) != 9 or any(number is None for number in numbers):
        return None
    return tuple(number for number in numbers if number is not None)
