"""Fractal terrain and periodic noise from spectra."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def _wave_numbers(shape: tuple[int, int]) -> Array:
    """Cycles per node of every term of a real two-dimensional Fourier transform."""
    rows, cols = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None, :]
    numbers: Array = np.hypot(rows, cols)
    return numbers


def coloured_noise(
    rng: np.random.Generator, shape: tuple[int, int], exponent: float, lowest: float, highest: float
) -> Array:
    """Periodic noise of zero mean and unit variance with amplitudes ``k**-exponent``.

    Parameters
    ----------
    exponent : float
        Fall of the amplitudes with the wave number k.
    lowest, highest : float
        Wave numbers, cycles per node, below and above which the amplitudes fade (as a Gaussian above).
    """
    k = _wave_numbers(shape)
    amplitude = np.where(k > 0.0, np.maximum(k, lowest), np.inf) ** -exponent
    amplitude *= np.exp(-0.5 * (k / highest) ** 4)
    spectrum = np.fft.rfft2(rng.standard_normal(shape)) * amplitude
    noise: Array = np.fft.irfft2(spectrum, s=shape)
    noise -= noise.mean()
    noise /= noise.std()
    return noise


def fractal_terrain(
    rng: np.random.Generator, shape: tuple[int, int], step_m: float, relief_m: float, mean_m: float
) -> Array:
    """Heights (rows, cols) with hills, valleys and roughness at all scales.

    Amplitudes fall with the wave number as ``k**-2.4`` (smoother than a pure fractal: eroded hills) and are
    taken from a period larger than the area, so that opposite borders differ. Crests are sharpened and
    valleys widened by squaring part of the height.
    """
    if relief_m == 0.0:
        return np.full(shape, mean_m)
    side = 2 ** math.ceil(math.log2(1.3 * max(shape)))
    longest = 1.0 / max(700.0 / step_m, 4.0)
    height = coloured_noise(rng, (side, side), 2.4, longest, 0.2)[: shape[0], : shape[1]]
    height = height + 0.15 * height * np.abs(height)
    height -= height.min()
    height *= relief_m / height.max()
    terrain: Array = height - height.mean() + mean_m
    return terrain


def hill_shade(heights: Array, step_m: float, sun: Array, ambient: float) -> NDArray[np.float32]:
    """Brightness of each node under the sun (unit vector towards it), 1 on level ground.

    Slopes are doubled, as on shaded maps: the relief is to be seen.
    """
    south, east = np.gradient(2.0 * heights, step_m)
    normal = np.stack([-east, south, np.ones_like(heights)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    lit = np.maximum(normal @ sun, 0.0) / sun[2]
    shade: NDArray[np.float32] = (ambient + (1.0 - ambient) * lit).astype(np.float32)
    return shade
