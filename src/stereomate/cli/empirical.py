"""`stereomate empirical`: von Gruber's relative orientation, step by step, on an exact instrument."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stereomate.cli.output import print_json

if TYPE_CHECKING:
    from stereomate.relative.empirical.procedure import Procedure
    from stereomate.relative.empirical.projectors import Setting, StereoModel
    from stereomate.relative.empirical.record import EmpiricalRun

_MODEL = "Model"
_METHOD = "Method"


@dataclass(frozen=True)
class _Scene:
    """What the instrument is given: the model, where it starts, and a cross-section if one is known."""

    model: StereoModel
    start: Setting
    section: Any = None
    profiles: tuple[tuple[str, str, str], ...] = ()
    cleared_ratio: float = 1e-5
    given: Setting | None = None


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    app.command("empirical")(_empirical)


def _empirical(
    points: Annotated[
        Path | None,
        typer.Argument(
            help="Table of points: point,x_left,y_left,x_right,y_right in mm, or point,x,y,h in metres; or a "
            "project (.toml), one of whose pairs is measured by image matching."
        ),
    ] = None,
    heights: Annotated[
        str,
        typer.Option(
            "--heights", help="Heights of points 1 to 6 over the flying height.", rich_help_panel=_MODEL
        ),
    ] = "0,0,0,0,0,0",
    tangent: Annotated[
        str, typer.Option("--tangent", help="y/z of points 3 to 6, as 2/3.", rich_help_panel=_MODEL)
    ] = "2/3",
    flying_height: Annotated[
        float, typer.Option("--flying-height", help="Metres.", rich_help_panel=_MODEL)
    ] = 1500.0,
    base: Annotated[
        float | None,
        typer.Option("--base", help="Metres [default: 5/8 of the flying height].", rich_help_panel=_MODEL),
    ] = None,
    pair: Annotated[
        tuple[str, str] | None,
        typer.Option("--pair", metavar="LEFT RIGHT", help="Pair of the project.", rich_help_panel=_MODEL),
    ] = None,
    principal_distance: Annotated[
        float | None,
        typer.Option(
            "--principal-distance", help="Millimetres, for image coordinates.", rich_help_panel=_MODEL
        ),
    ] = None,
    tilt: Annotated[
        float,
        typer.Option(
            "--tilt", help="Largest random angle of the photographs, degrees.", rich_help_panel=_MODEL
        ),
    ] = 1.0,
    shift: Annotated[
        float, typer.Option("--shift", help="Largest random by and bz over the base.", rich_help_panel=_MODEL)
    ] = 0.02,
    seed: Annotated[
        int, typer.Option("--seed", help="Of the random orientation.", rich_help_panel=_MODEL)
    ] = 1,
    rule: Annotated[
        list[str] | None,
        typer.Option(
            "--rule",
            help="flat, modified, general, whole (any places of points), or a number; several are compared.",
            rich_help_panel=_METHOD,
        ),
    ] = None,
    independent: Annotated[
        bool,
        typer.Option("--independent", help="Both projectors turn, the base stays.", rich_help_panel=_METHOD),
    ] = False,
    moved: Annotated[
        int,
        typer.Option(
            "--moved", help="Projector that moves, or whose ω is used: 1 or 2.", rich_help_panel=_METHOD
        ),
    ] = 2,
    corrected: Annotated[
        str, typer.Option("--corrected", help="Over-corrected point: 3, 4, 5 or 6.", rich_help_panel=_METHOD)
    ] = "5",
    step: Annotated[
        list[str] | None,
        typer.Option(
            "--step",
            metavar="POINT:MOTION",
            help="Own order, as 2:by2 1:kappa2 ...; the tilt last.",
            rich_help_panel=_METHOD,
        ),
    ] = None,
    section: Annotated[
        str | None,
        typer.Option(
            "--section",
            help="Own points of the cross-section, the corrected one last.",
            rich_help_panel=_METHOD,
        ),
    ] = None,
    profiles: Annotated[
        int,
        typer.Option(
            "--profiles", min=0, help="Take the mean ω of so many profiles instead.", rich_help_panel=_METHOD
        ),
    ] = 0,
    cycles: Annotated[int, typer.Option("--cycles", help="Cycles.", rich_help_panel=_METHOD)] = 4,
    rounds: Annotated[
        int, typer.Option("--rounds", help="Most rounds of clearing in a cycle.", rich_help_panel=_METHOD)
    ] = 10,
    noise: Annotated[
        float,
        typer.Option(
            "--noise", help="Standard deviation of reading p, metres in the model.", rich_help_panel=_METHOD
        ),
    ] = 0.0,
    every_round: Annotated[bool, typer.Option("--every-round", help="Write out repeated rounds.")] = False,
    figure: Annotated[
        Path | None, typer.Option("--figure", help="Plot the residual y-parallaxes after each cycle.")
    ] = None,
    course: Annotated[
        Path | None, typer.Option("--course", help="Plot the largest y-parallax against the cycles.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Orient a pair by hand: eliminate y-parallaxes with named motions, over-correct the tilt, repeat.

    Without a table of points a model with the six standard points is made up, and photographed with a random
    orientation that the instrument has to find.
    """
    from stereomate.relative.empirical.procedure import dependent_pair, independent_pair
    from stereomate.relative.empirical.run import EmpiricalOptions

    procedure = independent_pair(moved, corrected) if independent else dependent_pair(moved, corrected)
    if step:
        procedure = _own_procedure(step, section, procedure)
    flight = _Flight(
        flying_height, base if base is not None else 0.625 * flying_height, tilt, shift, seed, independent
    )
    if points is None:
        scene = _standard_scene(heights, tangent, flight, profiles, procedure)
    elif points.suffix.lower() == ".toml":
        scene = _measured_scene(points, pair, profiles > 0)
    else:
        scene = _scene_of_table(points, principal_distance, flight)
    if scene.profiles:
        procedure = replace(procedure, profiles=scene.profiles)
    options = EmpiricalOptions(
        cycles=cycles,
        rounds=rounds,
        parallax_std=noise,
        seed=seed,
        given_section=scene.section,
        cleared_ratio=scene.cleared_ratio,
    )
    runs = _runs(scene, procedure, rule or ["general"], options)
    _write_figures(runs, figure, course)
    _print(runs, every_round, json)
    if scene.given is not None and not json:
        typer.echo(_against_given(runs, scene.given))


@dataclass(frozen=True)
class _Flight:
    flying_height: float
    base: float
    tilt_deg: float
    shift: float
    seed: int
    independent: bool

    def truth(self) -> Setting:
        from stereomate.relative.empirical.scenes import wrong_orientation

        return wrong_orientation(
            self.base, self.seed, math.radians(self.tilt_deg), self.shift, self.independent
        )


def _runs(scene: _Scene, procedure: Procedure, rules: list[str], options: Any) -> dict[str, EmpiricalRun]:
    from stereomate.relative.empirical.procedure import rule_of
    from stereomate.relative.empirical.run import run_empirical

    return {
        name: run_empirical(scene.model, scene.start, procedure, rule_of(name), options) for name in rules
    }


def _standard_scene(
    heights: str, tangent: str, flight: _Flight, profiles: int, procedure: Procedure
) -> _Scene:
    import numpy as np

    from stereomate.cli.overcorrection import fraction
    from stereomate.relative.empirical.projectors import Setting
    from stereomate.relative.empirical.scenes import StandardTerrain, section_profiles

    terrain = StandardTerrain(
        heights=tuple(fraction(part, "--heights") for part in heights.split(",")),
        tangent=fraction(tangent, "--tangent"),
        flying_height=flight.flying_height,
        base=flight.base,
    )
    start, truth = Setting(flight.base), flight.truth()
    if profiles:
        places = np.linspace(0.0, 1.0, profiles).tolist() if profiles > 1 else [0.0]
        model, names = section_profiles(terrain, truth, places)
        return _Scene(model, start, None, names)
    # The cross-section is known from a map: only that of standard points can be told here.
    under_right = procedure.section[0] == "2"
    standard = procedure.section in (("1", "3", "5"), ("2", "4", "6"))
    known = terrain.section(right=under_right) if standard else None
    return _Scene(terrain.model(truth), start, known)


def _measured_scene(path: Path, pair: tuple[str, str] | None, with_profiles: bool) -> _Scene:
    from stereomate.errors import InputError
    from stereomate.project import load
    from stereomate.project.measured_pair import measured_pair

    if pair is None:
        raise InputError("is needed for a project: the names of two photographs", field="--pair")
    measured = measured_pair(load(path), pair)
    if measured.failed:
        typer.echo(f"not matched, left out: {', '.join(measured.failed)}", err=True)
    return _Scene(
        measured.model,
        measured.start,
        profiles=measured.profiles if with_profiles else (),
        # Parallaxes of less than a pixel belong to the measurement.
        cleared_ratio=measured.pixel,
        given=measured.given,
    )


def _against_given(runs: dict[str, EmpiricalRun], given: Setting) -> str:
    """The right projector's elements against the orientation of the project, for the dependent pair."""
    lines = ["", "found minus given by the project (dependent pair, right projector):"]
    for name, run in runs.items():
        if any(motion.endswith("1") for motion in run.procedure.motions):
            return ""
        found, wanted = run.setting.right, given.right
        angles = "  ".join(
            f"{symbol} {math.degrees(getattr(found, key) - getattr(wanted, key)):+.4f}°"
            for symbol, key in (("ω", "omega"), ("φ", "phi"), ("κ", "kappa"))
        )
        shifts = f"by {found.by - wanted.by:+.3f} m  bz {found.bz - wanted.bz:+.3f} m"
        lines.append(f"  {name:<10}{angles}  {shifts}")
    return "\n".join(lines)


def _scene_of_table(path: Path, principal_distance: float | None, flight: _Flight) -> _Scene:
    import numpy as np

    from stereomate.errors import FormatError, InputError
    from stereomate.relative.empirical.point_table import read_point_table
    from stereomate.relative.empirical.projectors import (
        Setting,
        model_from_image_coordinates,
        model_from_points,
    )

    try:
        table = read_point_table(path.read_text(encoding="utf-8"), str(path))
    except (OSError, UnicodeDecodeError) as error:
        raise FormatError("must be a readable text file", file=path) from error
    start = Setting(flight.base)
    if table.kind == "image":
        if principal_distance is None:
            raise InputError("is needed for image coordinates", field="--principal-distance")
        if np.abs(table.values).max() > 3.0 * principal_distance:
            raise InputError(
                "must be millimetres like the principal distance",
                file=path,
                field="image coordinates",
                value=float(np.abs(table.values).max()),
                hint="pixels or fiducial units?",
            )
        left, right = table.values[:, :2], table.values[:, 2:]
        return _Scene(model_from_image_coordinates(table.names, left, right, principal_distance), start)
    ground = table.values.copy()
    ground[:, 2] -= flight.flying_height
    return _Scene(model_from_points(table.names, ground, flight.truth()), start)


def _own_procedure(steps: list[str], section: str | None, default: Procedure) -> Procedure:
    from stereomate.errors import InputError
    from stereomate.relative.empirical.procedure import Procedure, Step
    from stereomate.relative.empirical.projectors import MOTIONS

    made = []
    for text in steps:
        point, colon, name = text.partition(":")
        motion = next((known for known in MOTIONS if known == name), None)
        if not colon or not point or motion is None:
            raise InputError(
                f"must be POINT:MOTION with one of {', '.join(MOTIONS)}", field="--step", value=text
            )
        made.append(Step(point, motion))
    if len(made) < 2:
        raise InputError(
            "must be given for every clearing step and the tilt", field="--step", value=len(made)
        )
    names = default.section if section is None else tuple(part.strip() for part in section.split(","))
    if len(names) != 3:
        raise InputError("must be three points", field="--section", value=section)
    return Procedure(tuple(made[:-1]), made[-1], (names[0], names[1], names[2]))


def _write_figures(runs: dict[str, EmpiricalRun], figure: Path | None, course: Path | None) -> None:
    if figure is None and course is None:
        return
    from stereomate.report.overcorrection_empirical import parallax_course, residual_parallaxes
    from stereomate.report.overcorrection_style import save_figure

    if course is not None:
        save_figure(parallax_course(runs), course)
    if figure is not None:
        for name, run in runs.items():
            path = figure if len(runs) == 1 else figure.with_stem(f"{figure.stem}-{name}")
            save_figure(residual_parallaxes(run, f"rule: {name}; {run.outcome}"), path)


def _print(runs: dict[str, EmpiricalRun], every_round: bool, json: bool) -> None:
    from stereomate.relative.empirical.notes import comparison_table, operator_notes

    if json:
        values = {name: _as_dict(run) for name, run in runs.items()}
        print_json(values if len(values) > 1 else next(iter(values.values())))
    elif len(runs) == 1:
        typer.echo(operator_notes(next(iter(runs.values())), every_round))
    else:
        typer.echo(comparison_table(runs))


def _as_dict(run: EmpiricalRun) -> dict[str, Any]:
    return {
        "outcome": run.outcome,
        "reason": run.reason,
        "tilt_amplification": run.tilt_amplification,
        "largest_parallax_m": run.largest,
        "points": run.model.names,
        "parallaxes_m": run.parallaxes,
        "settings": run.settings,
        "steps": run.notes,
    }
