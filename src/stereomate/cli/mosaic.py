"""`stereomate mosaic`: products made anew with edited seams."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from stereomate.cli.output import print_json
from stereomate.cli.progress import progress_of
from stereomate.cli.settings import Settings


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("mosaic")(_mosaic)


def _mosaic(
    context: typer.Context,
    source: Annotated[Path, typer.Argument(help="The folder of a run, or a project file.")],
    seams: Annotated[
        Path | None, typer.Option("--seams", help="Edited seams; without, they are found anew.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder of the products [default: that of the run].")
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option("--scheduler", help="Address of a Dask scheduler that runs the tiles.")
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Only say whether the seams fit, and make nothing.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print what was made as JSON.")] = False,
) -> None:
    """Make the products of a run anew with seams edited in a GIS (seams.gpkg of the run, changed)."""
    import time

    from stereomate.cli.logs import log_to_file
    from stereomate.cli.run import print_summary, write_documents
    from stereomate.project import load
    from stereomate.project.mosaic import edited_polygons, sources_of
    from stereomate.project.run import RunOptions, plan, run, summary_record

    started = time.monotonic()
    settings: Settings = context.obj
    project, folder, stereo = sources_of(source, out)
    loaded = load(project)
    options = RunOptions(threads=settings.threads, scheduler=scheduler, seams=seams, stereo=stereo)
    if seams is not None:
        # Errors in the seams are said before anything is computed.
        found = edited_polygons(seams, plan(loaded, options)[1])
        if check:
            _say(found, as_json)
            return
    with log_to_file(folder / "run.log"), progress_of(settings, as_json) as progress:
        result = run(loaded, folder, options, progress, lambda made: write_documents(made, started))
    if as_json:
        print_json(summary_record(result))
    elif settings.verbosity >= 0:
        print_summary(summary_record(result))


def _say(found: dict[str, tuple[tuple[int, object], ...]], as_json: bool) -> None:
    record = {name: len(polygons) for name, polygons in found.items()}
    if as_json:
        print_json({"polygons": record})
        return
    for name, count in record.items():
        typer.echo(f"product {name or '(first)'}: {count} polygons fit")
