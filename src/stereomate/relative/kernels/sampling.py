"""Reproducible random subsets."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import kernel

Ints = NDArray[np.int64]
Words = NDArray[np.uint64]


@kernel
def next_random(state: Words) -> int:
    """xorshift64*: the next of a reproducible sequence, state (1,) uint64."""
    x = state[0]
    x ^= x >> np.uint64(12)
    x ^= x << np.uint64(25)
    x ^= x >> np.uint64(27)
    state[0] = x
    number: int = (x * np.uint64(2685821657736338717)) >> np.uint64(32)
    return number


@kernel
def draw_subset(state: Words, n: int, chosen: Ints) -> None:
    """`chosen` gets distinct random indices below n in random order (Floyd's method, then a shuffle)."""
    m = chosen.shape[0]
    if m * 4 >= n:
        order = np.arange(n)
        for i in range(m):
            j = i + np.int64(next_random(state) % np.uint64(n - i))
            order[i], order[j] = order[j], order[i]
            chosen[i] = order[i]
        return
    taken = np.zeros(n, np.bool_)
    count = 0
    while count < m:
        j = np.int64(next_random(state) % np.uint64(n))
        if not taken[j]:
            taken[j] = True
            chosen[count] = j
            count += 1


@kernel
def draw_five(state: Words, n: int, five: Ints) -> None:
    count = 0
    while count < 5:
        j = np.int64(next_random(state) % np.uint64(n))
        fresh = True
        for k in range(count):
            if five[k] == j:
                fresh = False
        if fresh:
            five[count] = j
            count += 1
