"""Exchange of orientations: every format by name, and the conversion from one to another.

A conversion reads an `OrientationSet`, brings it to the declared frame and axes, and writes it. What is not
declared for the result stays as it was in the source, or is what the target format can hold.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final, Literal

from stereomate.errors import FormatError
from stereomate.formats.colmap import read_colmap, write_colmap
from stereomate.formats.declared import Declared
from stereomate.formats.exif_orientations import read_exif_orientations
from stereomate.formats.metashape import (
    read_metashape_opk,
    read_metashape_xml,
    write_metashape_opk,
    write_metashape_xml,
)
from stereomate.formats.micmac import read_micmac, write_micmac
from stereomate.formats.opensfm_exchange import read_opensfm_orientations, write_opensfm
from stereomate.formats.opf import read_opf, write_opf
from stereomate.formats.orientation_set import (
    GeocentricFrame,
    OrientationSet,
    Place,
    axes_of_place,
    converted,
    datum_of,
    describe_place,
    grid_from_space,
    space_from_grid,
)
from stereomate.formats.orthority import (
    read_orthority_csv,
    read_orthority_geojson,
    write_orthority_csv,
    write_orthority_geojson,
)
from stereomate.formats.patb import read_patb, write_patb
from stereomate.formats.pix4d import read_pix4d, write_pix4d
from stereomate.formats.tables import read_ign_opk, read_table, write_ign_opk, write_table
from stereomate.frames.attitude import AttitudeAxes
from stereomate.frames.checks import check_coordinates
from stereomate.frames.mapframe import MapFrame

Reader = Callable[[Path, Declared], OrientationSet]
Writer = Callable[[Path, OrientationSet, Declared], tuple[str, ...]]


@dataclass(frozen=True)
class OrientationFormat:
    """A format of orientations.

    Attributes
    ----------
    name : str
        On the command line.
    title : str
        For people.
    read, write
        Functions; `write` is None where the format is only read.
    holds : str
        What it can hold: ``any`` frame, map ``grid`` coordinates with grid axes, ``geocentric``, or a
        ``frame`` of OpenSfM (tangent or grid).
    """

    name: str
    title: str
    read: Reader
    write: Writer | None
    holds: Literal["any", "grid", "geocentric", "opensfm"] = "any"


FORMATS: Final = {
    entry.name: entry
    for entry in (
        OrientationFormat("table", "delimited text with a header", read_table, write_table),
        OrientationFormat("ign-opk", "IGN .OPK", read_ign_opk, write_ign_opk),
        OrientationFormat("orthority-csv", "orthority CSV", read_orthority_csv, write_orthority_csv, "grid"),
        OrientationFormat(
            "orthority-geojson", "orthority GeoJSON", read_orthority_geojson, write_orthority_geojson, "grid"
        ),
        OrientationFormat("patb", "PATB orientation file", read_patb, write_patb),
        OrientationFormat(
            "metashape-xml",
            "Agisoft Metashape camera XML",
            read_metashape_xml,
            write_metashape_xml,
            "geocentric",
        ),
        OrientationFormat(
            "metashape-opk", "Agisoft Metashape OPK text", read_metashape_opk, write_metashape_opk
        ),
        OrientationFormat(
            "pix4d", "Pix4D calibrated external camera parameters", read_pix4d, write_pix4d, "grid"
        ),
        OrientationFormat("opf", "Open Photogrammetry Format", read_opf, write_opf, "grid"),
        OrientationFormat(
            "opensfm", "OpenSfM reconstruction.json", read_opensfm_orientations, write_opensfm, "opensfm"
        ),
        OrientationFormat("colmap-text", "COLMAP model as text", read_colmap, write_colmap),
        OrientationFormat(
            "colmap-binary", "COLMAP model, binary", read_colmap, partial(write_colmap, binary=True)
        ),
        OrientationFormat("micmac", "MicMac Ori folder", read_micmac, write_micmac),
        OrientationFormat("exif", "EXIF and XMP of drone photographs", read_exif_orientations, None),
    )
}


@dataclass(frozen=True)
class Conversion:
    """What a conversion did: the written orientations, and what it assumed in sentences."""

    written: OrientationSet
    notes: tuple[str, ...]


def format_named(name: str, field: str) -> OrientationFormat:
    """A format by its name.

    Raises
    ------
    FormatError
        If there is none of that name; the names are listed.
    """
    if name not in FORMATS:
        raise FormatError(f"must be one of {', '.join(FORMATS)}", field=field, value=name)
    return FORMATS[name]


def convert_orientation(
    source: str | Path,
    target: str | Path,
    source_format: str,
    target_format: str,
    declared: Declared | None = None,
    wanted: Declared | None = None,
    grid_reference_heights: tuple[float | None, float | None] = (None, None),
) -> Conversion:
    """Convert a file of orientations to another format, frame or axes.

    Parameters
    ----------
    source, target : path
        Files, or folders for formats that are folders.
    source_format, target_format : str
        Names in `FORMATS`.
    declared, wanted : Declared
        About the source, and about the result. A CRS, heights or axes that are not wanted stay as they are.
    grid_reference_heights : (float or None, float or None)
        Of the source: its centres were adjusted in the grid, with control at this height; true positions are
        made of them. Of the result: it shall hold such centres.

    Raises
    ------
    FormatError, OrientationError, CrsError, HeightSystemError
        If the source is malformed or ambiguous, or the result cannot be made; the message names the file
        and, where something is to be declared, the possibilities.
    StorageError
        If the result cannot be written.
    """
    reading, writing = format_named(source_format, "--from"), format_named(target_format, "--to")
    declared, wanted = declared or Declared(), wanted or Declared()
    if writing.write is None:
        raise FormatError("can only be read", field="--to", value=target_format)
    orientations = reading.read(Path(source), declared)
    _check_place(orientations, source)
    if grid_reference_heights[0] is not None:
        orientations = space_from_grid(orientations, grid_reference_heights[0])
    place, axes = _target(orientations, writing, wanted, Path(target))
    result = converted(orientations, place, axes)
    _check_place(result, target)
    if grid_reference_heights[1] is not None:
        result = grid_from_space(result, grid_reference_heights[1])
    said = writing.write(Path(target), result, wanted)
    notes = (*result.notes, *(f"{Path(target).name}: {note}" for note in said))
    return Conversion(result, notes)


def _check_place(orientations: OrientationSet, path: str | Path) -> None:
    if isinstance(orientations.place, MapFrame):
        check_coordinates(orientations.place, orientations.positions, "projection centres", path)


def _target(
    source: OrientationSet, format_: OrientationFormat, wanted: Declared, path: Path
) -> tuple[Place, AttitudeAxes]:
    """Frame and axes of the result: what is wanted, else those of the source, as far as the format holds
    them."""
    place = _target_place(source, wanted)
    if format_.holds == "geocentric":
        if not isinstance(place, GeocentricFrame):
            place = GeocentricFrame(datum_of(place).crs)
        return place, "geocentric"
    grid = isinstance(place, MapFrame) and not place.is_geographic
    if format_.holds == "grid" and not grid:
        rule = f"holds map coordinates, not {describe_place(place)}"
        raise FormatError(rule, file=path, field=format_.name, hint="declare the map CRS of the result")
    usual = axes_of_place(place)
    axes = wanted.axes or (source.axes if source.axes in usual else usual[0])
    if format_.holds == "grid":
        return place, "grid"
    if format_.holds == "opensfm":
        return place, "grid_east_north" if grid else "tangent"
    return place, axes


def _target_place(source: OrientationSet, wanted: Declared) -> Place:
    place = wanted.place()
    here = source.place
    if place is None and isinstance(here, MapFrame) and wanted.heights is not None:
        return MapFrame(here.crs, wanted.heights)
    if place is None:
        return here
    if isinstance(place, MapFrame) and isinstance(here, MapFrame) and wanted.heights is None:
        # Heights that nobody asks to change stay in their system.
        return MapFrame(place.crs, here.heights) if place.heights.kind == "undeclared" else place
    return place
