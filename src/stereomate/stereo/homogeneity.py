"""The homogeneity map of a block: by how much objects are read wrongly through the law, place by place.

For every ground position and object height both rays of the object are traced to the real height model: no
tangent plane. Needs orientation (or a planned flight) and a height model, no photographs. On a plane it is
the formula of `stereomate.parallax.homogeneity`.
"""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate import __version__
from stereomate.errors import InputError
from stereomate.parallax.laws import LawKind, ParallaxLaw
from stereomate.raster import Window
from stereomate.raster.cog import CogProfile, Georeference, assemble_cog, encode_chunk
from stereomate.raster.files import storing
from stereomate.rectify.grid import ProductGrid
from stereomate.rectify.ground import Ground, ground_of, height_patch, heights_of
from stereomate.rectify.job import RectifyJob
from stereomate.rectify.serving import (
    HIDDEN_TOLERANCE_M,
    Pixels,
    camera_nodes,
    centres_in_patch,
    models_of_window,
    serve_pixels,
    sight_bounds_of,
)
from stereomate.stereo.homogeneity_summary import HomogeneitySummary, map_counts, map_summary
from stereomate.stereo.kernels import homogeneity as kernels
from stereomate.stereo.rays import ray_nodes, steepest_tangents
from stereomate.terrain.kernels.sight import steepest_slope
from stereomate.tiles import executor as tiles
from stereomate.tiles.ledger import Ledger, run_key
from stereomate.tiles.plan import Chunk, TilePlan

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]

BANDS: Final = (
    "t_x: relative error of the residual parallax along the rows",
    "t_y: residual parallax across the rows over the ideal parallax",
    "error of the object height read through the law, metres",
    "seen: 1 by the left photograph, 2 by the right one, 3 by both",
)
# Laws are compared on every so many rows and columns.
_STRIDE: Final = 4
_MODEL_BLOCK: Final = 512


def coarse_job(job: RectifyJob, resolution: float) -> RectifyJob:
    """The same product on pixels of another size (map units), covering the same ground."""
    if not (math.isfinite(resolution) and resolution > 0.0):
        raise InputError("must be positive", field="resolution", value=resolution)
    grid = job.grid
    cols, rows = (max(1, math.ceil(n * grid.gsd / resolution - 1e-9)) for n in grid.size)
    return replace(job, grid=ProductGrid(grid.u0, grid.v0, resolution, (cols, rows), grid.rotation))


def other_laws(law: ParallaxLaw) -> tuple[ParallaxLaw, ...]:
    """The laws that a product's law is compared with, nominal values the same."""
    kinds: tuple[LawKind, ...] = ("logarithmic", "linear", "natural")
    return tuple(
        ParallaxLaw(kind, law.base_m, law.w0_m, law.reference_m) for kind in kinds if kind != law.kind
    )


@dataclass(frozen=True, eq=False)
class HomogeneityPart:
    """A window of the map: values (rows, cols, 4) as `BANDS`, and statistics of the laws (laws, 6)."""

    values: Floats32
    statistics: Floats


def homogeneity_window(
    job: RectifyJob, window: Window, object_height_m: float, laws: tuple[ParallaxLaw, ...] = ()
) -> HomogeneityPart:
    """The map over a window of the job's pixels.

    Parameters
    ----------
    job : RectifyJob
        A stereo product; its photographs need no image.
    window : Window
    object_height_m : float
        Height of the objects, unit of the project's heights.
    laws : tuple of ParallaxLaw
        Others to compare the job's law with.
    """
    out = np.full((window.rows, window.cols, 4), np.nan, np.float32)
    statistics = np.zeros((1 + len(laws), kernels.STATISTICS))
    ground = ground_of(job, window)
    if ground.is_void:
        return HomogeneityPart(out, statistics)
    nodes = camera_nodes(job, ground)
    models = models_of_window(job, ground, nodes)
    if not models:
        return HomogeneityPart(out, statistics)
    heights = heights_of(job, ground, "homogeneity heights")
    columns = np.arange(window.cols, dtype=np.float32)[None, :] + np.float32(0.5)
    serving = serve_pixels(job, ground, Pixels(window, columns, heights), models, nodes)
    model = np.ascontiguousarray(np.broadcast_to(np.asarray(serving.model, np.int16), heights.shape))
    rays = ray_nodes(job, ground)
    tangents = steepest_tangents(rays, ground, object_height_m)
    ground = _widened(job, ground, float(tangents[tangents < 1e6].max(initial=0.0)), object_height_m)
    served = np.isin(np.arange(len(job.photographs)), [p for m in models for p in (m.left, m.right)])
    hidden = served & (steepest_slope(ground.patch, *job.heights.cell_size_m) * tangents > 0.95)
    cameras = [p.camera.kernel_parameters() for p in job.photographs]
    codes, parameters = packed_laws((job.law, *laws))
    lattice = ground.lattice
    kernels.trace_window(
        heights,
        model,
        np.array([m.left for m in models]),
        np.array([m.right for m in models]),
        float(lattice.col0 - window.col0),
        float(lattice.row0),
        float(lattice.step),
        float(window.row0),
        job.grid.gsd,
        rays,
        nodes,
        np.array([code for code, _ in cameras]),
        np.array([values for _, values in cameras]),
        ground.surface_nodes,
        ground.patch,
        sight_bounds_of(ground.patch, centres_in_patch(job, ground)[hidden]),
        np.where(hidden, np.cumsum(hidden) - 1, -1),
        HIDDEN_TOLERANCE_M,
        float(object_height_m),
        job.law.base_m,
        job.law.w0_m,
        job.law.reference_m,
        codes,
        parameters,
        _STRIDE,
        out,
        statistics,
    )
    return HomogeneityPart(out, statistics)


def packed_laws(laws: tuple[ParallaxLaw, ...]) -> tuple[NDArray[np.int64], Floats]:
    """Codes (n,) and parameters (n, m) of laws, for the kernel."""
    packed = [law.kernel_parameters() for law in laws]
    parameters = np.zeros((len(packed), max(len(values) for _, values in packed)))
    for row, (_, values) in zip(parameters, packed, strict=True):
        row[: len(values)] = values
    return np.array([code for code, _ in packed]), parameters


def _widened(job: RectifyJob, ground: Ground, tangent: float, object_height_m: float) -> Ground:
    """The same ground with heights as far around as rays of objects can go, down or up."""
    low, high = job.height_range
    reach_m = (high - low + object_height_m) * tangent * job.frame.unit_m
    rows, cols = job.heights.shape
    reach = min(math.ceil(reach_m / min(job.heights.cell_size_m)) + 3, max(rows, cols))
    col, row = ground.patch_origin
    height, width = ground.patch.shape
    col0, row0 = max(col - reach, 0), max(row - reach, 0)
    col1, row1 = min(col + width + reach, cols), min(row + height + reach, rows)
    patch = height_patch(job, ground.lattice, col0, row0, col1 - col0, row1 - row0)
    surface = ground.surface_nodes.copy()
    surface[..., 0] += col - col0
    surface[..., 1] += row - row0
    return replace(ground, patch=patch, surface_nodes=surface, patch_origin=(col0, row0))


def map_profile() -> CogProfile:
    """How a homogeneity map is written."""
    return CogProfile(
        "float32", 4, nodata=math.nan, overviews="nearest", descriptions=BANDS, statistics=False
    )


@dataclass(frozen=True, eq=False)
class HomogeneityTask:
    """Makes the blobs of a chunk: `map` and `summary`. Picklable."""

    job: RectifyJob
    plan: TilePlan
    object_height_m: float

    def __call__(self, chunk: Chunk) -> dict[str, bytes]:
        """Trace and encode one chunk."""
        part = homogeneity_window(self.job, chunk.window, self.object_height_m, other_laws(self.job.law))
        blob = encode_chunk(map_profile(), self.plan, part.values)
        summary = {"statistics": part.statistics.tolist(), **map_counts(part.values)}
        return {"map": blob, "summary": json.dumps(summary).encode()}


def write_homogeneity(
    job: RectifyJob,
    path: Path,
    object_height_m: float,
    *,
    threads: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> HomogeneitySummary:
    """The homogeneity map of a product as a Cloud Optimized GeoTIFF, and its summary.

    Parameters
    ----------
    job : RectifyJob
        Its grid is that of the map: see `coarse_job`.
    path : Path
    object_height_m : float
    threads : int
    progress : callable, optional
        Called with chunks done and all chunks.

    Raises
    ------
    InputError
        If the product has no stereomate, or the object height is not positive or reaches the cameras.
    """
    _check(job, object_height_m)
    plan = TilePlan(job.grid.size, _MODEL_BLOCK, 2)
    folder = path.with_name(f".{path.name}.tiles")
    with storing(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(folder, ignore_errors=True)
    ledger = Ledger.open(folder, run_key(version=__version__, homogeneity=object_height_m))
    tell = progress or (lambda done, total: None)
    try:
        tiles.run(
            plan,
            HomogeneityTask(job, plan, object_height_m),
            ledger,
            tiles.executor_of(threads, None),
            lambda p: tell(p.done, p.total),
        )
        place = Georeference(
            job.frame.crs,
            job.grid.affine,
            {
                "TIFFTAG_SOFTWARE": f"stereomate {__version__}",
                "STEREOMATE_OBJECT_HEIGHT": f"{object_height_m:g}",
                "STEREOMATE_LAW": job.law.kind,
            },
        )
        assemble_cog(path, map_profile(), plan, ledger, "map", place)
        found = [json.loads(ledger.get(chunk.index, "summary")) for chunk in plan.chunks]
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return map_summary(job, (job.law, *other_laws(job.law)), object_height_m, found, path)


def summarize(job: RectifyJob, object_height_m: float) -> HomogeneitySummary:
    """The summary alone, of a map that fits into memory."""
    _check(job, object_height_m)
    cols, rows = job.grid.size
    part = homogeneity_window(job, Window(0, 0, cols, rows), object_height_m, other_laws(job.law))
    found = {"statistics": part.statistics.tolist(), **map_counts(part.values)}
    return map_summary(job, (job.law, *other_laws(job.law)), object_height_m, [found], None)


# Height model nodes of a window of an overview, at most.
_OVERVIEW_NODES: Final = 4_000_000


def overview(
    job: RectifyJob, object_height_m: float, longest: int
) -> tuple[RectifyJob, Floats32, HomogeneitySummary]:
    """A map of at most `longest` columns and rows in memory, with the job of its pixels, and its summary.

    Window by window, so that the part of the height model in memory stays small however coarse the pixels.
    """
    _check(job, object_height_m)
    grid = job.grid
    coarse = coarse_job(job, grid.gsd * max(1.0, max(grid.size) / longest))
    cell = coarse.grid.gsd * job.frame.unit_m / job.heights.resolution_m
    side = int(min(max(math.sqrt(_OVERVIEW_NODES) / max(cell, 1e-9), 8.0), longest))
    cols, rows = coarse.grid.size
    values, found = np.full((rows, cols, len(BANDS)), np.nan, np.float32), []
    for row0 in range(0, rows, side):
        for col0 in range(0, cols, side):
            window = Window(col0, row0, min(side, cols - col0), min(side, rows - row0))
            part = homogeneity_window(coarse, window, object_height_m, other_laws(job.law))
            values[row0 : window.row1, col0 : window.col1] = part.values
            found.append({"statistics": part.statistics.tolist(), **map_counts(part.values)})
    return (
        coarse,
        values,
        map_summary(coarse, (coarse.law, *other_laws(coarse.law)), object_height_m, found, None),
    )


def _check(job: RectifyJob, object_height_m: float) -> None:
    if not job.is_stereo:
        raise InputError("must have a stereomate", field="product", value=job.name)
    if not (math.isfinite(object_height_m) and 0.0 < object_height_m < job.law.w0_m):
        raise InputError(
            "must be positive and below the flying height", field="object_height", value=object_height_m
        )
