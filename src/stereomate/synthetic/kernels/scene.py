"""The arrays a ray meets, as named tuples that numba understands.

All positions are local map coordinates: metres east and north of the upper left node of the terrain grid
(so north is negative inside), ellipsoidal heights in metres.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Single = NDArray[np.float32]
Index = NDArray[np.int32]

# Columns of Objects.buildings.
CX, CY, COS, SIN, HALF_LENGTH, HALF_WIDTH, BASE, EAVES, ROOF_SLOPE = range(9)
# Columns of Objects.trees.
TREE_X, TREE_Y, CROWN_BASE, TREE_TOP, TREE_RADIUS, TREE_KIND = range(6)
CONE, ELLIPSOID = 0.0, 1.0

# Every building owns this many surface numbers, so that surface = 1 + FACES * building + face.
FACES = 8
GROUND = 0


class TerrainGrid(NamedTuple):
    """The bilinear surface of a regular grid: node (row, col) lies at (col * step, -row * step)."""

    heights: NDArray[np.float64]
    step: float
    highest: float
    steepest: float  # largest slope anywhere, as a tangent


class Objects(NamedTuple):
    """Convex buildings and tree crowns, with a search grid of square cells."""

    buildings: NDArray[np.float64]  # (n, 9)
    trees: NDArray[np.float64]  # (m, 6)
    tallest: float  # largest height of an object above the ground under it
    cell: float
    cell_first: NDArray[np.int32]  # (rows * cols + 1,): where the cell's items begin
    cell_items: NDArray[np.int32]
    cell_top: NDArray[np.float64]  # (rows, cols): highest object top in the cell, -inf when empty
    near: NDArray[np.uint8]  # (rows, cols): 1 within the reach of any ray or shadow, whatever its direction
    hides: NDArray[np.uint8]  # (rows, cols): 1 where an object may stand before the ground
    shades: NDArray[np.uint8]  # (rows, cols): 1 where an object may stand before the sun


class Texture(NamedTuple):
    """What the ground and the objects look like."""

    gsd: float  # finest detail is limited for this ground sampling distance
    fine: NDArray[np.float32]  # (n, n) periodic noise, unit variance, limited to 0.3 cycles per GSD
    coarse: NDArray[np.float32]  # (n, n) periodic noise, unit variance, pink
    shade: NDArray[np.float32]  # brightness of each terrain node under the sun, 1 on level ground
    parcel: float  # mesh of the parcels, metres
    parcel_seed: NDArray[np.float64]  # (rows, cols, 2)
    parcel_look: NDArray[np.float32]  # (rows, cols, 7): r, g, b, row direction x, y, row period, row contrast
    roads: NDArray[np.float64]  # (n, 9): see texture.road_distance
    wood: NDArray[np.float64]  # (n, 6): ellipse centre x, y, half axes, cos, sin
    targets: NDArray[np.float64]  # (n, 3): x, y, radius
    target_first: NDArray[np.int32]  # the targets of each cell of the search grid
    target_items: NDArray[np.int32]
    building_look: NDArray[np.float32]  # (n, 6): roof r, g, b, wall r, g, b
    tree_look: NDArray[np.float32]  # (m, 3)
    sun: NDArray[np.float64]  # (3,) unit vector towards the sun
    shadow_reach: float  # how far along a ray to the sun an object may stand, metres


class Scene(NamedTuple):
    terrain: TerrainGrid
    objects: Objects
    texture: Texture
