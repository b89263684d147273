"""Photographs whose attitude is turned against their neighbours: what matches say of each one's heading.

The rays of two photographs, turned by their attitudes into map axes, meet level ground at offsets z (complex,
per unit of height). With true attitudes ``z_right = s z_left - B / H``, B the base. If the attitudes are
wrong by turns t about the vertical, z_right and z_left are multiplied by ``exp(-i t)``: the similarity
between matched offsets gives both turns, the base being known from the projection centres.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_TRIALS: Final = 400
# Share of the offsets' spread two matched points may differ by: relief and tilts are not modelled.
_TOLERANCE: Final = 0.03
_LEAST_MATCHES: Final = 12
# Estimates this near to each other speak for the same turn.
_CLUSTER_DEG: Final = 25.0


@dataclass(frozen=True)
class PairTurns:
    """What one pair says.

    Attributes
    ----------
    left, right : int
        Numbers of the photographs.
    turn_left_deg, turn_right_deg : float
        By which their attitudes must be turned about the vertical, counter-clockwise from above.
    matches : int
        That fit one similarity.
    scale : float
        Flying height of the left over that of the right photograph: near 1 for a sound pair.
    """

    left: int
    right: int
    turn_left_deg: float
    turn_right_deg: float
    matches: int
    scale: float


@dataclass(frozen=True)
class PhotoTurn:
    """What all pairs of a photograph say.

    Attributes
    ----------
    photo : int
    turn_deg : float
        In (-180, 180]: mean of the estimates that agree.
    spread_deg : float
        Their standard deviation.
    agreeing, pairs : int
        How many of its pairs agree.
    """

    photo: int
    turn_deg: float
    spread_deg: float
    agreeing: int
    pairs: int

    @property
    def is_turned(self) -> bool:
        """More than 45° off, by two pairs at least and most of its pairs."""
        return abs(self.turn_deg) > 45.0 and self.agreeing >= 2 and 2 * self.agreeing > self.pairs


def ground_offsets(rays: Array, map_from_camera: Array) -> Complex:
    """Horizontal over downward component of rays (n, 3) in map axes, as x + i y; NaN above the horizon."""
    directions = rays @ map_from_camera.T
    below = directions[:, 2] < -0.2 * np.linalg.norm(directions, axis=1)
    out = np.full(len(directions), np.nan + 0j)
    out[below] = (directions[below, 0] + 1j * directions[below, 1]) / -directions[below, 2]
    return out


def pair_turns(left: int, right: int, z_left: Complex, z_right: Complex, base: complex) -> PairTurns | None:
    """Turns of two photographs from offsets of matched points, most of which may be wrong.

    Parameters
    ----------
    z_left, z_right : ndarray (m,)
        Matched offsets of `ground_offsets`.
    base : complex
        Right minus left projection centre in the map.

    Returns
    -------
    PairTurns or None
        None without enough matches that fit one similarity, or with a base that shows no direction.
    """
    good = np.isfinite(z_left) & np.isfinite(z_right)
    x, y = z_left[good], z_right[good]
    if len(x) < _LEAST_MATCHES or abs(base) == 0.0:
        return None
    inliers = _largest_similarity(x, y, seed=left * 65537 + right)
    if inliers.sum() < _LEAST_MATCHES:
        return None
    a, b = _fit(x[inliers], y[inliers])
    if abs(b) < 0.02 or not 0.5 < abs(a) < 2.0:
        return None
    turn_right = -float(np.angle(-b / base))
    turn_left = turn_right + float(np.angle(a))
    return PairTurns(
        left, right, _wrapped(turn_left), _wrapped(turn_right), int(inliers.sum()), float(abs(a))
    )


def photo_turns(pairs: Sequence[PairTurns], count: int) -> tuple[PhotoTurn, ...]:
    """The turn each photograph has by most of its pairs; photographs without a pair are left out."""
    estimates: dict[int, list[float]] = {k: [] for k in range(count)}
    for pair in pairs:
        estimates[pair.left].append(pair.turn_left_deg)
        estimates[pair.right].append(pair.turn_right_deg)
    found = []
    for photo, turns in estimates.items():
        if not turns:
            continue
        angles = np.array(turns)
        apart = np.abs((angles[:, None] - angles[None, :] + 180.0) % 360.0 - 180.0)
        chosen = apart[int(np.argmax((apart < _CLUSTER_DEG).sum(axis=1)))] < _CLUSTER_DEG
        mean = math.degrees(float(np.angle(np.exp(1j * np.deg2rad(angles[chosen])).mean())))
        rest = (angles[chosen] - mean + 180.0) % 360.0 - 180.0
        found.append(PhotoTurn(photo, mean, float(np.sqrt(np.mean(rest**2))), int(chosen.sum()), len(turns)))
    return tuple(found)


def _largest_similarity(x: Complex, y: Complex, seed: int) -> NDArray[np.bool_]:
    """Matches that fit the similarity y = a x + b most others fit (RANSAC, all trials at once)."""
    random = np.random.default_rng(seed)
    first, second = random.integers(0, len(x), (2, _TRIALS))
    apart = x[second] - x[first]
    use = np.abs(apart) > 0.05
    if not use.any():
        return np.zeros(len(x), dtype=bool)
    first, second, apart = first[use], second[use], apart[use]
    a = (y[second] - y[first]) / apart
    a = np.where((np.abs(a) > 0.5) & (np.abs(a) < 2.0), a, np.nan)
    b = y[first] - a * x[first]
    limit = _TOLERANCE * float(np.ptp(y.real) + np.ptp(y.imag)) / 2.0
    fits = np.abs(a[:, None] * x[None, :] + b[:, None] - y[None, :]) < limit
    best: NDArray[np.bool_] = fits[int(np.argmax(fits.sum(axis=1)))]
    return best


def _fit(x: Complex, y: Complex) -> tuple[complex, complex]:
    """Least-squares similarity y = a x + b."""
    dx, dy = x - x.mean(), y - y.mean()
    a = complex(np.vdot(dx, dy) / np.vdot(dx, dx))
    return a, complex(y.mean() - a * x.mean())


def _wrapped(angle: float) -> float:
    return math.degrees(math.remainder(angle, 2.0 * math.pi))
