"""Control and positions that cannot be right, before anything is adjusted.

The tests of an adjustment look for errors that it can be linearised over: coordinates that are exchanged, or
of another place, lie kilometres off and bend everything before they are found. Here they are compared with
where the start puts them, and with each other. What goes comes back if the adjusted block agrees with it.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.block.gross_errors import Key, Kind, name_of
from stereomate.block.network import Network
from stereomate.block.start import KnownPoints, control_places

Array = NDArray[np.float64]

# Off by so much of the distance of the ground, and by so many times what is usual in this block.
_PART: Final = 0.1
_TIMES_MEDIAN: Final = 10.0
_LEAST: Final = 3


def implausible(network: Network) -> dict[Key, float]:
    """Coordinates of control and positions that lie far from where the start of the network has them.

    Returns
    -------
    dict of (kind, row, axis) to float
        With how far off they are, metres.
    """
    image, photographs = network.image, network.photographs
    if not len(image.photo):
        return {}
    distance = np.linalg.norm(network.points.xyz[image.point] - photographs.centres[image.photo], axis=1)
    least = _PART * float(np.median(distance))
    found: dict[Key, float] = {}
    control = network.control
    if control is not None and control.check is not None:
        given, there = _control(network)
        # Check points say nothing here: they take no part.
        given[control.check] = np.nan
        found |= _far_off("control", given - there, np.isfinite(control.sigma), least)
    positions = network.positions
    if positions is not None:
        arm = np.einsum("gij,gj->gi", photographs.rotations[positions.photo], positions.lever_arm)
        there = photographs.centres[positions.photo] + arm
        found |= _far_off("positions", positions.xyz - there, np.isfinite(positions.sigma), least)
    return found


def _control(network: Network) -> tuple[Array, Array]:
    """Coordinates of the control points, and where their rays meet (NaN without two of them)."""
    control, image = network.control, network.image
    assert control is not None
    row = np.full(len(network.points.names), -1)
    row[control.point] = np.arange(len(control.point))
    marks = np.flatnonzero(row[image.point] >= 0)
    there = np.full(control.xyz.shape, np.nan)
    cameras = [network.cameras[k].camera for k in network.photographs.camera.tolist()]
    if len(marks):
        names = tuple(map(str, range(len(control.point))))
        known = KnownPoints(
            names, control.xyz, control.sigma, row[image.point[marks]], image.photo[marks], image.xy[marks]
        )
        places = control_places(network.photographs.centres, network.photographs.rotations, cameras, known)
        there[[int(name) for name in places.names]] = places.model
    return np.where(np.isfinite(control.sigma), control.xyz, np.nan), there


def _far_off(kind: Kind, difference: Array, known: NDArray[np.bool_], least: float) -> dict[Key, float]:
    """Rows that stand out, with all their known axes; nobody if that were half of them."""
    rows = np.flatnonzero(np.isfinite(difference).any(axis=1))
    if len(rows) < _LEAST:
        return {}
    part = difference[rows]
    some = np.where(np.isfinite(part).any(axis=0), part, 0.0)
    size = np.linalg.norm(np.nan_to_num(part - np.nanmedian(some, axis=0)), axis=1)
    over = size > max(least, _TIMES_MEDIAN * float(np.median(size)))
    if 2 * np.count_nonzero(over) >= len(rows):
        return {}
    return {
        (kind, row, axis): float(size[k])
        for k, row in enumerate(rows.tolist())
        if over[k]
        for axis in np.flatnonzero(known[row]).tolist()
    }


def screening_note(network: Network, found: dict[Key, float]) -> str:
    """What was found, in words."""
    rows = {(kind, row): size for (kind, row, _), size in found.items()}
    places = [
        f"{name_of(network, kind, row)} ({kind}, {size:.4g} m)"
        for (kind, row), size in sorted(rows.items(), key=lambda entry: -entry[1])[:5]
    ]
    return (
        f"{len(rows)} control points or positions lie far from where the photographs have them and were left "
        f"out from the start: {', '.join(places)}"
    )
