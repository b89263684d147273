"""Rays against the terrain, buildings and trees: the first surface met, exactly."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import inline_kernel, kernel
from stereomate.synthetic.kernels.curve import (
    Array,
    Index64,
    curve_of_ray,
    point_on_curve,
    shift_terms,
    velocity_on_curve,
)
from stereomate.synthetic.kernels.scene import FACES, GROUND, Index, Objects, TerrainGrid


@inline_kernel
def height_and_slope(heights: Array, step: float, x: float, y: float) -> tuple[float, float, float]:
    """Height of the bilinear surface and its gradient (per metre east and north); NaN outside the grid."""
    rows, cols = heights.shape
    col, row = x / step, -y / step
    if not (col >= 0.0 and row >= 0.0 and col <= cols - 1 and row <= rows - 1):
        return np.nan, np.nan, np.nan
    c, r = min(int(col), cols - 2), min(int(row), rows - 2)
    u, v = col - c, row - r
    h00, h01 = heights[r, c], heights[r, c + 1]
    h10, h11 = heights[r + 1, c], heights[r + 1, c + 1]
    upper, lower = h00 + (h01 - h00) * u, h10 + (h11 - h10) * u
    east = ((h01 - h00) + ((h11 - h10) - (h01 - h00)) * v) / step
    return upper + (lower - upper) * v, east, (upper - lower) / step


@kernel
def heights_of_points(heights: Array, step: float, x: Array, y: Array, out: Array) -> None:
    """Terrain heights of many points."""
    for i in range(x.shape[0]):
        out[i] = height_and_slope(heights, step, x[i], y[i])[0]


@kernel
def trace_terrain(curve: Array, s: float, heights: Array, step: float, steepest: float, lift: float) -> float:
    """Distance, from s on, at which the ray first meets the terrain raised by ``lift``; NaN if it never does.

    A step never longer than the gap allows at the steepest slope cannot pass through a ridge; within a
    millimetre Newton's method ends it.
    """
    for _ in range(1000):
        x, y, h = point_on_curve(curve, s)
        ground, east, north = height_and_slope(heights, step, x, y)
        if math.isnan(ground):
            return np.nan
        gap = h - ground - lift
        if abs(gap) < 1e-10:
            return s
        vx, vy, vh = velocity_on_curve(curve, s)
        closing = -vh + steepest * math.sqrt(vx * vx + vy * vy)
        if gap > 1e-3:
            if closing <= 0.0:
                return np.nan
            s += 0.999 * gap / closing
            continue
        rate = vh - east * vx - north * vy
        if rate < 0.0:
            s -= gap / rate
        elif gap > 0.0 and closing > 0.0:
            s += 1e-3 / closing
        else:
            return np.nan
    return s


@inline_kernel
def terrain_from_guess(
    curve: Array, start: float, guess: float, heights: Array, step: float, steepest: float
) -> float:
    """As `trace_terrain`, quicker with a good guess.

    A ray that falls faster than any slope rises meets the terrain once only, so that Newton's method from
    anywhere finds the first and only place; other rays, and those for which it wavers, are traced from
    ``start``.
    """
    vx, vy, vh = velocity_on_curve(curve, guess)
    if -vh > 1.01 * steepest * math.sqrt(vx * vx + vy * vy):
        s = guess
        for _ in range(12):
            x, y, h = point_on_curve(curve, s)
            ground, east, north = height_and_slope(heights, step, x, y)
            gap = h - ground
            if abs(gap) < 1e-10:
                return s
            vx, vy, vh = velocity_on_curve(curve, s)
            s -= gap / (vh - east * vx - north * vy)
            if not s >= 0.0:
                break
    return trace_terrain(curve, start, heights, step, steepest, 0.0)


@kernel
def meet_building(
    buildings: Array, item: int, px: float, py: float, ph: float, vx: float, vy: float, vh: float
) -> tuple[float, int]:
    """Where the line P + t V enters a building, t in [0, 1], and by which face; (2, 0) if it does not."""
    x, y = px - buildings[item, 0], py - buildings[item, 1]
    pu, pv = x * buildings[item, 2] + y * buildings[item, 3], -x * buildings[item, 3] + y * buildings[item, 2]
    du, dv = (
        vx * buildings[item, 2] + vy * buildings[item, 3],
        -vx * buildings[item, 3] + vy * buildings[item, 2],
    )
    slope = buildings[item, 8]
    ridge = buildings[item, 7] + slope * buildings[item, 5]
    enter, leave, face = -1.0, 2.0, 0
    for plane in range(7):
        if plane == 0:
            room, rate = ridge - ph - slope * pv, vh + slope * dv
        elif plane == 1:
            room, rate = ridge - ph + slope * pv, vh - slope * dv
        elif plane == 2:
            room, rate = buildings[item, 4] - pu, du
        elif plane == 3:
            room, rate = buildings[item, 4] + pu, -du
        elif plane == 4:
            room, rate = buildings[item, 5] - pv, dv
        elif plane == 5:
            room, rate = buildings[item, 5] + pv, -dv
        else:
            room, rate = ph - buildings[item, 6], -vh
        if rate == 0.0:
            if room < 0.0:
                return 2.0, 0
            continue
        t = room / rate
        if rate < 0.0:
            if t > enter:
                enter, face = t, plane
        elif t < leave:
            leave = t
    if enter < leave and enter >= 0.0 and enter <= 1.0:
        return enter, face
    return 2.0, 0


@kernel
def meet_tree(
    trees: Array, item: int, px: float, py: float, ph: float, vx: float, vy: float, vh: float
) -> float:
    """Where the line P + t V enters a crown, t in [0, 1]; 2 if it does not."""
    x, y = px - trees[item, 0], py - trees[item, 1]
    if trees[item, 5] == 0.0:  # cone with its apex at the top
        ratio = trees[item, 4] / (trees[item, 3] - trees[item, 2])
        z, vz = ratio * (trees[item, 3] - ph), -ratio * vh
        a = vx * vx + vy * vy - vz * vz
        b = x * vx + y * vy - z * vz
        c = x * x + y * y - z * z
    else:
        half = 0.5 * (trees[item, 3] - trees[item, 2])
        ratio = trees[item, 4] / half
        z, vz = ratio * (ph - trees[item, 3] + half), ratio * vh
        a = vx * vx + vy * vy + vz * vz
        b = x * vx + y * vy + z * vz
        c = x * x + y * y + z * z - trees[item, 4] * trees[item, 4]
    root = b * b - a * c
    if root < 0.0 or a == 0.0:
        return 2.0
    root = math.sqrt(root)
    first, second = (-b - root) / a, (-b + root) / a
    if first > second:
        first, second = second, first
    for t in (first, second):
        h = ph + t * vh
        if 0.0 <= t <= 1.0 and trees[item, 2] <= h <= trees[item, 3]:
            return float(t)
    return 2.0


@kernel
def meet_object(
    buildings: Array,
    trees: Array,
    item: int,
    px: float,
    py: float,
    ph: float,
    vx: float,
    vy: float,
    vh: float,
) -> tuple[float, int]:
    """(t, surface number) where the line enters object ``item``."""
    count = buildings.shape[0]
    if item < count:
        t, face = meet_building(buildings, item, px, py, ph, vx, vy, vh)
        return t, 1 + FACES * item + face
    t = meet_tree(trees, item - count, px, py, ph, vx, vy, vh)
    return t, 1 + FACES * count + (item - count)


@kernel
def item_of_surface(count: int, surface: int) -> int:
    """The object a surface number belongs to, in a world of ``count`` buildings."""
    if surface <= FACES * count:
        return (surface - 1) // FACES
    return surface - 1 - FACES * count + count


@kernel
def nearest_object(
    buildings: Array,
    trees: Array,
    size: float,
    first: Index,
    items: Index,
    tops: Array,
    px: float,
    py: float,
    ph: float,
    vx: float,
    vy: float,
    vh: float,
    any_will_do: bool,
) -> tuple[float, int]:
    """(t, surface number) of the first object along P + t V, t in [0, 1]; (2, GROUND) if there is none.

    Walks the cells of the search grid under the line.
    """
    rows, cols = tops.shape
    gx, gy, wx, wy = px / size, -py / size, vx / size, -vy / size
    c, r = math.floor(gx), math.floor(gy)
    step_c, step_r = (1 if wx > 0.0 else -1), (1 if wy > 0.0 else -1)
    next_c = (c + (1 if wx > 0.0 else 0) - gx) / wx if wx != 0.0 else np.inf
    next_r = (r + (1 if wy > 0.0 else 0) - gy) / wy if wy != 0.0 else np.inf
    over_c = abs(1.0 / wx) if wx != 0.0 else np.inf
    over_r = abs(1.0 / wy) if wy != 0.0 else np.inf
    best, surface, t = 2.0, GROUND, 0.0
    while t <= 1.0:
        leave = min(next_c, next_r)
        if 0 <= c < cols and 0 <= r < rows:
            lowest = min(ph + t * vh, ph + min(leave, 1.0) * vh)
            if lowest <= tops[r, c]:
                cell = r * cols + c
                for k in range(first[cell], first[cell + 1]):
                    hit, number = meet_object(buildings, trees, int(items[k]), px, py, ph, vx, vy, vh)
                    if hit < best:
                        best, surface = hit, number
                if best <= leave or (any_will_do and best <= 1.0):
                    break
        t = leave
        if next_c < next_r:
            c += step_c
            next_c += over_c
        else:
            r += step_r
            next_r += over_r
    return best, surface


@inline_kernel
def in_cells(marked: NDArray[np.uint8], size: float, x: float, y: float) -> bool:
    """Whether a ground point lies in a marked cell of the search grid."""
    rows, cols = marked.shape
    c, r = math.floor(x / size), math.floor(-y / size)
    return bool(0 <= c < cols and 0 <= r < rows and marked[r, c] == 1)


@kernel
def start_above_objects(
    curve: Array, start: float, ground: float, heights: Array, step: float, steepest: float, tallest: float
) -> float:
    """A distance before which the ray is higher above the ground than any object is tall."""
    vx, vy, vh = velocity_on_curve(curve, ground)
    opening = -vh - steepest * math.sqrt(vx * vx + vy * vy)
    if opening > 0.3:
        return max(start, ground - 1.01 * tallest / opening)
    above = trace_terrain(curve, start, heights, step, steepest, tallest)
    if math.isnan(above) or above > ground:
        return start
    return above


@kernel
def object_before(
    curve: Array,
    start: float,
    ground: float,
    heights: Array,
    step: float,
    steepest: float,
    tallest: float,
    buildings: Array,
    trees: Array,
    size: float,
    first: Index,
    items: Index,
    tops: Array,
) -> tuple[float, int]:
    """(distance, surface number) of the first object before the ground at ``ground``, or that ground."""
    above = start_above_objects(curve, start, ground, heights, step, steepest, tallest)
    px, py, ph = point_on_curve(curve, above)
    qx, qy, qh = point_on_curve(curve, ground)
    t, surface = nearest_object(
        buildings, trees, size, first, items, tops, px, py, ph, qx - px, qy - py, qh - ph, False
    )
    if surface == GROUND:
        return ground, GROUND
    s = above + t * (ground - above)
    # once more with the line tangential to the ray where it meets the object: the ray is not quite straight
    item = item_of_surface(buildings.shape[0], surface)
    px, py, ph = point_on_curve(curve, s)
    vx, vy, vh = velocity_on_curve(curve, s)
    t, again = meet_object(buildings, trees, item, px - vx, py - vy, ph - vh, 2.0 * vx, 2.0 * vy, 2.0 * vh)
    if t <= 1.0:
        return s + 2.0 * t - 1.0, again
    return s, surface


@inline_kernel
def start_of_ray(curve: Array, top: float) -> float:
    """Distance at which a descending ray comes down to the highest point of the world, or 0."""
    if curve[2, 0] <= top or curve[2, 1] >= 0.0:
        return 0.0
    return float((curve[2, 0] - top) / -curve[2, 1])


@kernel
def first_hits(
    exponents: Index64,
    terms: Array,
    scale: float,
    origins: Array,
    directions: Array,
    terrain: TerrainGrid,
    objects: Objects,
    points: Array,
    distances: Array,
    surfaces: Index64,
) -> None:
    """First surfaces of rays of the tangent frame: fills map points (n, 3), distances and surface numbers."""
    heights, step, highest, steepest = terrain
    buildings, trees, tallest, size, first, items, tops = objects[:7]
    powers, curve = np.empty((3, 5)), np.empty((3, 5))
    shifted = np.empty((exponents.shape[0], 3))
    for i in range(origins.shape[0]):
        if i == 0 or (
            origins[i, 0] != origins[i - 1, 0]
            or origins[i, 1] != origins[i - 1, 1]
            or origins[i, 2] != origins[i - 1, 2]
        ):
            shifted = shift_terms(exponents, terms, scale, origins[i, 0], origins[i, 1], origins[i, 2])
        curve_of_ray(exponents, shifted, directions[i, 0], directions[i, 1], directions[i, 2], powers, curve)
        start = start_of_ray(curve, highest + tallest)
        distances[i] = trace_terrain(curve, start, heights, step, steepest, 0.0)
        surfaces[i] = GROUND
        if not math.isnan(distances[i]) and items.shape[0] > 0:
            distances[i], surfaces[i] = object_before(
                curve,
                start,
                distances[i],
                heights,
                step,
                steepest,
                tallest,
                buildings,
                trees,
                size,
                first,
                items,
                tops,
            )
        points[i, 0], points[i, 1], points[i, 2] = point_on_curve(curve, distances[i])
