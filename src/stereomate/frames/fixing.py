"""An orientation and its observations rewritten for software that takes the map grid as Cartesian.

The input is true (tangent frame); the output has right-handed map coordinates with ellipsoidal heights, grid
axes, and whatever the remedy changes: heights (M2), principal distances (M3), image coordinates (M4).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import InputError
from stereomate.frames.adjusted import effective_scale_at
from stereomate.frames.curvature import CurvatureOptions, curvature_corrected
from stereomate.frames.factors import gauss_radius
from stereomate.frames.refraction import RefractionModel, refraction_corrected
from stereomate.frames.remedies import (
    GridBlock,
    cartesian_from_map,
    grid_principal_distance,
    map_from_cartesian,
    scaled_heights,
)
from stereomate.frames.transform import map_from_tangent
from stereomate.geometry.intersection import Rays, intersect_rays

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Remedy = Literal["M2", "M3", "M4"]
REMEDIES: Final[tuple[Remedy, ...]] = ("M2", "M3", "M4")


@dataclass(frozen=True, eq=False)
class ImageRays:
    """Image observations: point and photograph of each, and ideal coordinates (m, 2) in units of c."""

    point_of: Indices
    photo_of: Indices
    image: Array
    count: int


@dataclass(frozen=True, eq=False)
class FixedBlock:
    """What the software is to be given.

    Attributes
    ----------
    remedy : str
    centres : ndarray (p, 3)
        Right-handed metric grid coordinates; heights ellipsoidal, for M2 times the scale.
    rotations : ndarray (p, 3, 3)
        Camera to grid axes.
    c_factor : ndarray (p,)
        Principal distance over the calibrated one: not 1 for M3.
    scale : ndarray (p,)
        tau_e at the ground below each photograph, or its mean over the block.
    ground_m : float
        Ellipsoidal height the scale was taken at.
    image : ndarray (m, 2)
        Corrected observations in units of the calibrated principal distance; NaN for points of one ray.
    points : ndarray (n, 3)
        Rigorous points in the grid, true heights; NaN for points of one ray.
    """

    remedy: Remedy
    centres: Array
    rotations: Array
    c_factor: Array
    scale: Array
    ground_m: float
    image: Array
    points: Array


def fixed_block(
    block: GridBlock,
    rays: ImageRays,
    remedy: Remedy,
    ground_m: float | None = None,
    *,
    per_image: bool = False,
    refraction: RefractionModel = "none",
) -> FixedBlock:
    """Correct an orientation and its observations by one of the remedies.

    Parameters
    ----------
    block : GridBlock
        True orientation; the frame has ellipsoidal heights; principal distances are 1.
    rays : ImageRays
        M2 and M3 need the classical Earth curvature correction, which is applied to them at the height of
        each rigorously intersected point; M4 adds its own.
    ground_m : float, optional
        Height of the ground or control; the mean of the intersected points if absent.
    per_image : bool
        M3 with the scale of each photograph instead of the block's.
    refraction : str
        Atmosphere the observations are freed of first: ``icao``, ``ardc``, or ``none`` (they are free of it,
        or the software corrects it).

    Raises
    ------
    InputError
        If the remedy or the atmosphere is unknown, M2 is asked per image, or no point gives the ground.
    """
    if remedy not in REMEDIES:
        raise InputError(f"must be one of {', '.join(REMEDIES)}", field="remedy", value=remedy)
    if per_image and remedy != "M3":
        raise InputError("has a meaning with M3 only: M2 has one scale, M4 none", field="per_image")
    if refraction != "none":
        rays = _in_vacuum(block, rays, refraction)
    points = _points_in_grid(block, rays)
    if ground_m is None:
        if not np.isfinite(points).any():
            raise InputError("must be given: no point is seen twice", field="ground")
        ground_m = float(np.nanmean(points[:, 2]))
    centres = block.grid_centres
    map_xy = map_from_cartesian(block.frame, centres)[:, :2]
    scale = effective_scale_at(block.frame, map_xy, ground_m)
    if not per_image:
        scale = np.full(len(centres), float(scale.mean()))
    image = _corrected(block, rays, points, remedy)
    c_factor = grid_principal_distance(1.0, scale) if remedy == "M3" else np.ones(len(centres))
    if remedy == "M2":
        centres = scaled_heights(centres, scale)
    return FixedBlock(remedy, centres, block.grid_rotations, c_factor, scale, ground_m, image, points)


def _in_vacuum(block: GridBlock, rays: ImageRays, model: RefractionModel) -> ImageRays:
    """Observations freed of refraction at the heights of their points."""
    heights = _points_in_grid(block, rays)[rays.point_of, 2]
    good = np.isfinite(heights)
    photo = rays.photo_of[good]
    image = rays.image.copy()
    image[good] = refraction_corrected(
        rays.image[good],
        1.0,
        block.grid_rotations[photo],
        block.grid_centres[photo, 2],
        heights[good],
        model,
    )
    return replace(rays, image=image)


def _points_in_grid(block: GridBlock, rays: ImageRays) -> Array:
    """Rigorously intersected points in Cartesian grid coordinates, NaN where there is one ray only."""
    photo = rays.photo_of
    sigma = np.full(len(photo), 1e-4)
    made = Rays(rays.point_of, block.centres[photo], block.rotations[photo], rays.image, sigma)
    met = intersect_rays(made, rays.count).points
    out = np.full(met.shape, np.nan)
    good = np.isfinite(met).all(axis=1)
    out[good] = _grid_points(block, met[good])
    return out


def _grid_points(block: GridBlock, tangent_points: Array) -> Array:
    return cartesian_from_map(block.frame, map_from_tangent(block.tangent, block.frame, tangent_points))


def _corrected(block: GridBlock, rays: ImageRays, points: Array, remedy: Remedy) -> Array:
    """Observations as the grid would have given them (M4), or freed of Earth curvature (M2, M3)."""
    out = np.full(rays.image.shape, np.nan)
    good = np.isfinite(points[rays.point_of]).all(axis=1)
    point, photo = rays.point_of[good], rays.photo_of[good]
    if remedy == "M4":
        safe = np.where(np.isfinite(points), points, np.nanmean(points, axis=0))
        change = block.corrections(map_from_cartesian(block.frame, safe), point, photo)
        out[good] = rays.image[good] + change
        return out
    datum = block.frame.geodetic
    radius = float(gauss_radius(datum.semi_major_m, datum.flattening, block.tangent.latitude_deg))
    out[good] = curvature_corrected(
        rays.image[good],
        1.0,
        block.grid_rotations[photo],
        block.grid_centres[photo, 2],
        points[point, 2],
        CurvatureOptions(radius, "classical", "ground"),
    )
    return out
