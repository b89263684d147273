"""Cameras of other programs' camera files: one lens in three forms is one camera."""

from __future__ import annotations

import json

import numpy as np
import pytest

from stereomate.errors import FormatError
from stereomate.formats.camera_files import read_camera_file

# Of 400 x 300 pixels: focal lengths 480 and 484 px, principal point at (206, 148) px from the outer corner.
TERMS = {"k1": -0.25, "k2": 0.12, "k3": -0.03, "p1": 0.001, "p2": -0.0004}
OPENSFM = {
    "projection_type": "brown", "width": 400, "height": 300,
    "focal_x": 480 / 400, "focal_y": 484 / 400, "c_x": 6 / 400, "c_y": -2 / 400, **TERMS,
}  # fmt: skip
ORTHORITY = """# comment
"A lens":           # the name
  type: brown
  im_size: [400, 300]
  focal_len: [24.0, 24.2]   # mm
  sensor_size: [20.0, 15.0]
  cx: 0.015
  cy: -0.005
"""
METASHAPE = """<?xml version="1.0" encoding="UTF-8"?>
<calibration>
  <projection>frame</projection>
  <width>400</width>
  <height>300</height>
  <f>484</f>
  <cx>6</cx>
  <cy>-2</cy>
  <b1>-4</b1>
  <date>2024-05-01T00:00:00Z</date>
"""


def expected(points):
    """The lens by hand: x right, y up, z backwards in, pixels out."""
    x, y = points[:, 0] / -points[:, 2], points[:, 1] / points[:, 2]
    r2 = x * x + y * y
    radial = 1 + r2 * (TERMS["k1"] + r2 * (TERMS["k2"] + r2 * TERMS["k3"]))
    p1, p2 = TERMS["p1"], TERMS["p2"]
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.stack([480 * xd + 206, 484 * yd + 148], axis=-1)


@pytest.fixture
def files(tmp_path):
    terms = "".join(f"  {key}: {value}\n" for key, value in TERMS.items())
    # Agisoft exchanges p1 and p2.
    agisoft = {**TERMS, "p1": TERMS["p2"], "p2": TERMS["p1"]}
    tags = "".join(f"  <{key}>{value}</{key}>\n" for key, value in agisoft.items())
    texts = {
        "cameras.json": json.dumps({"A lens": OPENSFM}),
        "int_param.yaml": ORTHORITY + terms,
        "config.yml": "camera:\n  name: A lens\n"
        + (ORTHORITY + terms).split("\n", 2)[2]
        + "ortho:\n  crs:\n",
        "A lens.xml": METASHAPE + tags + "</calibration>\n",
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    return tmp_path


@pytest.mark.parametrize("name", ["cameras.json", "int_param.yaml", "config.yml", "A lens.xml"])
def test_one_lens_in_the_form_of_each_program(files, name):
    found = read_camera_file(files / name)
    (camera,) = found.cameras
    assert (camera.name, camera.size_px) == ("A lens", (400, 300))
    points = np.array([[0.0, 0.0, -1.0], [0.3, -0.2, -1.0], [-0.7, 0.5, -2.0]])
    pixels, inside = camera.image_from_camera(points)
    assert inside.all()
    np.testing.assert_allclose(pixels, expected(points), atol=1e-9)
    assert found.nominal == (not name.endswith("ml") or name == "A lens.xml")
    if not found.nominal:
        assert camera.principal_distance_mm == pytest.approx(24.0)


def test_a_normalised_focal_length_is_of_the_longer_side(tmp_path):
    path = tmp_path / "cameras.yaml"
    path.write_text("fish:\n  type: fisheye\n  im_size: [300, 400]\n  focal_len: 0.5\n  k1: 0.01\n")
    found = read_camera_file(path)
    assert found.nominal
    pixel, _ = found.cameras[0].image_from_camera([0.1, 0.0, -1.0])
    angle = np.arctan(0.1)
    np.testing.assert_allclose(pixel, [150 + 200 * (angle + 0.01 * angle**3), 200.0], atol=1e-9)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.json", '{"version": 1}', "must be a camera of OpenSfM"),
        ("a.json", "[1, 2", "must be JSON"),
        ("a.xml", "<html/>", "must be a calibration or cameras of Metashape"),
        ("a.xml", "<calibration><projection>spherical</projection></calibration>", "frame or fisheye"),
        ("a.yaml", "- a\n- b\n", "must be a table of cameras"),
        ("a.yaml", "", "holds no camera"),
        ("a.yaml", "services:\n  web: 1\n", "must be a camera of orthority"),
        ("a.yaml", "c:\n  type: pinhole\n  focal_len: 1.0\n", r"c.im_size: must be 2 numbers"),
        ("a.yaml", "c:\n  type: spherical\n  im_size: [4, 3]\n  focal_len: 1.0\n", "must be one of pinhole"),
        ("a.toml", "", "must be a file of cameras"),
    ],
)
def test_other_files_are_refused(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises(FormatError, match=message):
        read_camera_file(tmp_path / name)
