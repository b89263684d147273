"""Real roots of a polynomial of degree ten, isolated by a Sturm chain."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import kernel

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

DEGREE = 10


@kernel
def value(poly: Array, degree: int, x: float) -> float:
    """A polynomial with coefficients from low to high at x."""
    v: float = poly[degree]
    for i in range(degree - 1, -1, -1):
        v = v * x + poly[i]
    return v


@kernel
def _sturm_chain(poly: Array, chain: Array, degrees: Ints) -> int:
    """Sturm's chain of a polynomial of degree ten; returns its length."""
    top = 0.0
    for i in range(DEGREE + 1):
        top = max(top, abs(poly[i]))
    degree = DEGREE
    while degree > 0 and abs(poly[degree]) <= 1e-14 * top:
        degree -= 1
    if degree == 0:
        return 0
    for i in range(degree + 1):
        chain[0, i] = poly[i] / top
    degrees[0] = degree
    for i in range(degree):
        chain[1, i] = chain[0, i + 1] * (i + 1)
    degrees[1] = degree - 1
    length = 2
    work = np.empty(DEGREE + 1)
    while degrees[length - 1] > 0:
        a, b = length - 2, length - 1
        da, db = degrees[a], degrees[b]
        for i in range(da + 1):
            work[i] = chain[a, i]
        for shift in range(da - db, -1, -1):
            factor = work[db + shift] / chain[b, db]
            for i in range(db):
                work[i + shift] -= factor * chain[b, i]
        size = 0.0
        for i in range(db):
            size = max(size, abs(work[i]))
        if size < 1e-15:
            break
        d = db - 1
        while d > 0 and abs(work[d]) <= 1e-14 * size:
            d -= 1
        for i in range(d + 1):
            chain[length, i] = -work[i] / size
        degrees[length] = d
        length += 1
    return length


@kernel
def _sign_changes(chain: Array, degrees: Ints, length: int, x: float) -> int:
    changes = 0
    previous = value(chain[0], degrees[0], x)
    for k in range(1, length):
        v = value(chain[k], degrees[k], x)
        if v == 0.0:
            continue
        if (v < 0.0) != (previous < 0.0):
            changes += 1
        previous = v
    return changes


@kernel
def _polish(poly: Array, degree: int, lo: float, hi: float) -> float:
    """The single root between `lo` and `hi`: Newton kept inside a shrinking bracket."""
    f_lo = value(poly, degree, lo)
    x = 0.5 * (lo + hi)
    for _ in range(60):
        f = poly[degree]
        slope = 0.0
        for i in range(degree - 1, -1, -1):
            slope = slope * x + f
            f = f * x + poly[i]
        if f == 0.0:
            return x
        if (f < 0.0) == (f_lo < 0.0):
            lo = x
        else:
            hi = x
        step = f / slope if slope != 0.0 else np.inf
        new = x - step
        if not (lo < new < hi):
            new = 0.5 * (lo + hi)
        if abs(new - x) <= 1e-13 * max(1.0, abs(new)):
            return new
        x = new
    return x


@kernel
def real_roots(poly: Array, roots: Array) -> int:
    """Real roots of a polynomial of degree ten (coefficients low to high); returns how many."""
    chain = np.empty((DEGREE + 1, DEGREE + 1))
    degrees = np.zeros(DEGREE + 1, np.int64)
    length = _sturm_chain(poly, chain, degrees)
    if length < 2:
        return 0
    degree = degrees[0]
    bound = 0.0
    for i in range(degree):
        # Fujiwara's bound: no root is larger.
        ratio = abs(chain[0, i] / chain[0, degree])
        if ratio > 0.0:
            bound = max(bound, ratio ** (1.0 / (degree - i)))
    bound = 2.0 * bound + 1e-9
    lows, highs = np.empty(64), np.empty(64)
    at_low, at_high = np.empty(64, np.int64), np.empty(64, np.int64)
    lows[0], highs[0] = -bound, bound
    at_low[0] = _sign_changes(chain, degrees, length, -bound)
    at_high[0] = _sign_changes(chain, degrees, length, bound)
    stack, count = 1, 0
    while stack > 0 and count < DEGREE:
        stack -= 1
        lo, hi, n_lo, n_hi = lows[stack], highs[stack], at_low[stack], at_high[stack]
        inside = n_lo - n_hi
        if inside <= 0:
            continue
        width = hi - lo
        if inside == 1:
            roots[count] = _polish(chain[0], degree, lo, hi)
            count += 1
            continue
        if width < 1e-11 * max(1.0, abs(lo)) or stack + 2 > 62:
            # Roots that coincide in double precision: one of them is enough.
            roots[count] = 0.5 * (lo + hi)
            count += 1
            continue
        middle = 0.5 * (lo + hi)
        n_middle = _sign_changes(chain, degrees, length, middle)
        lows[stack], highs[stack], at_low[stack], at_high[stack] = middle, hi, n_middle, n_hi
        stack += 1
        lows[stack], highs[stack], at_low[stack], at_high[stack] = lo, middle, n_lo, n_middle
        stack += 1
    return count
