"""The choice of a law for a planned product, from its own models, ground and flying heights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import CoverageError, InputError
from stereomate.parallax.choice import BlockSamples, LawChoice, Screen, choose_law
from stereomate.raster import Window
from stereomate.rectify.ground import ground_of, heights_of
from stereomate.rectify.job import RectifyJob
from stereomate.rectify.serving import Pixels, camera_nodes, models_of_window, serve_pixels
from stereomate.stereo.homogeneity import coarse_job
from stereomate.stereo.rays import ray_nodes
from stereomate.stereo.surface import JobSurface

Floats = NDArray[np.float64]

# Positions along the longer side of a product.
_SAMPLES: Final = 160


@dataclass(frozen=True, eq=False)
class SampledBlock:
    """Positions of a product that a model serves.

    Attributes
    ----------
    samples : BlockSamples
    rows, cols : ndarray of int (n,)
        Of the samples in a coarse raster of the product.
    shape : (int, int)
        Rows and columns of that raster.
    """

    samples: BlockSamples
    rows: NDArray[np.int64]
    cols: NDArray[np.int64]
    shape: tuple[int, int]

    def raster(self, values: Floats) -> Floats:
        """Values (n,) of the samples as a raster; NaN where no model serves."""
        out = np.full(self.shape, np.nan)
        out[self.rows, self.cols] = values
        return out


def sample_block(job: RectifyJob) -> SampledBlock:
    """Height, base along the rows, depth and slope of the ground over the area of a product.

    Raises
    ------
    InputError
        If the product has no stereomate.
    CoverageError
        If no model serves any ground.
    """
    if not job.is_stereo:
        raise InputError("must have a stereomate", field="product", value=job.name)
    cols, rows = job.grid.size
    coarse = coarse_job(job, max(cols, rows) * job.grid.gsd / _SAMPLES)
    window = Window(0, 0, *coarse.grid.size)
    ground = ground_of(coarse, window)
    nodes = camera_nodes(coarse, ground)
    models = models_of_window(coarse, ground, nodes)
    shape = (window.rows, window.cols)
    heights = heights_of(coarse, ground, "law heights").copy()
    index = np.full(shape, -1)
    if models and not ground.is_void:
        columns = np.arange(window.cols, dtype=np.float32)[None, :] + np.float32(0.5)
        serving = serve_pixels(coarse, ground, Pixels(window, columns, heights), models, nodes)
        index = np.array(np.broadcast_to(serving.model, shape), np.int64)
    stereo = np.array([m.right >= 0 for m in models] + [False])
    row, col = np.nonzero(stereo[index] & np.isfinite(heights))
    uv = coarse.grid.uv_from_map(coarse.grid.map_from_pixel(np.stack([col, row], axis=-1) + 0.5))
    exact = JobSurface(coarse).heights(uv)
    known = np.isfinite(exact).all(axis=1)
    row, col, exact = row[known], col[known], exact[known]
    if row.size == 0:
        raise CoverageError("has no ground that a model serves", field="product", value=job.name)
    centres = -ray_nodes(coarse, ground)[..., 2].mean(axis=(1, 2))
    chosen = [models[k] for k in index[row, col]]
    unit = job.frame.unit_m
    depth = np.array([0.5 * (centres[m.left] + centres[m.right]) for m in chosen]) - exact[:, 0]
    base = np.array([m.base_u_m for m in chosen]) / unit
    return SampledBlock(BlockSamples(exact[:, 0], base, depth, exact[:, 1]), row, col, shape)


def choose_law_of(
    job: RectifyJob, screen: Screen | None = None, object_height_m: float = 20.0
) -> tuple[SampledBlock, LawChoice]:
    """All laws assessed for a product, and the one to take."""
    block = sample_block(job)
    law = job.law
    nominal = (law.base_m, law.w0_m, law.reference_m)
    return block, choose_law(block.samples, nominal, job.grid.gsd, screen, object_height_m)
