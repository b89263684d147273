"""Blocks of stated tie points: photographs without files, and pairs oriented from the points they share."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from stereomate.block.models import PairPose
from stereomate.block.photos import BlockPhoto
from stereomate.block.tie_points import PairResult
from stereomate.camera.model import Camera
from stereomate.errors import ImageError, InputError, ProjectError
from stereomate.formats.colmap import database_cameras
from stereomate.formats.exif import CameraTags
from stereomate.formats.image_points import ImageMeasurements, is_database, read_image_points
from stereomate.measurement.tracks import TiePoints
from stereomate.project.film import film_cameras, film_notes
from stereomate.project.inputs import PhotoProblem
from stereomate.project.loader import cameras_of
from stereomate.project.orient_photos import RawPhoto, RawPhotos, film_of_photo, require_unique
from stereomate.project.photos import is_excluded
from stereomate.project.schema import ProjectFile
from stereomate.relative.orientation import RelativeOptions, relative_orientation
from stereomate.relative.pair import correspondences_from_pixels

# Standard deviation of tie points that state none.
STATED_SIGMA_PX: Final = 0.5
# Points measured by hand are few: von Gruber's six of a model determine it.
LEAST_POINTS: Final = 6
# Partners of a photograph, those with most common points first.
_PARTNERS: Final = 14
# A model of so many points may lose single ones to the search for gross errors.
_OPTIONS: Final = RelativeOptions()
_NAMED: Final = 5


def photographs_of_measurements(
    file: ProjectFile, path: Path, named: Mapping[str, str | None]
) -> tuple[RawPhotos, ImageMeasurements]:
    """Photographs that tie points name, where there are no image files: cameras alone say their sizes.

    Parameters
    ----------
    file : ProjectFile
    path : Path
        Of the project file.
    named : mapping
        Camera that a table names for a photograph, by its name without extension.

    Raises
    ------
    ProjectError
        If neither photographs nor tie points are given, or no camera is.
    """
    if file.orient.tie_points is None:
        hint = "or orient.tie_points: measurements can be oriented without the photographs"
        raise ProjectError("must be given", file=path, field="photos.files", hint=hint)
    source = path.parent / file.orient.tie_points
    notes: list[str] = []
    cameras = cameras_of(file, path, notes)
    stated: dict[str, str] = {}
    calibrated = {s.name for s in file.camera if s.distortion is not None or s.fiducials is not None}
    if not cameras and is_database(source):
        of_photos = database_cameras(source)
        stated = {name: camera.name for name, camera in of_photos.items()}
        cameras = {camera.name: camera for camera in of_photos.values()}
        notes.append(f"cameras are those of {source.name}")
    if not cameras:
        rule = "must describe the camera: without photographs nothing else tells its size"
        raise ProjectError(rule, file=path, field="camera")
    choose = _Choice(file, cameras, named, stated)
    measurements = read_image_points(source, choose.size)
    films = film_cameras(file, path)
    names = sorted(n for n in set(measurements.photographs) if not _left_out(n, file.photos.exclude))
    notes += film_notes(films, [Path(name).stem for name in names])
    photos: list[RawPhoto] = []
    problems: list[PhotoProblem] = []
    for name in names:
        try:
            camera = choose.camera(name)
            scan, size_mm = None, None
            film = film_of_photo(file, films, cameras, Path(name), camera.name)
            if film is not None:
                scan = films[film].camera_of(camera, Path(name), camera.size_px)
                size_mm = films[film].section.format_mm
        except ImageError as error:
            problems.append(PhotoProblem(name, error))
            continue
        known = camera.name in calibrated
        photos.append(
            RawPhoto(Path(name).stem, Path(name), None, CameraTags(), camera, known, "", scan, size_mm)
        )
    require_unique(photos, path, "orient.tie_points")
    if len(photos) < 2:
        if problems:
            raise problems[0].error
        rule = "must measure two photographs or more"
        raise InputError(rule, file=source, field="orient.tie_points", value=len(photos))
    notes.append(f"no photographs: {len(photos)} are known by their measurements in {source.name}")
    return RawPhotos(tuple(photos), tuple(problems), tuple(notes)), measurements


def _left_out(name: str, exclude: Sequence[str]) -> bool:
    return any(is_excluded(Path(name), pattern) for pattern in exclude)


@dataclass(frozen=True)
class _Choice:
    """Which camera a photograph has of which only the name is known."""

    file: ProjectFile
    cameras: Mapping[str, Camera]
    named: Mapping[str, str | None]
    stated: Mapping[str, str]

    def camera(self, name: str) -> Camera:
        wanted = self.file.photos.camera or self.named.get(Path(name).stem) or self.stated.get(name)
        if wanted is None and len(self.cameras) == 1:
            wanted = next(iter(self.cameras))
        if wanted is None or (wanted not in self.cameras and len(self.cameras) > 1):
            rule = f"must name its camera in photos.orientation: one of {', '.join(self.cameras)}"
            raise ImageError(rule, file=Path(name), field="camera", value=wanted)
        # A table may call the only camera by another name.
        return self.cameras.get(wanted) or next(iter(self.cameras.values()))

    def size(self, name: str) -> tuple[int, int] | None:
        try:
            return self.camera(name).size_px
        except ImageError:
            return None


def stated_tie_points(
    given: ImageMeasurements, photos: Sequence[BlockPhoto]
) -> tuple[TiePoints, tuple[str, ...], dict[str, Any]]:
    """Tie points of a file with their names; those outside their photograph are left out and counted.

    Raises
    ------
    InputError
        If none is in a photograph of the project.
    """
    index = {Path(photo.name).stem: k for k, photo in enumerate(photos)}
    index |= {photo.name: k for k, photo in enumerate(photos)}
    names: dict[str, int] = {}
    rows = [
        (names.setdefault(point, len(names)), k, row)
        for row, (point, name) in enumerate(zip(given.points, given.photographs, strict=True))
        if (k := index.get(name, index.get(Path(name).stem))) is not None
    ]
    if not rows:
        raise InputError(
            "holds no measurement in a photograph of the project", file=given.path, field="orient.tie_points"
        )
    rows.sort()
    table = np.array(rows, dtype=np.int64)
    pixels = given.pixels[table[:, 2]]
    sizes = np.array([photo.camera.size_px for photo in photos], dtype=np.float64)[table[:, 1]]
    inside = ((pixels >= 0.0) & (pixels <= sizes)).all(axis=1)
    sigma = given.sigma_px[table[:, 2]]
    ties = TiePoints(
        tuple(photo.name for photo in photos),
        table[inside, 0].copy(),
        table[inside, 1].copy(),
        pixels[inside],
        np.where(np.isfinite(sigma), sigma, STATED_SIGMA_PX)[inside],
        np.full(int(inside.sum()), -1, dtype=np.int64),
    )
    alone = int(np.count_nonzero(np.bincount(ties.point) == 1)) if len(ties) else 0
    ties = ties.with_rays(2)
    by_number = list(names)
    kept = tuple(by_number[k] for k in np.unique(ties.point).tolist())
    ties = ties.numbered()
    counts: dict[str, Any] = {"tie_points": ties.count, "tie_observations": len(ties)}
    outside = [f"{given.points[row]} in {given.photographs[row]}" for row in table[~inside, 2].tolist()]
    counts |= {"from": given.path.name, "seen_once": alone, "outside": len(outside)}
    if outside:
        counts["outside_first"] = outside[:_NAMED]
    return ties, kept, counts


def stated_findings(counts: Mapping[str, Any]) -> list[str]:
    """What a reader must know of stated tie points."""
    found = []
    if outside := counts.get("outside"):
        listed = ", ".join(counts["outside_first"])
        found.append(
            f"{outside} tie point measurements lie outside their photograph and are left out: {listed}"
        )
    if alone := counts.get("seen_once"):
        found.append(f"{alone} tie points are measured in one photograph only: they tie nothing")
    return found


def pairs_of_tie_points(
    ties: TiePoints, photos: Sequence[BlockPhoto], progress: Callable[[int, int], None] | None = None
) -> tuple[tuple[PairPose, ...], tuple[PairResult, ...]]:
    """Relative orientations of photographs that share tie points."""
    pairs = _sharing(ties, len(photos))
    rows = {k: np.flatnonzero(ties.photo == k) for k in range(len(photos))}
    poses, results = [], []
    for done, (a, b) in enumerate(pairs):
        if progress is not None:
            progress(done, len(pairs))
        _, i, j = np.intersect1d(ties.point[rows[a]], ties.point[rows[b]], return_indices=True)
        left, right = rows[a][i], rows[b][j]
        pose, result = _pair(ties, photos, (a, b), left, right)
        results.append(result)
        if pose is not None:
            poses.append(pose)
    if progress is not None:
        progress(len(pairs), len(pairs))
    return tuple(poses), tuple(results)


def _pair(
    ties: TiePoints,
    photos: Sequence[BlockPhoto],
    pair: tuple[int, int],
    left: NDArray[np.int64],
    right: NDArray[np.int64],
) -> tuple[PairPose | None, PairResult]:
    a, b = pair
    one, other = photos[a].camera, photos[b].camera
    good = np.isfinite(one.rays_from_image(ties.pixels[left])).all(axis=1)
    good &= np.isfinite(other.rays_from_image(ties.pixels[right])).all(axis=1)
    left, right = left[good], right[good]
    counts = {"matches": len(left)}
    if len(left) < LEAST_POINTS:
        return None, PairResult(a, b, counts, (f"only {len(left)} common points within the lens' range",))
    sigma = float(np.median(ties.sigma_px[np.concatenate([left, right])]))
    found = relative_orientation(
        correspondences_from_pixels(one, other, ties.pixels[left], ties.pixels[right], sigma), _OPTIONS
    )
    counts["matches that agree"] = int(np.count_nonzero(found.used))
    result = PairResult(a, b, counts, found.reasons)
    if not found.determined:
        return None, result
    return PairPose(a, b, found.pose.base, found.pose.left_from_right), result


def _sharing(ties: TiePoints, count: int) -> list[tuple[int, int]]:
    """Pairs that share enough points; of each photograph those with most."""
    shared = np.zeros((count, count), dtype=np.int64)
    order = np.argsort(ties.point, kind="stable")
    for photos in np.split(ties.photo[order], np.flatnonzero(np.diff(ties.point[order])) + 1):
        shared[np.ix_(photos, photos)] += 1
    np.fill_diagonal(shared, 0)
    chosen: set[tuple[int, int]] = set()
    for a in range(count):
        best = np.argsort(-shared[a], kind="stable")[:_PARTNERS]
        chosen |= {(min(a, b), max(a, b)) for b in best.tolist() if shared[a, b] >= LEAST_POINTS}
    return sorted(chosen)


def block_photos(photos: Sequence[RawPhoto]) -> tuple[BlockPhoto, ...]:
    """Photographs numbered as the database has them."""
    return tuple(
        BlockPhoto(k + 1, p.path.name, p.path, p.of_pixels, p.digest, p.format_mm)
        for k, p in enumerate(photos)
    )
