"""One image observation: computed pixel and its derivatives by the point and the camera.

With d = X - X0 and p = Rᵀ d, and R perturbed on the left (R -> exp(θ) R): dp/dX = Rᵀ, dp/dX0 = -Rᵀ,
dp/dθ = Rᵀ [d]x. With A = (d pixel / d p) Rᵀ a row a of A gives (-a, a x d) for the photograph: see `small`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.kernels.distortion import brown_derivatives
from stereomate.camera.kernels.jacobian import image_jacobian_point
from stereomate.camera.kernels.layout import (
    B1,
    B2,
    BROWN,
    P1,
    P2,
    PINHOLE,
    R0,
    R2_MAX,
    E,
    P,
)
from stereomate.jit import inline_kernel, kernel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@inline_kernel
def by_unknowns(free: int, entries: Indices, derivatives: Array, scratch: Array, out: Array) -> None:
    """Chain rule from the entries of the parameter array, in `scratch`, to the unknowns: `out` (2, free)."""
    for j in range(free):
        out[0, j] = out[1, j] = 0.0
    for t in range(entries.shape[0]):
        entry, j = entries[t, 0], entries[t, 1]
        if entry < 0:
            break
        out[0, j] += scratch[0, entry] * derivatives[t]
        out[1, j] += scratch[1, entry] * derivatives[t]


@inline_kernel
def _by_entries(
    model: int,
    p: Array,
    u: float,
    v: float,
    a: float,
    b: float,
    mx: float,
    my: float,
    g00: float,
    g01: float,
    g10: float,
    g11: float,
    scratch: Array,
) -> None:
    """Derivatives of the pixel by the entries of the parameter array that Brown's model has.

    (u, v) ideal, (a, b) reduced to the point of symmetry, (mx, my) measured; g: pixel by (a, b).
    """
    s, xy = a * a + b * b, 2.0 * a * b
    scratch[0, P], scratch[0, P + 1], scratch[0, P + 2] = mx, my, 1.0
    scratch[1, P + 3], scratch[1, P + 4], scratch[1, P + 5] = mx, my, 1.0
    if model == PINHOLE:
        return
    scratch[0, E], scratch[0, E + 1], scratch[0, E + 2] = g00 * u, g00 * v, g00
    scratch[1, E], scratch[1, E + 1], scratch[1, E + 2] = g10 * u, g10 * v, g10
    scratch[0, E + 3], scratch[0, E + 4], scratch[0, E + 5] = g01 * u, g01 * v, g01
    scratch[1, E + 3], scratch[1, E + 4], scratch[1, E + 5] = g11 * u, g11 * v, g11
    cx, cy = p[P] * a + p[P + 1] * b, p[P + 3] * a + p[P + 4] * b
    power = 1.0
    for i in range(5):  # R0, K1 .. K4 lie behind each other
        scratch[0, R0 + i], scratch[1, R0 + i] = cx * power, cy * power
        power *= s
    scratch[0, B1], scratch[1, B1] = p[P] * a, p[P + 3] * a
    scratch[0, B2], scratch[1, B2] = p[P] * b, p[P + 3] * b
    dx, dy = s + 2.0 * a * a, xy
    scratch[0, P1], scratch[1, P1] = p[P] * dx + p[P + 1] * dy, p[P + 3] * dx + p[P + 4] * dy
    dx, dy = xy, s + 2.0 * b * b
    scratch[0, P2], scratch[1, P2] = p[P] * dx + p[P + 1] * dy, p[P + 3] * dx + p[P + 4] * dy


@inline_kernel
def pixel_of(
    model: int,
    p: Array,
    x: float,
    y: float,
    z: float,
    d_point: Array,
    free: int,
    entries: Indices,
    derivatives: Array,
    d_camera: Array,
    scratch: Array,
) -> tuple[float, float, bool]:
    """Pixel of a camera-frame point: (column, row, ok); writes `d_point` (2, 3) and `d_camera` (2, free).

    `entries` (k, 2): an entry of the parameter array and an unknown of the camera that moves it, with
    `derivatives` (k,); an entry of -1 ends the list. `scratch` (2, LENGTH). The pixel array does not
    limit, nor where the distortion begins to fold, unless the model cannot be computed there.
    """
    if not z < 0.0:
        return 0.0, 0.0, False
    if model != PINHOLE and model != BROWN:
        column, row, _ = image_jacobian_point(model, p, x, y, z, d_point, scratch)
        if not (np.isfinite(column) and np.isfinite(row)):
            return 0.0, 0.0, False
        by_unknowns(free, entries, derivatives, scratch, d_camera)
        return column, row, True
    w = -1.0 / z
    u, v = x * w, y * w
    a, b, mx, my = u, v, u, v
    e00, e01, e10, e11 = 1.0, 0.0, 0.0, 1.0
    if model == BROWN:
        a = p[E] * u + p[E + 1] * v + p[E + 2]
        b = p[E + 3] * u + p[E + 4] * v + p[E + 5]
        if not a * a + b * b <= p[R2_MAX]:
            return 0.0, 0.0, False
        mx, my, j00, j01, j10, j11 = brown_derivatives(p, a, b)
        # From (a, b) to the pixel, then from (u, v).
        g00, g01 = p[P] * j00 + p[P + 1] * j10, p[P] * j01 + p[P + 1] * j11
        g10, g11 = p[P + 3] * j00 + p[P + 4] * j10, p[P + 3] * j01 + p[P + 4] * j11
        e00, e01 = g00 * p[E] + g01 * p[E + 3], g00 * p[E + 1] + g01 * p[E + 4]
        e10, e11 = g10 * p[E] + g11 * p[E + 3], g10 * p[E + 1] + g11 * p[E + 4]
    else:
        g00, g01, g10, g11 = p[P], p[P + 1], p[P + 3], p[P + 4]
        e00, e01, e10, e11 = g00, g01, g10, g11
    d_point[0, 0], d_point[0, 1], d_point[0, 2] = e00 * w, e01 * w, (e00 * u + e01 * v) * w
    d_point[1, 0], d_point[1, 1], d_point[1, 2] = e10 * w, e11 * w, (e10 * u + e11 * v) * w
    if free > 0:
        _by_entries(model, p, u, v, a, b, mx, my, g00, g01, g10, g11, scratch)
        by_unknowns(free, entries, derivatives, scratch, d_camera)
    column = p[P] * mx + p[P + 1] * my + p[P + 2]
    row = p[P + 3] * mx + p[P + 4] * my + p[P + 5]
    return column, row, True


@inline_kernel
def observe(
    model: int,
    p: Array,
    centre: Array,
    rotation: Array,
    point: Array,
    free: int,
    entries: Indices,
    derivatives: Array,
    by_point: Array,
    by_camera: Array,
    scratch: Array,
) -> tuple[float, float, bool]:
    """Computed pixel of an object point with its derivatives by the point (2, 3) and the camera (2, free)."""
    dx, dy, dz = point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]
    x = rotation[0, 0] * dx + rotation[1, 0] * dy + rotation[2, 0] * dz
    y = rotation[0, 1] * dx + rotation[1, 1] * dy + rotation[2, 1] * dz
    z = rotation[0, 2] * dx + rotation[1, 2] * dy + rotation[2, 2] * dz
    column, row, ok = pixel_of(model, p, x, y, z, by_point, free, entries, derivatives, by_camera, scratch)
    if not ok:
        return column, row, False
    for i in range(2):
        a, b, c = by_point[i, 0], by_point[i, 1], by_point[i, 2]
        by_point[i, 0] = a * rotation[0, 0] + b * rotation[0, 1] + c * rotation[0, 2]
        by_point[i, 1] = a * rotation[1, 0] + b * rotation[1, 1] + c * rotation[1, 2]
        by_point[i, 2] = a * rotation[2, 0] + b * rotation[2, 1] + c * rotation[2, 2]
    return column, row, True


@kernel
def residuals(
    photo: Indices,
    point: Indices,
    xy: Array,
    points: Array,
    centres: Array,
    rotations: Array,
    camera: Indices,
    model: Indices,
    packed: Array,
    out: Array,
) -> int:
    """Observed minus computed pixels into `out` (m, 2); NaN where nothing can be computed. Counts those."""
    entries, derivatives = np.empty((0, 2), np.int64), np.empty(0)
    by_point, by_camera = np.empty((2, 3)), np.empty((2, 0))
    scratch = np.zeros((2, packed.shape[1]))
    failed = 0
    for i in range(photo.shape[0]):
        k = photo[i]
        c = camera[k]
        column, row, ok = observe(
            model[c], packed[c], centres[k], rotations[k], points[point[i]], 0, entries, derivatives,
            by_point, by_camera, scratch,
        )  # fmt: skip
        if ok:
            out[i, 0], out[i, 1] = xy[i, 0] - column, xy[i, 1] - row
        else:
            out[i, 0] = out[i, 1] = np.nan
            failed += 1
    return failed
