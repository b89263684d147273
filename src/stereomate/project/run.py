"""The main job: from a project to orthophoto, stereomate, lineage, stereo.json and STAC item.

Stages: plan, tiles, assembly, agreement, documents. Tiles are kept in a ledger inside the output folder while
the run lasts; a run that was killed goes on from there and gives the same bytes.
"""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from stereomate import __version__
from stereomate.coverage.summary import Coverage, survey_coverage
from stereomate.coverage.survey import Photograph
from stereomate.errors import CoverageError, ImageError, ProjectError
from stereomate.project.inputs import file_digest
from stereomate.project.joins import measured_joins
from stereomate.project.making import ProductResult, make_product
from stereomate.project.model import Project
from stereomate.project.mosaic import planned_mosaics, write_seam_file
from stereomate.project.orientations import named
from stereomate.project.output import OutputFolder
from stereomate.project.run_options import ProgressSink, RunOptions
from stereomate.raster.files import storing
from stereomate.rectify.job import RectifyJob
from stereomate.rectify.planning import Request, plan_products
from stereomate.rectify.readers import close_readers
from stereomate.stereo.product import (
    ProductFiles,
    StereoProduct,
    product_record,
    write_stereo_json,
)
from stereomate.stereo.record import relative_path
from stereomate.tiles import executor as tiles
from stereomate.tiles.ledger import run_key

__all__ = [
    "DocumentWriter",
    "ProductResult",
    "ProgressSink",
    "RunOptions",
    "RunResult",
    "common_pixels",
    "plan",
    "run",
    "summary_record",
]

LOG = logging.getLogger(__name__)

# Seams of all products as polygons, to be edited.
SEAM_FILE: Final = "seams.gpkg"


@dataclass(frozen=True, eq=False)
class RunResult:
    """What a run made.

    Attributes
    ----------
    out : Path
    products : tuple of ProductResult
    coverage : Coverage
    up_to_date : bool
        Everything was there already: nothing was computed.
    """

    out: Path
    project: Project
    products: tuple[ProductResult, ...]
    coverage: Coverage
    key: str
    up_to_date: bool = False
    notes: tuple[str, ...] = field(default=())


DocumentWriter = Callable[[RunResult], Sequence[Path]]


def plan(project: Project, options: RunOptions) -> tuple[Coverage, list[RectifyJob]]:
    """Coverage of the survey and the jobs of its products; reads no pixel of a photograph."""
    try:
        return _plan(project, options)
    except CoverageError as error:
        raise error if error.file else named(error, project.path, error.field or "products") from error


def _plan(project: Project, options: RunOptions) -> tuple[Coverage, list[RectifyJob]]:
    heights = project.require_heights()
    coverage = survey_coverage(project.survey, heights)
    bands, dtype = common_pixels(project)
    request = Request(
        pairs=options.pairs if options.pairs is not None else project.pairs,
        stereo=options.stereo,
        area=project.area,
        bands=bands,
        dtype=project.options.dtype or dtype,
    )
    if not project.sheets:
        return coverage, plan_products(project.survey, heights, coverage, project.options, request)
    jobs = []
    for sheet in project.sheets:
        area = sheet.geometry if project.area is None else sheet.geometry.intersection(project.area)
        for job in plan_products(
            project.survey, heights, coverage, project.options, replace(request, area=area)
        ):
            name = sheet.name if not job.name else f"{sheet.name}_{job.name}"
            jobs.append(replace(job, name=name))
    return coverage, jobs


def common_pixels(project: Project) -> tuple[tuple[int, ...], str]:
    """Bands to take (from 0) and pixel type, the same in all photographs.

    Raises
    ------
    ProjectError
        If photographs differ, or a band that is asked for is not there.
    """
    if not project.infos:
        # a planned flight
        return (0,), project.options.dtype or "uint8"
    infos = [project.infos[p.name] for p in project.survey.photographs]
    kinds = {(len(info.colour_bands), str(info.dtype)) for info in infos}
    if len(kinds) > 1:
        text = "; ".join(sorted(f"{bands} bands of {dtype}" for bands, dtype in kinds))
        raise ProjectError(
            "must be photographs with the same bands and type",
            file=project.path,
            field="photos.files",
            value=text,
        )
    asked = project.options.bands
    available = infos[0].colour_bands
    if asked is None:
        return available, str(infos[0].dtype)
    if max(asked) > infos[0].bands:
        raise ProjectError(
            f"must be bands of the photographs, which have {infos[0].bands}",
            file=project.path,
            field="products.bands",
            value=list(asked),
        )
    return tuple(band - 1 for band in asked), str(infos[0].dtype)


def run(
    project: Project,
    out: Path,
    options: RunOptions,
    progress: ProgressSink | None = None,
    documents: DocumentWriter | None = None,
) -> RunResult:
    """Make all products of a project.

    A photograph whose pixels cannot be read is left out and the rest made anew, unless the run is strict.
    Files of an earlier run in `out` that this one does not make again are removed.

    Parameters
    ----------
    documents : callable, optional
        Writes what lies beside the rasters, and returns it. Called before stereo.json is written, which says
        that all is done.

    Raises
    ------
    StereomateError
        Wrong input, or a place that cannot be written. Finished chunks stay for the next run.
    """
    report = progress or (lambda stage, done, total: None)
    with storing(out):
        out.mkdir(parents=True, exist_ok=True)
    place = OutputFolder(out)
    if options.fresh:
        place.forget()
    strict = options.strict or project.options.strict
    unreadable = {} if strict or options.fresh else place.unreadable(project)
    for name in unreadable:
        project = project.without(name, _same_as_before(project, name))
    while True:
        try:
            return _run(project, place, options, report, (documents, unreadable))
        except ImageError as error:
            bad = _photograph_of(project, error)
            if strict or bad is None or bad.path is None:
                raise
            project = project.without(bad.name, error)
            LOG.warning("left out: %s", error)
            unreadable[bad.name] = file_digest(bad.path)


def _run(
    project: Project,
    place: OutputFolder,
    options: RunOptions,
    report: ProgressSink,
    beside: tuple[DocumentWriter | None, dict[str, str]],
) -> RunResult:
    out, (documents, unreadable) = place.out, beside
    report("plan", 0, 1)
    coverage, jobs = plan(project, options)
    report("plan", 1, 1)
    key = _definition_key(project, jobs, options, out)
    if not options.fresh and place.is_made(key):
        LOG.info("%s is up to date", out)
        return RunResult(out, project, (), coverage, key, up_to_date=True)
    place.note_unreadable(unreadable)
    try:
        results = _make_products(project, jobs, place, key, options, report)
        joins = measured_joins([r.product.job for r in results]) if options.agreement else []
    finally:
        close_readers()
    for join in joins:
        LOG.info("orthophotos of products %r and %r: %s", *join.products, join)
    result = RunResult(out, project, results, coverage, key)
    written = [] if documents is None else list(documents(result))
    if write_seam_file(out / SEAM_FILE, [r.product.job for r in results]):
        written.append(out / SEAM_FILE)
    place.remove_stale({name for r in results for name in r.product.files.hashes} | {p.name for p in written})
    write_stereo_json(
        out / "stereo.json",
        [r.product for r in results],
        {
            "key": key,
            "project": project.name,
            "project_file": relative_path(project.path, out),
            "notes": list(project.notes),
            "inputs": [{"role": i.role, "file": i.path.name, "digest": i.digest} for i in project.inputs],
            "documents": sorted(path.name for path in written),
            "unreadable": unreadable,
            "joins": [dataclasses.asdict(join) for join in joins],
            "mosaic": {
                r.product.job.name: dataclasses.asdict(r.mosaic) for r in results if r.mosaic is not None
            },
        },
    )
    place.forget()
    return result


def _make_products(
    project: Project,
    jobs: list[RectifyJob],
    place: OutputFolder,
    key: str,
    options: RunOptions,
    report: ProgressSink,
) -> tuple[ProductResult, ...]:
    """Balance and seams of the whole block, then the products one after the other."""
    report("mosaic", 0, 1)
    executor = tiles.executor_of(options.threads, options.scheduler)
    edited = _edited_seams(project, options)
    planned = planned_mosaics(jobs, place.workspace / "mosaic.json", key, executor, edited)
    report("mosaic", 1, 1)
    results = []
    for job, summary in planned:
        made = make_product(job, place, key, options, report)
        product = replace(made.product, orientation=project.orientation_covariance)
        results.append(replace(made, product=product, mosaic=summary))
    return tuple(results)


def _edited_seams(project: Project, options: RunOptions) -> Path | None:
    return options.seams if options.seams is not None else project.seam_file


def _photograph_of(project: Project, error: ImageError) -> Photograph | None:
    """The photograph that an error is about."""
    for photograph in project.survey.photographs:
        if photograph.path is not None and str(photograph.path) == str(error.file):
            return photograph
    return None


def _same_as_before(project: Project, name: str) -> ImageError:
    path = project.survey.photographs[project.survey.index(name)].path
    return ImageError("could not be read by the run before, and is the same file", file=path)


def _definition_key(project: Project, jobs: list[RectifyJob], options: RunOptions, out: Path) -> str:
    """Hash of everything that decides the bytes of the products."""
    nothing = ProductFiles("", "", None, {})
    records = [product_record(StereoProduct(job, nothing, out, "")) for job in jobs]
    return run_key(
        version=__version__,
        inputs=[(i.role, i.digest) for i in project.inputs if i.role != "project"],
        products=records,
        chunk_tiles=options.chunk_tiles,
        agreement=options.agreement,
        # those of the project are among its inputs
        seams=None if options.seams is None else file_digest(options.seams),
    )


def summary_record(result: RunResult) -> dict[str, Any]:
    """What was made, for ``--json`` and the end of the log."""
    return {
        "out": str(result.out),
        "up_to_date": result.up_to_date,
        "products": [
            {
                "name": r.product.job.name,
                "files": sorted(r.product.files.hashes),
                "size": list(r.product.job.grid.size),
                "gsd": r.product.job.grid.gsd,
                "models": sum(m.right >= 0 for m in r.product.job.models),
                "agreement": r.product.agreement,
                "chunks_made": r.chunks_made,
                "chunks_reused": r.chunks_reused,
            }
            for r in result.products
        ],
    }
