"""OpenSfM reconstructions: cameras, shots, and which of two frames they are in."""

from __future__ import annotations

import json

import numpy as np
import pytest

from stereomate.errors import FormatError
from stereomate.formats.opensfm import frame_of, projected_from_topocentric, read_opensfm
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.geometry.rotations import rotation_from_opk, rotation_from_vector

REFERENCE = (10.9, 47.9, 500.0)
GRID = MapFrame("EPSG:32632", HeightSystem.ellipsoidal())
CAMERA = {"projection_type": "brown", "width": 400, "height": 300, "focal_x": 0.8, "focal_y": 0.8, "k1": -0.1}


def vector_of(rotation: np.ndarray) -> list[float]:
    """Angle-axis of a rotation, by its eigenvector: another way than the one under test."""
    values, vectors = np.linalg.eig(rotation)
    axis = np.real(vectors[:, np.argmin(abs(values - 1.0))])
    angle = np.arccos((np.trace(rotation) - 1.0) / 2.0)
    if not np.allclose(rotation_from_vector(axis * angle), rotation):
        angle = -angle
    return list(axis * angle)


def reconstruction(tmp_path, centres, gps, *, camera=CAMERA, reference=REFERENCE):
    shots = {}
    rotation = np.diag([1.0, -1.0, -1.0]) @ rotation_from_opk([0.02, -0.03, 1.0]).T
    for k, centre in enumerate(centres):
        shot = {"rotation": vector_of(rotation), "translation": list(-rotation @ centre), "camera": "c"}
        if gps is not None:
            shot["gps_position"] = list(gps[k])
        shots[f"p{k}.jpg"] = shot
    lon, lat, alt = reference
    document = {
        "cameras": {"c": camera},
        "shots": shots,
        "reference_lla": {"longitude": lon, "latitude": lat, "altitude": alt},
    }
    path = tmp_path / "reconstruction.json"
    path.write_text(json.dumps([document]))
    return path


@pytest.fixture
def positions():
    """Topocentric positions of a block of 300 m, flown 100 m above the reference."""
    random = np.random.default_rng(5)
    return random.uniform((-150, -150, 95), (150, 150, 105), (12, 3))


def test_centre_and_rotation(tmp_path, positions):
    model = read_opensfm(reconstruction(tmp_path, positions, None))
    for shot, centre in zip(model.shots, positions, strict=True):
        np.testing.assert_allclose(shot.centre, centre, atol=1e-9)
        expected = rotation_from_opk([0.02, -0.03, 1.0])
        np.testing.assert_allclose(shot.object_from_camera, expected, atol=1e-12)


def test_camera_is_opencv_with_a_middle_of_half_a_pixel(tmp_path, positions):
    camera = {**CAMERA, "c_x": 0.01, "c_y": -0.02, "p1": 0.001, "p2": -0.002, "k2": 0.05, "k3": -0.01}
    model = read_opensfm(reconstruction(tmp_path, positions, None, camera=camera))
    point = np.array([0.2, 0.1, -1.0])
    pixels, inside = model.cameras["c"].image_from_camera(point)
    # The formulas of OpenSfM's documentation, y down.
    x, y = 0.2, -0.1
    r2 = x * x + y * y
    radial = 1 - 0.1 * r2 + 0.05 * r2**2 - 0.01 * r2**3
    xd = x * radial + 2 * 0.001 * x * y - 0.002 * (r2 + 2 * x * x)
    yd = y * radial + 0.001 * (r2 + 2 * y * y) + 2 * -0.002 * x * y
    expected = [(0.8 * xd + 0.01) * 400 + 200, (0.8 * yd - 0.02) * 400 + 150]
    assert inside
    np.testing.assert_allclose(pixels, expected, atol=1e-9)


@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_both_frames_are_told_apart(tmp_path, positions, noise):
    random = np.random.default_rng(6)
    gps = positions + random.normal(0.0, noise, positions.shape) + [0.4, -0.3, 1.0]
    topocentric = frame_of(read_opensfm(reconstruction(tmp_path, positions, gps)), GRID)
    assert topocentric.frame == "topocentric"
    centres = projected_from_topocentric(REFERENCE, positions, GRID)
    # The convergence of 1.4 degrees turns the block by metres.
    assert np.abs(centres - positions)[:, :2].max() > 2.0
    projected = frame_of(read_opensfm(reconstruction(tmp_path, centres, gps)), GRID)
    assert projected.frame == "projected"
    assert projected.rms_projected_m < 0.3 < projected.rms_topocentric_m
    assert "axes of the grid" in projected.sentence


def test_projected_coordinates_are_those_of_pyproj(positions):
    pyproj = pytest.importorskip("pyproj")
    crs = "+proj=pipeline +step +inv +proj=topocentric +ellps=WGS84 +lon_0=10.9 +lat_0=47.9 +h_0=500 "
    crs += "+step +inv +proj=cart +ellps=WGS84 +step +proj=utm +zone=32 +ellps=WGS84"
    x, y, z = pyproj.Transformer.from_pipeline(crs).transform(*positions.T)
    x0, y0 = pyproj.Transformer.from_crs(4326, 32632, always_xy=True).transform(10.9, 47.9)
    ours = projected_from_topocentric(REFERENCE, positions, GRID)
    np.testing.assert_allclose(ours, np.stack([x - x0, y - y0, z - 500.0], axis=-1), atol=1e-6)


def test_undecidable_is_refused_with_both_meanings(tmp_path, positions):
    random = np.random.default_rng(7)
    rough = positions + random.normal(0.0, 5.0, positions.shape)
    for gps, centres in ((rough, positions), (None, positions), (positions[:2], positions[:2])):
        model = read_opensfm(reconstruction(tmp_path, centres, gps))
        with pytest.raises(FormatError, match=r'opensfm_frame = "projected".*or "topocentric"'):
            frame_of(model, GRID)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.pop("reference_lla"), "reference_lla: must be given"),
        (
            lambda d: d["shots"]["p0.jpg"].update(rotation=[1, 2]),
            r"shots\.p0\.jpg\.rotation: must be 3 numbers",
        ),
        (lambda d: d["shots"]["p0.jpg"].update(camera="x"), r"p0\.jpg\.camera: must be one of the cameras"),
        (
            lambda d: d["cameras"]["c"].update(projection_type="spherical"),
            "projection_type: must be perspective",
        ),
        (lambda d: d["cameras"]["c"].pop("focal_x"), r"cameras\.c\.focal_x: must be 1 numbers"),
        (lambda d: d.update(shots={}), "holds no shot"),
    ],
)
def test_malformed_reconstructions(tmp_path, positions, change, message):
    path = reconstruction(tmp_path, positions, None)
    document = json.loads(path.read_text())
    change(document[0])
    path.write_text(json.dumps(document))
    with pytest.raises(FormatError, match=message):
        read_opensfm(path)


@pytest.mark.parametrize("text", ["{", "3", "[]", '[{"a": 1}]'])
def test_other_json(tmp_path, text):
    path = tmp_path / "r.json"
    path.write_text(text)
    with pytest.raises(FormatError, match="must be"):
        read_opensfm(path)


@pytest.mark.real
def test_real_reconstruction_is_projected(data_folder):
    model = read_opensfm(data_folder / "odm_tuniu" / "odm" / "opensfm" / "reconstruction.json")
    evidence = frame_of(model, MapFrame("EPSG:32651", HeightSystem.ellipsoidal()))
    assert evidence.frame == "projected"
    assert evidence.rms_projected_m < 0.03
    assert evidence.rms_topocentric_m > 0.4
