"""Exact points of dense matches, and the surface raster that they make.

The geometry is that of `stereo.exact`: rays from both centres through the ground behind a match, in the
product axes (u, v, h), of which space around an object is an affine picture.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import inline_kernel, kernel
from stereomate.measurement.kernels.splines import spline_weights
from stereomate.terrain.kernels.sampling import CUBIC, bilinear_gradient, cubic_gradient, sample

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]

# Layers of points.
COL = 0
ROW = 1
HEIGHT = 2
ABOVE = 3
SIGMA = 4
MISS = 5
POINT_LAYERS = 6


@kernel
def shift_rows(coefficients: Floats32, columns: Floats, out: Floats32) -> None:
    """Values of rows at fractional columns; `coefficients` are those of cubic B-splines along the rows.

    Parameters
    ----------
    columns : (rows, cols)
        Pixel centres at whole numbers; NaN gives 0.
    """
    last = coefficients.shape[1] - 3
    for r in range(out.shape[0]):
        for c in range(out.shape[1]):
            x = columns[r, c]
            out[r, c] = 0.0
            if x >= 1.0 and x <= last:
                k = int(x)
                a, b, d, e = spline_weights(x - k)
                out[r, c] = (
                    a * coefficients[r, k - 1]
                    + b * coefficients[r, k]
                    + d * coefficients[r, k + 1]
                    + e * coefficients[r, k + 2]
                )


@kernel
def _node_value(nodes: Floats, k: int, x: float, y: float) -> float:
    """Bilinear value of a lattice (ny, nx, values) at node coordinates."""
    i = min(max(int(x), 0), nodes.shape[1] - 2)
    j = min(max(int(y), 0), nodes.shape[0] - 2)
    f, g = x - i, y - j
    upper = nodes[j, i, k] + f * (nodes[j, i + 1, k] - nodes[j, i, k])
    lower = nodes[j + 1, i, k] + f * (nodes[j + 1, i + 1, k] - nodes[j + 1, i, k])
    value: float = upper + g * (lower - upper)
    return value


@kernel
def _ground(
    method: int, patch: Floats, nodes: Floats, x: float, y: float, step: float, gsd: float
) -> tuple[float, float, float]:
    """(h, dh/du, dh/dv) of the height model at node coordinates, height system of the law."""
    i = min(max(int(x), 0), nodes.shape[1] - 2)
    j = min(max(int(y), 0), nodes.shape[0] - 2)
    col, row = _node_value(nodes, 0, x, y), _node_value(nodes, 1, x, y)
    if method == CUBIC:
        h, by_col, by_row = cubic_gradient(patch, col, row)
    else:
        h, by_col, by_row = bilinear_gradient(patch, col, row)
    scale = 1.0 / (step * gsd)
    u_col, u_row = nodes[j, i + 1, 0] - nodes[j, i, 0], nodes[j, i + 1, 1] - nodes[j, i, 1]
    v_col, v_row = nodes[j, i, 0] - nodes[j + 1, i, 0], nodes[j, i, 1] - nodes[j + 1, i, 1]
    h_u = (by_col * u_col + by_row * u_row) * scale
    h_v = (by_col * v_col + by_row * v_row) * scale
    return h + _node_value(nodes, 2, x, y), h_u, h_v


@kernel
def _object_point(
    left: tuple[float, float, float],
    right: tuple[float, float, float],
    slope: tuple[float, float],
    apart: tuple[float, float, float],
    noise: tuple[float, float, float],
) -> tuple[float, float, float]:
    """Where two rays meet: share of the way from the left ground to its centre, its variance, miss distance.

    Parameters
    ----------
    left, right : (u, v, h)
        From each centre to its ground point.
    slope : (dh/du, dh/dv)
        Of the ground at the right point.
    apart : (u, v, h)
        Left ground point minus right one.
    noise : (uu, uv, vv)
        Covariance of the right position in u and v, metres².

    Returns
    -------
    NaN three times where the rays are parallel.
    """
    lu, lv, lh = left
    ru, rv, rh = right
    h_u, h_v = slope
    du, dv, dh = apart
    quu, quv, qvv = noise
    nu, nv, nh = lv * rh - lh * rv, lh * ru - lu * rh, lu * rv - lv * ru
    square = nu * nu + nv * nv + nh * nh
    if not square > 0.0:
        return math.nan, math.nan, math.nan
    gap = nu * du + nv * dv + nh * dh
    # k: change of the gap by the right position
    ku, kv = nu + nh * h_u, nv + nh * h_v
    ju, jv = quu * ku + quv * kv, quv * ku + qvv * kv
    spread = ku * ju + kv * jv
    shift_u, shift_v = ju * gap / spread, jv * gap / spread
    du -= shift_u
    dv -= shift_v
    dh -= h_u * shift_u + h_v * shift_v
    # s = (D x dR) . n / n . n, and its change by D
    wu, wv, wh = rv * nh - rh * nv, rh * nu - ru * nh, ru * nv - rv * nu
    s = (du * wu + dv * wv + dh * wh) / square
    gu, gv = -(wu + wh * h_u) / square, -(wv + wh * h_v) / square
    across = gu * ju + gv * jv
    variance = gu * (quu * gu + quv * gv) + gv * (quv * gu + qvv * gv) - across * across / spread
    return s, max(variance, 0.0), gap / math.sqrt(square)


@kernel
def intersect_matches(
    parallax: Floats32,
    row_parallax: Floats32,
    variance: Floats32,
    covariance: Floats32,
    row_variance: Floats32,
    photographs: NDArray[np.uint16],
    mesh: int,
    systematic: float,
    method: int,
    patch: Floats,
    surface_nodes: Floats,
    ray_nodes: Floats,
    node_col: float,
    node_row: float,
    step: float,
    gsd: float,
    points: Floats32,
    pairs: NDArray[np.int16],
) -> None:
    """Object points of matches between an orthophoto and a stereomate brought over it.

    Parameters
    ----------
    parallax ... row_variance : (rows, cols)
        Matches, one for every mesh of `mesh` pixels, at its middle pixel.
    photographs : (2, pixel rows, pixel cols)
        Left and right, from 1.
    systematic : float
        Added to the variances, pixels²: what resampling does, which residuals do not show.
    surface_nodes : (node rows, node cols, 3)
        Position in the patch and offset of its heights.
    ray_nodes : (photographs, node rows, node cols, 3)
        Position at height 0 relative to each centre, product axes.
    node_col, node_row, step
        First node in pixels of this window, and the lattice's mesh.
    points : (POINT_LAYERS, rows, cols)
        Column and row of the point in pixels of this window, height, height above the height model below it,
        standard deviation, miss distance of the rays; NaN where there is none.
    pairs : (2, rows, cols)
        Left and right photograph of each point, from 0; -1 where there is none.
    """
    points[:] = np.nan
    pairs[:] = -1
    for m in range(parallax.shape[0]):
        r = m * mesh + mesh // 2
        for n in range(parallax.shape[1]):
            p = np.float64(parallax[m, n])
            if p != p:
                continue
            c = n * mesh + mesh // 2
            e = np.float64(row_parallax[m, n])
            rr, cc = round(r - e), round(c - p)
            if not (0 <= rr < photographs.shape[1] and 0 <= cc < photographs.shape[2]):
                continue
            a, b = int(photographs[0, r, c]) - 1, int(photographs[1, rr, cc]) - 1
            if a < 0 or b < 0 or a == b:
                continue
            x, y = (c + 0.5 - node_col) / step, (r + 0.5 - node_row) / step
            xr, yr = x - p / step, y - e / step
            h_left, _, _ = _ground(method, patch, surface_nodes, x, y, step, gsd)
            h_right, h_u, h_v = _ground(method, patch, surface_nodes, xr, yr, step, gsd)
            if not (math.isfinite(h_left) and math.isfinite(h_right)):
                continue
            lu, lv = _node_value(ray_nodes[a], 0, x, y), _node_value(ray_nodes[a], 1, x, y)
            lh = _node_value(ray_nodes[a], 2, x, y) + h_left
            ru, rv = _node_value(ray_nodes[b], 0, xr, yr), _node_value(ray_nodes[b], 1, xr, yr)
            rh = _node_value(ray_nodes[b], 2, xr, yr) + h_right
            noise = (
                (variance[m, n] + systematic) * gsd * gsd,
                -covariance[m, n] * gsd * gsd,
                (row_variance[m, n] + systematic) * gsd * gsd,
            )
            apart = p * gsd, -e * gsd, h_left - h_right
            s, var, miss = _object_point((lu, lv, lh), (ru, rv, rh), (h_u, h_v), apart, noise)
            if s != s:
                continue
            height = h_left - s * lh
            col, row = c + 0.5 - s * lu / gsd, r + 0.5 + s * lv / gsd
            xo, yo = (col - node_col) / step, (row - node_row) / step
            below = sample(
                method, patch, _node_value(surface_nodes, 0, xo, yo), _node_value(surface_nodes, 1, xo, yo)
            )
            points[COL, m, n] = col
            points[ROW, m, n] = row
            points[HEIGHT, m, n] = height
            points[ABOVE, m, n] = height - below - _node_value(surface_nodes, 2, xo, yo)
            # a point above the ground moves less than the ground behind it
            nearer = 1.0 + (height - h_right) / rh
            points[SIGMA, m, n] = abs(lh) * nearer * math.sqrt(var)
            points[MISS, m, n] = miss
            pairs[0, m, n] = a
            pairs[1, m, n] = b


@inline_kernel
def _slope(before: float, after: float, here: float, at_before: float, at_after: float, room: float) -> float:
    """Rise per pixel between the two neighbours of a point; 0 where one is missing or of another surface."""
    run = at_after - at_before
    if abs(before - here) < room and abs(after - here) < room and run > 0.5:
        return (after - before) / run
    return 0.0


@kernel
def lay_points(
    points: Floats32,
    correlation: Floats32,
    mesh: int,
    first_row: int,
    first_col: int,
    room: float,
    out: Floats32,
) -> None:
    """Points on the cells of a raster: the mean of the highest ones of each cell, taken to its centre.

    The centre of a cell is the middle pixel of its mesh, as for the matches.

    Parameters
    ----------
    points : (POINT_LAYERS, rows, cols)
    mesh : int
        Pixels per cell.
    first_row, first_col : int
        First cell of `out`, in cells of the window of the points.
    room : float
        Points lower than the highest one by more than this and by four standard deviations belong to
        something that it hides; neighbours that differ by more are of another surface.
    out : (rows, cols, 5 or more)
        Height, nothing yet, standard deviation, miss distance, correlation; NaN for none. Others are left.
    """
    rows, cols = out.shape[:2]
    top = np.full((rows, cols), -np.inf)
    total = np.zeros((rows, cols, 6))
    shift = mesh // 2 + 0.5 - 0.5 * mesh
    for stage in range(2):
        for m in range(1, points.shape[1] - 1):
            for n in range(1, points.shape[2] - 1):
                col, row = np.float64(points[COL, m, n]), np.float64(points[ROW, m, n])
                if col != col:
                    continue
                i = math.floor((row - shift) / mesh) - first_row
                j = math.floor((col - shift) / mesh) - first_col
                if not (0 <= i < rows and 0 <= j < cols):
                    continue
                h = np.float64(points[HEIGHT, m, n])
                by_col = _slope(
                    points[HEIGHT, m, n - 1], points[HEIGHT, m, n + 1], h,
                    points[COL, m, n - 1], points[COL, m, n + 1], room,
                )  # fmt: skip
                by_row = _slope(
                    points[HEIGHT, m - 1, n], points[HEIGHT, m + 1, n], h,
                    points[ROW, m - 1, n], points[ROW, m + 1, n], room,
                )  # fmt: skip
                h += by_col * ((j + first_col) * mesh + mesh // 2 + 0.5 - col)
                h += by_row * ((i + first_row) * mesh + mesh // 2 + 0.5 - row)
                sigma = np.float64(points[SIGMA, m, n])
                if stage == 0:
                    top[i, j] = max(top[i, j], h)
                elif h >= top[i, j] - max(room, 4.0 * sigma):
                    w = 1.0 / max(sigma * sigma, 1e-12)
                    total[i, j, 0] += w
                    total[i, j, 1] += w * h
                    # points of one cell come from windows that overlap: their errors are the same
                    total[i, j, 3] += w * sigma
                    total[i, j, 4] += w * points[MISS, m, n]
                    total[i, j, 5] += w * correlation[m, n]
    for i in range(rows):
        for j in range(cols):
            w = total[i, j, 0]
            for k in range(5):
                out[i, j, k] = total[i, j, k + 1] / w if w > 0.0 else np.nan


@kernel
def fill_small_gaps(values: Floats32, least: int, out: Floats32) -> None:
    """Cells without value between `least` or more neighbours that have one take the mean of those.

    Only neighbours within a metre of the lowest one: a gap beside a wall is ground.
    """
    rows, cols, layers = values.shape
    for i in range(rows):
        for j in range(cols):
            for k in range(layers):
                out[i, j, k] = values[i, j, k]
            if values[i, j, 0] == values[i, j, 0] or i == 0 or j == 0 or i == rows - 1 or j == cols - 1:
                continue
            lowest = np.inf
            count = 0
            for a in range(i - 1, i + 2):
                for b in range(j - 1, j + 2):
                    if values[a, b, 0] == values[a, b, 0]:
                        count += 1
                        lowest = min(lowest, np.float64(values[a, b, 1]))
            if count < least:
                continue
            used = 0
            for k in range(layers):
                out[i, j, k] = 0.0
            for a in range(i - 1, i + 2):
                for b in range(j - 1, j + 2):
                    if values[a, b, 1] <= lowest + 1.0:
                        used += 1
                        for k in range(layers):
                            out[i, j, k] += values[a, b, k]
            for k in range(layers):
                out[i, j, k] /= used


# The bend h(-1) - 2 h(0) + h(1) of noise has a standard deviation of √6 times that of a height: thrice that.
_NO_NOISE = 3.0 * math.sqrt(6.0)


@kernel
def add_shape(
    values: Floats32, reach: int, share: float, most: float, out: Floats32, jumps: Floats32
) -> None:
    """Standard deviations with what a matching window smooths: the bend of the surface over its half width.

    Where the surface jumps beside a cell, the edge may lie on its other side: the cell shows one of two
    levels, and no standard deviation says which.

    Parameters
    ----------
    values : (rows, cols, layers)
        Height first, standard deviation third.
    reach : int
        Cells to the neighbours that the bend is taken from.
    share : float
        Of the bend h(-1) - 2 h(0) + h(1) that a window takes off a ridge.
    most : float
        Larger bends are walls: the window leaves out what lies beyond them.
    out : (rows, cols)
        Standard deviations.
    jumps : (rows, cols)
        1 where the surface bends by more than `most` and than noise does, from one cell to the next; NaN
        where there is none.
    """
    rows, cols = values.shape[:2]
    for i in range(rows):
        for j in range(cols):
            h = np.float64(values[i, j, 0])
            jumps[i, j] = 0.0 if h == h else np.nan
            least = max(most, _NO_NOISE * values[i, j, 2])
            if 0 < i < rows - 1 and abs(values[i - 1, j, 0] - 2.0 * h + values[i + 1, j, 0]) > least:
                jumps[i, j] = 1.0
            if 0 < j < cols - 1 and abs(values[i, j - 1, 0] - 2.0 * h + values[i, j + 1, 0]) > least:
                jumps[i, j] = 1.0
            worst = 0.0
            for k in range(2):
                di, dj = (reach, 0) if k == 0 else (0, reach)
                if i >= di and i + di < rows and j >= dj and j + dj < cols:
                    bend = abs(values[i - di, j - dj, 0] - 2.0 * h + values[i + di, j + dj, 0])
                    # a neighbour without height is a wall as well
                    worst = max(worst, min(bend, most) if bend == bend else most)
            out[i, j] = math.sqrt(values[i, j, 2] ** 2 + (share * worst) ** 2)
