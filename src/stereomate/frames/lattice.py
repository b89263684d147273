"""The lattice that makes rigour cheap: exact positions on nodes every few hundred pixels, bilinear between.

A product point at map position (x, y) with height h of the law's height system is ``base(x, y) + h normal(x,
y)`` in the tangent frame, exactly linear in h along the ellipsoid normal. Between nodes both are
interpolated.

The error of bilinear interpolation over a cell of edge s is at most ``s²/8 (|P_uu| + |P_vv|)``. Along a grid
line of a conformal map ``|P_uu| <= sqrt(1/R² + |grad ln tau|²)``, and 1/R is at least ten times the other
term wherever a map projection is used for surveys; so the position is good to ``s²/(4R)``, nearly all of it
in height (the sagitta). The position in the height model bends by ``tan(latitude)/R`` at most when one of the
systems is geographic. The step is the largest power of two for which both stay below a hundredth of a pixel.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import CrsError
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import map_from_map, tangent_from_map
from stereomate.raster import Window

Array = NDArray[np.float64]
Affine = tuple[float, float, float, float, float, float]

# Largest error of interpolation, in product pixels on the ground and in pixels of the height model.
TOLERANCE_PX: Final = 0.01
_LARGEST_STEP: Final = 256
_EARTH_RADIUS_M: Final = 6.33e6  # the smallest radius of curvature there is, rounded down
_UNIT_HEIGHT: Final = 1000.0


@dataclass(frozen=True, eq=False)
class Lattice:
    """Nodes of a window of a product grid.

    Attributes
    ----------
    col0, row0, step : int
        Product pixel coordinates (corner convention) of the first node, a multiple of `step`, so that
        neighbouring windows share nodes; and the distance of nodes.
    base : (node rows, node cols, 3) float64
        Tangent coordinates of the point at height 0.
    normal : (node rows, node cols, 3) float64
        Change of the tangent coordinates per unit of height.
    dem : (node rows, node cols, 3) float64
        Column and row in the height model, and the offset from its heights to those of the law.
    dem_scale : float
        Law units per height-model unit: ``law = dem_scale * dem + offset``. 1 unless their units differ.
    """

    col0: int
    row0: int
    step: int
    base: Array
    normal: Array
    dem: Array
    dem_scale: float = 1.0


def ground_lattice(
    affine: Affine,
    window: Window,
    frame: MapFrame,
    tangent: TangentFrame,
    dem_frame: MapFrame | None = None,
    dem_affine: Affine | None = None,
    *,
    height_range: tuple[float, float] = (0.0, 0.0),
    gsd: float | None = None,
    step: int | None = None,
) -> Lattice:
    """Lattice of a window of a product.

    Parameters
    ----------
    affine : (a, b, c, d, e, f)
        Product grid: ``x = a col + b row + c``, ``y = d col + e row + f`` in map units, pixel corners at
        integers.
    window : Window
        Product pixels.
    frame : MapFrame
        The map of the product with the height system of the law.
    tangent : TangentFrame
        Frame of the ray geometry.
    dem_frame, dem_affine : optional
        Map and pixel-to-map affine of the height model. Without them the height model is taken to be in the
        map and the heights of the product, and `dem` holds map coordinates and 0.
    height_range : (low, high)
        Lowest and highest ground in the law's system: a change of datum depends (a little) on height and is
        taken in the middle.
    gsd : float, optional
        Edge of a pixel in map units; from the affine if absent.
    step : int, optional
        Distance of nodes in pixels; from `lattice_step` if absent.

    Raises
    ------
    CrsError, HeightSystemError, MissingGridError
        If a node lies outside a projection, a geoid grid or a datum transformation.
    """
    if step is None:
        step = lattice_step(affine, frame, dem_frame, dem_affine, gsd)
    col0, row0 = window.col0 // step * step, window.row0 // step * step
    cols = np.arange(col0, window.col0 + window.cols + step, step, dtype=np.float64)
    rows = np.arange(row0, window.row0 + window.rows + step, step, dtype=np.float64)
    a, b, c, d, e, f = affine
    points = np.zeros((rows.size, cols.size, 3))
    points[..., 0] = a * cols + b * rows[:, None] + c
    points[..., 1] = d * cols + e * rows[:, None] + f
    base = tangent_from_map(tangent, frame, points)
    points[..., 2] = _UNIT_HEIGHT
    normal = (tangent_from_map(tangent, frame, points) - base) / _UNIT_HEIGHT
    points[..., 2] = 0.5 * (height_range[0] + height_range[1])
    dem, scale = _height_model_position(points, frame, dem_frame, dem_affine)
    return Lattice(col0, row0, step, base, normal, dem, scale)


def _height_model_position(
    points: Array, frame: MapFrame, dem_frame: MapFrame | None, dem_affine: Affine | None
) -> tuple[Array, float]:
    dem = points.copy()
    dem[..., 2] = 0.0
    scale = 1.0
    if dem_frame is not None and dem_frame != frame:
        dem = map_from_map(dem_frame, frame, points)
        scale = dem_frame.heights.metres_per_unit / frame.heights.metres_per_unit
        dem[..., 2] = points[..., 2] - scale * dem[..., 2]
    if dem_affine is not None:
        a, b, c, d, e, f = dem_affine
        determinant = a * e - b * d
        x, y = dem[..., 0] - c, dem[..., 1] - f
        dem[..., 0], dem[..., 1] = (e * x - b * y) / determinant, (a * y - d * x) / determinant
    return dem, float(scale)


@functools.lru_cache(maxsize=64)
def lattice_step(
    affine: Affine,
    frame: MapFrame,
    dem_frame: MapFrame | None = None,
    dem_affine: Affine | None = None,
    gsd: float | None = None,
) -> int:
    """Distance of nodes in pixels, a power of two up to 256, by the bounds in the module's text.

    Raises
    ------
    CrsError
        If the product's map is geographic, or pixels are so large that even nodes at every pixel would not
        do.
    """
    gsd_m = (gsd if gsd is not None else math.hypot(affine[0], affine[3])) * frame.unit_m
    radius = _EARTH_RADIUS_M
    limit_m = math.sqrt(4.0 * radius * TOLERANCE_PX * gsd_m)
    if dem_frame is not None and dem_affine is not None and dem_frame.crs != frame.crs:
        latitude = frame.geodetic_from_map((affine[2], affine[5], 0.0))[1]
        bend = max(1.0, abs(math.tan(math.radians(latitude)))) / radius
        pixel_m = _pixel_m(dem_frame, dem_affine, float(latitude))
        limit_m = min(limit_m, math.sqrt(4.0 * TOLERANCE_PX * pixel_m / bend))
    steps = limit_m / gsd_m
    if steps < 1.0:
        raise CrsError(
            "the pixels of the product are too large for the curvature of the Earth", field="gsd", value=gsd_m
        )
    return int(min(_LARGEST_STEP, 2 ** int(math.log2(steps))))


def _pixel_m(frame: MapFrame, affine: Affine, latitude_deg: float) -> float:
    """Shorter edge of a height model's pixel in metres."""
    a, b, _, d, e, _ = affine
    if not frame.is_geographic:
        return min(math.hypot(a, d), math.hypot(b, e)) * frame.unit_m
    degree_m = math.radians(1.0) * _EARTH_RADIUS_M
    along = math.cos(math.radians(latitude_deg))
    return degree_m * min(math.hypot(a * along, d), math.hypot(b * along, e))
