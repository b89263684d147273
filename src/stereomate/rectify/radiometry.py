"""Radiometric balance of a block: brightness of the photographs brought to one, by least squares.

A photograph records ground of brightness L as

    I(x, y) = L exp(g + a x + b y + u x^2 + v y^2 + w r^4)

per band, with x, y, r counted from its middle in half diagonals: a gain and a gradient of its own, and the
vignetting that all photographs of a camera share (round or not: masks and lenses differ). The logarithms
are linear in the unknowns. Wherever two
photographs show the same ground, L falls out of the difference of their logarithms: one observation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Ints = NDArray[np.int64]

# Unknowns of a photograph (gain, two gradients) and of a camera (three of vignetting), per band.
OWN: Final = 3
SHARED: Final = 3
# What is believed beforehand (natural logarithms). Overlaps alone do not tell a block that grows brighter to
# one side from photographs that all do, nor a bowl over the block from vignetting: the smaller one is taken.
PRIOR_SIGMA: Final = (0.3, 0.05, 0.05, 0.5, 0.5, 0.5)
# Differences of open ground scatter by about this much; larger ones than the limit are not the same ground.
OBSERVATION_SIGMA: Final = 0.03
_LIMIT_SIGMAS: Final = 3.0
_ITERATIONS: Final = 8
# Factors on so many nodes per side of a photograph; bilinear between them the error is below 1e-4.
TABLE_NODES: Final = 33


@dataclass(frozen=True, eq=False)
class Samples:
    """Ground seen in two photographs: observations of the balance.

    Attributes
    ----------
    photographs : (n, 2) int
    positions : (n, 2, 2)
        x, y of the ground in both, in half diagonals from the middle of the photograph.
    values : (n, 2, bands)
        What they recorded, positive.
    """

    photographs: Ints
    positions: Floats
    values: Floats

    @staticmethod
    def joined(parts: Sequence[Samples]) -> Samples:
        """Samples of several products with photographs numbered alike."""
        return Samples(
            np.concatenate([p.photographs for p in parts]),
            np.concatenate([p.positions for p in parts]),
            np.concatenate([p.values for p in parts]),
        )


@dataclass(frozen=True)
class Balance:
    """Radiometric balance of the photographs of a job.

    Attributes
    ----------
    coefficients : tuple (photographs) of tuple (bands) of (g, a, b, u, v, w)
        As above; a photograph is multiplied by exp(-(...)).
    """

    coefficients: tuple[tuple[tuple[float, ...], ...], ...]

    def logarithm(self, photograph: int, positions: Floats) -> Floats:
        """g + a x + b y + u x^2 + v y^2 + w r^4 (..., bands) at positions (..., 2) in half diagonals."""
        return np.asarray(design(positions) @ np.asarray(self.coefficients[photograph]).T)

    @cached_property
    def _tables(self) -> dict[tuple[int, tuple[int, int]], Floats32]:
        return {}

    def table(self, photograph: int, size_px: tuple[int, int]) -> Floats32:
        """Factors (nodes, nodes, bands) over a photograph; kept."""
        found = self._tables.get((photograph, size_px))
        if found is None:
            found = self._made(photograph, size_px)
            self._tables[photograph, size_px] = found
        return found

    def _made(self, photograph: int, size_px: tuple[int, int]) -> Floats32:
        t = np.linspace(0.0, 1.0, TABLE_NODES)
        col, row = np.meshgrid(t * size_px[0], t * size_px[1])
        at = photo_positions(np.stack([col, row], axis=-1), size_px)
        return np.exp(-self.logarithm(photograph, at)).astype(np.float32)


def photo_positions(pixels: Floats, size_px: tuple[int, int]) -> Floats:
    """Pixels (..., 2) as x, y from the middle of the photograph in half diagonals."""
    middle = 0.5 * np.asarray(size_px, np.float64)
    return np.asarray((pixels - middle) / np.hypot(*middle))


def design(positions: Floats) -> Floats:
    """(1, x, y, x^2, y^2, r^4) at positions (..., 2)."""
    x, y = positions[..., 0], positions[..., 1]
    return np.stack([np.ones_like(x), x, y, x * x, y * y, np.square(x * x + y * y)], axis=-1)


@dataclass(frozen=True)
class BalanceSummary:
    """How well the photographs agree.

    Attributes
    ----------
    samples : int
        Observations.
    before, after : tuple of float
        Per band the median of the relative differences between photographs.
    sigma : tuple of float
        Per band the rms relative residual of the observations that were used.
    largest_gain : float
        Largest correction of a photograph's middle, as a factor over 1.
    """

    samples: int
    before: tuple[float, ...]
    after: tuple[float, ...]
    sigma: tuple[float, ...]
    largest_gain: float


def solve_balance(
    samples: Samples, photographs: int, cameras: Sequence[int]
) -> tuple[Balance, BalanceSummary]:
    """Gains, gradients and vignetting from the overlaps.

    Parameters
    ----------
    photographs : int
        How many there are.
    cameras : sequence of int
        Number of each photograph's camera.
    """
    bands = samples.values.shape[2]
    logs = np.log(samples.values[:, 0]) - np.log(samples.values[:, 1])
    matrix, prior = _matrix(samples, photographs, cameras)
    columns = matrix.shape[1]
    solved = np.zeros((columns, bands))
    residuals = logs.copy()
    sigma = []
    for band in range(bands):
        solved[:, band], residuals[:, band], s = _robust(matrix, prior, logs[:, band])
        sigma.append(s)
    own = solved[: OWN * photographs].reshape(photographs, OWN, bands)
    shared = solved[OWN * photographs :].reshape(-1, SHARED, bands)[np.asarray(cameras, np.int64)]
    coefficients = np.concatenate([own, shared], axis=1).transpose(0, 2, 1)
    balance = Balance(tuple(tuple(tuple(map(float, c)) for c in photo) for photo in coefficients))
    summary = BalanceSummary(
        len(logs),
        _medians(logs),
        _medians(residuals),
        tuple(sigma),
        float(np.exp(np.abs(own[:, 0]).max(initial=0.0))),
    )
    return balance, summary


def _medians(values: Floats) -> tuple[float, ...]:
    """Median absolute value of each column; NaN without rows."""
    nothing = float("nan")
    return tuple([float(np.median(np.abs(v))) if v.size else nothing for v in values.T])


def _matrix(samples: Samples, photographs: int, cameras: Sequence[int]) -> tuple[Any, Floats]:
    """Sparse design of the differences of logarithms, and the weights of the prior per unknown."""
    n = len(samples.photographs)
    camera_of = np.asarray(cameras, np.int64)
    rows, cols, values = [], [], []
    for side, sign in ((0, 1.0), (1, -1.0)):
        photo = samples.photographs[:, side]
        terms = design(samples.positions[:, side])
        first = OWN * photo[:, None] + np.arange(OWN)
        last = OWN * photographs + SHARED * camera_of[photo][:, None] + np.arange(SHARED)
        rows.append(np.repeat(np.arange(n), OWN + SHARED))
        cols.append(np.concatenate([first, last], axis=1).ravel())
        values.append((sign * terms).ravel())
    count = OWN * photographs + SHARED * (int(camera_of.max(initial=0)) + 1)
    matrix = scipy.sparse.csr_matrix(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(cols))), shape=(n, count)
    )
    shared = (count - OWN * photographs) // SHARED
    sigmas = np.concatenate([np.tile(PRIOR_SIGMA[:OWN], photographs), np.tile(PRIOR_SIGMA[OWN:], shared)])
    return matrix, 1.0 / np.square(sigmas)


def _robust(matrix: Any, prior: Floats, observed: Floats) -> tuple[Floats, Floats, float]:
    """Weighted least squares with Tukey's weights; solution, residuals, rms of those that count."""
    solution = np.zeros(matrix.shape[1])
    residual = observed.copy()
    scale = OBSERVATION_SIGMA
    weight = np.ones(len(observed))
    for step in range(_ITERATIONS):
        if len(observed):
            scale = max(1.4826 * float(np.median(np.abs(residual))), 1e-4)
            limit = 2.0 * _LIMIT_SIGMAS * scale * (4.0 if step == 0 else 1.0)
            weight = np.square(np.clip(1.0 - np.square(residual / limit), 0.0, None))
        scaled = matrix.multiply(weight[:, None] / OBSERVATION_SIGMA**2).tocsr()
        normal = (matrix.T @ scaled + scipy.sparse.diags(prior)).tocsc()
        solution = np.asarray(scipy.sparse.linalg.splu(normal).solve(scaled.T @ observed))
        residual = observed - matrix @ solution
    used = float(weight.sum())
    rms = float(np.sqrt(weight @ np.square(residual) / used)) if used > 0.0 else float("nan")
    return solution, residual, rms


def balance_record(balance: Balance | None) -> list[list[list[float]]] | None:
    """Plain values for stereo.json: photographs, bands, (g, a, b, u, v, w)."""
    if balance is None:
        return None
    return [[list(band) for band in photograph] for photograph in balance.coefficients]


def balance_from_record(record: list[list[list[float]]] | None) -> Balance | None:
    """Inverse of `balance_record`."""
    if record is None:
        return None
    return Balance(tuple(tuple(tuple(map(float, band)) for band in photograph) for photograph in record))
