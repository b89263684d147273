"""Heights with their gradients at scattered points, and the ground that a stereomate position shows."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import kernel
from stereomate.parallax.kernels import q_of_height
from stereomate.terrain.kernels.sampling import CUBIC, bilinear_gradient, cubic_gradient, sample

Floats = NDArray[np.float64]


@kernel
def heights_and_gradients(method: int, patch: Floats, cols: Floats, rows: Floats, out: Floats) -> None:
    """(h, dh/dcol, dh/drow) at scattered pixel positions; ``out`` is (n, 3), NaN where nothing is known."""
    for k in range(cols.size):
        if method == CUBIC:
            out[k, 0], out[k, 1], out[k, 2] = cubic_gradient(patch, cols[k], rows[k])
        else:
            out[k, 0], out[k, 1], out[k, 2] = bilinear_gradient(patch, cols[k], rows[k])


@kernel
def shown_columns(
    method: int,
    patch: Floats,
    scale: float,
    code: int,
    parameters: Floats,
    segments: Floats,
    targets: Floats,
    starts: Floats,
    ends: Floats,
    step: float,
    out: Floats,
    branches: NDArray[np.int64],
) -> None:
    """For each stereomate position the ground along its row with x - q(h(x)) = U, the largest x.

    The row is walked from its far end (the highest ground that can appear) in steps; the first change of
    sign is the branch that is seen. All changes are counted.

    Parameters
    ----------
    segments : (n, 3, 3)
        Position in the patch and offset of heights at the start, the middle and the end of each row;
        quadratic in between.
    targets : (n,)
        U.
    starts, ends : (n,)
        The part of the row to search.
    out : (n,)
        x; NaN where no ground appears.
    branches : (n,)
        How many positions along the row have this U.
    """
    for k in range(targets.size):
        out[k] = math.nan
        branches[k] = 0
        length = ends[k] - starts[k]
        if not length > 0.0:
            continue
        count = max(1, math.ceil(length / step))
        f_right = math.nan
        for m in range(count, -1, -1):
            t = m / count
            f = _excess(method, patch, scale, code, parameters, segments[k], targets[k], starts[k], length, t)
            if f_right == f_right and f == f and (f < 0.0) != (f_right < 0.0):
                branches[k] += 1
                if branches[k] == 1:
                    out[k] = starts[k] + length * _root(
                        method, patch, scale, code, parameters, segments[k], targets[k], starts[k], length,
                        t, (m + 1) / count,
                    )  # fmt: skip
            f_right = f


@kernel
def _excess(
    method: int,
    patch: Floats,
    scale: float,
    code: int,
    parameters: Floats,
    segment: Floats,
    target: float,
    start: float,
    length: float,
    t: float,
) -> float:
    """x - q(h(x)) - U at the fraction t of a row."""
    a = (1.0 - t) * (1.0 - 2.0 * t)
    b = 4.0 * t * (1.0 - t)
    c = t * (2.0 * t - 1.0)
    col = a * segment[0, 0] + b * segment[1, 0] + c * segment[2, 0]
    row = a * segment[0, 1] + b * segment[1, 1] + c * segment[2, 1]
    offset = a * segment[0, 2] + b * segment[1, 2] + c * segment[2, 2]
    height = scale * sample(method, patch, col, row) + offset
    value: float = start + length * t - q_of_height(code, parameters, height) - target
    return value


@kernel
def _root(
    method: int,
    patch: Floats,
    scale: float,
    code: int,
    parameters: Floats,
    segment: Floats,
    target: float,
    start: float,
    length: float,
    low: float,
    high: float,
) -> float:
    """The fraction of a row between two of different sign: bisection to the last bits."""
    f_low = _excess(method, patch, scale, code, parameters, segment, target, start, length, low)
    for _ in range(60):
        middle = 0.5 * (low + high)
        f = _excess(method, patch, scale, code, parameters, segment, target, start, length, middle)
        if (f < 0.0) == (f_low < 0.0):
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)
