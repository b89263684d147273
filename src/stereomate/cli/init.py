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
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="The project file [default: FOLDER/project.toml].")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over files that are there.")] = False,
) -> None:
    """Draft a commented project.toml from a folder of photographs.

    Photographs, orientation tables, reconstruction.json, camera files (OpenSfM, Metashape, orthority), CRS
    and height model are looked for in the folder; where no table is, positions and angles in EXIF and XMP are
    written into one.
    """
    from stereomate.errors import ProjectError
    from stereomate.project.draft import PROJECT_FILE, draft_project, write_draft

    target = output or folder / PROJECT_FILE
    if target.parent.resolve() != folder.resolve():
        rule = "must lie in the folder of the photographs: paths in it are relative to it"
        raise ProjectError(rule, file=target, field="--output")
    draft = draft_project(folder)
    for path in write_draft(draft, target, force=force):
        typer.echo(f"wrote {path}")
    for item in draft.to_do:
        typer.echo(f"  to do: {item}")
    typer.echo(f"next: stereomate check {target}")
