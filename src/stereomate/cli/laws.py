"""`stereomate laws`: what each parallax law means for a block, and which one to take."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from stereomate.cli.output import console, print_json, table
from stereomate.cli.settings import Settings


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("laws")(_laws)


def _laws(
    context: typer.Context,
    project: Annotated[Path, typer.Argument(help="Project file.")],
    object_height: Annotated[
        float, typer.Option("--object-height", help="Of the objects whose reading is judged, metres.")
    ] = 20.0,
    pixel_mm: Annotated[float, typer.Option("--pixel-mm", help="Pixel on the screen.")] = 0.25,
    distance_mm: Annotated[float, typer.Option("--distance-mm", help="Eyes to screen.")] = 600.0,
    figure: Annotated[
        Path | None, typer.Option("--figure", help="Write a figure: .svg, .pdf or .png.")
    ] = None,
    fold_map: Annotated[
        Path | None,
        typer.Option("--fold-map", help="Write where each law folds: a GeoTIFF, a band for each law."),
    ] = None,
    write: Annotated[
        Path | None,
        typer.Option("--write", help="Write the fitted table: a CSV for products.law_table of a project."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Compare linear, logarithmic, natural and a fitted law over the area of a block; recommend one."""
    from stereomate.parallax.choice import Screen
    from stereomate.project import load
    from stereomate.project.run import RunOptions, plan
    from stereomate.stereo.choice import choose_law_of

    settings: Settings = context.obj
    screen = Screen(pixel_mm, distance_mm)
    _, jobs = plan(load(project, planned=True), RunOptions(threads=settings.threads))
    records = []
    for job in jobs:
        block, choice = choose_law_of(job, screen, object_height)
        if as_json:
            records.append(
                {
                    "product": job.name,
                    "recommended": choice.recommended.law.as_record(),
                    "reasons": choice.reasons,
                    "laws": choice.assessments,
                }
            )
        elif settings.verbosity >= 0:
            _print(job.name, choice, object_height)
        if write is not None:
            _write_table(
                choice, write if not job.name else write.with_stem(f"{write.stem}_{job.name}"), as_json
            )
        if fold_map is not None:
            name = fold_map if not job.name else fold_map.with_stem(f"{fold_map.stem}_{job.name}")
            _write_fold_map(job, choice, name, settings.threads, as_json)
        if figure is not None:
            name = figure if not job.name else figure.with_stem(f"{figure.stem}_{job.name}")
            _draw(job, block, choice, name)
            if not as_json:
                typer.echo(f"figure: {name}")
    if as_json:
        print_json(records)


def _print(name: str, choice: Any, object_height: float) -> None:
    heads = (
        "law", "parallax px", "range px", "degrees", "h per px m", "folds from", "folded", "error mean",
        "rms", "largest", "within 5 %",
    )  # fmt: skip
    rows = []
    for a in choice.assessments:
        rows.append(
            [
                a.law.kind + (" *" if a is choice.recommended else ""),
                f"{a.parallax_px[0]:.0f} … {a.parallax_px[1]:.0f}",
                f"{a.range_px:.0f}",
                f"{a.range_deg:.2f}" + ("" if a.comfortable else " !"),
                f"{a.height_per_pixel_m[0]:.2f} … {a.height_per_pixel_m[1]:.2f}",
                f"{a.limit_slope:.2f}",
                f"{a.folded:.2%}",
                f"{a.error_mean:+.1%}",
                f"{a.error_rms:.1%}",
                f"{a.error_max:+.1%}",
                f"{a.within_5_percent:.0%}",
            ]
        )
    out = console()
    title = f"Laws for product {name}" if name else "Laws"
    out.print(table(f"{title}; errors of {object_height:g} m objects on level ground", heads, rows))
    out.print(f"* recommended: {choice.recommended.law.kind}", highlight=False)
    for reason in choice.reasons:
        out.print(f"- {reason}", highlight=False)


def _write_table(choice: Any, path: Path, quiet: bool) -> None:
    from stereomate.formats.law_table import write_law_table

    fitted = next(a.law for a in choice.assessments if a.law.kind == "table")
    write_law_table(path, fitted)
    if not quiet:
        typer.echo(f'fitted table: {path}; in the project file: law = "table", law_table = "{path.name}"')


def _write_fold_map(job: Any, choice: Any, path: Path, threads: int, quiet: bool) -> None:
    from stereomate.stereo.fold_map import write_fold_map

    found = write_fold_map(job, [a.law for a in choice.assessments], path, threads=threads)
    if not quiet:
        shares = ", ".join(
            f"{kind} {share:.2%} (steepest {found.steepest[kind]:.2f})"
            for kind, share in found.folded.items()
        )
        typer.echo(f"fold map, cells of {found.cell:g}: {path}; folded: {shares}")


def _draw(job: Any, block: Any, choice: Any, path: Path) -> None:
    from stereomate.report.overcorrection_style import save_figure
    from stereomate.report.stereo_homogeneity import draw_laws

    samples = block.samples
    fold = block.raster(choice.recommended.law.slope(samples.heights_m) * samples.slopes)
    width, height = (n * job.grid.gsd * job.frame.unit_m * 1e-3 for n in job.grid.size)
    heights = float(samples.heights_m.min()), float(samples.heights_m.max())
    save_figure(draw_laws(choice, heights, fold, (0.0, width, 0.0, height)), path)
