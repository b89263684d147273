"""PATB orientation files (.ori): one record a photograph, with a rotation matrix instead of angles.

A record is the photograph's name, the principal distance (in micrometres, as PATB's image coordinates), the
projection centre X Y Z and nine elements of the rotation matrix row by row, spread over one or more lines;
some programs leave the principal distance out. A record named -99 ends the file. Which way the matrix goes
is not in the file: PATB's own is written in both directions by different programs, so it must be declared.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.model import Camera
from stereomate.errors import FormatError
from stereomate.formats.declared import Declared
from stereomate.formats.orientation_set import OrientationSet
from stereomate.formats.text_files import read_text, write_text

Array = NDArray[np.float64]

_END: Final = "-99"
# Matrices come with 6 to 9 decimals; more than this off a rotation is another kind of file.
_ORTHONORMAL: Final = 1e-4


def read_patb(path: Path, declared: Declared) -> OrientationSet:
    """Read a PATB orientation file.

    Parameters
    ----------
    path : Path
    declared : Declared
        Frame (`crs`, `heights` or `origin`), `axes` and the direction `matrix` of the matrices.

    Raises
    ------
    FormatError
        If it is no such file, or something it does not say is not declared.
    """
    place = declared.require_place(path)
    names, distances, centres, matrices = _records(path, read_text(path))
    axes = declared.require_axes(path, place)
    direction = declared.require_matrix(path)
    u, _, vt = np.linalg.svd(matrices)
    rotations = u @ vt
    if direction == "camera_from_object":
        rotations = np.swapaxes(rotations, -1, -2)
    worst = float(np.abs(u @ vt - matrices).max())
    notes = [
        f"{path.name}: matrices are {direction.replace('_', ' ')}, as declared; rotations to {worst:.1g}"
    ]
    if distances is not None:
        unique = sorted(set(distances))
        words = ", ".join(f"{value:g}" for value in unique[:4])
        notes.append(f"{path.name}: principal distance {words} (usually micrometres) is not taken over")
    return OrientationSet(names, centres + declared.offset, rotations, place, axes, notes=tuple(notes))


def write_patb(path: Path, orientations: OrientationSet, declared: Declared) -> tuple[str, ...]:
    """Write a PATB orientation file: five numbers on a line and the matrix on three; returns notes.

    Raises
    ------
    FormatError
        If the direction of the matrices is not declared, or a name has blanks.
    """
    direction = declared.require_matrix(path)
    lines: list[str] = []
    missing = 0
    for name, camera, centre, rotation in zip(
        orientations.names,
        orientations.cameras,
        orientations.positions - np.array(declared.offset),
        orientations.rotations,
        strict=True,
    ):
        if not name or len(name.split()) != 1 or name == _END:
            raise FormatError("cannot hold a name with blanks, or -99", file=path, field="name", value=name)
        matrix = rotation.T if direction == "camera_from_object" else rotation
        distance = _distance(camera, orientations.camera_values)
        missing += distance == 0.0
        lines.append(f"{name:>12} {distance:14.3f} " + " ".join(f"{value:16.6f}" for value in centre))
        lines += ["  " + " ".join(f"{value:16.12f}" for value in row) for row in matrix]
    lines.append(f"{_END:>12}")
    write_text(path, "\n".join(lines) + "\n")
    notes = [f"matrices are written {direction.replace('_', ' ')}, principal distances in micrometres"]
    if missing:
        notes.append(f"the principal distance of {missing} photographs is not known and written as 0")
    return tuple(notes)


def _distance(camera: str | None, cameras: Mapping[str, Camera]) -> float:
    value = cameras.get(camera) if camera is not None else None
    return 1000.0 * value.principal_distance_mm if value is not None else 0.0


def _records(path: Path, text: str) -> tuple[tuple[str, ...], Array | None, Array, Array]:
    tokens = [
        token for line in text.splitlines() if not line.lstrip().startswith("#") for token in line.split()
    ]
    if tokens and tokens[-1] == _END:
        tokens.pop()
    if not tokens:
        raise FormatError("holds no orientation", file=path)
    for size in (14, 13):
        numbers = _numbers(tokens, size)
        if numbers is None:
            continue
        matrices = numbers[:, -9:].reshape(-1, 3, 3)
        errors = np.abs(matrices @ np.swapaxes(matrices, -1, -2) - np.eye(3)).max(axis=(1, 2))
        if errors.max() > _ORTHONORMAL or np.linalg.det(matrices).min() < 0.0:
            continue
        distances = numbers[:, 0] if size == 14 else None
        return tuple(tokens[::size]), distances, numbers[:, -12:-9], matrices
    raise FormatError(
        "must be records of a name, the principal distance, X, Y, Z and a rotation matrix of nine numbers",
        file=path,
        hint="angles instead of a matrix: read it as a table and name its columns",
    )


def _numbers(tokens: list[str], size: int) -> Array | None:
    if len(tokens) % size:
        return None
    try:
        values = [float(token) for index, token in enumerate(tokens) if index % size]
    except ValueError:
        return None
    array = np.array(values).reshape(-1, size - 1)
    return array if np.isfinite(array).all() else None
