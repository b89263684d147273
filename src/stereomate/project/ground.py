"""The ground under a block, roughly: how high it is, and which photographs see it at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.model import Camera
from stereomate.errors import CoverageError, CrsError
from stereomate.frames.crs import convert_geodetic
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import map_from_tangent
from stereomate.terrain.model import HeightModel

Array = NDArray[np.float64]

# Rays of a photograph that look less than this far down (sine) reach the ground too far away to count.
_LEAST_SLOPE = 0.05
_RAYS = 9


@dataclass(frozen=True, eq=False)
class GroundUnderBlock:
    """Heights of a height model where the photographs look, ellipsoidal in metres on the project's datum.

    Attributes
    ----------
    mean_m, relief_m : float
        Mean, and standard deviation about it.
    heights_m : ndarray (photographs,)
        Mean under each photograph; NaN where it sees none of the height model.
    seen : ndarray (photographs,)
        Share of its rays that meet the height model.
    gsd_m : ndarray (photographs,)
        Ground sampling distance in the middle of each photograph.
    flying_height_m : ndarray (photographs,)
        Of the centre above the mean ground of the photograph.
    """

    mean_m: float
    relief_m: float
    heights_m: Array
    seen: Array
    gsd_m: Array
    flying_height_m: Array

    def of(self, photographs: NDArray[np.int64]) -> GroundUnderBlock:
        """The same for some of the photographs; mean and relief stay those of all."""
        return replace(
            self,
            heights_m=self.heights_m[photographs],
            seen=self.seen[photographs],
            gsd_m=self.gsd_m[photographs],
            flying_height_m=self.flying_height_m[photographs],
        )


def ground_under(
    centres: Array, rotations: Array, cameras: Sequence[Camera], tangent: TangentFrame, model: HeightModel
) -> GroundUnderBlock:
    """Sample a height model where a grid of rays of each photograph meets the mean ground.

    Parameters
    ----------
    centres : ndarray (n, 3)
    rotations : ndarray (n, 3, 3)
        Camera to tangent axes.
    cameras : sequence of Camera

    Raises
    ------
    CoverageError
        If no photograph sees any of the model; both places are named.
    """
    places = tangent.geodetic_from_tangent(centres)
    up = tangent.rotation_tangent_from_enu(places[:, 0], places[:, 1])[:, :, 2]
    rays = [
        camera.rays_from_image(_grid_of_pixels(camera)) @ rotation.T
        for camera, rotation in zip(cameras, rotations, strict=True)
    ]
    middle = _middle_height(centres, places, tangent, model)
    samples = []
    for _ in range(2):  # the second pass with the heights of the first
        samples = [
            _heights_below(centres[k], up[k], places[k, 2] - middle, rays[k], tangent, model)
            for k in range(len(rays))
        ]
        every = np.concatenate(samples)
        if not np.isfinite(every).any():
            raise CoverageError(_nowhere(places, model), file=model.name)
        middle = float(np.nanmean(every))
    heights = np.array([_mean(sample) for sample in samples])
    above = places[:, 2] - np.where(np.isfinite(heights), heights, middle)
    every = np.concatenate(samples)
    return GroundUnderBlock(
        mean_m=middle,
        relief_m=float(np.nanstd(every)),
        heights_m=heights,
        seen=np.array([float(np.isfinite(sample).mean()) for sample in samples]),
        gsd_m=np.array(
            [
                _gsd(camera, rotation, u, h)
                for camera, rotation, u, h in zip(cameras, rotations, up, above, strict=True)
            ]
        ),
        flying_height_m=above,
    )


def looks_up(centres: Array, rotations: Array, tangent: TangentFrame) -> Array:
    """Elevation of each optical axis above the horizon in degrees (n,): -90 looks straight down."""
    places = tangent.geodetic_from_tangent(centres)
    up = tangent.rotation_tangent_from_enu(places[:, 0], places[:, 1])[:, :, 2]
    sine = np.einsum("ni,ni->n", up, -rotations[:, :, 2])
    return np.asarray(np.degrees(np.arcsin(np.clip(sine, -1.0, 1.0))), dtype=np.float64)


def ellipsoidal_heights(points: Array, tangent: TangentFrame, model: HeightModel) -> Array:
    """Ellipsoidal heights (n,) on the datum of the tangent frame of a height model below points (n, 3)."""
    # Positions need no geoid, and where there is no height none is asked for: a geoid grid may be small.
    plain = MapFrame(model.frame.crs, HeightSystem.ellipsoidal())
    try:
        own = map_from_tangent(tangent, plain, points)
    except CrsError:
        return np.full(len(points), np.nan)  # outside the projection of the model is outside the model
    own[:, 2] = model.heights_at(own[:, :2])
    own[np.isnan(own[:, 2])] = np.nan
    lon, lat, h = model.frame.geodetic_from_map(own).T
    if tangent.geodetic is not None:
        h = convert_geodetic(model.frame.geodetic, tangent.geodetic, lon, lat, h)[2]
    return np.asarray(h, dtype=np.float64)


def _grid_of_pixels(camera: Camera) -> Array:
    shares = np.linspace(0.0, 1.0, _RAYS)
    return camera.picture_px(np.stack(np.meshgrid(shares, shares), axis=-1).reshape(-1, 2))


def _heights_below(
    centre: Array, up: Array, above: float, rays: Array, tangent: TangentFrame, model: HeightModel
) -> Array:
    """Heights (rays,) where rays meet a level `above` metres under the centre; NaN where they do not."""
    lengths = np.linalg.norm(rays, axis=1)
    fall = -(rays @ up) / lengths
    down = np.isfinite(fall) & (fall > _LEAST_SLOPE)
    heights = np.full(len(rays), np.nan)
    if above <= 0.0 or not down.any():
        return heights
    reach = above / (fall[down] * lengths[down])
    heights[down] = ellipsoidal_heights(centre + rays[down] * reach[:, None], tangent, model)
    return heights


def _middle_height(centres: Array, places: Array, tangent: TangentFrame, model: HeightModel) -> float:
    below = ellipsoidal_heights(centres, tangent, model)
    if np.isfinite(below).any():
        return float(np.nanmean(below))
    # No ground straight below any centre: steep tilts, or another country; a coarse look decides.
    rows, cols = model.shape
    col, row = np.meshgrid(np.linspace(0.5, cols - 0.5, 33), np.linspace(0.5, rows - 0.5, 33))
    xy = model.map_from_pixel(np.stack([col.ravel(), row.ravel()], axis=-1))
    heights = model.heights_at(xy)
    if not np.isfinite(heights).any():
        low, high = model.range  # raises where there is no height at all
        return 0.5 * (low + high)
    return float(np.nanmean(heights))


def _mean(sample: Array) -> float:
    return float(np.nanmean(sample)) if np.isfinite(sample).any() else float("nan")


def _gsd(camera: Camera, rotation: Array, up: Array, above: float) -> float:
    """Mean side of the middle pixel on level ground."""
    columns, rows = camera.size_px
    middle = np.array([columns / 2.0, rows / 2.0])
    steps = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])
    rays = camera.rays_from_image(middle + steps) @ rotation.T
    fall = -(rays @ up)
    if above <= 0.0 or not (fall > _LEAST_SLOPE * np.linalg.norm(rays, axis=1)).all():
        return float("nan")
    ground = rays * (above / fall)[:, None]
    sides = np.linalg.norm(ground[1:] - ground[0], axis=1)
    return float(np.sqrt(sides[0] * sides[1]))


def _nowhere(places: Array, model: HeightModel) -> str:
    lon, lat = places[:, :2].mean(axis=0)
    corners = np.column_stack([model.outline, np.zeros(4)])
    west, south, _ = model.frame.geodetic_from_map(corners).min(axis=0)
    east, north, _ = model.frame.geodetic_from_map(corners).max(axis=0)
    return (
        f"no photograph sees any of the height model: the photographs are at longitude {lon:.4f} latitude "
        f"{lat:.4f}, the height model covers longitude {west:.4f} to {east:.4f}, latitude {south:.4f} to "
        f"{north:.4f}"
    )
