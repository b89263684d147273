"""Where a stereomate folds: dq/dh times the slope of the ground along the rows, as a raster.

At 1 and above, ground further along the row is shown further back: the lower branches do not appear, and
nothing can be measured there.
"""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from stereomate import __version__
from stereomate.parallax.laws import ParallaxLaw
from stereomate.raster.cog import CogProfile, Georeference, assemble_cog, encode_chunk
from stereomate.raster.files import storing
from stereomate.rectify.job import RectifyJob
from stereomate.stereo.homogeneity import coarse_job
from stereomate.stereo.surface import JobSurface
from stereomate.tiles import executor as tiles
from stereomate.tiles.ledger import Ledger, run_key
from stereomate.tiles.plan import Chunk, TilePlan

_BLOCK: Final = 512


@dataclass(frozen=True)
class FoldSummary:
    """Where laws fold.

    Attributes
    ----------
    path : Path
    cell : float
        Edge of a cell, map units.
    folded : dict of str to float
        Share of the ground on which each law folds.
    steepest : dict of str to float
        Largest value of each law.
    """

    path: Path
    cell: float
    folded: dict[str, float]
    steepest: dict[str, float]


def fold_profile(laws: Sequence[ParallaxLaw]) -> CogProfile:
    """How a map is written: a band for each law."""
    bands = tuple(f"{law.kind}: dq/dh times the slope along the row; folds from 1" for law in laws)
    return CogProfile("float32", len(bands), nodata=math.nan, overviews="nearest", descriptions=bands)


@dataclass(frozen=True, eq=False)
class FoldTask:
    """Makes the blobs of a chunk: `map` and `summary`. Picklable."""

    job: RectifyJob
    laws: tuple[ParallaxLaw, ...]
    plan: TilePlan

    def __call__(self, chunk: Chunk) -> dict[str, bytes]:
        """Heights and slopes of the ground at the middles of the cells, and what the laws make of them."""
        window, grid = chunk.window, self.job.grid
        row, col = np.mgrid[window.row0 : window.row1, window.col0 : window.col1]
        pixels = np.stack([col.ravel() + 0.5, row.ravel() + 0.5], axis=-1)
        ground = JobSurface(self.job).heights(grid.uv_from_map(grid.map_from_pixel(pixels)))
        values = np.full((len(pixels), len(self.laws)), np.nan, np.float32)
        known = np.isfinite(ground).all(axis=1)
        for k, law in enumerate(self.laws):
            values[known, k] = law.slope(ground[known, 0]) * ground[known, 1]
        found = values[np.isfinite(values).all(axis=1)]
        summary = {
            "cells": len(found),
            "folded": (found >= 1.0).sum(axis=0).tolist(),
            "steepest": found.max(axis=0, initial=-math.inf).tolist(),
        }
        shaped = values.reshape(window.rows, window.cols, len(self.laws))
        blob = encode_chunk(fold_profile(self.laws), self.plan, shaped)
        return {"map": blob, "summary": json.dumps(summary).encode()}


def write_fold_map(
    job: RectifyJob,
    laws: Sequence[ParallaxLaw],
    path: Path,
    *,
    threads: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> FoldSummary:
    """The map of a product as a Cloud Optimized GeoTIFF, in cells of the height model or pixels, the larger.

    Parameters
    ----------
    job : RectifyJob
        Of the product; its photographs need no image.
    laws : sequence of ParallaxLaw
        A band for each.
    """
    resolution = max(job.grid.gsd, job.heights.resolution_m / job.frame.unit_m)
    coarse = coarse_job(job, resolution)
    plan = TilePlan(coarse.grid.size, _BLOCK, 2)
    folder = path.with_name(f".{path.name}.tiles")
    with storing(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(folder, ignore_errors=True)
    ledger = Ledger.open(folder, run_key(version=__version__, fold_map=path.name))
    tell = progress or (lambda done, total: None)
    task = FoldTask(coarse, tuple(laws), plan)
    try:
        tiles.run(plan, task, ledger, tiles.executor_of(threads, None), lambda p: tell(p.done, p.total))
        items = {"TIFFTAG_SOFTWARE": f"stereomate {__version__}", "STEREOMATE_PRODUCT": "fold map"}
        place = Georeference(job.frame.crs, coarse.grid.affine, items)
        assemble_cog(path, fold_profile(laws), plan, ledger, "map", place)
        found = [json.loads(ledger.get(chunk.index, "summary")) for chunk in plan.chunks]
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return _summary(path, resolution, [law.kind for law in laws], found)


def _summary(path: Path, cell: float, kinds: list[str], found: list[dict[str, Any]]) -> FoldSummary:
    cells = sum(part["cells"] for part in found)
    folded = np.sum([part["folded"] for part in found], axis=0) / max(cells, 1)
    steepest = np.max([part["steepest"] for part in found], axis=0)
    return FoldSummary(
        path,
        cell,
        dict(zip(kinds, folded.tolist(), strict=True)),
        dict(zip(kinds, steepest.tolist(), strict=True)),
    )
