"""`stereomate interior`: fiducial marks of film and interior orientation of its scans."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stereomate.cli.output import console, print_json, table
from stereomate.cli.progress import progress_of
from stereomate.cli.settings import Settings

if TYPE_CHECKING:
    from stereomate.project.interior import Scan


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("interior")(_interior)


def _interior(
    context: typer.Context,
    project: Annotated[Path, typer.Argument(help="A project file with a [camera.fiducials].")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder of the results [default: beside the project].")
    ] = None,
    residuals: Annotated[
        bool, typer.Option("--residuals", help="Print transformation and residuals of every mark.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Find the fiducial marks of film in its scans, and orient the scans by them.

    Writes interior.csv, which `measured` of [camera.fiducials] names, and interior.json.
    """
    from stereomate.project.interior import interior_of_project, write_interior

    settings: Settings = context.obj
    with progress_of(settings, as_json) as progress:
        scans = interior_of_project(project, lambda done, total: progress("fiducial marks", done, total))
    marks, _ = write_interior(scans, out if out is not None else project.parent)
    if as_json:
        print_json([scan.as_record() for scan in scans])
    elif settings.verbosity >= 0:
        _print(scans, marks)
        if residuals:
            for scan in scans:
                _print_residuals(scan)


def _print(scans: list[Scan], marks: Path) -> None:
    out = console()
    heads = (
        "photograph", "marks", "missing", "lies", "pitch, µm", "rms x, y, µm", "largest, µm", "σ0",
    )  # fmt: skip
    rows = []
    for scan in scans:
        found = scan.interior
        if found is None:
            rows.append(
                (scan.photo.name, str(len(scan.marks)), ", ".join(scan.missing), "-", "-", "-", "-", "-")
            )
            continue
        turned = f"{found.rotation}°" + (", mirrored" if found.mirrored else "")
        if scan.others:
            turned += f" (or {len(scan.others)} others)"
        largest = max(range(len(found.names)), key=lambda k: float(abs(found.residuals_mm[k]).max()))
        x, y = found.rms_mm
        sigma0 = found.summary.sigma0
        rows.append(
            (
                scan.photo.name,
                str(len(scan.marks)),
                ", ".join(scan.missing) or "-",
                turned,
                f"{1e3 * found.pitch_mm:.3f}",
                f"{1e3 * x:.1f}, {1e3 * y:.1f}",
                f"{1e3 * float(abs(found.residuals_mm[largest]).max()):.1f} ({found.names[largest]})",
                f"{sigma0:.2f}" if found.summary.redundancy else "-",
            )
        )
    out.print(table("Interior orientation", heads, rows))
    for scan in scans:
        if scan.problem:
            out.print(f"- {scan.photo.name}: {scan.problem}", markup=False)
        elif scan.others:
            out.print(
                f"- {scan.photo.name}: the pictures of the marks do not tell how the film lies; rotation and "
                "mirrored of the camera settle it",
                markup=False,
            )
    out.print(f'Marks are in {marks}: measured = "{marks.name}" in [camera.fiducials]', markup=False)


def _print_residuals(scan: Scan) -> None:
    """The transformation from pixels (rows downwards) to the photo system, and what it leaves of marks."""
    found = scan.interior
    if found is None:
        return
    out = console()
    rows: list[tuple[str, ...]] = []
    for name, (dx, dy) in zip(found.names, found.residuals_mm.tolist(), strict=True):
        x, y = found.photo_from_pixel.apply(scan.marks[name][:2]).tolist()
        rows.append((name, f"{x + dx:.3f}", f"{y + dy:.3f}", f"{dx:+.4f}", f"{dy:+.4f}"))
    rows.append(("rms", "", "", *(f"{v:.4f}" for v in found.rms_mm)))
    heads = ("mark", "x, mm", "y, mm", "residual x, mm", "residual y, mm")
    out.print(table(f"{scan.photo.name}: {found.photo_from_pixel.kind}", heads, rows))
    for label, values in zip(("x", "y", "divisor"), found.photo_from_pixel.matrix, strict=True):
        if label != "divisor" or values[:2] != (0.0, 0.0):
            a, b, c = values
            out.print(f"  {label} = {a:+.10f} column {b:+.10f} row {c:+.6f}", markup=False)
