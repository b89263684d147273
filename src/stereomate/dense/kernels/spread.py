"""Variances of dense least-squares matches under the correlation that the residuals themselves show."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.dense.kernels.window import ACROSS, ALONG, GREY, RIGHT, UNKNOWNS, WEIGHT
from stereomate.jit import kernel

Floats = NDArray[np.float64]


@kernel
def _box_sums(values: Floats, size: int, padded: Floats, lines: Floats, out: Floats) -> None:
    """Sums over all 3 x 3 pixels of a window, those at its border included: `out` (size + 2, size + 2).

    `padded` (size + 4, size + 4) has a border of two zeros; `lines` (size + 4, size + 2) is scratch.
    """
    for i in range(size):
        for j in range(size):
            padded[i + 2, j + 2] = values[i * size + j]
    for i in range(size + 4):
        for j in range(size + 2):
            lines[i, j] = padded[i, j] + padded[i, j + 1] + padded[i, j + 2]
    for i in range(size + 2):
        for j in range(size + 2):
            out[i, j] = lines[i, j] + lines[i + 1, j] + lines[i + 2, j]


@kernel
def spread_of_residuals(
    window: Floats,
    radius: int,
    middle: float,
    inverse: Floats,
    solution: Floats,
    contributions: Floats,
    sums: Floats,
    padded: Floats,
    lines: Floats,
    out: Floats,
) -> None:
    """Variances and covariance of both parallaxes under the correlation of neighbouring residuals.

    The estimate is a sum of residuals with weights: their contributions. Products of contributions up to two
    pixels apart are summed, tapered linearly along both axes: a ninth of the products of all sums over 3 x 3
    pixels. As all contributions together are zero, a part is lost: the share of the pairs that are summed.
    """
    size = 2 * radius + 1
    n = 0.0
    for k in range(window.shape[1]):
        w = window[WEIGHT, k]
        x, y, g = window[ALONG, k], window[ACROSS, k], window[GREY, k]
        v = window[RIGHT, k] - middle - g
        v = w * (v - (solution[0] * x + solution[1] * y + solution[2] * g + solution[3]))
        n += w
        contributions[0, k] = v * (inverse[0, 0] * x + inverse[0, 1] * y + inverse[0, 2] * g + inverse[0, 3])
        contributions[1, k] = v * (inverse[1, 0] * x + inverse[1, 1] * y + inverse[1, 2] * g + inverse[1, 3])
    for a in range(2):
        _box_sums(contributions[a], size, padded, lines, sums[a])
    # pairs of each pixel, tapered; what is cut off at the border of the window is a few per cent
    pairs = 9.0 / n
    xx = xy = yy = 0.0
    for i in range(size + 2):
        for j in range(size + 2):
            xx += sums[0, i, j] * sums[0, i, j]
            xy += sums[0, i, j] * sums[1, i, j]
            yy += sums[1, i, j] * sums[1, i, j]
    kept = 9.0 * (1.0 - pairs) * (n - UNKNOWNS) / n
    out[0] = xx / kept
    out[1] = xy / kept
    out[2] = yy / kept
