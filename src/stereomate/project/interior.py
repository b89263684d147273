"""`stereomate interior`: fiducial marks of film found in the scans, and their interior orientations."""

from __future__ import annotations

import csv
import io
import json
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from stereomate import __version__
from stereomate.camera.fiducials import InteriorOrientation
from stereomate.camera.model import Camera
from stereomate.errors import ImageError, NotDeterminedError, ProjectError
from stereomate.measurement.features import grey_image
from stereomate.measurement.fiducial_marks import (
    FiducialOptions,
    FoundFiducials,
    MarkTemplate,
    drawn_mark,
    find_fiducials,
)
from stereomate.project.film import Film, film_cameras
from stereomate.project.loader import cameras_of
from stereomate.project.orient_photos import film_of_photo
from stereomate.project.photos import photo_files
from stereomate.project.reading import read_project_file
from stereomate.project.schema import CameraSection, ProjectFile
from stereomate.project.schema_camera import MarkSection
from stereomate.raster import PhotoReader, open_photo
from stereomate.raster.files import write_whole

MARKS: Final = "interior.csv"
RECORD: Final = "interior.json"
_WAYS: Final = tuple((rotation, mirrored) for mirrored in (False, True) for rotation in (0, 90, 180, 270))

Way = tuple[int, bool]


@dataclass(frozen=True, eq=False)
class Scan:
    """One scan of film: its marks and what came of them.

    Attributes
    ----------
    photo : Path
    camera : str
    marks : dict
        Mark -> (column, row, correlation); correlation NaN for marks that were measured by others.
    missing : tuple of str
    others : tuple of (int, bool)
        Ways of lying that neither pictures nor residuals exclude.
    interior : InteriorOrientation or None
    problem : str
        Why there is none.
    """

    photo: Path
    camera: str
    marks: dict[str, tuple[float, float, float]]
    missing: tuple[str, ...]
    others: tuple[Way, ...]
    interior: InteriorOrientation | None
    problem: str = ""

    def as_record(self) -> dict[str, Any]:
        """Plain values."""
        record: dict[str, Any] = {
            "photograph": self.photo.name,
            "camera": self.camera,
            "missing": list(self.missing),
            "problem": self.problem,
        }
        if self.interior is None:
            return record
        found = self.interior
        return record | {
            "rotation": found.rotation,
            "mirrored": found.mirrored,
            "other_ways_of_lying": [list(way) for way in self.others],
            "transform": found.photo_from_pixel.kind,
            "photo_from_pixel": [list(row) for row in found.photo_from_pixel.matrix],
            "pitch_mm": found.pitch_mm,
            "rms_mm": list(found.rms_mm),
            "sigma0": found.summary.sigma0,
            "redundancy": found.summary.redundancy,
            "marks": [
                {
                    "name": name,
                    "col": self.marks[name][0],
                    "row": self.marks[name][1],
                    "correlation": None if np.isnan(self.marks[name][2]) else self.marks[name][2],
                    "residual_mm": found.residuals_mm[k].tolist(),
                }
                for k, name in enumerate(found.names)
            ],
        }


def interior_of_project(path: str | Path, progress: Callable[[int, int], None] | None = None) -> list[Scan]:
    """Interior orientations of all film photographs of a project.

    Marks that the project states are taken as they are; in all other scans they are looked for. Without
    `photos.files` the photographs are those whose marks are stated.

    Raises
    ------
    ProjectError
        If the project has no film camera, or marks are to be found and nothing says what they look like.
    StereomateError
        About the project and its files.
    """
    path = Path(path)
    file = read_project_file(path)
    films = film_cameras(file, path)
    if not films:
        raise ProjectError("must have a [camera.fiducials]: there is no film", file=path, field="camera")
    cameras = cameras_of(file, path, [])
    tell = progress or (lambda done, total: None)
    if file.photos.files:
        photos = photo_files(file.photos.files, file.photos.exclude, path.parent, path)
    else:
        photos = _of_measured_marks(films, path)
    scans = []
    for k, photo in enumerate(photos):
        tell(k, len(photos))
        name = film_of_photo(file, films, cameras, photo)
        if name is not None:
            section = next(s for s in file.camera if s.name == name)
            scans.append(_scan(photo, films[name], section, cameras[name], path))
    tell(len(photos), len(photos))
    return _settled(scans, films, file, path)


def _of_measured_marks(films: dict[str, Film], path: Path) -> tuple[Path, ...]:
    """Photographs by the names that tables of marks give them."""
    names = sorted({name for film in films.values() for name in film.measured})
    if not names:
        hint = "or camera.fiducials.measured: marks can be judged without the scans"
        raise ProjectError("must be given", file=path, field="photos.files", hint=hint)
    return tuple(Path(name) for name in names)


def write_interior(scans: list[Scan], out: Path) -> tuple[Path, Path]:
    """Write the marks as a table that `camera.fiducials.measured` reads, and everything as JSON."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["mark", "photograph", "col", "row"])
    for scan in scans:
        for name, (col, row, _) in scan.marks.items():
            table.writerow([name, scan.photo.name, f"{col:.4f}", f"{row:.4f}"])
    out.mkdir(parents=True, exist_ok=True)
    record = {
        "format": 1,
        "kind": "interior orientation",
        "software": f"stereomate {__version__}",
        "scans": [scan.as_record() for scan in scans],
    }
    write_whole(out / MARKS, [text.getvalue().encode()])
    write_whole(out / RECORD, [(json.dumps(record, indent=1, ensure_ascii=False) + "\n").encode()])
    return out / MARKS, out / RECORD


def _scan(
    photo: Path, film: Film, section: CameraSection, camera: Camera, path: Path, way: Way | None = None
) -> Scan:
    known = film.measured.get(photo.stem)
    if known is not None:
        marks = {name: (col, row, float("nan")) for name, (col, row) in known.items()}
        missing = tuple(name for name in film.certificate_mm if name not in known)
        return _judged(photo, film, marks, missing, ())
    pitch = _pitch_mm(camera)
    options = FiducialOptions(
        film.section.search_mm, film.section.least_correlation, None, *_way(section, way)
    )
    try:
        with open_photo(photo) as reader:
            found = find_fiducials(
                _grey_reader(reader),
                reader.info.size,
                film.certificate_mm,
                _templates(film, pitch, path),
                pitch,
                options,
            )
    except (ImageError, NotDeterminedError) as error:
        return Scan(photo, film.name, {}, tuple(film.certificate_mm), (), None, str(error))
    return _judged(photo, film, _marks(found), found.missing, found.others)


def _marks(found: FoundFiducials) -> dict[str, tuple[float, float, float]]:
    return {mark.name: (*mark.pixel, mark.correlation) for mark in found.marks}


def _judged(
    photo: Path,
    film: Film,
    marks: dict[str, tuple[float, float, float]],
    missing: tuple[str, ...],
    others: tuple[Way, ...],
) -> Scan:
    try:
        interior = film.oriented(photo, {name: (col, row) for name, (col, row, _) in marks.items()})
    except ImageError as error:
        return Scan(photo, film.name, marks, missing, others, None, str(error))
    return Scan(photo, film.name, marks, missing, others, interior)


def _way(section: CameraSection, way: Way | None) -> tuple[Literal[0, 90, 180, 270] | None, bool | None]:
    """How the film lies, as the project or what was found of other scans says."""
    if way is not None:
        return way  # type: ignore[return-value]
    rotation = section.rotation if "rotation" in section.model_fields_set else None
    mirrored = section.mirrored if "mirrored" in section.model_fields_set else None
    return rotation, mirrored


def _settled(scans: list[Scan], films: dict[str, Film], file: ProjectFile, path: Path) -> list[Scan]:
    """Scans that could lie in several ways: as residuals say, else as most others of their camera lie."""
    cameras = cameras_of(file, path, [])
    sections = {section.name: section for section in file.camera}
    result = []
    for scan in scans:
        best = scan
        for way in scan.others:
            other = _scan(
                scan.photo, films[scan.camera], sections[scan.camera], cameras[scan.camera], path, way
            )
            if other.interior is not None and _misfit(other) < 0.5 * _misfit(best):
                best = _with_others(other, ())
        result.append(best)
    sure: dict[str, Counter[Way]] = {}
    for scan in result:
        if scan.interior is not None and not scan.others:
            sure.setdefault(scan.camera, Counter())[scan.interior.rotation, scan.interior.mirrored] += 1
    final = []
    for scan in result:
        usual = sure.get(scan.camera)
        if scan.others and usual:
            way = min(usual, key=lambda w: (-usual[w], w))
            if way in scan.others:
                film, section = films[scan.camera], sections[scan.camera]
                scan = _scan(scan.photo, film, section, cameras[scan.camera], path, way)
        final.append(scan)
    return final


def _with_others(scan: Scan, others: tuple[Way, ...]) -> Scan:
    return Scan(scan.photo, scan.camera, scan.marks, scan.missing, others, scan.interior, scan.problem)


def _misfit(scan: Scan) -> float:
    """Root mean square residual of a similarity: residuals of the affine hide what it takes in."""
    if scan.interior is None:
        return float("inf")
    return float(np.hypot(*scan.interior.rms_mm))


def _templates(film: Film, pitch_mm: float, path: Path) -> dict[str, MarkTemplate]:
    pictures = {}
    for name in film.certificate_mm:
        mark = film.section.templates.get(name, film.section.template)
        if mark is None:
            raise ProjectError(
                f"must say what mark {name} looks like, or the marks be measured",
                file=path,
                field="camera.fiducials.template",
                hint='template = { kind = "cross", size_mm = 2.0 } or { file = "crop.tif" }',
            )
        pictures[name] = _picture(mark, pitch_mm, path)
    return pictures


def _picture(mark: MarkSection, pitch_mm: float, path: Path) -> MarkTemplate:
    if mark.kind is not None:
        assert mark.size_mm is not None  # asked for by the schema
        line = mark.line_mm or mark.size_mm / 10.0
        drawn = drawn_mark(mark.kind, mark.size_mm / pitch_mm, line / pitch_mm, mark.bright)
        return drawn.lying(mark.turned, False)
    assert mark.file is not None  # or a kind
    with open_photo(path.parent / mark.file) as reader:
        columns, rows = reader.info.size
        pixels, _ = reader.read_window(0, 0, columns, rows)
    picture = grey_image(pixels).astype(np.float32)
    centre = mark.centre_px or (picture.shape[1] / 2.0, picture.shape[0] / 2.0)
    return MarkTemplate(picture, centre).lying(mark.turned, False)


def _grey_reader(reader: PhotoReader) -> Callable[[int, int, int, int], NDArray[np.float32]]:
    def read(col: int, row: int, cols: int, rows: int) -> NDArray[np.float32]:
        pixels, _ = reader.read_window(col, row, cols, rows)
        if pixels.shape[2] >= 3 and pixels.dtype == np.uint8:
            return np.asarray(
                cv2.cvtColor(np.ascontiguousarray(pixels[..., :3]), cv2.COLOR_RGB2GRAY), np.float32
            )
        return np.asarray(pixels[..., 0], np.float32)

    return read


def _pitch_mm(camera: Camera) -> float:
    (a, b, _), (d, e, _) = camera.pixel_from_photo
    return float(1.0 / np.sqrt(abs(a * e - b * d)))
