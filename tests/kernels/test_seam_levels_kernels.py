"""Levels beside seams: the nearest segment of many, found by blocks, is the one that trying all finds."""

from __future__ import annotations

import numpy as np
import pytest

from stereomate.rectify.kernels.seam_levels import level_pixels


def by_trying_all(segments, sides, levels, owner, columns):
    """As `level_pixels`, over whole arrays, a segment at a time."""
    rows, cols = owner.shape
    x, y = np.broadcast_to(columns, (rows, cols)).astype(float), np.arange(rows)[:, None] + 0.5
    nearest, half = np.full((rows, cols), np.inf), np.zeros((rows, cols, levels.shape[2]))
    with np.errstate(invalid="ignore"):
        for (ax, ay, reach_a, bx, by, reach_b), side, level in zip(segments, sides, levels, strict=True):
            w = max(reach_a, reach_b)
            t = ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / ((bx - ax) ** 2 + (by - ay) ** 2)
            t = np.clip(t, 0.0, 1.0)
            d = np.hypot(x - ax - t * (bx - ax), y - ay - t * (by - ay))
            about = (x >= min(ax, bx) - w) & (x <= max(ax, bx) + w)
            about &= (y >= min(ay, by) - w) & (y <= max(ay, by) + w)
            better = np.isin(owner, side) & about & (d < nearest)
            share = np.minimum(d / (reach_a + t * (reach_b - reach_a)), 1.0)
            sign = np.where(owner == side[0], 0.5, -0.5)
            fall = (sign * (1.0 - share * share * (3.0 - 2.0 * share)))[..., None]
            made = fall * (level[0] + t[..., None] * (level[1] - level[0]))
            nearest[better], half[better] = d[better], made[better]
    return half


@pytest.mark.parametrize("reach", [12.0, 60.0])
def test_levels_of_many_segments(reach):
    rng = np.random.default_rng(int(reach))
    rows, cols, count = 70, 90, 60
    start = rng.uniform((-20.0, -20.0), (cols + 20.0, rows + 20.0), (count, 2))
    end = start + rng.normal(0.0, 8.0, (count, 2))
    reaches = rng.uniform(0.5, 1.0, (count, 2)) * reach
    segments = np.column_stack([start, reaches[:, 0], end, reaches[:, 1]])
    sides = np.array([rng.choice(4, 2, replace=False) for _ in range(count)])
    levels = rng.normal(0.0, 0.1, (count, 2, 3))
    owner = rng.integers(-1, 5, (rows // 10, cols // 10)).repeat(10, 0).repeat(10, 1).astype(np.int16)
    straight = (np.arange(cols, dtype=np.float32) + np.float32(0.5))[None]
    moved = (straight + rng.normal(0.0, 2.0, (rows, 1))).astype(np.float32)
    moved[:20, :30] = np.nan  # no ground: a whole block, and single pixels
    moved[rng.random((rows, cols)) < 0.02] = np.nan
    for columns in (straight, moved):
        out = np.full((rows, cols, 3), 9.0, np.float32)
        within = level_pixels(segments, sides, levels, owner, columns, 0.0, 0.0, out)
        expected = by_trying_all(segments, sides, levels, owner, columns)
        np.testing.assert_allclose(out, expected, atol=1e-6)
        assert within == (expected[..., 0] != 0.0).sum() > 0.1 * rows * cols
