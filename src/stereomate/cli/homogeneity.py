"""`stereomate homogeneity`: Table 1 and Fig. 2 of Jachimski's paper, and the map of a real block."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stereomate.cli.output import console, print_json, table
from stereomate.cli.progress import ProgressSink, progress_of
from stereomate.cli.settings import Settings
from stereomate.errors import InputError

if TYPE_CHECKING:
    from stereomate.parallax.homogeneity import TableRow
    from stereomate.rectify.job import RectifyJob
    from stereomate.stereo.homogeneity_summary import HomogeneitySummary


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("homogeneity")(_homogeneity)


def _homogeneity(
    context: typer.Context,
    what: Annotated[
        str, typer.Argument(metavar="PROJECT|table|diagram", help="A project file, or table, or diagram.")
    ],
    object_height: Annotated[
        str, typer.Option("--object-height", help="Of the map: heights of objects in metres.")
    ] = "5,10,20",
    resolution: Annotated[
        float | None,
        typer.Option("--resolution", help="Pixel of the map, map units [default: of the height model]."),
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the maps; file of the diagram.")] = Path(
        "homogeneity"
    ),
    slopes: Annotated[
        str, typer.Option("--slopes", help="Of table and diagram: along and across the base, degrees.")
    ] = "20,30",
    law: Annotated[
        str, typer.Option("--law", help="Of table and diagram: logarithmic, linear, natural or none.")
    ] = "logarithmic",
    case: Annotated[
        list[str] | None,
        typer.Option(
            "--case", metavar="C,FORMAT,LEVEL,OBJECT", help="Line of the table [default: the paper's]."
        ),
    ] = None,
    figure: Annotated[
        Path | None, typer.Option("--figure", help="Of the diagram: .svg, .pdf or .png.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """How wrongly objects on slopes are read through the law of a stereo-orthophoto."""
    settings: Settings = context.obj
    if what == "table":
        _table(case, _numbers(slopes, "--slopes", 2), law, as_json)
    elif what == "diagram":
        drawn = out if out.suffix else Path("homogeneity.svg")
        _diagram(figure or drawn, _numbers(slopes, "--slopes", 2), law)
    else:
        heights = _numbers(object_height, "--object-height")
        with progress_of(settings, as_json) as progress:
            found = _maps(Path(what), heights, resolution, out, settings.threads, progress)
        if as_json:
            print_json([{"product": name, **summary.as_record()} for name, summary in found])
        elif settings.verbosity >= 0:
            _print_maps(found, out)


def _numbers(text: str, option: str, count: int | None = None) -> list[float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if not values or (count is not None and len(values) != count):
        expected = "numbers" if count is None else f"{count} numbers"
        raise InputError(f"must be {expected} with commas between", field=option, value=text)
    return values


def _table(cases: list[str] | None, slopes: list[float], law: str, as_json: bool) -> None:
    from stereomate.parallax.homogeneity import PAPER_CASES, TableCase, homogeneity_table

    chosen = PAPER_CASES
    if cases:
        chosen = tuple(TableCase(*_numbers(text, "--case", 4)) for text in cases)
    rows = homogeneity_table(chosen, (slopes[0], slopes[1]), law)  # type: ignore[arg-type]
    if as_json:
        print_json([_row_record(row) for row in rows])
        return
    heads = ("c mm", "level", "object", "Δp°° mm", *(f"point {k}" for k in range(1, 7)))
    lines = [
        (
            f"{row.case.principal_distance_mm:g}",
            f"{row.case.level:+g}",
            f"{row.case.object_height:g}",
            f"{row.ideal_mm:.3f}",
            *(f"{_percent(x)} / {_percent(y)}" for x, y in zip(row.t_x, row.t_y, strict=True)),
        )
        for row in rows
    ]
    title = f"t_x / t_y in percent, slopes {slopes[0]:g}° along and {slopes[1]:g}° across the base, {law} law"
    console().print(table(title, heads, lines))


def _percent(value: float) -> str:
    return f"{round(100.0 * value, 2) + 0.0:.2f}"


def _row_record(row: TableRow) -> dict[str, Any]:
    return {
        "principal_distance_mm": row.case.principal_distance_mm,
        "format_mm": row.case.format_mm,
        "level": row.case.level,
        "object_height": row.case.object_height,
        "ideal_parallax_mm": row.ideal_mm,
        "t_x": row.t_x,
        "t_y": row.t_y,
    }


def _diagram(path: Path, slopes: list[float], law: str) -> None:
    from stereomate.report.overcorrection_style import save_figure
    from stereomate.report.stereo_homogeneity import draw_error_vectors

    save_figure(draw_error_vectors(slopes_deg=(slopes[0], slopes[1]), law=law), path)  # type: ignore[arg-type]
    typer.echo(f"figure: {path}")


def _maps(
    project: Path,
    heights: list[float],
    resolution: float | None,
    out: Path,
    threads: int,
    progress: ProgressSink,
) -> list[tuple[str, HomogeneitySummary]]:
    from stereomate.project import load
    from stereomate.project.run import RunOptions, plan
    from stereomate.stereo.homogeneity import coarse_job, write_homogeneity

    _, jobs = plan(load(project, planned=True), RunOptions(threads=threads))
    found = []
    for job in jobs:
        model_m = job.heights.resolution_m / job.frame.unit_m
        coarse = coarse_job(job, resolution if resolution is not None else max(model_m, job.grid.gsd))
        for height in heights:
            name = "_".join(part for part in ("homogeneity", job.name, f"{height:g}m") if part)
            stage = f"objects of {height:g} m"
            summary = write_homogeneity(
                coarse,
                out / f"{name}.tif",
                height,
                threads=threads,
                progress=lambda done, total, stage=stage: progress(stage, done, total),  # type: ignore[misc]
            )
            _draw_map(coarse, summary)
            found.append((job.name, summary))
    return found


def _draw_map(job: RectifyJob, summary: HomogeneitySummary) -> None:
    from stereomate.raster.thumbnail import read_thumbnail
    from stereomate.report.overcorrection_style import save_figure
    from stereomate.report.stereo_homogeneity import draw_homogeneity_map

    assert summary.path is not None
    values = read_thumbnail(summary.path, 900)[0]
    width, height = (n * job.grid.gsd * job.frame.unit_m * 1e-3 for n in job.grid.size)
    figure = draw_homogeneity_map(values, (0.0, width, 0.0, height), summary.object_height_m, job.law.kind)
    save_figure(figure, summary.path.with_suffix(".png"), dpi=150)


def _print_maps(found: list[tuple[str, HomogeneitySummary]], out: Path) -> None:
    heads = ("map", "seen by both", "|t_x| ≤ 5 %", "|t_x| ≤ 10 %", "|t_y| ≤ 5 %", "rms of height read")
    rows = []
    for _, s in found:
        assert s.path is not None
        rows.append(
            [
                s.path.name,
                *(f"{v:.1%}" for v in (s.seen_by_both, s.within_5_percent, s.within_10_percent)),
                f"{s.t_y_within_5_percent:.1%}",
                f"{s.error_rms_m:.2f} m",
            ]
        )
    screen = console()
    screen.print(table(f"Homogeneity maps in {out}", heads, rows))
    laws = []
    for name, s in found:
        for law in s.laws:
            laws.append(
                [
                    " ".join(part for part in (name, f"{s.object_height_m:g} m") if part),
                    law.kind,
                    f"{law.within_5_percent:.1%}",
                    f"{law.within_10_percent:.1%}",
                    f"{law.mean:+.1%}",
                    f"{law.rms:.1%}",
                ]
            )
    heads = ("objects", "law", "within 5 %", "within 10 %", "mean", "rms")
    screen.print(table("Object heights read through a law", heads, laws, left=(0, 1)))
