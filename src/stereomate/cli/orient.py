"""`stereomate orient`: orientation of raw photographs, with its accuracy."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stereomate.cli.logs import log_to_file
from stereomate.cli.output import console, print_json, table
from stereomate.cli.progress import progress_of
from stereomate.cli.settings import Settings

if TYPE_CHECKING:
    from stereomate.project.orient import OrientResult


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("orient")(_orient)


def _orient(
    context: typer.Context,
    project: Annotated[Path, typer.Argument(help="The project file.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder of the results [default: orient beside it].")
    ] = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Forget what an earlier run left.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Orient photographs: tie points, bundle adjustment, accuracy. A run that was killed goes on."""
    from stereomate.project.orient import OrientOptions, orient

    settings: Settings = context.obj
    folder = out if out is not None else project.parent / "orient"
    with log_to_file(folder / "orient.log"), progress_of(settings, as_json) as progress:
        options = OrientOptions(threads=settings.threads, fresh=fresh)
        result = orient(project, folder, options, progress, write_documents)
    if as_json:
        print_json(result.record)
    elif settings.verbosity >= 0:
        _print_summary(result)


def write_documents(result: OrientResult) -> list[Path]:
    """Write the report."""
    from stereomate.project.orient_report import write_orient_report

    return [write_orient_report(result)]


def _print_summary(result: OrientResult) -> None:
    out = console()
    record = result.record
    if result.up_to_date:
        out.print(f"{result.out} is up to date; --fresh makes it anew")
    summary = record["summary"]
    rms = summary["image_rms_px"]
    rows = [
        ("photographs oriented", f"{summary['oriented']} of {summary['photographs']}"),
        ("tie points, image points", f"{summary['tie_points']}, {summary['image_points']}"),
        ("image residuals, rms", f"{rms['columns']:.2f}, {rms['rows']:.2f} px (columns, rows)"),
        (
            "σ0 a posteriori",
            f"{summary['sigma0']:.3f} (redundancy {summary['redundancy']})",
        ),
        ("gross errors taken out", str(summary["gross_errors"])),
    ]
    positions: dict[str, Any] | None = record["positions"]
    if positions is not None:
        x, y, z = positions["rms_m"]
        rows.append(("residuals of positions, rms", f"{x:.2f}, {y:.2f}, {z:.2f} m ({positions['source']})"))
    for kind, values in (record["control"] or {}).items():
        if values["count"]:
            rms_m = ", ".join("-" if v is None else f"{v:.3f}" for v in values["rms_m"])
            rows.append((f"{values['count']} {kind} points, rms", f"{rms_m} m"))
    out.print(table(f"Orientation in {result.out}", ("", ""), rows))
    for finding in record["findings"]:
        out.print(f"- {finding}", markup=False)
    for left in record["not_oriented"]:
        out.print(f"- not oriented: {left['name']}: {left['reason']}", markup=False)
    out.print(f"Open {result.out}/orient.html")
