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
from stereomate.block.network import Network
from stereomate.block.options import BlockOptions
from stereomate.block.statistics import Reliability

Array = NDArray[np.float64]

_SETTLED: Final = 0.01
# Below this redundancy a group says too little about its own variance.
_LEAST_REDUNDANCY: Final = 2.0


@dataclass(frozen=True)
class VarianceComponent:
    """A group of observations and the factor of its standard deviations.

    Attributes
    ----------
    group : str
        ``image``, ``control plan``, ``control height``, ``positions plan``, ``positions height``,
        ``attitudes``.
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
    ("control plan", "control", (0, 1)),
    ("control height", "control", (2,)),
    ("positions plan", "positions", (0, 1)),
    ("positions height", "positions", (2,)),
    ("attitudes", "attitudes", (0, 1, 2)),
)


def estimate_variance_components(
    network: Network, options: BlockOptions | None = None, max_iterations: int = 15
) -> VarianceComponents:
    """Fit the standard deviations of all kinds of observations to their residuals."""
    options = replace(options or BlockOptions(), statistics=True, scale_by="prior")
    factors = {name: 1.0 for name, _, _ in _PARTS}
    redundancies: dict[str, float] = {}
    converged, iteration = False, 0
    adjustment = adjust_block(network, options)
    while iteration < max_iterations and not converged:
        iteration += 1
        converged = True
        for name, kind, axes in _PARTS:
            reliability = _reliability(adjustment, kind)
            if reliability is None:
                continue
            total, redundancy = _sums(reliability, axes)
            redundancies[name] = redundancy
            if redundancy < _LEAST_REDUNDANCY:
                continue
            step = float(np.sqrt(max(total, 1e-12) / redundancy))
            # A group that fits too well is not let go to zero in one stride.
            step = min(max(step, 0.2), 10.0)
            factors[name] *= step
            converged &= abs(step - 1.0) < _SETTLED
        if not converged:
            adjustment = adjust_block(_scaled(network, factors), options)
    components = tuple(
        VarianceComponent(name, factors[name], redundancies[name])
        for name, _, _ in _PARTS
        if name in redundancies
    )
    return VarianceComponents(components, adjustment, iteration, converged)


def components_of(adjustment: BlockAdjustment) -> tuple[VarianceComponent, ...]:
    """Factors that an adjustment shows as it is: the first step of the iteration; none without statistics.

    They are against the a priori standard deviations. Groups of too small a redundancy are left out.
    """
    found = []
    for name, kind, axes in _PARTS:
        reliability = _reliability(adjustment, kind)
        if reliability is None:
            continue
        total, redundancy = _sums(reliability, axes)
        if redundancy >= _LEAST_REDUNDANCY:
            found.append(VarianceComponent(name, float(np.sqrt(total / redundancy)), redundancy))
    return tuple(found)


def _reliability(adjustment: BlockAdjustment, kind: str) -> Reliability | None:
    found: Reliability | None = getattr(adjustment.statistics, kind, None)
    return found


def _sums(reliability: Reliability, axes: tuple[int, ...]) -> tuple[float, float]:
    redundancy = reliability.redundancy[:, axes]
    part = np.isfinite(redundancy)
    square = (reliability.residuals[:, axes] / reliability.sigma[:, axes]) ** 2
    return float(square[part].sum()), float(redundancy[part].sum())


def _scaled(network: Network, factors: dict[str, float]) -> Network:
    for name, kind, axes in _PARTS:
        part = getattr(network, kind)
        if part is None:
            continue
        sigma = part.sigma.copy()
        sigma[:, axes] *= factors[name]
        network = replace(network, **{kind: replace(part, sigma=sigma)})
    return network
