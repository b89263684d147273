"""Buildings and trees as values, where they stand, and the search grid that rays use."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stereomate.synthetic.kernels.scene import CONE, ELLIPSOID, Objects

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Building:
    """A convex building with a gabled or flat roof; plumb walls, map coordinates, ellipsoidal heights.

    The ridge runs along the length, in the direction ``azimuth`` (radians, counter-clockwise from grid east).
    """

    centre: tuple[float, float]
    azimuth: float
    half_length: float
    half_width: float
    base: float
    eaves: float
    ridge: float

    @property
    def roof_slope(self) -> float:
        """Tangent of the roof's inclination, 0 for a flat roof."""
        return (self.ridge - self.eaves) / self.half_width

    def corners(self) -> Array:
        """Roof corners (4 or 6, 3): the four at the eaves and, with a gable, the two ends of the ridge."""
        c, s = math.cos(self.azimuth), math.sin(self.azimuth)
        local = [
            (i * self.half_length, j * self.half_width, self.eaves)
            for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))
        ]
        if self.ridge > self.eaves:
            local += [(-self.half_length, 0.0, self.ridge), (self.half_length, 0.0, self.ridge)]
        u, v, h = np.array(local).T
        return np.stack([self.centre[0] + c * u - s * v, self.centre[1] + s * u + c * v, h], axis=-1)


@dataclass(frozen=True)
class Tree:
    """A crown: a cone with its apex at the top, or an upright ellipsoid of revolution."""

    centre: tuple[float, float]
    crown_base: float
    top: float
    radius: float
    conifer: bool


def building_rows(buildings: tuple[Building, ...], origin: Array) -> Array:
    """Buildings as the kernels want them (n, 9), in local map coordinates."""
    rows = [
        (
            b.centre[0] - origin[0],
            b.centre[1] - origin[1],
            math.cos(b.azimuth),
            math.sin(b.azimuth),
            b.half_length,
            b.half_width,
            b.base,
            b.eaves,
            b.roof_slope,
        )
        for b in buildings
    ]
    return np.array(rows, dtype=np.float64).reshape(-1, 9)


def tree_rows(trees: tuple[Tree, ...], origin: Array) -> Array:
    """Trees as the kernels want them (m, 6), in local map coordinates."""
    rows = [
        (
            t.centre[0] - origin[0],
            t.centre[1] - origin[1],
            t.crown_base,
            t.top,
            t.radius,
            CONE if t.conifer else ELLIPSOID,
        )
        for t in trees
    ]
    return np.array(rows, dtype=np.float64).reshape(-1, 6)


@dataclass(frozen=True)
class Reach:
    """How far objects hide and shade the ground.

    Attributes
    ----------
    view, sun : float
        Sideways way, per metre of height, of the flattest ray of a photograph and of the sun's.
    to_sun : (float, float)
        Direction on the map towards the sun, of unit length.
    """

    view: float
    sun: float
    to_sun: tuple[float, float]


def object_boxes(buildings: Array, trees: Array) -> tuple[Array, Array]:
    """Bounding boxes (n, 4: west, south, east, north) and tops of all objects."""
    half_x = np.abs(buildings[:, 4] * buildings[:, 2]) + np.abs(buildings[:, 5] * buildings[:, 3])
    half_y = np.abs(buildings[:, 4] * buildings[:, 3]) + np.abs(buildings[:, 5] * buildings[:, 2])
    x, y = np.r_[buildings[:, 0], trees[:, 0]], np.r_[buildings[:, 1], trees[:, 1]]
    hx, hy = np.r_[half_x, trees[:, 4]] + 0.05, np.r_[half_y, trees[:, 4]] + 0.05
    tops = np.r_[buildings[:, 7] + buildings[:, 8] * buildings[:, 5], trees[:, 3]]
    return np.stack([x - hx, y - hy, x + hx, y + hy], axis=-1), tops


def cell_lists(
    boxes: Array, cell: float, shape: tuple[int, int]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Which boxes touch each cell: first item of every cell (rows * cols + 1) and the items."""
    pairs = []
    for item, (west, south, east, north) in enumerate(boxes):
        c0, c1 = max(math.floor(west / cell), 0), min(math.floor(east / cell), shape[1] - 1)
        r0, r1 = max(math.floor(-north / cell), 0), min(math.floor(-south / cell), shape[0] - 1)
        pairs += [(r * shape[1] + c, item) for r in range(r0, r1 + 1) for c in range(c0, c1 + 1)]
    table = np.array(sorted(pairs), dtype=np.int32).reshape(-1, 2)
    first = np.searchsorted(table[:, 0], np.arange(shape[0] * shape[1] + 1)).astype(np.int32)
    return first, np.ascontiguousarray(table[:, 1])


def object_arrays(
    buildings: Array, trees: Array, heights: Array, step: float, reach: Reach, cell: float
) -> Objects:
    """Search grid over the objects.

    Parameters
    ----------
    heights : ndarray (rows, cols)
        Terrain nodes, the first at local (0, 0).
    step : float
        Mesh of the terrain.
    reach : Reach
        How far objects hide and shade the ground.
    cell : float
        Side of the grid's cells.
    """
    boxes, tops = object_boxes(buildings, trees)
    rows, cols = heights.shape
    shape = (math.ceil((rows - 1) * step / cell) + 1, math.ceil((cols - 1) * step / cell) + 1)
    first, items = cell_lists(boxes, cell, shape)
    top = np.full(shape[0] * shape[1], -np.inf)
    np.maximum.at(top, np.repeat(np.arange(top.size), np.diff(first)), tops[items])
    above = _heights_above_ground(boxes, tops, heights, step)
    tallest = float(above.max(initial=0.0))
    widest = tallest * max(reach.view, reach.sun)
    near = _touched(boxes + np.array([-widest, -widest, widest, widest]), cell, shape)
    hides = _touched(boxes + np.outer(above * reach.view, [-1.0, -1.0, 1.0, 1.0]), cell, shape)
    return Objects(
        buildings,
        trees,
        tallest,
        cell,
        first,
        items,
        top.reshape(shape),
        near,
        hides,
        _shaded(boxes, above, reach, cell, shape),
    )


def _heights_above_ground(boxes: Array, tops: Array, heights: Array, step: float) -> Array:
    """Height (n,) of every object's top above the lowest terrain node under it."""
    above = np.zeros(len(boxes))
    for i, ((west, south, east, north), highest) in enumerate(zip(boxes, tops, strict=True)):
        r0, r1 = max(math.floor(-north / step), 0), math.ceil(-south / step) + 1
        c0, c1 = max(math.floor(west / step), 0), math.ceil(east / step) + 1
        above[i] = highest - heights[r0:r1, c0:c1].min()
    return above


def _touched(boxes: Array, cell: float, shape: tuple[int, int]) -> NDArray[np.uint8]:
    """1 for the cells of a grid that any box touches."""
    first, _ = cell_lists(boxes, cell, shape)
    return (np.diff(first) > 0).astype(np.uint8).reshape(shape)


def _shaded(
    boxes: Array, above: Array, reach: Reach, cell: float, shape: tuple[int, int]
) -> NDArray[np.uint8]:
    """1 for the cells where a shadow may fall: those that boxes touch while they move away from the sun."""
    longest = float((above * reach.sun).max(initial=0.0))
    # between two places of a box lies less than half a cell, which the box is grown by
    away = [t * cell for t in range(math.ceil(longest / cell) + 1)]
    grown = boxes + 0.5 * cell * np.array([-1.0, -1.0, 1.0, 1.0])
    shades = np.zeros(shape, np.uint8)
    for t in away:
        moved = grown[above * reach.sun >= t - cell] - t * np.tile(reach.to_sun, 2)
        shades |= _touched(moved, cell, shape)
    return shades


def is_open(objects: Objects, local: Array) -> NDArray[np.bool_]:
    """Whether local positions (..., 2) lie away from objects and the places they may hide or shade."""
    rows, cols = objects.near.shape
    col = np.clip(np.floor(local[..., 0] / objects.cell).astype(int), 0, cols - 1)
    row = np.clip(np.floor(-local[..., 1] / objects.cell).astype(int), 0, rows - 1)
    open_here: NDArray[np.bool_] = objects.near[row, col] == 0
    return open_here
