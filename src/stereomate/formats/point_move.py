"""Points on their way from one frame to another, block by block, whatever file they come from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stereomate.formats.orientation_set import Place, axes_of_place, positions_in, rotations_between
from stereomate.frames.mapframe import MapFrame

Array = NDArray[np.float64]


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

    def points(self, xyz: Array) -> Array:
        """Points (n, 3) of the source file as they are in the target file."""
        moved = positions_in(self.source, self.target, xyz + np.array(self.source_offset))[0]
        result: Array = moved - np.array(self.target_offset)
        return result

    def notes(self) -> tuple[str, ...]:
        """What is assumed about datum and heights."""
        return positions_in(self.source, self.target, np.empty((0, 3)))[1]

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
