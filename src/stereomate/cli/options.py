"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

# The orientation's share in the standard deviations of measured points.
CentreSigma = Annotated[
    float,
    typer.Option(
        "--centre-sigma", help="Standard deviation of projection centres, metres; else as the product knows."
    ),
]
AngleSigma = Annotated[
    float, typer.Option("--angle-sigma", help="Standard deviation of their rotations, degrees.")
]

# What the viewer's page shows.
ObjectHeights = Annotated[
    str, typer.Option("--object-height", help="Of the homogeneity layer: heights of objects, metres.")
]
ObjectSurface = Annotated[
    Path | None, typer.Option("--surface", help="Heights of objects to show [default: surface.tif of OUT].")
]
ShownPoints = Annotated[
    Path | None, typer.Option("--points", help="Control and check points to show: name, x, y, z, type.")
]
Title = Annotated[
    str, typer.Option("--title", help="Shown on the page and on prints; the project's name if not given.")
]
Credits = Annotated[str, typer.Option("--credits", help="Shown on the page and on prints.")]
