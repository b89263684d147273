"""Ground that several photographs show, as observations of the radiometric balance."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from stereomate.rectify.overviews import Overviews, PhotoOverview
from stereomate.rectify.radiometry import Samples, photo_positions

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Ground positions at most, and photographs that each photograph is compared with at one of them.
PLACES: Final = 40_000
PARTNERS: Final = 3
# Cells along the side of the square whose mean is compared: parallaxes of low things fall out.
_SIDE: Final = 3
# Integers this near the end of their range may be saturated; darker than this share of it is mostly noise.
_SATURATED: Final = 0.98
_DARK: Final = 0.02


def balance_samples(overviews: Overviews, places: int = PLACES) -> Samples:
    """Values of the same ground in pairs of photographs, at cells spread evenly."""
    rows, cols = overviews.shape
    stride = max(_SIDE, int(np.sqrt(rows * cols / places)))
    found: list[tuple[Ints, Ints, Floats, Floats]] = []
    for p, overview in enumerate(overviews.photographs):
        if overview is not None:
            found.append(_of_photograph(overviews, p, overview, stride))
    bands = len(overviews.job.bands)
    if not found:
        return Samples(np.empty((0, 2), np.int64), np.empty((0, 2, 2)), np.empty((0, 2, bands)))
    place, photo, position, value = (np.concatenate(part) for part in zip(*found, strict=True))
    order = np.lexsort((photo, place))
    place, photo, position, value = place[order], photo[order], position[order], value[order]
    first: list[Ints] = []
    second: list[Ints] = []
    for step in range(1, PARTNERS + 1):
        same = np.flatnonzero(place[step:] == place[:-step])
        first.append(same)
        second.append(same + step)
    both = np.stack([np.concatenate(first), np.concatenate(second)], axis=1)
    return Samples(photo[both], position[both], value[both])


def _of_photograph(
    overviews: Overviews, p: int, overview: PhotoOverview, stride: int
) -> tuple[Ints, Ints, Floats, Floats]:
    window = overview.window
    rows = np.arange(-(-window.row0 // stride) * stride, window.row1, stride) - window.row0
    cols = np.arange(-(-window.col0 // stride) * stride, window.col1, stride) - window.col0
    pixels = overview.pixels.astype(np.float32)
    mean = cv2.blur(pixels, (_SIDE, _SIDE)).reshape(pixels.shape)
    usable = cv2.erode(overview.valid.astype(np.uint8), np.ones((_SIDE, _SIDE), np.uint8), borderValue=0) > 0
    low, high = _range(overviews)
    highest = cv2.dilate(pixels, np.ones((_SIDE, _SIDE), np.uint8)).reshape(pixels.shape)
    usable &= (mean > low).all(axis=2) & (highest < high).all(axis=2)
    row, col = np.meshgrid(rows, cols, indexing="ij")
    there = usable[row, col]
    row, col = row[there], col[there]
    size = overviews.job.photographs[p].camera.size_px
    at = overview.positions[row, col] * (np.asarray(size) / 65535.0)
    place = (row + window.row0).astype(np.int64) * overviews.shape[1] + col + window.col0
    return (
        place,
        np.full(len(place), p, np.int64),
        photo_positions(at, size),
        mean[row, col].astype(np.float64),
    )


def _range(overviews: Overviews) -> tuple[float, float]:
    dtype = overviews.job.dtype
    if dtype.kind == "f":
        return 0.0, float("inf")
    top = float(np.iinfo(np.zeros(0, dtype).dtype).max)
    return max(_DARK * min(top, 255.0), 1.0), _SATURATED * top
