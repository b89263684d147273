"""A shift of the positions of one strip as an alternative hypothesis, and the shift that could be seen.

One residual of a strip that is shifted as a whole says little: its neighbours are shifted too. The hypothesis
``l = A x + C ∇ + e`` with one shift ∇ for all positions of a strip is tested by all residuals v of them
(Baarda 1968; Teunissen 2006, Testing Theory, 3.1):

    w = Cᵀ P v,   M = Cᵀ P Q_vv P C,   ∇ = M⁻¹ w,   T = wᵀ M⁻¹ w ~ χ²(q, λ),   λ = ∇ᵀ M ∇

Q_vv needs the covariances of all photographs of a strip: three columns of the inverse for each. The level is
that of the tests of single observations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrs
from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

from stereomate.block.adjustment import BlockAdjustment
from stereomate.block.equations import build, factor
from stereomate.block.navigation import Group, groups_of
from stereomate.block.triangular import forward
from stereomate.errors import NotDeterminedError

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

# Part of a strip's information that must be left for a shift of it to show at all.
_SEEN: Final = 1e-6
# Correlation of two shifts from which they are one to the observations.
_ALIKE: Final = 0.95


@dataclass(frozen=True, eq=False)
class ShiftTest:
    """A shift of the positions of one strip: what the block says of it.

    Attributes
    ----------
    strip : int
        -1: all positions together.
    photo : ndarray of int
        Photographs of the strip.
    shift, sigma : ndarray, shape (3,)
        Estimated, east, north, up of the tangent frame, metres; NaN where the block says nothing of it.
    statistic, limit : float
        Of the test of the shift as a whole; NaN where no direction shows.
    dimension : int
        Directions that show, 0 to 3.
    significant : bool
    detectable : ndarray, shape (3,)
        Smallest shift along each axis that the test finds with the power asked for, metres; infinite where
        none is ever found.
    alike : tuple of int
        Strips whose shift, the other way, would look the same.
    """

    strip: int
    photo: Integers
    shift: Array
    sigma: Array
    statistic: float
    limit: float
    dimension: int
    significant: bool
    detectable: Array
    alike: tuple[int, ...]


def shift_tests(adjustment: BlockAdjustment, strips: Integers) -> tuple[ShiftTest, ...]:
    """Test a shift of each strip, and of all positions together, from an adjustment by least squares.

    Parameters
    ----------
    adjustment : BlockAdjustment
        With positions; gross errors are out.
    strips : ndarray of int, shape (n,)
        Strip of each photograph; -1 for none.

    Raises
    ------
    NotDeterminedError
        If the normal matrix is singular at the solution.
    """
    solution = adjustment.solution
    prepared = solution.prepared
    group = groups_of(prepared.network, prepared.layout, solution.state).get("positions")
    if group is None or adjustment.statistics is None:
        return ()
    of = strips[group.photo]
    present = np.unique(of[(of >= 0) & (group.weight > 0.0).any(axis=1)]).tolist()
    if not present:
        return ()
    number = {strip: k for k, strip in enumerate(present)}
    place = np.array([number.get(int(s), -1) for s in of])
    w, m = _normal(adjustment, group, place, len(present))
    information = np.zeros((len(present), 3))
    inside = place >= 0
    np.add.at(information, place[inside], group.weight[inside])
    scale = max(adjustment.statistics.scale, 1.0)
    tests = []
    for strip, k in number.items():
        rows = slice(3 * k, 3 * k + 3)
        found = _test(adjustment, w[rows], m[rows, rows], information[k], scale)
        photo = group.photo[place == k]
        alike = tuple(present[j] for j in _alike(found[0], m, information, k)) if found[-1] else ()
        tests.append(_named(strip, photo, found, alike))
    if len(present) > 1:
        every = np.tile(np.eye(3), len(present))
        found = _test(adjustment, every @ w, every @ m @ every.T, information.sum(axis=0), scale)
        tests.append(_named(-1, group.photo[inside], found, ()))
    return tuple(tests)


_Found = tuple[Array, Array, float, float, int, Array, bool]


def _named(strip: int, photo: Integers, found: _Found, alike: tuple[int, ...]) -> ShiftTest:
    shift, sigma, statistic, limit, dimension, detectable, significant = found
    return ShiftTest(strip, photo, shift, sigma, statistic, limit, dimension, significant, detectable, alike)


def _test(adjustment: BlockAdjustment, w: Array, m: Array, information: Array, scale: float) -> _Found:
    """Shift, its standard deviation, statistic, limit, dimension, detectable sizes and whether it is one."""
    tests = adjustment.options.tests
    unit = np.sqrt(np.maximum(information, 1e-300))
    values, vectors = np.linalg.eigh(m / np.outer(unit, unit))
    seen = (values > _SEEN) & (information > 0.0).any()
    nothing = np.full(3, math.nan)
    detectable = np.full(3, math.inf)
    q = int(seen.sum())
    if not q:
        return nothing, nothing.copy(), math.nan, math.nan, 0, detectable, False
    part = vectors[:, seen]
    # The inverse over what shows; an axis outside of it has no shift.
    inverse = (part / values[seen]) @ part.T / np.outer(unit, unit)
    shown = np.linalg.norm(part.T, axis=0) > math.sqrt(1.0 - 1e-6)
    shift = np.where(shown, inverse @ w, math.nan)
    sigma = np.where(shown, scale * np.sqrt(np.diag(inverse)), math.nan)
    statistic = float(w @ inverse @ w) / scale**2
    limit = float(chi2.isf(tests.alpha, q))
    diagonal = np.diag(m)
    visible = diagonal > _SEEN * information
    size = noncentrality(tests.alpha, tests.power, q)
    detectable[visible] = scale * np.sqrt(size / diagonal[visible])
    return shift, sigma, statistic, limit, q, detectable, statistic > limit


def noncentrality(alpha: float, power: float, dimension: int) -> float:
    """Size λ of the error that a chi-square test of level `alpha` finds with probability `power`.

    17.1 in one dimension for 0.1 % and 80 % (Baarda's 4.13 squared), 21.5 in three.
    """
    limit = float(chi2.isf(alpha, dimension))
    return float(brentq(lambda size: ncx2.sf(limit, dimension, size) - power, 1e-9, limit + 200.0))


def _alike(shift: Array, m: Array, information: Array, k: int) -> list[int]:
    """Strips (their rows) whose shift along the same direction cannot be told from this one."""
    direction = np.nan_to_num(shift)
    size = float(np.linalg.norm(direction))
    if not size > 0.0:
        return []
    direction /= size
    own = slice(3 * k, 3 * k + 3)
    mine = float(direction @ m[own, own] @ direction)
    found = []
    for j in range(len(information)):
        other = slice(3 * j, 3 * j + 3)
        theirs = float(direction @ m[other, other] @ direction)
        both = float(direction @ m[own, other] @ direction)
        seen = theirs > _SEEN * float(direction**2 @ information[j])
        if j != k and seen and abs(both) > _ALIKE * math.sqrt(mine * theirs):
            found.append(j)
    return found


def _normal(adjustment: BlockAdjustment, group: Group, place: Integers, count: int) -> tuple[Array, Array]:
    """``Cᵀ P v`` (3 s,) and ``Cᵀ P Q_vv P C`` (3 s, 3 s) of the shifts of all strips."""
    solution = adjustment.solution
    prepared = solution.prepared
    n, q = len(solution.state.centres), len(prepared.layout.names)
    photos, shared = np.zeros((3 * count, n, 6)), np.zeros((3 * count, q))
    w, m = np.zeros(3 * count), np.zeros((3 * count, 3 * count))
    for row in np.flatnonzero(place >= 0).tolist():
        at = 3 * int(place[row])
        k, weight = int(group.photo[row]), group.weight[row]
        w[at : at + 3] += weight * group.residual[row]
        m[range(at, at + 3), range(at, at + 3)] += weight
        photos[at : at + 3, k] += weight[:, None] * group.by_photo[row]
        mine = group.columns[row] >= 0
        shared[at : at + 3, group.columns[row][mine]] += weight[:, None] * group.by_shared[row][:, mine]
    equations = build(prepared, solution.state, solution.start)
    factored = factor(prepared, equations)
    if factored.singular >= 0:
        raise NotDeterminedError("the normal matrix is singular at the solution")
    right = np.empty_like(photos)
    right[:, prepared.place] = photos * prepared.free_photo
    half = right.reshape(3 * count, 6 * n)
    forward(factored.factor, prepared.skew, half)
    m -= half @ half.T
    if q:
        rest = shared - half @ factored.half.T
        solved, _ = dpotrs(factored.corner, np.asfortranarray(rest.T), lower=1)
        m -= rest @ solved
    return w, 0.5 * (m + m.T)


__all__ = ["ShiftTest", "noncentrality", "shift_tests"]
