"""Photographs of a project: the files, and which orientation belongs to which."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Final

from stereomate.errors import ImageError, OrientationError, ProjectError
from stereomate.project.inputs import PhotoProblem
from stereomate.raster import PhotoReader, RasterInfo, open_photo

_END_OF_JPEG: Final = b"\xff\xd9"
_START_OF_SCAN: Final = b"\xff\xda"
# Cameras append thumbnails or padding after the end marker; it is looked for in this tail.
_TAIL: Final = 1 << 20
# Rows read at once where valid pixels are looked for.
_STRIP_ROWS: Final = 256


def photo_files(
    patterns: str | Sequence[str], exclude: Iterable[str], folder: Path, project: Path
) -> tuple[Path, ...]:
    """Files of the photographs, sorted by name.

    A file that is named and missing is among them: as one that cannot be read, it does not stop the others.

    Parameters
    ----------
    patterns : str or sequence of str
        File names or glob patterns, relative to `folder`; ``**`` descends.
    exclude : iterable of str
        Names (with or without extension) or patterns to leave out.
    folder : Path
        The folder of the project file.
    project : Path
        The project file, for messages.

    Raises
    ------
    ProjectError
        If a pattern matches nothing, no file is there, or two files have one name.
    """
    if not patterns:
        raise ProjectError("must be given", file=project, field="photos.files")
    left_out = tuple(exclude)
    found: dict[Path, None] = {}
    for pattern in [patterns] if isinstance(patterns, str) else patterns:
        matches = sorted(_matches(pattern, folder))
        if not matches and _is_pattern(pattern):
            rule, value = "matches no file", str(folder / pattern)
            raise ProjectError(rule, file=project, field="photos.files", value=value)
        found.update(dict.fromkeys(matches or [folder / pattern]))
    if not any(path.is_file() for path in found):
        missing = str(next(iter(found)))
        raise ProjectError("is missing", file=project, field="photos.files", value=missing)
    files = sorted(
        (path for path in found if not any(is_excluded(path, name) for name in left_out)),
        key=lambda path: (path.name, str(path)),
    )
    if not files:
        raise ProjectError("leaves no photograph", file=project, field="photos.exclude", value=list(left_out))
    for first, second in itertools.pairwise(files):
        if first.name == second.name:
            rule = f"names two photographs alike: {first} and {second}"
            raise ProjectError(rule, file=project, field="photos.files")
    return tuple(files)


def any_photo_there(patterns: str | Sequence[str], folder: Path) -> bool:
    """Whether any pattern matches a file."""
    every = [patterns] if isinstance(patterns, str) else patterns
    return any(True for pattern in every for _ in _matches(pattern, folder))


def match_names(
    written: Iterable[str], files: Sequence[Path], table: Path
) -> tuple[dict[str, Path], list[PhotoProblem]]:
    """Which file each written name means: the same file name, else the same name without extension.

    Returns
    -------
    matched : dict
        Written name -> file.
    problems : list of PhotoProblem
        Orientations without a photograph and photographs without an orientation.

    Raises
    ------
    OrientationError
        If a name could mean two files, or two names mean one file.
    """
    exact = {path.name: path for path in files}
    stems: dict[str, list[Path]] = {}
    for path in files:
        stems.setdefault(path.stem.lower(), []).append(path)
    matched: dict[str, Path] = {}
    owner: dict[Path, str] = {}
    problems = []
    for name in written:
        file = _file_of(name, exact, stems, table)
        if file is None:
            problems.append(PhotoProblem(name, OrientationError("has no photograph", file=table, field=name)))
            continue
        if file in owner:
            rule = f"is oriented twice, as {owner[file]} and as {name}"
            raise OrientationError(rule, file=table, field=file.name)
        matched[name], owner[file] = file, name
    problems += [
        PhotoProblem(path.name, OrientationError(f"has no orientation in {table.name}", file=path))
        for path in files
        if path not in owner
    ]
    return matched, problems


def read_photo_info(path: Path) -> RasterInfo:
    """Facts of a photograph; the file must be complete and show something.

    Raises
    ------
    ImageError
        If it is missing, no image, cut off, or nodata everywhere.
    """
    with open_photo(path) as reader:
        _require_complete(reader)
        _require_pixels(reader)
        return reader.info


def _require_pixels(reader: PhotoReader) -> None:
    """One valid pixel is enough: as a rule the first window from the middle has it."""
    if reader.nodata is None and not reader.info.has_mask:
        return
    columns, rows = reader.size
    starts = sorted(range(0, rows, _STRIP_ROWS), key=lambda row: abs(row + _STRIP_ROWS / 2 - rows / 2))
    if not any(reader.read_mask(0, row, columns, _STRIP_ROWS)[0].any() for row in starts):
        raise ImageError("is nodata everywhere", file=reader.path)


def _require_complete(reader: PhotoReader) -> None:
    # A whole JPEG takes long to decode; a complete one ends with its marker.
    if reader.info.driver != "JPEG":
        reader.require_complete()
        return
    with reader.path.open("rb") as file:
        file.seek(max(reader.path.stat().st_size - _TAIL, 0))
        tail = file.read()
    # Markers cannot occur inside coded data. An end before a start of scan is that of the thumbnail.
    if tail.rfind(_END_OF_JPEG) <= tail.rfind(_START_OF_SCAN):
        raise ImageError("is cut off: a JPEG ends with an end marker", file=reader.path)


def _matches(pattern: str, folder: Path) -> Iterable[Path]:
    if not _is_pattern(pattern):
        path = folder / pattern
        return [path] if path.is_file() else []
    root = Path(pattern).anchor
    relative = str(PurePosixPath(pattern).relative_to(root)) if root else pattern
    base = Path(root) if root else folder
    return [path for path in base.glob(relative) if path.is_file()]


def _is_pattern(text: str) -> bool:
    return any(mark in text for mark in "*?[")


def is_excluded(path: Path, name: str) -> bool:
    """Whether a name (with or without extension) or a pattern means a photograph."""
    return name in (path.name, path.stem) or path.match(name)


def _file_of(
    name: str, exact: Mapping[str, Path], stems: Mapping[str, list[Path]], table: Path
) -> Path | None:
    bare = name.replace("\\", "/").rsplit("/", 1)[-1]
    if bare in exact:
        return exact[bare]
    # A table may name photographs without extension, or as they were before conversion.
    candidates = stems.get(bare.lower()) or stems.get(PurePosixPath(bare).stem.lower()) or []
    if len(candidates) > 1:
        rule = f"could mean {' or '.join(path.name for path in candidates)}"
        raise OrientationError(rule, file=table, field=name)
    return candidates[0] if candidates else None
