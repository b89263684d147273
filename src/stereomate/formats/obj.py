"""Wavefront OBJ meshes, streamed: vertices are moved, normals turned, every other line stays as it is."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import FormatError
from stereomate.formats.point_move import MovedPoints, PointMove
from stereomate.raster.files import replacing, write_all

Array = NDArray[np.float64]

_LINES: Final = 100_000


def move_obj(path: Path, target: Path, move: PointMove) -> MovedPoints:
    """Move the vertices of an OBJ file. Material libraries are named as before, so they belong beside the
    copy.

    Normals have no vertex of their own; all of them are turned as at the first vertex, which is off by 0.009
    degrees a kilometre from it.

    Raises
    ------
    FormatError
        If a vertex does not hold three numbers (the line is named), or a normal comes before any vertex.
    """
    count = normals = 0
    first: Array | None = None
    try:
        source = path.open(encoding="utf-8", errors="surrogateescape")
    except OSError as error:
        raise FormatError(f"cannot be read: {error.strerror}", file=path) from error
    with source, replacing(target) as out:
        numbered = enumerate(source, 1)
        while block := list(islice(numbered, _LINES)):
            lines = [line for _, line in block]
            where, xyz = _values(path, block, "v")
            if first is None and len(xyz):
                first = xyz[:1]
            for index, point in zip(where, move.points(xyz).tolist(), strict=True):
                lines[index] = _line("v", point, move.decimals, lines[index])
            where, vectors = _values(path, block, "vn")
            if len(vectors):
                if first is None:
                    raise FormatError("has normals before its first vertex", file=path)
                turned = move.directions(vectors, np.broadcast_to(first, vectors.shape))
                for index, vector in zip(where, turned.tolist(), strict=True):
                    lines[index] = _line("vn", vector, (9, 9, 9), lines[index])
            count += len(xyz)
            normals += len(vectors)
            write_all(out, ["".join(lines).encode("utf-8", errors="surrogateescape")])
        if count == 0:
            raise FormatError("holds no vertex", file=path)
    notes = list(move.notes())
    if normals:
        notes.append(f"{path.name}: {normals} normals are turned as at the first vertex (0.009 degrees a km)")
    return MovedPoints(count, tuple(notes))


def _values(path: Path, block: Sequence[tuple[int, str]], word: str) -> tuple[list[int], Array]:
    where, values = [], []
    for index, (number, line) in enumerate(block):
        cells = line.split(None, 4)
        if not cells or cells[0] != word:
            continue
        try:
            values.append([float(cell) for cell in cells[1:4]])
        except ValueError:
            values.append([])
        if len(values[-1]) != 3:
            rule = f"must be {word} and three numbers"
            raise FormatError(rule, file=path, field=f"line {number}", value=line.strip())
        where.append(index)
    return where, np.array(values, dtype=np.float64).reshape(-1, 3)


def _line(word: str, values: Sequence[float], decimals: Sequence[int], before: str) -> str:
    rest = before.split(None, 4)[4:]
    numbers = " ".join(f"{value:.{digits}f}" for value, digits in zip(values, decimals, strict=True))
    return f"{word} {numbers} {rest[0]}" if rest else f"{word} {numbers}\n"
