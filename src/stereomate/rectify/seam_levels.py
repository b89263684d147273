"""Brightness levelled beside seams: what differs between two models right there, shared out over some cells.

Crowns, rocks and waves look different from two places, and no balance of photographs takes that away. So the
mean brightness of both models around each place of a seam is compared, per eye and band, and each side goes
half the way to the other, falling off away from the seam. Pixels are multiplied, never taken from the other
photograph: no depths are mixed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np
import scipy  # its parts load when they are used
from numpy.typing import NDArray

from stereomate.raster import Window
from stereomate.rectify.disagreement import photograph_of
from stereomate.rectify.layout import StereoModel
from stereomate.rectify.overviews import Overviews

Floats = NDArray[np.float64]

# Cells from a seam to where nothing is changed, and half the side of the square whose mean is compared.
REACH_CELLS: Final = 16.0
_AROUND_CELLS: Final = 2
# Logarithms at most; of squares that both models show to less than this share, nothing is said.
_MOST: Final = 0.3
_LEAST_SHARE: Final = 0.1
# Points of all seams that are looked through for the nearest one of another seam.
_NEIGHBOURS: Final = 48


def level_reaches(lines: Sequence[Floats], factor: int) -> list[Floats]:
    """Pixels from the points (n, 2) of each line to where nothing is changed; less beside other lines."""
    if not lines:
        return []
    most = REACH_CELLS * factor
    points = np.concatenate(lines)
    number = np.repeat(np.arange(len(lines)), [len(line) for line in lines])
    tree = scipy.spatial.cKDTree(points)
    many = min(_NEIGHBOURS, len(points))
    found = []
    for k, line in enumerate(lines):
        distance, index = tree.query(line, many, distance_upper_bound=2.0 * most)
        shape = (len(line), many)
        distance, index = np.reshape(distance, shape), np.reshape(index, shape)
        other = np.append(number, k)[index] != k
        nearest = np.where(other, distance, 2.0 * most).min(axis=1)
        found.append(np.minimum(0.5 * nearest, most))
    return found


def seam_levels(overviews: Overviews, models: tuple[StereoModel, StereoModel], points: Floats) -> Floats:
    """Logarithm of the brightness of the second model over that of the first, (n, eyes, bands).

    Parameters
    ----------
    overviews : Overviews
        Balanced.
    points : (n, 2)
        Product pixels.
    """
    rows, cols = overviews.shape
    cells = points / overviews.factor
    pad = _AROUND_CELLS + 1
    col0, row0 = np.maximum(np.floor(cells.min(axis=0)).astype(int) - pad, 0).tolist()
    col1, row1 = np.minimum(np.ceil(cells.max(axis=0)).astype(int) + pad, (cols, rows)).tolist()
    window = Window(col0, row0, col1 - col0, row1 - row0)
    row = np.clip(np.floor(cells[:, 1]).astype(int) - row0, 0, window.rows - 1)
    col = np.clip(np.floor(cells[:, 0]).astype(int) - col0, 0, window.cols - 1)
    found = np.zeros((len(points), 2, len(overviews.job.bands)))
    side = 2 * _AROUND_CELLS + 1
    for eye, (a, b) in enumerate(((models[0].left, models[1].left), (models[0].right, models[1].right))):
        if a == b or min(a, b) < 0:
            continue
        (first, first_valid), (second, second_valid) = (photograph_of(overviews, p, window) for p in (a, b))
        both = (first_valid & second_valid).astype(np.float32)
        enough = cv2.blur(both, (side, side), borderType=cv2.BORDER_CONSTANT)[row, col] > _LEAST_SHARE
        means = [
            cv2.blur(image * both[..., None], (side, side)).reshape(image.shape)[row, col]
            for image in (first, second)
        ]
        lit = enough[:, None] & (means[0] > 0.0) & (means[1] > 0.0)
        ratio = np.where(lit, means[1], 1.0) / np.where(lit, means[0], 1.0)
        found[:, eye] = np.clip(np.log(ratio), -_MOST, _MOST)
    return _smoothed(found)


def _smoothed(values: Floats) -> Floats:
    """A third from each neighbour along the line, ends doubled."""
    padded = np.concatenate([values[:1], values, values[-1:]])
    return np.asarray((padded[:-2] + padded[1:-1] + padded[2:]) / 3.0)
