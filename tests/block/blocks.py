"""Small blocks with known truth for the tests of the adjustment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stereomate.block.network import (
    BlockCamera,
    Control,
    ImagePoints,
    Network,
    Photographs,
    Points,
    Positions,
)
from stereomate.camera.distortion import BrownDistortion
from stereomate.camera.model import Camera
from stereomate.geometry.rotations import rotation_from_opk, rotation_from_vector

CAMERA = Camera.from_pixel_pitch(
    "drone", (6000, 4000), 24.0, 0.004, (0.01, -0.02), BrownDistortion(k1=-0.02, k2=0.01, p1=1e-4, p2=-2e-4)
)


@dataclass(frozen=True, eq=False)
class Block:
    """A network and the truth behind it."""

    network: Network
    centres: np.ndarray
    rotations: np.ndarray
    points: np.ndarray


def make_block(
    columns=3,
    rows=3,
    per_photo=40,
    seed=1,
    noise_seed=None,
    sigma=0.5,
    free=None,
    gnss=None,
    control=0,
    control_sigma=0.02,
    start=(1.0, 0.01),
    camera=CAMERA,
    noise=1.0,
):
    """Strips of `columns` photographs at 100 m, 65 % forward and side overlap, tilts of 2°."""
    rng = np.random.default_rng(seed)
    height, width, length = 100.0, 100.0, 66.7
    centres = np.array(
        [[j * 0.35 * width, i * 0.35 * length, height] for j in range(rows) for i in range(columns)], float
    )
    centres += rng.normal(0, 1, centres.shape)
    n = len(centres)
    rotations = rotation_from_opk(rng.normal(0, 0.03, (n, 3)))
    count = n * per_photo // 4
    margin = np.array([width / 2, length / 2, 0.0])
    low, high = centres.min(0) - margin, centres.max(0) + margin
    points = np.column_stack(
        [rng.uniform(low[0], high[0], count), rng.uniform(low[1], high[1], count), rng.normal(0, 5, count)]
    )
    photo, point, xy = [], [], []
    for k in range(n):
        pixels, inside = camera.image_from_camera((points - centres[k]) @ rotations[k])
        seen = np.flatnonzero(inside)
        photo.append(np.full(len(seen), k))
        point.append(seen)
        xy.append(pixels[seen])
    photo, point, xy = np.concatenate(photo), np.concatenate(point), np.concatenate(xy)
    keep = np.bincount(point, minlength=count) >= 2
    number, rows_kept = np.cumsum(keep) - 1, keep[point]
    photo, point, xy, points = photo[rows_kept], number[point[rows_kept]], xy[rows_kept], points[keep]
    chosen = rng.choice(len(points), control, replace=False)
    order = rng.permutation(len(photo))  # observations come in no order
    photo, point, xy = photo[order], point[order], xy[order]
    start_centres = centres + start[0] * rng.normal(0, 1, centres.shape)
    start_rotations = rotation_from_vector(start[1] * rng.normal(0, 1, (n, 3))) @ rotations
    start_points = points + start[0] * rng.normal(0, 1, points.shape)
    # Noise has its own stream: simulations differ in nothing else.
    rng = np.random.default_rng([seed, 77 if noise_seed is None else noise_seed])
    xy = xy + noise * sigma * rng.normal(0, 1, xy.shape)
    positions = ground = None
    if gnss is not None:
        positions = Positions(np.arange(n), centres + noise * gnss * rng.normal(0, 1, centres.shape), gnss)
    if control:
        error = noise * control_sigma * rng.normal(0, 1, (control, 3))
        ground = Control(chosen, points[chosen] + error, control_sigma)
    network = Network(
        (BlockCamera(camera, free or {}),),
        Photographs(tuple(f"p{i}" for i in range(n)), np.zeros(n, int), start_centres, start_rotations),
        Points(tuple(f"t{i}" for i in range(len(points))), start_points),
        ImagePoints(photo, point, xy, sigma),
        ground,
        positions,
    )
    return Block(network, centres, rotations, points)
