"""A project as a value: what the project file and the files it names come to."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import shapely

from stereomate.coverage.survey import Survey
from stereomate.errors import InputError, ProjectError
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.project.adjusted import GridScale
from stereomate.project.ground import GroundUnderBlock
from stereomate.raster import RasterInfo
from stereomate.rectify.options import RectifyOptions
from stereomate.terrain.model import HeightModel


@dataclass(frozen=True)
class PhotoProblem:
    """A photograph that cannot take part, and why."""

    name: str
    error: InputError


@dataclass(frozen=True)
class InputFile:
    """A file the project reads. `digest` is the SHA-256 of it, of photographs that of their fingerprint."""

    role: str
    path: Path
    digest: str


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
    grid_scale : GridScale or None
        How heights of centres from an adjustment in the grid were changed; None where they are as written.
    inputs : tuple of InputFile
        Every file that was read, but for the height model, whose hash is ``heights.content_hash``.
    problems : tuple of PhotoProblem
        Photographs left out.
    notes : tuple of str
        What was assumed and found, for the report.
    document : mapping
        The project file with all defaults, as plain values.
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
    grid_scale: GridScale | None
    inputs: tuple[InputFile, ...]
    problems: tuple[PhotoProblem, ...]
    notes: tuple[str, ...]
    document: Mapping[str, Any]

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


def file_digest(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


_SAMPLE = 1 << 16


def photo_fingerprint(path: Path) -> str:
    """SHA-256 of the size and the first, middle and last 64 KiB: tells photographs apart at once."""
    size = path.stat().st_size
    digest = hashlib.sha256(str(size).encode())
    with path.open("rb") as file:
        for start in sorted({0, max(size // 2 - _SAMPLE // 2, 0), max(size - _SAMPLE, 0)}):
            file.seek(start)
            digest.update(file.read(_SAMPLE))
    return digest.hexdigest()
