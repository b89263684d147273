"""Pix4D: ``*_calibrated_external_camera_parameters.txt``.

``imageName X Y Z Omega Phi Kappa``: positions in the output coordinate system, which the ``*_wkt.prj``
beside it names, angles in degrees, R = Rx(omega) Ry(phi) Rz(kappa) from camera axes (x right, y up, z
backwards) to the axes of that coordinate system, which Pix4D takes as Cartesian.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from stereomate.errors import FormatError
from stereomate.formats.declared import Declared
from stereomate.formats.orientation_set import OrientationSet
from stereomate.formats.orientation_table import MAP_COLUMNS, OPK_COLUMNS, read_orientation_table
from stereomate.formats.text_files import read_text, write_text
from stereomate.frames.attitude import AttitudeConvention, axes_from_camera, written_from_axes

_CONVENTION: Final = AttitudeConvention("opk", "grid", "deg")
_HEADER: Final = "imageName X Y Z Omega Phi Kappa"


def read_pix4d(path: Path, declared: Declared) -> OrientationSet:
    """Read calibrated external camera parameters.

    Parameters
    ----------
    path : Path
    declared : Declared
        The output coordinate system, unless a ``*_wkt.prj`` lies beside the file; its heights.

    Raises
    ------
    FormatError
        If it is no such file, or its coordinate system is not known.
    """
    table = read_orientation_table(path)
    if not table.has((*MAP_COLUMNS, *OPK_COLUMNS)):
        rule = "must have the columns of calibrated external camera parameters: " + _HEADER
        raise FormatError(rule, file=path, value=list(table.columns))
    beside = sorted(path.parent.glob("*_wkt.prj"))
    notes = []
    default = None
    if declared.crs is None and len(beside) == 1:
        default = read_text(beside[0]).strip()
        notes.append(f"{path.name}: its coordinate system is read from {beside[0].name}")
    place = declared.require_map(path, default)
    angles = np.array([row.values(OPK_COLUMNS) for row in table.rows])
    declared.require_unit(path, angles, "deg")
    notes.append(
        f"{path.name}: angles are omega-phi-kappa in degrees about the axes of the output coordinate system "
        "(Pix4D's documentation)"
    )
    return OrientationSet(
        tuple(row.name for row in table.rows),
        np.array([row.values(MAP_COLUMNS) for row in table.rows]) + declared.offset,
        axes_from_camera(angles, _CONVENTION),
        place,
        declared.axes or "grid",
        notes=tuple(notes),
    )


def write_pix4d(path: Path, orientations: OrientationSet, declared: Declared) -> tuple[str, ...]:
    """Write the same table; returns notes.

    Raises
    ------
    FormatError
        If a name has blanks, which separate the columns.
    """
    angles = written_from_axes(orientations.rotations, _CONVENTION)
    centres = orientations.positions - np.array(declared.offset)
    lines = [_HEADER]
    for name, centre, opk in zip(orientations.names, centres, angles, strict=True):
        if len(name.split()) != 1:
            raise FormatError("cannot hold a name with blanks", file=path, field="imageName", value=name)
        lines.append(" ".join((name, *(f"{v:.6f}" for v in centre), *(f"{v:.12f}" for v in opk))))
    write_text(path, "\n".join(lines) + "\n")
    return (f"angles are omega-phi-kappa in degrees about {orientations.axes} axes",)
