"""GNSS positions and attitudes as linearised observations of photographs and shared unknowns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stereomate.block.network import Attitudes, Network, Positions
from stereomate.block.unknowns import Layout, State, of_mounts, vector_from_rotation
from stereomate.geometry.rotations import skew

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Group:
    """Observations of three numbers each, of one photograph each.

    Attributes
    ----------
    photo : ndarray of int, shape (g,)
    residual : ndarray, shape (g, 3)
        Observed minus computed.
    weight : ndarray, shape (g, 3)
    by_photo : ndarray, shape (g, 3, 6)
    columns : ndarray of int, shape (g, s)
        Shared unknowns, -1 for none.
    by_shared : ndarray, shape (g, 3, s)
    """

    photo: Integers
    residual: Array
    weight: Array
    by_photo: Array
    columns: Integers
    by_shared: Array


def groups_of(network: Network, layout: Layout, state: State) -> dict[str, Group]:
    """Linearised navigation at a state, by the name of its part of the network."""
    groups = {}
    if network.positions is not None and len(network.positions.photo):
        groups["positions"] = _positions(network.positions, layout, state)
    if network.attitudes is not None and len(network.attitudes.photo):
        groups["attitudes"] = _attitudes(network.attitudes, layout, state)
    return groups


def _positions(positions: Positions, layout: Layout, state: State) -> Group:
    photo = positions.photo
    g = len(photo)
    assert positions.mount is not None  # filled in by the network
    unknown_arm = bool((layout.lever_arm >= 0).any())
    known = positions.lever_arm
    if unknown_arm:
        known = known + of_mounts(layout.lever_arm, state.shared)[positions.mount]
    arm = np.einsum("gij,gj->gi", state.rotations[photo], known)
    computed = state.centres[photo] + arm
    by_photo = np.zeros((g, 3, 6))
    by_photo[:, [0, 1, 2], [0, 1, 2]] = 1.0
    by_photo[:, :, 3:] = -skew(arm)
    wide = 9 if unknown_arm else 6
    columns = np.full((g, wide), -1)
    by_shared = np.zeros((g, 3, wide))
    if unknown_arm:
        columns[:, 6:] = layout.lever_arm[positions.mount][:, None] + np.arange(3)
        by_shared[:, :, 6:] = state.rotations[photo]
    if len(layout.strips):
        assert positions.strip is not None
        for i, strip in enumerate(layout.strips.tolist()):
            rows = np.flatnonzero(positions.strip == strip)
            time = time_in_strip(positions, rows)
            for to, first, value in ((0, layout.shift[i], np.ones(len(rows))), (3, layout.drift[i], time)):
                if first < 0:
                    continue
                columns[rows, to : to + 3] = first + np.arange(3)
                by_shared[rows[:, None], np.arange(3), to + np.arange(3)] = value[:, None]
                computed[rows] += value[:, None] * state.shared[first : first + 3]
    weight = 1.0 / positions.sigma**2
    residual = np.where(weight > 0.0, positions.xyz - computed, 0.0)
    return Group(photo, residual, weight, by_photo, columns.astype(np.int64), by_shared)


def time_in_strip(positions: Positions, rows: Integers) -> Array:
    """Times of a strip's photographs about their mean: seconds, or their numbers."""
    time = np.arange(len(rows), dtype=np.float64) if positions.time is None else positions.time[rows]
    return np.asarray(time - time.mean())


def _attitudes(attitudes: Attitudes, layout: Layout, state: State) -> Group:
    photo = attitudes.photo
    g = len(photo)
    assert attitudes.mount is not None  # filled in by the network
    unknown = bool((layout.boresight >= 0).any())
    turn = state.boresight[attitudes.mount] if unknown else state.boresight[np.zeros(g, np.int64)]
    computed = state.rotations[photo] @ turn
    residual = vector_from_rotation(attitudes.rotations @ np.swapaxes(computed, 1, 2))
    # log(exp(e) exp(-θ)) = e - Jr⁻¹(e) θ, Jr⁻¹ = 1 + [e]x / 2 + [e]x² / 12 to third order.
    turned = skew(residual)
    inverse = np.eye(3) + 0.5 * turned + turned @ turned / 12.0
    by_photo = np.zeros((g, 3, 6))
    by_photo[:, :, 3:] = inverse
    columns = np.full((g, 3), -1)
    by_shared = np.zeros((g, 3, 3))
    if unknown:
        columns[:] = layout.boresight[attitudes.mount][:, None] + np.arange(3)
        # R B exp(δ) = exp(R B δ) R B.
        by_shared = inverse @ computed
    return Group(photo, residual, 1.0 / attitudes.sigma**2, by_photo, columns.astype(np.int64), by_shared)
