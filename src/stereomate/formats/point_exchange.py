"""Points, point clouds and meshes from one frame to another, by the suffix of the file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from stereomate.errors import FormatError
from stereomate.formats.las import move_las
from stereomate.formats.obj import move_obj
from stereomate.formats.orientation_set import describe_place
from stereomate.formats.ply import move_ply
from stereomate.formats.point_move import MovedPoints, PointMove
from stereomate.formats.points_text import move_text

_TEXT: Final = (".csv", ".txt", ".xyz", ".asc", ".pts")
_CLOUD: Final = (".las", ".laz")


def convert_points(
    source: str | Path, target: str | Path, move: PointMove, columns: Sequence[int] | None = None
) -> MovedPoints:
    """Move the points of a file exactly, in blocks: no matrix stands in for the transformation.

    Parameters
    ----------
    source, target : path
        Both text (.csv .txt .xyz .asc .pts), both .las or .laz, both .obj or both .ply.
    move : PointMove
    columns : three ints, optional
        For text: columns of x, y, z from 1.

    Raises
    ------
    FormatError
        If the file is malformed or the two are of different kinds.
    CrsError, HeightSystemError, MissingGridError
        If a point cannot be transformed.
    StorageError
        If the result cannot be written.
    """
    path, out = Path(source), Path(target)
    if not path.is_file():
        raise FormatError("does not exist", file=path)
    if out.exists() and out.resolve() == path.resolve():
        raise FormatError("must be another file than the source", file=out)
    kinds = [_kind(path), _kind(out)]
    if kinds[0] != kinds[1]:
        raise FormatError(f"must be of the kind of its source, {kinds[0]}", file=out, value=out.suffix)
    if columns is not None and kinds[0] != "text":
        raise FormatError("have a meaning for text only", field="columns", value=list(columns))
    if kinds[0] == "text":
        moved = move_text(path, out, move, columns)
    elif kinds[0] == "LAS":
        moved = move_las(path, out, move)
    elif kinds[0] == "OBJ":
        moved = move_obj(path, out, move)
    else:
        moved = move_ply(path, out, move)
    where = f"from {describe_place(move.source)} to {describe_place(move.target)}"
    return MovedPoints(moved.count, (where, *moved.notes, *move.datum_words()))


def _kind(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix in _TEXT:
        return "text"
    if suffix in _CLOUD:
        return "LAS"
    if suffix in (".obj", ".ply"):
        return suffix[1:].upper()
    known = ", ".join((*_TEXT, *_CLOUD, ".obj", ".ply"))
    raise FormatError(f"must have one of the suffixes {known}", file=path, value=suffix)
