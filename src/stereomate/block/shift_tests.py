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
from typing import Final, Literal

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

Kind = Literal["strip", "all", "mount"]

# Part of a strip's information that must be left for a shift of it to show at all.
_SEEN: Final = 1e-6
# Correlation of two shifts from which they are one to the observations.
_ALIKE: Final = 0.95


@dataclass(frozen=True, eq=False)
class ShiftTest:
    """A shift of the positions of one strip: what the block says of it.

    Attributes
    ----------
    kind : {"strip", "all", "mount"}
        Of the positions of one strip, of all, or of all that have one lever arm, in camera axes.
    strip : int
        Number of the strip or of the mount; -1 for all.
    photo : ndarray of int
        Photographs of the strip.
    shift, sigma : ndarray, shape (3,)
        Estimated, east, north, up of the tangent frame (of a mount along the axes of the camera), metres;
        NaN where the block says nothing of it.
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

    kind: Kind
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
    """Test a shift of each strip, of all positions, and of those of one mount along the axes of the camera.

    The last is what a lever arm that is off, or a principal point, does: strips flown there and back are
    shifted to opposite sides.

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
    positions = adjustment.network.positions
    assert positions is not None  # the group is of them
    assert positions.mount is not None  # filled in by the network
    of = np.where((group.weight > 0.0).any(axis=1), strips[group.photo], -1)
    present = np.unique(of[of >= 0]).tolist()
    if not present:
        return ()
    place = np.array([present.index(s) if s >= 0 else -1 for s in of.tolist()])
    mounts = np.unique(positions.mount).tolist()
    mount = np.array([mounts.index(m) for m in positions.mount.tolist()])
    turns = solution.state.rotations[group.photo]
    count = len(present)
    every = np.concatenate([place, count + mount])
    axes = np.concatenate([np.broadcast_to(np.eye(3), turns.shape), turns])
    w, m, information = _normal(adjustment, group, every, axes, count + len(mounts))
    scale = max(adjustment.statistics.scale, 1.0)
    tests = []
    for k in range(count + len(mounts)):
        rows = slice(3 * k, 3 * k + 3)
        found = _test(adjustment, w[rows], m[rows, rows], information[k], scale)
        if k >= count:
            tests.append(_named("mount", mounts[k - count], group.photo[mount == k - count], found, ()))
            continue
        alike = tuple(present[j] for j in _alike(found[0], m, information[:count], k)) if found[-1] else ()
        tests.append(_named("strip", present[k], group.photo[place == k], found, alike))
    if count > 1:
        total = np.tile(np.eye(3), count)
        inner = slice(0, 3 * count)
        summed = information[:count].sum(axis=0)
        found = _test(adjustment, total @ w[inner], total @ m[inner, inner] @ total.T, summed, scale)
        tests.append(_named("all", -1, group.photo[place >= 0], found, ()))
    return tuple(tests)


_Found = tuple[Array, Array, float, float, int, Array, bool]


def _named(kind: Kind, strip: int, photo: Integers, found: _Found, alike: tuple[int, ...]) -> ShiftTest:
    shift, sigma, statistic, limit, dimension, detectable, significant = found
    return ShiftTest(
        kind, strip, photo, shift, sigma, statistic, limit, dimension, significant, detectable, alike
    )


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


def _normal(
    adjustment: BlockAdjustment, group: Group, place: Integers, axes: Array, count: int
) -> tuple[Array, Array, Array]:
    """``Cᵀ P v`` (3 s,), ``Cᵀ P Q_vv P C`` (3 s, 3 s) of all shifts, and the diagonal of ``Cᵀ P C`` (s, 3).

    `place`, `axes`: of each observation, once or several times over, its shift and the axes of that.
    """
    solution = adjustment.solution
    prepared = solution.prepared
    n, q = len(solution.state.centres), len(prepared.layout.names)
    photos, shared = np.zeros((3 * count, n, 6)), np.zeros((3 * count, q))
    w, m = np.zeros(3 * count), np.zeros((3 * count, 3 * count))
    rows_of = [np.flatnonzero(place == k) for k in range(count)]
    g = len(group.photo)
    # What two shifts have in common of the observations themselves: those of strips and mounts overlap.
    own = np.zeros((count, g, 3, 3))
    for k, entries in enumerate(rows_of):
        own[k, entries % g] = axes[entries]
    taken = own.any(axis=(2, 3)).astype(np.float64)
    common: NDArray[np.bool_] = np.asarray(np.matmul(taken, taken.T) > 0.0)
    for k in range(count):
        at = slice(3 * k, 3 * k + 3)
        weighted = np.einsum("gij,gi->gji", own[k], group.weight)
        w[at] = np.einsum("gji,gi->j", weighted, group.residual)
        for j in np.flatnonzero(common[k]).tolist():
            m[at, 3 * j : 3 * j + 3] = np.einsum("gji,gik->jk", weighted, own[j])
        by_photo = np.einsum("gji,gia->gja", weighted, group.by_photo)
        for x in range(3):
            np.add.at(photos[3 * k + x], group.photo, by_photo[:, x])
        by_shared = np.einsum("gji,gis->gjs", weighted, group.by_shared)
        here = group.columns >= 0
        for x in range(3):
            np.add.at(shared[3 * k + x], group.columns[here], by_shared[:, x][here])
    information = np.diag(m).reshape(count, 3).copy()
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
    return w, 0.5 * (m + m.T), information


__all__ = ["ShiftTest", "noncentrality", "shift_tests"]
