"""Radiometric balance of a block: brightness of the photographs brought to one, by least squares.

A photograph records ground of brightness L as

    I(x, y) = L exp(g + a x + b y + u x^2 + v y^2 + w r^4)

per band, with x, y, r counted from its middle in half diagonals: a gain and a gradient of its own, and the
vignetting that all photographs of a camera share (round or not: masks and lenses differ). The logarithms
are linear in the unknowns. Wherever two photographs show the same ground, L falls out of the difference of
their logarithms: one observation. It counts by what is known of it: rough ground (crowns, rocks, edges) looks
different from every side, and neighbouring values of two photographs are not independent.

Overlaps tell neither a block that grows brighter to one side from photographs that all do, nor a bowl over
the block from vignetting. So the corrections have no plane and no bowl over the block: it keeps its look.
What is left of differences that vary slowly over a photograph is taken by `rectify.local_balance`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
import scipy  # its parts load when they are used
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Ints = NDArray[np.int64]

# Unknowns of a photograph (gain, two gradients) and of a camera (three of vignetting), per band.
OWN: Final = 3
SHARED: Final = 3
# Photographs that each photograph is compared with at one place.
_PARTNERS: Final = 3
# Factors on so many nodes per side of a photograph; bilinear between them the error is below 1e-4.
TABLE_NODES: Final = 33
# Nodes per side of what the model above does not take.
LOCAL_NODES: Final = 9


@dataclass(frozen=True, eq=False)
class Samples:
    """What photographs recorded of places on the ground; several values of a place make observations.

    Attributes
    ----------
    places : (n,) int
        Number of the place, rising.
    ground : (n, 2)
        Where it is: column and row of a product, in any unit.
    photographs : (n,) int
    positions : (n, 2)
        x, y in the photograph, in half diagonals from its middle.
    values : (n, bands)
        What was recorded, positive.
    noise : (n, bands)
        How far the value may be off, as a share of it: from the roughness around it and the digital step.
    """

    places: Ints
    ground: Floats
    photographs: Ints
    positions: Floats
    values: Floats
    noise: Floats

    @staticmethod
    def joined(parts: Sequence[Samples]) -> Samples:
        """Samples of several products with photographs numbered alike."""
        places, shift = [], 0
        for part in parts:
            places.append(part.places + shift)
            shift += int(part.places.max(initial=-1)) + 1
        return Samples(
            np.concatenate(places),
            np.concatenate([p.ground for p in parts]),
            np.concatenate([p.photographs for p in parts]),
            np.concatenate([p.positions for p in parts]),
            np.concatenate([p.values for p in parts]),
            np.concatenate([p.noise for p in parts]),
        )

    @cached_property
    def pairs(self) -> Ints:
        """Rows (m, 2) of the same place."""
        found = []
        for step in range(1, _PARTNERS + 1):
            same = np.flatnonzero(self.places[step:] == self.places[:-step])
            found.append(np.stack([same, same + step], axis=1))
        return np.concatenate(found)


@dataclass(frozen=True)
class Balance:
    """Radiometric balance of the photographs of a job.

    Attributes
    ----------
    coefficients : tuple (photographs) of tuple (bands) of (g, a, b, u, v, w)
        As above; a photograph is multiplied by exp(-(...)).
    local : tuple (photographs) of tuple (bands) of (LOCAL_NODES ** 2) numbers
        Added to it: on nodes over the photograph, row by row, bilinear between. Empty: nothing.
    """

    coefficients: tuple[tuple[tuple[float, ...], ...], ...]
    local: tuple[tuple[tuple[float, ...], ...], ...] = ()

    def logarithm(self, photograph: int, pixels: Floats, size_px: tuple[int, int]) -> Floats:
        """g + a x + b y + u x^2 + v y^2 + w r^4 and the local part, (..., bands), at pixels (..., 2)."""
        terms = design(photo_positions(pixels, size_px))
        found = terms @ np.asarray(self.coefficients[photograph]).T
        if self.local:
            local = at_nodes(pixels, size_px) @ np.asarray(self.local[photograph]).T
            found = found + local.reshape(found.shape)
        return np.asarray(found)

    def of(self, photographs: Sequence[int]) -> Balance:
        """That of some photographs, in this order."""
        local = tuple(self.local[p] for p in photographs) if self.local else ()
        return Balance(tuple(self.coefficients[p] for p in photographs), local)

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
        logs = self.logarithm(photograph, np.stack([col, row], axis=-1), size_px)
        return np.exp(-logs).astype(np.float32)


def photo_positions(pixels: Floats, size_px: tuple[int, int]) -> Floats:
    """Pixels (..., 2) as x, y from the middle of the photograph in half diagonals."""
    middle = 0.5 * np.asarray(size_px, np.float64)
    return np.asarray((pixels - middle) / np.hypot(*middle))


def photo_pixels(positions: Floats, size_px: tuple[int, int]) -> Floats:
    """Inverse of `photo_positions`."""
    middle = 0.5 * np.asarray(size_px, np.float64)
    return np.asarray(positions * np.hypot(*middle) + middle)


def design(positions: Floats) -> Floats:
    """(1, x, y, x^2, y^2, r^4) at positions (..., 2)."""
    x, y = positions[..., 0], positions[..., 1]
    return np.stack([np.ones_like(x), x, y, x * x, y * y, np.square(x * x + y * y)], axis=-1)


def at_nodes(pixels: Floats, size_px: tuple[int, int]) -> Any:
    """Weights (n, nodes) of the nodes of the local part at pixels (..., 2), n of them; a sparse array."""
    cells = LOCAL_NODES - 1
    at = np.clip(pixels / np.asarray(size_px, np.float64), 0.0, 1.0) * cells
    first = np.minimum(at.astype(np.int64), cells - 1)
    share = at - first
    flat = first.reshape(-1, 2), share.reshape(-1, 2)
    n = len(flat[0])
    rows, cols, values = [], [], []
    for i in (0, 1):
        for j in (0, 1):
            weight = (flat[1][:, 1] if i else 1.0 - flat[1][:, 1]) * (
                flat[1][:, 0] if j else 1.0 - flat[1][:, 0]
            )
            rows.append(np.arange(n))
            cols.append((flat[0][:, 1] + i) * LOCAL_NODES + flat[0][:, 0] + j)
            values.append(weight)
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(cols)))
    return scipy.sparse.csr_array(entries, shape=(n, LOCAL_NODES**2))


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


def balance_record(balance: Balance | None) -> dict[str, list[list[list[float]]]] | None:
    """Plain values for stereo.json: photographs, bands, (g, a, b, u, v, w) and nodes of the local part."""
    if balance is None:
        return None
    parts = {"coefficients": balance.coefficients, "local": balance.local}
    return {key: [[list(band) for band in photo] for photo in part] for key, part in parts.items()}


def balance_from_record(record: dict[str, list[list[list[float]]]] | None) -> Balance | None:
    """Inverse of `balance_record`."""
    if record is None:
        return None
    return Balance(*(_tuples(record[key]) for key in ("coefficients", "local")))


def _tuples(values: list[list[list[float]]]) -> tuple[tuple[tuple[float, ...], ...], ...]:
    return tuple(tuple(tuple(map(float, band)) for band in photograph) for photograph in values)
