"""The ground under a window of a product: lattice, heights at the pixels, and for a stereomate the inverse.

The window of ground that a stereomate window shows is wider than the window: it is found from the range of
heights, narrowed by the heights that are really there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stereomate.frames.lattice import Lattice, ground_lattice
from stereomate.raster import Window
from stereomate.rectify.job import RectifyJob
from stereomate.rectify.kernels.surface import invert_rows, sample_surface, tabulate_law
from stereomate.rectify.scratch import scratch
from stereomate.terrain.kernels.sampling import BILINEAR, CUBIC

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]

LAW_TABLE = 4096


@dataclass(frozen=True, eq=False)
class Ground:
    """Ground of a window of product pixels.

    Attributes
    ----------
    window : Window
        Product pixels whose ground this is (it may reach beyond the product).
    lattice : Lattice
        Of the window.
    surface_nodes : (node rows, node cols, 3)
        Position in `patch` and offset from its heights to those of the law.
    patch : (rows, cols) float64
        Heights of the height model in its own system, in the unit of the law.
    patch_origin : (int, int)
        Column and row of the patch in the height model.
    height_range : (low, high)
        Of the patch, in the law's system; NaN when it is void.
    """

    window: Window
    lattice: Lattice
    surface_nodes: Floats
    patch: Floats
    patch_origin: tuple[int, int]
    height_range: tuple[float, float]

    @property
    def is_void(self) -> bool:
        """Whether there is no ground at all."""
        return not math.isfinite(self.height_range[0])


def method_code(job: RectifyJob) -> int:
    """Kernel code of the interpolation of heights."""
    return CUBIC if job.options.heights_interpolation == "cubic" else BILINEAR


def ground_of(job: RectifyJob, window: Window, margin: int = 3) -> Ground:
    """Lattice and height patch of a window; `margin` in height-model pixels around what the window needs."""
    lattice = ground_lattice(
        job.grid.affine,
        window,
        job.frame,
        job.tangent,
        job.heights.frame,
        job.heights.affine,
        gsd=job.grid.gsd,
        height_range=job.height_range,
    )
    dem = lattice.dem
    finite = np.isfinite(dem[..., 0]) & np.isfinite(dem[..., 1])
    if not finite.any():
        return Ground(window, lattice, dem, np.full((2, 2), np.nan), (0, 0), (math.nan, math.nan))
    rows, cols = job.heights.shape
    col0 = math.floor(np.clip(dem[..., 0][finite].min(), -1e8, 1e8)) - margin
    row0 = math.floor(np.clip(dem[..., 1][finite].min(), -1e8, 1e8)) - margin
    col1 = math.ceil(np.clip(dem[..., 0][finite].max(), -1e8, 1e8)) + margin + 1
    row1 = math.ceil(np.clip(dem[..., 1][finite].max(), -1e8, 1e8)) + margin + 1
    col0, col1 = max(col0, 0), min(col1, cols)
    row0, row1 = max(row0, 0), min(row1, rows)
    if col1 - col0 < 2 or row1 - row0 < 2:
        return Ground(window, lattice, dem, np.full((2, 2), np.nan), (0, 0), (math.nan, math.nan))
    patch = height_patch(job, lattice, col0, row0, col1 - col0, row1 - row0)
    nodes = dem.copy()
    nodes[..., 0] -= col0
    nodes[..., 1] -= row0
    some = np.isfinite(patch)
    if not some.any():
        return Ground(window, lattice, nodes, patch, (col0, row0), (math.nan, math.nan))
    low = float(patch[some].min() + nodes[..., 2][finite].min())
    high = float(patch[some].max() + nodes[..., 2][finite].max())
    # Bicubic interpolation overshoots its nodes; by less than this share of their range.
    slack = 0.2 * (high - low) if method_code(job) == CUBIC else 0.0
    return Ground(window, lattice, nodes, patch, (col0, row0), (low - slack - 1e-3, high + slack + 1e-3))


def height_patch(job: RectifyJob, lattice: Lattice, col0: int, row0: int, cols: int, rows: int) -> Floats:
    """Heights of a window of the height model, in the unit of the law."""
    patch = job.heights.patch(col0, row0, cols, rows).heights
    return patch if lattice.dem_scale == 1.0 else patch * lattice.dem_scale


def heights_of(job: RectifyJob, ground: Ground, name: str) -> Floats32:
    """Heights at the pixel centres of the ground's window (a buffer of this thread)."""
    window = ground.window
    out = scratch(name, (window.rows, window.cols), np.float32)
    if ground.is_void:
        out.fill(np.nan)
        return out
    lattice = ground.lattice
    sample_surface(
        method_code(job),
        ground.patch,
        ground.surface_nodes,
        lattice.col0,
        lattice.row0,
        lattice.step,
        float(window.col0),
        float(window.row0),
        out,
    )
    return out


def shown_ground(job: RectifyJob, window: Window) -> Ground:
    """Ground that can appear in a stereomate window: at least all x with x - q(h(x)) inside it."""
    low, high = job.height_range
    ground: Ground | None = None
    # Each pass narrows the window by the heights found in the last one; two passes settle almost always.
    for _ in range(3):
        q_low, q_high = (float(q) / job.grid.gsd for q in job.law.q([low, high]))
        col0 = window.col0 + math.floor(q_low) - 2
        col1 = window.col1 + math.ceil(q_high) + 2
        wider = Window(col0, window.row0, col1 - col0, window.rows)
        if ground is not None and wider.cols > 0.8 * ground.window.cols:
            break
        ground = ground_of(job, wider)
        if ground.is_void:
            break
        low, high = max(low, ground.height_range[0]), min(high, ground.height_range[1])
    assert ground is not None
    return ground


def mate_positions(job: RectifyJob, window: Window, ground: Ground) -> tuple[Floats32, Floats32, int]:
    """Ground columns (relative to the window's first column) and heights of a stereomate window's pixels.

    Returns
    -------
    columns, heights : (rows, cols) float32
        NaN where no ground appears (buffers of this thread).
    folds : int
        Segments between neighbouring pixels over which the stereomate folds.
    """
    shape = (window.rows, window.cols)
    columns = scratch("mate columns", shape, np.float32)
    heights = scratch("mate heights", shape, np.float32)
    if ground.is_void:
        columns.fill(np.nan)
        heights.fill(np.nan)
        return columns, heights, 0
    surface = heights_of(job, ground, "mate surface")
    code, parameters = job.law.kernel_parameters()
    table = np.empty(LAW_TABLE)
    low, high = ground.height_range
    tabulate_law(code, parameters, low, high, job.grid.gsd, table)
    lattice = ground.lattice
    folds = invert_rows(
        method_code(job),
        ground.patch,
        ground.surface_nodes,
        lattice.col0,
        lattice.row0,
        lattice.step,
        table,
        low,
        high,
        surface,
        float(ground.window.col0),
        float(window.col0),
        float(window.row0),
        columns,
        heights,
    )
    return columns, heights, int(folds)
