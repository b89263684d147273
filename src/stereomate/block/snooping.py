"""Data snooping: gross errors found one after the other by their standardized residuals (Baarda).

Begins from a robust solution (Huber's loss). In each pass the observation of the largest standardized
residual of every point is taken out, as far as it is over the limit and among the large ones of the block: a
gross error spreads over its neighbours, so these wait. At the end observations that agree with the others
again come back, once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from stereomate.block.loop import Progress, Solution, run_loop
from stereomate.block.navigation import groups_of
from stereomate.block.network import Network
from stereomate.block.options import BlockOptions
from stereomate.block.statistics import Reliability, Statistics, statistics_of
from stereomate.errors import NotDeterminedError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# In one pass go those over this part of the largest standardized residual.
_PART: Final = 0.4
_PASSES: Final = 60
_MEDIAN_OF_NORMAL: Final = 0.6744897501960817

Kind = Literal["image", "control", "positions", "attitudes"]


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
        The largest, in standard deviations of the estimate.
    """

    kind: Kind
    row: int
    place: str
    size: tuple[float, ...]
    standardized: float


class _Search:
    """Which observations are out."""

    def __init__(self, network: Network, options: BlockOptions) -> None:
        self.network, self.options = network, options
        self.used = np.ones(len(network.image.photo), np.bool_)
        self.back: Mask = np.zeros_like(self.used)
        self.out: dict[tuple[Kind, int, int], float] = {}
        self.limit = float(norm.isf(options.tests.alpha / 2.0))

    def reduced(self) -> Network:
        """The network without the axes of control, positions and attitudes that are out."""
        network = self.network
        for kind in ("control", "positions", "attitudes"):
            rows = [(row, axis) for (k, row, axis) in self.out if k == kind]
            if not rows:
                continue
            part = getattr(network, kind)
            sigma = part.sigma.copy()
            for row, axis in rows:
                sigma[row, axis] = math.inf
            changes = {"sigma": sigma}
            if kind == "control" and part.covariance is not None:
                covariance = part.covariance.copy()
                covariance[[row for row, _ in rows]] = np.nan
                changes["covariance"] = covariance
            network = replace(network, **{kind: replace(part, **changes)})
        return network

    def scale(self, statistics: Statistics) -> float:
        """Robust standard deviation of unit weight, or 1."""
        if self.options.scale_by == "prior":
            return 1.0
        image = statistics.image
        controlled = self.used[:, None] & (image.redundancy > 0.2)
        values = np.abs(image.standardized[controlled]) * statistics.scale
        if values.size < 30:
            return statistics.scale
        return float(np.median(values)) / _MEDIAN_OF_NORMAL

    def remove(self, statistics: Statistics, scale: float) -> bool:
        """Take out the largest of each point; whether there was one."""
        ratio = statistics.scale / scale
        size = np.where(self.used, np.abs(statistics.image.standardized * ratio).max(axis=1), 0.0)
        size = np.nan_to_num(size)
        others = self._other_sizes(statistics, ratio)
        largest = max(float(size.max(initial=0.0)), *(value for _, value in others), 0.0)
        if largest <= self.limit:
            return False
        threshold = max(self.limit, _PART * largest)
        found = False
        order = np.lexsort((np.arange(len(size)), -size))
        seen: set[int] = set()
        for row in order[: int((size > threshold).sum())].tolist():
            point = int(self.network.image.point[row])
            if point not in seen:
                seen.add(point)
                self.used[row] = False
                found = True
        for key, value in others:
            if value > threshold and value >= 0.999 * largest:
                self.out[key] = value
                found = True
        if not found:
            key, _ = max(others, key=lambda entry: entry[1])
            self.out[key] = largest
        return True

    def _other_sizes(self, statistics: Statistics, ratio: float) -> list[tuple[tuple[Kind, int, int], float]]:
        """Standardized residuals of all other observations; the largest axis of each row."""
        result: list[tuple[tuple[Kind, int, int], float]] = [(("control", -1, -1), 0.0)]
        parts: tuple[tuple[Kind, Reliability | None], ...] = (
            ("control", statistics.control),
            ("positions", statistics.positions),
            ("attitudes", statistics.attitudes),
        )
        for kind, part in parts:
            if part is None or not len(part.standardized):
                continue
            size = np.nan_to_num(np.abs(part.standardized) * ratio)
            axis = size.argmax(axis=1)
            result += [((kind, row, int(axis[row])), float(size[row, axis[row]])) for row in range(len(size))]
        return result

    def restore(self, statistics: Statistics, scale: float) -> bool:
        """Bring back image points that agree with what the others say; each once."""
        size = np.abs(statistics.image.standardized * statistics.scale / scale).max(axis=1)
        again = ~self.used & ~self.back & (size <= self.limit)
        self.used |= again
        self.back |= again
        return bool(again.any())


def snoop(
    network: Network, options: BlockOptions, solution: Solution, progress: Progress | None = None
) -> tuple[Solution, tuple[GrossError, ...]]:
    """Take gross errors out of a robust solution.

    Returns
    -------
    solution : Solution
        Least squares without them.
    gross : tuple of GrossError
        The largest first.
    """
    search = _Search(network, options)
    try:
        statistics = statistics_of(solution, options, options.huber_width)
        search.remove(statistics, search.scale(statistics))
    except NotDeterminedError:
        return solution, ()
    for _ in range(_PASSES):
        solution = run_loop(
            search.reduced(), options, used=search.used, progress=progress, state=solution.state
        )
        statistics = statistics_of(solution, options)
        scale = search.scale(statistics)
        if not search.remove(statistics, scale) and not search.restore(statistics, scale):
            break
    return solution, _errors(search, solution, statistics)


def _errors(search: _Search, solution: Solution, statistics: Statistics) -> tuple[GrossError, ...]:
    network, image = search.network, statistics.image
    points, photos = network.points.names, network.photographs.names
    found = []
    for row in np.flatnonzero(~search.used).tolist():
        place = f"{points[network.image.point[row]]} in {photos[network.image.photo[row]]}"
        dx, dy = image.residuals[row].tolist()
        found.append(GrossError("image", row, place, (dx, dy), float(np.abs(image.standardized[row]).max())))
    rows: dict[tuple[Kind, int], list[int]] = {}
    for kind, row, axis in search.out:
        rows.setdefault((kind, row), []).append(axis)
    for (kind, row), axes in rows.items():
        size = [math.nan] * 3
        residual = _residual_of(search.network, solution, kind, row)
        for axis in axes:
            size[axis] = float(residual[axis])
        strength = max(search.out[kind, row, axis] for axis in axes)
        name = (
            points[network.control.point[row]]
            if kind == "control" and network.control
            else photos[getattr(network, kind).photo[row]]
        )
        found.append(GrossError(kind, row, name, tuple(size), strength))
    return tuple(sorted(found, key=lambda g: (-np.nan_to_num(g.standardized, nan=0.0), g.kind, g.row)))


def _residual_of(network: Network, solution: Solution, kind: Kind, row: int) -> Array:
    """Observed minus computed of an observation that may be out."""
    from_network = solution.prepared.layout, solution.state
    if kind == "control":
        assert network.control is not None
        return np.asarray(network.control.xyz[row] - solution.state.points[network.control.point[row]])
    group = groups_of(network, *from_network)[kind]
    return np.asarray(group.residual[row])
