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

# Ground positions, at most for a block of few photographs, and for each photograph of a large one.
PLACES: Final = 40_000
PLACES_OF_PHOTOGRAPH: Final = 400
# Cells along the side of the square whose mean is compared: parallaxes of low things fall out.
_SIDE: Final = 3
# Cells along the side of the square whose roughness counts, and what of it is in the mean.
_AROUND: Final = 9
_ROUGHNESS_SHARE: Final = 0.5
# Uncertainty of a value in digital numbers of 255.
_DIGITAL_STEPS: Final = 2.0
# Integers this near the end of their range may be saturated; darker than this share of it is mostly noise.
_SATURATED: Final = 0.98
_DARK: Final = 0.02


def balance_samples(overviews: Overviews, scale: float) -> Samples:
    """What the photographs recorded at cells spread evenly.

    Parameters
    ----------
    scale : float
        From values to digital numbers of 0 to 255 (`rectify.disagreement.grey_scale`).
    """
    rows, cols = overviews.shape
    places = max(PLACES, PLACES_OF_PHOTOGRAPH * len(overviews.photographs))
    stride = max(_SIDE, int(np.sqrt(rows * cols / places)))
    found: list[tuple[Ints, Ints, Floats, Floats, Floats]] = []
    for p, overview in enumerate(overviews.photographs):
        if overview is not None:
            found.append(_of_photograph(overviews, p, overview, stride, scale))
    bands = len(overviews.job.bands)
    if not found:
        nothing, two, none = np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, bands))
        return Samples(nothing, two, nothing, two, none, none)
    place, photo, position, value, noise = (np.concatenate(part) for part in zip(*found, strict=True))
    order = np.lexsort((photo, place))
    place = place[order]
    ground = np.stack([place % cols, place // cols], axis=1).astype(np.float64)
    return Samples(place, ground, photo[order], position[order], value[order], noise[order])


def _of_photograph(
    overviews: Overviews, p: int, overview: PhotoOverview, stride: int, scale: float
) -> tuple[Ints, Ints, Floats, Floats, Floats]:
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
    value = mean[row, col].astype(np.float64)
    rough = _ROUGHNESS_SHARE * _roughness(pixels, overview.valid)[row, col].astype(np.float64)
    place = (row + window.row0).astype(np.int64) * overviews.shape[1] + col + window.col0
    return (
        place,
        np.full(len(place), p, np.int64),
        photo_positions(at, size),
        value,
        np.hypot(rough, _DIGITAL_STEPS / (value * scale)),
    )


def _roughness(pixels: NDArray[np.float32], valid: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Standard deviation over mean around each cell (rows, cols, bands), of the cells that are valid."""
    side = (_AROUND, _AROUND)
    inside = valid.astype(np.float32)
    share = np.maximum(cv2.blur(inside, side), np.float32(1e-6))[..., None]
    shown = np.where(valid[..., None], pixels, np.float32(0.0))
    mean = cv2.blur(shown, side).reshape(pixels.shape) / share
    square = cv2.blur(np.square(shown), side).reshape(pixels.shape) / share
    spread = np.sqrt(np.maximum(square - np.square(mean), 0.0))
    return np.asarray(spread / np.maximum(mean, np.float32(1e-6)), np.float32)


def _range(overviews: Overviews) -> tuple[float, float]:
    dtype = overviews.job.dtype
    if dtype.kind == "f":
        return 0.0, float("inf")
    top = float(np.iinfo(np.zeros(0, dtype).dtype).max)
    return max(_DARK * min(top, 255.0), 1.0), _SATURATED * top
