"""Centres of an adjustment in a map grid, and true positions: the same file, read half a metre apart.

An adjustment in the grid keeps the principal distance, so the plane scale goes into the heights of the
centres: they are ``h_ref + τ_e (h - h_ref)`` with ``τ_e = τ / (1 + h_ref / R)`` (Ressl's equation (2),
indirect georeferencing). ``adjusted_in = "grid"`` turns such heights into true ones; ``"space"`` takes them
as they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stereomate.frames.factors import effective_scale, gauss_radius, grid_factors
from stereomate.frames.mapframe import MapFrame

Array = NDArray[np.float64]

# More than this share of the GSD in height must not depend on a key that nobody set.
LARGEST_SHARE_OF_GSD = 0.3


@dataclass(frozen=True, eq=False)
class GridScale:
    """What `adjusted_in` changes for a block.

    Attributes
    ----------
    reference_m : float
        Ellipsoidal height the scale acts about.
    effective : ndarray (n,)
        τ_e at each centre.
    change_m : ndarray (n,)
        True height minus written height of each centre.
    relief_m : float
        Standard deviation of the ground about the reference.
    """

    reference_m: float
    effective: Array
    change_m: Array
    relief_m: float

    @property
    def largest_m(self) -> float:
        """Largest change of a height."""
        return float(np.abs(self.change_m).max())

    @property
    def uncertainty_m(self) -> float:
        """(τ_e - 1) times the relief: the height the adjustment really scaled about is not known better."""
        return float(np.abs(self.effective - 1.0).max()) * self.relief_m

    @property
    def sentence(self) -> str:
        """What was done, for reports."""
        ppm = (float(self.effective.mean()) - 1.0) * 1e6
        return (
            f"centres come from an adjustment in the grid: their heights above {self.reference_m:.1f} m "
            f"(ellipsoidal, mean ground or control) were divided by the scale (1 {ppm:+.0f} ppm), which "
            f"changes them by {float(self.change_m.mean()):+.3f} m on average, known to "
            f"±{self.uncertainty_m:.3f} m"
        )


def grid_scale(frame: MapFrame, positions: Array, reference_m: float, relief_m: float) -> GridScale:
    """What `adjusted_in` changes for centres in a map grid.

    Parameters
    ----------
    frame : MapFrame
        Conformal grid of the positions.
    positions : ndarray (n, 3)
        In that frame, heights in its height system.
    reference_m : float
        Ellipsoidal height of the ground or the control.
    relief_m : float
        Standard deviation of the ground about it.
    """
    lon_lat_h = frame.geodetic_from_map(positions)
    tau, _ = grid_factors(frame.crs, positions[:, 0], positions[:, 1])
    datum = frame.geodetic
    radius = gauss_radius(datum.semi_major_m, datum.flattening, lon_lat_h[:, 1])
    effective = effective_scale(tau, reference_m, radius)
    change = (lon_lat_h[:, 2] - reference_m) * (1.0 / effective - 1.0)
    return GridScale(reference_m, effective, change, relief_m)


def true_positions(frame: MapFrame, positions: Array, scale: GridScale) -> Array:
    """Map positions (n, 3) with the heights changed into true ones, in the height system of the frame."""
    lon_lat_h = frame.geodetic_from_map(positions)
    lon_lat_h[:, 2] += scale.change_m
    result = positions.copy()
    result[:, 2] = frame.map_from_geodetic(lon_lat_h)[:, 2]
    return result
