"""`stereomate heights` and `stereomate terrain`: what a stereo-orthophoto tells by itself."""

from __future__ import annotations

import logging
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stereomate.cli.logs import log_to_file
from stereomate.cli.output import console, print_json, table
from stereomate.cli.progress import ProgressSink, progress_of
from stereomate.cli.settings import Settings
from stereomate.errors import InputError, StereomateError

if TYPE_CHECKING:
    from stereomate.stereo.matched_surface import SurfaceOptions, SurfaceSummary
    from stereomate.stereo.product import StereoProduct
    from stereomate.stereo.terrain_check import TerrainSummary

LOG = logging.getLogger(__name__)

_PRODUCT = typer.Argument(metavar="OUT", help="stereo.json of a run, or its folder.")
_ABOVE = typer.Option("--above", help="Search this far above the height model, metres.")
_BELOW = typer.Option("--below", help="Search this far below the height model, metres.")
_STEP = typer.Option("--step", min=1, help="Cell of the surface in pixels of the product.")
# Pairs of photographs with fewer matches are not shown.
_FEW = 100


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command("heights")(_heights)
    app.command("terrain")(_terrain)


def _heights(
    context: typer.Context,
    product: Annotated[Path, _PRODUCT],
    name: Annotated[str | None, typer.Option("--product", help="Which product of the run.")] = None,
    above: Annotated[float, _ABOVE] = 40.0,
    below: Annotated[float, _BELOW] = 12.0,
    step: Annotated[int, _STEP] = 2,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="The raster [default: surface.tif in OUT].")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Heights of trees and buildings as a raster: orthophoto matched against stereomate, exact by lineage."""
    from stereomate.stereo.product import StereoProduct

    settings: Settings = context.obj
    opened = StereoProduct.open(product, name)
    path = out or opened.raster_beside("surface")
    with progress_of(settings, as_json) as progress:
        summary = _surface(opened, path, _options(above, below, step), settings.threads, progress)
    if as_json:
        print_json(summary.as_record())
    elif settings.verbosity >= 0:
        _print_surface(summary)


def _terrain(
    context: typer.Context,
    product: Annotated[Path, _PRODUCT],
    name: Annotated[str | None, typer.Option("--product", help="Which product of the run.")] = None,
    repair: Annotated[
        Path | None, typer.Option("--repair", help="Write a corrected height model: a GeoTIFF.")
    ] = None,
    remake: Annotated[
        Path | None, typer.Option("--remake", help="Make the products anew over it, into this folder.")
    ] = None,
    above: Annotated[float, _ABOVE] = 40.0,
    below: Annotated[float, _BELOW] = 12.0,
    step: Annotated[int, _STEP] = 2,
    largest_object: Annotated[
        float, typer.Option("--largest-object", help="Width of the widest building, metres.")
    ] = 40.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Check the height model by what the products show of open ground; repair it on request."""
    from stereomate.dense.ground_filter import GroundOptions
    from stereomate.stereo.product import StereoProduct
    from stereomate.stereo.terrain_check import TerrainOptions, check_terrain

    settings: Settings = context.obj
    if remake is not None and repair is None:
        raise InputError("needs --repair: the height model to make the products over", field="--remake")
    opened = StereoProduct.open(product, name)
    own = opened.job.heights.path
    if repair is not None and own is not None and repair.resolve() == own.resolve():
        raise InputError("must not be the height model itself", field="--repair", value=str(repair))
    with progress_of(settings, as_json) as progress:
        options = TerrainOptions(
            ground=GroundOptions(largest_object_m=largest_object), surface=_options(above, below, step)
        )
        surface = opened.raster_beside("surface")
        matched = _surface(opened, surface, options.surface, settings.threads, progress)
        found = check_terrain(
            opened,
            surface,
            opened.raster_beside("terrain"),
            options,
            repaired=repair,
            threads=settings.threads,
            progress=lambda done, total: progress("terrain", done, total),
        )
        _draw_terrain(opened, found)
        if repair is not None and remake is not None:
            _remake(opened, repair, remake, settings.threads, progress)
    if as_json:
        print_json({"surface": matched.as_record(), "terrain": found.as_record()})
    elif settings.verbosity >= 0:
        _print_surface(matched)
        _print_terrain(found)
        if remake is not None:
            typer.echo(f"products over the corrected height model: {remake}")


def _options(above: float, below: float, step: int) -> SurfaceOptions:
    from stereomate.dense.matching import DenseOptions
    from stereomate.stereo.matched_surface import SurfaceOptions

    return SurfaceOptions(below, above, dense=DenseOptions(step_px=step))


def _surface(
    product: StereoProduct, path: Path, options: SurfaceOptions, threads: int, progress: ProgressSink
) -> SurfaceSummary:
    """Match the surface, write it and its figure."""
    from stereomate.raster.thumbnail import read_thumbnail
    from stereomate.report.overcorrection_style import save_figure
    from stereomate.report.stereo_surface import draw_heights
    from stereomate.stereo.matched_surface import write_surface
    from stereomate.stereo.surface_bands import ABOVE, SIGMA

    summary = write_surface(
        product,
        path,
        options,
        threads=threads,
        progress=lambda done, total: progress("matching", done, total),
    )
    values = read_thumbnail(path, 1200)[0]
    job = product.job
    width, height = (n * job.grid.gsd * job.frame.unit_m * 1e-3 for n in job.grid.size)
    title = f"Heights of objects, cells of {summary.cell:g}"
    figure = draw_heights(values[..., ABOVE], values[..., SIGMA], (0.0, width, 0.0, height), title)
    save_figure(figure, path.with_suffix(".png"), dpi=150)
    return summary


def _draw_terrain(product: StereoProduct, found: TerrainSummary) -> None:
    import numpy as np

    from stereomate.raster.thumbnail import read_thumbnail
    from stereomate.report.overcorrection_style import save_figure
    from stereomate.report.stereo_surface import draw_terrain_check

    values, _, step = read_thumbnail(found.path, 1200)
    known = np.isfinite(values[..., 0])
    # the height model may reach far beyond the products
    rows, cols = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    if rows.size:
        values = values[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
    model = product.job.heights
    cell = [size * 1e-3 * step for size in model.cell_size_m]
    extent = (0.0, values.shape[1] * cell[0], 0.0, values.shape[0] * cell[1])
    save_figure(
        draw_terrain_check(values[..., 0], extent, found.as_record()), found.path.with_suffix(".png"), dpi=150
    )


def _remake(product: StereoProduct, repair: Path, out: Path, threads: int, progress: ProgressSink) -> None:
    """Rasters, and where the project file is still there report and STAC item, as a run writes them."""
    from stereomate.project import load
    from stereomate.project.documents import write_documents
    from stereomate.project.mosaic import sources_of
    from stereomate.project.remake import remake
    from stereomate.project.run import RunOptions
    from stereomate.terrain.model import HeightModel

    started = time.perf_counter()
    frame = product.job.heights.frame
    heights = HeightModel.open(repair, frame.heights, crs=frame.crs)
    try:
        project = load(sources_of(product.folder, None)[0])
    except StereomateError as error:
        LOG.warning("%s: made anew without report and STAC item", error)
        project = None
    with log_to_file(out / "run.log"):
        remake(
            [product],
            heights,
            out,
            RunOptions(threads=threads),
            progress,
            project=project,
            documents=lambda made: write_documents(made, started),
        )


def _print_surface(summary: SurfaceSummary) -> None:
    out = console()
    per_mille = 1e3 * summary.sigma_median_m / summary.flying_height_m
    rows: list[list[Any]] = [
        ["cell", f"{summary.cell:g}"],
        ["matched", f"{summary.matched:.1%} of what both products show"],
        ["beside a jump", f"{summary.beside_jumps:.1%} of the cells: they may show either level"],
        ["σ of a height, median", f"{summary.sigma_median_m:.3f} m = {per_mille:.2f} ‰ of the flying height"],
    ]
    out.print(table(f"Surface: {summary.path}", ("what", "value"), rows, left=(0, 1)))
    heads = ("left", "right", "matches", "rays miss: median, nmad, rms m", "y-parallax: median, nmad, rms m")
    models = [
        [
            m.left,
            m.right,
            str(m.count),
            f"{m.miss_median_m:+.3f}, {m.miss_nmad_m:.3f}, {m.miss_rms_m:.3f}",
            f"{m.y_median_m:+.3f}, {m.y_nmad_m:.3f}, {m.y_rms_m:.3f}",
        ]
        for m in summary.models
        if m.count >= _FEW
    ]
    out.print(table("How well the rays of each model meet", heads, models, left=(0, 1)))
    if summary.at_limits > 0.002:
        out.print(
            f"{summary.at_limits:.1%} of the matches lie at an end of the search range: "
            "raise --above or --below"
        )


def _print_terrain(found: TerrainSummary) -> None:
    rows = [
        ["cells checked", str(found.nodes)],
        ["open ground", f"{found.ground:.0%} of the surface"],
        ["mean, median", f"{found.mean_m:+.3f}, {found.median_m:+.3f} m"],
        ["rms, nmad", f"{found.rms_m:.3f}, {found.nmad_m:.3f} m"],
        ["predicted σ", f"{found.sigma_m:.3f} m"],
        ["tilt to east, to north", "{:+.2f}, {:+.2f} ‰".format(*found.tilt_per_mille)],
        ["map", str(found.path)],
    ]
    if found.repaired is not None:
        rows.append(["corrected height model", str(found.repaired)])
    title = "Ground minus height model, on open ground"
    console().print(table(title, ("what", "value"), rows, left=(0, 1)))
