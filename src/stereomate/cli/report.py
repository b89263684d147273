"""`stereomate report`: what a run says of itself, in the terminal, as JSON or as PDF."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from stereomate.cli.output import console, print_json, table
from stereomate.cli.settings import Settings


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("report")(_report)


def _report(
    context: typer.Context,
    out: Annotated[Path, typer.Argument(help="Folder of a run.")],
    pdf: Annotated[Path | None, typer.Option("--pdf", help="Print the report to this file.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print report.json.")] = False,
) -> None:
    """Summary of a run: requirements and whether they are kept, products, what was assumed."""
    from stereomate.project.run_record import read_run_record
    from stereomate.report.pdf import write_pdf

    settings: Settings = context.obj
    record = read_run_record(out / "report.json")
    if pdf is not None:
        write_pdf(out / "report.html", pdf)
    if as_json:
        print_json(record)
    elif settings.verbosity >= 0:
        _print(record)
        if pdf is not None:
            typer.echo(f"report: {pdf}")


def _print(record: dict[str, Any]) -> None:
    rows = [("project", record["project"]), ("map", record["crs"]), ("heights", record["heights"])]
    rows += [("photographs", f"{len(record['photographs'])} used, {len(record['left_out'])} left out")]
    for product in record["products"]:
        cols, lines = product["size"]
        name = product["name"] or "product"
        rows.append((name, f"{cols} x {lines} pixels of {product['gsd']:g}, {product['ortho']}"))
    for asked in record["accuracy"]["requirements"]:
        found = "not measured" if asked["found"] is None else f"{asked['found']:.3g} {asked['unit']}"
        wanted = f"{asked['requested']:g} {asked['unit']}"
        rows.append((asked["requirement"], f"{asked['verdict']}: {found}, requested {wanted}"))
    checked = record["accuracy"]["check_points"]
    if checked is not None:
        rows += [("", sentence) for sentence in checked["accuracy"]["asprs_2023"].values()]
    console().print(table("Report", ("", ""), rows, left=(0, 1)))
