"""What an undetected error of control, positions, attitudes or priors would do to its own unknowns.

An error ∇ of an observation moves the unknowns by ``Q Aᵀ P e ∇`` (external reliability, Baarda): here by one
of the size of its minimal detectable error, for the unknowns that the observation is of.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stereomate.block.adjustment import BlockAdjustment
from stereomate.block.navigation import groups_of
from stereomate.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Influences:
    """Motions by the minimal detectable error of each coordinate.

    Attributes
    ----------
    control : ndarray, shape (k, 3)
        Of the own point, metres.
    positions, attitudes : ndarray, shape (g, 3, 2)
        Of the own projection centre (metres) and rotation (radians).
    priors : ndarray, shape (q,)
        Of the own unknown, in its unit.
    """

    control: Array
    positions: Array
    attitudes: Array
    priors: Array


def influences(adjustment: BlockAdjustment) -> Influences:
    """Influence of every observation that is not an image point (`Statistics` has those).

    NaN where an error of any size would stay unseen, or the observation took no part.

    Raises
    ------
    InputError
        If the adjustment has no statistics.
    """
    statistics = adjustment.statistics
    if statistics is None:
        raise InputError("must have statistics", field="adjustment")
    solution, cofactors = adjustment.solution, statistics.cofactors
    prepared = solution.prepared
    found = {}
    groups = groups_of(prepared.network, prepared.layout, solution.state)
    for name in ("positions", "attitudes"):
        group, part = groups.get(name), getattr(statistics, name)
        if group is None or part is None:
            found[name] = np.empty((0, 3, 2))
            continue
        k = group.photo
        motion = np.einsum("gab,gib->gai", cofactors.photos[k], group.by_photo)
        if group.columns.shape[1] and cofactors.shared.shape[0]:
            columns = np.maximum(group.columns, 0)
            by_shared = group.by_shared * (group.columns >= 0)[:, None, :]
            cross = np.take_along_axis(cofactors.photo_shared[k], columns[:, None, :], axis=2)
            motion += np.einsum("gas,gis->gai", cross, by_shared)
        motion *= (group.weight * part.minimal_detectable)[:, None, :]
        found[name] = np.stack(
            [np.linalg.norm(motion[:, :3], axis=1), np.linalg.norm(motion[:, 3:], axis=1)], axis=2
        )
    priors = statistics.priors
    own = (1.0 - priors.redundancy[:, 0]) * priors.minimal_detectable[:, 0]
    return Influences(_of_control(adjustment), found["positions"], found["attitudes"], own)


def _of_control(adjustment: BlockAdjustment) -> Array:
    prepared, statistics = adjustment.solution.prepared, adjustment.statistics
    control = prepared.network.control
    assert statistics is not None  # asked before
    if control is None or statistics.control is None:
        return np.empty((0, 3))
    out = np.full(control.xyz.shape, np.nan)
    for i, j in enumerate(control.point.tolist()):
        row = int(prepared.control[j])
        if row < 0:
            continue
        motion = statistics.cofactors.points[j] @ prepared.control_weight[row]
        out[i] = np.linalg.norm(motion, axis=0) * statistics.control.minimal_detectable[i]
    return out


__all__ = ["Influences", "influences"]
