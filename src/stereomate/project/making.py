"""One product of a run: its tiles, the rasters assembled from them, and how well left and right agree."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

from stereomate import __version__
from stereomate.project.inputs import file_digest
from stereomate.project.output import OutputFolder
from stereomate.project.run_options import ProgressSink, RunOptions
from stereomate.raster.cog import BandStatistics, CogProfile, Georeference, assemble_cog
from stereomate.rectify.job import RectifyJob
from stereomate.rectify.mosaic import MosaicSummary
from stereomate.rectify.task import LINEAGE, MATE, ORTHO, ChunkTask, lineage_profile, product_profile
from stereomate.stereo.agreement import Agreement, measure_agreement
from stereomate.stereo.product import ProductFiles, StereoProduct
from stereomate.tiles import executor as tiles
from stereomate.tiles.ledger import Ledger, run_key
from stereomate.tiles.plan import TilePlan

LOG = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class ProductResult:
    """One product as made.

    Attributes
    ----------
    product : StereoProduct
    agreement : Agreement or None
    statistics : dict of str to tuple of BandStatistics
        Per raster.
    chunks_made, chunks_reused : int
    mosaic : MosaicSummary or None
        None where one model serves all.
    """

    product: StereoProduct
    agreement: Agreement | None
    statistics: dict[str, tuple[BandStatistics, ...]]
    chunks_made: int
    chunks_reused: int
    mosaic: MosaicSummary | None = None


def make_product(
    job: RectifyJob, place: OutputFolder, key: str, options: RunOptions, report: ProgressSink
) -> ProductResult:
    """Tiles, assembly and agreement of one product."""
    out = place.out
    roles = _roles(job)
    layout = TilePlan(job.grid.size, job.options.blocksize, options.chunk_tiles)
    profile = product_profile(job, roles)
    folder = place.workspace / f"tiles{_suffix(job)}"
    ledger = Ledger.open(folder, run_key(key=key, product=job.name))
    task = ChunkTask(job, layout, profile)
    stage = f"tiles{_suffix(job)}"
    summary = tiles.run(
        layout,
        task,
        ledger,
        tiles.executor_of(options.threads, options.scheduler),
        lambda p: report(stage, p.done, p.total),
    )
    files = {ORTHO: f"ortho{_suffix(job)}.tif", LINEAGE: f"lineage{_suffix(job)}.tif"}
    if job.is_stereo:
        files[MATE] = f"mate{_suffix(job)}.tif"
    # From here on rasters of an earlier run are replaced: it is not made any more.
    place.retire()
    report(f"assembly{_suffix(job)}", 0, len(files))
    assembly = _Assembly(job, out, layout, ledger, profile)
    assembled = tiles.map_items(assembly, list(files.items()), tiles.Threads(options.threads))
    report(f"assembly{_suffix(job)}", len(files), len(files))
    agreement = None
    if job.is_stereo and options.agreement:
        report(f"agreement{_suffix(job)}", 0, 1)
        agreement = measure_agreement(job, executor=tiles.Threads(options.threads))
        report(f"agreement{_suffix(job)}", 1, 1)
    hashes = {file: digest for file, (_, digest) in zip(files.values(), assembled, strict=True)}
    statistics = {name: found for name, (found, _) in zip(files, assembled, strict=True)}
    for name in (ORTHO, MATE):
        if name in statistics and not any(band.count for band in statistics[name]):
            LOG.warning("%s: holds no valid pixel: no photograph shows its ground", files[name])
    product = StereoProduct(
        job,
        ProductFiles(files[ORTHO], files[LINEAGE], files.get(MATE), hashes),
        out,
        job.heights.content_hash,
        None if agreement is None else agreement.as_record(),
    )
    return ProductResult(product, agreement, statistics, summary.made, summary.reused)


@dataclass(frozen=True)
class _Assembly:
    """Makes one raster of a product from its tiles: statistics of its bands, and its hash."""

    job: RectifyJob
    out: Path
    layout: TilePlan
    ledger: Ledger
    profile: CogProfile

    def __call__(self, raster: tuple[str, str]) -> tuple[tuple[BandStatistics, ...], str]:
        """Assemble the raster of this (name, file)."""
        name, file = raster
        profile = lineage_profile(self.job) if name == LINEAGE else self.profile
        where = Georeference(self.job.frame.crs, self.job.grid.affine, _metadata(self.job, name))
        statistics = assemble_cog(self.out / file, profile, self.layout, self.ledger, name, where)
        return statistics, file_digest(self.out / file)


def _suffix(job: RectifyJob) -> str:
    return f"_{job.name}" if job.name else ""


def _roles(job: RectifyJob) -> tuple[str, ...]:
    """Colours of the bands: red, green, blue for the first three of three or more."""
    count = len(job.bands)
    if count < 3:
        return ("gray", *["undefined"] * (count - 1))
    return ("red", "green", "blue", *["undefined"] * (count - 3))


def _metadata(job: RectifyJob, name: str) -> dict[str, str]:
    """Items of a raster that say what it is to whom finds it alone."""
    items = {"TIFFTAG_SOFTWARE": f"stereomate {__version__}", "STEREOMATE_PRODUCT": name}
    if job.is_stereo and name in (ORTHO, MATE):
        other = {ORTHO: "mate", MATE: "ortho"}[name]
        items |= {
            "STEREOMATE_EYE": "left" if name == ORTHO else "right",
            "ISO19115_ASSOCIATION": f"stereoMate {other}{_suffix(job)}.tif",
            "STEREOMATE_LAW": job.law.kind,
        }
    return items
