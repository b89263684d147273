"""Bundle adjustment of a block: the entry, and its result as a value.

Residual = observed - computed. Poor results are values: an adjustment that did not converge says so, gross
errors are a list. Wrong input raises.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from stereomate.block.check_points import CheckPoint, judged_check_points
from stereomate.block.datum import find_defect
from stereomate.block.gross_errors import GrossError
from stereomate.block.loop import Progress, Solution, run_loop
from stereomate.block.loop import image_residuals as residuals_at
from stereomate.block.network import BlockCamera, Network
from stereomate.block.options import BlockOptions
from stereomate.block.screening import implausible, screening_note
from stereomate.block.snooping import snoop, without
from stereomate.block.statistics import Statistics, counts, statistics_of
from stereomate.block.unknowns import camera_from_values
from stereomate.camera.model import Camera
from stereomate.errors import NotDeterminedError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Correlation from which two unknowns are named.
_CORRELATED: Final = 0.95


@dataclass(frozen=True)
class GlobalTest:
    """Chi-square test of the standard deviation of unit weight against 1.

    Attributes
    ----------
    statistic : float
        Weighted sum of squares.
    lower, upper : float
        Its limits at the level of the test.
    passed : bool
    """

    statistic: float
    lower: float
    upper: float
    passed: bool


@dataclass(frozen=True)
class Correlation:
    """Two unknowns whose correlation exceeds 95 %; `count` photographs have it, `value` is the largest."""

    first: str
    second: str
    value: float
    count: int = 1


@dataclass(frozen=True, eq=False)
class BlockAdjustment:
    """An adjusted block.

    Attributes
    ----------
    network : Network
        As it was given.
    options : BlockOptions
    cameras : tuple of Camera
        Adjusted.
    centres, rotations, points : ndarray, shape (n, 3), (n, 3, 3), (p, 3)
        Adjusted; points that are not determined are NaN.
    shared_names : tuple of str (q)
    shared : ndarray, shape (q,)
        Adjusted values of interior parameters, shifts and drifts of strips, boresight.
    used : ndarray of bool, shape (m,)
        Image observations that took part.
    residuals : ndarray, shape (m, 2)
        Observed minus computed pixels, of all image observations.
    sigma0 : float
        NaN without redundancy.
    redundancy, observations, unknowns : int
    test : GlobalTest or None
    iterations, damped : int
    converged : bool
    gross_errors : tuple of GrossError
        Found and taken out, the largest first.
    check_points : tuple of CheckPoint
        Those that stand out are to be counted apart; the notes name them.
    correlations : tuple of Correlation
    statistics : Statistics or None
    solution : Solution
        For more of the inverse: `whole.full_covariance`.
    notes : tuple of str
    """

    network: Network
    options: BlockOptions
    cameras: tuple[Camera, ...]
    centres: Array
    rotations: Array
    points: Array
    shared_names: tuple[str, ...]
    shared: Array
    used: Mask
    residuals: Array
    sigma0: float
    redundancy: int
    observations: int
    unknowns: int
    test: GlobalTest | None
    iterations: int
    damped: int
    converged: bool
    gross_errors: tuple[GrossError, ...]
    check_points: tuple[CheckPoint, ...]
    correlations: tuple[Correlation, ...]
    statistics: Statistics | None
    solution: Solution
    notes: tuple[str, ...]

    @property
    def determined_photos(self) -> Mask:
        """Photographs that observations determine, shape (n,); the others keep their start."""
        return ~self.solution.lonely

    @property
    def rms_px(self) -> tuple[float, float]:
        """Rms of the image residuals that took part, columns and rows."""
        columns, rows = np.sqrt(np.mean(self.residuals[self.used] ** 2, axis=0)).tolist()
        return columns, rows

    def adjusted_network(self) -> Network:
        """The network with the adjusted values as its start; undetermined points keep theirs."""
        points = np.where(np.isfinite(self.points), self.points, self.network.points.xyz)
        moved = self.network.moved_to(self.centres, self.rotations, points)
        cameras = tuple(
            BlockCamera(camera, entry.free)
            for camera, entry in zip(self.cameras, self.network.cameras, strict=True)
        )
        return replace(moved, cameras=cameras)


def adjust_block(
    network: Network, options: BlockOptions | None = None, progress: Progress | None = None
) -> BlockAdjustment:
    """Adjust a block rigorously in the tangent frame.

    Parameters
    ----------
    network : Network
        Observations and approximate values.
    options : BlockOptions, optional
    progress : callable, optional
        Gets the number of each iteration and its cost.

    Returns
    -------
    BlockAdjustment

    Raises
    ------
    NotDeterminedError
        If the observations do not determine an unknown; the message names it.
    InputError
        If the datum is open and inner constraints are not allowed.
    """
    options = options or BlockOptions()
    width = options.huber_width if options.robust != "none" else math.inf
    searching = options.robust in ("snooping", "l1")
    # Without what cannot be right: as far as the datum does not hang on it.
    out = implausible(network) if searching else {}
    if out and find_defect(without(network, out)).size > find_defect(network).size:
        out = {}
    solution = run_loop(without(network, out), options, width=width, progress=progress)
    gross: tuple[GrossError, ...] = ()
    statistics: Statistics | None = None
    if searching:
        solution, gross, statistics = snoop(network, options, solution, progress, out)
        width = math.inf
        statistics = statistics if options.statistics else None
    notes = list(solution.notes)
    if out:
        notes.append(screening_note(network, out))
    if options.statistics and statistics is None:
        try:
            statistics = statistics_of(solution, options, width)
        except NotDeterminedError as error:
            notes.append(str(error))
    # The equations are as large as all the rest, and no longer needed.
    solution = replace(solution, linearised=None)
    return _result(network, options, solution, statistics, gross, tuple(notes))


def _result(
    network: Network,
    options: BlockOptions,
    solution: Solution,
    statistics: Statistics | None,
    gross: tuple[GrossError, ...],
    notes: tuple[str, ...],
) -> BlockAdjustment:
    state, layout = solution.state, solution.prepared.layout
    observations, unknowns = counts(solution)
    redundancy = observations - unknowns
    shared = state.shared.copy()
    for values, first, chosen in zip(state.cameras, layout.first.tolist(), layout.chosen, strict=True):
        shared[first : first + len(chosen)] = values[chosen]
    known = solution.determined
    if network.control is not None:
        known = known | (solution.prepared.control >= 0)
    correlations: tuple[Correlation, ...] = ()
    if statistics is not None:
        correlations = find_correlations(network, statistics, layout.names)
        notes = (*notes, *_inseparable(correlations))
    points = np.where(known[:, None], state.points, np.nan)
    checked = judged_check_points(network.control, network.points.names, points, statistics, options)
    notes = (*notes, *_contradicting(checked))
    return BlockAdjustment(
        network=network,
        options=options,
        cameras=tuple(
            camera_from_values(entry.camera, values)
            for entry, values in zip(network.cameras, state.cameras, strict=True)
        ),
        centres=state.centres,
        rotations=state.rotations,
        points=points,
        shared_names=layout.names,
        shared=shared,
        used=solution.used,
        residuals=residuals_at(solution.prepared, state),
        sigma0=math.sqrt(solution.cost / redundancy) if redundancy > 0 else math.nan,
        redundancy=redundancy,
        observations=observations,
        unknowns=unknowns,
        test=_global_test(solution.cost, redundancy, options.tests.alpha_global),
        iterations=solution.iterations,
        damped=solution.damped,
        converged=solution.converged,
        gross_errors=gross,
        check_points=checked,
        correlations=correlations,
        statistics=statistics,
        solution=solution,
        notes=notes,
    )


def _contradicting(checked: tuple[CheckPoint, ...]) -> list[str]:
    """Check points that stand out, in words."""
    notes = []
    for point in checked:
        if point.stands_out:
            x, y, z = point.difference
            why = f", {point.reason}" if point.reason else ""
            notes.append(
                f"check point {point.name} contradicts the block and is counted apart: given minus adjusted "
                f"{x:+.3f}, {y:+.3f}, {z:+.3f} m{why}"
            )
    return notes


def _global_test(cost: float, redundancy: int, alpha: float) -> GlobalTest | None:
    if redundancy <= 0:
        return None
    lower, upper = (float(chi2.ppf(p, redundancy)) for p in (alpha / 2.0, 1.0 - alpha / 2.0))
    return GlobalTest(cost, lower, upper, lower <= cost <= upper)


def find_correlations(
    network: Network, statistics: Statistics, names: tuple[str, ...]
) -> tuple[Correlation, ...]:
    """Pairs over 95 %: of shared unknowns, and of these with photographs' and photographs' own unknowns."""
    cofactors = statistics.cofactors
    found: list[Correlation] = []
    among = _normalised(cofactors.shared)
    for i, j in zip(*np.nonzero(np.triu(np.abs(among) > _CORRELATED, 1)), strict=True):
        found.append(Correlation(names[i], names[j], float(among[i, j])))
    own = ("X0", "Y0", "Z0", "rotation x", "rotation y", "rotation z")
    inner = _normalised(cofactors.photos)
    diagonal = np.diagonal(cofactors.photos, axis1=1, axis2=2)
    with np.errstate(invalid="ignore", divide="ignore"):
        cross = cofactors.photo_shared / np.sqrt(diagonal[:, :, None] * np.diag(cofactors.shared))
    for i in range(6):
        for j in range(i + 1, 6):
            found += _over(f"{own[i]} of a photograph", f"{own[j]} of the same", inner[:, i, j])
        for j, name in enumerate(names):
            found += _over(name, f"{own[i]} of photographs", cross[:, i, j])
    return tuple(found)


def _over(first: str, second: str, values: Array) -> list[Correlation]:
    over = np.abs(np.nan_to_num(values)) > _CORRELATED
    if not over.any():
        return []
    largest = values[over][np.argmax(np.abs(values[over]))]
    return [Correlation(first, second, float(largest), int(over.sum()))]


def _normalised(matrices: Array) -> Array:
    root = np.sqrt(np.diagonal(matrices, axis1=-2, axis2=-1))
    with np.errstate(invalid="ignore", divide="ignore"):
        result: Array = matrices / (root[..., :, None] * root[..., None, :])
    return result


def _inseparable(correlations: tuple[Correlation, ...]) -> list[str]:
    """Correlations that a surveyor has to know of, in words."""
    notes = []
    for entry in correlations:
        if "principal_distance_mm" in entry.first and entry.second.startswith("Z0"):
            notes.append(
                f"{entry.first} and the height of {entry.count} photographs are not separable "
                f"(correlation {entry.value:.3f}): hold the principal distance, or give it a prior"
            )
    return notes


__all__ = ["BlockAdjustment", "Correlation", "GlobalTest", "adjust_block"]
