"""A world with known truth: terrain, buildings, trees and their look, in a real map projection."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import CrsError
from stereomate.frames.factors import grid_axes
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import map_from_tangent, tangent_from_map
from stereomate.synthetic import layout
from stereomate.synthetic.geodesy import MapPolynomial, fit_map_polynomial
from stereomate.synthetic.kernels.render import AMBIENT
from stereomate.synthetic.kernels.scene import FACES, Objects, Scene, TerrainGrid, Texture
from stereomate.synthetic.kernels.trace import first_hits, heights_of_points
from stereomate.synthetic.objects import (
    Building,
    Tree,
    building_rows,
    cell_lists,
    object_arrays,
    object_boxes,
    tree_rows,
)
from stereomate.synthetic.options import SurveyOptions
from stereomate.synthetic.relief import coloured_noise, fractal_terrain, hill_shade

Array = NDArray[np.float64]

SUN_AZIMUTH_DEG: Final = 150.0
SUN_ELEVATION_DEG: Final = 48.0
LIMIT_OF_TILT: Final = 2.5  # standard deviations
# No house or tree is taller, metres.
_TALLEST: Final = 60.0


@dataclass(frozen=True, eq=False)
class Hits:
    """First surfaces met by rays.

    Attributes
    ----------
    points : ndarray (..., 3)
        Map coordinates and ellipsoidal heights; NaN where a ray leaves the world.
    distances : ndarray (...)
        Along the ray, metres.
    kind : ndarray of str (...)
        ``"terrain"``, ``"building"``, ``"tree"`` or ``"nothing"``.
    number : ndarray of int (...)
        Which building or tree, -1 otherwise.
    """

    points: Array
    distances: Array
    kind: NDArray[np.str_]
    number: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class SyntheticWorld:
    """Everything that is true about a synthetic block before it is photographed.

    Attributes
    ----------
    frame, tangent
        The map (ellipsoidal heights) and the tangent frame at the centre of the block.
    polynomial : MapPolynomial
        From the tangent frame to local map coordinates, with its error.
    heights : ndarray (rows, cols)
        Terrain nodes, exactly representable as float32; the terrain is the bilinear surface between them.
    buildings, trees
        In map coordinates.
    targets : ndarray (n, 3)
        Signalised points on the terrain, map coordinates.
    """

    options: SurveyOptions
    frame: MapFrame
    tangent: TangentFrame
    polynomial: MapPolynomial
    heights: Array
    buildings: tuple[Building, ...]
    trees: tuple[Tree, ...]
    targets: Array
    scene: Scene

    @property
    def origin(self) -> tuple[float, float]:
        """Map position of the upper left terrain node."""
        return float(self.polynomial.origin[0]), float(self.polynomial.origin[1])

    @property
    def affine(self) -> tuple[float, float, float, float, float, float]:
        """Geotransform (a, b, c, d, e, f) of the terrain grid: pixel corners, nodes at pixel centres."""
        step, (east, north) = self.options.terrain_step_m, self.origin
        return step, 0.0, east - 0.5 * step, 0.0, -step, north + 0.5 * step

    def height(self, xy: ArrayLike) -> Array:
        """Terrain height (...) at map positions (..., 2); NaN outside the world."""
        xy = np.asarray(xy, dtype=np.float64)
        local = (xy - self.polynomial.origin[:2]).reshape(-1, 2)
        out = np.empty(len(local))
        x, y = np.ascontiguousarray(local[:, 0]), np.ascontiguousarray(local[:, 1])
        heights_of_points(self.heights, self.options.terrain_step_m, x, y, out)
        return out.reshape(xy.shape[:-1])

    def on_ground(self, xy: ArrayLike) -> Array:
        """Terrain points (..., 3) at map positions (..., 2)."""
        xy = np.asarray(xy, dtype=np.float64)
        return np.concatenate([xy, self.height(xy)[..., None]], axis=-1)

    def tangent_from_map(self, points: ArrayLike) -> Array:
        """Tangent coordinates (..., 3) of map points, rigorously."""
        return tangent_from_map(self.tangent, self.frame, points)

    def map_from_tangent(self, points: ArrayLike) -> Array:
        """Map points (..., 3) of tangent coordinates, rigorously."""
        return map_from_tangent(self.tangent, self.frame, points)

    def first_hit(self, origins: ArrayLike, directions: ArrayLike) -> Hits:
        """First surface of rays given in the tangent frame.

        Parameters
        ----------
        origins, directions : array_like (..., 3)
            Broadcast against each other; directions need not be unit vectors.
        """
        o, d = np.broadcast_arrays(
            np.asarray(origins, dtype=np.float64), np.asarray(directions, dtype=np.float64)
        )
        shape = o.shape[:-1]
        o, d = np.ascontiguousarray(o.reshape(-1, 3)), d.reshape(-1, 3)
        d = np.ascontiguousarray(d / np.linalg.norm(d, axis=-1, keepdims=True))
        points, distances = np.empty(o.shape), np.empty(len(o))
        surfaces = np.empty(len(o), dtype=np.int64)
        polynomial = self.polynomial
        first_hits(
            polynomial.exponents,
            polynomial.terms,
            polynomial.scale,
            o,
            d,
            self.scene.terrain,
            self.scene.objects,
            points,
            distances,
            surfaces,
        )
        kind, number = self._meaning(surfaces, distances)
        return Hits(
            (points + polynomial.origin).reshape(*shape, 3),
            distances.reshape(shape),
            kind.reshape(shape),
            number.reshape(shape),
        )

    def is_visible(self, centre: ArrayLike, points: ArrayLike, slack_m: float = 0.01) -> NDArray[np.bool_]:
        """Whether nothing hides map points (..., 3) from a centre (3,) in the tangent frame."""
        target = self.tangent_from_map(points)
        direction = target - np.asarray(centre, dtype=np.float64)
        distance = np.linalg.norm(direction, axis=-1)
        free = self.first_hit(np.asarray(centre, dtype=np.float64), direction).distances
        visible: NDArray[np.bool_] = np.isfinite(distance) & ~(free < distance - slack_m)
        return visible

    def is_open(self, xy: ArrayLike) -> NDArray[np.bool_]:
        """Whether map positions (..., 2) lie away from objects and the places they may hide or shade."""
        local = np.asarray(xy, dtype=np.float64) - self.polynomial.origin[:2]
        return _is_open(self.scene.objects, local)

    def is_clear(self, xy: ArrayLike, margin_m: float = 4.0) -> NDArray[np.bool_]:
        """Whether every object stands farther from map positions (..., 2) than its own height and a margin.

        A narrower question than `is_open`: nothing leans into the image of such ground in a photograph whose
        rays are steeper than 45°, but shadows may fall there.
        """
        local = np.asarray(xy, dtype=np.float64) - self.polynomial.origin[:2]
        boxes, tops = object_boxes(self.scene.objects.buildings, self.scene.objects.trees)
        feet = self.height(0.5 * (boxes[:, :2] + boxes[:, 2:]) + self.polynomial.origin[:2])
        clear = np.ones(local.shape[:-1], dtype=np.bool_)
        for (west, south, east, north), reach in zip(boxes, tops - feet + margin_m, strict=True):
            beside = np.maximum(np.maximum(west - local[..., 0], local[..., 0] - east), 0.0)
            beyond = np.maximum(np.maximum(south - local[..., 1], local[..., 1] - north), 0.0)
            clear &= np.hypot(beside, beyond) > reach
        return clear

    def surface_model(self) -> Array:
        """Highest surface (terrain, roofs, crowns) over each terrain node, seen from straight above."""
        rows, cols = self.heights.shape
        step = self.options.terrain_step_m
        col, row = np.meshgrid(np.arange(cols), np.arange(rows))
        nodes = np.stack([col * step, -row * step], axis=-1).reshape(-1, 2) + self.polynomial.origin[:2]
        inner = self.heights.ravel().copy()
        near = ~self.is_open(nodes)
        feet = np.concatenate([nodes[near], inner[near, None]], axis=-1)
        above = feet + np.array([0.0, 0.0, self.scene.objects.tallest + 5.0])
        top = self.tangent_from_map(above)
        hits = self.first_hit(top, self.tangent_from_map(feet) - top)
        found = hits.points[:, 2]
        inner[near] = np.where(np.isfinite(found), np.maximum(found, inner[near]), inner[near])
        return inner.reshape(rows, cols)

    def _meaning(
        self, surfaces: NDArray[np.int64], distances: Array
    ) -> tuple[NDArray[np.str_], NDArray[np.int64]]:
        count = len(self.buildings)
        tree = surfaces > FACES * count
        building = (surfaces > 0) & ~tree
        nothing = np.isnan(distances)
        kind = np.select([nothing, tree, building], ["nothing", "tree", "building"], "terrain")
        number = np.select(
            [nothing, tree, building], [-1, surfaces - 1 - FACES * count, (surfaces - 1) // FACES], -1
        )
        return kind, number


def _is_open(objects: Objects, local: Array) -> NDArray[np.bool_]:
    rows, cols = objects.near.shape
    col = np.clip(np.floor(local[..., 0] / objects.cell).astype(int), 0, cols - 1)
    row = np.clip(np.floor(-local[..., 1] / objects.cell).astype(int), 0, rows - 1)
    open_here: NDArray[np.bool_] = objects.near[row, col] == 0
    return open_here


def block_size(options: SurveyOptions) -> tuple[float, float]:
    """Length along and across the flight that the photographs cover at the mean terrain."""
    length, width = options.footprint_m
    return (
        length + (options.photos_per_strip - 1) * options.base_m,
        width + (options.strips - 1) * options.strip_spacing_m,
    )


def steepest_ray(options: SurveyOptions) -> float:
    """Tangent of the largest nadir angle of a photograph's ray, with tilts and room for the distortion."""
    half_diagonal = 0.5 * math.hypot(*options.size_px) * options.pixel_pitch_mm
    offset = math.hypot(*options.principal_point_mm)
    angle = math.atan(1.08 * (half_diagonal + offset) / options.principal_distance_mm)
    tilt = math.sqrt(2.0) * LIMIT_OF_TILT * math.radians(options.tilt_sigma_deg)
    return math.tan(min(angle + tilt, math.radians(80.0)))


def _extent(options: SurveyOptions) -> tuple[int, int]:
    """Rows and columns of terrain nodes that hold every footprint."""
    length, width = block_size(options)
    lowest = options.flying_height_m + 0.8 * options.relief_m + 3.0 * options.position_sigma_m
    half = 0.5 * math.hypot(*options.footprint_m)
    margin = (
        steepest_ray(options) * lowest - half + 3.0 * options.position_sigma_m + 4.0 * options.terrain_step_m
    )
    c, s = abs(math.sin(math.radians(options.heading_deg))), abs(math.cos(math.radians(options.heading_deg)))
    size = (length * c + width * s + 2.0 * margin, length * s + width * c + 2.0 * margin)
    return math.ceil(size[1] / options.terrain_step_m) + 1, math.ceil(size[0] / options.terrain_step_m) + 1


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


def _reach(options: SurveyOptions, heights: Array) -> tuple[float, float]:
    """Sideways way per metre of height over a slope: of the flattest ray of all, and of the sun's."""
    slope = 1.3 * _longer_slope(heights, options.terrain_step_m, 20.0)
    sun = 1.0 / math.tan(math.radians(SUN_ELEVATION_DEG))

    def over_slope(tangent: float) -> float:
        return tangent / max(1.0 - slope * tangent, 0.2)

    return max(over_slope(steepest_ray(options)), over_slope(sun)), over_slope(sun)


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
    spots = spots[_is_open(objects, spots)]
    if len(spots) == 0 or count == 0:
        return np.empty((0, 2))
    chosen = [int(np.argmax(np.hypot(*(spots - middle).T)))]
    distance = np.hypot(*(spots - spots[chosen[0]]).T)
    while len(chosen) < count:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.hypot(*(spots - spots[chosen[-1]]).T))
    positions: Array = spots[chosen]
    return positions


def make_world(options: SurveyOptions) -> SyntheticWorld:
    """Build the world that a survey with these options flies over.

    Raises
    ------
    CrsError
        If the CRS is not conformal, its axes are not east and north in metres, or the block is too large.
    """
    frame = MapFrame(options.crs, HeightSystem.ellipsoidal())
    frame.require_conformal()
    axes = grid_axes(options.crs)
    if axes.east_north_from_map != ((1.0, 0.0), (0.0, 1.0)) or axes.unit_m != 1.0:
        raise CrsError("must have axes east and north in metres", field="crs", value=options.crs)
    turn = math.radians(90.0 - options.heading_deg)
    streams = [np.random.default_rng([options.seed, number]) for number in range(5)]
    shape = _extent(options)
    step = options.terrain_step_m
    extent = ((shape[1] - 1) * step, (shape[0] - 1) * step)
    terrain = _terrain(options, streams[0], shape)
    west, north = (
        np.round(np.array(options.centre) / step) * step + [-0.5 * extent[0], 0.5 * extent[1]]
    ).tolist()
    west, north = math.floor(west / step) * step, math.ceil(north / step) * step
    low, high = float(terrain.heights.min()), options.terrain_height_m + 1.3 * options.flying_height_m
    high = max(high, terrain.highest + _TALLEST) + 20.0
    tangent = TangentFrame.at_map(frame, (*options.centre, options.terrain_height_m))
    polynomial = fit_map_polynomial(
        frame, tangent, (west, north - extent[1], low - 20.0), (west + extent[0], north, high)
    )
    places = layout.plan(streams[1], extent, block_size(options), turn)

    def ground(points: Array) -> Array:
        out = np.empty(len(points))
        heights_of_points(
            terrain.heights, step, np.ascontiguousarray(points[:, 0]), np.ascontiguousarray(points[:, 1]), out
        )
        return out

    houses = layout.build_village(streams[1], places, options.buildings, ground)
    trees = layout.plant_trees(streams[2], places, houses, options.trees, ground)
    nowhere = np.zeros(2)
    reach, sun_reach = _reach(options, terrain.heights)
    cell = max(8.0, max(extent) / 1000.0)
    objects = object_arrays(
        building_rows(houses, nowhere), tree_rows(trees, nowhere), terrain.heights, step, reach, cell
    )
    targets = _choose_targets(options, streams[3], places, objects, turn)
    texture = _texture(options, streams[4], places, terrain, objects, houses, trees, targets)
    texture = texture._replace(
        shadow_reach=objects.tallest * sun_reach / math.cos(math.radians(SUN_ELEVATION_DEG))
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
