"""A published self-calibration: its camera and orientations give its image residuals back."""

from __future__ import annotations

import re

import numpy as np
import pytest

from stereomate.camera.distortion import BrownDistortion
from stereomate.camera.model import Camera
from stereomate.geometry.collinearity import camera_from_object
from stereomate.geometry.intersection import Rays, intersect_rays
from stereomate.geometry.rotations import rotation_from_opk


def _rows(path):
    lines = path.read_text().splitlines()
    return np.array(
        [[float(v) for v in line.split(",")[:8]] for line in lines if line and line[0] not in "#"]
    )


def _camera(report: str) -> Camera:
    def value(key: str) -> float:
        return float(re.search(rf"^ +{key}.*\n +Value: +(\S+)", report, re.M).group(1))

    c, px, py, aspect = (value(key) for key in ("Camera Constant", "px -", "py -", "as -"))
    pitch = value("Format height") / value("Image height")
    model = BrownDistortion(
        **{name.lower(): value(f"{name} -") for name in ("K1", "K2", "K3", "P1", "P2")},
        convention="australis",
        direction="measured_to_ideal",
        units="mm",
    )
    # DBAT counts mm from the corner, y down, and stretches x about the principal point before the correction.
    stretched = pitch * (1.0 + aspect)
    affine = ((1 / stretched, 0.0, px / pitch - px / stretched), (0.0, -1 / pitch, 0.0))
    return Camera("c4040z", (2272, 1704), c, (px, -py), affine, model)


@pytest.mark.real
def test_dbat_camera_calibration_residuals(data_folder):
    folder = data_folder / "dbat_camcal/camcaldemo"
    report = (folder / "result/report.txt").read_text()
    stations = {int(row[1]): row[2:8] for row in _rows(folder / "result/camera_stations.txt")}
    marks = np.array(
        [
            [float(v) for v in line.split(",")]
            for line in (folder / "measurements/markpts.txt").read_text().splitlines()
            if line and line[0] != "#"
        ]
    )
    of_photo = np.array([stations[int(i)] for i in marks[:, 0]])
    names, index = np.unique(marks[:, 1].astype(int), return_inverse=True)
    rotations = rotation_from_opk(of_photo[:, 3:])
    camera = _camera(report)
    observed = camera.rays_from_image(marks[:, 2:4])[:, :2]
    rays = Rays(index, of_photo[:, :3], rotations, observed, np.full(len(marks), 1e-4))
    points = intersect_rays(rays).points
    # Four control points were held: they are a unit square.
    for name, fixed in ((1001, (0, 1, 0)), (1002, (1, 1, 0)), (1003, (0, 0, 0)), (1004, (1, 0, 0))):
        points[names == name] = fixed
    computed = camera_from_object(points[index], of_photo[:, :3], rotations)
    pitch = 5.43764 / 1704
    # DBAT's residuals are computed minus observed of the corrected image point, in pixels.
    residuals = (computed[:, :2] / -computed[:, 2:] - observed) * camera.principal_distance_mm / pitch

    rms = float(re.search(r"Overall point RMS: ([\d.]+) pixels", report).group(1))
    assert np.sqrt(np.sum(residuals**2) / len(marks)) == pytest.approx(rms, abs=0.0006)
    error = float(re.search(r"Last error: +([\d.]+)", report).group(1))  # with sigma 0.1 px
    assert np.sqrt(np.sum(residuals**2)) / 0.1 == pytest.approx(error, rel=1e-4)
    largest = np.array(
        [
            [float(v) for v in line.split(",")]
            for line in (folder / "result/top_residuals.txt").read_text().splitlines()
            if line and line[0] != "#"
        ]
    )
    assert len(largest) == 50
    for point, photo, _, _, dx, dy, _ in largest:
        mine = residuals[(marks[:, 1] == point) & (marks[:, 0] == photo)][0]
        # The report prints six digits of the camera: 0.002 px at the corners.
        np.testing.assert_allclose(mine, [dx, dy], rtol=0, atol=0.003)
