"""Exact statistics of the valid pixels: sums of each chunk, added in the order of the plan."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from stereomate.raster.cog import kernels
from stereomate.raster.cog.profile import CogProfile
from stereomate.raster.scratch import SCRATCH

# Sums over the rows of a chunk (at most 32768 of them) of one sample of each row, and of its square.
_ACCUMULATORS: Final = {"uint8": np.uint32, "uint16": np.int64, "int16": np.int64}


@dataclass(frozen=True)
class BandStatistics:
    """Sums over the valid samples of one band; integers for integer pixels, so nothing is rounded.

    Attributes
    ----------
    count : int
        Valid samples.
    total, squares : int or float
        Sum of the samples and of their squares.
    minimum, maximum : int or float or None
        None when there is no valid sample.
    """

    count: int = 0
    total: float = 0
    squares: float = 0
    minimum: float | None = None
    maximum: float | None = None

    @property
    def mean(self) -> float:
        """Mean; NaN without samples."""
        return self.total / self.count if self.count else math.nan

    @property
    def standard_deviation(self) -> float:
        """Standard deviation of the population; NaN without samples."""
        if not self.count:
            return math.nan
        if isinstance(self.total, int) and isinstance(self.squares, int):
            return math.sqrt(self.count * self.squares - self.total**2) / self.count
        return math.sqrt(max(0.0, self.squares / self.count - self.mean**2))


def statistics_of(
    profile: CogProfile, pixels: NDArray[Any], valid: NDArray[np.uint8] | None
) -> tuple[BandStatistics, ...]:
    """Statistics of each band of a chunk.

    Parameters
    ----------
    profile : CogProfile
    pixels : ndarray, shape (rows, cols, bands)
        C-contiguous.
    valid : ndarray of uint8, shape (rows, cols), or None
        1 where valid; None where all are.
    """
    if profile.dtype == "float32":
        return _float_statistics(pixels, valid)
    width = pixels.shape[1] * profile.bands
    dtype = _ACCUMULATORS[profile.dtype]
    total, squares = SCRATCH.array("total", (width,), dtype), SCRATCH.array("squares", (width,), dtype)
    low = SCRATCH.array("low", (width,), profile.dtype)
    high = SCRATCH.array("high", (width,), profile.dtype)
    limits = np.iinfo(profile.dtype)
    total[:], squares[:], low[:], high[:] = 0, 0, limits.max, limits.min
    count = kernels.add_statistics(pixels, _mask(valid), valid is not None, total, squares, low, high)
    if not count:
        return (BandStatistics(),) * profile.bands
    by_band = [a.reshape(-1, profile.bands) for a in (total, squares, low, high)]
    return tuple(
        BandStatistics(
            int(count),
            int(by_band[0][:, b].sum(dtype=np.int64)),
            int(by_band[1][:, b].sum(dtype=np.int64)),
            int(by_band[2][:, b].min()),
            int(by_band[3][:, b].max()),
        )
        for b in range(profile.bands)
    )


def _float_statistics(pixels: NDArray[Any], valid: NDArray[np.uint8] | None) -> tuple[BandStatistics, ...]:
    bands = pixels.shape[2]
    counts, sums = np.zeros(bands, np.int64), np.zeros((bands, 2))
    limits = np.tile([np.inf, -np.inf], (bands, 1))
    kernels.add_float_statistics(pixels, _mask(valid), valid is not None, counts, sums, limits)
    return tuple(
        BandStatistics(int(n), float(s[0]), float(s[1]), float(m[0]), float(m[1])) if n else BandStatistics()
        for n, s, m in zip(counts, sums, limits, strict=True)
    )


def _mask(valid: NDArray[np.uint8] | None) -> NDArray[np.uint8]:
    # A kernel takes an array; this one is never looked at.
    return np.empty((0, 0), np.uint8) if valid is None else valid


def merged(parts: Sequence[BandStatistics]) -> BandStatistics:
    """Statistics of everything from those of the parts; correctly rounded, whatever their order."""
    parts = [part for part in parts if part.count]
    if not parts:
        return BandStatistics()
    return BandStatistics(
        sum(part.count for part in parts),
        _sum([part.total for part in parts]),
        _sum([part.squares for part in parts]),
        min(part.minimum for part in parts if part.minimum is not None),
        max(part.maximum for part in parts if part.maximum is not None),
    )


def _sum(values: Sequence[float]) -> float:
    return sum(values) if all(isinstance(value, int) for value in values) else math.fsum(values)
