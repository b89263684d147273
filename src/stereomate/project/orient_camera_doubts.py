"""Parameters of cameras that a block does not determine, and how that is told."""

from __future__ import annotations

from typing import Final

import numpy as np

from stereomate.block.adjustment import BlockAdjustment
from stereomate.block.orient_network import BlockData
from stereomate.camera.model import Camera

# What is held first where something is not determined.
HELD_FIRST: Final = ("principal_distance", "principal_point")
_NAMES: Final = {
    "principal_distance": ("principal_distance_mm",),
    "principal_point": ("principal_point_x_mm", "principal_point_y_mm"),
}
# In standard deviations of the prior.
_LARGEST_CHANGE: Final = 2.5
_CORRELATED: Final = 0.95
# Share of its prior standard deviation that a parameter keeps when the block says next to nothing about it.
_NOT_IMPROVED: Final = 0.5
# Part of the photographs whose height must be correlated with the principal distance to call it inseparable.
_MOST: Final = 0.5


def undetermined(
    data: BlockData, keys: dict[str, tuple[str, ...]], result: BlockAdjustment
) -> dict[str, str]:
    """Parameters that the block does not determine, with the reason: key -> finding."""
    doubts: dict[str, str] = {}
    statistics = result.statistics
    for k, camera in enumerate(data.cameras):
        free = result.network.cameras[k].free
        for key in keys.get(camera.name, ()):
            reason = ""
            for name in _NAMES.get(key, (key,)):
                place = result.shared_names.index(f"{camera.name}: {name}")
                change = float(result.shared[place]) - _nominal(result.network.cameras[k].camera, name)
                share = abs(change) / free[name]
                if share > _LARGEST_CHANGE:
                    reason = f"left free it runs to {result.shared[place]:.4g}, {share:.1f} times its prior"
                elif not result.converged:
                    reason = "left free the adjustment does not converge"
                elif statistics is None or not statistics.shared_sigma[place] < _NOT_IMPROVED * free[name]:
                    reason = "the block says next to nothing about it"
                elif key == "principal_distance":
                    reason = _with_height(result, place, k)
                if reason:
                    break
            if reason and key in HELD_FIRST and key not in doubts:
                doubts[key] = _finding(key, camera, reason)
    return doubts


def _with_height(result: BlockAdjustment, place: int, camera: int) -> str:
    """Whether principal distance and height of most photographs are as good as one unknown."""
    assert result.statistics is not None  # asked before
    cofactors = result.statistics.cofactors
    mine = result.network.photographs.camera == camera
    height = cofactors.photos[mine, 2, 2] * cofactors.shared[place, place]
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = cofactors.photo_shared[mine, 2, place] / np.sqrt(height)
    over = np.abs(correlation) > _CORRELATED
    if np.count_nonzero(over) < _MOST * np.count_nonzero(mine):
        return ""
    largest = float(correlation[np.argmax(np.abs(correlation))])
    return f"its correlation with their heights is {largest:.3f}"


def _finding(key: str, camera: Camera, reason: str) -> str:
    if key == "principal_distance":
        return (
            f"principal distance of {camera.name} and flying height are not separable in this block "
            f"({reason}): it is held at {camera.principal_distance_mm:g} mm, and an error of it goes into "
            "the heights above ground in proportion"
        )
    return (
        f"principal point of {camera.name}, tilts and positions are not separable in this block "
        f"({reason}): it is held"
    )


def _nominal(camera: Camera, name: str) -> float:
    if name in camera.parameter_names:
        return camera.parameters[camera.parameter_names.index(name)]
    return 0.0
