"""`stereomate check`: everything that can be said about a project without computing it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stereomate.cli.output import print_json

if TYPE_CHECKING:
    from rich.console import Console

    from stereomate.project.check import CheckReport

# Rows of a table before it only counts the rest.
_ROWS = 40


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    app.command("check")(_check)


def _check(
    project: Annotated[Path, typer.Argument(help="The project file.")],
    json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
    strict: Annotated[
        bool, typer.Option("--strict", help="One photograph that cannot take part is an error.")
    ] = False,
) -> None:
    """Validate a project without computing it, and say what `run` will make.

    Exit code 0: nothing wrong; 2: something is, and it is said what.
    """
    from stereomate.project import load
    from stereomate.project.check import check_project

    report = check_project(load(project, strict=strict or None))
    if json:
        print_json({**_as_dict(report), "good": report.is_good})
    else:
        _print(report)
    if not report.is_good:
        for problem in report.problems:
            typer.echo("error: " + " ".join(problem.split()), err=True)
        raise typer.Exit(2)


def _as_dict(report: CheckReport) -> dict[str, object]:
    from dataclasses import fields

    return {field.name: getattr(report, field.name) for field in fields(report)}


def _print(report: CheckReport) -> None:
    from stereomate.cli.output import console

    out = console()
    out.print(f"[bold]{report.project}[/bold]  {report.file}", highlight=False)
    out.print(f"{report.crs}; {report.heights}", highlight=False)
    _print_photographs(out, report)
    _print_pairs(out, report)
    _print_terrain(out, report)
    _print_products(out, report)
    for title, lines, style in (("Notes", report.notes, "dim"), ("Warnings", report.warnings, "yellow")):
        if lines:
            out.print(f"[bold]{title}[/bold]")
            for line in lines:
                out.print(f"  • {line}", style=style, highlight=False)
    if report.comparison is not None and report.comparison.is_same:
        out.print(report.comparison.sentence, highlight=False)


def _print_photographs(out: Console, report: CheckReport) -> None:
    from stereomate.cli.output import table

    rows = [
        (
            row.name,
            f"{row.size_px[0]} x {row.size_px[1]}",
            f"{row.bands} {row.dtype}",
            row.camera,
            f"{row.gsd_m:.3g}",
            f"{row.height_above_ground_m:.0f}",
            f"{row.tilt_deg:.1f}",
            f"{row.covered:.0%}",
        )
        for row in report.photographs
    ]
    heads = (
        "photograph",
        "pixels",
        "bands",
        "camera",
        "GSD m",
        "above ground m",
        "tilt °",
        "on height model",
    )
    out.print(table("Photographs", heads, rows[:_ROWS], left=(0, 3), rest=len(rows) - _ROWS))


def _print_pairs(out: Console, report: CheckReport) -> None:
    from stereomate.cli.output import table

    rows = [
        (
            row.first,
            row.second,
            f"{row.overlap:.0%}",
            f"{row.base_m:.1f}",
            f"{row.base_height:.2f}",
            f"{row.azimuth_deg:.1f}",
            "yes" if row.serves else "no",
            "-" if row.factors is None else " / ".join(_factor(n) for n in row.factors),
            "-" if row.strength is None else f"{row.strength:.2g}",
            row.geometry or "-",
        )
        for row in report.pairs
    ]
    heads = (
        "pair",
        "",
        "overlap",
        "base m",
        "base/height",
        "azimuth °",
        "serves",
        "over-correction n",
        "strength",
        "geometry",
    )
    out.print(table("Pairs", heads, rows[:_ROWS], left=(0, 1, 9), rest=len(rows) - _ROWS))


def _factor(n: float) -> str:
    return "±∞" if math.isinf(n) else f"{n:.1f}"


def _print_terrain(out: Console, report: CheckReport) -> None:
    from stereomate.cli.output import table

    row = report.terrain
    if row is None:
        return
    cells = (
        Path(row.file).name,
        row.crs,
        row.heights,
        f"{row.size[0]} x {row.size[1]}",
        f"{row.resolution_m:.3g}",
        f"{row.lowest:.1f} to {row.highest:.1f}",
        f"{row.covered:.0%}",
    )
    heads = ("file", "CRS", "heights", "nodes", "step m", "range m", "of the photographs")
    out.print(table("Height model", heads, [cells], left=(0, 1, 2)))


def _print_products(out: Console, report: CheckReport) -> None:
    from stereomate.cli.output import table

    rows = []
    for row in report.products:
        law = "-"
        if row.base_m is not None:
            law = f"{row.law}: B {row.base_m:.1f}, w0 {row.w0_m:.1f}, reference {row.reference_m:.1f} m"
        rows.append(
            (
                ", ".join(row.files),
                f"{row.size_px[0]} x {row.size_px[1]}",
                f"{row.gsd:g}",
                f"{row.rotation_deg:.1f}",
                f"{row.bands} {row.dtype}",
                str(row.models),
                law,
                f"{row.megabytes:,.0f} MB",
            )
        )
    heads = ("run will make", "pixels", "GSD", "turned °", "bands", "models", "parallax law", "uncompressed")
    if rows:
        out.print(table("Products", heads, rows, left=(0, 6)))
