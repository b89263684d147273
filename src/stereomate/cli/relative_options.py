"""Options of `stereomate relative`, as types."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

_POINTS = "Measured points"

Left = Annotated[str | None, typer.Argument(help="Left photograph: a file, or a name in the project.")]
Right = Annotated[str | None, typer.Argument(help="Right photograph.")]
CameraFile = Annotated[
    Path | None,
    typer.Option("--camera", help="TOML file with one [[camera]], or one each for left and right."),
]
Project = Annotated[
    Path | None,
    typer.Option("--project", help="Project file: cameras, and orientation to start from and compare."),
]
Figures = Annotated[
    Path | None, typer.Option("--figures", help="Folder for matches, y-parallaxes, six-point picture.")
]
Output = Annotated[Path | None, typer.Option("--output", "-o", help="Write the JSON record here.")]
Json = Annotated[bool, typer.Option("--json", help="Print the JSON record (without points).")]
LargestSide = Annotated[
    int, typer.Option("--largest-side", help="Features are looked for in images reduced to this side.")
]
Seed = Annotated[int, typer.Option("--seed", help="Of the random sampling.")]
Points = Annotated[
    Path | None,
    typer.Option(
        "--points",
        help="Measured points instead of photographs: point,x_left,y_left,x_right,y_right in mm from the "
        "principal point, or point,col_left,row_left,col_right,row_right in pixels; perhaps weight.",
        rich_help_panel=_POINTS,
    ),
]
PrincipalDistance = Annotated[
    str | None,
    typer.Option("--principal-distance", help="Of points in mm: C, or LEFT,RIGHT.", rich_help_panel=_POINTS),
]
Sigma = Annotated[
    float | None,
    typer.Option(
        "--sigma",
        help="Standard deviation of a measured coordinate of weight one [default: 0.005 mm, 0.5 px].",
        rich_help_panel=_POINTS,
    ),
]
EqualWeights = Annotated[
    bool,
    typer.Option(
        "--equal-weights",
        help="All conditions weigh the same, as textbook programs have it.",
        rich_help_panel=_POINTS,
    ),
]
