"""Which points of two photographs are the same: nearest descriptors, tested by ratio and mutually.

Where the place in the other photograph can be predicted (overlap, a first orientation, positions from
navigation) only points near it are compared: that is faster, and a ratio test among few neighbours lets more
good matches pass.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import InputError
from stereomate.measurement.features import Features
from stereomate.measurement.kernels.matching import match_near, two_largest

Array = NDArray[np.float64]

_BLOCK: Final = 1024


@dataclass(frozen=True)
class MatchOptions:
    """What counts as a match.

    Parameters
    ----------
    ratio : float
        Largest ratio of the descriptor distance to the next nearest (D. Lowe 2004).
    mutual : bool
        The left point must also be the nearest of the right one.
    largest_distance : float
        Of unit descriptors, 0 to 1.42.
    """

    ratio: float = 0.8
    mutual: bool = True
    largest_distance: float = 0.7

    def __post_init__(self) -> None:
        if not (0.0 < self.ratio <= 1.0 and self.largest_distance > 0.0):
            raise InputError("ratio must lie between 0 and 1, largest_distance above 0", field="ratio")


@dataclass(frozen=True)
class Matches:
    """Pairs of rows of two `Features`.

    Parameters
    ----------
    left, right : ndarray of int, shape (m,)
        Rows of the left and the right features.
    distance, ratio : ndarray, shape (m,)
        Descriptor distance, and over that of the next nearest.
    """

    left: NDArray[np.int64]
    right: NDArray[np.int64]
    distance: Array
    ratio: Array

    def __len__(self) -> int:
        return len(self.left)

    def select(self, rows: NDArray[Any]) -> Matches:
        """Some of the matches (indices or a mask)."""
        return Matches(self.left[rows], self.right[rows], self.distance[rows], self.ratio[rows])


def match_features(left: Features, right: Features, options: MatchOptions | None = None) -> Matches:
    """Match every left point among all right points."""
    options = options or MatchOptions()
    if len(left) == 0 or len(right) == 0:
        return _none()
    best, first, second = _nearest(left.descriptors, right.descriptors)
    back = _nearest(right.descriptors, left.descriptors)[0] if options.mutual else None
    return _passed(best, first, second, back, options)


def match_features_near(
    left: Features,
    right: Features,
    predicted: Array,
    search_px: float | Array,
    options: MatchOptions | None = None,
) -> Matches:
    """Match every left point among the right points near its predicted place.

    Parameters
    ----------
    predicted : ndarray, shape (n, 2)
        Pixels in the right photograph; NaN where the point is not expected there.
    search_px : float or ndarray, shape (n,)
        Radius of the search.
    options : MatchOptions, optional

    Raises
    ------
    InputError
        If `predicted` does not have one row per left point.
    """
    options = options or MatchOptions()
    if predicted.shape != (len(left), 2):
        raise InputError(f"must have the shape ({len(left)}, 2)", field="predicted", value=predicted.shape)
    if len(left) == 0 or len(right) == 0:
        return _none()
    reach = np.broadcast_to(np.asarray(search_px, dtype=np.float64), (len(left),)).copy()
    best, first, second = _nearest_near(left, right, predicted, reach)
    if not options.mutual:
        return _passed(best, first, second, None, options)
    # The other way only matters for points that were chosen: their nearest among the left points that
    # were compared with them is the one with the largest similarity.
    order = np.lexsort((np.arange(len(best)), -first))
    chosen = order[best[order] >= 0]
    _, winners = np.unique(best[chosen], return_index=True)
    mutual = np.zeros(len(left), dtype=np.bool_)
    mutual[chosen[winners]] = True
    return _passed(np.where(mutual, best, -1), first, second, None, options)


def _nearest(left: NDArray[np.float32], right: NDArray[np.float32]) -> tuple[NDArray[np.int64], Array, Array]:
    n = len(left)
    best = np.empty(n, dtype=np.int64)
    first, second = np.empty(n), np.empty(n)
    transposed = np.ascontiguousarray(right.T)
    for start in range(0, n, _BLOCK):
        stop = min(start + _BLOCK, n)
        similarity = left[start:stop] @ transposed
        two_largest(similarity, best[start:stop], first[start:stop], second[start:stop])
    return best, first, second


def _nearest_near(
    left: Features, right: Features, predicted: Array, reach: Array
) -> tuple[NDArray[np.int64], Array, Array]:
    cell = max(8.0, float(np.median(reach)))
    position = np.maximum(right.pixels, 0.0) / cell
    columns, rows = (int(v) + 1 for v in position.max(axis=0))
    number = position[:, 1].astype(np.int64) * columns + position[:, 0].astype(np.int64)
    order = np.argsort(number, kind="stable")
    starts = np.searchsorted(number[order], np.arange(columns * rows + 1))
    n = len(left)
    best = np.empty(n, dtype=np.int64)
    first, second = np.empty(n), np.empty(n)
    match_near(
        left.descriptors,
        right.descriptors,
        np.ascontiguousarray(predicted, dtype=np.float64),
        reach,
        right.pixels,
        order,
        starts.astype(np.int64),
        columns,
        rows,
        cell,
        best,
        first,
        second,
    )
    return best, first, second


def _passed(
    best: NDArray[np.int64],
    first: Array,
    second: Array,
    back: NDArray[np.int64] | None,
    options: MatchOptions,
) -> Matches:
    distance = np.sqrt(np.maximum(2.0 - 2.0 * first, 0.0))
    # Without a second neighbour there is nothing to compare with: the distance of random points stands in.
    other = np.where(second < -1.0, 1.0, np.sqrt(np.maximum(2.0 - 2.0 * second, 1e-12)))
    ratio = distance / other
    good = (best >= 0) & (ratio <= options.ratio) & (distance <= options.largest_distance)
    if back is not None:
        good &= back[best] == np.arange(len(best))
    rows = np.flatnonzero(good)
    return Matches(rows, best[rows], distance[rows], ratio[rows])


def _none() -> Matches:
    empty = np.empty(0, dtype=np.int64)
    return Matches(empty, empty, np.empty(0), np.empty(0))
