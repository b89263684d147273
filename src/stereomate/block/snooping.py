"""Data snooping: gross errors found one after the other by their standardized residuals (Baarda).

Begins from a robust solution (Huber's loss). In each pass the observation of the largest standardized
residual of every point is taken out, as far as it is over the limit and among the large ones of the block: a
gross error spreads over its neighbours, so these wait. At the end observations that agree with the others
again come back, once. An observation that the block cannot be determined without stays in, and is named.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from stereomate.block.absolute import least_sum
from stereomate.block.datum import find_defect
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
# Redundancy number from which control, positions and attitudes are tested: below it an error would have to be
# 40 standard deviations to be seen, and what is taken out is what holds the block.
_CONTROLLED: Final = 0.01
_MEDIAN_OF_NORMAL: Final = 0.6744897501960817

Kind = Literal["image", "control", "positions", "attitudes"]
# Kind, row, axis.
_Key = tuple[Kind, int, int]


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
        self.out: dict[_Key, float] = {}
        self.limit = float(norm.isf(options.tests.alpha / 2.0))
        control = network.control
        self.of_control: Mask = np.isin(network.image.point, () if control is None else control.point)
        # What was out when the block was last determined, and what must not go.
        self.last = self.used.copy(), dict(self.out)
        self.needed_rows: Mask = np.zeros_like(self.used)
        self.needed: set[_Key] = set()
        self.one_by_one = False

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
        size = np.where(self.used & ~self.needed_rows, self._image_sizes(statistics, scale), 0.0)
        size = np.nan_to_num(size)
        others = self._other_sizes(statistics, statistics.scale / max(scale, 1.0))
        largest = max(float(size.max(initial=0.0)), *(value for _, value in others), 0.0)
        if largest <= self.limit:
            return False
        threshold = max(self.limit, (0.999 if self.one_by_one else _PART) * largest)
        found = False
        order = np.lexsort((np.arange(len(size)), -size))
        seen: set[int] = set()
        for row in order[: int((size > threshold).sum())].tolist():
            point = int(self.network.image.point[row])
            if point not in seen:
                seen.add(point)
                self.used[row] = False
                found = True
                if self.one_by_one:
                    return True
        for key, value in others:
            if value > threshold and value >= 0.999 * largest:
                self.out[key] = value
                found = True
                if self.one_by_one:
                    return True
        if not found:
            key, _ = max(others, key=lambda entry: entry[1])
            self.out[key] = largest
        return True

    def remove_all(self, statistics: Statistics) -> None:
        """Take out all that an L1 solution shows to be over the limit; its residuals are not scaled."""
        scale = 1.0
        if self.options.scale_by == "estimated":
            values = np.abs(statistics.image.standardized)
            scale = max(float(np.nanmedian(values)) / _MEDIAN_OF_NORMAL, 1e-12)
        size = np.nan_to_num(statistics.image.standardized).max(axis=1)
        self.used &= ~(size > self.limit * np.where(self.of_control, max(scale, 1.0), scale))
        for key, value in self._other_sizes(statistics, 1.0 / max(scale, 1.0)):
            if value > self.limit:
                self.out[key] = value

    def _image_sizes(self, statistics: Statistics, scale: float) -> Array:
        """Largest standardized residual of each image observation; NaN for those that are not controlled.

        The scale is that of the tie points. Where they are better than stated, what a surveyor measured of
        control points is not: his standard deviations are never made smaller.
        """
        scales = np.where(self.of_control, max(scale, 1.0), scale)
        return np.asarray(np.abs(statistics.image.standardized).max(axis=1) * statistics.scale / scales)

    def _other_sizes(self, statistics: Statistics, ratio: float) -> list[tuple[_Key, float]]:
        """Standardized residuals of all other observations; the largest axis of each row."""
        result: list[tuple[_Key, float]] = [(("control", -1, -1), 0.0)]
        parts: tuple[tuple[Kind, Reliability | None], ...] = (
            ("control", statistics.control),
            ("positions", statistics.positions),
            ("attitudes", statistics.attitudes),
        )
        for kind, part in parts:
            if part is None or not len(part.standardized):
                continue
            size = np.nan_to_num(np.abs(part.standardized) * ratio)
            # The block hardly controls these; it would be bent by small errors of others without them.
            size[part.redundancy < _CONTROLLED] = 0.0
            axis = size.argmax(axis=1)
            keys: list[_Key] = [(kind, row, int(axis[row])) for row in range(len(size))]
            result += [(key, float(size[key[1:]])) for key in keys if key not in self.needed]
        return result

    def restore(self, statistics: Statistics, scale: float) -> bool:
        """Bring back image points that agree with what the others say; each once."""
        size = self._image_sizes(statistics, scale)
        again = ~self.used & ~self.back & (size <= self.limit)
        self.used |= again
        self.back |= again
        return bool(again.any())

    def accept(self) -> None:
        """Keep what is out now."""
        self.last = self.used.copy(), dict(self.out)

    @property
    def changed(self) -> bool:
        """Whether other observations are out than when the block was last determined."""
        return not np.array_equal(self.used, self.last[0]) or self.out.keys() != self.last[1].keys()

    def take_back(self) -> bool:
        """Back to where the block was last determined; False if that is here.

        Of several observations that went together only the largest goes next time. One that went alone is
        needed: it stays in.
        """
        if not self.changed:
            return False
        used, out = self.last
        rows = np.flatnonzero(used & ~self.used)
        keys = [key for key in self.out if key not in out]
        self.used, self.out = used.copy(), dict(out)
        if len(rows) + len(keys) == 1:
            self.needed_rows[rows] = True
            self.needed.update(keys)
        self.one_by_one = True
        return True

    def notes(self) -> tuple[str, ...]:
        """Names what contradicts the others and stayed in."""
        network = self.network
        points, photos = network.points.names, network.photographs.names
        places = [
            f"{points[network.image.point[row]]} in {photos[network.image.photo[row]]}"
            for row in np.flatnonzero(self.needed_rows).tolist()
        ]
        places += [_name(network, kind, row) for kind, row, _ in sorted(self.needed)]
        if not places:
            return ()
        note = f"{len(places)} observations contradict the others and stay in, the block is not determined "
        return (note + f"without them: {', '.join(places[:5])}",)


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
        if options.robust == "l1":
            solution, statistics = least_sum(network, options, solution, progress)
            search.remove_all(statistics)
        else:
            statistics = statistics_of(solution, options, options.huber_width)
            search.remove(statistics, search.scale(statistics))
    except NotDeterminedError:
        return solution, ()
    for _ in range(_PASSES):
        try:
            solution, statistics = _adjusted(search, solution, progress)
            done = True
            search.accept()
        except NotDeterminedError:
            if not search.take_back():
                raise
            done = False
        scale = search.scale(statistics)
        if not search.remove(statistics, scale) and not search.restore(statistics, scale) and done:
            break
    else:
        search.take_back()
    solution = replace(solution, notes=(*solution.notes, *search.notes()))
    return solution, _errors(search, solution, statistics)


def _adjusted(search: _Search, solution: Solution, progress: Progress | None) -> tuple[Solution, Statistics]:
    """Least squares without what is out, from where it stood.

    Raises
    ------
    NotDeterminedError
        If too little is left: an unknown or the datum is open, or there is no convergence any more.
    """
    network, options = search.reduced(), search.options
    if find_defect(network, search.used).size > find_defect(search.network).size:
        raise NotDeterminedError("too little is left to determine the datum")
    found = run_loop(network, options, used=search.used, progress=progress, state=solution.state)
    if solution.converged and not found.converged and search.changed:
        raise NotDeterminedError("too little is left for the adjustment to converge")
    return found, statistics_of(found, options)


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
        found.append(GrossError(kind, row, _name(network, kind, row), tuple(size), strength))
    return tuple(sorted(found, key=lambda g: (-np.nan_to_num(g.standardized, nan=0.0), g.kind, g.row)))


def _name(network: Network, kind: Kind, row: int) -> str:
    """Point or photograph of an observation."""
    names, part = network.photographs.names, getattr(network, kind)
    if kind == "control":
        return network.points.names[int(part.point[row])]
    return names[int(part.photo[row])]


def _residual_of(network: Network, solution: Solution, kind: Kind, row: int) -> Array:
    """Observed minus computed of an observation that may be out."""
    from_network = solution.prepared.layout, solution.state
    if kind == "control":
        assert network.control is not None
        return np.asarray(network.control.xyz[row] - solution.state.points[network.control.point[row]])
    group = groups_of(network, *from_network)[kind]
    return np.asarray(group.residual[row])
