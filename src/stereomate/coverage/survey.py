"""Photographs and surveys: what everything after is computed from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.model import Camera
from stereomate.errors import OrientationError
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.orientation import ExteriorOrientation
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import map_from_tangent


@dataclass(frozen=True)
class Photograph:
    """An oriented photograph.

    Attributes
    ----------
    name : str
        Unique in its survey.
    path : Path or None
        The image; None for a planned photograph.
    camera : Camera
    orientation : ExteriorOrientation
        In the tangent frame of the survey.
    time : float or None
        Seconds, of any common origin.
    """

    name: str
    path: Path | None
    camera: Camera
    orientation: ExteriorOrientation
    time: float | None = None


@dataclass(frozen=True)
class Survey:
    """Oriented photographs in one map and one tangent frame.

    Attributes
    ----------
    frame : MapFrame
        CRS and height system of the project.
    tangent : TangentFrame
        Where the orientations live.
    photographs : tuple of Photograph

    Raises
    ------
    OrientationError
        If there is no photograph, or a name occurs twice.
    """

    frame: MapFrame
    tangent: TangentFrame
    photographs: tuple[Photograph, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "photographs", tuple(self.photographs))
        if not self.photographs:
            raise OrientationError("a survey must have at least one photograph", field="photographs")
        seen: set[str] = set()
        for photograph in self.photographs:
            if photograph.name in seen:
                raise OrientationError(
                    "names of photographs must be unique", field="photographs", value=photograph.name
                )
            seen.add(photograph.name)

    def index(self, name: str) -> int:
        """Position of the photograph of a name.

        Raises
        ------
        OrientationError
            If there is none.
        """
        for k, photograph in enumerate(self.photographs):
            if photograph.name == name:
                return k
        raise OrientationError("no photograph of this name in the survey", field="photographs", value=name)

    @property
    def centres_tangent(self) -> NDArray[np.float64]:
        """Projection centres in the tangent frame, (n, 3)."""
        return np.array([photograph.orientation.centre for photograph in self.photographs])

    @property
    def centres_map(self) -> NDArray[np.float64]:
        """Projection centres in the map and height system of the project, (n, 3)."""
        return map_from_tangent(self.tangent, self.frame, self.centres_tangent)
