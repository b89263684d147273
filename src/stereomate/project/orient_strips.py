"""Shifts of the positions of whole strips: tested, and taken as unknown where the block shows one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.block.adjustment import BlockAdjustment, adjust_block
from stereomate.block.network import Positions
from stereomate.block.orient_network import Assembled, BlockData
from stereomate.block.shift_tests import ShiftTest, shift_tests
from stereomate.block.variance import good_network
from stereomate.errors import NotDeterminedError

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

# A shift is the simpler explanation if it saves more coordinates than it has.
_UNKNOWNS: Final = 3
# Another shift is told from the best one if it is less than a twentieth as likely.
_DOUBT: Final = 2.0 * math.log(20.0)
# Prior of the axes of a lever arm along which nothing shows, metres.
_LEAST_M: Final = 1e-3
_LEAST_SIGMAS: Final = 3.3


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
        for _ in range(int(strips.max(initial=-1)) + 1):
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
    """The shift that explains most, and the block adjusted with it; None where none does."""
    given = assembled.network.positions
    assert given is not None  # asked before
    out = _out(result)
    # A shift that is significant, but for which no position had to go, is told and leaves the block as it is:
    # errors of the images that go together look like one, and positions do not err because of them.
    if len(out) <= _UNKNOWNS:
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
    known = {(test.kind, test.strip) for test in found}
    if not tests or tests[0].kind == "all" or (tests[0].kind, tests[0].strip) in known:
        return None
    best = tests[0]
    # Strips flown there and back: an offset of the camera is a shift of theirs to opposite sides.
    rivals = [t for t in tests[1:] if t.kind != "all" and t.statistic > best.statistic - _DOUBT]
    best = replace(best, alike=_rivals(best, rivals, strips)) if rivals else best
    network = replace(assembled.network, positions=_with_unknown(given, strips, (*found, best)))
    start = result.adjusted_network()
    network = replace(network, photographs=start.photographs, points=start.points)
    try:
        trial = adjust_block(network, result.options)
    except NotDeterminedError:
        return None
    if not trial.converged or len(_out(trial)) + _UNKNOWNS >= len(out):
        return None
    return replace(assembled, network=network), trial, best


def _rivals(best: ShiftTest, rivals: Sequence[ShiftTest], strips: Integers) -> tuple[int, ...]:
    """Strips whose shifts explain as much as the best: all of them where an offset of the camera does."""
    numbers = {s for test in (best, *rivals) for s in (test.strip, *test.alike) if test.kind == "strip"}
    if any(test.kind == "mount" for test in (best, *rivals)):
        numbers |= set(np.unique(strips[strips >= 0]).tolist())
    return tuple(sorted(numbers - ({best.strip} if best.kind == "strip" else set())))


def _with_unknown(given: Positions, strips: Integers, found: Sequence[ShiftTest]) -> Positions:
    """The positions with a shift unknown for the strips, and a lever arm for the mounts, that were found."""
    shifted = [test for test in found if test.kind == "strip" or test.alike]
    own = {test.strip for test in shifted if test.kind == "strip"}
    numbers = sorted(own.union(*(test.alike for test in shifted)))
    if numbers:
        of = strips[given.photo]
        chosen = np.where(np.isin(of, numbers), of, -1)
        given = replace(given, strip=chosen, shift=True, drift=False, shift_sigma=_prior(shifted))
    mounts = [test for test in found if test.kind == "mount" and not test.alike]
    if mounts and not given.lever_arm_sigma.any():
        # What does not show of it is as good as it was: a height without control would be any.
        sizes = [np.where(_shows(test), np.abs(test.shift), 0.0) for test in mounts]
        given = replace(given, lever_arm_sigma=np.maximum(np.max(sizes, axis=0), _LEAST_M))
    return given


def _shows(test: ShiftTest) -> NDArray[np.bool_]:
    """Axes along which a shift alone is more than chance."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.abs(test.shift) > _LEAST_SIGMAS * test.sigma)


def _prior(tests: Sequence[ShiftTest]) -> Array:
    """Prior of the shifts: none where it is known which strip it is, else the size of what contradicts."""
    if not any(test.alike for test in tests):
        return np.full(3, math.inf)
    sizes = np.max([np.where(_shows(t), np.abs(t.shift) + t.sigma, _LEAST_M) for t in tests], axis=0)
    # The axes of a camera lie in the map as the flight does; from there the strips shift to both sides.
    if any(test.kind == "mount" for test in tests):
        sizes[:2] = np.linalg.norm(sizes[:2])
    return np.asarray(sizes)


def _out(result: BlockAdjustment) -> set[tuple[int, int]]:
    """Coordinates of positions that the tests took out: row, axis."""
    return {
        (error.row, axis)
        for error in result.gross_errors
        if error.kind == "positions"
        for axis in np.flatnonzero(np.isfinite(error.size)).tolist()
    }
