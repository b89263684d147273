"""The datum of a network: what the observations leave open, held by minimal and then by inner constraints."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.block.absorbed import absorbed
from stereomate.block.kernels.structure import pivots
from stereomate.block.navigation import groups_of
from stereomate.block.network import Network
from stereomate.block.unknowns import State, layout_of, start_of
from stereomate.geometry.rotations import rotation_from_vector, skew
from stereomate.geometry.similarity import similarity_arrays

Array = NDArray[np.float64]

# A direction of the similarity that moves no datum observation, but for this part of what others do, is open.
_OPEN: Final = 1e-9
_ALL: Final = 7


@dataclass(frozen=True, eq=False)
class Defect:
    """What a network leaves open of a similarity.

    Attributes
    ----------
    directions : ndarray, shape (7, d)
        Combinations of shift (in units of `extent`), turn and scale about `origin` that no observation sees.
    origin : ndarray, shape (3,)
    extent : float
    """

    directions: Array
    origin: Array
    extent: float

    @property
    def size(self) -> int:
        """Number of open directions, 0 to 7."""
        return int(self.directions.shape[1])

    def moves(self, xyz: Array) -> Array:
        """Motion of places by the open directions, shape (n, 3, d)."""
        return np.asarray(_place_moves(xyz - self.origin, self.extent) @ self.directions)

    def turns(self) -> Array:
        """Left rotation of every photograph by the open directions, shape (3, d)."""
        return self.directions[3:6]


def find_defect(network: Network, used: NDArray[np.bool_] | None = None) -> Defect:
    """What control, positions, attitudes and held unknowns leave open; shared unknowns may open more.

    Parameters
    ----------
    network : Network
    used : ndarray of bool, shape (m,), optional
        Image observations that take part; all if None. Control points that none of them sees hold nothing.
    """
    centres = network.photographs.centres
    origin = centres.mean(axis=0)
    extent = float(
        max(
            np.abs(centres - origin).max(initial=0.0),
            np.abs(network.points.xyz - origin).max(initial=0.0),
            1e-9,
        )
    )
    rows = [np.zeros((0, 7))]
    control = network.control
    if control is not None:
        assert control.check is not None
        points = network.image.point if used is None else network.image.point[used]
        known = np.isfinite(control.sigma) & (np.isin(control.point, points) & ~control.check)[:, None]
        rows.append(_place_moves(network.points.xyz[control.point] - origin, extent)[known])
    turn = np.concatenate([np.zeros((3, 3)), extent * np.eye(3), np.zeros((3, 1))], axis=1)
    if network.positions is not None or network.attitudes is not None:
        layout = layout_of(network)
        turns = np.broadcast_to(turn / extent, (len(centres), 3, _ALL))
        motion = np.concatenate([_place_moves(centres - origin, extent), turns], axis=1)
        for name, group in groups_of(network, layout, start_of(network, layout)).items():
            moves = np.einsum("gia,gad->gid", group.by_photo, motion[group.photo])
            left, _ = absorbed(network, layout, group, name, moves)
            unit = extent if name == "attitudes" else 1.0
            rows.append(unit * left[group.weight > 0.0])
    if network.photographs.fixed is not None:
        fixed = network.photographs.fixed
        rows.append(_place_moves(centres - origin, extent)[fixed[:, :3]])
        rows.append(np.broadcast_to(turn, (len(fixed), 3, 7))[fixed[:, 3:]])
    if len(rows) == 1:
        return Defect(np.eye(_ALL), origin, extent)
    design = np.concatenate(rows) / extent
    values, vectors = np.linalg.eigh(design.T @ design)
    open_ones = values < _OPEN * max(float(values.max(initial=0.0)), 1e-30)
    if not len(design):
        open_ones[:] = True
    return Defect(vectors[:, open_ones], origin, extent)


def _place_moves(offset: Array, extent: float) -> Array:
    """Motion of places by a unit of each of the seven parameters, shape (n, 3, 7); metres."""
    result = np.zeros((len(offset), 3, 7))
    result[:, :, :3] = extent * np.eye(3)
    result[:, :, 3:6] = -skew(offset)
    result[:, :, 6] = offset
    return result


def held(network: Network, defect: Defect) -> Network:
    """The network with as many unknowns of photographs held as directions are open (minimal constraints)."""
    photographs = network.photographs
    n = len(photographs.names)
    fixed = np.zeros((n, 6), np.bool_) if photographs.fixed is None else photographs.fixed.copy()
    moves = np.concatenate(
        [
            defect.moves(photographs.centres) / defect.extent,
            np.broadcast_to(defect.turns(), (n, 3, defect.size)),
        ],
        axis=1,
    ).reshape(6 * n, defect.size)
    moves = np.where(fixed.reshape(-1, 1), 0.0, moves)
    chosen = np.empty(defect.size, np.int64)
    pivots(moves, chosen)
    fixed.reshape(-1)[chosen] = True
    return network.holding(fixed)


def onto_start(state: State, start: State, defect: Defect, determined: NDArray[np.bool_]) -> State:
    """The state moved along the open directions to where centres and points are nearest to their start."""
    here = np.concatenate([state.centres, state.points[determined]])
    there = np.concatenate([start.centres, start.points[determined]])
    rotations, points = state.rotations, state.points
    if defect.size == _ALL:
        turn, shift, scale = similarity_arrays(here, there, False, np.ones(len(here)))
        return replace(
            state,
            centres=scale * (state.centres @ turn.T) + shift,
            rotations=turn @ rotations,
            points=scale * (points @ turn.T) + shift,
        )
    for _ in range(20):
        moves = defect.moves(here).reshape(-1, defect.size)
        t = defect.directions @ np.linalg.lstsq(moves, (there - here).reshape(-1), rcond=None)[0]
        turn, scale = rotation_from_vector(t[3:6]), float(np.exp(t[6]))
        shift = defect.extent * t[:3]

        def move(xyz: Array, turn: Array = turn, scale: float = scale, shift: Array = shift) -> Array:
            return np.asarray(defect.origin + shift + scale * (xyz - defect.origin) @ turn.T)

        here, points, rotations = move(here), move(points), turn @ rotations
        if float(np.abs(t).max()) < 1e-14:
            break
    return replace(state, centres=here[: len(state.centres)], rotations=rotations, points=points)
