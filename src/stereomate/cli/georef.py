"""`stereomate georef`: errors of working in a map grid foretold, found in an orientation, and made right."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stereomate.cli.georef_audit import audit_dict, print_audit
from stereomate.cli.output import print_json

if TYPE_CHECKING:
    from collections.abc import Mapping

    from stereomate.frames.prediction.plan import FlightPlan
    from stereomate.frames.prediction.predict import Prediction


def register(app: typer.Typer) -> None:
    """Add the commands to the application."""
    georef = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help=_HELP)
    georef.command("predict")(_predict)
    georef.command("audit")(_audit)
    georef.command("fix")(_fix)
    app.add_typer(georef, name="georef")


_HELP = "Georeferencing in map projections: predict errors, audit an orientation, fix it."


def _predict(
    context: typer.Context,
    crs: Annotated[str, typer.Option("--crs", help="Map projection of the project, as EPSG:25832.")],
    at: Annotated[str, typer.Option("--at", help="Middle of the block in it: E,N.", metavar="E,N")],
    flying_height: Annotated[float, typer.Option("--flying-height", help="Above ground, metres.")],
    ground: Annotated[
        float, typer.Option("--ground", help="Ellipsoidal height of the ground, metres.")
    ] = 0.0,
    relief: Annotated[
        float, typer.Option("--relief", help="Height of the highest points above the ground, metres.")
    ] = 0.0,
    principal_distance_mm: Annotated[float, typer.Option("--principal-distance-mm")] = 150.0,
    format_mm: Annotated[float, typer.Option("--format-mm", help="Side of the square format.")] = 230.0,
    overlap: Annotated[float, typer.Option("--overlap", help="Along the strip, percent.")] = 60.0,
    sidelap: Annotated[float, typer.Option("--sidelap", help="Between strips, percent.")] = 60.0,
    heading: Annotated[
        float, typer.Option("--heading", help="Of the flight, degrees from true north.")
    ] = 90.0,
    tilt: Annotated[float, typer.Option("--tilt", help="Of the photographs, degrees.")] = 0.0,
    curvature: Annotated[
        str, typer.Option("--curvature", help="Curvature correction of the software: classical or sphere.")
    ] = "classical",
    level: Annotated[
        str, typer.Option("--level", help="Distances it keeps: at the ground, or on the ellipsoid.")
    ] = "ground",
    expected_mm: Annotated[
        float | None,
        typer.Option(
            "--expected-mm", help="Height accuracy expected [default: 0.06 per mille of the height]."
        ),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
    figure: Annotated[
        Path | None, typer.Option("--figure", help="Write bars and the map of errors: .svg, .pdf or .png.")
    ] = None,
) -> None:
    """Errors in height and plan to expect of a planned flight, for every way of working in the map.

    Rays are simulated over the ellipsoid, for direct and indirect orientation, with the principal distance
    fixed and free; the equations of the paper (Ressl 2002) stand beside them.
    """
    from stereomate.errors import InputError
    from stereomate.frames.curvature import CurvatureOptions
    from stereomate.frames.prediction.predict import predict

    if expected_mm is not None and not expected_mm > 0.0:
        raise InputError("must be positive", field="--expected-mm", value=expected_mm)
    plan = _flight_plan(context.params)
    options = CurvatureOptions(plan.radius_m, curvature, level)  # type: ignore[arg-type]
    prediction = predict(plan, None if expected_mm is None else 1e-3 * expected_mm, options)
    if figure is not None:
        _draw_prediction(prediction, figure)
    if json:
        print_json(_prediction_dict(prediction))
    else:
        _print_prediction(prediction)
        if figure is not None:
            typer.echo(f"figure: {figure}")


def _flight_plan(options: Mapping[str, Any]) -> FlightPlan:
    """The flight that the options describe."""
    from stereomate.frames.prediction.plan import FlightPlan

    x, y = _position(options["at"])
    return FlightPlan(
        crs=options["crs"],
        x=x,
        y=y,
        flying_height_m=options["flying_height"],
        ground_m=options["ground"],
        relief_m=options["relief"],
        principal_distance_mm=options["principal_distance_mm"],
        format_mm=options["format_mm"],
        overlap=options["overlap"] / 100.0,
        sidelap=options["sidelap"] / 100.0,
        heading_deg=options["heading"],
        tilt_deg=options["tilt"],
    )


def _position(text: str) -> tuple[float, float]:
    from stereomate.errors import InputError

    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError("must be two numbers E,N", field="--at", value=text) from None
    return x, y


def _draw_prediction(prediction: Prediction, path: Path) -> None:
    from stereomate.frames.prediction.predict import error_map
    from stereomate.report.georef import draw_prediction
    from stereomate.report.overcorrection_style import save_figure

    save_figure(draw_prediction(prediction, error_map(prediction.plan)), path)


_WORDS = {
    "nothing": "nothing",
    "P1": "P1 only (curvature correction)",
    "M2": "M2 (heights scaled)",
    "M3": "M3 (principal distance scaled)",
    "M3i": "M3 per photograph",
    "M4": "M4 (image coordinates corrected)",
    "M1": "M1 (tangent frame)",
}


def _print_prediction(prediction: Prediction) -> None:
    from stereomate.cli.output import console, table

    out = console()
    plan = prediction.plan
    out.print(f"[bold]{plan.frame.name}[/bold] at {plan.x:.0f}, {plan.y:.0f}", highlight=False)
    for sentence in prediction.words():
        out.print(sentence, highlight=False)
    heads = ("done", "centre dZ m", "centre plan m", "worst dZ m", "worst plan m", "worst/expected", "")
    modes = (
        ("direct", False, "Direct: orientation true, c fixed"),
        ("indirect", False, "Indirect: control points, c fixed"),
        ("indirect", True, "Indirect: control points, c free, GNSS centres"),
    )
    for mode, free, title in modes:
        rows = []
        for outcome in prediction.outcomes:
            if (outcome.mode, outcome.free_principal_distance) != (mode, free):
                continue
            centre = outcome.centre_error
            rows.append(
                (
                    _WORDS[outcome.method],
                    f"{centre[2]:+.4f}",
                    f"{(centre[0] ** 2 + centre[1] ** 2) ** 0.5:.4f}",
                    f"{outcome.worst_height_m:+.4f}",
                    f"{outcome.worst_plan_m:.4f}",
                    f"{abs(outcome.worst_height_m) / prediction.expected_m:.2f}",
                    "harmless" if prediction.harmless(outcome) else "",
                )
            )
        out.print(table(title, heads, rows, left=(0, 6)))
    p1 = prediction.outcome("indirect", "P1")
    out.print(
        f"Equations beside the simulation: (2) centres {prediction.equation_2_m:+.4f} m (simulated "
        f"{p1.centres_up_m:+.4f}); (3) highest new point {prediction.equation_3_m:+.4f} m; (4) direct, on "
        f"the ground {prediction.equation_4_m:+.4f} m (simulated "
        f"{prediction.outcome('direct', 'P1').centre_error[2]:+.4f}).",
        highlight=False,
    )


def _prediction_dict(prediction: Prediction) -> dict[str, Any]:
    plan = prediction.plan
    return {
        "crs": plan.crs,
        "at": [plan.x, plan.y],
        "flying_height_m": plan.flying_height_m,
        "ground_m": plan.ground_m,
        "relief_m": plan.relief_m,
        "tau": plan.tau,
        "tau_e": plan.tau_e,
        "convergence_deg": math.degrees(plan.convergence),
        "expected_m": prediction.expected_m,
        "curvature": {"method": prediction.curvature.method, "level": prediction.curvature.level},
        "outcomes": [
            {
                "mode": outcome.mode,
                "method": outcome.method,
                "free_principal_distance": outcome.free_principal_distance,
                "centre_error_m": outcome.centre_error,
                "worst_height_m": outcome.worst_height_m,
                "worst_plan_m": outcome.worst_plan_m,
                "centres_up_m": outcome.centres_up_m,
                "principal_distance_mm": outcome.principal_distance_mm,
                "harmless": prediction.harmless(outcome),
            }
            for outcome in prediction.outcomes
        ],
        "equation_2_m": prediction.equation_2_m,
        "equation_3_m": prediction.equation_3_m,
        "equation_4_m": prediction.equation_4_m,
        "words": prediction.words(),
    }


def _audit(
    project: Annotated[Path, typer.Argument(help="The project file.")],
    photographs: Annotated[
        bool | None,
        typer.Option(
            "--photographs/--no-photographs",
            help="Match neighbouring photographs to find turned ones [default: without observations].",
        ),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
    figure: Annotated[
        Path | None, typer.Option("--figure", help="Write height differences and scores: .svg, .pdf or .png.")
    ] = None,
) -> None:
    """Tell which frame the orientation of a project was really made in.

    Readings of the attitudes, the heights and the way of adjusting are tried against the tie and control
    points of [observations] and ranked by their fit. What the project file should say is printed, and how
    sure that is. Photographs that are turned against their attitude are found by matching neighbours.
    """
    from stereomate.errors import InputError
    from stereomate.project.audit import audit_project

    found = audit_project(project, photographs)
    if figure is not None:
        if found.audit is None:
            raise InputError("needs [observations] in the project file", field="--figure", value=str(figure))
        from stereomate.report.georef import draw_audit
        from stereomate.report.overcorrection_style import save_figure

        save_figure(draw_audit(found.audit), figure)
    if json:
        print_json(audit_dict(found))
    else:
        print_audit(found)
        if figure is not None:
            typer.echo(f"figure: {figure}")


def _fix(
    project: Annotated[Path, typer.Argument(help="The project file.")],
    folder: Annotated[Path, typer.Argument(help="Folder for the corrected files.")],
    remedy: Annotated[
        str, typer.Option("--remedy", help="M2 (heights), M3 (principal distance), M4 (image coordinates).")
    ] = "M4",
    per_image: Annotated[
        bool, typer.Option("--per-image", help="M3: the scale of each photograph, not of the block.")
    ] = False,
    refraction: Annotated[
        str, typer.Option("--refraction", help="Atmosphere to take out of the observations: icao, ardc.")
    ] = "none",
    back: Annotated[
        Path | None,
        typer.Option("--back", help="Bring a table of its results (x, y, z) back to true heights."),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Rewrite an orientation for software that takes the map grid as Cartesian.

    Writes orientation.csv, the corrected observations and fix.json; the principal distances of M3 are in the
    orientation. With --back, results are brought back and written beside the table as NAME_true.csv.
    """
    from stereomate.project.fix import fix_project, results_back

    if back is not None:
        out = back.with_name(f"{back.stem}_true.csv")
        count = results_back(folder, back, out)
        typer.echo(f"{out}: {count} rows with true heights")
        return
    made = fix_project(project, folder, remedy, per_image=per_image, refraction=refraction)  # type: ignore[arg-type]
    fixed = made.fixed
    if json:
        print_json(
            {
                "remedy": fixed.remedy,
                "files": made.files,
                "scale": float(fixed.scale.mean()),
                "ground_m": fixed.ground_m,
                "words": made.words,
            }
        )
        return
    for path in made.files:
        typer.echo(f"wrote {path}")
    for line in made.words:
        typer.echo(f"  {line}")
