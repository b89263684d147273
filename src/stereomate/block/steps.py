"""Steps of the refinement loop: how long, and along which path.

A weak block (tilts by poor positions, a bend that the lens could have made) has long steps, and where they
lead the linear model does not hold: its path bends, and residuals bend it further.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from stereomate.block.equations import Step
from stereomate.block.prepared import Prepared
from stereomate.block.unknowns import State, moved
from stereomate.geometry.rotations import rotation_from_vector, skew

# Square of the cosine between steps on one line; ratios of their lengths that call for more or less of them.
_ON_ONE_LINE: Final = 0.98
_SLOW: Final = 0.3
_LARGEST_RATIO: Final = 0.8
# Radians by which a step turns a block as a whole, from which it is more than its tangents.
_COMMON_TURN: Final = 1e-4


def shorter(promised: float, rise: float, share: float) -> float:
    """Part of a step that lowers the cost, where this share of it raised it.

    Along the step the cost is -2 p s + p s² of the linear model and e s⁴ of the path's curvature; e is what
    the rise shows, and the minimum where 4 e s³ = 2 p (1 - s), for a large e.
    """
    excess = (rise + promised * share * (2.0 - share)) / share**4
    if not 0.0 < excess < math.inf or promised <= 0.0:
        return 0.25
    return float(min(0.5, max(0.1, (promised / (2.0 * excess)) ** (1.0 / 3.0) / share)))


def longer(before: Step | None, step: Step) -> float:
    """Part of a step where steps follow each other on one line, each q times the last: 1 / (1 - q).

    So they do along what residuals of a weak block bend more, or less, than the linear model knows.
    """
    if before is None:
        return 1.0
    size = float(np.sum(before.photos[:, 3:] ** 2))
    along = float(np.sum(before.photos[:, 3:] * step.photos[:, 3:]))
    other = float(np.sum(step.photos[:, 3:] ** 2))
    if not along**2 > _ON_ONE_LINE * size * other or not _SLOW < abs(along) / size < 1.0:
        return 1.0
    return 1.0 / (1.0 - min(along / size, _LARGEST_RATIO))


def moved_by(prepared: Prepared, state: State, step: Step, share: float) -> State:
    """A state moved by a part of a step."""
    photos, points, shared = step.photos, step.points, step.shared
    if share != 1.0:
        photos, points, shared = share * photos, share * points, share * shared
    turn = photos[:, 3:].mean(axis=0)
    held = prepared.any_held or not prepared.control_free.all()
    if not held and float(turn @ turn) > _COMMON_TURN**2:
        # What turns and scales the block as a whole goes on spirals, which a linear step leaves.
        places = state.centres - state.centres.mean(axis=0)
        scale = float(np.sum(places * photos[:, :3]) / max(float(np.sum(places**2)), 1e-300))
        bend = (1.0 + scale) * rotation_from_vector(turn) - (1.0 + scale) * np.eye(3) - skew(turn)
        photos = photos.copy()
        photos[:, :3] += places @ bend.T
        points = points + (state.points - state.centres.mean(axis=0)) @ bend.T
    return moved(state, prepared.layout, photos, points, shared)
