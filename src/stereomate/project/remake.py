"""The products of a run made anew over another height model, from their stereo.json and the photographs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from stereomate import __version__
from stereomate.coverage.summary import survey_coverage
from stereomate.errors import InputError
from stereomate.frames.transform import map_from_map, map_from_tangent
from stereomate.project.making import make_product
from stereomate.project.model import Project
from stereomate.project.mosaic import write_seam_file
from stereomate.project.output import OutputFolder
from stereomate.project.run import (
    SEAM_FILE,
    DocumentWriter,
    ProductResult,
    ProgressSink,
    RunOptions,
    RunResult,
)
from stereomate.raster.files import storing
from stereomate.rectify.job import RectifyJob
from stereomate.rectify.planning import ground_range
from stereomate.rectify.readers import close_readers
from stereomate.stereo.product import ProductFiles, StereoProduct, product_record, write_stereo_json
from stereomate.terrain.model import HeightModel
from stereomate.tiles.ledger import run_key


def remake(
    products: Sequence[StereoProduct],
    heights: HeightModel,
    out: Path,
    options: RunOptions,
    progress: ProgressSink | None = None,
    *,
    project: Project | None = None,
    documents: DocumentWriter | None = None,
) -> tuple[ProductResult, ...]:
    """Make products anew over a height model; grid, law, models, seams, balance and orientation stay.

    Parameters
    ----------
    project : Project, optional
        Of the first run: without it nobody knows the survey, and there are no documents.
    documents : callable, optional
        As of `stereomate.project.run.run`.

    Raises
    ------
    InputError
        If a photograph is not there any more, or `out` is where the products lie.
    StereomateError
        As `stereomate.project.run.run`.
    """
    report = progress or (lambda stage, done, total: None)
    for product in products:
        if product.folder.resolve() == out.resolve():
            raise InputError("must be another folder than that of the products", field="out", value=str(out))
        for photograph in product.job.photographs:
            if photograph.path is None or not photograph.path.is_file():
                raise InputError(
                    "must be there to make products anew", file=photograph.path, field=photograph.name
                )
    with storing(out):
        out.mkdir(parents=True, exist_ok=True)
    place = OutputFolder(out)
    jobs = [over_heights(product.job, heights) for product in products]
    nothing = ProductFiles("", "", None, {})
    records = [product_record(StereoProduct(job, nothing, out, heights.content_hash)) for job in jobs]
    key = run_key(version=__version__, remade=records, chunk_tiles=options.chunk_tiles)
    try:
        made = [make_product(job, place, key, options, report) for job in jobs]
    finally:
        close_readers()
    results = tuple(
        replace(one, product=replace(one.product, orientation=before.orientation))
        for one, before in zip(made, products, strict=True)
    )
    note = f"made anew from {products[0].folder.name} over the height model {heights.name}"
    written: list[Path] = []
    if project is not None and documents is not None:
        over = replace(project, heights=heights, notes=(*project.notes, note))
        coverage = survey_coverage(project.survey, heights)
        written = list(documents(RunResult(out, over, results, coverage, key)))
    if write_seam_file(out / SEAM_FILE, [r.product.job for r in results]):
        written.append(out / SEAM_FILE)
    place.remove_stale({name for r in results for name in r.product.files.hashes} | {p.name for p in written})
    document = {
        "key": key,
        "project": project.name if project is not None else "",
        "notes": [note],
        "inputs": [],
        "documents": sorted(path.name for path in written),
        "unreadable": {},
    }
    write_stereo_json(out / "stereo.json", [r.product for r in results], document)
    place.forget()
    return results


def over_heights(job: RectifyJob, heights: HeightModel) -> RectifyJob:
    """The job over another height model."""
    centres = map_from_tangent(job.tangent, job.frame, job.centres_tangent)
    in_model = map_from_map(heights.frame, job.frame, centres)
    return replace(
        job,
        heights=heights,
        centres_in_height_model=np.column_stack([heights.pixel_from_map(in_model[:, :2]), centres[:, 2]]),
        height_range=ground_range(job.frame, heights, job.grid),
    )
