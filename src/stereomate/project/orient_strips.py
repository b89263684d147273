"""Shifts of the positions of whole strips: tested, and taken as unknown where the block shows one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.block.adjustment import BlockAdjustment, adjust_block
from stereomate.block.orient_network import Assembled, BlockData
from stereomate.block.shift_tests import ShiftTest, shift_tests
from stereomate.block.variance import good_network
from stereomate.errors import NotDeterminedError

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

# A shift is the simpler explanation if it saves more coordinates than it has.
_UNKNOWNS: Final = 3


@dataclass(frozen=True, eq=False)
class StripShifts:
    """What became of the strips.

    Attributes
    ----------
    tests : tuple of ShiftTest
        Of the block as it was adjusted at last; none where there are no positions.
    shifted : tuple of ShiftTest
        Those that were taken as unknown, as they were found.
    """

    tests: tuple[ShiftTest, ...]
    shifted: tuple[ShiftTest, ...]


def with_shifted_strips(
    data: BlockData, assembled: Assembled, result: BlockAdjustment
) -> tuple[Assembled, BlockAdjustment, StripShifts]:
    """The block with a shift unknown for each strip whose positions are shifted as a whole.

    Only where gross errors are looked for at all, and the project does not make shifts unknown itself: a
    strip whose positions would be taken out one by one is explained more simply by one shift.
    """
    positions, groups = result.network.positions, data.groups
    if positions is None or groups is None:
        return assembled, result, StripShifts((), ())
    strips = groups.strip[assembled.photos]
    found: list[ShiftTest] = []
    if result.options.robust in ("snooping", "l1") and not positions.shift:
        for _ in range(int(strips.max(initial=-1))):
            step = _explained(assembled, result, strips, found)
            if step is None:
                break
            assembled, result, test = step
            found.append(test)
    return assembled, result, StripShifts(_tests(result, strips), tuple(found))


def _tests(result: BlockAdjustment, strips: Integers) -> tuple[ShiftTest, ...]:
    try:
        return shift_tests(result, strips)
    except NotDeterminedError:
        return ()


def _explained(
    assembled: Assembled, result: BlockAdjustment, strips: Integers, found: Sequence[ShiftTest]
) -> tuple[Assembled, BlockAdjustment, ShiftTest] | None:
    """The strip whose shift explains most, and the block adjusted with it; None where none does."""
    given = assembled.network.positions
    assert given is not None  # asked before
    out = _out(result)
    now = {test.strip: test for test in _tests(result, strips)}
    if not out and not any(test.significant for test in now.values()):
        return None
    # With all positions back: what was taken out is what a shift has to explain.
    whole = replace(good_network(result), positions=given)
    try:
        plain = adjust_block(whole, replace(result.options, robust="none"))
    except NotDeterminedError:
        return None
    tests = [test for test in _tests(plain, strips) if test.significant]
    tests.sort(key=lambda test: -test.statistic)
    # A shift of all positions against control is another matter: its cause is not a strip.
    if not tests or tests[0].strip < 0 or tests[0].strip in {test.strip for test in found}:
        return None
    best = tests[0]
    shifted = sorted({best.strip, *best.alike, *(s for test in found for s in (test.strip, *test.alike))})
    prior = _prior((*found, best))
    of = strips[given.photo]
    positions = replace(
        given, strip=np.where(np.isin(of, shifted), of, -1), shift=True, drift=False, shift_sigma=prior
    )
    network = replace(assembled.network, positions=positions)
    start = result.adjusted_network()
    network = replace(network, photographs=start.photographs, points=start.points)
    try:
        trial = adjust_block(network, result.options)
    except NotDeterminedError:
        return None
    before, after = len(out), len(_out(trial))
    held = now.get(best.strip)
    seen = held is not None and held.significant and after <= before
    if not trial.converged or not (seen or after + _UNKNOWNS < before):
        return None
    return replace(assembled, network=network), trial, best


def _prior(tests: Sequence[ShiftTest]) -> Array:
    """Prior of the shifts: none where it is known which strip it is, else the size of what contradicts."""
    if not any(test.alike for test in tests):
        return np.full(3, math.inf)
    sizes = [np.abs(np.nan_to_num(test.shift)) + np.nan_to_num(test.sigma) for test in tests]
    return np.asarray(np.max(sizes, axis=0))


def _out(result: BlockAdjustment) -> set[tuple[int, int]]:
    """Coordinates of positions that the tests took out: row, axis."""
    return {
        (error.row, axis)
        for error in result.gross_errors
        if error.kind == "positions"
        for axis in np.flatnonzero(np.isfinite(error.size)).tolist()
    }
