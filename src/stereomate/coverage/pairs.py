"""Pairs of photographs: how much ground they share, and how strong their base is for it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from stereomate.coverage.footprints import Footprint
from stereomate.coverage.survey import Survey
from stereomate.terrain.model import height_unit_m

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Pair:
    """Two photographs that share ground, in the order of the survey.

    Attributes
    ----------
    first, second : int
        Indices into the survey.
    names : (str, str)
    base : (float, float, float)
        Second centre minus first in the map plane and the heights of the survey, metres.
    base_m : float
        Length of the base in space.
    overlap : float
        Shared ground over the smaller of the two footprints.
    overlap_of_first, overlap_of_second : float
        Shared ground over each footprint.
    height_above_ground_m : float
        Mean height of the centres above the mean ground of the two footprints.
    gsd_m : float
        Coarser of the two median ground sampling distances.
    """

    first: int
    second: int
    names: tuple[str, str]
    base: tuple[float, float, float]
    base_m: float
    overlap: float
    overlap_of_first: float
    overlap_of_second: float
    height_above_ground_m: float
    gsd_m: float

    @property
    def base_height(self) -> float:
        """Horizontal base over height above ground."""
        return math.hypot(self.base[0], self.base[1]) / self.height_above_ground_m

    @property
    def direction(self) -> float:
        """Direction of the base from first to second, radians from the first map axis, in (-pi, pi]."""
        return math.atan2(self.base[1], self.base[0])

    @property
    def azimuth_deg(self) -> float:
        """Direction of the base from first to second, degrees clockwise from the second map axis."""
        return math.degrees(math.atan2(self.base[0], self.base[1])) % 360.0

    def left_right(self, rows_direction: float = 0.0) -> tuple[int, int]:
        """Indices of the left and the right photograph of a product whose rows run along a direction.

        Left is the photograph whose centre has the smaller coordinate along the columns, whatever the order
        of exposure. A base square to the rows has no left: then the order of the survey stands.

        Parameters
        ----------
        rows_direction : float
            Radians from the first map axis, counter-clockwise.
        """
        along = math.cos(rows_direction) * self.base[0] + math.sin(rows_direction) * self.base[1]
        return (self.first, self.second) if along >= 0.0 else (self.second, self.first)


def find_pairs(
    survey: Survey, footprints: Sequence[Footprint | None], min_overlap: float = 0.05
) -> list[Pair]:
    """All pairs of a survey that share at least a given part of the smaller footprint.

    Parameters
    ----------
    survey : Survey
    footprints : sequence of Footprint or None
        One for each photograph; None for those that have none.
    min_overlap : float

    Returns
    -------
    list of Pair
        In the order of the survey; none with coincident centres.
    """
    known = [k for k, print_ in enumerate(footprints) if print_ is not None]
    polygons = [print_.polygon for print_ in footprints if print_ is not None]
    tree = shapely.STRtree(polygons)
    left, right = tree.query(polygons, predicate="intersects")
    candidates = sorted((known[i], known[j]) for i, j in zip(left, right, strict=True) if known[i] < known[j])
    centres = survey.centres_map
    centres[:, :2] *= survey.frame.unit_m
    centres[:, 2] *= height_unit_m(survey.frame.heights)
    pairs = []
    for i, j in candidates:
        one, two = footprints[i], footprints[j]
        if one is not None and two is not None:
            pair = _pair(survey, (i, j), (one, two), centres[j] - centres[i])
            if pair is not None and pair.overlap >= min_overlap:
                pairs.append(pair)
    return pairs


def _pair(
    survey: Survey, indices: tuple[int, int], prints: tuple[Footprint, Footprint], base: Floats
) -> Pair | None:
    shared = prints[0].polygon.intersection(prints[1].polygon).area
    shares = shared / prints[0].polygon.area, shared / prints[1].polygon.area
    ends = [np.array(survey.photographs[k].orientation.centre) for k in indices]
    length = float(np.linalg.norm(ends[1] - ends[0]))
    if length == 0.0 or shared == 0.0:
        return None
    return Pair(
        first=indices[0],
        second=indices[1],
        names=(prints[0].name, prints[1].name),
        base=(float(base[0]), float(base[1]), float(base[2])),
        base_m=length,
        overlap=max(shares),
        overlap_of_first=shares[0],
        overlap_of_second=shares[1],
        height_above_ground_m=0.5 * (prints[0].height_above_ground_m + prints[1].height_above_ground_m),
        gsd_m=max(prints[0].gsd_m, prints[1].gsd_m),
    )
