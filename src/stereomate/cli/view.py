"""`stereomate view`: a stereo product in the browser, to be seen and measured in."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from stereomate.cli.options import (
    AngleSigma,
    CentreSigma,
    Credits,
    ObjectHeights,
    ObjectSurface,
    ShownPoints,
    Title,
)
from stereomate.cli.publish import heights_of_text, open_site
from stereomate.cli.settings import Settings


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("view")(_view)


def _view(
    context: typer.Context,
    product: Annotated[Path, typer.Argument(help="Folder of a run (with stereo.json), or a published site.")],
    port: Annotated[int, typer.Option("--port", min=0, max=65535, help="0 takes a free one.")] = 0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the browser.")] = True,
    name: Annotated[str | None, typer.Option("--product", help="Only this product of the run.")] = None,
    quality: Annotated[int, typer.Option("--quality", help="Of JPEG tiles, 1 to 100.")] = 90,
    lossless: Annotated[bool, typer.Option("--lossless", help="PNG tiles.")] = False,
    object_heights: ObjectHeights = "10",
    points: ShownPoints = None,
    title: Title = "",
    credit: Credits = "",
    centre_sigma: CentreSigma = 0.0,
    angle_sigma: AngleSigma = 0.0,
    surface: ObjectSurface = None,
    verify: Annotated[
        bool,
        typer.Option(
            "--verify/--no-verify", help="Compare hashes of rasters and height model, while one looks."
        ),
    ] = True,
) -> None:
    """See a stereo-orthophoto in the browser and measure in it. Ctrl-C ends it."""
    from stereomate.viewer.publish import is_site
    from stereomate.viewer.server import PublishedFolder, serve
    from stereomate.viewer.site import KeptSite, SiteOptions

    settings: Settings = context.obj

    def ready(address: str) -> None:
        if settings.verbosity >= 0:
            typer.echo(f"{address}  (Ctrl-C ends)")
        if browser:
            typer.launch(address)

    if is_site(product):
        serve(PublishedFolder(product), port, ready)
        return
    options = SiteOptions(
        "png" if lossless else "jpg",
        quality,
        heights_of_text(object_heights),
        title,
        credit,
        points,
        surface,
        centre_sigma,
        angle_sigma,
    )
    site = open_site(product, name, options, verify=False)
    try:
        site.prepare()
        # reading gigabytes through takes longer than anybody waits for a picture: it is done beside
        serve(KeptSite(site), port, ready, site.verify if verify else None)
    finally:
        site.close()
