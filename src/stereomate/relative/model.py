"""The model of an oriented pair: its points, how flat they lie, and the critical cylinder."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stereomate.relative.pair import Correspondences, RelativePose

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CriticalCylinder:
    """Circle through both centres' axis that fits the points best, seen along the base.

    In the cross-section perpendicular to the base, y is across and z depth (positive away from the cameras).
    On the circle y² + z² is linear in y and z, the y-parallax of a tilt is that of other elements, and the
    tilt is not determined (Kasper's critical circle; in space the critical cylinder).

    Parameters
    ----------
    centre : (float, float)
        y and z of its axis, in units of the base.
    radius : float
        In units of the base.
    distance : float
        Root mean square distance of the points from it over their mean depth; 0 is critical.
    """

    centre: tuple[float, float]
    radius: float
    distance: float


def model_points(pose: RelativePose, correspondences: Correspondences) -> Array:
    """Points of the model where the rays come closest, seen along the base; shape (n, 3), in bases.

    x along the base, y across it to the left, z depth away from the cameras in the mean viewing direction:
    the axes of a cross-section.
    """
    left = np.column_stack([correspondences.left, -np.ones(len(correspondences))])
    right = np.column_stack([correspondences.right, -np.ones(len(correspondences))])
    right = right @ pose.left_from_right.T
    a, c = np.einsum("ij,ij->i", left, left), np.einsum("ij,ij->i", right, right)
    d = np.einsum("ij,ij->i", left, right)
    lb, rb = left @ pose.base, right @ pose.base
    sine2 = np.maximum(a * c - d * d, 1e-12)
    near_left, near_right = (c * lb - d * rb) / sine2, (d * lb - a * rb) / sine2
    middle = 0.5 * (left * near_left[:, None] + pose.base + right * near_right[:, None])
    view = -(np.array([0.0, 0.0, 1.0]) + pose.left_from_right[:, 2])
    view = view - (view @ pose.base) * pose.base
    length = float(np.linalg.norm(view))
    if length < 1e-9:
        # Cameras looking along the base: any direction across serves as depth.
        view = np.cross(pose.base, np.array([0.0, 1.0, 0.0]))
        length = float(np.linalg.norm(view))
    down = view / length
    axes = np.stack([pose.base, np.cross(pose.base, down), down])
    points: Array = middle @ axes.T
    return points


def critical_cylinder(model: Array) -> CriticalCylinder:
    """Circle through the base's axis fitted to model points (n, 3) of `model_points`."""
    y, z = model[:, 1], model[:, 2]
    depth = float(np.mean(np.abs(z))) or 1.0
    design = np.column_stack([y, z]) / depth
    solution = np.linalg.lstsq(design, (y * y + z * z) / depth, rcond=None)[0]
    centre = solution / 2.0
    radius = float(np.hypot(*centre))
    distance = np.hypot(y - centre[0], z - centre[1]) - radius
    return CriticalCylinder(
        (float(centre[0]), float(centre[1])), radius, float(np.sqrt(np.mean(distance**2))) / depth
    )


def flatness(model: Array) -> float:
    """Root mean square distance of model points (n, 3) from their plane over the mean depth."""
    depth = float(np.mean(np.abs(model[:, 2]))) or 1.0
    centred = model - model.mean(axis=0)
    scatter = np.linalg.svd(centred, compute_uv=False) / np.sqrt(len(model))
    return float(scatter[-1]) / depth
