"""A photograph that too few observations determine is left out of an orientation, and named."""

from __future__ import annotations

import math

import numpy as np
import pytest

from stereomate.block.options import BlockOptions
from stereomate.block.orient_network import BlockData, assemble
from stereomate.block.start import KnownPoints
from stereomate.camera.model import Camera
from stereomate.measurement.tracks import TiePoints
from stereomate.project.orient_adjust import (
    UNDETERMINED,
    Approximate,
    adjust_assembled,
    without_undetermined,
)

CAMERA = Camera.from_pixel_pitch("c", (1000, 1000), 10.0, 0.01)


def block(few: int) -> tuple[BlockData, Approximate]:
    """Four photographs at 100 m with control; the last one has `few` tie points."""
    rng = np.random.default_rng(8)
    centres = np.array([[0, 0, 100.0], [30, 0, 100], [0, 30, 100], [30, 30, 100]])
    points = np.column_stack([rng.uniform(0, 30, (60, 2)), rng.normal(0, 5, 60)])
    rows = [
        (j, k, CAMERA.image_from_camera(points[j : j + 1] - centres[k])[0][0] + rng.normal(0, 0.1, 2))
        for j in range(60)
        for k in range(4)
        if k < 3 or 10 <= j < 10 + few
    ]
    point, photo = (np.array([row[i] for row in rows]) for i in (0, 1))
    pixels = np.array([row[2] for row in rows])
    # The first ten are control points, which the last photograph does not show.
    ties, measured = point >= 10, (point < 10) & (photo < 3)
    names = tuple(f"p{k}" for k in range(4))
    m = int(ties.sum())
    data = BlockData(
        names,
        np.zeros(4, dtype=np.int64),
        (CAMERA,),
        {"c": ()},
        TiePoints(names, point[ties], photo[ties], pixels[ties], np.full(m, 0.1), np.full(m, -1)),
        KnownPoints(
            tuple(f"g{k}" for k in range(10)),
            points[:10],
            np.full((10, 3), 0.02),
            point[measured],
            photo[measured],
            pixels[measured],
        ),
        np.zeros(10, dtype=np.bool_),
        np.full(int(measured.sum()), 0.1),
        np.full((4, 3), math.nan),
        (1.0, 1.0, 1.0),
        np.full((4, 3, 3), math.nan),
        None,
    )
    return data, Approximate(centres + 0.5, np.tile(np.eye(3), (4, 1, 1)), points.copy(), True)


@pytest.mark.parametrize(("few", "left_out"), [(2, {3: UNDETERMINED}), (20, {})])
def test_photograph_of_two_points_is_left_out(few: int, left_out: dict[int, str]) -> None:
    data, at = block(few)
    options = BlockOptions(robust="snooping")
    before = adjust_assembled(data, at, options)
    assert before[1].determined_photos.tolist() == [True, True, True, not left_out]
    found: dict[int, str] = {}
    assembled, result = without_undetermined(data, at, options, before, found)
    assert found == left_out
    assert assembled.photos.tolist() == [k for k in range(4) if k not in left_out]
    assert result.converged
    assert result.determined_photos.all()
    assert result.statistics is not None
    assert np.isfinite(result.statistics.photo_sigma).all()
    truth = np.array([[0, 0, 100.0], [30, 0, 100], [0, 30, 100], [30, 30, 100]])[assembled.photos]
    assert np.abs(result.centres - truth).max() < 0.3
    # What came in is untouched.
    assert np.isfinite(at.centres).all()
    assert len(assemble(data, at.centres, at.rotations, at.points).photos) == 4
