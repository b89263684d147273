"""A surface from the adjusted tie points, for projects that have no height model.

Triangulated and interpolated linearly; points that stand out from all their neighbours are left out, beyond
the outermost points the nearest one stands in. It is as coarse as the tie points are apart: enough to make an
orthophoto of open ground, not to show buildings.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from stereomate.frames.transform import map_from_tangent
from stereomate.project.orient_adjust import Adjusted
from stereomate.project.orient_inputs import OrientInputs
from stereomate.raster.cog import CogProfile, Georeference, assemble_cog, encode_chunk
from stereomate.tiles.ledger import Ledger, run_key
from stereomate.tiles.plan import TilePlan

Array = NDArray[np.float64]

SURFACE: Final = "surface.tif"
_NEIGHBOURS: Final = 9
_LEAST_POINTS: Final = 20
_LARGEST_GRID: Final = 4000
# Parts of the extent of the points by which the surface is continued for the photographs' margins.
_MARGIN: Final = 0.35
_SMOOTHING_CELLS: Final = 8.0


def write_tie_surface(out: Path, inputs: OrientInputs, adjusted: Adjusted) -> tuple[Path, str] | None:
    """Write the surface as a COG; returns the file and what it is in words, None for too few points."""
    if not adjusted.has_datum or inputs.tangent is None:
        return None
    points = adjusted.result.points
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < _LEAST_POINTS:
        return None
    xyz = map_from_tangent(inputs.tangent, inputs.frame, points)
    kept = xyz[fits_neighbours(xyz)]
    origin, step, heights = interpolated(kept)
    rows, cols = heights.shape
    plan = TilePlan((cols, rows), 256, 2)
    profile = CogProfile("float32", 1, nodata=-9999.0)
    folder = out / ".surface"
    ledger = Ledger.open(folder, run_key(surface=heights.tobytes().hex()[:64], shape=heights.shape))
    for chunk in plan.chunks:
        w = chunk.window
        part = heights[w.row0 : w.row0 + w.rows, w.col0 : w.col0 + w.cols]
        blob = encode_chunk(profile, plan, np.ascontiguousarray(part[..., None], dtype=np.float32))
        ledger.put(chunk.index, {"surface": blob})
    place = Georeference(inputs.frame.crs, (step, 0.0, origin[0], 0.0, -step, origin[1]))
    assemble_cog(out / SURFACE, profile, plan, ledger, "surface", place)
    shutil.rmtree(folder, ignore_errors=True)
    words = (
        f"no height model: a surface was interpolated from {len(kept)} tie points "
        f"({len(xyz) - len(kept)} left out), "
        f"about {_spacing(kept):.1f} m apart; buildings and trees are not in it as they are"
    )
    return out / SURFACE, words


def fits_neighbours(xyz: Array) -> NDArray[np.bool_]:
    """Points whose height lies among those of their neighbours."""
    count = min(_NEIGHBOURS, len(xyz))
    _, nearest = cKDTree(xyz[:, :2]).query(xyz[:, :2], count)
    heights = xyz[np.asarray(nearest).reshape(len(xyz), -1)[:, 1:], 2]
    middle = np.median(heights, axis=1)
    spread = 1.4826 * np.median(np.abs(heights - middle[:, None]), axis=1)
    # Ground that is flat to the millimetre is not: no tighter than the common scatter.
    spread = np.maximum(spread, float(np.median(spread)))
    return np.asarray(np.abs(xyz[:, 2] - middle) <= 4.0 * np.maximum(spread, 1e-6))


def interpolated(xyz: Array) -> tuple[tuple[float, float], float, Array]:
    """Outer corner (west, north), pitch and heights of a grid over the points."""
    low, high = xyz[:, :2].min(axis=0), xyz[:, :2].max(axis=0)
    margin = _MARGIN * (high - low)
    low, high = low - margin, high + margin
    step = max(_spacing(xyz) / 3.0, float((high - low).max()) / _LARGEST_GRID)
    west, north = np.floor(low[0] / step) * step, np.ceil(high[1] / step) * step
    cols, rows = int((high[0] - west) / step) + 1, int((north - low[1]) / step) + 1
    x = west + (np.arange(cols) + 0.5) * step
    y = north - (np.arange(rows) + 0.5) * step
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    # Shifted to the points' middle: map coordinates would lose digits in the triangulation.
    middle = xyz[:, :2].mean(axis=0)
    heights = LinearNDInterpolator(xyz[:, :2] - middle, xyz[:, 2])(grid - middle)
    outside = np.isnan(heights)
    heights[outside] = NearestNDInterpolator(xyz[:, :2] - middle, xyz[:, 2])(grid[outside] - middle)
    # Steps between the regions of two outermost points would tear the products there.
    heights[outside] = gaussian_filter(heights, _SMOOTHING_CELLS)[outside]
    return (float(west), float(north)), step, np.asarray(heights, dtype=np.float64)


def _spacing(xyz: Array) -> float:
    """Median distance to the nearest other point."""
    distance, _ = cKDTree(xyz[:, :2]).query(xyz[:, :2], 2)
    return max(float(np.median(np.asarray(distance)[:, 1])), 1e-3)
