"""PLY meshes and point clouds, streamed: vertices are moved and written in double precision.

Text and binary of both byte orders. The vertex element must come first, as every program writes it; what
follows (faces) is copied byte by byte. Single precision holds seven digits, a map coordinate needs ten, so
x, y, z become double.
"""

from __future__ import annotations

import io
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import IO, Final

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import FormatError
from stereomate.formats.point_move import MovedPoints, PointMove
from stereomate.raster.files import replacing

Array = NDArray[np.float64]

_VERTICES: Final = 200_000
_TYPES: Final = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS: Final = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
_XYZ: Final = ("x", "y", "z")
_NORMAL: Final = ("nx", "ny", "nz")
_HEADER_LINES: Final = 1000


@dataclass(frozen=True)
class _Header:
    lines: list[str]
    order: str
    count: int
    properties: list[tuple[str, str]]

    def dtype(self, moved: bool) -> np.dtype[np.void]:
        """Record of a vertex; x, y, z are double once moved."""
        return np.dtype(
            [
                (name, self.order + ("f8" if moved and name in _XYZ else kind))
                for name, kind in self.properties
            ]
        )

    def written(self) -> bytes:
        out = []
        for line in self.lines:
            cells = line.split()
            is_xyz = len(cells) == 3 and cells[0] == "property" and cells[2] in _XYZ
            out.append(f"property double {cells[2]}" if is_xyz else line)
        return ("\n".join(out) + "\n").encode()


def move_ply(path: Path, target: Path, move: PointMove) -> MovedPoints:
    """Move the vertices of a PLY file, and turn their normals where it has them.

    Raises
    ------
    FormatError
        If it is no PLY file, is cut off, or its vertices are no plain records of x, y, z and other numbers.
    """
    try:
        source: IO[bytes] = path.open("rb")
    except OSError as error:
        raise FormatError(f"cannot be read: {error.strerror}", file=path) from error
    with source, replacing(target) as raw:
        header = _header(path, source)
        # Buffered: a raw file may take fewer bytes than it is given.
        out = io.BufferedWriter(raw)
        out.write(header.written())
        for start in range(0, header.count, _VERTICES):
            size = min(_VERTICES, header.count - start)
            (_move_binary if header.order else _move_text)(path, source, out, header, size, move)
        shutil.copyfileobj(source, out, 1 << 20)
        out.flush()
        out.detach()
    return MovedPoints(header.count, move.notes())


def _header(path: Path, source: IO[bytes]) -> _Header:
    lines: list[str] = []
    while not lines or lines[-1] != "end_header":
        line = source.readline(4096)
        if not line.endswith(b"\n") or len(lines) > _HEADER_LINES or (not lines and line.strip() != b"ply"):
            raise FormatError("must begin with the header of a PLY file", file=path)
        lines.append(line.decode("ascii", errors="replace").strip())
    cells = [line.split() for line in lines]
    kind = next((c[1] for c in cells if len(c) == 3 and c[0] == "format"), "")
    if kind not in _ORDERS:
        raise FormatError(f"must be one of {', '.join(_ORDERS)}", file=path, field="format", value=kind)
    elements = [k for k, c in enumerate(cells) if c[:1] == ["element"]]
    first = cells[elements[0]] if elements else []
    if len(first) != 3 or first[1] != "vertex" or not first[2].isdigit() or int(first[2]) == 0:
        raise FormatError("must have vertices as its first element", file=path, value=" ".join(first))
    end = elements[1] if len(elements) > 1 else len(cells)
    properties = []
    for c in cells[elements[0] + 1 : end]:
        if c[:1] == ["property"]:
            if len(c) != 3 or c[1] not in _TYPES:
                raise FormatError("must be plain numbers in a vertex", file=path, field=" ".join(c))
            properties.append((c[2], _TYPES[c[1]]))
    names = [name for name, _ in properties]
    if not set(_XYZ) <= set(names) or len(set(names)) != len(names):
        raise FormatError("must have x, y and z once in a vertex", file=path, value=names)
    return _Header(lines, _ORDERS[kind], int(first[2]), properties)


def _move_binary(
    path: Path, source: IO[bytes], out: IO[bytes], header: _Header, size: int, move: PointMove
) -> None:
    before = header.dtype(moved=False)
    data = source.read(size * before.itemsize)
    if len(data) != size * before.itemsize:
        raise FormatError("is cut off in its vertices", file=path)
    records = np.frombuffer(data, dtype=before)
    moved = np.empty(size, dtype=header.dtype(moved=True))
    for name in before.names or ():
        moved[name] = records[name]
    xyz = _columns(records, _XYZ)
    for name, values in zip(_XYZ, move.points(xyz).T, strict=True):
        moved[name] = values
    if set(_NORMAL) <= set(before.names or ()):
        for name, values in zip(_NORMAL, move.directions(_columns(records, _NORMAL), xyz).T, strict=True):
            moved[name] = values
    out.write(moved.tobytes())


def _columns(records: NDArray[np.void], names: Sequence[str]) -> Array:
    return np.stack([records[name].astype(np.float64) for name in names], axis=-1)


def _move_text(
    path: Path, source: IO[bytes], out: IO[bytes], header: _Header, size: int, move: PointMove
) -> None:
    names = [name for name, _ in header.properties]
    rows = [line.split() for line in islice(source, size)]
    if len(rows) != size or any(len(row) != len(names) for row in rows):
        raise FormatError(f"must have {len(names)} numbers in each vertex", file=path)
    columns = [names.index(name) for name in _XYZ]
    xyz = _numbers(path, rows, columns)
    changes = list(zip(columns, move.points(xyz).T.tolist(), move.decimals, strict=True))
    if set(_NORMAL) <= set(names):
        columns = [names.index(name) for name in _NORMAL]
        turned = move.directions(_numbers(path, rows, columns), xyz)
        changes += list(zip(columns, turned.T.tolist(), (9, 9, 9), strict=True))
    for column, values, digits in changes:
        for row, value in zip(rows, values, strict=True):
            row[column] = f"{value:.{digits}f}".encode()
    out.write(b"".join(b" ".join(row) + b"\n" for row in rows))


def _numbers(path: Path, rows: Sequence[Sequence[bytes]], columns: Sequence[int]) -> Array:
    try:
        return np.array([[float(row[column]) for column in columns] for row in rows])
    except ValueError as error:
        raise FormatError(f"must be numbers: {error}", file=path, field="vertex") from error
