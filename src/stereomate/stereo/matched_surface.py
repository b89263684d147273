"""Heights of objects as a raster: every pixel of the orthophoto matched in the stereomate, and intersected.

Left and right photograph of a match are known by lineage; their rays meet in the object, whatever the law,
the slope and the errors of the height model. The points are laid on a raster at their true positions: the
highest of a cell counts, ground that an object hides in a photograph stays empty. Chunk by chunk: memory does
not grow with the block.
"""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from stereomate import __version__
from stereomate.dense.matching import DenseMatch, DenseOptions, match_dense
from stereomate.errors import InputError
from stereomate.raster import Window
from stereomate.raster.cog import CogProfile, Georeference, assemble_cog, encode_chunk
from stereomate.raster.files import storing
from stereomate.rectify.grid import ProductGrid
from stereomate.rectify.ground import method_code
from stereomate.stereo.ground_pair import GroundPair, ground_pair, require_rasters
from stereomate.stereo.kernels import dense_points as kernels
from stereomate.stereo.model_quality import ModelQuality, ModelTally
from stereomate.stereo.product import StereoProduct
from stereomate.stereo.rays import ray_nodes
from stereomate.stereo.surface_bands import ABOVE, BANDS, HEIGHT, JUMP, ORTHO_TAG, SIGMA
from stereomate.tiles import executor as tiles
from stereomate.tiles.ledger import Ledger, run_key
from stereomate.tiles.plan import Chunk, TilePlan

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]

_BLOCK: Final = 512
# A window of half width r lowers a ridge of slopes s and -s by s r / 2; the bend over r is 2 s r.
_SMOOTHED: Final = 0.25
# Smaller patches of cells that stand apart by more than the room are no objects.
_SPECKLE: Final = 12
_NOTHING: Final = -32768
# Cells with so many of eight neighbours filled are filled from them.
_NEIGHBOURS: Final = 5


@dataclass(frozen=True)
class SurfaceOptions:
    """How the surface of a product is matched.

    Attributes
    ----------
    below_m, above_m : float
        Heights below and above the height model that are looked for.
    systematic_px : float
        Standard deviation of what resampling does to parallaxes; the residuals of a match do not show it.
    dense : DenseOptions
        Its `step_px` is the cell of the raster in pixels of the product.

    Raises
    ------
    InputError
        Naming the field, the rule and the value.
    """

    below_m: float = 12.0
    above_m: float = 40.0
    systematic_px: float = 0.03
    dense: DenseOptions = field(default_factory=lambda: DenseOptions(step_px=2))

    def __post_init__(self) -> None:
        for name in ("below_m", "above_m"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InputError("must be positive", field=name, value=value)
        if not (math.isfinite(self.systematic_px) and self.systematic_px >= 0.0):
            raise InputError("must be 0 or more", field="systematic_px", value=self.systematic_px)


@dataclass(frozen=True, eq=False)
class SurfaceSummary:
    """A matched surface in figures.

    Attributes
    ----------
    path : Path
    cell : float
        Edge of a cell, map units.
    matched : float
        Share of the ground with orthophoto and stereomate that was matched.
    at_limits : float
        Share of the matches beside the ends of the search range: wide ranges find more.
    beside_jumps : float
        Share of the cells that may show either level of a jump (band `JUMP`).
    sigma_median_m : float
    flying_height_m : float
        Of the centres above the ground, median of the models.
    models : tuple of ModelQuality
    """

    path: Path
    cell: float
    matched: float
    at_limits: float
    beside_jumps: float
    sigma_median_m: float
    flying_height_m: float
    models: tuple[ModelQuality, ...]

    def as_record(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "file": self.path.name,
            "cell": self.cell,
            "matched": self.matched,
            "at_limits": self.at_limits,
            "beside_jumps": self.beside_jumps,
            "sigma_median_m": self.sigma_median_m,
            "sigma_per_mille_of_flying_height": 1e3 * self.sigma_median_m / self.flying_height_m,
            "models": [model.as_record() for model in self.models],
        }


@dataclass(frozen=True, eq=False)
class MatchedPoints:
    """Object points of a window, as `kernels.intersect_matches` makes them."""

    pair: GroundPair
    match: DenseMatch
    search_px: tuple[float, float]
    points: Floats32
    photographs: NDArray[np.int16]


def surface_grid(product: StereoProduct, options: SurfaceOptions) -> ProductGrid:
    """Grid of the surface: that of the product in cells of `step_px` pixels."""
    grid, step = product.job.grid, options.dense.step_px
    cols, rows = (-(-n // step) for n in grid.size)
    # the centre of a cell is the centre of a pixel, also where the step is even
    shift = (step // 2 + 0.5 - 0.5 * step) * grid.gsd
    return ProductGrid(grid.u0 + shift, grid.v0 - shift, grid.gsd * step, (cols, rows), grid.rotation)


def match_window(product: StereoProduct, window: Window, options: SurfaceOptions) -> MatchedPoints | None:
    """Object points of a window of product pixels; None where there is no ground.

    Edges of the window belong to the margin that its matches need.
    """
    job = product.job
    pair = ground_pair(product, window)
    if pair.ground.is_void or not (pair.left_valid.any() and pair.right_valid.any()):
        return None
    rays = ray_nodes(job, pair.ground)
    low, high = search_range(product, rays, pair, options)
    match = match_dense(
        pair.left,
        pair.right,
        (low, high),
        options.dense,
        valid=(pair.left_valid, pair.right_valid),
        labels=pair.photographs[0],
    )
    points = np.empty((kernels.POINT_LAYERS, *match.parallax.shape), np.float32)
    photographs = np.empty((2, *match.parallax.shape), np.int16)
    lattice = pair.ground.lattice
    kernels.intersect_matches(
        match.parallax,
        match.row_parallax,
        match.variance,
        match.covariance,
        match.row_variance,
        pair.photographs,
        options.dense.step_px,
        options.systematic_px**2,
        method_code(job),
        pair.ground.patch,
        pair.ground.surface_nodes,
        rays,
        float(lattice.col0 - window.col0),
        float(lattice.row0 - window.row0),
        float(lattice.step),
        job.grid.gsd,
        points,
        photographs,
    )
    return MatchedPoints(pair, match, (low, high), points, photographs)


def search_range(
    product: StereoProduct, rays: Floats, pair: GroundPair, options: SurfaceOptions
) -> tuple[float, float]:
    """Least and largest residual parallax in pixels of what is looked for, over the models of a window."""
    low, high = -1.0, 1.0
    wanted, below = (m / product.job.frame.unit_m for m in (options.above_m, options.below_m))
    seen = set(np.unique(pair.photographs[0])) | set(np.unique(pair.photographs[1]))
    ground = sum(pair.ground.height_range) / 2.0
    for model in product.job.models:
        if model.right < 0 or not {model.left + 1, model.right + 1} <= seen:
            continue
        base = float((rays[model.left, ..., 0] - rays[model.right, ..., 0]).mean())
        depth = -float(rays[[model.left, model.right], ..., 2].mean()) - ground
        above = min(wanted, 0.8 * depth)
        high = max(high, base * above / (depth - above) / product.job.grid.gsd)
        low = min(low, -base * below / (depth + below) / product.job.grid.gsd)
    return low - 2.0, high + 2.0


def margin_px(product: StereoProduct, options: SurfaceOptions) -> int:
    """Pixels around a chunk whose points may lie in it."""
    job = product.job
    steepest, widest = 0.0, 0.0
    for model in job.models:
        if model.right >= 0:
            base = math.hypot(model.base_u_m, model.base_v_m)
            depth = max(model.height_above_ground_m, 1.0)
            above = min(options.above_m, 0.8 * depth)
            widest = max(widest, base * above / (depth - above))
            # common ground of two photographs lies within a base or so of both nadirs
            steepest = max(steepest, 1.2 * base / depth)
    gsd = job.grid.gsd * job.frame.unit_m
    return math.ceil((widest + steepest * options.above_m) / gsd) + options.dense.margin_px


def surface_profile() -> CogProfile:
    """How a matched surface is written."""
    return CogProfile("float32", len(BANDS), nodata=math.nan, overviews="nearest", descriptions=BANDS)


@dataclass(frozen=True, eq=False)
class SurfaceTask:
    """Makes the blobs of a chunk: `surface` and `summary`. Picklable."""

    product: StereoProduct
    plan: TilePlan
    options: SurfaceOptions
    margin: int

    def __call__(self, chunk: Chunk) -> dict[str, bytes]:
        """Match, intersect and encode one chunk."""
        values, summary = surface_window(self.product, chunk.window, self.options, self.margin)
        blob = encode_chunk(surface_profile(), self.plan, values)
        return {"surface": blob, "summary": json.dumps(summary).encode()}


def surface_window(
    product: StereoProduct, window: Window, options: SurfaceOptions, margin: int
) -> tuple[Floats32, dict[str, Any]]:
    """The surface over a window of its cells (rows, cols, bands), and what is counted for the summary."""
    step = options.dense.step_px
    around = -(-margin // step)
    wide = Window(
        (window.col0 - around) * step,
        (window.row0 - around) * step,
        (window.cols + 2 * around) * step,
        (window.rows + 2 * around) * step,
    )
    found = match_window(product, wide, options)
    out = np.full((window.rows, window.cols, len(BANDS)), np.nan, np.float32)
    if found is None:
        counts = dict.fromkeys(("common", "matched", "at_limits", "cells", "jumps"), 0)
        return out, counts | {"sigma": [0] * _SIGMA_BINS, "models": {}}
    laid = np.empty_like(out)
    room = 1.0 / product.job.frame.heights.metres_per_unit
    kernels.lay_points(found.points, found.match.correlation, step, around, around, room, laid)
    inside = (slice(around, around + window.rows), slice(around, around + window.cols))
    laid[..., ABOVE] = laid[..., HEIGHT] - found.pair.heights[step // 2 :: step, step // 2 :: step][inside]
    laid[_speckles(laid[..., ABOVE], room)] = np.nan
    kernels.fill_small_gaps(laid, _NEIGHBOURS, out)
    reach = max(1, round(0.5 * options.dense.window_px / step))
    sigma, jumps = np.empty(out.shape[:2], np.float32), np.empty(out.shape[:2], np.float32)
    kernels.add_shape(out, reach, _SMOOTHED, room, sigma, jumps)
    out[..., SIGMA], out[..., JUMP] = sigma, jumps
    known = np.isfinite(jumps)
    cells = {"cells": int(known.sum()), "jumps": int((jumps[known] > 0.0).sum())}
    return out, _counts(product, found, inside) | cells


def _speckles(above: Floats32, room: float) -> NDArray[np.bool_]:
    """Cells of small patches that stand apart from all around them: single mismatches."""
    known = np.isfinite(above)
    # OpenCV looks at whole numbers: sixteenths of the room
    steps = np.clip(np.rint(np.where(known, above, 0.0) * (16.0 / room)), -32000, 32000).astype(np.int16)
    steps[~known] = _NOTHING
    cv2.filterSpeckles(steps, _NOTHING, _SPECKLE, 16)
    return np.asarray(known & (steps == _NOTHING), np.bool_)


# Standard deviations are counted in classes of a factor.
_SIGMA_BINS: Final = 240
_SIGMA_EDGES: Final = np.geomspace(1e-4, 1e2, _SIGMA_BINS + 1)


def _counts(product: StereoProduct, found: MatchedPoints, inside: tuple[slice, slice]) -> dict[str, Any]:
    rows, cols = inside
    points, photographs = found.points[:, rows, cols], found.photographs[:, rows, cols]
    parallax = found.match.parallax[rows, cols]
    known = np.isfinite(points[kernels.SIGMA])
    step = found.pair.left.shape[0] // found.match.parallax.shape[0]
    both = (found.pair.left_valid & found.pair.right_valid)[step // 2 :: step, step // 2 :: step][rows, cols]
    gsd = product.job.grid.gsd
    tally = ModelTally(gsd)
    tally.add(photographs, points[kernels.MISS], -gsd * found.match.row_parallax[rows, cols])
    low, high = found.search_px
    near = (parallax[known] < low + 1.5) | (parallax[known] > high - 1.5)
    return {
        "common": int(both.sum()),
        "matched": int(known.sum()),
        "at_limits": int(near.sum()),
        "sigma": np.histogram(points[kernels.SIGMA][known], _SIGMA_EDGES)[0].tolist(),
        "models": tally.counts,
    }


def write_surface(
    product: StereoProduct,
    path: Path,
    options: SurfaceOptions | None = None,
    *,
    threads: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> SurfaceSummary:
    """The matched surface of a product as a Cloud Optimized GeoTIFF with the bands `BANDS`, and its summary.

    Raises
    ------
    InputError
        If the product has no stereomate, or its rasters are not there.
    """
    require_rasters(product)
    options = options or SurfaceOptions()
    grid = surface_grid(product, options)
    plan = TilePlan(grid.size, _BLOCK, 2)
    folder = path.with_name(f".{path.name}.tiles")
    with storing(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(folder, ignore_errors=True)
    ledger = Ledger.open(folder, run_key(version=__version__, surface=path.name))
    tell = progress or (lambda done, total: None)
    task = SurfaceTask(product, plan, options, margin_px(product, options))
    try:
        tiles.run(plan, task, ledger, tiles.executor_of(threads, None), lambda p: tell(p.done, p.total))
        items = {
            "TIFFTAG_SOFTWARE": f"stereomate {__version__}",
            "STEREOMATE_PRODUCT": "surface",
            "STEREOMATE_HEIGHT_MODEL_SHA256": product.height_model_hash,
            ORTHO_TAG: product.files.hashes.get(product.files.ortho, ""),
        }
        place = Georeference(product.job.frame.crs, grid.affine, items)
        assemble_cog(path, surface_profile(), plan, ledger, "surface", place)
        found = [json.loads(ledger.get(chunk.index, "summary")) for chunk in plan.chunks]
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return _summary(product, grid, path, found)


def _summary(
    product: StereoProduct, grid: ProductGrid, path: Path, found: list[dict[str, Any]]
) -> SurfaceSummary:
    job = product.job
    keys = ("common", "matched", "at_limits", "cells", "jumps")
    common, matched, limits, cells, jumps = (sum(part[k] for part in found) for k in keys)
    sigma = np.sum([part["sigma"] for part in found], axis=0)
    tally = ModelTally(job.grid.gsd)
    for part in found:
        tally.merge(part["models"])
    flying = [m.height_above_ground_m for m in job.models if m.right >= 0]
    return SurfaceSummary(
        path=path,
        cell=grid.gsd,
        matched=matched / common if common else math.nan,
        at_limits=limits / matched if matched else math.nan,
        beside_jumps=jumps / cells if cells else math.nan,
        sigma_median_m=_median_of_classes(sigma) * job.frame.heights.metres_per_unit,
        flying_height_m=float(np.median(flying)),
        models=tally.qualities([p.name for p in job.photographs], job.frame.unit_m),
    )


def _median_of_classes(counts: NDArray[np.int64]) -> float:
    if not counts.sum():
        return math.nan
    below = np.concatenate([[0.0], np.cumsum(counts)]) / counts.sum()
    return float(np.exp(np.interp(0.5, below, np.log(_SIGMA_EDGES))))
