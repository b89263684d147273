"""Gross errors that were found: what they are called, how large they are, and what the others predict."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from stereomate.block.loop import Solution
from stereomate.block.navigation import groups_of
from stereomate.block.network import Network
from stereomate.block.reliability import computed_variance
from stereomate.block.statistics import Statistics

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

Kind = Literal["image", "control", "positions", "attitudes"]
# Kind, row, axis.
Key = tuple[Kind, int, int]

# Redundancy number from which an observation that comes back is controlled by the others.
_CONTROLLED: Final = 0.05


@dataclass(frozen=True)
class GrossError:
    """A gross error that was found and taken out.

    Attributes
    ----------
    kind : {"image", "control", "positions", "attitudes"}
    row : int
        In that part of the network.
    place : str
        Point and photograph.
    size : tuple of float
        Estimated error in each coordinate (observed minus what the others say): pixels, metres or
        radians; NaN for axes that stayed in.
    standardized : float
        The largest, in standard deviations of the estimate; NaN where the others say nothing.
    in_doubt : bool
        Another observation of the same point may be the wrong one as well: all that may be are out.
    """

    kind: Kind
    row: int
    place: str
    size: tuple[float, ...]
    standardized: float
    in_doubt: bool = False


def errors_of(
    network: Network,
    solution: Solution,
    statistics: Statistics,
    used: Mask,
    out: Mapping[Key, float],
    in_doubt: Collection[int] = (),
) -> tuple[GrossError, ...]:
    """What is out of a network, the largest first.

    `out` with the standardized residuals of their removal; `in_doubt`: points in which another one may
    be the wrong one.
    """
    image = statistics.image
    points, photos = network.points.names, network.photographs.names
    found = []
    for row in np.flatnonzero(~used).tolist():
        place = f"{points[network.image.point[row]]} in {photos[network.image.photo[row]]}"
        dx, dy = image.residuals[row].tolist()
        strength = float(np.abs(image.standardized[row]).max())
        doubtful = int(network.image.point[row]) in in_doubt
        found.append(GrossError("image", row, place, (dx, dy), strength, doubtful))
    rows: dict[tuple[Kind, int], list[int]] = {}
    for kind, row, axis in out:
        rows.setdefault((kind, row), []).append(axis)
    for (kind, row), axes in rows.items():
        size = [math.nan] * 3
        residual = residual_of(network, solution, kind, row)
        for axis in axes:
            size[axis] = float(residual[axis])
        strength = max(out[kind, row, axis] for axis in axes)
        doubtful = kind == "control" and int(getattr(network, kind).point[row]) in in_doubt
        found.append(GrossError(kind, row, name_of(network, kind, row), tuple(size), strength, doubtful))
    return tuple(sorted(found, key=lambda g: (-np.nan_to_num(g.standardized, nan=0.0), g.kind, g.row)))


def name_of(network: Network, kind: Kind, row: int) -> str:
    """Point or photograph of an observation that is not an image point."""
    names, part = network.photographs.names, getattr(network, kind)
    if kind == "control":
        return network.points.names[int(part.point[row])]
    return names[int(part.photo[row])]


def residual_of(network: Network, solution: Solution, kind: Kind, row: int) -> Array:
    """Observed minus computed of an observation that may be out."""
    if kind == "control":
        assert network.control is not None
        return np.asarray(network.control.xyz[row] - solution.state.points[network.control.point[row]])
    group = groups_of(network, solution.prepared.layout, solution.state)[kind]
    return np.asarray(group.residual[row])


def predicted_sizes(
    network: Network, solution: Solution, statistics: Statistics, keys: list[Key]
) -> dict[Key, float]:
    """Differences to what the others predict in their standard deviations, of observations that are out.

    For a standard deviation of unit weight of 1; observations of which the others say next to nothing (too
    small a redundancy number once they are back) are left out.
    """
    found: dict[Key, float] = {}
    cofactors = statistics.cofactors
    groups = groups_of(network, solution.prepared.layout, solution.state) if keys else {}
    variances = {
        kind: computed_variance(group, cofactors.photos, cofactors.photo_shared, cofactors.shared)
        for kind, group in groups.items()
    }
    for key in keys:
        kind, row, axis = key
        if kind == "control":
            assert network.control is not None
            j = int(network.control.point[row])
            variance = float(cofactors.points[j, axis, axis])
            sigma = float(network.control.sigma[row, axis])
        else:
            variance = float(variances[kind][row, axis])
            sigma = float(getattr(network, kind).sigma[row, axis])
        size = abs(float(residual_of(network, solution, kind, row)[axis])) / math.sqrt(sigma**2 + variance)
        if math.isfinite(size) and sigma**2 >= _CONTROLLED * (sigma**2 + variance):
            found[key] = size
    return found
