"""What lies in a folder of photographs: photographs, orientations, height models, CRS, cameras."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Final

from stereomate.errors import CrsError, FormatError, ImageError, InputError, ProjectError
from stereomate.formats.camera_files import SUFFIXES, CameraFile, read_camera_file
from stereomate.formats.exif import CameraTags, read_camera_tags
from stereomate.formats.opensfm import OpenSfmReconstruction, read_opensfm
from stereomate.formats.orientation_table import OrientationTable, read_orientation_table
from stereomate.frames.crs import parse
from stereomate.frames.factors import require_conformal
from stereomate.raster import RasterInfo, open_photo

_IMAGES: Final = {".tif", ".tiff", ".jpg", ".jpeg", ".png", ".jp2", ".bmp"}
_TABLES: Final = {".csv", ".txt", ".tsv", ".dat"}
_SURFACE_WORDS: Final = ("dem", "dsm", "dtm", "dgm", "dom", "mnt", "height", "elev", "srtm", "terrain")
_GUESSED_COLUMNS: Final = ("filename", "x", "y", "z", "omega", "phi", "kappa")
# Products of a run are no photographs.
_PRODUCTS: Final = ("ortho", "mate", "lineage")
# A folder deeper than this is somebody else's.
_DEPTH: Final = 4
_MOST_TABLES: Final = 200
# Files of cameras are small; JSON and XML larger than this are something else.
_LARGEST_CAMERA_FILE: Final = 1_000_000


@dataclass(frozen=True)
class FoundPhoto:
    """A photograph, its facts and what its camera wrote into it."""

    path: Path
    info: RasterInfo
    tags: CameraTags


@dataclass(frozen=True)
class FoundTable:
    """A table that orients some of the photographs; `columns` where they had to be guessed."""

    table: OrientationTable
    columns: tuple[str, ...] | None
    matches: int


@dataclass(frozen=True)
class FoundCrs:
    """A projected CRS as text, and the file that said it."""

    text: str
    source: str


@dataclass(frozen=True)
class Findings:
    """Everything `init` could find, best first; `others` are images that nothing orients."""

    folder: Path
    photographs: tuple[FoundPhoto, ...]
    others: tuple[FoundPhoto, ...]
    tables: tuple[FoundTable, ...]
    reconstructions: tuple[OpenSfmReconstruction, ...]
    surfaces: tuple[RasterInfo, ...]
    cameras: tuple[CameraFile, ...]
    crs: FoundCrs | None
    unreadable: tuple[str, ...]

    @property
    def has_positions(self) -> bool:
        """Whether every photograph carries its position."""
        return all(p.tags.longitude is not None and p.tags.latitude is not None for p in self.photographs)


def look_through(folder: Path) -> Findings:
    """Look through a folder and its sub-folders.

    Raises
    ------
    ProjectError
        If the folder is missing or holds no photograph.
    """
    if not folder.is_dir():
        raise ProjectError("must be a folder of photographs", file=folder)
    photographs, surfaces, unreadable = _rasters(folder)
    if not photographs:
        hint = f"unreadable: {unreadable[0]}" if unreadable else None
        raise ProjectError("holds no photograph (TIFF, JPEG, PNG, JPEG 2000)", file=folder, hint=hint)
    tables = _tables(folder, photographs)
    reconstructions = _reconstructions(folder, photographs)
    photographs, others = _with_orientation(photographs, tables, reconstructions)
    return Findings(
        folder=folder,
        photographs=tuple(photographs),
        others=tuple(others),
        tables=tuple(tables),
        reconstructions=tuple(reconstructions),
        surfaces=tuple(surfaces),
        cameras=tuple(_cameras(folder)),
        crs=_crs(tables, surfaces, photographs),
        unreadable=tuple(unreadable),
    )


def photo_pattern(photographs: Sequence[FoundPhoto], folder: Path) -> str | list[str]:
    """The shortest pattern that names exactly the photographs, else their names."""
    relative = [PurePosixPath(photo.path.relative_to(folder).as_posix()) for photo in photographs]
    patterns: dict[str, None] = {}
    for parent in dict.fromkeys(path.parent for path in relative):
        group = [path for path in relative if path.parent == parent]
        for suffix in dict.fromkeys(path.suffix for path in group):
            names = [path.name for path in group if path.suffix == suffix]
            patterns |= dict.fromkeys(_patterns_of(names, suffix, folder / parent, parent))
    found = list(patterns)
    return found[0] if len(found) == 1 else found


def _patterns_of(names: list[str], suffix: str, folder: Path, parent: PurePosixPath) -> list[str]:
    prefix = "" if str(parent) == "." else f"{parent}/"
    stems = [name.removesuffix(suffix) for name in names]
    tail, head = _common([stem[::-1] for stem in stems])[::-1], _common(stems)
    for pattern in (f"*{suffix}", f"*{tail}{suffix}" if tail else "", f"{head}*{suffix}" if head else ""):
        if pattern and {path.name for path in folder.glob(pattern) if path.is_file()} == set(names):
            return [prefix + pattern]
    return [prefix + name for name in sorted(names)]


def _common(texts: Sequence[str]) -> str:
    shortest = min(texts, key=len)
    length = next(
        (index for index, letter in enumerate(shortest) if any(text[index] != letter for text in texts)),
        len(shortest),
    )
    return shortest[:length] if len(texts) > 1 else ""


def _files(folder: Path, suffixes: Iterable[str]) -> list[Path]:
    """Files of these suffixes, not deep, links to folders followed as a user's own folders."""
    wanted = set(suffixes)
    found = []
    for parent, folders, names in os.walk(folder, followlinks=True):
        depth = len(Path(parent).relative_to(folder).parts)
        folders[:] = sorted(n for n in folders if not n.startswith(".")) if depth + 1 < _DEPTH else []
        paths = (Path(parent, name) for name in names if not name.startswith("."))
        found += [path for path in paths if path.suffix.lower() in wanted and path.is_file()]
    return sorted(found)


def _rasters(folder: Path) -> tuple[list[FoundPhoto], list[RasterInfo], list[str]]:
    photographs: list[FoundPhoto] = []
    surfaces: list[RasterInfo] = []
    unreadable: list[str] = []
    for path in _files(folder, _IMAGES):
        try:
            with open_photo(path) as reader:
                info = reader.info
        except ImageError as error:
            unreadable.append(str(error))
            continue
        if _is_surface(info):
            surfaces.append(info)
        elif not path.stem.lower().startswith(_PRODUCTS):
            photographs.append(FoundPhoto(path, info, read_camera_tags(path)))
    return _of_main_folder(photographs), sorted(surfaces, key=_surface_order), unreadable


def _of_main_folder(photographs: list[FoundPhoto]) -> list[FoundPhoto]:
    """The photographs of the folder that has most of them, and others that are no copies of those."""
    if not photographs:
        return []
    parents = [photo.path.parent for photo in photographs]
    best = max(dict.fromkeys(parents), key=lambda parent: (parents.count(parent), -len(parent.parts)))
    names = {photo.path.stem for photo in photographs if photo.path.parent == best}
    return [photo for photo in photographs if photo.path.parent == best or photo.path.stem not in names]


def _with_orientation(
    photographs: list[FoundPhoto],
    tables: Sequence[FoundTable],
    reconstructions: Sequence[OpenSfmReconstruction],
) -> tuple[list[FoundPhoto], list[FoundPhoto]]:
    """Photographs that something orients, and the other images; all of them if nothing does."""
    if tables:
        names = {row.name for row in tables[0].table.rows}
    elif reconstructions:
        names = {shot.name for shot in reconstructions[0].shots}
    else:
        names = {photo.path.name for photo in photographs if photo.tags.longitude is not None}
    stems = {_stem(name) for name in names} | {name.lower() for name in names}
    oriented = [photo for photo in photographs if photo.path.stem.lower() in stems]
    if not oriented:
        return photographs, []
    return oriented, [photo for photo in photographs if photo not in oriented]


def _is_surface(info: RasterInfo) -> bool:
    if info.bands != 1 or info.transform is None:
        return False
    named = any(word in info.path.stem.lower() for word in _SURFACE_WORDS)
    return named or info.dtype.name in ("float32", "float64", "int16", "int32")


def _surface_order(info: RasterInfo) -> tuple[int, int, str]:
    stem = info.path.stem.lower()
    # A surface with buildings shows less wrong than bare ground only where roofs matter; dsm first.
    rank = 0 if "dsm" in stem else 1 if any(word in stem for word in _SURFACE_WORDS) else 2
    return rank, len(info.path.parts), info.path.name


def _tables(folder: Path, photographs: Sequence[FoundPhoto]) -> list[FoundTable]:
    stems = {photo.path.stem.lower() for photo in photographs}
    found = []
    for path in _files(folder, _TABLES)[:_MOST_TABLES]:
        table, columns = _read_table(path)
        if table is None:
            continue
        matches = sum(_stem(row.name) in stems or row.name.lower() in stems for row in table.rows)
        if matches and (table.has(("omega", "phi", "kappa")) or table.has(("roll", "pitch", "yaw"))):
            found.append(FoundTable(table, columns, matches))
    return sorted(found, key=_table_order)


def _table_order(found: FoundTable) -> tuple[int, bool, bool, int, str]:
    adjusted = found.table.has(("x", "y", "z", "omega", "phi", "kappa"))
    guessed = found.columns is not None
    return (-found.matches, not adjusted, guessed, len(found.table.path.parts), found.table.path.name)


def _read_table(path: Path) -> tuple[OrientationTable | None, tuple[str, ...] | None]:
    try:
        return read_orientation_table(path), None
    except InputError:
        pass
    try:
        return read_orientation_table(path, _GUESSED_COLUMNS), _GUESSED_COLUMNS
    except InputError:
        return None, None


def _stem(name: str) -> str:
    return PurePosixPath(name.replace("\\", "/")).stem.lower()


def _reconstructions(folder: Path, photographs: Sequence[FoundPhoto]) -> list[OpenSfmReconstruction]:
    stems = {photo.path.stem.lower() for photo in photographs}
    found = []
    for path in _files(folder, {".json"})[:_MOST_TABLES]:
        try:
            model = read_opensfm(path)
        except FormatError:
            continue
        if any(_stem(shot.name) in stems or shot.name.lower() in stems for shot in model.shots):
            found.append(model)
    return found


def _cameras(folder: Path) -> list[CameraFile]:
    """Files that describe cameras, those of the folder itself first."""
    found = []
    for path in _files(folder, SUFFIXES)[:_MOST_TABLES]:
        if path.stat().st_size > _LARGEST_CAMERA_FILE:
            continue
        try:
            found.append(read_camera_file(path))
        except InputError:  # something else, or a camera no project file can describe
            continue
    # config.yaml of simple-ortho holds more than cameras.
    return sorted(found, key=lambda f: (len(f.path.parts), f.path.stem.lower() == "config", f.path.name))


def _crs(
    tables: Sequence[FoundTable], surfaces: Sequence[RasterInfo], photographs: Sequence[FoundPhoto]
) -> FoundCrs | None:
    """A conformal projected CRS: of a .prj beside a table, else of the height model, else of photographs."""
    for found in tables:
        sidecar = found.table.path.with_suffix(".prj")
        if sidecar.is_file():
            text = sidecar.read_text(encoding="utf-8", errors="replace").strip()
            if _is_conformal(text):
                return FoundCrs(_short(text), sidecar.name)
    for info in [*surfaces, *(photo.info for photo in photographs[:1])]:
        if info.crs_wkt and _is_conformal(info.crs_wkt):
            return FoundCrs(_short(info.crs_wkt), info.path.name)
    positions = [
        (photo.tags.longitude, photo.tags.latitude)
        for photo in photographs
        if photo.tags.longitude is not None and photo.tags.latitude is not None
    ]
    if not positions:
        return None
    longitude = sum(lon for lon, _ in positions) / len(positions)
    latitude = sum(lat for _, lat in positions) / len(positions)
    zone = math.floor((longitude + 180.0) / 6.0) % 60 + 1
    code = f"EPSG:{(32600 if latitude >= 0.0 else 32700) + zone}"
    return FoundCrs(code, "the UTM zone of the photographs' positions")


def _is_conformal(text: str) -> bool:
    try:
        require_conformal(text)
    except CrsError:
        return False
    return True


def _short(text: str) -> str:
    """The authority code of the horizontal part where it has one, else the text as it is."""
    crs = parse(text)
    horizontal = crs.sub_crs_list[0] if crs.is_compound else crs
    authority = horizontal.to_authority(min_confidence=100)
    if authority:
        return ":".join(authority)
    return str(horizontal.to_wkt()) if crs.is_compound else text
