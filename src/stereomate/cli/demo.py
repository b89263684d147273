"""`stereomate demo`: a synthetic survey with known truth, the whole main job on it, and how far off it is."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stereomate.cli.output import console, print_json, table
from stereomate.cli.progress import ProgressSink, progress_of
from stereomate.cli.settings import Settings
from stereomate.errors import InputError

if TYPE_CHECKING:
    from stereomate.project.run import RunResult
    from stereomate.synthetic.survey import SyntheticSurvey


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("demo")(_demo)


def _demo(
    context: typer.Context,
    folder: Annotated[Path, typer.Argument(help="Where the survey and its products go.")],
    seed: Annotated[int, typer.Option("--seed", help="Another seed, another world.")] = 1,
    strips: Annotated[int, typer.Option("--strips", min=1, help="Strips, flown to and fro.")] = 2,
    photos: Annotated[int, typer.Option("--photos", min=2, help="Photographs in each strip.")] = 5,
    heading: Annotated[
        float, typer.Option("--heading", help="Direction of flight, degrees from grid north.")
    ] = 90.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print what was made as JSON.")] = False,
) -> None:
    """Make a synthetic survey, run the main job on it and compare the products with the truth."""
    settings: Settings = context.obj
    _require_ours(folder)
    with progress_of(settings, as_json) as progress:
        survey, result = _make(folder, settings.threads, (seed, strips, photos, heading), progress)
        progress("truth", 0, 1)
        rows = _errors(survey, result)
        progress("truth", 1, 1)
    if as_json:
        print_json({"folder": folder, "products": result.out, "errors": rows, "open": _to_open(result)})
    elif settings.verbosity >= 0:
        _print(folder, survey, result, rows)


def _require_ours(folder: Path) -> None:
    """A folder with somebody's own project is not written into."""
    if (folder / "project.toml").exists() and not (folder / "truth.json").exists():
        raise InputError(
            "must be new, empty, or an earlier demo",
            field="FOLDER",
            value=str(folder),
            hint="name another folder",
        )


def _make(
    folder: Path, threads: int, choice: tuple[int, int, int, float], progress: ProgressSink
) -> tuple[SyntheticSurvey, RunResult]:
    from stereomate.project import load
    from stereomate.project.documents import write_documents
    from stereomate.project.run import RunOptions, run
    from stereomate.synthetic.files import write_survey
    from stereomate.synthetic.options import SurveyOptions
    from stereomate.synthetic.survey import make_survey
    from stereomate.tiles.executor import executor_of

    started = time.monotonic()
    seed, strips, photos, heading = choice
    progress("world", 0, 1)
    survey = make_survey(
        SurveyOptions(seed=seed, strips=strips, photos_per_strip=photos, heading_deg=heading)
    )
    progress("world", 1, 1)
    total, done = strips * photos, 0

    def count(name: str) -> None:
        nonlocal done
        progress("photographs", min(done, total), total)
        done += 1

    written = write_survey(survey, folder, executor=executor_of(threads, None), progress=count)
    result = run(
        load(written.project), folder / "products", RunOptions(threads=threads, fresh=True), progress
    )
    if not result.up_to_date:
        write_documents(result, started)
    return survey, result


def _errors(survey: SyntheticSurvey, result: RunResult) -> list[dict[str, Any]]:
    """What was compared with the truth: name, value, what it must stay below, unit."""
    from stereomate.stereo.agreement import measure_agreement
    from stereomate.stereo.product import read_products
    from stereomate.synthetic.truth import matched_error, warp_error

    rows: list[dict[str, Any]] = []

    def add(name: str, value: float, goal: float, unit: str, count: int) -> None:
        good = abs(value) <= goal
        rows.append({"what": name, "value": value, "goal": goal, "unit": unit, "count": count, "good": good})

    for product in read_products(result.out / "stereo.json"):
        job = product.job
        prefix = f"{job.name}: " if job.name else ""
        for kind in ("orthophoto", "stereomate"):
            found = warp_error(survey, job, kind)
            add(f"{prefix}{kind}: positions, rms", found.rms_px, 0.05, "px", found.count)
        made = next((r.agreement for r in result.products if r.product.job.name == job.name), None)
        if made is None:
            made = measure_agreement(job)
        match = matched_error(survey, job, made)
        for axis, name in enumerate(("x-parallax less q(h)", "y-parallax")):
            add(f"{prefix}matched {name}, median", match.median_px[axis], 0.05, "px", match.count)
            add(f"{prefix}matched {name}, nmad", match.nmad_px[axis], 0.2, "px", match.count)
        bound = match.height_bound_m
        add(f"{prefix}heights read through the law, mean", match.height_mean_m, bound, "m", match.count)
    return rows


def _to_open(result: RunResult) -> Path:
    report = result.out / "report.html"
    return report if report.exists() else result.out / "ortho.tif"


def _print(folder: Path, survey: SyntheticSurvey, result: RunResult, rows: list[dict[str, Any]]) -> None:
    out = console()
    world = survey.world
    options = survey.options
    made = [
        [
            f"{len(survey.survey.photographs)} photographs",
            "{} x {} px".format(*options.size_px),
            "strip*.tif",
        ],
        ["terrain", f"relief {options.relief_m:g} m, {options.crs}", "heights.tif"],
        ["houses, trees", f"{len(world.buildings)}, {len(world.trees)}", "truth.json"],
        ["control and check points", f"{len(world.targets)}", "points.csv"],
        ["project file", "for stereomate check and run", "project.toml"],
    ]
    for path in sorted(result.out.glob("*.*")):
        if path.suffix in (".tif", ".json", ".html"):
            made.append(["product", f"{path.stat().st_size / 1e6:.1f} MB", f"products/{path.name}"])
    out.print(table(f"Made in {folder}", ("what", "size", "file"), made, left=(0, 1, 2)))
    compared = [
        [
            row["what"],
            f"{row['value']:+.4f} {row['unit']}",
            f"{row['goal']:.4f} {row['unit']}",
            str(row["count"]),
            "yes" if row["good"] else "NO",
        ]
        for row in rows
    ]
    heads = ("against the truth, on open ground", "found", "within", "points", "kept")
    out.print(table("How far from the truth", heads, compared))
    out.print(f"Open {_to_open(result)}")
