"""L1-norm by reweighting: a solution that gross errors of every kind hardly move.

The sum of the absolute standardized residuals is minimised by least squares with weights divided by them
(Kubik, Merchant and Schenk 1987: robust estimation in photogrammetry). Residuals are standardized with the
redundancy numbers of the given weights, so that an observation that controls itself little counts by what
it would show of an error, not by the residual it happens to have.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.block.loop import Progress, Solution, image_residuals, run_loop
from stereomate.block.navigation import groups_of
from stereomate.block.network import Network
from stereomate.block.options import BlockOptions
from stereomate.block.reliability import Reliability
from stereomate.block.statistics import Statistics, statistics_of

Array = NDArray[np.float64]

_ROUNDS: Final = 12
# The weight stops growing below this standardized residual: the sum of absolute values has a corner there.
_CORNER: Final = 0.3
# Below this redundancy a residual says nothing about its observation: it keeps its weight.
_UNCONTROLLED: Final = 0.02
_SETTLED: Final = 0.05
_KINDS: Final = ("image", "control", "positions", "attitudes")


def least_sum(
    network: Network, options: BlockOptions, solution: Solution, progress: Progress | None = None
) -> tuple[Solution, Statistics]:
    """The L1 solution, and statistics in which its residuals stand against the given weights.

    Parameters
    ----------
    network : Network
    options : BlockOptions
    solution : Solution
        Where to begin; Huber's.
    progress : callable, optional

    Raises
    ------
    NotDeterminedError
        If the normal matrix is singular.
    """
    given = statistics_of(run_loop(network, options, progress=progress, state=solution.state), options)
    deviations = {kind: _deviation(network, given, kind) for kind in _KINDS}
    sizes = _sizes(network, solution, deviations)
    for _ in range(_ROUNDS):
        solution = run_loop(
            _reweighted(network, sizes),
            replace(options, relative_tolerance=max(options.relative_tolerance, 1e-8)),
            progress=progress,
            state=solution.state,
        )
        before, sizes = sizes, _sizes(network, solution, deviations)
        change = [np.abs(np.sqrt(sizes[k]) - np.sqrt(before[k])) for k in sizes]
        if max(float(np.nanmax(c, initial=0.0)) for c in change) < _SETTLED:
            break
    return solution, replace(
        given,
        image=replace(given.image, standardized=sizes["image"]),
        control=_against(given.control, sizes.get("control")),
        positions=_against(given.positions, sizes.get("positions")),
        attitudes=_against(given.attitudes, sizes.get("attitudes")),
    )


def _deviation(network: Network, statistics: Statistics, kind: str) -> Array | None:
    """Standard deviations of the residuals; NaN for what is not controlled."""
    part: Reliability | None = getattr(statistics, kind)
    if part is None:
        return None
    with np.errstate(invalid="ignore"):
        controlled = part.redundancy > _UNCONTROLLED
        return np.where(controlled, part.sigma * np.sqrt(np.where(controlled, part.redundancy, 1.0)), np.nan)


def _sizes(network: Network, solution: Solution, deviations: dict[str, Array | None]) -> dict[str, Array]:
    """Absolute standardized residuals of every kind."""
    groups = groups_of(network, solution.prepared.layout, solution.state)
    residuals = {"image": image_residuals(solution.prepared, solution.state)}
    residuals |= {name: group.residual for name, group in groups.items()}
    if network.control is not None:
        residuals["control"] = network.control.xyz - solution.state.points[network.control.point]
    found = {}
    for kind, deviation in deviations.items():
        if deviation is not None:
            found[kind] = np.abs(residuals[kind]) / deviation
    return found


def _reweighted(network: Network, sizes: dict[str, Array]) -> Network:
    """Standard deviations times the root of the absolute standardized residuals."""
    for kind, size in sizes.items():
        part = getattr(network, kind)
        factor = np.sqrt(np.maximum(np.where(np.isfinite(size), size, 1.0), _CORNER))
        if kind == "image":
            # One weight for both coordinates: a mark that is wrong is wrong in both.
            factor = np.repeat(factor.max(axis=1, keepdims=True), 2, axis=1)
        changes = {"sigma": part.sigma * factor}
        if kind == "control" and part.covariance is not None:
            changes["covariance"] = part.covariance * factor[:, :, None] * factor[:, None, :]
        network = replace(network, **{kind: replace(part, **changes)})
    return network


def _against(part: Reliability | None, size: Array | None) -> Reliability | None:
    """Standardized residuals of the L1 solution in place of those of least squares."""
    if part is None or size is None:
        return part
    return replace(part, standardized=size)


__all__ = ["least_sum"]
