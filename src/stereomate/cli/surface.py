"""`stereomate surface`: surface and terrain model of oriented photographs by dense matching."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stereomate.cli.logs import log_to_file
from stereomate.cli.output import console, print_json, table
from stereomate.cli.progress import progress_of
from stereomate.cli.settings import Settings

if TYPE_CHECKING:
    from stereomate.project.own_surface import OwnSurface


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("surface")(_surface)


def _surface(
    context: typer.Context,
    project: Annotated[Path, typer.Argument(help="A project file with orientation.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder of the results [default: surface beside it].")
    ] = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Forget what an earlier run left.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Match a surface and a terrain model from oriented photographs. A run that was killed goes on."""
    from stereomate.project.own_surface import make_own_surface

    settings: Settings = context.obj
    folder = out if out is not None else project.parent / "surface"
    with log_to_file(folder / "surface.log"), progress_of(settings, as_json) as progress:
        made = make_own_surface(project, folder, settings.threads, fresh, progress)
    if as_json:
        print_json(made.record)
    elif settings.verbosity >= 0:
        _print_summary(made)


def _print_summary(made: OwnSurface) -> None:
    out, record = console(), made.record
    if made.up_to_date:
        out.print(f"{made.out} is up to date; --fresh makes it anew")
    rows = [
        ("pairs matched", str(len(record["pairs"]))),
        ("cells measured, filled", f"{record['measured_cells']}, {record['filled_cells']}"),
        ("of one pair only", str(record["cells_of_one_pair"])),
        ("cell of surface, terrain", f"{record['cell']:g}, {record['terrain_cell']:g}"),
        ("standard deviation, mean", _text(record["sigma_mean"])),
        ("ground", f"{100.0 * record['ground_share']:.0f} %"),
        ("largest y-parallax of a pair", f"{_largest(record):.2f} px of the reduced photographs"),
    ]
    out.print(table(f"Surface in {made.out}", ("", ""), rows))
    out.print(f"Go on with: stereomate run {made.project_file}", markup=False)


def _text(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _largest(record: dict[str, list[dict[str, float | None]]]) -> float:
    return max((abs(pair["y_parallax_px"] or 0.0) for pair in record["pairs"]), default=0.0)
