"""The terms of the over-correction factor for many cross-sections at once."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import inline_kernel, kernel

FloatArray = NDArray[np.float64]

# A sum of products below this many times its terms, cancelled differences counted whole, is rounding only.
ROUNDING = 32.0 * 2.220446049250313e-16


@inline_kernel
def section_terms(
    y0: float, z0: float, y1: float, z1: float, y2: float, z2: float
) -> tuple[float, float, float, float, float, float, float, float, float, float, bool]:
    """t, K and weight w of three points, the curvature Σ w K, and whether the section is valid.

    Σ w = 0 and Σ w t = 0, so that Σ w p / Σ w K is the tilt. Weights (two points on one ray) and curvature
    (critical circle) that are zero to rounding are returned as zero.
    """
    t0, t1, t2 = y0 / z0, y1 / z1, y2 / z2
    k0, k1, k2 = z0 + y0 * t0, z1 + y1 * t1, z2 + y2 * t2
    # nan, infinite and overflowing values all show in a K; a point above the centre in its z.
    total = k0 + k1 + k2
    valid = z0 > 0.0 and z1 > 0.0 and z2 > 0.0 and math.isfinite(total)
    w0, w1, w2 = t2 - t1, t0 - t2, t1 - t0
    curvature = w2 * (k2 - k0) + w1 * (k1 - k0)
    least = ROUNDING * (abs(t0) + abs(t1) + abs(t2))
    if abs(curvature) <= least * total:
        curvature = math.copysign(0.0, curvature)
    if abs(w0) <= least:
        w0 = 0.0
    if abs(w1) <= least:
        w1 = 0.0
    if abs(w2) <= least:
        w2 = 0.0
    return t0, t1, t2, k0, k1, k2, w0, w1, w2, curvature, valid


@kernel
def overcorrection_factors(sections: FloatArray, row: int, factors: FloatArray) -> int:
    """n of sections (N, 3, 2) with the point of `row` corrected, into `factors` (N,).

    Returns the index of the first invalid section, or -1. nan: the other two points share a ray.
    """
    for index in range(sections.shape[0]):
        s = sections[index]
        _, _, _, k0, k1, k2, w0, w1, w2, curvature, valid = section_terms(
            s[0, 0], s[0, 1], s[1, 0], s[1, 1], s[2, 0], s[2, 1]
        )
        if not valid:
            return index
        if row == 0:
            k, w = k0, w0
        elif row == 1:
            k, w = k1, w1
        else:
            k, w = k2, w2
        if w == 0.0:
            factors[index] = np.nan
        else:
            factors[index] = k * w / curvature
    return -1


@kernel
def all_section_terms(
    sections: FloatArray, t: FloatArray, k: FloatArray, weights: FloatArray, curvature: FloatArray
) -> int:
    """Terms of sections (N, 3, 2) into t, k, weights (3, N) and curvature (N,); as above else."""
    for index in range(sections.shape[0]):
        s = sections[index]
        t0, t1, t2, k0, k1, k2, w0, w1, w2, total, valid = section_terms(
            s[0, 0], s[0, 1], s[1, 0], s[1, 1], s[2, 0], s[2, 1]
        )
        if not valid:
            return index
        t[0, index], t[1, index], t[2, index] = t0, t1, t2
        k[0, index], k[1, index], k[2, index] = k0, k1, k2
        weights[0, index], weights[1, index], weights[2, index] = w0, w1, w2
        curvature[index] = total
    return -1
