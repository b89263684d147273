"""The whole covariance of photographs and shared unknowns, on request: its size grows with the square."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.block.equations import build, factor
from stereomate.block.loop import Solution
from stereomate.block.triangular import backward, forward
from stereomate.errors import NotDeterminedError

Array = NDArray[np.float64]


def full_covariance(solution: Solution) -> Array:
    """Whole cofactor matrix of photographs (their own order) and shared unknowns, (6 n + q, 6 n + q).

    Points follow from it by elimination; of free networks it is that of the minimal constraints.
    """
    prepared = solution.prepared
    factored = factor(prepared, build(prepared, solution.state, solution.start))
    if factored.singular >= 0:
        raise NotDeterminedError("the normal matrix is singular at the solution")
    n6 = len(factored.factor)
    whole = np.eye(n6)
    forward(factored.factor, prepared.skew, whole)
    backward(factored.factor, prepared.skew, whole)
    solved = factored.half.copy()
    backward(factored.factor, prepared.skew, solved)
    solved = solved.T
    root = np.linalg.inv(factored.corner) if len(factored.half) else np.zeros((0, 0))
    shared = root.T @ root
    whole += solved @ shared @ solved.T
    rows = (6 * prepared.place[:, None] + np.arange(6)).ravel()
    free = prepared.free_photo.ravel()
    top = whole[np.ix_(rows, rows)] * np.outer(free, free)
    side = -(solved @ shared)[rows]
    return np.block([[top, side], [side.T, shared]])
