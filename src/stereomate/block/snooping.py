"""Data snooping: gross errors found one after the other by their standardized residuals (Baarda).

Begins from a robust solution (Huber's loss). In each pass the observation of the largest standardized
residual of every point is taken out, as far as it is over the limit and among the large ones of the block: a
gross error spreads over its neighbours, so these wait. At the end observations that agree with the others
again come back, twice at most. An observation that the block is not determined without stays in, named.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from stereomate.block.absolute import least_sum
from stereomate.block.alternatives import explain
from stereomate.block.datum import find_defect
from stereomate.block.gross_errors import GrossError, Key, Kind, errors_of, name_of, predicted_sizes
from stereomate.block.loop import Progress, Solution, run_loop
from stereomate.block.network import Network
from stereomate.block.options import BlockOptions
from stereomate.block.reliability import Reliability
from stereomate.block.statistics import Statistics, detection_limit, statistics_of
from stereomate.errors import NotDeterminedError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# In one pass go those over this part of the largest standardized residual.
_PART: Final = 0.4
_PASSES: Final = 60
_RETURNS: Final = 2
# Redundancy number from which control, positions and attitudes are tested: below it an error would have to be
# 130 standard deviations to be seen. Up to ten times of it only twice the limit counts: such an observation
# holds the block, and small errors of others that nobody modelled show in it first.
_CONTROLLED: Final = 0.001
_MEDIAN_OF_NORMAL: Final = 0.6744897501960817


def without(network: Network, out: Collection[Key]) -> Network:
    """A network in which some axes of control, positions and attitudes are not known."""
    for kind in ("control", "positions", "attitudes"):
        rows = [(row, axis) for (k, row, axis) in out if k == kind]
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


class _Search:
    """Which observations are out."""

    def __init__(self, network: Network, options: BlockOptions, out: Mapping[Key, float]) -> None:
        self.network, self.options = network, options
        self.used = np.ones(len(network.image.photo), np.bool_)
        # How often each has come back.
        self.back: NDArray[np.int8] = np.zeros(len(self.used), np.int8)
        self.out: dict[Key, float] = dict(out)
        self.limit = float(norm.isf(options.tests.alpha / 2.0))
        control = network.control
        self.of_control: Mask = np.isin(network.image.point, () if control is None else control.point)
        # What was out when the block was last determined, and what must not go.
        self.last = self.used.copy(), dict(self.out)
        self.needed_rows: Mask = np.zeros_like(self.used)
        self.needed: set[Key] = set()
        self.one_by_one = False
        self.keys_back: dict[Key, int] = {}
        self.explained: set[int] = set()
        self.in_doubt: set[int] = set()

    def reduced(self) -> Network:
        """The network without the axes of control, positions and attitudes that are out."""
        return without(self.network, self.out)

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
        over = size > self.limit * np.where(self.of_control, max(scale, 1.0), scale)
        # Two rays of each point stay, the smallest: without them nothing could ever come back.
        point = self.network.image.point
        order = np.lexsort((size, point))
        first = np.searchsorted(point[order], point[order])
        over[order[np.arange(len(order)) - first < 2]] = False
        self.used &= ~over
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

    def _other_sizes(self, statistics: Statistics, ratio: float) -> list[tuple[Key, float]]:
        """Standardized residuals of all other observations; the largest axis of each row."""
        result: list[tuple[Key, float]] = [(("control", -1, -1), 0.0)]
        parts: tuple[tuple[Kind, Reliability | None], ...] = (
            ("control", statistics.control),
            ("positions", statistics.positions),
            ("attitudes", statistics.attitudes),
        )
        for kind, part in parts:
            if part is None or not len(part.standardized):
                continue
            size = np.nan_to_num(np.abs(part.standardized) * ratio)
            size[part.redundancy < _CONTROLLED] = 0.0
            size[(part.redundancy < 10.0 * _CONTROLLED) & (size < 2.0 * self.limit)] = 0.0
            axis = size.argmax(axis=1)
            keys: list[Key] = [(kind, row, int(axis[row])) for row in range(len(size))]
            result += [(key, float(size[key[1:]])) for key in keys if key not in self.needed]
        return result

    def restore(self, solution: Solution, statistics: Statistics, scale: float) -> bool:
        """Bring back observations that agree with what the others say; each twice at most.

        Once would lose those that came back early and had to go again for an error that was found later.
        """
        size = self._image_sizes(statistics, scale)
        again = ~self.used & (self.back < _RETURNS) & (size <= self.limit)
        self.used |= again
        self.back += again
        keys = [key for key in self.out if self.keys_back.get(key, 0) < _RETURNS]
        sizes = predicted_sizes(self.network, solution, statistics, keys)
        agreeing = [key for key, value in sizes.items() if value <= self.limit * max(scale, 1.0)]
        for key in agreeing:
            del self.out[key]
        self.keys_back.update({key: self.keys_back.get(key, 0) + 1 for key in agreeing})
        return bool(again.any()) or bool(agreeing)

    def explain(self, solution: Solution, statistics: Statistics, scale: float) -> bool:
        """Put the smallest explanation of the contradictions in each point in the place of what went.

        Only where what went was no error of chance; each point once. Whether anything changed.
        """
        network, control = self.network, self.network.control
        large = detection_limit(self.options.tests.alpha, self.options.tests.power)
        size = self._image_sizes(statistics, scale)
        rows = ~self.used & ~(size <= large)
        axes = np.zeros((0 if control is None else len(control.point), 3), np.bool_)
        for (kind, row, axis), value in self.out.items():
            if kind == "control" and value > large:
                axes[row, axis] = True
        points = set(network.image.point[rows].tolist())
        if control is not None:
            points.update(control.point[axes.any(axis=1)].tolist())
        points -= self.explained
        if not points:
            return False
        self.explained |= points
        mine = np.isin(network.image.point, list(points))
        own = np.zeros(len(axes), np.bool_) if control is None else np.isin(control.point, list(points))
        all_axes = np.zeros_like(axes)
        for kind, row, axis in self.out:
            if kind == "control":
                all_axes[row, axis] = own[row]
        scales = np.where(self.of_control, max(scale, 1.0), scale)
        found = explain(network, solution, (mine & ~self.used, all_axes), scales, self.options.tests.alpha)
        before = self.used.copy(), set(self.out)
        solved = np.isin(network.image.point, found.points)
        self.used[solved] = ~found.rays[solved]
        self.back[found.rays] = _RETURNS
        if control is not None:
            of = np.isin(control.point, found.points)
            for row, axis in np.argwhere(of[:, None] & (all_axes | found.axes)).tolist():
                key: Key = ("control", row, axis)
                if not found.axes[row, axis]:
                    del self.out[key]
                else:
                    self.keys_back[key] = _RETURNS
                    self.out.setdefault(key, math.nan)
        self.in_doubt.update(found.points[found.in_doubt].tolist())
        return not np.array_equal(self.used, before[0]) or set(self.out) != before[1]

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
        places += [name_of(network, kind, row) for kind, row, _ in sorted(self.needed)]
        notes = []
        if places:
            note = (
                f"{len(places)} observations contradict the others and stay in, the block is not determined "
            )
            notes.append(note + f"without them: {', '.join(places[:5])}")
        if self.in_doubt:
            names = [points[j] for j in sorted(self.in_doubt)[:5]]
            notes.append(
                f"{len(self.in_doubt)} points contain a gross error that no test can place: what may be "
                f"wrong of them is out: {', '.join(names)}"
            )
        return tuple(notes)


def snoop(
    network: Network,
    options: BlockOptions,
    solution: Solution,
    progress: Progress | None = None,
    out: Mapping[Key, float] | None = None,
) -> tuple[Solution, tuple[GrossError, ...], Statistics | None]:
    """Take gross errors out of a robust solution.

    Parameters
    ----------
    network : Network
        With all observations.
    options : BlockOptions
    solution : Solution
        Huber's, `without` what is `out` from the start: (kind, row, axis).
    progress : callable, optional
    out : mapping, optional

    Returns
    -------
    solution : Solution
        Least squares without them.
    gross : tuple of GrossError
        The largest first.
    statistics : Statistics or None
        Of that solution; None where nothing could be searched.
    """
    search = _Search(network, options, out or {})
    try:
        if options.robust == "l1":
            solution, statistics = least_sum(search.reduced(), options, solution, progress)
            search.remove_all(statistics)
        else:
            statistics = statistics_of(solution, options, options.huber_width)
            search.remove(statistics, search.scale(statistics))
    except NotDeterminedError:
        return solution, (), None
    done = False
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
        changed = search.remove(statistics, scale) or search.restore(solution, statistics, scale)
        if done and not changed and not search.explain(solution, statistics, scale):
            break
    else:
        search.take_back()
    solution = replace(solution, notes=(*solution.notes, *search.notes()))
    gross = errors_of(search.network, solution, statistics, search.used, search.out, search.in_doubt)
    return solution, gross, statistics if done else None


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
