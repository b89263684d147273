"""Rays of the photographs in product axes, over the lattice of a window."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.frames.lattice import Lattice
from stereomate.rectify.ground import Ground
from stereomate.rectify.job import RectifyJob

Floats = NDArray[np.float64]


def ray_nodes(job: RectifyJob, ground: Ground) -> Floats:
    """Nodes relative to each projection centre in product axes, at height 0: (photographs, ny, nx, 3)."""
    by_u, by_v = _axes(ground.lattice, job.grid.gsd, 0.5 * sum(ground.height_range))
    normal = ground.lattice.normal
    matrix = np.linalg.inv(np.stack([by_u, by_v, normal], axis=-1))
    return np.stack(
        [
            np.einsum("yxij,yxj->yxi", matrix, ground.lattice.base - np.asarray(p.orientation.centre))
            for p in job.photographs
        ]
    )


def steepest_tangents(rays: Floats, ground: Ground, object_height_m: float) -> Floats:
    """Tangent of the largest nadir angle of each photograph's rays; 1e6 from below."""
    drop = -(rays[..., 2] + ground.height_range[1] + object_height_m)
    across = np.hypot(rays[..., 0], rays[..., 1])
    tangents = np.where(drop > 0.0, across / np.where(drop > 0.0, drop, 1.0), 1e6)
    return np.asarray(tangents.reshape(len(rays), -1).max(axis=1))


def _axes(lattice: Lattice, gsd: float, height: float) -> tuple[Floats, Floats]:
    """Change of the tangent coordinates per map unit along u and along v at a height."""
    points = lattice.base + height * lattice.normal
    spacing = lattice.step * gsd
    return np.gradient(points, spacing, axis=1), -np.gradient(points, spacing, axis=0)
