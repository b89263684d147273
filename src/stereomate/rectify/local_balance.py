"""What gains, gradients and vignetting leave: differences that vary slowly over a photograph.

A forest is darker seen against the sun, and a haze drifts between two strips: no function of the block has
these. For each photograph the difference of its logarithms to the mean of all photographs of the same place
is smoothed on a few nodes, and taken off. Where all photographs agree nothing changes: what is bright on the
ground stays bright.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.rectify.radiometry import LOCAL_NODES, Samples, at_nodes, photo_pixels

Floats = NDArray[np.float64]
Nodes = tuple[tuple[tuple[float, ...], ...], ...]

# Larger corrections than this (natural logarithm) are not made.
_MOST: Final = 0.4
# How many values a node is worth that believes in no correction, and in a smooth one.
_ZERO_WORTH: Final = 0.5
_SMOOTH_WORTH: Final = 1.0
# The mean of a place changes with the corrections: so many times.
_ROUNDS: Final = 3
_LIMIT_SIGMAS: Final = 3.0


@dataclass(frozen=True, eq=False)
class LocalPart:
    """Nodes of each photograph and band, and the logarithms (n, bands) that are left."""

    nodes: Nodes
    left: Floats


def local_part(samples: Samples, logs: Floats, sizes_px: Sequence[tuple[int, int]]) -> LocalPart:
    """Corrections on nodes over each photograph.

    Parameters
    ----------
    logs : (n, bands)
        Logarithms of the values less the correction found so far.
    """
    bands = logs.shape[1]
    nodes = np.zeros((len(sizes_px), bands, LOCAL_NODES**2))
    _, place, count = np.unique(samples.places, return_inverse=True, return_counts=True)
    several = count[place] >= 2
    mine = [np.flatnonzero(several & (samples.photographs == p)) for p in range(len(sizes_px))]
    left = logs.copy()
    for _ in range(_ROUNDS):
        mean = np.stack([np.bincount(place, left[:, b]) / count for b in range(bands)], axis=1)
        off = left - mean[place]
        for p, rows in enumerate(mine):
            if len(rows) == 0:
                continue
            at = at_nodes(photo_pixels(samples.positions[rows], sizes_px[p]), sizes_px[p])
            for b in range(bands):
                found = _smoothed(at, off[rows, b], samples.values[rows, b])
                found = np.round(np.clip(nodes[p, b] + found, -_MOST, _MOST), 4) - nodes[p, b]
                nodes[p, b] += found
                left[rows, b] -= at @ found
    made = tuple(tuple(tuple(np.round(band, 4).tolist()) for band in photo) for photo in nodes)
    return LocalPart(made, left)


def _smoothed(at: object, off: Floats, values: Floats) -> Floats:
    """Nodes that smooth the differences; bright ground counts more: it is digital numbers that are seen."""
    scale = max(1.4826 * float(np.median(np.abs(off))), 1e-3)
    weight = values / values.mean()
    weight = weight * np.square(np.clip(1.0 - np.square(off / (2.0 * _LIMIT_SIGMAS * scale)), 0.0, None))
    scaled = at.multiply(weight[:, None]).tocsr()  # type: ignore[attr-defined]
    normal = (at.T @ scaled).toarray() + _BELIEF  # type: ignore[attr-defined]
    return np.asarray(np.linalg.solve(normal, scaled.T @ off))


def _belief() -> Floats:
    """Weights of the nodes among each other: small, and smooth along rows and columns."""
    second = np.diff(np.eye(LOCAL_NODES), 2, axis=0)
    bend = np.kron(np.eye(LOCAL_NODES), second), np.kron(second, np.eye(LOCAL_NODES))
    smooth = sum(m.T @ m for m in bend)
    return np.asarray(_ZERO_WORTH * np.eye(LOCAL_NODES**2) + _SMOOTH_WORTH * smooth)


_BELIEF: Final = _belief()
