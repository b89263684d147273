"""Tags of cameras: EXIF with exact rationals, XMP, and gimbal angles for every attitude."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stereomate.formats.exif import gimbal_from_dji, read_camera_tags
from stereomate.frames.attitude import AttitudeConvention, axes_from_camera

XMP = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:Description drone-dji:AbsoluteAltitude="+321.50" '
    'drone-dji:RelativeAltitude="+80.00" drone-dji:GimbalRollDegree="+0.00" '
    'drone-dji:GimbalYawDegree="+45.00" '
    'drone-dji:GimbalPitchDegree="-60.00" {more}/></x:xmpmeta>'
)


def ifd(order: str, entries: list[tuple[int, int, bytes]], at: int) -> tuple[bytes, int]:
    """A directory at an offset; entries are (tag, type, data), longer data follow it."""
    sizes = {2: 1, 3: 2, 4: 4, 5: 8, 7: 1}
    body, extra = struct.pack(order + "H", len(entries)), b""
    start = at + 2 + 12 * len(entries) + 4
    for tag, kind, data in entries:
        body += struct.pack(order + "HHI", tag, kind, len(data) // sizes[kind])
        if len(data) <= 4:
            body += data.ljust(4, b"\0")
        else:
            body += struct.pack(order + "I", start + len(extra))
            extra += data + b"\0" * (len(data) % 2)
    return body + b"\0\0\0\0" + extra, start + len(extra)


def tiff_tags(order: str) -> bytes:
    def rationals(*pairs: tuple[int, int]) -> bytes:
        return b"".join(struct.pack(order + "II", *pair) for pair in pairs)

    gps = [
        (1, 2, b"S\0"),
        (2, 5, rationals((24, 1), (408166821234 // 1000, 10_000_000), (0, 1))),
        (3, 2, b"E\0"),
        (4, 5, rationals((120, 1), (57, 1), (612571234, 100_000_000))),
        (5, 7, b"\x01"),
        (6, 5, rationals((1234567, 1000))),
    ]
    exif = [
        (0x9003, 2, b"2016:06:23 16:31:59\0"),
        (0x920A, 5, rationals((361, 100))),
        (0xA002, 4, struct.pack(order + "I", 4000)),
        (0xA003, 4, struct.pack(order + "I", 2250)),
        (0xA405, 3, struct.pack(order + "H", 20)),
    ]
    head = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(order + "I", 8)
    main_length = 2 + 12 * 4 + 4 + 8
    exif_block, gps_at = ifd(order, exif, 8 + main_length)
    gps_block, _ = ifd(order, gps, gps_at)
    main, end = ifd(
        order,
        [
            (0x010F, 2, b"DJI\0"),
            (0x0110, 2, b"FC300S\0\0"),
            (0x8769, 4, struct.pack(order + "I", 8 + main_length)),
            (0x8825, 4, struct.pack(order + "I", gps_at)),
        ],
        8,
    )
    assert end == 8 + main_length
    return head + main + exif_block + gps_block


def jpeg(*segments: bytes) -> bytes:
    parts = [b"\xff\xe1" + struct.pack(">H", len(segment) + 2) + segment for segment in segments]
    return b"\xff\xd8" + b"".join(parts) + b"\xff\xda\0\2"


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("container", ["jpeg", "tiff"])
def test_exif_to_the_last_digit(tmp_path, order, container):
    path = tmp_path / "photo"
    data = tiff_tags(order)
    path.write_bytes(jpeg(b"Exif\0\0" + data) if container == "jpeg" else data)
    tags = read_camera_tags(path)
    assert (tags.make, tags.model, tags.size_px) == ("DJI", "FC300S", (4000, 2250))
    assert (tags.focal_length_mm, tags.focal_length_35mm) == (3.61, 20.0)
    assert tags.latitude == pytest.approx(-(24 + 40.8166821 / 60), abs=1e-9)
    assert tags.longitude == pytest.approx(120 + 57 / 60 + 6.12571234 / 3600, abs=1e-12)
    assert tags.altitude == -1234.567
    assert tags.time == 1466699519.0
    assert tags.gimbal is None


def test_xmp_goes_before_exif(tmp_path):
    path = tmp_path / "photo.jpg"
    more = 'drone-dji:GpsLatitude="24.68027804" drone-dji:GpsLongtitude="120.95170160"'
    xmp = b"http://ns.adobe.com/xap/1.0/\0" + XMP.format(more=more).encode()
    path.write_bytes(jpeg(b"Exif\0\0" + tiff_tags("<"), xmp))
    tags = read_camera_tags(path)
    assert (tags.longitude, tags.latitude, tags.altitude) == (120.9517016, 24.68027804, 321.5)
    assert tags.height_above_start == 80.0
    assert tags.gimbal is not None
    assert (tags.gimbal.roll_deg, tags.gimbal.pitch_deg, tags.gimbal.heading_deg) == (0.0, 30.0, 45.0)


def test_calibration_of_the_maker(tmp_path):
    path = tmp_path / "photo.jpg"
    more = (
        'drone-dji:CalibratedFocalLength="3666.66" drone-dji:DewarpFlag="0" '
        'drone-dji:DewarpData="2018-09-07;3657.02,3650.62,-4.03,23.1,-0.267,0.112,0.0009,0.00009,-0.033"'
    )
    path.write_bytes(jpeg(b"http://ns.adobe.com/xap/1.0/\0" + XMP.format(more=more).encode()))
    tags = read_camera_tags(path)
    assert tags.dewarp == (3657.02, 3650.62, -4.03, 23.1, -0.267, 0.112, 0.0009, 0.00009, -0.033)
    assert (tags.calibrated_focal_px, tags.dewarped) == (3666.66, False)


@pytest.mark.parametrize(
    "content", [b"", b"\xff\xd8", b"II*\0\xff\xff\xff\xff", b"text", tiff_tags("<")[:90]]
)
def test_damaged_metadata_are_no_metadata(tmp_path, content):
    path = tmp_path / "photo"
    path.write_bytes(content)
    assert read_camera_tags(path).longitude is None


@settings(deadline=None)
@given(
    roll=st.floats(-180, 180),
    pitch=st.floats(-120, 30),
    yaw=st.floats(-180, 180),
)
def test_gimbal_angles_are_the_same_attitude(roll, pitch, yaw):
    """Against the frames' own gimbal mount: two ways to one rotation."""
    gimbal = gimbal_from_dji(roll, pitch, yaw)
    ours = axes_from_camera(
        (gimbal.roll_deg, gimbal.pitch_deg, gimbal.heading_deg), AttitudeConvention("rph", "local")
    )
    theirs = axes_from_camera((roll, pitch, yaw), AttitudeConvention("rph", "local", mount="gimbal"))
    # The table has six decimals of a degree.
    np.testing.assert_allclose(ours, theirs, atol=1e-7)


def test_roll_of_180_straight_down_is_a_turned_heading():
    gimbal = gimbal_from_dji(180.0, -90.0, 45.0)
    assert (abs(gimbal.roll_deg), gimbal.pitch_deg, gimbal.heading_deg) == (0.0, 0.0, -135.0)


@pytest.mark.real
def test_real_photographs(data_folder):
    jpg = read_camera_tags(data_folder / "brighton_beach" / "images" / "DJI_0024.JPG")
    assert (jpg.model, jpg.focal_length_mm, jpg.altitude) == ("FC300S", 3.61, 198.41)
    assert jpg.gimbal is not None
    assert jpg.gimbal.heading_deg == -140.0
    tif = read_camera_tags(data_folder / "odm_tuniu" / "odm" / "images" / "100_0005_0018.tif")
    assert (tif.longitude, tif.latitude) == (120.9517016, 24.68027804)
    assert tif.size_px == (5472, 3648)
