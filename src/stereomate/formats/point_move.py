"""Points on their way from one frame to another, block by block, whatever file they come from."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.formats.orientation_set import (
    Place,
    axes_of_place,
    datum_words,
    positions_in,
    rotations_between,
)
from stereomate.frames.checks import check_coordinates
from stereomate.frames.mapframe import MapFrame

Array = NDArray[np.float64]

# Points of a block that are looked at for whether they lie in the map.
_SAMPLE: Final = 200


@dataclass(frozen=True)
class PointMove:
    """From the coordinates of one file to those of another.

    Attributes
    ----------
    source, target : MapFrame, TangentFrame or GeocentricFrame
    source_offset, target_offset : (3,)
        Added to the numbers of a file to get coordinates of its frame.
    """

    source: Place
    target: Place
    source_offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    target_offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    # The first point that was moved: the transformation between datums depends on the place.
    _first: list[Array] = field(default_factory=list, init=False, repr=False, compare=False)

    def points(self, xyz: Array) -> Array:
        """Points (n, 3) of the source file as they are in the target file.

        Raises
        ------
        CrsError, HeightSystemError
            If they cannot be transformed, or a sample of them lies outside the area of a map.
        """
        here = xyz + np.array(self.source_offset)
        moved = positions_in(self.source, self.target, here)[0]
        sample = slice(None, None, max(1, len(here) // _SAMPLE))
        for place, points in ((self.source, here), (self.target, moved)):
            if isinstance(place, MapFrame) and len(here):
                check_coordinates(place, points[sample], "points")
        if not self._first and len(here):
            self._first.append(here[0])
        result: Array = moved - np.array(self.target_offset)
        return result

    def notes(self) -> tuple[str, ...]:
        """What is assumed about datum and heights."""
        return positions_in(self.source, self.target, np.empty((0, 3)))[1]

    def datum_words(self) -> tuple[str, ...]:
        """Which transformation of datums was used; known once points were moved."""
        return datum_words(self.source, self.target, self._first[0]) if self._first else ()

    def directions(self, vectors: Array, xyz: Array) -> Array:
        """Directions (n, 3), such as normals, at points (n, 3) of the source file."""
        source, target = axes_of_place(self.source)[0], axes_of_place(self.target)[0]
        at = xyz + np.array(self.source_offset)
        turns = rotations_between(self.source, source, self.target, target, at)
        turned: Array = np.einsum("nij,nj->ni", turns, vectors)
        return turned

    @property
    def decimals(self) -> tuple[int, int, int]:
        """Decimals of the written coordinates: a hundredth of a millimetre."""
        geographic = isinstance(self.target, MapFrame) and self.target.is_geographic
        return (10, 10, 5) if geographic else (5, 5, 5)


@dataclass(frozen=True)
class MovedPoints:
    """How many points were moved, and what was assumed."""

    count: int
    notes: tuple[str, ...]
