"""`stereomate convert`: orientations between formats and frames, points from a tangent frame to the map."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stereomate.cli.output import console, print_json

if TYPE_CHECKING:
    from collections.abc import Mapping

    from stereomate.formats.declared import Declared

_HELP = "Convert orientations between formats and frames, and points between frames, exactly."
_FORMATS = (
    "table, ign-opk, orthority-csv, orthority-geojson, patb, metashape-xml, metashape-opk, pix4d, opf, "
    "opensfm, colmap-text, colmap-binary, micmac, exif (read only)"
)
_AXES = "What angles turn about: grid, grid_east_north, local, tangent or geocentric."
_HEIGHTS = "Height system: ellipsoidal, undeclared, a vertical CRS, or a geoid grid file."
_ORIGIN = "Coordinates are topocentric about lon,lat,height (--*-crs is then its datum)."
_OFFSET = "Added to the coordinates of the file to get those of its frame: x,y,z."
_TRIPLE = "X,Y,Z"
# Declarations whose options bear no side in their name.
_ELSEWHERE = {"from": "opensfm_frame", "to": "cameras"}

Crs = Annotated[str | None, typer.Option("--from-crs", help="CRS of the source, as EPSG:25832.")]
ToCrs = Annotated[str | None, typer.Option("--to-crs", help="CRS of the result [default: as the source].")]
Heights = Annotated[str | None, typer.Option("--from-heights", help=_HEIGHTS)]
ToHeights = Annotated[str | None, typer.Option("--to-heights", help=_HEIGHTS)]
Origin = Annotated[str | None, typer.Option("--from-origin", help=_ORIGIN, metavar="LON,LAT,H")]
ToOrigin = Annotated[str | None, typer.Option("--to-origin", help=_ORIGIN, metavar="LON,LAT,H")]
Offset = Annotated[str | None, typer.Option("--from-offset", help=_OFFSET, metavar=_TRIPLE)]
ToOffset = Annotated[str | None, typer.Option("--to-offset", help=_OFFSET, metavar=_TRIPLE)]
_GRID_SOURCE = "The centres were adjusted in the grid, with control at this height: make true positions."
_GRID_RESULT = "Write centres as an adjustment in the grid with control at this height gives them."
_CAMERAS = "TOML file with [[camera]] sections, for formats that hold cameras."
_ORDER = "Angles: opk (omega phi kappa), pok, rph (roll pitch heading)."
_COLUMNS = "Columns of a table without header: filename,x,y,..."
_BORESIGHT = "For rph: omega,phi,kappa."
Axes = Annotated[str | None, typer.Option("--from-axes", help=_AXES)]
ToAxes = Annotated[str | None, typer.Option("--to-axes", help=_AXES)]
Order = Annotated[str | None, typer.Option("--from-order", help=_ORDER)]
ToOrder = Annotated[str | None, typer.Option("--to-order", help="As --from-order.")]
Unit = Annotated[str | None, typer.Option("--from-unit", help="Unit of angles: deg, gon, rad, deg.mmss.")]
ToUnit = Annotated[str | None, typer.Option("--to-unit", help="As --from-unit.")]
Mount = Annotated[str | None, typer.Option("--from-mount", help="For rph: y_forward, x_forward, gimbal.")]
ToMount = Annotated[str | None, typer.Option("--to-mount", help="As --from-mount.")]
Boresight = Annotated[str | None, typer.Option("--from-boresight-deg", help=_BORESIGHT, metavar=_TRIPLE)]
Matrix = Annotated[
    str | None, typer.Option("--from-matrix", help="PATB: object_from_camera or camera_from_object.")
]
ToMatrix = Annotated[str | None, typer.Option("--to-matrix", help="As --from-matrix.")]
Columns = Annotated[str | None, typer.Option("--from-columns", help=_COLUMNS)]
OpenSfm = Annotated[
    str | None, typer.Option("--opensfm-frame", help="Of reconstruction.json: topocentric or projected.")
]
FromGridHeight = Annotated[float | None, typer.Option("--from-grid-reference-height", help=_GRID_SOURCE)]
ToGridHeight = Annotated[float | None, typer.Option("--to-grid-reference-height", help=_GRID_RESULT)]
Cameras = Annotated[Path | None, typer.Option("--cameras", help=_CAMERAS)]
Guessing = Annotated[
    bool, typer.Option("--guess", help="Try what is not declared against the points of --evidence.")
]
Evidence = Annotated[
    Path | None, typer.Option("--evidence", help="Project file with [observations]; implies --guess.")
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of sentences.")]


def register(app: typer.Typer) -> None:
    """Add the commands to the application."""
    convert = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help=_HELP)
    convert.command("orientation")(_orientation)
    convert.command("points")(_points)
    app.add_typer(convert, name="convert")


def _orientation(
    context: typer.Context,
    source: Annotated[Path, typer.Argument(help="File, or folder for formats that are folders.")],
    target: Annotated[Path, typer.Argument(help="File or folder to write.")],
    source_format: Annotated[str, typer.Option("--from", help=f"Format of the source: {_FORMATS}.")],
    target_format: Annotated[str, typer.Option("--to", help="Format of the result.")],
    from_crs: Crs = None,
    from_heights: Heights = None,
    from_origin: Origin = None,
    from_offset: Offset = None,
    from_axes: Axes = None,
    from_order: Order = None,
    from_unit: Unit = None,
    from_mount: Mount = None,
    from_boresight_deg: Boresight = None,
    from_matrix: Matrix = None,
    from_columns: Columns = None,
    opensfm_frame: OpenSfm = None,
    from_grid_reference_height: FromGridHeight = None,
    to_crs: ToCrs = None,
    to_heights: ToHeights = None,
    to_origin: ToOrigin = None,
    to_offset: ToOffset = None,
    to_axes: ToAxes = None,
    to_order: ToOrder = None,
    to_unit: ToUnit = None,
    to_mount: ToMount = None,
    to_matrix: ToMatrix = None,
    to_grid_reference_height: ToGridHeight = None,
    cameras: Cameras = None,
    guess: Guessing = False,
    evidence: Evidence = None,
    json: Json = False,
) -> None:
    """Convert orientations between formats, frames and axes, and say what was assumed.

    What a file does not say (CRS, axes and unit of its angles) has to be declared; without it the command
    names the possibilities and stops. With --guess they are tried against the tie and control points of a
    project, and what fits is used and said; what fits equally well is still refused.
    """
    from stereomate.formats.exchange import convert_orientation, format_named

    format_named(source_format, "--from")
    format_named(target_format, "--to")
    declared, wanted = _declared("from", context.params), _declared("to", context.params)
    height = from_grid_reference_height
    notes: tuple[str, ...] = ()
    if guess or evidence is not None:
        declared, height, notes = _guessed(source, source_format, declared, height, evidence)
    heights = (height, to_grid_reference_height)
    result = convert_orientation(source, target, source_format, target_format, declared, wanted, heights)
    notes = (*notes, *result.notes)
    count = len(result.written.names)
    if json:
        print_json({"source": source, "target": target, "photographs": count, "notes": notes})
        return
    _say(f"{target}: {count} orientations", notes)


def _guessed(
    source: Path, source_format: str, declared: Declared, height: float | None, evidence: Path | None
) -> tuple[Declared, float | None, tuple[str, ...]]:
    """Declarations and reference height completed by the points of a project, and what was guessed."""
    from stereomate.errors import InputError
    from stereomate.project.guess import guess_declared

    if evidence is None:
        raise InputError(
            "must be given with --guess: a project file whose [observations] decide", field="--evidence"
        )
    found = guess_declared(source, source_format, declared, evidence)
    return found.declared, height if height is not None else found.grid_reference_height, found.notes


def _points(
    context: typer.Context,
    source: Annotated[Path, typer.Argument(help="Points: .csv .txt .xyz .las .laz .obj .ply.")],
    target: Annotated[Path, typer.Argument(help="File to write, of the same kind.")],
    from_crs: Crs = None,
    from_heights: Heights = None,
    from_origin: Origin = None,
    from_offset: Offset = None,
    to_crs: ToCrs = None,
    to_heights: ToHeights = None,
    to_origin: ToOrigin = None,
    to_offset: ToOffset = None,
    columns: Annotated[
        str | None, typer.Option("--columns", help="Of text: columns of x,y,z from 1.", metavar=_TRIPLE)
    ] = None,
    json: Json = False,
) -> None:
    """Move points, point clouds and meshes from one frame to another, each point exactly.

    The rigorous replacement for an export with one matrix, which is wrong by 0.3 m in height at 2 km from
    the origin and by 2 m at 5 km.
    """
    from stereomate.errors import InputError
    from stereomate.formats.point_exchange import convert_points
    from stereomate.formats.point_move import PointMove

    declared, wanted = _declared("from", context.params), _declared("to", context.params)
    here, there = declared.require_place(source), wanted.place()
    if there is None:
        raise InputError("must be given, or --to-origin", field="--to-crs")
    places = None if columns is None else [int(value) for value in _triple(columns, "--columns")]
    if places is not None and min(places) < 1:
        raise InputError("must be counted from 1", field="--columns", value=columns)
    move = PointMove(here, there, declared.offset, wanted.offset)
    result = convert_points(source, target, move, places)
    if json:
        print_json({"source": source, "target": target, "points": result.count, "notes": result.notes})
        return
    _say(f"{target}: {result.count} points", result.notes)


def _declared(side: str, options: Mapping[str, Any]) -> Declared:
    """Declarations of one side from the options; a wrong choice is reported with the option's name."""
    from stereomate.errors import InputError
    from stereomate.formats.declared import Declared

    given = {
        key.removeprefix(f"{side}_"): (f"--{key.replace('_', '-')}", value)
        for key, value in options.items()
        if value is not None and (key.startswith(f"{side}_") or key == _ELSEWHERE[side])
    }
    given.pop("grid_reference_height", None)
    values = {key: _declaration(key, value, option) for key, (option, value) in given.items()}
    if "heights" in values and "origin" in values:
        option, text = given["heights"]
        rule = "have no meaning with an origin: topocentric coordinates have no height system"
        raise InputError(rule, field=option, value=text)
    return Declared(**values)


def _declaration(key: str, value: Any, option: str) -> Any:
    """One declaration as a value."""
    from stereomate.formats.declared import check_choice

    if key in ("origin", "offset", "boresight_deg"):
        return _triple(value, option)
    if key == "heights":
        return _heights(value, option)
    if key == "columns":
        return [cell.strip() for cell in value.split(",")]
    if key == "cameras":
        from stereomate.project.cameras import load_cameras

        return {camera.name: camera for camera in load_cameras(value)}
    check_choice(key, value, option)
    return value


def _heights(text: str, option: str) -> Any:
    from stereomate.errors import InputError
    from stereomate.frames.heights import HeightSystem

    try:
        return HeightSystem.from_text(text)
    except InputError as error:
        raise type(error)(error.rule, field=option, value=text, hint=error.hint) from error


def _triple(text: str, option: str) -> tuple[float, float, float]:
    from stereomate.errors import InputError

    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError("must be three numbers with commas", field=option, value=text) from None
    return x, y, z


def _say(first: str, notes: tuple[str, ...]) -> None:
    out = console()
    out.print(first, highlight=False, markup=False)
    for note in notes:
        out.print(f"- {note}", highlight=False, markup=False)
