"""`stereomate publish`: the viewer of a stereo product as static files for any web server."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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
from stereomate.cli.output import print_json
from stereomate.cli.progress import progress_of
from stereomate.cli.settings import Settings
from stereomate.errors import InputError

if TYPE_CHECKING:
    from stereomate.viewer.site import Site, SiteOptions


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("publish")(_publish)


def _publish(
    context: typer.Context,
    product: Annotated[Path, typer.Argument(help="Folder of a run (with stereo.json).")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the site.")],
    name: Annotated[str | None, typer.Option("--product", help="Only this product of the run.")] = None,
    quality: Annotated[int, typer.Option("--quality", help="Of JPEG tiles, 1 to 100.")] = 90,
    lossless: Annotated[
        bool, typer.Option("--lossless", help="PNG tiles, three to five times larger.")
    ] = False,
    object_heights: ObjectHeights = "10",
    points: ShownPoints = None,
    title: Title = "",
    credit: Credits = "",
    centre_sigma: CentreSigma = 0.0,
    angle_sigma: AngleSigma = 0.0,
    surface: ObjectSurface = None,
    verify: Annotated[
        bool, typer.Option("--verify/--no-verify", help="Compare hashes of rasters and height model.")
    ] = True,
    as_json: Annotated[bool, typer.Option("--json", help="Print what was written as JSON.")] = False,
) -> None:
    """Write the viewer, its tiles and everything it measures with as static files."""
    from stereomate.viewer.publish import publish
    from stereomate.viewer.site import SiteOptions

    settings: Settings = context.obj
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
    site = open_site(product, name, options, verify)
    try:
        with progress_of(settings, as_json) as progress:
            made = publish(site, out, settings.threads, lambda done, total: progress("files", done, total))
    finally:
        site.close()
    if as_json:
        print_json({"out": made.folder, "files": made.files, "bytes": made.size_bytes})
    elif settings.verbosity >= 0:
        typer.echo(f"{made.files} files, {made.size_bytes / 1e6:.1f} MB in {made.folder}")
        typer.echo(f"Open it with a web server: stereomate view {made.folder}, or python -m http.server")


def heights_of_text(text: str) -> tuple[float, ...]:
    """Heights of objects as the option gives them."""
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise InputError("must be numbers with commas between", field="--object-height", value=text) from None


def open_site(product: Path, name: str | None, options: SiteOptions, verify: bool) -> Site:
    """The site of the products of a run, or of one of them; titled as its project where no title is given."""
    from stereomate.errors import FormatError
    from stereomate.stereo.product import read_document, read_products
    from stereomate.viewer.site import Site

    path = product / "stereo.json" if product.is_dir() else product
    products = [p for p in read_products(path) if name is None or p.job.name == name]
    if not products:
        raise FormatError("has no product of that name", file=path, field="product", value=name)
    if verify:
        for one in products:
            one.verify()
    title = options.title or str(read_document(path)["run"].get("project") or "")
    return Site(products, replace(options, title=title))
