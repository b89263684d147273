"""The mosaic of a block: radiometric balance and seams, decided once before the tiles are made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import shapely

from stereomate.rectify.balance_solution import solve_balance
from stereomate.rectify.disagreement import grey_scale
from stereomate.rectify.job import RectifyJob
from stereomate.rectify.overviews import Overviews, make_overviews
from stereomate.rectify.radiometry import Balance, BalanceSummary, Samples
from stereomate.rectify.samples import balance_samples
from stereomate.rectify.seamlines import improved_regions
from stereomate.rectify.seampolygons import Polygons, finished_seams, region_polygons
from stereomate.rectify.seams import Seams
from stereomate.rectify.serving_ground import best_models, everywhere, where_shown
from stereomate.tiles import Executor, Threads


@dataclass(frozen=True)
class MosaicSummary:
    """What was decided for a product.

    Attributes
    ----------
    models_used : int
        Models that serve ground.
    seam_length : float
        Between different models, map units.
    mixed_length : float
        Along which photographs are mixed.
    cell : float
        Side of the cells in which it was decided, map units.
    balance : BalanceSummary or None
    """

    models_used: int
    seam_length: float
    mixed_length: float
    cell: float
    balance: BalanceSummary | None


def has_choice(job: RectifyJob) -> bool:
    """Whether more than one model (or photograph) can serve ground of a product."""
    stereo = sum(m.right >= 0 for m in job.models)
    return stereo > 1 or (stereo == 0 and len(job.models) > 1)


def needs_mosaic(jobs: Sequence[RectifyJob]) -> bool:
    """Whether there are seams to find, or several photographs or products to balance."""
    return len(jobs) > 1 or any(has_choice(job) for job in jobs)


def plan_mosaics(
    jobs: Sequence[RectifyJob],
    executor: Executor | None = None,
    edited: dict[str, Polygons] | None = None,
) -> list[tuple[RectifyJob, MosaicSummary | None]]:
    """The jobs of a block with balance and seams; a block with nothing to choose stays as it is.

    The balance is one for all products of the block: a photograph is as bright in each of them.

    Parameters
    ----------
    edited : dict of str to polygons, optional
        Seams given by the user, by name of the product, instead of least-cost paths.
    """
    wanted = list(jobs) if needs_mosaic(jobs) else []
    overviews = [make_overviews(job, executor) for job in wanted]
    balances = _balances(wanted, overviews)
    if not wanted:
        return [(job, None) for job in jobs]
    # The overviews are in this process: a cluster would be sent all of them.
    threads = executor if isinstance(executor, Threads) else None
    return [
        _mosaic(job, overviews[k], balances[k], (edited or {}).get(job.name), threads)
        for k, job in enumerate(wanted)
    ]


def _mosaic(
    job: RectifyJob,
    overviews: Overviews,
    balanced: tuple[Balance, BalanceSummary] | None,
    polygons: Polygons | None,
    threads: Threads | None,
) -> tuple[RectifyJob, MosaicSummary]:
    if balanced is not None:
        overviews = overviews.balanced(balanced[0])
    scale = grey_scale(overviews)
    if polygons is None and has_choice(job) and job.options.seams == "least-cost":
        best = best_models(overviews, job)
        label = everywhere(best)
        if (label >= 0).all():
            label = improved_regions(overviews, job.models, label, scale, threads)
            label = where_shown(overviews, job.models, label, best)
            polygons = region_polygons(label, overviews.factor, job.grid.size)
    seams: Seams | None = None
    if polygons is not None:
        levelled = balanced is not None
        seams = finished_seams(overviews, job.models, polygons, job.options.feather_px, scale, levelled)
    made = replace(job, seams=seams, balance=None if balanced is None else balanced[0])
    return made, _summary(made, overviews, None if balanced is None else balanced[1])


def _balances(
    jobs: Sequence[RectifyJob], overviews: Sequence[Overviews]
) -> list[tuple[Balance, BalanceSummary] | None]:
    """Balance of each job's photographs, solved together over the photographs of all jobs."""
    if not jobs or not jobs[0].options.balance:
        return [None] * len(jobs)
    camera_of = {p.name: p.camera for job in jobs for p in job.photographs}
    names = sorted(camera_of)
    number = {name: k for k, name in enumerate(names)}
    cameras = sorted({camera.name for camera in camera_of.values()})
    parts = []
    for job, overview in zip(jobs, overviews, strict=True):
        samples = balance_samples(overview, grey_scale(overview))
        table = np.array([number[p.name] for p in job.photographs], np.int64)
        parts.append(replace(samples, photographs=table[samples.photographs]))
    balance, summary = solve_balance(
        Samples.joined(parts),
        [cameras.index(camera_of[name].name) for name in names],
        [camera_of[name].size_px for name in names],
    )
    return [(balance.of([number[p.name] for p in job.photographs]), summary) for job in jobs]


def _summary(job: RectifyJob, overviews: Overviews, balance: BalanceSummary | None) -> MosaicSummary:
    seams, gsd = job.seams, job.grid.gsd
    cell = overviews.job.grid.gsd
    if seams is None:
        return MosaicSummary(0, 0.0, 0.0, cell, balance)
    outlines: list[Any] = [polygon.boundary for _, polygon in seams.polygons]
    border = shapely.box(0, 0, *job.grid.size).exterior.length
    length = 0.5 * (sum(line.length for line in outlines) - border) * gsd
    mixed = sum(_mixed_length(np.asarray(line.points)) for line in seams.lines) * gsd
    return MosaicSummary(len({m for m, _ in seams.polygons}), max(length, 0.0), mixed, cell, balance)


def _mixed_length(points: Any) -> float:
    steps = np.hypot(*np.diff(points[:, :2], axis=0).T)
    return float(steps[np.maximum(points[1:, 2], points[:-1, 2]) > 0.0].sum())
