"""Where things stand in the world: roads, fields, a village, a wood, signalised points."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stereomate.synthetic.objects import Building, Tree

Array = NDArray[np.float64]
Heights = Callable[[Array], Array]  # terrain heights of local positions (n, 2)

TERRACOTTA, SLATE, CONCRETE = (178.0, 98.0, 70.0), (104.0, 106.0, 114.0), (160.0, 158.0, 150.0)
WALLS = ((206.0, 196.0, 176.0), (190.0, 180.0, 166.0), (212.0, 208.0, 200.0))
CONIFER, BROADLEAF = (68.0, 90.0, 60.0), (102.0, 126.0, 68.0)

# Colour, contrast of the rows and its scatter of what grows on a parcel.
CROPS = (
    ((108.0, 122.0, 80.0), 0.015),  # pasture
    ((124.0, 136.0, 82.0), 0.02),  # meadow
    ((188.0, 168.0, 112.0), 0.06),  # wheat
    ((140.0, 112.0, 88.0), 0.09),  # ploughed
    ((172.0, 154.0, 118.0), 0.07),  # stubble
    ((98.0, 114.0, 72.0), 0.10),  # maize
)


@dataclass(frozen=True)
class Places:
    """The plan of the world in local map coordinates (origin: upper left node, north up)."""

    extent: tuple[float, float]  # width, height
    village: tuple[float, float, float]  # centre and radius
    roads: Array  # (n, 9), see kernels.texture.road_distance
    wood: Array  # (n, 6): centre, half axes, direction cosines


def plan(
    rng: np.random.Generator, extent: tuple[float, float], block: tuple[float, float], turn: float
) -> Places:
    """Village, wood and roads inside a block of the given length and width, turned by ``turn`` radians."""
    middle = np.array([0.5 * extent[0], -0.5 * extent[1]])
    along, across = np.array([math.cos(turn), math.sin(turn)]), np.array([-math.sin(turn), math.cos(turn)])
    village = middle - 0.15 * block[0] * along + 0.02 * block[1] * across
    radius = min(120.0, 0.22 * block[1], 0.16 * block[0])
    wood = middle + 0.17 * block[0] * along + 0.03 * block[1] * across
    phase = rng.uniform(-0.3, 0.3, 2)
    swing = 0.05 * min(extent)

    def road(direction: float, half_width: float, length: float) -> tuple[float, ...]:
        k = 2.0 * math.pi / length
        c, s = math.cos(direction), math.sin(direction)
        return (*village, c, s, swing, k, 0.4 * swing, 2.3 * k, half_width)

    roads = [
        road(turn + 0.12 + phase[0], 3.2, 0.9 * max(extent)),
        road(turn + 1.75 + phase[1], 2.4, 0.8 * max(extent)),
    ]
    side = village + 0.9 * radius * along + 0.6 * radius * across
    roads.append((*side, *across, 0.3 * swing, 0.02, 0.0, 0.0, 1.6))
    axes = (0.115 * block[0], 0.2 * block[1], math.cos(turn + 0.3), math.sin(turn + 0.3))
    return Places(extent, (*village, radius), np.array(roads), np.array([(*wood, *axes)]))


def road_distances(roads: Array, points: Array) -> tuple[Array, Array]:
    """Distance (n, roads) of points from the verge of each road, and the road's direction there (radians)."""
    x, y = points[:, None, 0] - roads[:, 0], points[:, None, 1] - roads[:, 1]
    u, v = x * roads[:, 2] + y * roads[:, 3], -x * roads[:, 3] + y * roads[:, 2]
    centre = roads[:, 4] * np.sin(roads[:, 5] * u) + roads[:, 6] * np.sin(roads[:, 7] * u)
    slope = roads[:, 4] * roads[:, 5] * np.cos(roads[:, 5] * u)
    slope += roads[:, 6] * roads[:, 7] * np.cos(roads[:, 7] * u)
    distance: Array = np.abs(v - centre) / np.hypot(1.0, slope) - roads[:, 8]
    return distance, np.arctan2(roads[:, 3], roads[:, 2]) + np.arctan(slope)


def build_village(
    rng: np.random.Generator, places: Places, count: int, ground: Heights
) -> tuple[Building, ...]:
    """Houses along the roads of the village, some with flat roofs, and a church with its tower.

    Coordinates are local; `ground` gives the terrain. Every house stands level: its base lies below the
    lowest ground of its footprint, its eaves above the highest.
    """
    x0, y0, radius = places.village
    taken: list[tuple[float, float, float]] = []
    houses: list[Building] = []

    def is_free(x: float, y: float, half_diagonal: float) -> bool:
        return all(math.hypot(x - a, y - b) > half_diagonal + c + 1.5 for a, b, c in taken)

    for attempt in range(120 * count):
        if len(houses) >= count:
            break
        church = not houses
        half_length, half_width = (11.0, 5.0) if church else (rng.uniform(4.5, 8.0), rng.uniform(3.6, 5.0))
        distance, angle = rng.uniform(0.0, 1.0) ** 0.6 * radius, rng.uniform(0.0, 2.0 * math.pi)
        x, y = x0 + distance * math.cos(angle), y0 + distance * math.sin(angle)
        half_diagonal = math.hypot(half_length, half_width)
        verge, direction = road_distances(places.roads, np.array([[x, y]]))
        nearest = int(verge[0].argmin())
        room = 45.0 if attempt > 40 * count else 24.0
        if not (half_diagonal + 1.5 < verge[0, nearest] < room) or not is_free(x, y, half_diagonal):
            continue
        taken.append((x, y, half_diagonal))
        azimuth = direction[0, nearest] + rng.normal(0.0, 0.05) + (math.pi / 2 if rng.random() < 0.3 else 0.0)
        storey = 9.0 if church else rng.uniform(3.2, 6.5)
        flat = not church and rng.random() < 0.2
        rise = 0.0 if flat else half_width * rng.uniform(0.55, 0.95)
        houses.append(_house((x, y), azimuth, half_length, half_width, storey, rise, ground))
        if church:
            c, s = math.cos(azimuth), math.sin(azimuth)
            offset = half_length + 2.6
            tower = (x + c * offset, y + s * offset)
            taken.append((*tower, 3.7))
            houses.append(_house(tower, azimuth, 2.6, 2.6, 19.0, 3.9, ground))
    return tuple(houses)


def _house(
    centre: tuple[float, float],
    azimuth: float,
    half_length: float,
    half_width: float,
    storey: float,
    rise: float,
    ground: Heights,
) -> Building:
    c, s = math.cos(azimuth), math.sin(azimuth)
    u, v = np.meshgrid(np.linspace(-half_length, half_length, 9), np.linspace(-half_width, half_width, 9))
    points = np.stack([centre[0] + c * u - s * v, centre[1] + s * u + c * v], axis=-1).reshape(-1, 2)
    heights = ground(points)
    eaves = float(heights.max()) + storey
    return Building(centre, azimuth, half_length, half_width, float(heights.min()) - 2.0, eaves, eaves + rise)


def _grown(rng: np.random.Generator, x: float, y: float, conifer: bool, ground: Heights) -> Tree:
    foot = float(ground(np.array([[x, y]]))[0])
    height = rng.uniform(11.0, 21.0) if conifer else rng.uniform(7.0, 15.0)
    radius = height * (rng.uniform(0.17, 0.24) if conifer else rng.uniform(0.24, 0.34))
    base = foot + (0.12 if conifer else 0.2) * height
    return Tree((x, y), base, foot + height, radius, conifer)


def plant_trees(
    rng: np.random.Generator, places: Places, houses: tuple[Building, ...], count: int, ground: Heights
) -> tuple[Tree, ...]:
    """A wood, gardens in the village and lone trees in the fields; nothing on roads or in houses."""
    spots = np.concatenate([_wood_spots(rng, places), _lone_spots(rng, places)])
    clear = road_distances(places.roads, spots)[0].min(axis=1) > 3.0
    for house in houses:
        gap = np.hypot(spots[:, 0] - house.centre[0], spots[:, 1] - house.centre[1])
        clear &= gap > math.hypot(house.half_length, house.half_width) + 3.0
    spots = spots[clear]
    if len(spots) > count:
        spots = spots[np.sort(rng.permutation(len(spots))[:count])]
    return tuple(_grown(rng, float(x), float(y), bool(rng.random() < share), ground) for x, y, share in spots)


def _wood_spots(rng: np.random.Generator, places: Places) -> Array:
    """Jittered mesh inside the wood; the share of conifers drifts from one end to the other."""
    parts = [np.empty((0, 3))]
    for x0, y0, a, b, c, s in places.wood:
        mesh = 6.5
        u, v = np.meshgrid(np.arange(-a, a, mesh), np.arange(-b, b, mesh))
        u, v = (w + rng.uniform(-0.3, 0.3, w.shape) * mesh for w in (u, v))
        inside = (u / a) ** 2 + (v / b) ** 2 < rng.uniform(0.75, 1.0, u.shape)
        u, v = u[inside], v[inside]
        share = 0.15 + 0.7 * (u + a) / (2.0 * a)
        parts.append(np.stack([x0 + c * u - s * v, y0 + s * u + c * v, share], axis=-1))
    return np.concatenate(parts)


def _lone_spots(rng: np.random.Generator, places: Places) -> Array:
    width, height = places.extent
    x0, y0, radius = places.village
    fields = np.stack([rng.uniform(0.05, 0.95, 60) * width, -rng.uniform(0.05, 0.95, 60) * height], axis=-1)
    gardens = rng.normal(0.0, 0.5 * radius, (60, 2)) + np.array([x0, y0])
    spots = np.concatenate([fields, gardens])
    return np.concatenate([spots, np.full((len(spots), 1), 0.1)], axis=1)


def parcels(
    rng: np.random.Generator, extent: tuple[float, float], mesh: float, gsd: float
) -> tuple[Array, NDArray[np.float32]]:
    """Seeds (rows, cols, 2) and looks (rows, cols, 7) of the fields; their rows are no finer than 5 GSD."""
    shape = (math.ceil(extent[1] / mesh) + 1, math.ceil(extent[0] / mesh) + 1)
    rows, cols = np.mgrid[: shape[0], : shape[1]]
    jitter = rng.uniform(0.18, 0.82, (*shape, 2))
    seeds = np.stack([(cols + jitter[..., 0]) * mesh, -(rows + jitter[..., 1]) * mesh], axis=-1)
    looks = np.empty((*shape, 7), dtype=np.float32)
    kind = rng.choice(len(CROPS), size=shape, p=[0.24, 0.22, 0.16, 0.13, 0.13, 0.12])
    direction = rng.uniform(0.0, math.pi, shape)
    for number, (colour, contrast) in enumerate(CROPS):
        looks[kind == number, :3] = colour
        looks[kind == number, 6] = contrast
    looks[..., :3] *= rng.uniform(0.92, 1.08, (*shape, 1))
    looks[..., 3], looks[..., 4] = np.cos(direction), np.sin(direction)
    looks[..., 5] = np.maximum(rng.uniform(1.6, 3.0, shape), 5.0 * gsd)
    return seeds, looks


def building_looks(rng: np.random.Generator, houses: tuple[Building, ...]) -> NDArray[np.float32]:
    """Colours of roofs and walls (n, 6)."""
    looks = np.empty((len(houses), 6), dtype=np.float32)
    for row, house in zip(looks, houses, strict=True):
        flat = house.ridge == house.eaves
        row[:3] = CONCRETE if flat else (TERRACOTTA if rng.random() < 0.75 else SLATE)
        row[:3] *= rng.uniform(0.85, 1.12)
        row[3:] = WALLS[rng.integers(len(WALLS))]
    return looks


def tree_looks(rng: np.random.Generator, trees: tuple[Tree, ...]) -> NDArray[np.float32]:
    """Colours of crowns (m, 3)."""
    base = np.array([CONIFER if tree.conifer else BROADLEAF for tree in trees], dtype=np.float32).reshape(
        -1, 3
    )
    tint = rng.normal(1.0, 0.07, (len(trees), 1)) * rng.normal(1.0, 0.03, (len(trees), 3))
    looks: NDArray[np.float32] = (base * tint).astype(np.float32)
    return looks
