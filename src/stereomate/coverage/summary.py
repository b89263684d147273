"""The survey in figures: what a check prints before anything is computed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from stereomate.coverage.footprints import Footprint, footprint
from stereomate.coverage.pairs import Pair, find_pairs
from stereomate.coverage.survey import Survey
from stereomate.errors import CoverageError, OrientationError
from stereomate.terrain.model import HeightModel


@dataclass(frozen=True)
class Coverage:
    """Footprints and pairs of a survey.

    Attributes
    ----------
    footprints : tuple of Footprint or None
        One for each photograph of the survey, None where there is none.
    problems : tuple of OrientationError or CoverageError
        Why, for each photograph without a footprint.
    pairs : tuple of Pair
    """

    footprints: tuple[Footprint | None, ...]
    problems: tuple[OrientationError | CoverageError, ...]
    pairs: tuple[Pair, ...]

    @property
    def known(self) -> tuple[Footprint, ...]:
        """The footprints that exist."""
        return tuple(f for f in self.footprints if f is not None)

    @property
    def area(self) -> shapely.Geometry:
        """Union of the footprints, map coordinates."""
        return shapely.union_all([f.polygon for f in self.known])

    @property
    def stereo_area(self) -> shapely.Geometry:
        """Union of the ground that pairs share, map coordinates."""
        parts = []
        for pair in self.pairs:
            one, two = self.footprints[pair.first], self.footprints[pair.second]
            if one is not None and two is not None:
                parts.append(one.polygon.intersection(two.polygon))
        return shapely.union_all(parts)

    @property
    def gsd_m(self) -> float:
        """Median of the photographs' ground sampling distances."""
        return float(np.median([f.gsd_m for f in self.known]))

    @property
    def covered(self) -> float:
        """Share of the footprints that the height model covers, weighted by area."""
        areas = np.array([f.polygon.area for f in self.known])
        return float(np.average([f.covered for f in self.known], weights=areas))


def survey_coverage(survey: Survey, ground: HeightModel | float, min_overlap: float = 0.05) -> Coverage:
    """Footprints and pairs of all photographs; one bad photograph does not stop the others.

    Raises
    ------
    CoverageError or OrientationError
        The first problem, if no photograph has a footprint.
    """
    footprints: list[Footprint | None] = []
    problems: list[OrientationError | CoverageError] = []
    for photograph in survey.photographs:
        try:
            footprints.append(footprint(survey, photograph, ground))
        except (OrientationError, CoverageError) as problem:
            footprints.append(None)
            problems.append(problem)
    if all(f is None for f in footprints):
        raise problems[0]
    return Coverage(tuple(footprints), tuple(problems), tuple(find_pairs(survey, footprints, min_overlap)))
