"""What unknown shifts, drifts, lever arms and misalignments take of a motion of the photographs.

A motion of the whole block that these unknowns follow is not seen by positions and attitudes: the datum is
open by it, and these unknowns move along with the block.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from stereomate.block.navigation import Group, groups_of
from stereomate.block.network import Network
from stereomate.block.unknowns import Layout, State, moved

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]


def absorbed(network: Network, layout: Layout, group: Group, name: str, motion: Array) -> tuple[Array, Array]:
    """A motion of what a group observes, as far as its unknowns without a prior can follow it.

    Parameters
    ----------
    network : Network
    layout : Layout
    group : Group
    name : {"positions", "attitudes"}
    motion : ndarray, shape (g, 3, d)

    Returns
    -------
    left : ndarray, shape (g, 3, d)
        What they cannot follow; zero where nothing is observed.
    shared : ndarray, shape (q, d)
        How the unknowns have to move for the rest to stay as observed.
    """
    seen = group.weight > 0.0
    left = np.where(seen[:, :, None], motion, 0.0)
    shared = np.zeros((len(layout.names), motion.shape[2]))
    free = ~np.isfinite(layout.prior_sigma)
    own = (group.columns >= 0) & free[np.maximum(group.columns, 0)] if len(free) else group.columns >= 0
    if not own.any():
        return left, shared
    for rows in _apart(network, name, group.columns, own):
        columns = np.unique(group.columns[rows][own[rows]])
        if not len(columns):
            continue
        at = np.searchsorted(columns, np.where(own[rows], group.columns[rows], columns[0]))
        design = np.zeros((len(rows), 3, len(columns)))
        values = group.by_shared[rows] * own[rows][:, None, :] * seen[rows][:, :, None]
        for s in range(at.shape[1]):
            np.add.at(
                design, (np.arange(len(rows))[:, None], np.arange(3), at[:, s][:, None]), values[:, :, s]
            )
        flat, wanted = design.reshape(-1, len(columns)), left[rows].reshape(-1, motion.shape[2])
        found = np.linalg.lstsq(flat, wanted, rcond=None)[0]
        shared[columns] -= found
        left[rows] = (wanted - flat @ found).reshape(len(rows), 3, -1)
    return left, shared


def _apart(network: Network, name: str, columns: Integers, own: Mask) -> list[Integers]:
    """Observations that share no unknown with others, together: by strips, or by mounts."""
    if name == "positions" and network.positions is not None:
        key = network.positions.strip
        # A lever arm runs through the strips.
        if columns.shape[1] > 6 and own[:, 6:].any():
            key = np.zeros(len(columns), np.int64)
    else:
        assert network.attitudes is not None
        key = network.attitudes.mount
    assert key is not None  # filled in by the network
    return [np.flatnonzero(key == value) for value in np.unique(key)]


def followed(network: Network, layout: Layout, before: State, after: State) -> State:
    """The state after a motion of the block, with navigation where it leaves its residuals as they were."""
    if network.positions is None and network.attitudes is None:
        return after
    nothing = np.zeros((len(after.centres), 6)), np.zeros_like(after.points)
    there = groups_of(network, layout, before)
    for _ in range(3):
        step = np.zeros(len(layout.names))
        for name, group in groups_of(network, layout, after).items():
            # Computed minus computed before.
            change = (there[name].residual - group.residual)[:, :, None]
            step += absorbed(network, layout, group, name, change)[1][:, 0]
        after = replace(moved(after, layout, *nothing, step), cameras=after.cameras)
    return after


__all__ = ["absorbed", "followed"]
