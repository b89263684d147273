"""Least squares of the radiometric balance: gains, gradients and vignetting from the overlaps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import scipy  # its parts load when they are used
from numpy.typing import NDArray

from stereomate.rectify.local_balance import local_part
from stereomate.rectify.radiometry import OWN, SHARED, Balance, BalanceSummary, Samples, design

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# What is believed beforehand (natural logarithms).
PRIOR_SIGMA: Final = (0.3, 0.05, 0.05, 0.5, 0.5, 0.5)
# Plane and bowl of the mean correction over the block.
_TREND_SIGMA: Final = 0.005
# Differences of smooth open ground scatter by about this much.
OBSERVATION_SIGMA: Final = 0.03
# A pair of photographs counts as so many of them at most.
_INDEPENDENT: Final = 64.0
# Larger multiples of the usual scatter are not the same ground.
_LIMIT_SIGMAS: Final = 3.0
_ITERATIONS: Final = 8


def solve_balance(
    samples: Samples, cameras: Sequence[int], sizes_px: Sequence[tuple[int, int]]
) -> tuple[Balance, BalanceSummary]:
    """Gains, gradients and vignetting from the overlaps, and what varies slowly beside them.

    Parameters
    ----------
    cameras : sequence of int
        Number of each photograph's camera.
    sizes_px : sequence of (int, int)
        Columns and rows of each photograph.
    """
    photographs = len(cameras)
    bands = samples.values.shape[1]
    pairs = samples.pairs
    single = _design(samples, cameras)
    matrix = (single[pairs[:, 0]] - single[pairs[:, 1]]).tocsr()
    logs = np.log(samples.values[pairs[:, 0]]) - np.log(samples.values[pairs[:, 1]])
    noise = np.square(samples.noise)
    sigmas = np.sqrt(OBSERVATION_SIGMA**2 + noise[pairs[:, 0]] + noise[pairs[:, 1]])
    prior, trend = _prior(photographs, matrix.shape[1]), _trend(samples, single)
    solved = np.zeros((matrix.shape[1], bands))
    rms = []
    for band in range(bands):
        weight = _information(samples.photographs[pairs], sigmas[:, band])
        solved[:, band], s = _robust(matrix, (prior, trend), logs[:, band], sigmas[:, band], weight)
        rms.append(s)
    own = solved[: OWN * photographs].reshape(photographs, OWN, bands)
    shared = solved[OWN * photographs :].reshape(-1, SHARED, bands)[np.asarray(cameras, np.int64)]
    coefficients = np.concatenate([own, shared], axis=1).transpose(0, 2, 1)
    left = np.log(samples.values) - single @ solved
    local = local_part(samples, left, sizes_px)
    balance = Balance(
        tuple(tuple(tuple(map(float, c)) for c in photo) for photo in coefficients), local.nodes
    )
    residuals = local.left[pairs[:, 0]] - local.left[pairs[:, 1]]
    largest = float(np.exp(np.abs(own[:, 0]).max(initial=0.0)))
    return balance, BalanceSummary(len(logs), _medians(logs), _medians(residuals), tuple(rms), largest)


def _medians(values: Floats) -> tuple[float, ...]:
    """Median absolute value of each column; NaN without rows."""
    nothing = float("nan")
    return tuple([float(np.median(np.abs(v))) if v.size else nothing for v in values.T])


def _design(samples: Samples, cameras: Sequence[int]) -> Any:
    """Sparse design of the logarithms of single values."""
    n = len(samples.photographs)
    camera = np.asarray(cameras, np.int64)[samples.photographs]
    own = OWN * samples.photographs[:, None] + np.arange(OWN)
    shared = OWN * len(cameras) + SHARED * camera[:, None] + np.arange(SHARED)
    columns = np.concatenate([own, shared], axis=1)
    count = OWN * len(cameras) + SHARED * (max(cameras, default=0) + 1)
    starts = np.arange(0, columns.size + 1, OWN + SHARED)
    return scipy.sparse.csr_array((design(samples.positions).ravel(), columns.ravel(), starts), (n, count))


def _prior(photographs: int, count: int) -> Floats:
    """Weights of the prior per unknown."""
    cameras = (count - OWN * photographs) // SHARED
    sigmas = [np.tile(PRIOR_SIGMA[:OWN], photographs), np.tile(PRIOR_SIGMA[OWN:], cameras)]
    return np.asarray(1.0 / np.square(np.concatenate(sigmas)))


def _trend(samples: Samples, single: Any) -> Floats:
    """Rows (5, unknowns): plane and bowl of the mean correction of the places that several photographs show.

    Of orthonormal polynomials over the block, so each row is the rms of its share.
    """
    _, first, place, count = np.unique(
        samples.places, return_index=True, return_inverse=True, return_counts=True
    )
    many = count >= 2
    if many.sum() < 6:
        return np.zeros((0, single.shape[1]))
    at = samples.ground[first][many]
    span = np.maximum(np.ptp(at, axis=0), 1e-12)
    x, y = (2.0 * (at - at.min(axis=0)) / span - 1.0).T
    basis = np.linalg.qr(np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1))[0][:, 1:]
    spread = np.zeros((len(count), basis.shape[1]))
    spread[many] = basis / np.sqrt(many.sum())
    return np.asarray(single.T @ (spread / count[:, None])[place]).T


def _information(photographs: Ints, sigma: Floats) -> Floats:
    """Weights of the observations; those of a pair of photographs count as `_INDEPENDENT` at most."""
    weight = 1.0 / np.square(sigma)
    key = photographs[:, 0] * (int(photographs.max(initial=0)) + 1) + photographs[:, 1]
    _, pair = np.unique(key, return_inverse=True)
    total = np.bincount(pair, weight)
    most = _INDEPENDENT / OBSERVATION_SIGMA**2
    return np.asarray(weight * np.minimum(1.0, most / total)[pair]) if len(pair) else weight


def _robust(
    matrix: Any, believed: tuple[Floats, Floats], observed: Floats, sigma: Floats, information: Floats
) -> tuple[Floats, float]:
    """Weighted least squares with Tukey's weights; solution, rms residual of the observations that count."""
    prior, trend = believed
    solution = np.zeros(matrix.shape[1])
    residual = observed.copy()
    counts = np.ones(len(observed))
    for step in range(_ITERATIONS):
        if len(observed):
            scale = max(1.4826 * float(np.median(np.abs(residual / sigma))), 1e-3)
            limit = 2.0 * _LIMIT_SIGMAS * scale * (4.0 if step == 0 else 1.0)
            counts = np.square(np.clip(1.0 - np.square(residual / sigma / limit), 0.0, None))
        scaled = scipy.sparse.diags_array(counts * information) @ matrix
        normal = (matrix.T @ scaled + scipy.sparse.diags_array(prior)).tocsc()
        solver = scipy.sparse.linalg.splu(normal)
        solution = solver.solve(np.asarray(scaled.T @ observed))
        if len(trend):
            # the few dense rows of the trend come in afterwards (Woodbury)
            across = solver.solve(np.ascontiguousarray(trend.T))
            inner = _TREND_SIGMA**2 * np.eye(len(trend)) + trend @ across
            solution = solution - across @ np.linalg.solve(inner, trend @ solution)
        residual = observed - matrix @ solution
    used = float(counts @ information)
    rms = float(np.sqrt(counts * information @ np.square(residual) / used)) if used > 0.0 else float("nan")
    return solution, rms
