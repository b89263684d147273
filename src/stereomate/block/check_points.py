"""Check points against the adjusted block: which of them can be believed.

A check point takes no part in the adjustment, so nothing there finds a wrong one. Its difference has a
standard deviation, of the block and of the point itself; and what is wrong with all check points is the
block, what is wrong with one of them is that one. What stands out is named and counted apart, never dropped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from stereomate.block.network import Control
from stereomate.block.options import BlockOptions
from stereomate.block.statistics import Statistics

Array = NDArray[np.float64]

# Over so many times the median size of all differences a point stands out among the others, as soon as there
# are so many of them.
_TIMES_MEDIAN: Final = 5.0
_LEAST: Final = 4
# An exchange explains a difference if it leaves less than this part of it.
_EXPLAINED: Final = 0.1


@dataclass(frozen=True)
class CheckPoint:
    """A check point against the adjusted block.

    Attributes
    ----------
    row : int
        In the control of the network.
    name : str
    difference : tuple of float
        Given minus adjusted, metres; NaN for axes that are not known.
    standardized : tuple of float
        In standard deviations of the difference; NaN without statistics.
    stands_out : bool
        Too far off for its standard deviation and against the other check points: to be counted apart.
    reason : str
        What would explain it, as far as the block can tell.
    """

    row: int
    name: str
    difference: tuple[float, float, float]
    standardized: tuple[float, float, float]
    stands_out: bool
    reason: str


def judged_check_points(
    control: Control | None,
    names: tuple[str, ...],
    points: Array,
    statistics: Statistics | None,
    options: BlockOptions,
) -> tuple[CheckPoint, ...]:
    """Check points of a network against its adjusted `points` (p, 3), NaN for those not determined.

    Without statistics only the other points judge.
    """
    if control is None or control.check is None or not control.check.any():
        return ()
    rows = np.flatnonzero(control.check & np.isfinite(points[control.point]).all(axis=1))
    given = np.where(np.isfinite(control.sigma[rows]), control.xyz[rows], np.nan)
    difference = given - points[control.point[rows]]
    standardized = np.full(difference.shape, np.nan)
    if statistics is not None:
        own = statistics.point_sigma[control.point[rows]]
        with np.errstate(invalid="ignore", divide="ignore"):
            standardized = difference / np.hypot(own, control.sigma[rows])
    limit = float(norm.isf(options.tests.alpha / 2.0))
    over = np.nan_to_num(np.abs(standardized)).max(axis=1, initial=0.0) > limit
    if statistics is None:
        over[:] = len(over) >= _LEAST
    over &= _among_others(difference)
    return tuple(
        CheckPoint(
            row,
            names[control.point[row]],
            _three(difference[k]),
            _three(standardized[k]),
            bool(over[k]),
            _reason(control, names, row, difference[k]) if over[k] else "",
        )
        for k, row in enumerate(rows.tolist())
    )


def _among_others(difference: Array) -> NDArray[np.bool_]:
    """Whether each is far from the others too, plan and height apart; a few points judge nobody."""
    if len(difference) < _LEAST:
        return np.ones(len(difference), np.bool_)
    over = np.zeros(len(difference), np.bool_)
    for part in (difference[:, :2], difference[:, 2:]):
        size = np.linalg.norm(part, axis=1)
        known = size[np.isfinite(size)]
        if known.size >= _LEAST:
            over |= np.nan_to_num(size) > _TIMES_MEDIAN * float(np.median(known))
        else:
            over |= np.isfinite(size)
    return over


def _reason(control: Control, names: tuple[str, ...], row: int, difference: Array) -> str:
    """Whether the coordinates are those of another point."""
    adjusted = control.xyz[row] - difference
    others = np.linalg.norm(control.xyz - adjusted, axis=1)
    others[row] = math.inf
    if not np.isfinite(others).any():
        return ""
    nearest = int(np.nanargmin(others))
    neighbours = np.linalg.norm(control.xyz - control.xyz[nearest], axis=1)
    neighbours[[row, nearest]] = math.inf
    # A large error leaves many points near enough: nearer than its own neighbours it must be, too.
    size = min(float(np.linalg.norm(np.nan_to_num(difference))), float(np.nanmin(neighbours)))
    if others[nearest] < _EXPLAINED * size:
        return f"its rays meet at {names[control.point[nearest]]}"
    return ""


def _three(values: Array) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z
