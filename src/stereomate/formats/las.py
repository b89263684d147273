"""LAS and LAZ point clouds, streamed through laspy (an extra: ``pip install stereomate[las]``)."""

from __future__ import annotations

import copy
import io
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import FormatError
from stereomate.formats.point_move import MovedPoints, PointMove
from stereomate.frames.crs import parse
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.raster.files import replacing

Array = NDArray[np.float64]

_POINTS: Final = 500_000
# Records of the coordinate system, which is another one afterwards.
_CRS_RECORDS: Final = {2111, 2112, 34735, 34736, 34737}
_LARGEST: Final = 2**31 - 1


def move_las(path: Path, target: Path, move: PointMove) -> MovedPoints:
    """Move the points of a LAS or LAZ file; every other dimension stays as it is.

    Coordinates are integers in a LAS file: they keep its resolution (0.1 mm at the coarsest a millimetre
    file needs), with an offset at the middle of the points.

    Raises
    ------
    FormatError
        If laspy is not installed, the file is none, or its points do not fit into integers of that
        resolution.
    """
    laspy = _laspy()
    try:
        reader = laspy.open(path)
    except (OSError, laspy.errors.LaspyException) as error:
        raise FormatError(f"is no LAS or LAZ file that laspy reads: {error}", file=path) from error
    with reader, replacing(target) as raw:
        header = _header(reader.header, move)
        buffer = io.BufferedWriter(raw)
        compressed = target.suffix.lower() == ".laz"
        with laspy.open(buffer, mode="w", header=header, do_compress=compressed, closefd=False) as writer:
            for chunk in _chunks(laspy, path, reader):
                xyz = np.stack([np.asarray(chunk.x), np.asarray(chunk.y), np.asarray(chunk.z)], axis=-1)
                _require_fit(path, header, moved := move.points(xyz.astype(np.float64)))
                record = laspy.ScaleAwarePointRecord(
                    chunk.array.copy(), chunk.point_format, scales=header.scales, offsets=header.offsets
                )
                record.x, record.y, record.z = moved.T
                writer.write_points(record)
        buffer.flush()
        buffer.detach()
        count = int(reader.header.point_count)
    return MovedPoints(count, (*move.notes(), *_crs_notes(move)))


def _laspy() -> Any:
    try:
        import laspy
        import laspy.errors
    except ImportError as error:
        rule = "needs the package laspy, which is not installed"
        raise FormatError(rule, field="las", hint='pip install "stereomate[las]"') from error
    return laspy


def _header(before: Any, move: PointMove) -> Any:
    header = copy.deepcopy(before)
    header.vlrs = [vlr for vlr in before.vlrs if vlr.record_id not in _CRS_RECORDS]
    header.evlrs = None
    middle = ((np.asarray(before.mins) + np.asarray(before.maxs)) / 2.0)[None]
    geographic = isinstance(move.target, MapFrame) and move.target.is_geographic
    moved = move.points(middle)[0]
    header.offsets = np.round(moved, 3) if geographic else np.round(moved)
    scales = np.minimum(np.asarray(before.scales), 1e-3)
    header.scales = np.array([1e-8, 1e-8, scales[2]]) if geographic else scales
    if not isinstance(move.target, TangentFrame):
        header.add_crs(parse(move.target.crs), keep_compatibility=True)
    return header


def _chunks(laspy: Any, path: Path, reader: Any) -> Any:
    try:
        yield from reader.chunk_iterator(_POINTS)
    except (OSError, RuntimeError, ValueError, laspy.errors.LaspyException) as error:
        raise FormatError(f"cannot be read to its end: {error}", file=path) from error


def _require_fit(path: Path, header: Any, points: Array) -> None:
    steps = np.abs((points - header.offsets) / header.scales).max(initial=0.0)
    if not steps < _LARGEST:
        raise FormatError(
            "has points too far apart for integers of its resolution", file=path, value=list(header.scales)
        )


def _crs_notes(move: PointMove) -> tuple[str, ...]:
    if isinstance(move.target, TangentFrame):
        return ("the file states no coordinate system: a tangent frame has no code",)
    if isinstance(move.target, MapFrame):
        return (f"heights are {move.target.heights.description}; the file states the plan's CRS only",)
    return ()
