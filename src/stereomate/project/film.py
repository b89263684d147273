"""Film in a project: fiducial marks measured in each scan, and the camera that each scan makes of them.

All scans of a film camera share its principal distance, principal point and distortion; each has its own
transformation from pixels to the photo system.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from stereomate.camera.fiducials import (
    DistanceAdjustment,
    InteriorOrientation,
    certificate_from_distances,
    interior_orientation,
)
from stereomate.camera.model import Camera
from stereomate.errors import FormatError, ImageError, InputError, NotDeterminedError, ProjectError
from stereomate.formats.image_points import read_image_points
from stereomate.project.schema import ProjectFile
from stereomate.project.schema_camera import FiducialsSection

Point = tuple[float, float]

# Residuals of a mark that are a blunder for any scan.
_LARGEST_SIGMAS: Final = 20.0


@dataclass(frozen=True, eq=False)
class Film:
    """A film camera of a project.

    Attributes
    ----------
    name : str
        Of the camera.
    section : FiducialsSection
    certificate_mm : dict
        Mark -> (x, y).
    from_distances : DistanceAdjustment or None
        Where the certificate states distances only.
    measured : dict
        Photograph (without extension) -> mark -> (column, row).
    source : Path or None
        The file of `measured`.
    """

    name: str
    section: FiducialsSection
    certificate_mm: dict[str, Point]
    from_distances: DistanceAdjustment | None
    measured: dict[str, dict[str, Point]]
    source: Path | None

    def interior(self, photo: Path) -> InteriorOrientation:
        """Interior orientation of a scan from its measured marks.

        Raises
        ------
        ImageError
            If its marks are not measured, or too few.
        """
        marks = self.measured.get(photo.stem)
        if not marks:
            where = "none is named" if self.source is None else f"they are not in {self.source.name}"
            raise ImageError(
                f"must have its fiducial marks measured: {where}",
                file=photo,
                field="camera.fiducials.measured",
                hint="stereomate interior finds them",
            )
        return self.oriented(photo, marks)

    def oriented(self, photo: Path, marks: Mapping[str, Point]) -> InteriorOrientation:
        """Interior orientation from marks.

        Raises
        ------
        ImageError
            If they are too few, or do not fit the certificate by far.
        """
        try:
            found = interior_orientation(
                self.certificate_mm, marks, self.section.transform, self.section.sigma_mm
            )
        except NotDeterminedError as error:
            raise ImageError(
                f"must have more fiducial marks for a {self.section.transform} transformation",
                file=photo,
                value=f"{len(marks)} marks",
                hint=str(error),
            ) from error
        worst = int(np.argmax(np.abs(found.residuals_mm).max(axis=1)))
        largest = float(np.abs(found.residuals_mm[worst]).max())
        if largest > _LARGEST_SIGMAS * self.section.sigma_mm:
            raise ImageError(
                f"must show the fiducial marks of {self.name} where its certificate has them: mark "
                f"{found.names[worst]} is off by {largest:.3f} mm",
                file=photo,
                field="camera.fiducials",
            )
        return found

    def camera_of(self, camera: Camera, photo: Path, size_px: tuple[int, int]) -> Camera:
        """The camera of one scan.

        Raises
        ------
        ImageError
            As `interior`.
        """
        found = self.interior(photo)
        return replace(
            camera,
            name=f"{camera.name} [{photo.stem}]",
            size_px=size_px,
            pixel_from_photo=found.pixel_from_photo,
            projective_per_mm=found.projective_per_mm,
            format_mm=self.section.format_mm,
        )


def film_cameras(file: ProjectFile, path: Path) -> dict[str, Film]:
    """The film cameras of a project by name, with the marks measured in their scans.

    Raises
    ------
    ProjectError
        If distances do not fit the marks.
    FormatError
        If the file of measured marks is missing or makes no sense.
    """
    cameras = {}
    for number, section in enumerate(file.camera, 1):
        if section.fiducials is None:
            continue
        film = section.fiducials
        certificate, adjusted = certificate_of(film, path, f"camera[{number}].fiducials")
        source = None if film.measured is None else path.parent / film.measured
        measured = {} if source is None else read_marks(source, certificate)
        cameras[section.name] = Film(section.name, film, certificate, adjusted, measured, source)
    return cameras


def certificate_of(
    section: FiducialsSection, path: Path, field: str
) -> tuple[dict[str, Point], DistanceAdjustment | None]:
    """Coordinates of the marks, from distances where the certificate states only those."""
    nominal = dict(section.marks)
    if section.distances is None:
        return nominal, None
    try:
        found = certificate_from_distances(nominal, {(a, b): value for a, b, value in section.distances})
    except InputError as error:
        raise ProjectError(error.rule, file=path, field=f"{field}.distances", value=error.value) from error
    return found.certificate_mm, found


def read_marks(source: Path, certificate: Mapping[str, Point]) -> dict[str, dict[str, Point]]:
    """Marks measured in scans: a table of mark, photograph, column, row.

    Raises
    ------
    FormatError
        If the file is missing, makes no sense, or names a mark that the certificate does not.
    """
    table = read_image_points(source)
    found: dict[str, dict[str, Point]] = {}
    for mark, name, (col, row) in zip(table.points, table.photographs, table.pixels.tolist(), strict=True):
        if mark not in certificate:
            raise FormatError(
                f"names a mark that the certificate does not: {', '.join(certificate)}",
                file=source,
                field="point",
                value=mark,
            )
        found.setdefault(Path(name).stem, {})[mark] = (col, row)
    return found


def film_notes(films: Mapping[str, Film], names: Sequence[str]) -> list[str]:
    """What a report says of the certificates."""
    notes = []
    for film in films.values():
        count = sum(name in film.measured for name in names)
        notes.append(
            f"film camera {film.name}: interior orientation by {film.section.transform} transformation, "
            f"marks measured in {count} photographs"
        )
        if film.from_distances is not None and film.from_distances.assumed:
            notes.append(
                f"film camera {film.name}: the certificate's distances leave {film.from_distances.assumed} "
                "relations of the marks open; they are those of the nominal layout"
            )
    return notes
