"""The six orientation points of von Gruber in a model of many points: what the y-parallax is around each.

Numbers as Kasper has them: 1 and 2 in the middle of the strip at the left and right end of the overlap, 3 and
4 to the right of the base (-y), 5 and 6 to its left, as in cross-sections and on the instrument.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stereomate.relative.coplanarity import PointStatistics
from stereomate.relative.model import model_points
from stereomate.relative.pair import Correspondences, RelativePose

Array = NDArray[np.float64]

# Column and row of the zone of each point: left or right end, middle or one of the sides.
_ZONES = {1: (0, 0), 2: (1, 0), 3: (0, -1), 4: (1, -1), 5: (0, 1), 6: (1, 1)}


@dataclass(frozen=True)
class OrientationPoint:
    """One of the six.

    Parameters
    ----------
    number : int
        1 to 6.
    place : (float, float)
        x along the base and y across, in bases, of the middle of its zone.
    points : int
        Correspondences in the zone.
    y_parallax, standard_deviation : float
        Their mean y-parallax and its standard deviation, in the unit of the correspondences; NaN without
        points.
    nearest : int
        Row of the correspondence nearest to the middle; -1 without points.
    """

    number: int
    place: tuple[float, float]
    points: int
    y_parallax: float
    standard_deviation: float
    nearest: int


def six_points(
    pose: RelativePose, correspondences: Correspondences, statistics: PointStatistics
) -> tuple[OrientationPoint, ...]:
    """Gather the used correspondences into the six zones of the overlap.

    The overlap is the extent of the used points along and across the base; a zone is a third of it across and
    a half along.
    """
    rows = np.flatnonzero(statistics.used)
    place = model_points(pose, correspondences)[:, :2]
    low, high = np.percentile(place[rows], [1.0, 99.0], axis=0)
    size = np.maximum(high - low, 1e-12)
    result = []
    for number, (end, side) in _ZONES.items():
        middle = low + size * np.array([0.15 + 0.7 * end, 0.5 + 0.38 * side])
        off = np.abs(place[rows] - middle) / size
        inside = rows[(off[:, 0] <= 0.25) & (off[:, 1] <= 1.0 / 6.0)]
        parallax = statistics.y_parallax[inside]
        nearest = -1
        if len(inside):
            distance = np.linalg.norm((place[inside] - middle) / size, axis=1)
            nearest = int(inside[np.argmin(distance)])
        count = len(inside)
        result.append(
            OrientationPoint(
                number,
                (float(middle[0]), float(middle[1])),
                count,
                float(parallax.mean()) if count else float("nan"),
                float(parallax.std(ddof=1) / np.sqrt(count)) if count > 1 else float("nan"),
                nearest,
            )
        )
    return tuple(result)
