"""How products of different base directions continue each other: orthophotos compared where both show."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from stereomate.raster import Window
from stereomate.rectify.engine import orthophoto_part
from stereomate.rectify.job import RectifyJob

Floats = NDArray[np.float64]

# Windows that are compared for a pair of products, and their edge in pixels.
_WINDOWS: Final = 60
_EDGE: Final = 64
# Weaker peaks of the phase correlation are not used; one is an exact shift.
_LEAST_RESPONSE: Final = 0.2


@dataclass(frozen=True)
class Join:
    """Two products where both show the ground.

    Attributes
    ----------
    products : (str, str)
        Their names.
    windows : int
        Compared places.
    shift_px : (float, float)
        Median shift of the second orthophoto against the first in pixels of the first, along its columns and
        rows; NaN without places.
    spread_px : (float, float)
        Normalised median absolute deviation of the shifts.
    step : float
        Median difference of brightness, relative.
    """

    products: tuple[str, str]
    windows: int
    shift_px: tuple[float, float]
    spread_px: tuple[float, float]
    step: float


def measured_joins(jobs: Sequence[RectifyJob]) -> list[Join]:
    """Compare the orthophotos of every two products of a block that lie on different grids."""
    found = []
    for first, second in itertools.combinations(jobs, 2):
        if first.grid.rotation != second.grid.rotation:
            found.append(_measured(first, second))
    return found


def _measured(first: RectifyJob, second: RectifyJob) -> Join:
    # Pixels of the seams belong to the other grid: there the nearest model serves, of the same photographs.
    other = replace(second, grid=first.grid, seams=None)
    shifts, steps = [], []
    window_of_hann = cv2.createHanningWindow((_EDGE, _EDGE), cv2.CV_32F)
    for window in _windows(first, second):
        part = orthophoto_part(first, window, "left")
        a, shown = part.pixels.astype(np.float32), part.valid != 0
        there = orthophoto_part(other, window, "left")
        b, both = there.pixels.astype(np.float32), shown & (there.valid != 0)
        if both.mean() < 1.0:
            continue
        steps.append(abs(float(b.mean()) / max(float(a.mean()), 1e-6) - 1.0))
        shift, response = cv2.phaseCorrelate(a.mean(axis=2), b.mean(axis=2), window_of_hann)
        if response > _LEAST_RESPONSE:
            shifts.append(shift)
    names = first.name, second.name
    if not shifts:
        nothing = float("nan"), float("nan")
        return Join(names, 0, nothing, nothing, float("nan"))
    values = np.array(shifts)
    median = np.median(values, axis=0)
    spread = 1.4826 * np.median(np.abs(values - median), axis=0)
    return Join(
        names,
        len(values),
        (float(median[0]), float(median[1])),
        (float(spread[0]), float(spread[1])),
        float(np.median(steps)),
    )


def _windows(first: RectifyJob, second: RectifyJob) -> list[Window]:
    """Windows of the first product, spread over what it has in common with the second one's grid."""
    corners = first.grid.pixel_from_map(second.grid.corners())
    low = np.maximum(corners.min(axis=0), 0).astype(int)
    high = np.minimum(corners.max(axis=0), first.grid.size).astype(int) - _EDGE
    if (high <= low).any():
        return []
    side = max(2, int(np.sqrt(_WINDOWS)))
    cols, rows = (np.unique(np.linspace(low[k], high[k], side).astype(int)) for k in range(2))
    return [Window(int(c), int(r), _EDGE, _EDGE) for r in rows for c in cols]
