"""Photographs that are to be oriented: files, cameras, and which of them cannot take part and why."""

from __future__ import annotations

import tomllib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.model import Camera
from stereomate.errors import ImageError, InputError, ProjectError
from stereomate.formats.exif import CameraTags, read_camera_tags
from stereomate.project.cameras import camera_from_section
from stereomate.project.film import Film, film_cameras, film_notes
from stereomate.project.inputs import PhotoProblem, photo_fingerprint
from stereomate.project.loader import cameras_of
from stereomate.project.photos import photo_files, read_photo_info
from stereomate.project.reading import validated
from stereomate.project.schema import CameraSection, ProjectFile
from stereomate.project.sensors import draft_camera
from stereomate.raster import RasterInfo


@dataclass(frozen=True, eq=False)
class RawPhoto:
    """A photograph before it is oriented.

    Attributes
    ----------
    name : str
        File name without extension.
    path : Path
    info : RasterInfo or None
        None where there is no file: a photograph known by its measurements only.
    tags : CameraTags
    camera : Camera
    calibrated : bool
        The camera has a distortion from the project file: it is taken as it is.
    digest : str
        Fingerprint of the file.
    scan : Camera or None
        Of film: the camera with this scan's own interior orientation; `camera` is what all scans share.
    format_mm : (float, float) or None
        Of film: width and height of the picture within its frame.
    """

    name: str
    path: Path
    info: RasterInfo | None
    tags: CameraTags
    camera: Camera
    calibrated: bool
    digest: str
    scan: Camera | None = None
    format_mm: tuple[float, float] | None = None

    @property
    def of_pixels(self) -> Camera:
        """The camera that the pixels of the file belong to."""
        return self.camera if self.scan is None else self.scan


@dataclass(frozen=True, eq=False)
class RawPhotos:
    """Photographs that take part in the order of their names, problems of the others, and notes."""

    photos: tuple[RawPhoto, ...]
    problems: tuple[PhotoProblem, ...]
    notes: tuple[str, ...]


def shared_pixels(
    photos: Sequence[RawPhoto], photo: NDArray[np.int64], pixels: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Pixels (m, 2) of photographs (m) as pixels of the cameras they share; film alone moves."""
    out = pixels.copy()
    for k, one in enumerate(photos):
        if one.scan is not None and (mine := photo == k).any():
            out[mine] = one.camera.image_from_photo(one.scan.photo_from_image(pixels[mine]))
    return out


def scan_pixels(
    photos: Sequence[RawPhoto], photo: NDArray[np.int64], pixels: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The reverse of `shared_pixels`."""
    out = pixels.copy()
    for k, one in enumerate(photos):
        if one.scan is not None and (mine := photo == k).any():
            out[mine] = one.scan.image_from_photo(one.camera.photo_from_image(pixels[mine]))
    return out


def raw_photos(file: ProjectFile, path: Path, named: Mapping[str, str | None] | None = None) -> RawPhotos:
    """Find the photographs of a project and their cameras.

    Parameters
    ----------
    file : ProjectFile
    path : Path
        Of the project file.
    named : mapping, optional
        Camera that a table names for a photograph, by its name without extension.

    Raises
    ------
    ProjectError
        If fewer than two photographs can take part, or nothing describes their camera.
    """
    notes: list[str] = []
    problems: list[PhotoProblem] = []
    described = cameras_of(file, path, notes)
    found: list[tuple[Path, RasterInfo, CameraTags, str]] = []
    seen: dict[str, Path] = {}
    for photo in photo_files(file.photos.files, file.photos.exclude, path.parent, path):
        try:
            info = read_photo_info(photo)
        except InputError as error:
            problems.append(PhotoProblem(photo.name, error))
            continue
        digest = photo_fingerprint(photo)
        if digest in seen:
            rule = f"is the same photograph as {seen[digest].name}"
            problems.append(PhotoProblem(photo.name, ImageError(rule, file=photo)))
            continue
        seen[digest] = photo
        found.append((photo, info, read_camera_tags(photo), digest))
    if described:
        photos = _with_described(file, path, found, described, named or {}, problems, notes)
    else:
        photos = _with_drafted(path, found, problems, notes)
    require_unique(photos, path)
    if len(photos) < 2:
        if problems:
            raise problems[0].error
        raise ProjectError(
            "must be two photographs or more", file=path, field="photos.files", value=len(photos)
        )
    return RawPhotos(tuple(photos), tuple(problems), tuple(notes))


def require_unique(photos: Sequence[RawPhoto], path: Path, field: str = "photos.files") -> None:
    """Refuse names that are the same but for their extension."""
    counts = Counter(photo.name for photo in photos)
    twice = sorted(name for name, count in counts.items() if count > 1)
    if twice:
        rule = "names photographs that differ only in their extension"
        raise ProjectError(rule, file=path, field=field, value=twice[0])


def _with_described(
    file: ProjectFile,
    path: Path,
    found: Sequence[tuple[Path, RasterInfo, CameraTags, str]],
    cameras: Mapping[str, Camera],
    named: Mapping[str, str | None],
    problems: list[PhotoProblem],
    notes: list[str],
) -> list[RawPhoto]:
    """Cameras of the project file: by the name a table gives, else by size."""
    if file.photos.camera is not None and file.photos.camera not in cameras:
        rule = f"must be one of {', '.join(cameras)}"
        raise ProjectError(rule, file=path, field="photos.camera", value=file.photos.camera)
    films = film_cameras(file, path)
    notes += film_notes(films, [photo.stem for photo, *_ in found])
    # Film comes with a certificate, if only to say that the lens has no distortion.
    calibrated = {s.name for s in file.camera if s.distortion is not None or s.fiducials is not None}
    photos = []
    for photo, info, tags, digest in found:
        wanted = file.photos.camera or named.get(photo.stem)
        name = film_of_photo(file, films, cameras, photo, wanted)
        if name is not None:
            film, shared = films[name], cameras[name]
            try:
                scan = film.camera_of(shared, photo, info.size)
            except ImageError as error:
                problems.append(PhotoProblem(photo.name, error))
                continue
            size_mm = film.section.format_mm
            photos.append(RawPhoto(photo.stem, photo, info, tags, shared, True, digest, scan, size_mm))
            continue
        sized = [camera for camera in cameras.values() if camera.size_px == info.size]
        camera = cameras.get(wanted or "") or (sized[0] if len(sized) == 1 else None)
        if camera is None or camera.size_px != info.size:
            sizes = ", ".join(f"{c.name} {c.size_px[0]} x {c.size_px[1]}" for c in cameras.values())
            rule = f"is of another camera: none described has its size ({sizes})"
            if len(sized) > 1:
                rule = f"must name its camera: {', '.join(c.name for c in sized)} have its size"
            value = f"{info.size[0]} x {info.size[1]}"
            problems.append(PhotoProblem(photo.name, ImageError(rule, file=photo, value=value)))
            continue
        photos.append(RawPhoto(photo.stem, photo, info, tags, camera, camera.name in calibrated, digest))
    return _split_by_tags(photos, notes)


def film_of_photo(
    file: ProjectFile,
    films: Mapping[str, Film],
    cameras: Mapping[str, Camera],
    photo: Path,
    wanted: str | None = None,
) -> str | None:
    """Name of the film camera of a photograph; None if it is of a digital one.

    By the name that is stated, by the only camera there is, or by the film whose marks are measured in it.
    """
    wanted = wanted or file.photos.camera or (next(iter(cameras)) if len(cameras) == 1 else None)
    if wanted is not None:
        return wanted if wanted in films else None
    return next((name for name, film in films.items() if photo.stem in film.measured), None)


def _kind(tags: CameraTags) -> tuple[str, float | None]:
    """What tells two cameras apart that go by one name: model and focal length."""
    return tags.model, tags.focal_length_mm


def _split_by_tags(photos: Sequence[RawPhoto], notes: list[str]) -> list[RawPhoto]:
    """Two cameras under one name become two: each has its own calibration."""
    kinds: dict[str, Counter[tuple[str, float | None]]] = {}
    for photo in photos:
        kinds.setdefault(photo.camera.name, Counter())[_kind(photo.tags)] += 1
    result = []
    renamed: dict[tuple[str, tuple[str, float | None]], Camera] = {}
    for photo in photos:
        counts = kinds[photo.camera.name]
        usual = min(counts, key=lambda kind: (-counts[kind], str(kind)))
        kind = _kind(photo.tags)
        if kind == usual:
            result.append(photo)
            continue
        key = photo.camera.name, kind
        if key not in renamed:
            model, focal = kind
            what = " ".join(part for part in (model, f"{focal:g} mm" if focal else "") if part) or "no EXIF"
            renamed[key] = replace(photo.camera, name=f"{photo.camera.name} ({what})")
            notes.append(
                f"two cameras under one name: {counts[kind]} photographs of {photo.camera.name} were taken "
                f"with {what}, not {usual[0] or 'a camera without EXIF'}; they are calibrated by themselves"
            )
        result.append(replace(photo, camera=renamed[key]))
    return result


def _with_drafted(
    path: Path,
    found: Sequence[tuple[Path, RasterInfo, CameraTags, str]],
    problems: list[PhotoProblem],
    notes: list[str],
) -> list[RawPhoto]:
    """Cameras from what the photographs say of themselves."""
    cameras: dict[tuple[str, float | None, tuple[int, int]], Camera] = {}
    calibrated: dict[str, bool] = {}
    models = Counter(tags.model for _, _, tags, _ in found)
    photos = []
    for photo, info, tags, digest in found:
        key = (*_kind(tags), info.size)
        if key not in cameras:
            draft = draft_camera(tags, info.size)
            if draft.lines[0].startswith("#"):
                rule = "says nothing about its camera: describe it as [[camera]] in the project file"
                problems.append(PhotoProblem(photo.name, ImageError(rule, file=photo)))
                continue
            name = draft.name
            if any(k[0] == tags.model for k in cameras):
                name = f"{draft.name} {info.size[0]}x{info.size[1]} {tags.focal_length_mm or 0:g} mm"
            section = {"name": name, "size_px": list(info.size), **tomllib.loads("\n".join(draft.lines))}
            camera, remarks = camera_from_section(validated(CameraSection, section, path), path, "camera")
            cameras[key] = camera
            calibrated[name] = "distortion" in section
            notes.append(f"camera {name}: {draft.source}")
            notes += remarks
        camera = cameras[key]
        photos.append(RawPhoto(photo.stem, photo, info, tags, camera, calibrated[camera.name], digest))
    if len(models) > 1 and photos:
        listed = ", ".join(f"{count} of {model or 'unknown'}" for model, count in sorted(models.items()))
        notes.append(f"photographs of several cameras: {listed}; each is calibrated by itself")
    return photos
