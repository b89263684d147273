"""The surface that one pair of photographs shows, in cells of a map grid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stereomate.coverage.survey import Survey
from stereomate.dense.epipolar import EpipolarPair
from stereomate.dense.matching import DenseOptions, match_dense
from stereomate.errors import InputError
from stereomate.frames.transform import map_from_tangent
from stereomate.raster.windows import Window

Array = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Bytes = NDArray[np.uint8]


@dataclass(frozen=True)
class CellGrid:
    """Square cells of a surface, north up in the map.

    Attributes
    ----------
    west, north : float
        Outer corner.
    cell : float
        Edge of a cell, map units.
    size : (int, int)
        Columns and rows.
    """

    west: float
    north: float
    cell: float
    size: tuple[int, int]

    @property
    def affine(self) -> tuple[float, float, float, float, float, float]:
        """(a, b, c, d, e, f) from pixels to the map."""
        return self.cell, 0.0, self.west, 0.0, -self.cell, self.north


@dataclass(frozen=True)
class PairOptions:
    """How a pair is matched.

    Attributes
    ----------
    near, far : float
        What is looked for above and below the ground that is known beforehand, parts of the flying height
        above it.
    systematic_px : float
        Standard deviation of a parallax that the residuals of its match do not show: resampling, lens.
    dense : DenseOptions

    Raises
    ------
    InputError
        Naming the field, the rule and the value.
    """

    near: float = 0.12
    far: float = 0.06
    systematic_px: float = 0.05
    dense: DenseOptions = field(default_factory=lambda: DenseOptions(step_px=2))

    def __post_init__(self) -> None:
        for name in ("near", "far"):
            value = getattr(self, name)
            if not 0.0 < value < 0.9:
                raise InputError("must lie between 0 and 0.9", field=name, value=value)
        if not self.systematic_px >= 0.0:
            raise InputError("must be 0 or more", field="systematic_px", value=self.systematic_px)


@dataclass(frozen=True, eq=False)
class PairCells:
    """Heights of a pair in a window of the grid; NaN where it shows none.

    Attributes
    ----------
    window : Window
    heights, sigma : ndarray of float32, shape (rows, cols)
        Height system of the project.
    points : int
        Matched points they are made of.
    common : int
        Positions that both photographs show.
    row_parallax_px : float
        Median of what the orientation leaves across the rows.
    """

    window: Window
    heights: Floats32
    sigma: Floats32
    points: int
    common: int
    row_parallax_px: float


def depth_range(pair: EpipolarPair, ground: Array, options: PairOptions) -> tuple[float, float]:
    """Least and largest parallax to look for, from points of the ground (n, 3) in the tangent frame."""
    local = pair.epipolar_from_tangent(ground)
    depth = -local[:, 2]
    seen = np.ones(len(ground), dtype=np.bool_)
    for photo in (pair.left, pair.right):
        seen &= photo.camera.image_from_camera(photo.orientation.camera_from_tangent(ground))[1]
    depth = depth[seen] if seen.any() else depth
    nearest, farthest = np.percentile(depth, (1.0, 99.0))
    limits = pair.parallax(np.array([farthest * (1.0 + options.far), nearest * (1.0 - options.near)]))
    return float(limits[0]) - 1.0, float(limits[1]) + 1.0


def match_pair(
    survey: Survey,
    pair: EpipolarPair,
    grey: Callable[[str], Bytes],
    ground: Array,
    grid: CellGrid,
    options: PairOptions | None = None,
) -> PairCells:
    """Match a pair densely and lay its points into the cells of the grid.

    Parameters
    ----------
    survey : Survey
        Frames.
    pair : EpipolarPair
    grey : callable
        Name of a photograph -> its grey values, reduced.
    ground : ndarray, shape (n, 3)
        Points of the ground as known beforehand, tangent frame: they limit the search.
    grid : CellGrid
    options : PairOptions, optional
    """
    options = options or PairOptions()
    left, left_valid = pair.image(0, grey(pair.left.name))
    right, right_valid = pair.image(1, grey(pair.right.name))
    common = int(np.count_nonzero(left_valid & right_valid))
    nothing = np.empty((0, 0), np.float32)
    empty = PairCells(Window(0, 0, 0, 0), nothing, nothing, 0, common, float("nan"))
    if not common:
        return empty
    match = match_dense(
        left, right, depth_range(pair, ground, options), options.dense, valid=(left_valid, right_valid)
    )
    known = np.isfinite(match.parallax)
    if not known.any():
        return empty
    step = options.dense.step_px
    row, col = np.nonzero(known)
    across = match.row_parallax[known].astype(np.float64)
    # A parallax across the rows is shared by both rays.
    rows = row * step + step // 2 + 0.5 - 0.5 * across
    parallax = match.parallax[known].astype(np.float64)
    columns = np.asarray(col * step + step // 2 + 0.5, dtype=np.float64)
    points = pair.points(columns, rows, parallax)
    sigma_px = np.sqrt(match.variance[known].astype(np.float64) + options.systematic_px**2)
    sigma = pair.sigma_m(parallax, sigma_px) / survey.frame.heights.metres_per_unit
    good = np.isfinite(points[:, 2])
    xyz = map_from_tangent(survey.tangent, survey.frame, points[good])
    window, heights, spread = laid(xyz, sigma[good], grid)
    return PairCells(window, heights, spread, int(good.sum()), common, float(np.median(across)))


def laid(xyz: Array, sigma: Array, grid: CellGrid) -> tuple[Window, Floats32, Floats32]:
    """Points in the cells of a grid: the median height of each cell, and the mean standard deviation.

    Returns
    -------
    window : Window
        The part of the grid that holds any.
    heights, sigma : ndarray of float32, shape (rows, cols)
        NaN for cells without a point.
    """
    col = np.floor((xyz[:, 0] - grid.west) / grid.cell).astype(np.int64)
    row = np.floor((grid.north - xyz[:, 1]) / grid.cell).astype(np.int64)
    inside = (col >= 0) & (row >= 0) & (col < grid.size[0]) & (row < grid.size[1]) & np.isfinite(xyz[:, 2])
    col, row, z, sigma = col[inside], row[inside], xyz[inside, 2], sigma[inside]
    if not len(col):
        nothing = np.empty((0, 0), np.float32)
        return Window(0, 0, 0, 0), nothing, nothing
    first = int(col.min()), int(row.min())
    window = Window(first[0], first[1], int(col.max()) - first[0] + 1, int(row.max()) - first[1] + 1)
    cell = (row - window.row0) * window.cols + (col - window.col0)
    order = np.lexsort((z, cell))
    cell, z, sigma = cell[order], z[order], sigma[order]
    start = np.flatnonzero(np.concatenate([[True], cell[1:] != cell[:-1]]))
    count = np.diff(np.append(start, len(cell)))
    heights = np.full(window.rows * window.cols, np.nan, np.float32)
    spread = heights.copy()
    middle = 0.5 * (z[start + (count - 1) // 2] + z[start + count // 2])
    heights[cell[start]] = middle
    spread[cell[start]] = np.add.reduceat(sigma, start) / count
    shape = window.rows, window.cols
    return window, heights.reshape(shape), spread.reshape(shape)
