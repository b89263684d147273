"""Photographs on their way into a survey: file, orientation and camera of each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from stereomate.camera.model import Camera
from stereomate.errors import ImageError, OrientationError, ProjectError
from stereomate.project.film import film_cameras
from stereomate.project.inputs import PhotoProblem
from stereomate.project.orientations import WrittenOrientations
from stereomate.project.photos import match_names, photo_files, read_photo_info
from stereomate.project.schema import ProductsSection, ProjectFile
from stereomate.raster import RasterInfo

# Planned photographs are named with or without one of these.
_IMAGE_SUFFIXES = (".tif", ".tiff", ".jpg", ".jpeg", ".png", ".jp2")


@dataclass(frozen=True)
class Candidate:
    """A photograph with an orientation, on its way into the survey; without info it is only planned."""

    index: int
    path: Path
    info: RasterInfo | None
    camera: Camera

    @property
    def name(self) -> str:
        """Name of the photograph in the survey: of the file without extension."""
        plain = self.info is None and self.path.suffix.lower() not in _IMAGE_SUFFIXES
        return self.path.name if plain else self.path.stem


def planned_candidates(
    file: ProjectFile, path: Path, written: WrittenOrientations, cameras: Mapping[str, Camera]
) -> list[Candidate]:
    """Every row of the orientation table as a photograph that is not taken yet, or not at hand."""
    films = film_cameras(file, path)
    candidates = []
    for k, name in enumerate(written.names):
        camera = _camera_of(k, file, path, written, cameras, None)
        film = films.get(camera.name)
        if film is not None and Path(name).stem in film.measured:
            camera = film.camera_of(camera, Path(name), camera.size_px)
        elif film is not None:
            camera = replace(camera, format_mm=film.section.format_mm)
        candidates.append(Candidate(k, Path(name), None, camera))
    return candidates


def find_candidates(
    file: ProjectFile, path: Path, written: WrittenOrientations, cameras: Mapping[str, Camera]
) -> tuple[list[Candidate], list[PhotoProblem]]:
    files = photo_files(file.photos.files, file.photos.exclude, path.parent, path)
    matched, problems = match_names(written.names, files, written.source)
    films = film_cameras(file, path)
    candidates = []
    for index, name in enumerate(written.names):
        if name not in matched:
            continue
        photo = matched[name]
        try:
            info = read_photo_info(photo)
            camera = _camera_of(index, file, path, written, cameras, info)
            if camera.name in films:
                camera = films[camera.name].camera_of(camera, photo, info.size)
            _require_size(camera, info)
        except (ImageError, OrientationError) as error:
            problems.append(PhotoProblem(photo.name, error))
            continue
        candidates.append(Candidate(index, photo, info, camera))
    candidates.sort(key=lambda candidate: candidate.path.name)
    return _of_one_kind(candidates, file.products, problems), problems


def _of_one_kind(
    candidates: list[Candidate], products: ProductsSection, problems: list[PhotoProblem]
) -> list[Candidate]:
    """Candidates that can share a product: bands that are asked for, else as many and of the same type."""
    kinds = Counter((len(c.info.colour_bands), c.info.dtype.name) for c in candidates if c.info is not None)
    if not kinds:
        return []
    (bands, dtype), _ = kinds.most_common(1)[0]
    kept = []
    for candidate in candidates:
        info = candidate.info
        if info is None:
            continue
        rule, value = "", ""
        if products.bands is not None and max(products.bands) > info.bands:
            rule, value = f"must have band {max(products.bands)} (products.bands)", f"{info.bands} bands"
        elif products.bands is None and len(info.colour_bands) != bands:
            rule, value = f"must have {bands} bands like the others", f"{len(info.colour_bands)} bands"
        elif products.dtype is None and info.dtype.name != dtype:
            rule, value = f"must be {dtype} like the others, or products.dtype be given", info.dtype.name
        if rule:
            problems.append(PhotoProblem(candidate.path.name, ImageError(rule, file=info.path, value=value)))
        else:
            kept.append(candidate)
    return kept


def _camera_of(
    index: int,
    file: ProjectFile,
    path: Path,
    written: WrittenOrientations,
    cameras: Mapping[str, Camera],
    info: RasterInfo | None,
) -> Camera:
    known = cameras or written.camera_values
    if not known:
        rule = "must be given: no camera is described"
        raise ProjectError(rule, file=path, field="camera", hint="[[camera]] with its principal distance")
    wanted = file.photos.camera or written.cameras[index]
    if file.photos.camera is not None and wanted not in known:
        rule = f"must be one of {', '.join(known)}"
        raise ProjectError(rule, file=path, field="photos.camera", value=wanted)
    if len(known) == 1:
        camera = next(iter(known.values()))
    elif wanted is not None and wanted in known:
        camera = known[wanted]
    else:
        # Without a name the size decides, where only one camera has it.
        sized = [camera for camera in known.values() if info is not None and camera.size_px == info.size]
        if len(sized) != 1:
            rule = f"must name its camera, one of {', '.join(known)}"
            raise OrientationError(rule, file=written.source, field=written.names[index], value=wanted)
        camera = sized[0]
    return camera


def _require_size(camera: Camera, info: RasterInfo) -> None:
    if info.size != camera.size_px:
        raise ImageError(
            f"must have the {camera.size_px[0]} x {camera.size_px[1]} pixels of camera {camera.name}",
            file=info.path,
            value=f"{info.size[0]} x {info.size[1]}",
        )
