"""Photographs of the world, by rows of pixels."""

from __future__ import annotations

import math

import numpy as np

from stereomate.jit import kernel
from stereomate.synthetic.kernels.curve import Array, Index64, curve_of_ray, point_on_curve
from stereomate.synthetic.kernels.scene import GROUND, Objects, TerrainGrid, Texture
from stereomate.synthetic.kernels.texture import (
    building_colour,
    ground_colour,
    paint_targets,
    surface_kind,
    tree_colour,
)
from stereomate.synthetic.kernels.trace import (
    in_cells,
    nearest_object,
    object_before,
    start_of_ray,
    terrain_from_guess,
)

OUTSIDE = -1
SHADOW = 0.5
AMBIENT = 0.45


@kernel
def shade_rays(
    exponents: Index64,
    shifted: Array,
    rays: Array,
    terrain: TerrainGrid,
    objects: Objects,
    texture: Texture,
    colours: Array,
    surfaces: Index64,
    distances: Array,
) -> None:
    """Colours (n, 3), surface numbers and distances (n,) of rays (n, 3) of the tangent frame.

    A surface number is twice that of the surface, plus 1 where it lies in shadow.
    """
    heights, step, highest, steepest = terrain
    buildings, trees, tallest, size, first, items, tops, near, hides, shades = objects
    gsd, fine, coarse, shade, mesh, seeds, looks, roads, woods, targets = texture[:10]
    target_first, target_items, building_looks, tree_looks, sun, reach = texture[10:]
    powers, curve = np.empty((3, 5)), np.empty((3, 5))
    sun_x, sun_y, sun_h = sun[0], sun[1], sun[2]
    guess = 0.0
    for i in range(rays.shape[0]):
        dx, dy, dz = rays[i, 0], rays[i, 1], rays[i, 2]
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        curve_of_ray(exponents, shifted, dx / length, dy / length, dz / length, powers, curve)
        start = start_of_ray(curve, highest + tallest)
        s = terrain_from_guess(curve, start, guess, heights, step, steepest)
        guess = s if s > 0.0 else 0.0
        surfaces[i], distances[i] = OUTSIDE, s
        colours[i, 0] = colours[i, 1] = colours[i, 2] = 0.0
        if math.isnan(s):
            continue
        x, y, h = point_on_curve(curve, s)
        surface = GROUND
        if in_cells(hides, size, x, y):
            s, surface = object_before(
                curve, start, s, heights, step, steepest, tallest, buildings, trees, size, first, items, tops
            )
            distances[i] = s
        nx, ny, nh, lit = 0.0, 0.0, 1.0, 1.0
        if surface == GROUND:
            red, green, blue = ground_colour(
                fine, coarse, shade, step, seeds, looks, mesh, roads, woods, gsd, x, y
            )
            red, green, blue = paint_targets(
                targets, target_first, target_items, size, near.shape[1], gsd, x, y, red, green, blue
            )
        else:
            x, y, h = point_on_curve(curve, s)
            item, face = surface_kind(buildings.shape[0], surface)
            if face >= 0:
                red, green, blue, nx, ny, nh = building_colour(
                    buildings, building_looks, fine, coarse, gsd, item, face, x, y, h
                )
            else:
                red, green, blue, nx, ny, nh = tree_colour(
                    trees, tree_looks, fine, coarse, gsd, item, x, y, h
                )
            incidence = nx * sun_x + ny * sun_y + nh * sun_h
            lit = AMBIENT + (1.0 - AMBIENT) * incidence / sun_h
        in_shadow = lit <= AMBIENT
        if not in_shadow and in_cells(shades, size, x, y):
            _, blocker = nearest_object(
                buildings, trees, size, first, items, tops,
                x + 0.02 * nx, y + 0.02 * ny, h + 0.02 * nh,
                reach * sun_x, reach * sun_y, reach * sun_h, True,
            )  # fmt: skip
            in_shadow = blocker != GROUND
        if in_shadow:
            # lit by the sky: darker and bluer
            red, green, blue = 0.95 * SHADOW * red, SHADOW * green, 1.1 * SHADOW * blue
        else:
            red, green, blue = lit * red, lit * green, lit * blue
        colours[i, 0], colours[i, 1], colours[i, 2] = red, green, blue
        surfaces[i] = 2 * surface + (1 if in_shadow else 0)


@kernel
def edge_pixels(surfaces: Index64, distances: Array, first: int, last: int, found: Index64) -> int:
    """Find pixels of rows first..last with another surface, shadow or depth among their neighbours.

    Fills ``found`` (n, 2) with (row, col) and returns how many there are.
    """
    rows, cols = surfaces.shape
    count = 0
    for row in range(first, last):
        for col in range(cols):
            here, s = surfaces[row, col], distances[row, col]
            edge = False
            for r in range(max(row - 1, 0), min(row + 2, rows)):
                for c in range(max(col - 1, 0), min(col + 2, cols)):
                    if surfaces[r, c] != here or abs(distances[r, c] - s) > 0.02 * s:
                        edge = True
            if edge:
                found[count, 0], found[count, 1] = row, col
                count += 1
    return count


@kernel
def rays_inside_pixels(rays: Array, pixels: Index64, samples: int, out: Array) -> None:
    """Fill ``out`` (n * samples², 3) with samples x samples rays inside each pixel (n, 2).

    They are interpolated between the rays of the pixel's neighbours.
    """
    rows, cols = rays.shape[:2]
    i = 0
    for n in range(pixels.shape[0]):
        row, col = pixels[n, 0], pixels[n, 1]
        up, down, left, right = (
            max(row - 1, 0),
            min(row + 1, rows - 1),
            max(col - 1, 0),
            min(col + 1, cols - 1),
        )
        for a in range(samples):
            v = ((a + 0.5) / samples - 0.5) / (down - up)
            for b in range(samples):
                u = ((b + 0.5) / samples - 0.5) / (right - left)
                for axis in range(3):
                    out[i, axis] = (
                        rays[row, col, axis]
                        + u * (rays[row, right, axis] - rays[row, left, axis])
                        + v * (rays[down, col, axis] - rays[up, col, axis])
                    )
                i += 1
