"""The forecast of a block's accuracy, and the layers and sections that show what was found beside it."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from stereomate.block.adjustment import BlockAdjustment, adjust_block
from stereomate.block.network import BlockCamera, ImagePoints, Network, Photographs, Points, Positions
from stereomate.block.options import BlockOptions
from stereomate.camera.model import Camera
from stereomate.project.orient_expected import expected_accuracy, expected_finding
from stereomate.project.orient_layers import exaggeration

CAMERA = Camera.from_pixel_pitch("c", (1000, 800), 10.0, 0.01)
HEIGHT, SIGMA_PX, SIGMA_M = 100.0, 0.4, 0.03


def flown(noise: float = 1.0) -> BlockAdjustment:
    """Two strips of four photographs over level ground, straight down, in a square pattern of points."""
    rng = np.random.default_rng(5)
    centres = np.array([[40.0 * k, 48.0 * s, HEIGHT] for s in range(2) for k in range(4)])
    step = 10.0
    x, y = np.meshgrid(np.arange(-50, 171, step), np.arange(-40, 89, step))
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    photo, point, xy = [], [], []
    for k, centre in enumerate(centres):
        pixels, inside = CAMERA.image_from_camera(points - centre)
        seen = np.flatnonzero(inside)
        photo.append(np.full(len(seen), k))
        point.append(seen)
        xy.append(pixels[seen] + rng.normal(0, noise * SIGMA_PX, (len(seen), 2)))
    photo, point, xy = np.concatenate(photo), np.concatenate(point), np.concatenate(xy)
    keep = np.bincount(point, minlength=len(points))[point] >= 2
    used, index = np.unique(point[keep], return_inverse=True)
    network = Network(
        (BlockCamera(CAMERA, free={}),),
        Photographs(
            tuple(f"p{k}" for k in range(8)),
            np.zeros(8, dtype=np.int64),
            centres,
            np.tile(np.eye(3), (8, 1, 1)),
        ),
        Points(tuple(f"t{k}" for k in used), points[used]),
        ImagePoints(photo[keep], index, xy[keep], np.full((int(keep.sum()), 2), SIGMA_PX)),
        None,
        Positions(np.arange(8), centres + rng.normal(0, noise * SIGMA_M, (8, 3)), np.full((8, 3), SIGMA_M)),
        None,
    )
    return adjust_block(network, BlockOptions(robust="none"))


def record_of(result: BlockAdjustment, stated_px: float = SIGMA_PX) -> dict:
    measured = SimpleNamespace(ties=SimpleNamespace(sigma_px=np.full(10, stated_px)))
    found = expected_accuracy(measured, SimpleNamespace(has_datum=True, result=result))
    assert found is not None
    return found


def test_a_block_flown_as_planned_is_as_accurate_as_forecast() -> None:
    result = flown()
    record = record_of(result)
    statistics = result.statistics
    assert statistics is not None
    # What was found is that of the adjustment.
    np.testing.assert_allclose(
        record["found"]["centres_m"], np.median(statistics.photo_sigma[:, :3], axis=0), rtol=1e-6
    )
    for name in ("centres_m", "rotations_deg", "tie_points_m"):
        assert record["ratio"][name] == pytest.approx([1.0] * 3, abs=0.15), name
    assert expected_finding(record) == []
    # By hand: a point of two photographs of base 40 m, sigma_Z = Z/B * Z/c * sigma * sqrt(2) at most, less by
    # more rays, more by the centres.
    plain = HEIGHT / 40.0 * HEIGHT / 1000.0 * SIGMA_PX * math.sqrt(2.0)
    assert 0.4 * plain < record["expected"]["tie_points_m"][2] < 1.5 * plain


def test_a_block_worse_than_planned_is_named_by_axis() -> None:
    """Measured three times worse than stated: the adjustment scales, the forecast does not."""
    record = record_of(flown(noise=3.0))
    assert min(record["ratio"]["tie_points_m"]) > 2.3
    (finding,) = expected_finding(record)
    assert "less accurate than the plan" in finding
    assert "tie points" in finding


def test_without_datum_there_is_no_forecast() -> None:
    measured = SimpleNamespace(ties=SimpleNamespace(sigma_px=np.ones(3)))
    assert expected_accuracy(measured, SimpleNamespace(has_datum=False, result=flown())) is None
    assert expected_finding(None) == []


def test_vectors_are_exaggerated_by_a_round_factor() -> None:
    place = np.array([[0.0, 0.0, 0.0], [1000.0, 10.0, 0.0]])
    assert exaggeration(place, np.array([[0.3, 0.0, 0.0], [0.0, 0.4, 0.0]])) == 200.0
    assert exaggeration(place, np.zeros((2, 3))) == 1.0
    assert exaggeration(place, np.array([[100.0, 0, 0], [0, 0, 0]])) == 1.0
