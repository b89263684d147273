"""Image observations of a project by index, freed of distortion, with what is known of their points."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.model import Camera
from stereomate.errors import OrientationError, ProjectError
from stereomate.formats.ign import GroundPoints, ImageObservations, read_ground_points, read_mes
from stereomate.frames.audit.observations import AuditObservations
from stereomate.project.control import read_control
from stereomate.project.loader import cameras_of
from stereomate.project.schema import ProjectFile

Array = NDArray[np.float64]


def project_observations(
    file: ProjectFile, path: Path, written: Oriented, notes: list[str]
) -> AuditObservations:
    """Image observations of a project in units of the principal distance, and what is known of points."""
    return observations_for(file, path, written.names, photo_cameras(file, path, written, notes), notes)


def observations_for(
    file: ProjectFile, path: Path, names: Sequence[str], cameras: Sequence[Camera], notes: list[str]
) -> AuditObservations:
    """The observations of a project in photographs of given names and cameras.

    Raises
    ------
    ProjectError, FormatError, OrientationError
        If the project names none, a file is malformed, or none is in one of the photographs.
    """
    section = file.observations
    if section is None:
        raise ProjectError("must be given", file=path, field="observations")
    files = [section.files] if isinstance(section.files, str) else list(section.files)
    tables = [(path.parent / name, read_mes(path.parent / name)) for name in files]
    known: dict[str, tuple[Array, bool]] = {}
    if section.points is not None:
        _add(known, read_ground_points(path.parent / section.points), control=False)
    if file.control is not None:
        _add(known, read_control(file.control, path.parent), control=True)
    return observations_of(tables, names, cameras, known, notes)


def _add(known: dict[str, tuple[Array, bool]], points: GroundPoints, *, control: bool) -> None:
    for name, xyz in zip(points.names, points.xyz, strict=True):
        known[name] = (xyz, control)


class Oriented(Protocol):
    """Orientations of a file, as far as their cameras go."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of the photographs."""

    @property
    def cameras(self) -> tuple[str | None, ...]:
        """Camera named beside each."""

    @property
    def camera_values(self) -> Mapping[str, Camera]:
        """Cameras the file defines itself."""


def photo_cameras(file: ProjectFile, path: Path, written: Oriented, notes: list[str]) -> tuple[Camera, ...]:
    """The camera of each orientation, without looking at any photograph.

    Raises
    ------
    ProjectError
        If no camera is described, or several and a row names none of them.
    """
    known: Mapping[str, Camera] = cameras_of(file, path, notes) or written.camera_values
    if not known:
        raise ProjectError("must be given: no camera is described", file=path, field="camera")
    only = next(iter(known.values())) if len(known) == 1 else None
    cameras = []
    for name, wanted in zip(written.names, written.cameras, strict=True):
        camera = only or known.get(file.photos.camera or wanted or "")
        if camera is None:
            raise ProjectError(
                f"photograph {name} must name one of {', '.join(known)}", file=path, value=wanted
            )
        cameras.append(camera)
    return tuple(cameras)


def observations_of(
    tables: Iterable[tuple[Path, ImageObservations]],
    photographs: Sequence[str],
    cameras: Sequence[Camera],
    known: Mapping[str, tuple[Array, bool]],
    notes: list[str],
) -> AuditObservations:
    """Observations by index: points in the order they are first named, rays freed of distortion.

    Raises
    ------
    OrientationError
        If no observation is in an oriented photograph.
    """
    index = photograph_index(photographs)
    names: dict[str, int] = {}
    point_of, photo_of, pixels, strange = [], [], [], set()
    for _, table in tables:
        for point, photo, pixel in zip(table.points, table.photographs, table.pixels, strict=True):
            k = index.get(photo, index.get(Path(photo).stem))
            if k is None:
                strange.add(photo)
                continue
            point_of.append(names.setdefault(point, len(names)))
            photo_of.append(k)
            pixels.append(pixel)
    if not point_of:
        raise OrientationError(
            "no observation is in an oriented photograph", field="observations", value=sorted(strange)[:3]
        )
    if strange:
        notes.append(f"observations in {len(strange)} photographs without orientation are left out")
    points, photos, where = np.array(point_of), np.array(photo_of), np.array(pixels)
    image, c_px = np.empty((len(points), 2)), np.empty(len(points))
    for camera in dict.fromkeys(cameras):
        rows = np.array([cameras[k] is camera for k in range(len(cameras))])[photos]
        image[rows] = camera.rays_from_image(where[rows])[..., :2]
        c_px[rows] = principal_distance_px(camera)
    good = np.isfinite(image).all(axis=1)
    if not good.all():
        notes.append(f"{int((~good).sum())} observations lie outside the range of the camera's distortion")
    reference = np.full((len(names), 3), np.nan)
    control = np.zeros(len(names), dtype=bool)
    for name, k in names.items():
        if name in known:
            reference[k], control[k] = known[name]
    return AuditObservations(
        points[good].astype(np.int64),
        photos[good].astype(np.int64),
        image[good],
        c_px[good],
        tuple(names),
        reference,
        control,
    )


def photograph_index(photographs: Sequence[str]) -> dict[str, int]:
    """Number of a photograph by its written name, and by that without extension."""
    index = {Path(name).stem: k for k, name in enumerate(photographs)}
    return index | {name: k for k, name in enumerate(photographs)}


def principal_distance_px(camera: Camera) -> float:
    """Principal distance in pixels, the mean of both directions."""
    (a, b, _), (d, e, _) = camera.pixel_from_photo
    return float(camera.principal_distance_mm * np.sqrt(abs(a * e - b * d)))
