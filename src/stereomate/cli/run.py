"""`stereomate run`: orthophoto, stereomate, lineage and report of a project."""

from __future__ import annotations

import importlib
import logging
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stereomate.cli.logs import log_to_file
from stereomate.cli.output import console, print_json
from stereomate.cli.progress import progress_of
from stereomate.cli.settings import Settings

if TYPE_CHECKING:
    from stereomate.project.run import ProgressSink, RunResult

LOG = logging.getLogger(__name__)


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("run")(_run)


def _run(
    context: typer.Context,
    project: Annotated[Path, typer.Argument(help="The project file.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the products.")],
    pair: Annotated[
        tuple[str, str] | None, typer.Option("--pair", help="Names of two photographs: this model alone.")
    ] = None,
    ortho_only: Annotated[bool, typer.Option("--ortho-only", help="Orthophoto without stereomate.")] = False,
    scheduler: Annotated[
        str | None, typer.Option("--scheduler", help="Address of a Dask scheduler that runs the tiles.")
    ] = None,
    strict: Annotated[bool, typer.Option("--strict", help="One bad photograph stops the run.")] = False,
    fresh: Annotated[bool, typer.Option("--fresh", help="Forget what an earlier run left.")] = False,
    no_agreement: Annotated[
        bool, typer.Option("--no-agreement", help="Do not measure how well left and right agree.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print what was made as JSON.")] = False,
) -> None:
    """Make orthophoto and stereomate of a project. A run that was killed goes on where it stopped.

    Photographs without orientation are oriented first, as by `stereomate orient`; without a height model one
    is matched from them, as by `stereomate surface`.
    """
    from stereomate.project import load
    from stereomate.project.loader import named_pair
    from stereomate.project.run import RunOptions, run, summary_record

    started = time.monotonic()
    settings: Settings = context.obj
    loaded = load(_with_heights(project, out, settings, fresh, as_json), strict=strict or None)
    options = RunOptions(
        threads=settings.threads,
        scheduler=scheduler,
        pairs=None if pair is None else (named_pair(pair, loaded.survey, project, "--pair"),),
        stereo=not ortho_only,
        agreement=not no_agreement,
        fresh=fresh,
        strict=strict,
    )
    with log_to_file(out / "run.log"), progress_of(settings, as_json) as progress:
        result = run(
            loaded, out, options, _with_documents_ahead(progress), lambda made: write_documents(made, started)
        )
    if as_json:
        print_json(summary_record(result))
    elif settings.verbosity >= 0:
        print_summary(summary_record(result))


def _with_heights(project: Path, out: Path, settings: Settings, fresh: bool, as_json: bool) -> Path:
    """The project file, or that of the oriented photographs with their own height model where it has none."""
    from stereomate.project.reading import read_project_file

    oriented = _oriented(project, out, settings, fresh, as_json)
    file = read_project_file(project)
    if file.has_ground or (file.terrain is not None and oriented == project):
        return oriented
    from stereomate.errors import NotDeterminedError
    from stereomate.project.own_surface import make_own_surface, words

    folder = out / "surface"
    with log_to_file(folder / "surface.log"), progress_of(settings, as_json) as progress:
        try:
            made = make_own_surface(oriented, folder, settings.threads, fresh, progress)
        except NotDeterminedError as error:
            if oriented == project:
                raise
            LOG.warning("%s: products are made on the surface through the tie points", error)
            return oriented
    if settings.verbosity >= 0 and not as_json:
        console().print(words(made.record), markup=False)
    return made.project_file


def _oriented(project: Path, out: Path, settings: Settings, fresh: bool, as_json: bool) -> Path:
    """The project file, or that of the oriented photographs where it has no orientation yet."""
    from stereomate.project.reading import read_project_file

    if read_project_file(project).photos.orientation:
        return project
    from stereomate.cli.orient import write_documents as write_orient_documents
    from stereomate.errors import NotDeterminedError
    from stereomate.project.orient import OrientOptions, orient

    folder = out / "orient"
    with log_to_file(folder / "orient.log"), progress_of(settings, as_json) as progress:
        options = OrientOptions(threads=settings.threads, fresh=fresh)
        result = orient(project, folder, options, progress, write_orient_documents)
    if result.project_file is None:
        raise NotDeterminedError(
            "the photographs are oriented to each other, but nothing says where they are: products need "
            "positions or control points"
        )
    return result.project_file


def _with_documents_ahead(progress: ProgressSink) -> ProgressSink:
    """The same sink. When the first rasters are assembled, the report's libraries begin to load beside it.

    Not earlier: they take memory that the tiles need first. Assembly copies and hashes, and leaves the
    interpreter to them.
    """
    loading = threading.Thread(target=importlib.import_module, args=("stereomate.project.documents",))

    def sink(stage: str, done: int, total: int) -> None:
        if stage.startswith("assembly") and loading.ident is None:
            loading.start()
        progress(stage, done, total)

    return sink


def write_documents(result: RunResult, started: float) -> list[Path]:
    """Write what lies beside the rasters of a run."""
    from stereomate.project import documents

    return documents.write_documents(result, started)


def print_summary(summary: dict[str, object]) -> None:
    """Print what a run made as a table."""
    from rich.console import Console
    from rich.table import Table

    console = Console()
    if summary["up_to_date"]:
        console.print(f"{summary['out']} is up to date; --fresh makes it anew")
        return
    table = Table(title=f"Products in {summary['out']}")
    for heading in ("product", "pixels", "GSD", "models", "x-parallax minus q(h), px", "y-parallax, px"):
        table.add_column(heading)
    products = summary["products"]
    assert isinstance(products, list)
    for product in products:
        agreement = (product["agreement"] or {}).get("orthophoto_against_stereomate")
        table.add_row(
            ", ".join(product["files"]),
            "{} x {}".format(*product["size"]),
            f"{product['gsd']:g}",
            str(product["models"]),
            _median_nmad(agreement, 0),
            _median_nmad(agreement, 1),
        )
    console.print(table)
    console.print(f"Open {summary['out']}/report.html")


def _median_nmad(agreement: dict[str, tuple[float, float]] | None, axis: int) -> str:
    if agreement is None or not agreement["count"]:
        return "not measured"
    return f"{agreement['median_px'][axis]:+.3f} ± {agreement['nmad_px'][axis]:.3f}"
