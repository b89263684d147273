"""`stereomate check`: everything that can be said about a project without computing it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    app.command("check")(_check)


def _check(
    project: Annotated[Path, typer.Argument(help="The project file.")],
    json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
) -> None:
    """Validate a project without computing it, and say what `run` will make."""
    from stereomate.errors import ProjectError

    raise ProjectError("does not exist", file=project)
