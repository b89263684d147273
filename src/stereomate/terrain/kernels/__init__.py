"""Numeric kernels on height patches.

A patch is a float64 array (rows, cols), NaN where there is no height. Positions are pixel coordinates
(col, row): (0, 0) is the outer corner of the first pixel, its centre is (0.5, 0.5).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from stereomate.terrain.kernels.lines import bilinear_line, cubic_line, sample_line
from stereomate.terrain.kernels.rays import first_hit, first_hits
from stereomate.terrain.kernels.sampling import (
    bilinear,
    bilinear_gradient,
    bilinear_points,
    cubic,
    cubic_gradient,
    cubic_points,
    sample,
)
from stereomate.terrain.kernels.sight import (
    block_maxima,
    occluded,
    occluded_blockwise,
    occluded_bounded,
    sight_bounds,
    steepest_slope,
)

# A kernel that samples a patch at scattered points: (patch, cols, rows, out).
Sampler: TypeAlias = Callable[
    [NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]], None
]

__all__ = [
    "Sampler",
    "bilinear",
    "bilinear_gradient",
    "bilinear_line",
    "bilinear_points",
    "block_maxima",
    "cubic",
    "cubic_gradient",
    "cubic_line",
    "cubic_points",
    "first_hit",
    "first_hits",
    "occluded",
    "occluded_blockwise",
    "occluded_bounded",
    "sample",
    "sample_line",
    "sight_bounds",
    "steepest_slope",
]
