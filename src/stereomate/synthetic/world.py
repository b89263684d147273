"""A world with known truth: what is asked of it once it is made (`stereomate.synthetic.making`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import map_from_tangent, tangent_from_map
from stereomate.synthetic.geodesy import MapPolynomial
from stereomate.synthetic.kernels.scene import FACES, Scene
from stereomate.synthetic.kernels.trace import first_hits, heights_of_points
from stereomate.synthetic.objects import Building, Tree, is_open, object_boxes
from stereomate.synthetic.options import SurveyOptions

Array = NDArray[np.float64]


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
        return is_open(self.scene.objects, local)

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
