"""Every photograph rectified on a coarse grid of bounded size: what seams and balance are decided from."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from stereomate.frames.transform import map_from_tangent
from stereomate.raster import Window
from stereomate.rectify.engine import NO_PHOTOGRAPH
from stereomate.rectify.grid import ProductGrid
from stereomate.rectify.ground import Ground, ground_of, heights_of
from stereomate.rectify.job import RectifyJob
from stereomate.rectify.kernels.warp import warp
from stereomate.rectify.layout import StereoModel
from stereomate.rectify.radiometry import Balance
from stereomate.rectify.readers import reader_of
from stereomate.rectify.resample import clear_frame, resample
from stereomate.rectify.serving import camera_nodes, models_of_window
from stereomate.tiles import Executor, map_items

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Bools = NDArray[np.bool_]

# Cells of the coarse grid at most; at least so many product pixels along the side of a cell.
CELLS: Final = 1_500_000
LEAST_FACTOR: Final = 2
# Cells along the side of the blocks that are made at once.
_BLOCK: Final = 256
# Positions in a photograph are kept as shares of its size in 16 bits.
_POSITION: Final = 65535.0


@dataclass(frozen=True, eq=False)
class PhotoOverview:
    """A photograph on the coarse grid.

    Attributes
    ----------
    window : Window
        Cells of the coarse grid.
    pixels : (rows, cols, bands)
    valid : (rows, cols) bool
    positions : (rows, cols, 2) uint16
        Column and row in the photograph as shares of its size.
    """

    window: Window
    pixels: NDArray[Any]
    valid: Bools
    positions: NDArray[np.uint16]

    def within(self, window: Window) -> tuple[NDArray[Any], Bools]:
        """Pixels and validity over any window of cells; nothing is valid outside the own one."""
        pixels = np.zeros((window.rows, window.cols, self.pixels.shape[2]), self.pixels.dtype)
        valid = np.zeros((window.rows, window.cols), np.bool_)
        common = intersection(self.window, window)
        if not common.is_empty:
            mine, there = slices_within(common, self.window), slices_within(common, window)
            pixels[there] = self.pixels[mine]
            valid[there] = self.valid[mine]
        return pixels, valid

    def shows(self, window: Window) -> Bools:
        """Validity alone, as `within`."""
        valid = np.zeros((window.rows, window.cols), np.bool_)
        common = intersection(self.window, window)
        if not common.is_empty:
            valid[slices_within(common, window)] = self.valid[slices_within(common, self.window)]
        return valid


@dataclass(frozen=True, eq=False)
class Overviews:
    """All photographs of a job on a coarse grid.

    Attributes
    ----------
    job : RectifyJob
        The job on the coarse grid.
    factor : int
        Product pixels along the side of a cell.
    photographs : tuple of PhotoOverview or None
        None for a photograph that shows nothing of the product.
    heights : (rows, cols) float32
        Ground, in the height system of the law.
    centres : (photographs, 3)
        Projection centres in cells (column, row) and their height.
    compared : dict
        Pairs of photographs that have been compared (`rectify.disagreement`): seams ask for them often.
    """

    job: RectifyJob
    factor: int
    photographs: tuple[PhotoOverview | None, ...]
    heights: Floats32
    centres: Floats
    compared: dict[tuple[int, int], tuple[Window, Floats32, Floats32]] = field(default_factory=dict)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the coarse grid."""
        cols, rows = self.job.grid.size
        return rows, cols

    def balanced(self, balance: Balance) -> Overviews:
        """The same with the photographs brought to one brightness, as floats of 32 bits."""
        done: list[PhotoOverview | None] = []
        for p, overview in enumerate(self.photographs):
            if overview is None:
                done.append(None)
                continue
            size = self.job.photographs[p].camera.size_px
            at = overview.positions * (np.asarray(size) / _POSITION)
            factor = np.exp(-balance.logarithm(p, at, size)).astype(np.float32)
            done.append(replace(overview, pixels=overview.pixels * factor))
        return replace(self, photographs=tuple(done), compared={})


def intersection(a: Window, b: Window) -> Window:
    """Common cells of two windows; empty where there are none."""
    col0, row0 = max(a.col0, b.col0), max(a.row0, b.row0)
    return Window(col0, row0, max(min(a.col1, b.col1) - col0, 0), max(min(a.row1, b.row1) - row0, 0))


def slices_within(window: Window, within: Window) -> tuple[slice, slice]:
    row, col = window.row0 - within.row0, window.col0 - within.col0
    return slice(row, row + window.rows), slice(col, col + window.cols)


def coarse_job(job: RectifyJob, cells: int = CELLS) -> tuple[RectifyJob, int]:
    """The job on a grid of at most `cells` cells with the same first corner, and the side of a cell."""
    cols, rows = job.grid.size
    factor = max(LEAST_FACTOR, math.ceil(math.sqrt(cols * rows / cells)))
    grid = replace(job.grid, gsd=job.grid.gsd * factor, size=(-(-cols // factor), -(-rows // factor)))
    return (
        replace(
            job,
            grid=grid,
            reductions=tuple(r * factor for r in job.reductions),
            models=tuple(StereoModel(p, -1) for p in range(len(job.photographs))),
            options=replace(job.options, hidden="keep", resampling="bilinear"),
            seams=None,
            balance=None,
        ),
        factor,
    )


def make_overviews(job: RectifyJob, executor: Executor | None = None, cells: int = CELLS) -> Overviews:
    """Rectify every photograph of a job on the coarse grid; blocks of cells are shared out by `executor`."""
    coarse, factor = coarse_job(job, cells)
    cols, rows = coarse.grid.size
    windows = [
        Window(c, r, min(_BLOCK, cols - c), min(_BLOCK, rows - r))
        for r in range(0, rows, _BLOCK)
        for c in range(0, cols, _BLOCK)
    ]
    blocks = map_items(_BlockTask(coarse), windows, executor)
    heights = np.full((rows, cols), np.nan, np.float32)
    parts: list[list[PhotoOverview]] = [[] for _ in coarse.photographs]
    for window, (ground, found) in zip(windows, blocks, strict=True):
        heights[slices_within(window, Window(0, 0, cols, rows))] = ground
        for p, overview in found:
            parts[p].append(overview)
    photographs = tuple(_assembled(part) if part else None for part in parts)
    return Overviews(coarse, factor, photographs, heights, _centres(coarse, coarse.grid))


def _assembled(parts: list[PhotoOverview]) -> PhotoOverview:
    col0, row0 = min(p.window.col0 for p in parts), min(p.window.row0 for p in parts)
    col1, row1 = max(p.window.col1 for p in parts), max(p.window.row1 for p in parts)
    whole = Window(col0, row0, col1 - col0, row1 - row0)
    shape = (whole.rows, whole.cols)
    pixels = np.zeros((*shape, parts[0].pixels.shape[2]), parts[0].pixels.dtype)
    valid, positions = np.zeros(shape, np.bool_), np.zeros((*shape, 2), np.uint16)
    for part in parts:
        at = slices_within(part.window, whole)
        pixels[at], valid[at], positions[at] = part.pixels, part.valid, part.positions
    return PhotoOverview(whole, pixels, valid, positions)


def _centres(job: RectifyJob, grid: ProductGrid) -> Floats:
    centres = map_from_tangent(job.tangent, job.frame, job.centres_tangent)
    return np.column_stack([grid.pixel_from_map(centres[:, :2]), centres[:, 2]])


@dataclass(frozen=True, eq=False)
class _BlockTask:
    """Makes the overviews of a block of cells; picklable."""

    job: RectifyJob

    def __call__(self, window: Window) -> tuple[Floats32, list[tuple[int, PhotoOverview]]]:
        job = self.job
        ground = ground_of(job, window)
        heights = heights_of(job, ground, "overview heights").copy()
        if ground.is_void:
            return heights, []
        nodes = camera_nodes(job, ground)
        found = []
        for model in models_of_window(job, ground, nodes):
            overview = _overview(job, ground, heights, model.left, nodes[model.left])
            if overview is not None:
                found.append((model.left, overview))
        return heights, found


def _overview(
    job: RectifyJob, ground: Ground, heights: Floats32, p: int, nodes: Floats
) -> PhotoOverview | None:
    window, lattice, photograph = ground.window, ground.lattice, job.photographs[p]
    shape = (window.rows, window.cols)
    columns = np.arange(window.cols, dtype=np.float32)[None, :] + np.float32(0.5)
    map_x, map_y = np.empty(shape, np.float32), np.empty(shape, np.float32)
    valid = np.zeros(shape, np.uint8)
    size, reduction = photograph.camera.size_px, job.reductions[p]
    shift = (size[0] // reduction // 2, size[1] // reduction // 2)
    code, parameters = photograph.camera.kernel_parameters()
    count = warp(
        columns, heights, NO_PHOTOGRAPH, 0, nodes, lattice.col0 - window.col0, lattice.row0, lattice.step,
        float(window.row0), code, parameters, float(reduction), float(shift[0]), float(shift[1]),
        map_x, map_y, valid,
    )  # fmt: skip
    if count == 0 or not clear_frame(photograph.camera, (map_x, map_y), shift, reduction, "bilinear", valid):
        return None
    share = np.stack([map_x, map_y], axis=-1) + (np.asarray(shift, np.float32) + np.float32(0.5))
    share *= np.float32(reduction) / np.asarray(size, np.float32)
    positions = np.clip(np.rint(share * _POSITION), 0, _POSITION).astype(np.uint16)
    inside = valid != 0
    extremes = tuple(float(f(m[inside])) for m in (map_x, map_y) for f in (np.min, np.max))
    pixels = np.zeros((*shape, len(job.bands)), job.dtype)
    resample(
        reader_of(photograph), job.bands, (map_x, map_y),
        (extremes[0], extremes[1], extremes[2], extremes[3]), shift, reduction, "bilinear", pixels, valid,
    )  # fmt: skip
    inside = valid != 0
    if not inside.any():
        return None
    rows, cols = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    r0, r1, c0, c1 = int(rows[0]), int(rows[-1]) + 1, int(cols[0]), int(cols[-1]) + 1
    pixels[~inside] = 0
    box = (slice(r0, r1), slice(c0, c1))
    return PhotoOverview(
        Window(window.col0 + c0, window.row0 + r0, c1 - c0, r1 - r0),
        pixels[box].copy(),
        inside[box].copy(),
        positions[box].copy(),
    )
