"""Orientations that come from an adjustment in the map grid, turned into true positions.

A bundle adjusted in the grid with a fixed principal distance takes its scale from the plan of the control, so
its centres' heights above the control are tau_e times too large (georeferencing theory, sections 2 and 9):
equation (2), ``(tau_e - 1)(H_centre - H_control)``. Read as true positions they put every point that much too
high.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import HeightSystemError
from stereomate.frames.factors import effective_scale, gauss_radius, grid_factors_geodetic
from stereomate.frames.mapframe import MapFrame

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class GridAdjustment:
    """What becomes of centres adjusted in the grid.

    Attributes
    ----------
    centres : ndarray (..., 3)
        True positions in map coordinates and heights of the frame: the heights are changed, nothing else.
    effective_scale : ndarray (...)
        tau_e at the reference height below each centre.
    shift_m : ndarray (...)
        True minus written height: minus (tau_e - 1) H, H being the true height above the reference.
    reference_height : float
        In the height system of the frame.
    """

    centres: Array
    effective_scale: Array
    shift_m: Array
    reference_height: float

    def uncertainty_m(self, relief_m: float) -> float:
        """Error of the true heights if the control lay up to `relief_m` off the reference: |tau_e - 1| x
        relief."""
        return float(np.abs(self.effective_scale - 1.0).max(initial=0.0) * abs(relief_m))


def space_from_grid_centres(
    frame: MapFrame, centres: ArrayLike, grid_reference_height: float
) -> GridAdjustment:
    """True projection centres from those of an adjustment in the map grid.

    Parameters
    ----------
    frame : MapFrame
        Map and height system of the centres.
    centres : array_like (..., 3)
        As delivered.
    grid_reference_height : float
        Height of the control in the same system: the mean of the control points, else the mean terrain.

    Raises
    ------
    CrsError
        If the map is geographic or not conformal.
    HeightSystemError
        If a centre is not above the reference height.
    """
    delivered = np.array(centres, dtype=np.float64)
    above = delivered[..., 2] - grid_reference_height
    if np.any(above <= 0.0):
        raise HeightSystemError(
            "projection centres lie above the height of the control",
            field="grid_reference_height",
            value=float(grid_reference_height),
            hint=f"the lowest centre is at {float(delivered[..., 2].min()):.1f}",
        )
    tau_e = effective_scale_at(frame, delivered[..., :2], grid_reference_height)
    shift = above / tau_e - above
    delivered[..., 2] += shift
    return GridAdjustment(
        delivered, tau_e, shift * frame.heights.metres_per_unit, float(grid_reference_height)
    )


def grid_from_space_centres(frame: MapFrame, centres: ArrayLike, grid_reference_height: float) -> Array:
    """Centres as an adjustment in the grid writes them: the inverse of `space_from_grid_centres`."""
    true = np.array(centres, dtype=np.float64)
    tau_e = effective_scale_at(frame, true[..., :2], grid_reference_height)
    true[..., 2] = grid_reference_height + (true[..., 2] - grid_reference_height) * tau_e
    return true


def grid_height_excess_m(frame: MapFrame, centres: ArrayLike, grid_reference_height: float) -> Array:
    """(tau_e - 1) H in metres, signed: how far the two meanings of `adjusted_in` lie apart at each centre.

    Positive: read as true positions, a grid adjustment puts points too high.
    """
    points = np.asarray(centres, dtype=np.float64)
    tau_e = effective_scale_at(frame, points[..., :2], grid_reference_height)
    above = points[..., 2] - grid_reference_height
    excess: Array = (above - above / tau_e) * frame.heights.metres_per_unit
    return excess


def effective_scale_at(frame: MapFrame, xy: ArrayLike, height: float) -> Array:
    """tau_e of a map at positions (..., 2) and a height of its height system."""
    xy = np.asarray(xy, dtype=np.float64)
    points = np.concatenate([xy, np.full((*xy.shape[:-1], 1), float(height))], axis=-1)
    lon, lat, h = np.moveaxis(frame.geodetic_from_map(points), -1, 0)
    tau, _ = grid_factors_geodetic(frame.crs, lon, lat)
    datum = frame.geodetic
    return effective_scale(tau, h, gauss_radius(datum.semi_major_m, datum.flattening, lat))
