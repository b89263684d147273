"""`stereomate empirical`: von Gruber's relative orientation, step by step, on an exact instrument."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from stereomate.cli import empirical_options as given
from stereomate.cli.empirical_scenes import (
    Flight,
    Scene,
    photographs_scene,
    project_scene,
    scene_of_table,
    standard_scene,
)
from stereomate.cli.output import print_json

if TYPE_CHECKING:
    from stereomate.relative.empirical.procedure import Procedure
    from stereomate.relative.empirical.record import EmpiricalRun


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    app.command("empirical")(_empirical)


def _empirical(
    points: given.Points = None,
    right: given.RightPhotograph = None,
    heights: given.Heights = "0,0,0,0,0,0",
    tangent: given.Tangent = "2/3",
    flying_height: given.FlyingHeight = 1500.0,
    base: given.Base = None,
    pair: given.Pair = None,
    camera: given.CameraFile = None,
    principal_distance: given.PrincipalDistance = None,
    tilt: given.Tilt = 1.0,
    shift: given.Shift = 0.02,
    seed: given.Seed = 1,
    rule: given.Rules = None,
    independent: given.Independent = False,
    moved: given.Moved = 2,
    corrected: given.Corrected = "5",
    step: given.Steps = None,
    section: given.Section = None,
    profiles: given.Profiles = 0,
    cycles: given.Cycles = 4,
    rounds: given.Rounds = 10,
    noise: given.Noise = 0.0,
    every_round: given.EveryRound = False,
    figure: given.Figure = None,
    course: given.Course = None,
    json: given.Json = False,
) -> None:
    """Orient a pair by hand: eliminate y-parallaxes with named motions, over-correct the tilt, repeat.

    Without a table of points a model with the six standard points is made up, and photographed with a random
    orientation that the instrument has to find.
    """
    procedure = _procedure(independent, moved, corrected, step, section)
    standard_base = 0.625 * flying_height if base is None else base
    flight = Flight(flying_height, standard_base, tilt, shift, seed, independent)
    if right is not None and points is not None:
        scene = photographs_scene((points, right), camera, (base, flying_height), profiles)
    elif points is None:
        scene = standard_scene(heights, tangent, flight, profiles, procedure)
    elif points.suffix.lower() == ".toml":
        scene = project_scene(points, pair, profiles)
    else:
        scene = scene_of_table(points, principal_distance, flight)
    operation = {"cycles": cycles, "rounds": rounds, "parallax_std": noise, "seed": seed}
    runs = _runs(scene, procedure, rule or ["general"], operation)
    _write_figures(runs, figure, course)
    _print(runs, every_round, json)
    if scene.given is not None and not json:
        typer.echo(_against_given(runs, scene))


def _runs(
    scene: Scene, procedure: Procedure, rules: list[str], operation: dict[str, Any]
) -> dict[str, EmpiricalRun]:
    from stereomate.relative.empirical.procedure import rule_of
    from stereomate.relative.empirical.run import EmpiricalOptions, run_empirical

    if scene.profiles:
        procedure = replace(procedure, profiles=scene.profiles)
    options = EmpiricalOptions(**operation, given_section=scene.section, cleared_ratio=scene.cleared_ratio)
    return {
        name: run_empirical(scene.model, scene.start, procedure, rule_of(name), options) for name in rules
    }


def _against_given(runs: dict[str, EmpiricalRun], scene: Scene) -> str:
    """The right projector's elements against the known orientation, for the dependent pair."""
    assert scene.given is not None
    lines = ["", f"found minus {scene.given_by} (dependent pair, right projector):"]
    for name, run in runs.items():
        if any(motion.endswith("1") for motion in run.procedure.motions):
            return ""
        found, wanted = run.setting.right, scene.given.right
        angles = "  ".join(
            f"{symbol} {math.degrees(getattr(found, key) - getattr(wanted, key)):+.4f}°"
            for symbol, key in (("ω", "omega"), ("φ", "phi"), ("κ", "kappa"))
        )
        shifts = f"by {found.by - wanted.by:+.3f} m  bz {found.bz - wanted.bz:+.3f} m"
        lines.append(f"  {name:<10}{angles}  {shifts}")
    return "\n".join(lines)


def _procedure(
    independent: bool, moved: int, corrected: str, steps: list[str] | None, section: str | None
) -> Procedure:
    from stereomate.relative.empirical.procedure import dependent_pair, independent_pair

    default = independent_pair(moved, corrected) if independent else dependent_pair(moved, corrected)
    return _own_procedure(steps, section, default) if steps else default


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
