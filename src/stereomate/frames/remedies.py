"""The four remedies for orientations and adjustments in a map grid (georeferencing theory, section 4).

- M1: stay in a tangent frame and transform the results. Rigorous; what stereomate does.
- M2: multiply all heights by the scale, work, divide the results by it. ``(X, Y, tau Z)`` is a similarity of
  space, so it holds for any tilt; what is left is the change of scale inside an image.
- M3: principal distance ``c / tau``. For nearly vertical photographs only.
- M4: add to each measured image coordinate the difference between the grid's collinearity and the rigorous
  one at the current point. Exact after a few passes, each about 300 times better than the last.

The scale is tau_e = tau / (1 + h/R) where distances are kept at ground level (classical curvature
correction), tau where they are reduced to the ellipsoid.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import InputError, OrientationError
from stereomate.frames import kernels
from stereomate.frames.attitude import rotation_tangent_from_axes
from stereomate.frames.factors import require_conformal
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import map_from_tangent, tangent_from_map

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


def cartesian_from_map(frame: MapFrame, xyz: ArrayLike) -> Array:
    """Map points (..., 3) as software sees them that takes the grid as Cartesian: right-handed axes, metres.

    Heights stay in their system, only their unit becomes metres.

    Raises
    ------
    CrsError
        If the map is geographic or not conformal.
    """
    points = np.asarray(xyz, dtype=np.float64)
    axes = require_conformal(frame.crs)
    plan = points[..., :2] @ axes.working_from_map.T * axes.unit_m
    return np.concatenate([plan, points[..., 2:] * frame.heights.metres_per_unit], axis=-1)


def map_from_cartesian(frame: MapFrame, xyz: ArrayLike) -> Array:
    """Map points (..., 3) of right-handed metric grid coordinates: the inverse of `cartesian_from_map`."""
    points = np.asarray(xyz, dtype=np.float64)
    axes = require_conformal(frame.crs)
    plan = points[..., :2] / axes.unit_m @ axes.working_from_map
    return np.concatenate([plan, points[..., 2:] / frame.heights.metres_per_unit], axis=-1)


def scaled_heights(xyz: ArrayLike, scale: ArrayLike) -> Array:
    """M2: points (..., 3) with their heights multiplied by the scale. Centres, control and antennas alike."""
    points = np.array(xyz, dtype=np.float64)
    points[..., 2] *= _positive(scale)
    return points


def unscaled_heights(xyz: ArrayLike, scale: ArrayLike) -> Array:
    """M2 undone: results of a bundle with scaled heights as true heights."""
    points = np.array(xyz, dtype=np.float64)
    points[..., 2] /= _positive(scale)
    return points


def grid_principal_distance(principal_distance: ArrayLike, scale: ArrayLike) -> Array:
    """M3: the principal distance that gives true heights in the grid, ``c / scale``. The unit is that of c.

    A grid that stretches (tau > 1) makes depths too large, so c gets smaller. For tilts t1, t2 the error left
    is |1/scale - 1| c hypot(t1, t2) in the image; see `levelled_scale` for the exact form.
    """
    return np.asarray(np.asarray(principal_distance, dtype=np.float64) / _positive(scale), dtype=np.float64)


def levelled_scale(
    xy: ArrayLike, principal_distance: float, level_from_camera: ArrayLike, scale: ArrayLike
) -> Array:
    """M3 for tilted photographs: image coordinates with the vertical component of their rays divided by the
    scale.

    Rotated to level, scaled and rotated back: with them a bundle in the grid, with c unchanged, gives true
    heights.

    Parameters
    ----------
    xy : array_like (..., 2)
    principal_distance : float
    level_from_camera : array_like (..., 3, 3)
    scale : array_like (...)
    """
    xy = np.asarray(xy, dtype=np.float64)
    rotation = np.asarray(level_from_camera, dtype=np.float64)
    ray = np.concatenate([xy, np.full((*xy.shape[:-1], 1), -float(principal_distance))], axis=-1)
    level = np.einsum("...ij,...j->...i", rotation, ray)
    level[..., 2] /= _positive(scale)
    camera = np.einsum("...ji,...j->...i", rotation, level)
    out: Array = -principal_distance * camera[..., :2] / camera[..., 2:]
    return out


def _positive(scale: ArrayLike) -> Array:
    scale = np.asarray(scale, dtype=np.float64)
    if not np.all(np.abs(scale - 1.0) < 0.2):
        raise InputError(
            "a map's scale lies within 20 % of 1", field="scale", value=float(np.ravel(scale)[0])
        )
    return scale


@dataclass(frozen=True, eq=False)
class GridBlock:
    """Photographs with true orientations, to be used by software that takes the map grid as Cartesian.

    Attributes
    ----------
    tangent : TangentFrame
    frame : MapFrame
        The map with the heights that the software will use.
    centres : ndarray (photographs, 3)
        True projection centres in the tangent frame.
    rotations : ndarray (photographs, 3, 3)
        Camera to tangent axes.
    principal_distances : ndarray (photographs,)
        In the unit of the image coordinates.
    """

    tangent: TangentFrame
    frame: MapFrame
    centres: Array
    rotations: Array
    principal_distances: Array

    def __post_init__(self) -> None:
        count = len(self.centres)
        if self.rotations.shape != (count, 3, 3) or self.principal_distances.shape != (count,):
            raise OrientationError(
                "centres, rotations and principal distances are one per photograph",
                value=(self.centres.shape, self.rotations.shape, self.principal_distances.shape),
            )

    @cached_property
    def grid_centres(self) -> Array:
        """Projection centres in the right-handed metric grid, (photographs, 3)."""
        return cartesian_from_map(self.frame, map_from_tangent(self.tangent, self.frame, self.centres))

    @cached_property
    def grid_rotations(self) -> Array:
        """Camera to grid axes at each centre, (photographs, 3, 3)."""
        turn = rotation_tangent_from_axes("grid", self.tangent, self.centres, self.frame)
        return np.asarray(np.swapaxes(turn, -1, -2) @ self.rotations, dtype=np.float64)

    def corrections(self, points: ArrayLike, point_of: ArrayLike, photo_of: ArrayLike) -> Array:
        """M4: what to add to measured image coordinates so that the grid can be taken as Cartesian.

        Parameters
        ----------
        points : array_like (m, 3)
            Current points in map coordinates and heights of the frame.
        point_of, photo_of : array_like of int (n,)
            Point and photograph of each observation.

        Returns
        -------
        ndarray (n, 2)
            Collinearity in the grid minus the rigorous one. NaN where the point is not before the camera.
        """
        points = np.asarray(points, dtype=np.float64)
        true = tangent_from_map(self.tangent, self.frame, points)
        grid = cartesian_from_map(self.frame, points)
        point_index = np.ascontiguousarray(point_of, dtype=np.int64)
        photo_index = np.ascontiguousarray(photo_of, dtype=np.int64)
        for name, index, count in (
            ("point_of", point_index, len(points)),
            ("photo_of", photo_index, len(self.centres)),
        ):
            if index.size and not (int(index.min()) >= 0 and int(index.max()) < count):
                raise InputError(f"must index {count} of them", field=name, value=int(index.max()))
        out = np.empty((point_index.size, 2))
        kernels.collinearity_difference(
            grid,
            true,
            point_index,
            photo_index,
            self.grid_centres,
            self.grid_rotations,
            np.ascontiguousarray(self.centres),
            np.ascontiguousarray(self.rotations),
            np.ascontiguousarray(self.principal_distances),
            out,
        )
        return out
