"""Ressl's indirect case: the same network adjusted in the grid, equations (2) and (3)."""

from __future__ import annotations

import numpy as np
import pytest
from blocks import make_block

from stereomate.block.adjustment import adjust_block
from stereomate.block.in_grid import compare_in_grid
from stereomate.block.options import BlockOptions
from stereomate.frames.adjusted import effective_scale_at
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import map_from_tangent


@pytest.fixture(scope="module")
def rigorous():
    """A block at UTM's central meridian (scale 0.9996), its datum by control in the tangent frame."""
    block = make_block(columns=4, rows=3, per_photo=60, control=12, control_sigma=0.005, sigma=0.2)
    frame = MapFrame("EPSG:25832", HeightSystem.ellipsoidal())
    tangent = TangentFrame.at_map(frame, np.array([500000.0, 5300000.0, 0.0]))
    return adjust_block(block.network, BlockOptions(statistics=False)), tangent, frame


def test_curvature_alone_moves_the_centres_by_equation_2(rigorous):
    result, tangent, frame = rigorous
    found = compare_in_grid(result, tangent, frame, "P1")
    centres = map_from_tangent(tangent, frame, result.centres)
    control = result.network.control.point
    heights = map_from_tangent(tangent, frame, result.points[control])[:, 2]
    above = centres[:, 2] - heights.mean()
    scale = effective_scale_at(frame, centres[:, :2], float(heights.mean()))
    expected = float(np.mean((scale - 1.0) * above))
    assert expected == pytest.approx(-0.040, abs=0.001)
    assert found.centres[2] == pytest.approx(expected, abs=0.0015)
    assert np.abs(found.points).max() < 0.002


def test_scaled_heights_and_scaled_principal_distance_remove_it(rigorous):
    result, tangent, frame = rigorous
    m2 = compare_in_grid(result, tangent, frame, "M2")
    assert np.abs(m2.centres).max() < 5e-4
    assert m2.points_rms.max() < 5e-4
    m3 = compare_in_grid(result, tangent, frame, "M3")
    assert np.abs(m3.centres).max() < 3e-3
    assert m3.principal_distance_mm == pytest.approx(24.0 / 0.9996, rel=5e-5)


def test_free_principal_distance_with_positions_takes_the_scale(rigorous):
    _, tangent, frame = rigorous
    block = make_block(
        columns=4, rows=3, per_photo=60, control=12, control_sigma=0.005, gnss=0.005, sigma=0.2
    )
    result = adjust_block(block.network, BlockOptions(statistics=False))
    found = compare_in_grid(result, tangent, frame, "P1", {"principal_distance_mm": np.inf})
    held = compare_in_grid(result, tangent, frame, "P1")
    assert found.principal_distance_mm == pytest.approx(24.0 / 0.9996, rel=1e-4)
    assert abs(found.centres[2]) < 0.25 * abs(held.centres[2]) or abs(found.centres[2]) < 0.003
