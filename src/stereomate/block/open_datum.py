"""What is open of a datum, in words: which shifts, which turns and about what, the scale.

The open directions of a similarity are a linear space; any basis of it mixes shifts with turns. Here the pure
shifts are taken out first, then the turns that need no change of scale (each about an axis: its line is
found), then the scale.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.block.datum import Defect
from stereomate.block.network import Network

Array = NDArray[np.float64]

_AXES: Final = "xyz"
EVERYTHING: Final = ("shift x", "shift y", "shift z", "turn x", "turn y", "turn z", "scale")
# Directions closer to an axis than this are called by it.
_ALONG: Final = 0.02
# Part of the extent within which a point lies on a line.
_ON_LINE: Final = 1e-3
# Singular values below this part of the largest are none.
_NONE: Final = 1e-6


def open_datum(network: Network, defect: Defect) -> tuple[str, ...]:
    """Names of what is open, one for each direction.

    Returns
    -------
    tuple of str
        Such as ``shift z``, ``turn about the line through a and b``, ``scale``; in the tangent frame.
    """
    if not defect.size:
        return ()
    if defect.size == len(EVERYTHING):
        return EVERYTHING
    directions = defect.directions
    shifts = _without(directions, directions[3:])
    turns = _without(directions, directions[6:])
    found = [f"shift {_direction(v)}" for v in _tidy(shifts[:3])]
    rest = _beyond(turns, shifts)
    axes = _tidy(rest[3:6])
    found += [_turn(network, defect, rest, axis, len(axes), shifts.shape[1]) for axis in axes]
    if defect.size > shifts.shape[1] + rest.shape[1]:
        found.append("scale")
    return tuple(found)


def _without(space: Array, rows: Array) -> Array:
    """The part of a space of columns (7, d) in which some rows (k, d) of them vanish, orthonormal."""
    if not space.shape[1]:
        return space
    _, values, vectors = np.linalg.svd(rows, full_matrices=True)
    rank = int(np.count_nonzero(values > _NONE))
    return np.asarray(space @ vectors[rank:].T)


def _beyond(space: Array, part: Array) -> Array:
    """Orthonormal columns of a space at right angles to a part of it."""
    left = space - part @ (part.T @ space)
    u, values, _ = np.linalg.svd(left, full_matrices=False)
    return np.asarray(u[:, values > _NONE])


def _tidy(vectors: Array) -> list[Array]:
    """Unit vectors that span the columns (3, d): the axes where they do, one after the other."""
    found: list[Array] = []
    u, values, _ = np.linalg.svd(vectors, full_matrices=False)
    span = u[:, values > _NONE]
    for axis in np.eye(3):
        inside = span @ (span.T @ axis)
        if span.shape[1] > len(found) and np.linalg.norm(inside - axis) < _ALONG:
            found.append(axis)
    taken = np.array(found).reshape(-1, 3).T
    others = _beyond(span, taken)
    while len(found) < span.shape[1] and others.shape[1]:
        vector = others[:, 0] * np.sign(others[np.argmax(np.abs(others[:, 0])), 0])
        found.append(vector)
        others = others[:, 1:]
    return found


def _direction(vector: Array) -> str:
    """A direction in words: an axis, or its azimuth from y (north) over x (east) and its slope."""
    size = np.abs(vector)
    k = int(np.argmax(size))
    if np.linalg.norm(np.delete(vector, k)) < _ALONG:
        return _AXES[k]
    azimuth = math.degrees(math.atan2(vector[0], vector[1])) % 180.0
    slope = math.degrees(math.asin(min(1.0, abs(float(vector[2])))))
    return f"along azimuth {azimuth:.1f}°" + (f", slope {slope:.1f}°" if slope > 1.0 else "")


def _turn(network: Network, defect: Defect, rest: Array, axis: Array, count: int, shifts: int) -> str:
    """A turn by its axis; where shifts are open too its place says nothing."""
    if shifts:
        return f"turn {_direction(axis)}" if count > 1 else f"turn about {_direction(axis)}"
    # The motion of this turn: its shift at the origin tells where the axis lies.
    part = rest @ np.linalg.lstsq(rest[3:6], axis, rcond=None)[0]
    move = defect.extent * part[:3]
    place = defect.origin + np.cross(axis, move)
    names = _known_on(network, defect, place, axis)
    if count == 1 and len(names) > 1:
        return f"turn about the line through {names[0]} and {names[-1]}"
    if names:
        return f"turn {_direction(axis)} about {names[0]}"
    x, y, z = place.tolist()
    return f"turn about the line through ({x:.1f}, {y:.1f}, {z:.1f}), direction {_direction(axis)}"


def _known_on(network: Network, defect: Defect, place: Array, axis: Array) -> list[str]:
    """Control points and positions that lie on a line, in the order along it."""
    names: list[str] = []
    xyz: list[Array] = []
    control, positions = network.control, network.positions
    if control is not None:
        assert control.check is not None  # filled in by the network
        known = np.isfinite(control.sigma).any(axis=1) & ~control.check
        names += [network.points.names[k] for k in control.point[known].tolist()]
        xyz.append(network.points.xyz[control.point[known]])
    if positions is not None:
        placed = np.isfinite(positions.sigma).any(axis=1)
        names += [network.photographs.names[k] for k in positions.photo[placed].tolist()]
        xyz.append(network.photographs.centres[positions.photo[placed]])
    if not names:
        return []
    offset = np.concatenate(xyz) - place
    along = offset @ axis
    off = np.linalg.norm(offset - along[:, None] * axis, axis=1)
    rows = np.flatnonzero(off < _ON_LINE * defect.extent)
    return [names[k] for k in rows[np.argsort(along[rows], kind="stable")].tolist()]
