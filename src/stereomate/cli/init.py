"""`stereomate init`: drafts a project file from a folder of photographs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    app.command("init")(_init)


def _init(
    folder: Annotated[Path, typer.Argument(help="The folder of photographs.")],
) -> None:
    """Draft a commented project.toml from a folder of photographs."""
