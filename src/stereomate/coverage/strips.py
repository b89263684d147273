"""Strips of a flight, found from the order of its photographs and their centres."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

# A base that turns more than this against its strip begins another one.
_TURN: Final = math.cos(math.radians(35.0))
# So does one of more than so many times the median base.
_GAP: Final = 3.0
# Photographs of a rig are taken at one place: closer than this part of the median base.
_SAME_PLACE: Final = 0.2


def flight_strips(names: Sequence[str], centres: Array, times: Array | None = None) -> Integers:
    """Number the strips of a flight.

    Taken in the order of their times, else of the numbers in their names; a strip ends where the flight turns
    or leaves a gap.

    Parameters
    ----------
    names : sequence of str (n)
    centres : ndarray, shape (n, 3) or (n, 2)
        In any metric frame; NaN for photographs without.
    times : ndarray, shape (n,), optional
        Seconds; used if all photographs that have a centre have one.

    Returns
    -------
    ndarray of int, shape (n,)
        From 0 in the order of the flight; -1 for photographs without a centre and for those that lie alone.
    """
    strips = np.full(len(names), -1, dtype=np.int64)
    known = np.flatnonzero(np.isfinite(centres).all(axis=1))
    if len(known) < 2:
        return strips
    order = known[flight_order([names[k] for k in known.tolist()], None if times is None else times[known])]
    plan = centres[order, :2]
    bases = np.diff(plan, axis=0)
    lengths = np.linalg.norm(bases, axis=1)
    moving = lengths[lengths > _SAME_PLACE * np.median(lengths)]
    if not len(moving):
        strips[order] = 0
        return strips
    usual = float(np.median(moving))
    groups: list[list[int]] = [[int(order[0])]]
    heading = np.zeros(2)
    for k, (base, length) in enumerate(zip(bases, lengths.tolist(), strict=True)):
        here = int(order[k + 1])
        if length <= _SAME_PLACE * usual:
            groups[-1].append(here)
            continue
        straight = float(base @ heading) >= _TURN * length * float(np.linalg.norm(heading))
        if length > _GAP * usual or not straight:
            groups.append([here])
            heading = np.zeros(2)
            continue
        groups[-1].append(here)
        heading = heading + base
    number = 0
    for group in groups:
        if len(group) > 1:
            strips[group] = number
            number += 1
    return strips


def flight_order(names: Sequence[str], times: Array | None = None) -> Integers:
    """Order in which photographs were taken: by time if all have one, else by the numbers in names."""
    order = np.array(sorted(range(len(names)), key=lambda k: _natural(names[k])), dtype=np.int64)
    if times is not None and np.isfinite(times).all() and len(np.unique(times)) > 1:
        order = order[np.argsort(times[order], kind="stable")]
    return order


def _natural(name: str) -> list[tuple[int, int, str]]:
    """Names with their numbers as numbers: 9 before 10."""
    return [(1, int(part), "") if part.isdigit() else (0, 0, part) for part in re.split(r"(\d+)", name)]
