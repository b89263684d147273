"""What a point of the world looks like: fields, roads, wood floor, roofs, walls and crowns.

Everything is a function of position, limited in detail to the ground sampling distance, so that one sample
per pixel shows no aliasing on open ground. Colours are (red, green, blue), 0 to 255.
"""

from __future__ import annotations

import math

from stereomate.jit import inline_kernel, kernel
from stereomate.synthetic.kernels.curve import Array
from stereomate.synthetic.kernels.scene import FACES, Index, Single

Colour = tuple[float, float, float]
Lit = tuple[float, float, float, float, float, float]  # colour and outward normal


@inline_kernel
def periodic_noise(tile: Single, u: float, v: float) -> float:
    """Bilinear sample of a periodic tile at (u, v) in nodes."""
    size = tile.shape[0]  # a power of two
    fu, fv = math.floor(u), math.floor(v)
    c, r = int(fu) & (size - 1), int(fv) & (size - 1)
    d, e = u - fu, v - fv
    c1, r1 = (c + 1) & (size - 1), (r + 1) & (size - 1)
    upper = tile[r, c] + (tile[r, c1] - tile[r, c]) * d
    lower = tile[r1, c] + (tile[r1, c1] - tile[r1, c]) * d
    return float(upper + (lower - upper) * e)


@inline_kernel
def fine_noise(tile: Single, gsd: float, x: float, y: float) -> float:
    """Sum of two turned copies of the fine tile (two nodes per GSD): it never repeats."""
    unit = 2.0 / gsd
    first = periodic_noise(tile, unit * (0.8 * x + 0.6 * y), unit * (0.8 * y - 0.6 * x))
    unit *= 0.7391
    second = periodic_noise(tile, unit * (0.2756 * x - 0.9613 * y) + 77.3, unit * (0.2756 * y + 0.9613 * x))
    return first + second


@inline_kernel
def coarse_noise(tile: Single, gsd: float, x: float, y: float) -> float:
    """Pink mottling from a few GSD to a hundred."""
    unit = 0.5 / gsd
    return periodic_noise(tile, unit * (0.6 * x + 0.8 * y), unit * (0.6 * y - 0.8 * x))


@inline_kernel
def cover(distance: float, gsd: float) -> float:
    """Share of a pixel on the positive side of an edge at a signed distance."""
    return min(1.0, max(0.0, distance / gsd + 0.5))


@inline_kernel
def grid_sample(grid: Single, col: float, row: float) -> float:
    """Bilinear sample of a grid, at its border beyond it."""
    rows, cols = grid.shape
    col, row = min(max(col, 0.0), cols - 1.001), min(max(row, 0.0), rows - 1.001)
    c, r = int(col), int(row)
    d, e = col - c, row - r
    upper = grid[r, c] + (grid[r, c + 1] - grid[r, c]) * d
    lower = grid[r + 1, c] + (grid[r + 1, c + 1] - grid[r + 1, c]) * d
    return float(upper + (lower - upper) * e)


@inline_kernel
def road_distance(roads: Array, i: int, x: float, y: float) -> float:
    """Distance from a winding road's centre line v = a1 sin(k1 u) + a2 sin(k2 u), less its half width."""
    x, y = x - roads[i, 0], y - roads[i, 1]
    u, v = x * roads[i, 2] + y * roads[i, 3], -x * roads[i, 3] + y * roads[i, 2]
    rough = abs(v) - abs(roads[i, 4]) - abs(roads[i, 6])
    if rough > 50.0:
        return float(rough)
    first, second = roads[i, 5] * u, roads[i, 7] * u
    centre = roads[i, 4] * math.sin(first) + roads[i, 6] * math.sin(second)
    slope = roads[i, 4] * roads[i, 5] * math.cos(first) + roads[i, 6] * roads[i, 7] * math.cos(second)
    return float(abs(v - centre) / math.sqrt(1.0 + slope * slope) - roads[i, 8])


@inline_kernel
def mixed(share: float, red: float, green: float, blue: float, towards: Colour) -> Colour:
    """A colour moved by a share towards another."""
    return (
        red + share * (towards[0] - red),
        green + share * (towards[1] - green),
        blue + share * (towards[2] - blue),
    )


@inline_kernel
def parcel_colour(seeds: Array, looks: Single, mesh: float, gsd: float, x: float, y: float) -> Colour:
    """Fields with rows, separated by hedges: the nearest of jittered seeds."""
    rows, cols = looks.shape[:2]
    c0, r0 = math.floor(x / mesh), math.floor(-y / mesh)
    near, nearer, at_r, at_c = 1e30, 1e30, 0, 0
    for r in range(max(r0 - 1, 0), min(r0 + 2, rows)):
        for c in range(max(c0 - 1, 0), min(c0 + 2, cols)):
            dx, dy = x - seeds[r, c, 0], 1.5 * (y - seeds[r, c, 1])
            d = dx * dx + dy * dy
            if d < nearer:
                near, nearer, at_r, at_c = nearer, d, r, c
            elif d < near:
                near = d
    period, contrast = looks[at_r, at_c, 5], looks[at_r, at_c, 6]
    across = x * looks[at_r, at_c, 3] + y * looks[at_r, at_c, 4]
    light = 1.0 + contrast * math.sin(2.0 * math.pi / period * across)
    hedge = cover(1.1 - 0.45 * (math.sqrt(near) - math.sqrt(nearer)), gsd)
    hedge *= 1.0 if contrast > 0.03 else 0.25
    return mixed(
        hedge,
        light * looks[at_r, at_c, 0],
        light * looks[at_r, at_c, 1],
        light * looks[at_r, at_c, 2],
        (62.0, 82.0, 48.0),
    )


@inline_kernel
def ground_colour(
    fine: Single,
    coarse: Single,
    shade: Single,
    step: float,
    seeds: Array,
    looks: Single,
    mesh: float,
    roads: Array,
    woods: Array,
    gsd: float,
    x: float,
    y: float,
) -> Colour:
    """Colour of the sunlit ground at a local map position."""
    red, green, blue = parcel_colour(seeds, looks, mesh, gsd, x, y)
    detail, mottling = fine_noise(fine, gsd, x, y), coarse_noise(coarse, gsd, x, y)
    for i in range(woods.shape[0]):
        dx, dy = x - woods[i, 0], y - woods[i, 1]
        u = (dx * woods[i, 4] + dy * woods[i, 5]) / woods[i, 2]
        v = (-dx * woods[i, 5] + dy * woods[i, 4]) / woods[i, 3]
        inside = (1.0 - math.sqrt(u * u + v * v)) * woods[i, 3] + 4.0 * mottling
        red, green, blue = mixed(cover(0.3 * inside, gsd), red, green, blue, (84.0, 82.0, 56.0))
    contrast = 1.0
    for i in range(roads.shape[0]):
        distance = road_distance(roads, i, x, y)
        if distance < 3.0:
            verge = 0.8 * cover(1.0 + 0.3 * mottling - distance, gsd)
            red, green, blue = mixed(verge, red, green, blue, (156.0, 148.0, 122.0))
            asphalt = cover(-distance, gsd)
            red, green, blue = mixed(asphalt, red, green, blue, (132.0, 131.0, 129.0))
            contrast = min(contrast, 1.0 - 0.45 * asphalt)
    light = 1.0 + contrast * (0.085 * detail + 0.07 * mottling)
    light = max(light * grid_sample(shade, x / step, -y / step), 0.1)
    return light * red, light * green, light * blue


@inline_kernel
def paint_targets(
    targets: Array,
    first: Index,
    items: Index,
    size: float,
    cols: int,
    gsd: float,
    x: float,
    y: float,
    red: float,
    green: float,
    blue: float,
) -> Colour:
    """Signalised points: a white disc on a black one of twice its radius."""
    cell = math.floor(-y / size) * cols + math.floor(x / size)
    if not 0 <= cell < first.shape[0] - 1:
        return red, green, blue
    for k in range(first[cell], first[cell + 1]):
        i = items[k]
        distance = math.sqrt((x - targets[i, 0]) ** 2 + (y - targets[i, 1]) ** 2)
        black, white = cover(2.0 * targets[i, 2] - distance, gsd), cover(targets[i, 2] - distance, gsd)
        red, green, blue = mixed(black, red, green, blue, (28.0, 28.0, 30.0))
        red, green, blue = mixed(white, red, green, blue, (238.0, 238.0, 236.0))
    return red, green, blue


@kernel
def building_colour(
    buildings: Array,
    looks: Single,
    fine: Single,
    coarse: Single,
    gsd: float,
    item: int,
    face: int,
    x: float,
    y: float,
    h: float,
) -> Lit:
    """(r, g, b, nx, ny, nh): colour and outward normal of a roof or wall."""
    cosine, sine, slope = buildings[item, 2], buildings[item, 3], buildings[item, 8]
    du, dv = x - buildings[item, 0], y - buildings[item, 1]
    u, v = du * cosine + dv * sine, -du * sine + dv * cosine
    look, q, nh = 3, h, 0.0
    if face <= 1:
        sign = 1.0 if face == 0 else -1.0
        length = math.sqrt(1.0 + slope * slope)
        nx, ny, nh = -sign * slope / length * sine, sign * slope / length * cosine, 1.0 / length
        look, p, q = 0, u, v * length
    elif face <= 3:
        sign = 1.0 if face == 2 else -1.0
        nx, ny, p = sign * cosine, sign * sine, v
    else:
        sign = 1.0 if face == 4 else -1.0
        nx, ny, p = -sign * sine, sign * cosine, u
    p += 13.7 * item
    light = 1.0 + 0.07 * fine_noise(fine, gsd, p, q) + 0.05 * coarse_noise(coarse, gsd, p, q)
    return light * looks[item, look], light * looks[item, look + 1], light * looks[item, look + 2], nx, ny, nh


@kernel
def tree_colour(
    trees: Array,
    looks: Single,
    fine: Single,
    coarse: Single,
    gsd: float,
    item: int,
    x: float,
    y: float,
    h: float,
) -> Lit:
    """(r, g, b, nx, ny, nh): colour and outward normal of a crown."""
    dx, dy = x - trees[item, 0], y - trees[item, 1]
    if trees[item, 5] == 0.0:
        radius = max(math.sqrt(dx * dx + dy * dy), 1e-6)
        nx, ny, nh = dx / radius, dy / radius, trees[item, 4] / (trees[item, 3] - trees[item, 2])
    else:
        half = 0.5 * (trees[item, 3] - trees[item, 2])
        nx, ny = dx / trees[item, 4] ** 2, dy / trees[item, 4] ** 2
        nh = (h - trees[item, 3] + half) / half**2
    length = math.sqrt(nx * nx + ny * ny + nh * nh)
    detail = fine_noise(fine, gsd, x + 0.7 * h, y - 0.5 * h)
    mottling = coarse_noise(coarse, gsd, 2.0 * x + 0.7 * h, 2.0 * y - 0.5 * h)
    light = 1.0 + 0.12 * detail + 0.10 * mottling
    red, green, blue = light * looks[item, 0], light * looks[item, 1], light * looks[item, 2]
    return red, green, blue, nx / length, ny / length, nh / length


@inline_kernel
def surface_kind(count: int, surface: int) -> tuple[int, int]:
    """(item, face) of an object's surface number; face is -1 for trees, whose item counts from 0 again."""
    if surface <= FACES * count:
        return (surface - 1) // FACES, (surface - 1) % FACES
    return surface - 1 - FACES * count, -1
