"""Variance components: how well a priori standard deviations of each kind of observations fit residuals.

Förstner's iteration: the factor of a group is its weighted sum of squares over the sum of its redundancy
numbers, and its standard deviations are multiplied with the root of it until all factors are one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.block.adjustment import BlockAdjustment, adjust_block
from stereomate.block.network import ImagePoints, Network
from stereomate.block.options import BlockOptions
from stereomate.block.reliability import Reliability
from stereomate.block.snooping import without

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_SETTLED: Final = 0.01
# Searches for gross errors, each with the standard deviations fitted to what was good in the one before.
_SEARCHES: Final = 12
# Below this redundancy a group says too little about its own variance.
_LEAST_REDUNDANCY: Final = 2.0


@dataclass(frozen=True)
class VarianceComponent:
    """A group of observations and the factor of its standard deviations.

    Attributes
    ----------
    group : str
        ``image`` (tie points), ``control images`` (measurements of control and check points),
        ``control plan``, ``control height``, ``positions plan``, ``positions height``, ``attitudes``.
    factor : float
        Estimated over a priori standard deviation; 1 where the group is too small to tell.
    redundancy : float
        Sum of the redundancy numbers of the group.
    """

    group: str
    factor: float
    redundancy: float


@dataclass(frozen=True, eq=False)
class VarianceComponents:
    """Components of all groups and the adjustment with the fitted standard deviations."""

    components: tuple[VarianceComponent, ...]
    adjustment: BlockAdjustment
    iterations: int
    converged: bool


_PARTS: Final[tuple[tuple[str, str, tuple[int, ...]], ...]] = (
    ("image", "image", (0, 1)),
    ("control images", "image", (0, 1)),
    ("control plan", "control", (0, 1)),
    ("control height", "control", (2,)),
    ("positions plan", "positions", (0, 1)),
    ("positions height", "positions", (2,)),
    ("attitudes", "attitudes", (0, 1, 2)),
)


def estimate_variance_components(
    network: Network, options: BlockOptions | None = None, max_iterations: int = 15
) -> VarianceComponents:
    """Fit the standard deviations of all kinds of observations to their residuals.

    Gross errors are looked for as `options` say, with the standard deviations as given; the components are
    fitted to what is good, and gross errors are looked for again with the fitted ones, until both agree.
    """
    options = options or BlockOptions()
    adjustment = adjust_block(network, replace(options, statistics=True, scale_by="prior"))
    factors = {name: 1.0 for name, _, _ in _PARTS}
    redundancies: dict[str, float] = {}
    iterations, converged = 0, False
    for _ in range(_SEARCHES if options.robust in ("snooping", "l1") else 1):
        step, redundancies, count, converged = _fitted(adjustment, max_iterations)
        iterations += count
        for name, factor in step.items():
            factors[name] *= factor
        if max(abs(factor - 1.0) for factor in step.values()) < _SETTLED:
            break
        start = adjustment.adjusted_network()
        scaled = _scaled(replace(start, cameras=network.cameras), step)
        adjustment = adjust_block(scaled, replace(options, statistics=True, scale_by="prior"))
    if options.scale_by != "prior" or not options.statistics:
        adjustment = adjust_block(adjustment.network, options)
    components = tuple(
        VarianceComponent(name, factors[name], redundancies[name])
        for name, _, _ in _PARTS
        if name in redundancies
    )
    return VarianceComponents(components, adjustment, iterations, converged)


def _fitted(
    adjustment: BlockAdjustment, max_iterations: int
) -> tuple[dict[str, float], dict[str, float], int, bool]:
    """Factors of the groups over the good observations, redundancies, iterations, and if it converged."""
    factors = {name: 1.0 for name, _, _ in _PARTS}
    redundancies: dict[str, float] = {}
    network, plain = good_network(adjustment), replace(adjustment.options, robust="none")
    current = adjust_block(network, plain)
    for iteration in range(1, max_iterations + 1):
        settled = True
        for name, kind, axes in _PARTS:
            reliability = _reliability(current, kind)
            if reliability is None:
                continue
            total, redundancy = _sums(reliability, axes, _rows(current.network, name))
            if not redundancy:
                continue
            redundancies[name] = redundancy
            if redundancy < _LEAST_REDUNDANCY:
                continue
            step = float(np.sqrt(max(total, 1e-12) / redundancy))
            # A group that fits too well is not let go to zero in one stride.
            step = min(max(step, 0.2), 10.0)
            factors[name] *= step
            settled &= abs(step - 1.0) < _SETTLED
        if settled:
            return factors, redundancies, iteration, True
        current = adjust_block(_scaled(network, factors), plain)
    return factors, redundancies, max_iterations, False


def components_of(adjustment: BlockAdjustment) -> tuple[VarianceComponent, ...]:
    """Factors that an adjustment shows as it is: the first step of the iteration; none without statistics.

    They are against the a priori standard deviations. Groups of too small a redundancy are left out.
    """
    found = []
    for name, kind, axes in _PARTS:
        reliability = _reliability(adjustment, kind)
        if reliability is None:
            continue
        total, redundancy = _sums(reliability, axes, _rows(adjustment.network, name))
        if redundancy >= _LEAST_REDUNDANCY:
            found.append(VarianceComponent(name, float(np.sqrt(total / redundancy)), redundancy))
    return tuple(found)


def good_network(adjustment: BlockAdjustment) -> Network:
    """The network of what took part, from where it was adjusted; priors keep the values they were given."""
    network = replace(adjustment.adjusted_network(), cameras=adjustment.network.cameras)
    out = {
        (error.kind, error.row, axis)
        for error in adjustment.gross_errors
        if error.kind != "image"
        for axis in np.flatnonzero(np.isfinite(error.size)).tolist()
    }
    used, image = adjustment.used, network.image
    image = ImagePoints(image.photo[used], image.point[used], image.xy[used], image.sigma[used])
    return replace(without(network, out), image=image)


def _rows(network: Network, group: str) -> Mask | slice:
    """Rows of a kind of observations that belong to a group."""
    if group not in ("image", "control images"):
        return slice(None)
    control = network.control
    of_control = np.isin(network.image.point, () if control is None else control.point)
    return np.asarray(of_control if group == "control images" else ~of_control)


def _reliability(adjustment: BlockAdjustment, kind: str) -> Reliability | None:
    found: Reliability | None = getattr(adjustment.statistics, kind, None)
    return found


def _sums(reliability: Reliability, axes: tuple[int, ...], rows: Mask | slice) -> tuple[float, float]:
    redundancy = reliability.redundancy[rows][:, axes]
    part = np.isfinite(redundancy)
    square = (reliability.residuals[rows][:, axes] / reliability.sigma[rows][:, axes]) ** 2
    return float(square[part].sum()), float(redundancy[part].sum())


def _scaled(network: Network, factors: dict[str, float]) -> Network:
    for name, kind, axes in _PARTS:
        part = getattr(network, kind)
        if part is None or factors[name] == 1.0:
            continue
        sigma = part.sigma.copy()
        rows = _rows(network, name)
        if isinstance(rows, slice):
            sigma[:, axes] *= factors[name]
        else:
            sigma[rows] *= factors[name]
        changes = {"sigma": sigma}
        if kind == "control" and part.covariance is not None:
            root = np.ones(3)
            root[list(axes)] = factors[name]
            changes["covariance"] = part.covariance * np.outer(root, root)
        network = replace(network, **{kind: replace(part, **changes)})
    return network
