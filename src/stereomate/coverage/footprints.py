"""Footprints: the ground a photograph covers, its height above it, and the size of its pixels there."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray

from stereomate.coverage.survey import Photograph, Survey
from stereomate.errors import CoverageError, OrientationError
from stereomate.frames.transform import map_from_tangent
from stereomate.terrain.intersection import distances_to_level, ground_distances
from stereomate.terrain.model import HeightModel, height_unit_m

Floats = NDArray[np.float64]

# Border points per side of a photograph, and interior points per side.
_BORDER: Final = 16
_GRID: Final = 9
# A photograph that shows the horizon counts as far as rays come down by at least this angle.
_SHALLOWEST: Final = math.radians(8.0)


@dataclass(frozen=True)
class Footprint:
    """The ground of one photograph.

    Attributes
    ----------
    name : str
        The photograph.
    polygon : shapely Polygon
        In map coordinates of the survey.
    covered : float
        Share of the photograph whose rays meet the height model (1 on a plane).
    ground_m : float
        Mean height of the ground in it, height system of the survey.
    height_above_ground_m : float
        Projection centre above the mean ground, metres.
    gsd_m, gsd_min_m, gsd_max_m : float
        Ground size of a pixel (root of its horizontal area): median, least and largest over the photograph.
    tilt_deg : float
        Angle of the optical axis against the plumb line at the centre.
    """

    name: str
    polygon: shapely.Polygon
    covered: float
    ground_m: float
    height_above_ground_m: float
    gsd_m: float
    gsd_min_m: float
    gsd_max_m: float
    tilt_deg: float


@dataclass(frozen=True)
class _View:
    """Rays of a set of pixels in the tangent frame, unit vectors, and the local vertical at the centre.

    ``within``: not on the border. ``distances`` to the ground are NaN where a ray does not meet it.
    """

    pixels: Floats
    within: NDArray[np.bool_]
    centre: Floats
    up: Floats
    directions: Floats
    distances: Floats

    @property
    def sink(self) -> Floats:
        """Sine of the angle by which each ray comes down."""
        return np.asarray(-self.directions @ self.up)

    @property
    def points(self) -> Floats:
        """Ground points in the tangent frame."""
        return self.centre + self.distances[:, None] * self.directions

    def part(self, which: NDArray[np.bool_]) -> _View:
        """Some of the rays."""
        return replace(
            self,
            pixels=self.pixels[which],
            within=self.within[which],
            directions=self.directions[which],
            distances=self.distances[which],
        )


def footprint(survey: Survey, photograph: Photograph, ground: HeightModel | float) -> Footprint:
    """The footprint of a photograph on a height model or at one height.

    Where a border ray leaves the height model or ends in a void, the mean height of the ground that the
    photograph does show stands in, so that the polygon is whole; ``covered`` says how much is known.

    Parameters
    ----------
    survey : Survey
    photograph : Photograph
    ground : HeightModel or float
        Or a height in the height system of the survey.

    Raises
    ------
    OrientationError
        If the photograph looks at the sky.
    CoverageError
        If no ray of it meets the height model, or its centre is below the ground.
    """
    view = _view(survey, photograph)
    on_border = ~view.within
    _require_downwards(photograph, view.part(~on_border))
    steep = view.sink >= math.sin(_SHALLOWEST)
    view = _on_surface(survey, view, steep, ground)
    level, covered = _ground_level(survey, photograph, ground, view.part(steep & ~on_border))
    centre = map_from_tangent(survey.tangent, survey.frame, view.centre)
    height = float(centre[2] - level) * height_unit_m(survey.frame.heights)
    if not height > 0.0:
        raise CoverageError(
            f"projection centre must be above the ground (mean ground height {level:.1f})",
            field=f"photograph {photograph.name}",
            value=round(float(centre[2]), 1),
            hint="are the heights of orientation and height model in the systems that are stated?",
        )
    view = _completed(survey, view, level)
    sizes = _pixel_sizes(photograph, view.part(steep & ~on_border))
    tilt = math.degrees(math.acos(min(1.0, -float(photograph.orientation.viewing_direction @ view.up))))
    return Footprint(
        name=photograph.name,
        polygon=_polygon(survey, photograph, view, on_border, steep),
        covered=covered,
        ground_m=level,
        height_above_ground_m=height,
        gsd_m=float(np.median(sizes)),
        gsd_min_m=float(sizes.min()),
        gsd_max_m=float(sizes.max()),
        tilt_deg=tilt,
    )


def _shares() -> Floats:
    """The border of a picture as an open loop and the cell centres of a grid, in shares of its sides."""
    steps = (np.arange(_GRID) + 0.5) / _GRID
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    t = np.arange(_BORDER) / _BORDER
    zero, one = np.zeros(_BORDER), np.ones(_BORDER)
    sides = [(t, zero), (one, t), (1.0 - t, one), (zero, 1.0 - t)]
    return np.concatenate([*(np.stack(side, axis=-1) for side in sides), grid])


def _view(survey: Survey, photograph: Photograph) -> _View:
    """Rays of grid and border; pixels beyond the monotonic range of the distortion have none."""
    shares = _shares()
    within = np.asarray(((shares > 0.0) & (shares < 1.0)).all(axis=1))
    pixels = photograph.camera.picture_px(shares)
    rays = photograph.camera.rays_from_image(pixels)
    known = np.isfinite(rays).all(axis=1)
    directions = rays[known] @ photograph.orientation.object_from_camera.T
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    centre = np.asarray(photograph.orientation.centre, np.float64)
    lon, lat, _ = survey.tangent.geodetic_from_tangent(centre)
    up = np.asarray(survey.tangent.rotation_tangent_from_enu(lon, lat)[:, 2], np.float64)
    return _View(pixels[known], within[known], centre, up, directions, np.full(len(directions), np.nan))


def _on_surface(survey: Survey, view: _View, steep: NDArray[np.bool_], ground: HeightModel | float) -> _View:
    """The view with distances to the surface of the height model, for rays that come down steeply enough."""
    if not isinstance(ground, HeightModel):
        return view
    distances = view.distances.copy()
    distances[steep] = ground_distances(ground, survey.tangent, view.centre[None], view.directions[steep])
    return replace(view, distances=distances)


def _completed(survey: Survey, view: _View, level: float) -> _View:
    """The view with distances to a level where the surface is not known."""
    missing = np.isnan(view.distances)
    if not missing.any():
        return view
    directions = view.directions[missing]
    starts = np.repeat(view.centre[None], len(directions), axis=0)
    distances = view.distances.copy()
    distances[missing] = distances_to_level(survey.frame, survey.tangent, starts, directions, level)
    return replace(view, distances=distances)


def _require_downwards(photograph: Photograph, view: _View) -> None:
    axis = float(photograph.orientation.viewing_direction @ view.up)
    if axis < 0.0 and (view.sink >= math.sin(_SHALLOWEST)).any():
        return
    elevation = math.degrees(math.asin(max(-1.0, min(1.0, axis))))
    raise OrientationError(
        f"looks at the sky: its optical axis points {elevation:+.1f} degrees from the horizontal",
        field=f"photograph {photograph.name}",
        hint="check the unit, the order and the axes of the angles",
    )


def _ground_level(
    survey: Survey, photograph: Photograph, ground: HeightModel | float, view: _View
) -> tuple[float, float]:
    """Mean height of the ground in the height system of the survey, and the share of rays that meet it."""
    if not isinstance(ground, HeightModel):
        return float(ground), 1.0
    met = np.isfinite(view.distances)
    if not met.any():
        raise CoverageError(
            f"does not reach the height model {ground.name}: no ray of it meets the surface",
            field=f"photograph {photograph.name}",
            hint="check CRS and heights of orientation and height model, and extent and voids of the model",
        )
    heights = map_from_tangent(survey.tangent, survey.frame, view.points[met])[:, 2]
    return float(heights.mean()), float(met.mean())


def _polygon(
    survey: Survey,
    photograph: Photograph,
    view: _View,
    on_border: NDArray[np.bool_],
    steep: NDArray[np.bool_],
) -> shapely.Polygon:
    """The border on the ground; for a view to the horizon the hull of what is steep enough."""
    shallow = bool((on_border & ~steep).any())
    outline = view.part(steep if shallow else on_border)
    outline = outline.part(np.isfinite(outline.distances))
    mapped = map_from_tangent(survey.tangent, survey.frame, outline.points)[:, :2]
    polygon = shapely.MultiPoint(mapped).convex_hull if shallow else _valid_polygon(mapped)
    if polygon.geom_type != "Polygon" or polygon.area == 0.0:
        raise CoverageError("its footprint has no area", field=f"photograph {photograph.name}")
    return polygon


def _valid_polygon(points: Floats) -> shapely.Polygon:
    """Polygon of a border; where relief makes it cross itself, its largest valid part."""
    polygon = shapely.Polygon(points)
    if polygon.is_valid:
        return polygon
    parts = [part for part in shapely.get_parts(shapely.make_valid(polygon)) if part.geom_type == "Polygon"]
    return max(parts, key=lambda part: part.area, default=shapely.Polygon())


def _pixel_sizes(photograph: Photograph, view: _View) -> Floats:
    """Root of the area that pixels cover on the horizontal through the ground they show."""
    depth = view.distances * (view.directions @ view.up)
    steps = []
    for step in ((1.0, 0.0), (0.0, 1.0)):
        ends = []
        for sign in (-0.5, 0.5):
            rays = photograph.camera.rays_from_image(view.pixels + sign * np.array(step))
            rays = rays @ photograph.orientation.object_from_camera.T
            ends.append(rays * (depth / (rays @ view.up))[:, None])
        steps.append(ends[1] - ends[0])
    area = np.linalg.norm(np.cross(steps[0], steps[1]), axis=1)
    return np.asarray(np.sqrt(area[np.isfinite(area)]), np.float64)
