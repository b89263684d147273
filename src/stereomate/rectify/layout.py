"""What the products of a block will be: which pairs are models, how the grid lies, which law they share.

All of it is decided from positions and heights, before a pixel is read; the result is a value that goes
into ``stereo.json``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stereomate.coverage.pairs import Pair

Array = NDArray[np.float64]

# Models of one product share a direction of rows; bases further off than this belong to another product.
DIRECTION_TOLERANCE = math.radians(20.0)
# Less common ground than this share of the smaller footprint makes no model.
MIN_OVERLAP = 0.15
# Weight of a base/height ratio e times too large or small against the tangent of the steepest ray.
BASE_WEIGHT = 0.5


@dataclass(frozen=True)
class StereoModel:
    """A model that serves a stereo product: left and right photograph and its own base in product axes.

    Attributes
    ----------
    left, right : int
        Indices of the photographs; right is -1 in an orthophoto without stereomate.
    base_u_m, base_v_m, base_z_m : float
        Right centre minus left, along the rows, across them (to the left of u), and in height.
    height_above_ground_m : float
        Mean height of the centres above the ground.
    penalty : float
        Added to the obliquity when models compete for ground: how unsuitable the base is.
    """

    left: int
    right: int
    base_u_m: float = 0.0
    base_v_m: float = 0.0
    base_z_m: float = 0.0
    height_above_ground_m: float = math.nan
    penalty: float = 0.0


def of_one_kind(models: Sequence[StereoModel]) -> bool:
    """Whether all have a right photograph, or none: ground of one kind is not to be had from the other."""
    return len({m.right >= 0 for m in models}) < 2


def axis_direction(dx: float, dy: float) -> float:
    """Direction of an axis, in (-pi/2, pi/2]: its east component is >= 0; exactly north-south gives north."""
    if dx < 0.0 or (dx == 0.0 and dy < 0.0):
        dx, dy = -dx, -dy
    return math.atan2(dy, dx)


def base_length(pair: Pair) -> float:
    """Horizontal length of the base, metres."""
    return math.hypot(pair.base[0], pair.base[1])


def base_axis(pair: Pair) -> float:
    """Direction of the base as an axis, see `axis_direction`."""
    return axis_direction(pair.base[0], pair.base[1])


def axis_difference(a: float, b: float) -> float:
    """Angle between two axes, in [0, pi/2]."""
    d = abs(a - b) % math.pi
    return min(d, math.pi - d)


def mean_axis(directions: Array, weights: Array) -> float:
    """Weighted mean of axes (angles doubled), in (-pi/2, pi/2]."""
    double = 2.0 * directions
    mean = 0.5 * math.atan2(float(weights @ np.sin(double)), float(weights @ np.cos(double)))
    return axis_direction(math.cos(mean), math.sin(mean))


def suitable_pairs(pairs: list[Pair], min_base_height: float, max_base_height: float) -> list[Pair]:
    """Pairs with enough common ground and a base/height ratio within limits."""
    return [
        c for c in pairs if c.overlap >= MIN_OVERLAP and min_base_height <= c.base_height <= max_base_height
    ]


def serving_groups(usable: list[Pair]) -> list[list[Pair]]:
    """Pairs sorted into products: each group shares one direction of the base.

    The direction with the most common ground comes first; photographs that no pair of that direction holds
    open another group. Pairs across strips of photographs that already have a model are left out.
    """
    groups: list[list[Pair]] = []
    served: set[int] = set()
    while usable:
        axes = np.array([base_axis(c) for c in usable])
        weights = np.array([c.overlap for c in usable])
        main = _main_axis(axes, weights)
        near = [
            c
            for c, axis in zip(usable, axes, strict=True)
            if axis_difference(axis, main) <= DIRECTION_TOLERANCE
        ]
        groups.append(near)
        served |= {i for c in near for i in (c.first, c.second)}
        rest = set(map(id, usable)) - set(map(id, near))
        usable = [c for c in usable if id(c) in rest and not (c.first in served and c.second in served)]
    return groups


def _main_axis(axes: Array, weights: Array) -> float:
    """The axis with the most weight around it: histogram of 1 degree, then the mean of what is near."""
    bins = 180
    index = np.floor((axes / math.pi + 0.5) * bins).astype(np.int64) % bins
    histogram = np.bincount(index, weights, bins)
    reach = round(math.degrees(DIRECTION_TOLERANCE) / 2.0)
    around = np.convolve(
        np.concatenate([histogram[-reach:], histogram, histogram[:reach]]), np.ones(2 * reach + 1), "valid"
    )
    peak = (int(np.argmax(around)) + 0.5) / bins * math.pi - 0.5 * math.pi
    near = np.array([axis_difference(a, peak) <= DIRECTION_TOLERANCE for a in axes])
    return mean_axis(axes[near], weights[near])


def y_parallax_px(pair: Pair, rotation: float, object_height_m: float, gsd: float) -> float:
    """y-parallax in pixels that an object shows in a product whose rows run along `rotation`.

    B sin(delta) dh / (Z - dh) / gsd (theory: one law per product, many models in a block).
    """
    delta = axis_difference(base_axis(pair), rotation)
    depth = pair.height_above_ground_m - object_height_m
    if depth <= 0.0:
        return math.inf
    return base_length(pair) * math.sin(delta) * object_height_m / depth / gsd


def choose_rotation(group: list[Pair], object_height_m: float, gsd: float) -> float:
    """Direction of the rows: 0 (north-up) where that leaves less than 1 px of y-parallax in every model."""
    if all(y_parallax_px(c, 0.0, object_height_m, gsd) < 1.0 for c in group):
        return 0.0
    return mean_axis(np.array([base_axis(c) for c in group]), np.array([c.overlap for c in group]))


def oriented_models(group: list[Pair], rotation: float) -> list[StereoModel]:
    """The models of a product; left is the photograph whose centre has the smaller u, whatever the order.

    The penalty grows with the logarithm of the base/height ratio over the group's usual one (the median of
    each photograph's most overlapping pair, kept within 0.25 to 0.8): with 80 % overlap every second
    photograph serves better than the next one.
    """
    closest: dict[int, Pair] = {}
    for c in group:
        for i in (c.first, c.second):
            if i not in closest or c.overlap > closest[i].overlap:
                closest[i] = c
    usual = float(np.median([c.base_height for c in closest.values()]))
    target = min(max(usual, 0.25), 0.8)
    cos, sin = (1.0, 0.0) if rotation == 0.0 else (math.cos(rotation), math.sin(rotation))
    models = []
    for c in group:
        dx, dy, dz = c.base
        u, v = cos * dx + sin * dy, -sin * dx + cos * dy
        left, right = c.first, c.second
        if u < 0.0:
            left, right, u, v, dz = right, left, -u, -v, -dz
        penalty = BASE_WEIGHT * abs(math.log(c.base_height / target))
        models.append(StereoModel(left, right, u, v, dz, c.height_above_ground_m, penalty))
    return sorted(models, key=lambda m: (m.penalty, m.left, m.right))
