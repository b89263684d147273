"""Check of a product's height model by the product itself, and a corrected one.

What the matched surface has above the height model on open ground is the model's error. Cell by cell of the
height model: its correction, standard deviation, and the ground cells it rests on. The corrected model has
the correction added where there is ground, carried on under objects from the ground around them, and nowhere
else.
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
from stereomate.dense.ground_filter import GroundOptions, ground_cells
from stereomate.frames.transform import map_from_map
from stereomate.raster import Window, open_photo
from stereomate.raster.cog import CogProfile, Georeference, assemble_cog, encode_chunk
from stereomate.raster.files import storing
from stereomate.rectify.job import RectifyJob
from stereomate.stereo.matched_surface import SurfaceOptions, surface_grid
from stereomate.stereo.product import StereoProduct
from stereomate.stereo.surface_bands import ABOVE, SIGMA
from stereomate.tiles import executor as tiles
from stereomate.tiles.ledger import Ledger, run_key
from stereomate.tiles.plan import Chunk, TilePlan

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]

BANDS: Final = (
    "correction: matched ground minus height model, metres",
    "standard deviation of the correction, metres",
    "cells of ground it rests on",
)
NMAD: Final = 1.4826
_BLOCK: Final = 512
# Ground is told from objects on cells of about this size, metres, but not finer than two of the surface.
_GROUND_CELL_M: Final = 2.0
_LIMITS_M: Final = 200.0
_CLASSES: Final = 40_000


@dataclass(frozen=True)
class TerrainOptions:
    """How a height model is checked and corrected.

    Attributes
    ----------
    ground : GroundOptions
    reach_m : float
        The correction is carried this far from ground into places without any.
    least_correlation : float
        Weaker matches are not used.
    surface : SurfaceOptions
        Those that the matched surface was made with.
    """

    ground: GroundOptions = field(default_factory=GroundOptions)
    reach_m: float = 60.0
    least_correlation: float = 0.7
    surface: SurfaceOptions = field(default_factory=SurfaceOptions)


@dataclass(frozen=True)
class TerrainSummary:
    """The error of a height model on open ground: matched ground minus model, metres.

    Attributes
    ----------
    path : Path
        The map of corrections.
    repaired : Path or None
        The corrected height model.
    nodes : int
        Cells of the height model that were checked.
    ground : float
        Share of the matched surface that is open ground.
    mean_m, median_m, rms_m, nmad_m : float
        Of the corrections.
    sigma_m : float
        rms of their standard deviations.
    tilt_per_mille : (float, float)
        Rise of the correction to the east and to the north.
    """

    path: Path
    repaired: Path | None
    nodes: int
    ground: float
    mean_m: float
    median_m: float
    rms_m: float
    nmad_m: float
    sigma_m: float
    tilt_per_mille: tuple[float, float]

    def as_record(self) -> dict[str, Any]:
        """Plain values."""
        return {
            **vars(self),
            "path": self.path.name,
            "repaired": None if self.repaired is None else str(self.repaired),
            "tilt_per_mille": list(self.tilt_per_mille),
        }


def map_profile() -> CogProfile:
    """How the map of corrections is written."""
    return CogProfile("float32", len(BANDS), nodata=math.nan, overviews="nearest", descriptions=BANDS)


def model_profile() -> CogProfile:
    """How a corrected height model is written."""
    return CogProfile("float32", 1, nodata=math.nan, descriptions=("height",))


@dataclass(frozen=True, eq=False)
class TerrainTask:
    """Makes the blobs of a chunk of the height model: `map`, `model` and `summary`. Picklable."""

    product: StereoProduct
    surface: Path
    plan: TilePlan
    options: TerrainOptions

    def __call__(self, chunk: Chunk) -> dict[str, bytes]:
        """Check and correct one chunk."""
        job, window = self.product.job, chunk.window
        nodes, counts = corrections(self.product, self.surface, window, self.options)
        heights = job.heights.patch(window.col0, window.row0, window.cols, window.rows).heights
        inner = (slice(_apron(job, self.options), None),) * 2
        shape = (window.rows, window.cols)
        inside = nodes[inner][: shape[0], : shape[1]]
        filled = carried(nodes, _apron(job, self.options))[inner][: shape[0], : shape[1]]
        # corrections are metres; heights are in the unit of the model's own system
        unit = job.heights.frame.heights.metres_per_unit
        corrected = heights + np.where(np.isfinite(filled), filled, 0.0) / unit
        return {
            "map": encode_chunk(map_profile(), self.plan, np.ascontiguousarray(inside, np.float32)),
            "model": encode_chunk(model_profile(), self.plan, corrected.astype(np.float32)[..., None]),
            "summary": json.dumps(counts | _figures(inside, window)).encode(),
        }


def _apron(job: RectifyJob, options: TerrainOptions) -> int:
    """Nodes around a chunk from which corrections are carried into it."""
    return math.ceil(options.reach_m / min(job.heights.cell_size_m)) + 1


def corrections(
    product: StereoProduct, surface: Path, window: Window, options: TerrainOptions
) -> tuple[Floats, dict[str, int]]:
    """Corrections at the nodes of a window of the height model and its apron: (rows, cols, 3) as `BANDS`."""
    job = product.job
    apron = _apron(job, options)
    nodes = Window(window.col0 - apron, window.row0 - apron, window.cols + 2 * apron, window.rows + 2 * apron)
    shape = (nodes.rows, nodes.cols)
    out = np.full((*shape, 3), np.nan)
    place = _surface_window(product, nodes, options)
    grid = surface_grid(product, options.surface)
    wanted = place.clamped(grid.size)
    if wanted.is_empty:
        return out, {"surface": 0, "ground": 0}
    with open_photo(surface) as raster:
        values, _ = raster.read_window(*wanted)
    above, sigma, mesh = _ground_raster(job, values, grid.gsd, options)
    cell_m = grid.gsd * mesh * job.frame.unit_m
    ground = ground_cells(above, cell_m, options.ground)
    row, col = np.nonzero(ground)
    counts = {"surface": int(np.isfinite(above).sum()), "ground": len(row)}
    if len(row) == 0:
        return out, counts
    pixels = np.stack([wanted.col0 + mesh * (col + 0.5), wanted.row0 + mesh * (row + 0.5)], axis=-1)
    at = _in_height_model(job, grid.map_from_pixel(pixels)) - 0.5 - np.array([nodes.col0, nodes.row0])
    return _on_nodes(at, above[ground], sigma[ground], shape), counts


def _surface_window(product: StereoProduct, nodes: Window, options: TerrainOptions) -> Window:
    """Cells of the surface over a window of the height model, with room for the ground filter."""
    job = product.job
    share = np.linspace(0.0, 1.0, 5)
    c, r = np.meshgrid(nodes.col0 + share * nodes.cols, nodes.row0 + share * nodes.rows)
    xy = job.heights.map_from_pixel(np.stack([c, r], axis=-1).reshape(-1, 2))
    if job.heights.frame != job.frame:
        xy = map_from_map(job.frame, job.heights.frame, np.column_stack([xy, np.zeros(len(xy))]))[:, :2]
    grid = surface_grid(product, options.surface)
    at = grid.pixel_from_map(xy)
    room = options.ground.largest_object_m / (grid.gsd * job.frame.unit_m) + 4.0
    low, high = np.floor(at.min(axis=0) - room).astype(int), np.ceil(at.max(axis=0) + room).astype(int)
    return Window(int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1]))


def _ground_raster(
    job: RectifyJob, values: Floats32, cell: float, options: TerrainOptions
) -> tuple[Floats32, Floats32, int]:
    """Medians of the surface over square cells, metres above the height model; sigmas; cells on a side."""
    unit = job.frame.heights.metres_per_unit
    cell_m = cell * job.frame.unit_m
    wanted = max(2.0 * cell_m, min(0.5 * min(job.heights.cell_size_m), _GROUND_CELL_M))
    mesh = max(1, round(wanted / cell_m))
    rows, cols = (n // mesh for n in values.shape[:2])
    good = values[: rows * mesh, : cols * mesh]
    above = np.where(good[..., 4] >= options.least_correlation, good[..., ABOVE], np.nan) * unit
    blocks = above.reshape(rows, mesh, cols, mesh).swapaxes(1, 2).reshape(rows, cols, mesh * mesh)
    sigmas = good[..., SIGMA].reshape(rows, mesh, cols, mesh).swapaxes(1, 2).reshape(rows, cols, mesh * mesh)
    order = np.sort(blocks, axis=2)
    count = np.isfinite(order).sum(axis=2)
    middle = np.take_along_axis(order, np.maximum((count - 1) // 2, 0)[..., None], axis=2)[..., 0]
    other = np.take_along_axis(order, np.maximum(count // 2, 0)[..., None].clip(max=mesh * mesh - 1), axis=2)
    median = np.where(count % 2 == 1, middle, 0.5 * (middle + other[..., 0]))
    enough = 2 * count > mesh * mesh
    spread = np.sqrt(np.nanmean(np.where(np.isfinite(blocks), sigmas, 0.0) ** 2, axis=2)) * unit
    return np.where(enough, median, np.nan).astype(np.float32), spread.astype(np.float32), mesh


def _in_height_model(job: RectifyJob, xy: Floats) -> Floats:
    if job.heights.frame != job.frame:
        middle = 0.5 * (job.height_range[0] + job.height_range[1])
        points = np.column_stack([xy, np.full(len(xy), middle)])
        xy = map_from_map(job.heights.frame, job.frame, points)[:, :2]
    return job.heights.pixel_from_map(xy)


def _on_nodes(at: Floats, values: Floats32, sigma: Floats32, shape: tuple[int, int]) -> Floats:
    """Weighted means at nodes of what lies within one mesh of them, weights falling linearly."""
    total = np.zeros((4, shape[0] * shape[1]))
    first = np.floor(at).astype(np.int64)
    part = at - first
    weight = 1.0 / np.maximum(sigma.astype(np.float64), 1e-3) ** 2
    for di in range(2):
        for dj in range(2):
            j, i = first[:, 0] + dj, first[:, 1] + di
            inside = (j >= 0) & (i >= 0) & (j < shape[1]) & (i < shape[0])
            share = np.abs(1 - dj - part[:, 0]) * np.abs(1 - di - part[:, 1])
            w = (share * weight)[inside]
            place = (i * shape[1] + j)[inside]
            for k, v in enumerate((w, w * values[inside], w * sigma[inside], share[inside])):
                total[k] += np.bincount(place, v, total.shape[1])
    out = np.full((shape[0] * shape[1], 3), np.nan)
    # what touches a node only from the edge of its mesh says little about it
    known = total[3] > 0.2
    out[known, 0] = total[1, known] / total[0, known]
    out[known, 1] = total[2, known] / total[0, known]
    out[known, 2] = total[3, known]
    return out.reshape(*shape, 3)


def carried(nodes: Floats, reach: int) -> Floats:
    """Corrections (rows, cols), gaps filled from ever wider surroundings up to `reach` nodes; NaN beyond."""
    known = np.isfinite(nodes[..., 0])
    weight = np.where(known, 1.0 / np.maximum(nodes[..., 1], 1e-3) ** 2, 0.0)
    sums = np.stack([weight, weight * np.where(known, nodes[..., 0], 0.0)], axis=-1)
    out = np.where(known, nodes[..., 0], np.nan)
    radius = 1
    while radius <= reach:
        size = (2 * radius + 1, 2 * radius + 1)
        around = cv2.boxFilter(sums, -1, size, normalize=False, borderType=cv2.BORDER_CONSTANT)
        missing = np.isnan(out) & (around[..., 0] > 1e-9)
        out[missing] = around[missing, 1] / around[missing, 0]
        radius *= 2
    # what is carried far fades out: no cliffs where the correction ends
    distance = cv2.distanceTransform((~known).astype(np.uint8), cv2.DIST_L2, 5)
    return np.asarray(out * np.clip(2.0 * (1.0 - distance / max(reach, 1)), 0.0, 1.0))


def _figures(nodes: Floats, window: Window) -> dict[str, Any]:
    """Sums over the checked nodes of a chunk."""
    known = np.isfinite(nodes[..., 0])
    row, col = np.nonzero(known)
    e, s = nodes[known][:, 0], nodes[known][:, 1]
    x, y = col + float(window.col0), row + float(window.row0)
    design = np.stack([np.ones_like(x), x, y])
    return {
        "nodes": len(e),
        "sums": [float(e.sum()), float(np.sum(e**2)), float(np.sum(s**2))],
        "normal": (design @ design.T).tolist(),
        "rhs": (design @ e).tolist(),
        "histogram": np.histogram(np.clip(e, -_LIMITS_M, _LIMITS_M), _CLASSES, (-_LIMITS_M, _LIMITS_M))[
            0
        ].tolist(),
    }


def check_terrain(
    product: StereoProduct,
    surface: Path,
    path: Path,
    options: TerrainOptions | None = None,
    *,
    repaired: Path | None = None,
    threads: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> TerrainSummary:
    """The map of corrections of a product's height model, and the corrected model on request.

    Parameters
    ----------
    product : StereoProduct
    surface : Path
        Its matched surface, as `matched_surface.write_surface` makes it.
    path : Path
        The map: a Cloud Optimized GeoTIFF on the grid of the height model with the bands `BANDS`.
    repaired : Path, optional
        Where the corrected height model goes: same grid, CRS, height system and unit.

    Raises
    ------
    ImageError
        If the surface cannot be read.
    """
    options = options or TerrainOptions()
    model = product.job.heights
    plan = TilePlan((model.shape[1], model.shape[0]), _BLOCK, 2)
    folder = path.with_name(f".{path.name}.tiles")
    with storing(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(folder, ignore_errors=True)
    ledger = Ledger.open(folder, run_key(version=__version__, terrain=path.name))
    tell = progress or (lambda done, total: None)
    try:
        task = TerrainTask(product, surface, plan, options)
        tiles.run(plan, task, ledger, tiles.executor_of(threads, None), lambda p: tell(p.done, p.total))
        items = {"TIFFTAG_SOFTWARE": f"stereomate {__version__}", "STEREOMATE_PRODUCT": "terrain check"}
        place = Georeference(model.frame.crs, model.affine, items)
        assemble_cog(path, map_profile(), plan, ledger, "map", place)
        if repaired is not None:
            items = items | {"STEREOMATE_PRODUCT": "corrected height model"}
            place = Georeference(model.frame.crs, model.affine, items)
            assemble_cog(repaired, model_profile(), plan, ledger, "model", place)
        found = [json.loads(ledger.get(chunk.index, "summary")) for chunk in plan.chunks]
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return _summary(product.job, found, path, repaired)


def _summary(
    job: RectifyJob, found: list[dict[str, Any]], path: Path, repaired: Path | None
) -> TerrainSummary:
    n = sum(part["nodes"] for part in found)
    sums = np.sum([part["sums"] for part in found], axis=0)
    surface, ground = (sum(part[k] for part in found) for k in ("surface", "ground"))
    histogram = np.sum([part["histogram"] for part in found], axis=0)
    nan = math.nan
    if n < 4:
        return TerrainSummary(path, repaired, n, 0.0, nan, nan, nan, nan, nan, (nan, nan))
    median, nmad = _robust(histogram)
    normal = np.sum([part["normal"] for part in found], axis=0)
    plane = np.linalg.lstsq(normal, np.sum([part["rhs"] for part in found], axis=0), rcond=None)[0]
    a, b, _, d, e, _ = job.heights.affine
    cells = np.array([[a, b], [d, e]]) * job.heights.frame.unit_m
    by_map = np.linalg.solve(cells.T, plane[1:])
    return TerrainSummary(
        path=path,
        repaired=repaired,
        nodes=n,
        ground=ground / surface if surface else nan,
        mean_m=float(sums[0] / n),
        median_m=median,
        rms_m=float(np.sqrt(sums[1] / n)),
        nmad_m=nmad,
        sigma_m=float(np.sqrt(sums[2] / n)),
        tilt_per_mille=(1e3 * float(by_map[0]), 1e3 * float(by_map[1])),
    )


def _robust(histogram: NDArray[np.int64]) -> tuple[float, float]:
    edges = np.linspace(-_LIMITS_M, _LIMITS_M, _CLASSES + 1)
    below = np.concatenate([[0.0], np.cumsum(histogram)]) / histogram.sum()
    median = float(np.interp(0.5, below, edges))
    distances = np.linspace(0.0, 2.0 * _LIMITS_M, 4 * _CLASSES)
    within = np.interp(median + distances, edges, below) - np.interp(median - distances, edges, below)
    return median, NMAD * float(np.interp(0.5, within, distances))
