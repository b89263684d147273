"""A project as a value: what the project file and the files it names come to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from stereomate.coverage.covariance import OrientationCovariance
from stereomate.coverage.survey import Survey
from stereomate.errors import InputError, ProjectError
from stereomate.frames.adjusted import GridAdjustment
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.project.compare import Comparison
from stereomate.project.ground import GroundUnderBlock
from stereomate.project.inputs import InputFile, PhotoProblem
from stereomate.raster import RasterInfo
from stereomate.rectify.options import RectifyOptions
from stereomate.terrain.model import HeightModel


@dataclass(frozen=True)
class Sheet:
    """One product to make: its name and its area in the map of the project."""

    name: str
    geometry: shapely.Geometry


@dataclass(frozen=True, eq=False)
class Project:
    """Everything a run needs, checked.

    Attributes
    ----------
    path : Path
        The project file.
    name : str
    survey : Survey
        The photographs that can take part, in order of their names.
    infos : mapping of str to RasterInfo
        Facts of each photograph's file, by name.
    heights : HeightModel or None
        With break-lines burned in, where the project has some.
    ground : GroundUnderBlock or None
        What lies under the photographs of the survey, in their order.
    options : RectifyOptions
    area : shapely geometry or None
        Area of interest in the map of the project.
    sheets : tuple of Sheet
        Products to cut the block into; empty for one.
    pairs : tuple of (str, str) or None
        Models to use, by names of photographs; None for all that serve.
    seam_file : Path or None
        Seams edited by the user, instead of those that would be found.
    grid_adjustment : GridAdjustment or None
        How heights of centres from an adjustment in the grid were changed; None where they are as written.
    inputs : tuple of InputFile
        Every file that was read, but for the height model, whose hash is ``heights.content_hash``.
    comparison : Comparison or None
        Of the orientation with the one of ``[photos.compare]``.
    orientation_covariance : OrientationCovariance or None
        Of the orientations, along the axes of the survey's tangent frame.
    problems : tuple of PhotoProblem
        Photographs left out.
    warnings : tuple of str
        What works, but perhaps not as meant.
    notes : tuple of str
        What was assumed and found, for the report.
    document : mapping
        The project file with all defaults, as plain values.
    water : shapely geometry or None
        Where no orientation point may lie, in the map of the project.
    """

    path: Path
    name: str
    survey: Survey
    infos: Mapping[str, RasterInfo]
    heights: HeightModel | None
    ground: GroundUnderBlock | None
    options: RectifyOptions
    area: shapely.Geometry | None
    sheets: tuple[Sheet, ...]
    pairs: tuple[tuple[str, str], ...] | None
    grid_adjustment: GridAdjustment | None
    inputs: tuple[InputFile, ...]
    comparison: Comparison | None
    problems: tuple[PhotoProblem, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    document: Mapping[str, Any]
    seam_file: Path | None = None
    water: shapely.Geometry | None = None
    orientation_covariance: OrientationCovariance | None = None

    @property
    def frame(self) -> MapFrame:
        """CRS and height system of the project."""
        return self.survey.frame

    @property
    def tangent(self) -> TangentFrame:
        """The frame of all ray geometry."""
        return self.survey.tangent

    def require_heights(self) -> HeightModel:
        """The height model.

        Raises
        ------
        ProjectError
            If the project has none.
        """
        if self.heights is None:
            raise ProjectError("must be given to make products", file=self.path, field="terrain")
        return self.heights

    def without(self, name: str, error: InputError) -> Project:
        """The project without a photograph, for a reason that is kept in `problems` and `notes`.

        Raises
        ------
        InputError
            `error` itself, if no photograph or none of a pair that was asked for would be left.
        """
        index = self.survey.index(name)
        kept = [k for k in range(len(self.survey.photographs)) if k != index]
        if not kept or (self.pairs is not None and any(name in pair for pair in self.pairs)):
            raise error
        path = self.survey.photographs[index].path
        photographs = tuple(self.survey.photographs[k] for k in kept)
        return replace(
            self,
            survey=replace(self.survey, photographs=photographs),
            infos={other: info for other, info in self.infos.items() if other != name},
            ground=None if self.ground is None else self.ground.of(np.array(kept)),
            inputs=tuple(i for i in self.inputs if i.path != path),
            problems=(*self.problems, PhotoProblem(name, error)),
            notes=(*self.notes, f"left out: {error}"),
        )
