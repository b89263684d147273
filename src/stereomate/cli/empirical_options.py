"""Options of `stereomate empirical`, as types."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

_MODEL = "Model"
_METHOD = "Method"

Points = Annotated[
    Path | None,
    typer.Argument(
        help="Table of points: point,x_left,y_left,x_right,y_right in mm, or point,x,y,h in metres; a "
        "project (.toml), one of whose pairs is measured by image matching; or the left photograph."
    ),
]
RightPhotograph = Annotated[
    Path | None,
    typer.Argument(help="Right photograph: both are measured by image matching, with --camera."),
]
CameraFile = Annotated[
    Path | None,
    typer.Option(
        "--camera",
        help="TOML file with one [[camera]], or one each for left and right.",
        rich_help_panel=_MODEL,
    ),
]
Heights = Annotated[
    str,
    typer.Option(
        "--heights", help="Heights of points 1 to 6 over the flying height.", rich_help_panel=_MODEL
    ),
]
Tangent = Annotated[
    str, typer.Option("--tangent", help="y/z of points 3 to 6, as 2/3.", rich_help_panel=_MODEL)
]
FlyingHeight = Annotated[float, typer.Option("--flying-height", help="Metres.", rich_help_panel=_MODEL)]
Base = Annotated[
    float | None,
    typer.Option(
        "--base",
        help="Metres [default: 5/8 of the flying height; of two photographs what the flying height gives].",
        rich_help_panel=_MODEL,
    ),
]
Pair = Annotated[
    tuple[str, str] | None,
    typer.Option("--pair", metavar="LEFT RIGHT", help="Pair of the project.", rich_help_panel=_MODEL),
]
PrincipalDistance = Annotated[
    float | None,
    typer.Option("--principal-distance", help="Millimetres, for image coordinates.", rich_help_panel=_MODEL),
]
Tilt = Annotated[
    float,
    typer.Option("--tilt", help="Largest random angle of the photographs, degrees.", rich_help_panel=_MODEL),
]
Shift = Annotated[
    float, typer.Option("--shift", help="Largest random by and bz over the base.", rich_help_panel=_MODEL)
]
Seed = Annotated[int, typer.Option("--seed", help="Of the random orientation.", rich_help_panel=_MODEL)]
Rules = Annotated[
    list[str] | None,
    typer.Option(
        "--rule",
        help="flat, modified, general, whole (any places of points), or a number; several are compared.",
        rich_help_panel=_METHOD,
    ),
]
Independent = Annotated[
    bool,
    typer.Option("--independent", help="Both projectors turn, the base stays.", rich_help_panel=_METHOD),
]
Moved = Annotated[
    int,
    typer.Option(
        "--moved", help="Projector that moves, or whose ω is used: 1 or 2.", rich_help_panel=_METHOD
    ),
]
Corrected = Annotated[
    str, typer.Option("--corrected", help="Over-corrected point: 3, 4, 5 or 6.", rich_help_panel=_METHOD)
]
Steps = Annotated[
    list[str] | None,
    typer.Option(
        "--step",
        metavar="POINT:MOTION",
        help="Own order, as 2:by2 1:kappa2 ...; the tilt last.",
        rich_help_panel=_METHOD,
    ),
]
Section = Annotated[
    str | None,
    typer.Option(
        "--section", help="Own points of the cross-section, the corrected one last.", rich_help_panel=_METHOD
    ),
]
Profiles = Annotated[
    int,
    typer.Option(
        "--profiles", min=0, help="Take the mean ω of so many profiles instead.", rich_help_panel=_METHOD
    ),
]
Cycles = Annotated[int, typer.Option("--cycles", help="Cycles.", rich_help_panel=_METHOD)]
Rounds = Annotated[
    int, typer.Option("--rounds", help="Most rounds of clearing in a cycle.", rich_help_panel=_METHOD)
]
Noise = Annotated[
    float,
    typer.Option(
        "--noise", help="Standard deviation of reading p, metres in the model.", rich_help_panel=_METHOD
    ),
]
EveryRound = Annotated[bool, typer.Option("--every-round", help="Write out repeated rounds.")]
Figure = Annotated[
    Path | None, typer.Option("--figure", help="Plot the residual y-parallaxes after each cycle.")
]
Course = Annotated[
    Path | None, typer.Option("--course", help="Plot the largest y-parallax against the cycles.")
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]
