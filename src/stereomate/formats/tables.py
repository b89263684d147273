"""Delimited text as orientations: any column order, with what the numbers mean declared.

Inpho, BINGO, Applanix, IGN (``.OPK``) and most other programs exchange such tables: a name, a position,
three angles. None says its CRS, its heights, the axes of its angles, and few their unit; all of that has to
be declared.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from stereomate.errors import FormatError
from stereomate.formats.declared import AXES_WORDS, Declared
from stereomate.formats.orientation_set import OrientationSet, describe_place
from stereomate.formats.orientation_table import (
    GEOGRAPHIC_COLUMNS,
    MAP_COLUMNS,
    OPK_COLUMNS,
    RPY_COLUMNS,
    OrientationTable,
    read_orientation_table,
)
from stereomate.formats.text_files import read_text, write_text
from stereomate.frames.attitude import AttitudeKind, axes_from_camera, written_from_axes
from stereomate.frames.mapframe import MapFrame

_COLUMNS: Final[dict[AttitudeKind, tuple[str, ...]]] = {
    "opk": OPK_COLUMNS,
    "pok": ("phi", "omega", "kappa"),
    "rph": RPY_COLUMNS,
}
_IGN_COLUMNS: Final = ("filename", *MAP_COLUMNS, *OPK_COLUMNS, "camera")


def read_table(path: Path, declared: Declared) -> OrientationSet:
    """Read a table of orientations.

    Parameters
    ----------
    path : Path
    declared : Declared
        Frame, `axes`, `unit` unless the header has it, `order` where it could be several, `mount` for roll,
        pitch and yaw, `columns` without a header.

    Raises
    ------
    FormatError
        If it is no such table, or something it does not say is not declared: the possibilities are named.
    """
    return _set_of(read_orientation_table(path, declared.columns, declared.separator), declared)


def read_ign_opk(path: Path, declared: Declared) -> OrientationSet:
    """Read IGN's ``.OPK`` (NOM X Y Z O P K CAMERA): a table whose header is known; declarations as
    `read_table`.

    Raises
    ------
    FormatError
        If the header is another, or something it does not say is not declared.
    """
    lines = [line for line in read_text(path).splitlines() if line.strip()]
    head = lines[0].split() if lines else []
    if [cell.upper() for cell in head] != ["NOM", "X", "Y", "Z", "O", "P", "K", "CAMERA"]:
        raise FormatError("must begin with NOM X Y Z O P K CAMERA", file=path, value=" ".join(head))
    return _set_of(read_orientation_table(path, _IGN_COLUMNS, declared.separator), declared)


def write_table(path: Path, orientations: OrientationSet, declared: Declared) -> tuple[str, ...]:
    """Write a table with a header and comments that state what the numbers mean; returns notes.

    Parameters
    ----------
    declared : Declared
        `order`, `unit` and `mount` of the angles (omega-phi-kappa in degrees if absent), `separator`
        (comma if absent).
    """
    kind = declared.order or "opk"
    unit = declared.unit or "deg"
    convention = declared.angle_convention(kind, orientations.axes, unit, path)
    angles = written_from_axes(orientations.rotations, convention)
    centres = orientations.positions - np.array(declared.offset)
    place = orientations.place
    geographic = isinstance(place, MapFrame) and place.is_geographic
    columns = (*(GEOGRAPHIC_COLUMNS if geographic else MAP_COLUMNS), *_COLUMNS[kind])
    separator = declared.separator or ","
    angle_words = f"{'-'.join(_COLUMNS[kind])} in {unit} about axes {AXES_WORDS[orientations.axes]}"
    if kind == "rph":
        angle_words += f", mount {convention.mount}, boresight {declared.boresight_deg} deg"
    lines = [f"# positions: {_one_line(describe_place(place))}", f"# angles: {angle_words}"]
    if isinstance(place, MapFrame):
        lines.insert(1, f"# crs: {_one_line(place.crs)}")
    if any(declared.offset):
        lines.append(f"# add to the positions: {declared.offset}")
    header = ["filename", *columns, "camera"]
    lines.append(separator.join(header))
    digits = 10 if geographic else 4
    for name, centre, values, camera in zip(
        orientations.names, centres, angles, orientations.cameras, strict=True
    ):
        x, y, z = centre
        cells = [name, f"{x:.{digits}f}", f"{y:.{digits}f}", f"{z:.4f}"]
        cells += [f"{value:.12f}" for value in values]
        cells.append(camera or "-")
        lines.append(separator.join(_quoted(path, cell, separator) for cell in cells))
    write_text(path, "\n".join(lines) + "\n")
    return (f"angles are {angle_words}", f"positions are in {describe_place(place)}")


def write_ign_opk(path: Path, orientations: OrientationSet, declared: Declared) -> tuple[str, ...]:
    """Write IGN's ``.OPK``; the unit of angles must be declared. Returns notes."""
    unit = declared.require_unit(path, np.zeros(1))
    convention = declared.angle_convention("opk", orientations.axes, unit, path)
    angles = written_from_axes(orientations.rotations, convention)
    centres = orientations.positions - np.array(declared.offset)
    lines = ["NOM\tX\tY\tZ\tO\tP\tK\tCAMERA"]
    for name, centre, values, camera in zip(
        orientations.names, centres, angles, orientations.cameras, strict=True
    ):
        numbers = (*(f"{v:.4f}" for v in centre), *(f"{v:.12f}" for v in values))
        lines.append("\t".join((_quoted(path, name, "\t"), *numbers, _quoted(path, camera or "-", "\t"))))
    write_text(path, "\n".join(lines) + "\n")
    return (f"angles are omega-phi-kappa in {unit} about {orientations.axes} axes",)


def _set_of(table: OrientationTable, declared: Declared) -> OrientationSet:
    path = table.path
    place = declared.require_place(path)
    geographic = isinstance(place, MapFrame) and place.is_geographic
    columns = GEOGRAPHIC_COLUMNS if geographic else MAP_COLUMNS
    if not table.has(columns):
        rule = f"must have the columns {', '.join(columns)} for positions in {describe_place(place)}"
        raise FormatError(rule, file=path, value=list(table.columns))
    kind = _kind(table, declared)
    axes = declared.require_axes(path, place)
    angles = np.array([row.values(_COLUMNS[kind]) for row in table.rows])
    unit = declared.require_unit(path, angles, table.angle_unit)
    convention = declared.angle_convention(kind, axes, unit, path)
    names = "-".join(_COLUMNS[kind])
    notes = [f"{path.name}: angles are read as {names} in {unit} about axes {AXES_WORDS[axes]}"]
    if table.ignored:
        notes.append(f"{path.name}: columns passed over: {', '.join(table.ignored)}")
    return OrientationSet(
        tuple(row.name for row in table.rows),
        np.array([row.values(columns) for row in table.rows]) + declared.offset,
        axes_from_camera(angles, convention),
        place,
        axes,
        tuple(row.camera if row.camera != "-" else None for row in table.rows),
        notes=tuple(notes),
    )


def _kind(table: OrientationTable, declared: Declared) -> AttitudeKind:
    has = {"opk": table.has(OPK_COLUMNS), "rph": table.has(RPY_COLUMNS)}
    if declared.order is not None:
        if declared.order not in _COLUMNS or not table.has(_COLUMNS[declared.order]):
            rule = f'lacks the columns of angles "{declared.order}"'
            raise FormatError(rule, file=table.path, field="order", value=list(table.columns))
        return declared.order
    if has["opk"] == has["rph"]:
        both = "both kinds of angles" if has["opk"] else "no angles"
        raise FormatError(
            f"has {both}",
            file=table.path,
            field="order",
            value=list(table.columns),
            hint="declare opk (omega, phi, kappa), pok (phi first) or rph (roll, pitch, yaw)",
        )
    return "opk" if has["opk"] else "rph"


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _quoted(path: Path, cell: str, separator: str) -> str:
    if separator not in cell and (separator.strip() or not any(c.isspace() for c in cell)):
        return cell
    if '"' in cell:
        raise FormatError("cannot hold quotes and the separator in one name", file=path, value=cell)
    return f'"{cell}"'
