"""Cross-sections under a projection centre."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stereomate.errors import InputError
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import map_from_tangent, tangent_from_map
from stereomate.terrain.model import HeightModel
from stereomate.terrain.sections import cross_section, section_axes

FRAME = MapFrame("EPSG:32631", HeightSystem.ellipsoidal())
X0, Y0 = 500000.0, 4900000.0
TANGENT = TangentFrame.at_map(FRAME, (X0, Y0, 0.0))


def model(heights: np.ndarray, cell: float = 20.0) -> HeightModel:
    rows, cols = heights.shape
    return HeightModel.from_array(
        heights, (cell, 0.0, X0 - cols * cell / 2, 0.0, -cell, Y0 + rows * cell / 2), FRAME
    )


def test_level_ground_eastward_base() -> None:
    centre = tangent_from_map(TANGENT, FRAME, (X0, Y0, 1700.0))
    section = cross_section(
        model(np.full((300, 300), 200.0)), TANGENT, centre, (800.0, 0.0, 0.0), [0, 0.6, -0.6]
    )
    # the ground falls away from the plane of the centre by y^2 / 2R: 7 cm at 900 m
    np.testing.assert_allclose(section.z, 1500.0 + section.y**2 / 2 / 6.37e6, atol=2e-3)
    np.testing.assert_allclose(section.y, [0.0, 900.0, -900.0], atol=0.1)
    mapped = map_from_tangent(TANGENT, FRAME, section.points)
    np.testing.assert_allclose(mapped[:, 2], 200.0, atol=1e-6)
    # left of a base to the east is north
    assert mapped[1, 1] > Y0 + 890
    np.testing.assert_allclose(mapped[:, 0], X0, atol=1e-3)


def test_points_lie_in_the_plane_and_on_the_ground() -> None:
    x, y = np.meshgrid(np.arange(400), np.arange(400))
    ground = model(300.0 + 90.0 * np.sin(x / 17.0) * np.cos(y / 23.0))
    centre = tangent_from_map(TANGENT, FRAME, (X0 + 300, Y0 - 200, 2100.0))
    base = np.array([500.0, -420.0, 35.0])
    section = cross_section(ground, TANGENT, centre, base, np.linspace(-0.8, 0.8, 41))
    assert section.known.all()
    np.testing.assert_allclose((section.points - centre) @ base / np.linalg.norm(base), 0.0, atol=1e-8)
    np.testing.assert_allclose(section.y / section.z, section.tangents, atol=1e-12)
    mapped = map_from_tangent(TANGENT, FRAME, section.points)
    np.testing.assert_allclose(mapped[:, 2], ground.heights_at(mapped[:, :2]), atol=1e-6)
    assert section.section.shape == (41, 2)


def test_axes() -> None:
    axes = section_axes(TANGENT, (0.0, 0.0, 1000.0), (300.0, 400.0, 50.0))
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(axes[1], [-0.8, 0.6, 0.0], atol=1e-6)
    assert axes[2, 2] < -0.99
    for base in ((0.0, 0.0, 0.0), (0.0, 0.0, 5.0)):
        with pytest.raises(InputError, match="base: must be neither zero nor vertical"):
            section_axes(TANGENT, (0.0, 0.0, 1000.0), base)
    with pytest.raises(InputError, match="tangents: must be finite"):
        cross_section(model(np.zeros((9, 9))), TANGENT, (0, 0, 1000.0), (1.0, 0, 0), [np.nan])


def test_water_is_unknown() -> None:
    heights = np.full((300, 300), 200.0)
    heights[:120] = np.nan  # north
    centre = tangent_from_map(TANGENT, FRAME, (X0, Y0, 1700.0))
    section = cross_section(model(heights), TANGENT, centre, (800.0, 0.0, 0.0), [-0.6, 0.0, 0.6])
    np.testing.assert_array_equal(section.known, [True, True, False])


@pytest.mark.real
def test_ngi_section(data_folder: Path) -> None:
    """The section under 0182, against heights read straight down at the same places."""
    heights = HeightSystem.undeclared()
    dem = HeightModel.open(data_folder / "ngi_strip05/dem.tif", heights)
    tangent = TangentFrame.at_map(dem.frame, (-55094.504, -3727407.037, 0.0))
    centres = tangent_from_map(
        tangent, dem.frame, [(-55094.504, -3727407.037, 5258.308), (-57710.435, -3727433.893, 5256.765)]
    )
    section = cross_section(dem, tangent, centres[0], centres[1] - centres[0], [0.0, 0.5, -0.5])
    assert section.known.all()
    mapped = map_from_tangent(tangent, dem.frame, section.points)
    np.testing.assert_allclose(mapped[:, 2], dem.heights_at(mapped[:, :2]), atol=1e-6)
    assert (np.abs(section.z - 4900.0) < 300.0).all()
