"""Making a world: terrain, buildings, trees, targets and their look, in a real map projection."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import CrsError
from stereomate.frames.factors import grid_axes
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.synthetic import layout
from stereomate.synthetic.extent import block_size, steepest_ray, terrain_nodes
from stereomate.synthetic.geodesy import fit_map_polynomial
from stereomate.synthetic.kernels.render import AMBIENT
from stereomate.synthetic.kernels.scene import Objects, Scene, TerrainGrid, Texture
from stereomate.synthetic.kernels.trace import heights_of_points
from stereomate.synthetic.objects import (
    Building,
    Reach,
    Tree,
    building_rows,
    cell_lists,
    is_open,
    object_arrays,
    tree_rows,
)
from stereomate.synthetic.options import SurveyOptions
from stereomate.synthetic.relief import coloured_noise, fractal_terrain, hill_shade
from stereomate.synthetic.world import SyntheticWorld

Array = NDArray[np.float64]

SUN_AZIMUTH_DEG: Final = 150.0
SUN_ELEVATION_DEG: Final = 48.0
# No house or tree is taller, metres.
_TALLEST: Final = 60.0


def make_world(options: SurveyOptions) -> SyntheticWorld:
    """Build the world that a survey with these options flies over.

    Raises
    ------
    CrsError
        If the CRS is not conformal, its axes are not east and north in metres, or the block is too large.
    """
    frame = _map_of(options)
    turn = math.radians(90.0 - options.heading_deg)
    streams = [np.random.default_rng([options.seed, number]) for number in range(5)]
    shape = terrain_nodes(options)
    step = options.terrain_step_m
    extent = ((shape[1] - 1) * step, (shape[0] - 1) * step)
    terrain = _terrain(options, streams[0], shape)
    west, north = _corner(options, extent)
    low, high = float(terrain.heights.min()), options.terrain_height_m + 1.3 * options.flying_height_m
    high = max(high, terrain.highest + _TALLEST) + 20.0
    tangent = TangentFrame.at_map(frame, (*options.centre, options.terrain_height_m))
    polynomial = fit_map_polynomial(
        frame, tangent, (west, north - extent[1], low - 20.0), (west + extent[0], north, high)
    )
    places = layout.plan(streams[1], extent, block_size(options), turn)
    ground = _ground_of(terrain)
    houses = layout.build_village(streams[1], places, options.buildings, ground)
    trees = layout.plant_trees(streams[2], places, houses, options.trees, ground)
    nowhere = np.zeros(2)
    reach = _reach(options, terrain.heights)
    cell = max(8.0, max(extent) / 1000.0)
    objects = object_arrays(
        building_rows(houses, nowhere), tree_rows(trees, nowhere), terrain.heights, step, reach, cell
    )
    targets = _choose_targets(options, streams[3], places, objects, turn)
    texture = _texture(options, streams[4], places, terrain, objects, houses, trees, targets)
    texture = texture._replace(
        shadow_reach=objects.tallest * reach.sun / math.cos(math.radians(SUN_ELEVATION_DEG))
    )
    to_map = partial(_moved, origin=(west, north))
    return SyntheticWorld(
        options,
        frame,
        tangent,
        polynomial,
        terrain.heights,
        tuple(replace(house, centre=to_map(house.centre)) for house in houses),
        tuple(replace(tree, centre=to_map(tree.centre)) for tree in trees),
        np.concatenate([targets + np.array([west, north]), ground(targets)[:, None]], axis=-1),
        Scene(terrain, objects, texture),
    )


def _map_of(options: SurveyOptions) -> MapFrame:
    frame = MapFrame(options.crs, HeightSystem.ellipsoidal())
    frame.require_conformal()
    axes = grid_axes(options.crs)
    if axes.east_north_from_map != ((1.0, 0.0), (0.0, 1.0)) or axes.unit_m != 1.0:
        raise CrsError("must have axes east and north in metres", field="crs", value=options.crs)
    return frame


def _corner(options: SurveyOptions, extent: tuple[float, float]) -> tuple[float, float]:
    """Map position of the upper left terrain node, on whole steps."""
    step = options.terrain_step_m
    middle = np.round(np.array(options.centre) / step) * step
    west, north = (middle + np.array([-0.5 * extent[0], 0.5 * extent[1]])).tolist()
    return math.floor(west / step) * step, math.ceil(north / step) * step


def _ground_of(terrain: TerrainGrid) -> Callable[[Array], Array]:
    """Heights of the terrain at local positions (n, 2)."""

    def ground(points: Array) -> Array:
        out = np.empty(len(points))
        x, y = np.ascontiguousarray(points[:, 0]), np.ascontiguousarray(points[:, 1])
        heights_of_points(terrain.heights, terrain.step, x, y, out)
        return out

    return ground


def _terrain(options: SurveyOptions, rng: np.random.Generator, shape: tuple[int, int]) -> TerrainGrid:
    step = options.terrain_step_m
    heights = fractal_terrain(rng, shape, step, options.relief_m, options.terrain_height_m)
    heights = heights.astype(np.float32).astype(np.float64)
    east = np.abs(np.diff(heights, axis=1)).max() / step
    north = np.abs(np.diff(heights, axis=0)).max() / step
    return TerrainGrid(heights, step, float(heights.max()), float(np.hypot(east, north)))


def _longer_slope(heights: Array, step: float, length: float) -> float:
    """Largest slope between nodes about ``length`` apart, along the rows and columns."""
    lag = max(min(round(length / step), min(heights.shape) - 1), 1)
    rise = max(
        float(np.abs(heights[lag:] - heights[:-lag]).max()),
        float(np.abs(heights[:, lag:] - heights[:, :-lag]).max()),
    )
    return float(rise / (lag * step))


def _reach(options: SurveyOptions, heights: Array) -> Reach:
    """How far objects hide and shade ground that slopes."""
    slope = 1.3 * _longer_slope(heights, options.terrain_step_m, 20.0)
    sun = 1.0 / math.tan(math.radians(SUN_ELEVATION_DEG))

    def over_slope(tangent: float) -> float:
        return tangent / max(1.0 - slope * tangent, 0.2)

    azimuth = math.radians(SUN_AZIMUTH_DEG)
    to_sun = math.sin(azimuth), math.cos(azimuth)
    return Reach(over_slope(steepest_ray(options)), over_slope(sun), to_sun)


def _sun() -> Array:
    azimuth, elevation = math.radians(SUN_AZIMUTH_DEG), math.radians(SUN_ELEVATION_DEG)
    level = math.cos(elevation)
    return np.array([level * math.sin(azimuth), level * math.cos(azimuth), math.sin(elevation)])


def _choose_targets(
    options: SurveyOptions, rng: np.random.Generator, places: layout.Places, objects: Objects, turn: float
) -> Array:
    """Local positions (n, 2) on open ground, far from each other: the first are the best spread."""
    length, width = block_size(options)
    count = options.control_points + options.check_points
    u, v = rng.uniform(-0.46, 0.46, 4000) * length, rng.uniform(-0.44, 0.44, 4000) * width
    c, s = math.cos(turn), math.sin(turn)
    middle = np.array([0.5 * places.extent[0], -0.5 * places.extent[1]])
    spots = np.stack([c * u - s * v, s * u + c * v], axis=-1) + middle
    spots = spots[is_open(objects, spots)]
    if len(spots) == 0 or count == 0:
        return np.empty((0, 2))
    chosen = [int(np.argmax(np.hypot(*(spots - middle).T)))]
    distance = np.hypot(*(spots - spots[chosen[0]]).T)
    while len(chosen) < count:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.hypot(*(spots - spots[chosen[-1]]).T))
    positions: Array = spots[chosen]
    return positions


def _moved(point: tuple[float, float], origin: tuple[float, float]) -> tuple[float, float]:
    return point[0] + origin[0], point[1] + origin[1]


def _texture(
    options: SurveyOptions,
    rng: np.random.Generator,
    places: layout.Places,
    terrain: TerrainGrid,
    objects: Objects,
    houses: tuple[Building, ...],
    trees: tuple[Tree, ...],
    targets: Array,
) -> Texture:
    sun = _sun()
    mesh = min(max(95.0, 100.0 * options.gsd_m), 0.2 * min(places.extent))
    seeds, looks = layout.parcels(rng, places.extent, mesh, options.gsd_m)
    radius = 2.5 * options.gsd_m
    reach = 2.0 * radius + 2.0 * options.gsd_m
    boxes = np.concatenate([targets - reach, targets + reach], axis=-1)
    first, items = cell_lists(boxes, objects.cell, (objects.near.shape[0], objects.near.shape[1]))
    return Texture(
        gsd=options.gsd_m,
        fine=coloured_noise(rng, (512, 512), 0.8, 0.0125, 0.15).astype(np.float32),
        coarse=coloured_noise(rng, (256, 256), 1.3, 0.01, 0.2).astype(np.float32),
        shade=hill_shade(terrain.heights, terrain.step, sun, AMBIENT),
        parcel=mesh,
        parcel_seed=seeds,
        parcel_look=looks,
        roads=places.roads,
        wood=places.wood,
        targets=np.concatenate([targets, np.full((len(targets), 1), radius)], axis=-1),
        target_first=first,
        target_items=items,
        building_look=layout.building_looks(rng, houses),
        tree_look=layout.tree_looks(rng, trees),
        sun=sun,
        shadow_reach=0.0,
    )
