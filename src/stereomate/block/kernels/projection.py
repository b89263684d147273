"""One image observation: computed pixel and its derivatives by the point and the camera.

With d = X - X0 and p = Rᵀ d, and R perturbed on the left (R -> exp(θ) R): dp/dX = Rᵀ, dp/dX0 = -Rᵀ,
dp/dθ = Rᵀ [d]x. With A = (d pixel / d p) Rᵀ a row a of A gives (-a, a x d) for the photograph: see `small`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.block.kernels.small import Nine, Three, nine_of, three_of
from stereomate.camera.kernels.distortion import brown_terms
from stereomate.camera.kernels.jacobian import image_jacobian_point
from stereomate.camera.kernels.layout import (
    B1,
    B2,
    BROWN,
    K1,
    K2,
    K3,
    K4,
    LENGTH,
    P1,
    P2,
    R0,
    R2_MAX,
    E,
    P,
)
from stereomate.jit import fused_inline_kernel as inline_kernel
from stereomate.jit import fused_kernel as kernel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Lens = tuple[float, ...]
Inner = tuple[float, float, float, float, float, float, float, float, float, float]
Observed = tuple[float, float, bool, Three, Three]

NOTHING = (0.0, 0.0, False, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
NO_INNER = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@inline_kernel
def lens_of(p: Array, c: int) -> Lens:
    """What Brown's model reads of the parameter array of camera `c`: P, E, the limit, and its coefficients.

    `p`: the arrays of all cameras behind each other.
    """
    o = c * LENGTH
    return (
        p[o + P], p[o + P + 1], p[o + P + 2], p[o + P + 3], p[o + P + 4], p[o + P + 5],
        p[o + E], p[o + E + 1], p[o + E + 2], p[o + E + 3], p[o + E + 4], p[o + E + 5],
        p[o + R2_MAX], p[o + R0], p[o + K1], p[o + K2], p[o + K3], p[o + K4],
        p[o + P1], p[o + P2], p[o + B1], p[o + B2],
    )  # fmt: skip


@inline_kernel
def in_camera(centre: Three, r: Nine, point: Three) -> Three:
    """Object point in the camera frame: ``Rᵀ (X - X0)``."""
    dx, dy, dz = point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]
    return (
        r[0] * dx + r[3] * dy + r[6] * dz,
        r[1] * dx + r[4] * dy + r[7] * dz,
        r[2] * dx + r[5] * dy + r[8] * dz,
    )


@inline_kernel
def observe(model: int, lens: Lens, centre: Three, r: Nine, point: Three) -> tuple[Observed, Inner]:
    """Computed pixel of an object point by the models of a pinhole and of Brown.

    Returns
    -------
    (column, line, ok, by_column, by_line)
        `by_column`, `by_line`: how either moves with the object point. The pixel array does not limit, nor
        where the distortion begins to fold, unless the model cannot be computed there.
    inner
        What `by_camera_of` needs: (u, v) ideal, (a, b) reduced to the point of symmetry, (mx, my) measured,
        and the pixel by (a, b), row by row.
    """
    x, y, z = in_camera(centre, r, point)
    if not z < 0.0:
        return NOTHING, NO_INNER
    w = -1.0 / z
    u, v = x * w, y * w
    p00, p01, p02, p10, p11, p12 = lens[:6]
    a, b, mx, my = u, v, u, v
    g00, g01, g10, g11 = p00, p01, p10, p11
    e00, e01, e10, e11 = p00, p01, p10, p11
    if model == BROWN:
        q00, q01, q02, q10, q11, q12 = lens[6:12]
        a, b = q00 * u + q01 * v + q02, q10 * u + q11 * v + q12
        if not a * a + b * b <= lens[12]:
            return NOTHING, NO_INNER
        mx, my, j00, j01, j10, j11 = brown_terms(lens[13:], a, b)
        # From (a, b) to the pixel, then from (u, v).
        g00, g01 = p00 * j00 + p01 * j10, p00 * j01 + p01 * j11
        g10, g11 = p10 * j00 + p11 * j10, p10 * j01 + p11 * j11
        e00, e01 = g00 * q00 + g01 * q10, g00 * q01 + g01 * q11
        e10, e11 = g10 * q00 + g11 * q10, g10 * q01 + g11 * q11
    column = p00 * mx + p01 * my + p02
    line = p10 * mx + p11 * my + p12
    by_column = _turned((e00 * w, e01 * w, (e00 * u + e01 * v) * w), r)
    by_line = _turned((e10 * w, e11 * w, (e10 * u + e11 * v) * w), r)
    return (column, line, True, by_column, by_line), (u, v, a, b, mx, my, g00, g01, g10, g11)


@kernel
def observe_general(
    model: int, p: Array, c: int, centre: Three, r: Nine, point: Three, scratch: Array
) -> Observed:
    """As `observe` by any model, with the derivatives by the parameter array in `scratch` (3, LENGTH)."""
    x, y, z = in_camera(centre, r, point)
    if not z < 0.0:
        return NOTHING
    d = scratch[2, :6].reshape(2, 3)
    column, line, _ = image_jacobian_point(
        model, p[c * LENGTH : (c + 1) * LENGTH], x, y, z, d, scratch[:2]
    )  # fmt: skip
    if not (np.isfinite(column) and np.isfinite(line)):
        return NOTHING
    by_column = _turned((d[0, 0], d[0, 1], d[0, 2]), r)
    by_line = _turned((d[1, 0], d[1, 1], d[1, 2]), r)
    return column, line, True, by_column, by_line


@inline_kernel
def by_entries(lens: Lens, inner: Inner, scratch: Array) -> None:
    """Derivatives of the pixel by the entries of the parameter array that Brown's model has."""
    u, v, a, b, mx, my, g00, g01, g10, g11 = inner
    p00, p01, p10, p11 = lens[0], lens[1], lens[3], lens[4]
    s, xy = a * a + b * b, 2.0 * a * b
    scratch[0, P], scratch[0, P + 1], scratch[0, P + 2] = mx, my, 1.0
    scratch[1, P + 3], scratch[1, P + 4], scratch[1, P + 5] = mx, my, 1.0
    scratch[0, E], scratch[0, E + 1], scratch[0, E + 2] = g00 * u, g00 * v, g00
    scratch[1, E], scratch[1, E + 1], scratch[1, E + 2] = g10 * u, g10 * v, g10
    scratch[0, E + 3], scratch[0, E + 4], scratch[0, E + 5] = g01 * u, g01 * v, g01
    scratch[1, E + 3], scratch[1, E + 4], scratch[1, E + 5] = g11 * u, g11 * v, g11
    cx, cy = p00 * a + p01 * b, p10 * a + p11 * b
    power = 1.0
    for i in range(5):  # R0, K1 .. K4 lie behind each other
        scratch[0, R0 + i], scratch[1, R0 + i] = cx * power, cy * power
        power *= s
    scratch[0, B1], scratch[1, B1] = p00 * a, p10 * a
    scratch[0, B2], scratch[1, B2] = p00 * b, p10 * b
    dx, dy = s + 2.0 * a * a, xy
    scratch[0, P1], scratch[1, P1] = p00 * dx + p01 * dy, p10 * dx + p11 * dy
    dx, dy = xy, s + 2.0 * b * b
    scratch[0, P2], scratch[1, P2] = p00 * dx + p01 * dy, p10 * dx + p11 * dy


@inline_kernel
def by_unknowns(
    c: int, free: int, entries: Indices, derivatives: Array, scratch: Array, row: int, out: Array
) -> None:
    """Chain rule from the entries of the parameter array, in `scratch`, to the unknowns: ``out[row]``.

    `entries` (c, k, 2): an entry of the parameter array and an unknown of the camera that moves it, with
    `derivatives` (c, k); an entry of -1 ends the list. `out` (rows, 2, free).
    """
    for j in range(free):
        out[row, 0, j] = out[row, 1, j] = 0.0
    for t in range(entries.shape[1]):
        entry, j = entries[c, t, 0], entries[c, t, 1]
        if entry < 0:
            break
        out[row, 0, j] += scratch[0, entry] * derivatives[c, t]
        out[row, 1, j] += scratch[1, entry] * derivatives[c, t]


@inline_kernel
def _turned(a: Three, r: Nine) -> Three:
    """Derivative by the camera-frame point to that by the object point: ``a Rᵀ``."""
    return (
        a[0] * r[0] + a[1] * r[1] + a[2] * r[2],
        a[0] * r[3] + a[1] * r[4] + a[2] * r[5],
        a[0] * r[6] + a[1] * r[7] + a[2] * r[8],
    )


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
    p, scratch = packed.reshape(packed.size), np.zeros((3, LENGTH))
    failed = 0
    for i in range(photo.shape[0]):
        k = photo[i]
        c = camera[k]
        place = three_of(centres, k), nine_of(rotations, k), three_of(points, point[i])
        if model[c] <= BROWN:
            observed, _ = observe(model[c], lens_of(p, c), *place)
        else:
            observed = observe_general(model[c], p, c, *place, scratch)
        column, line, ok, _, _ = observed
        if ok:
            out[i, 0], out[i, 1] = xy[i, 0] - column, xy[i, 1] - line
        else:
            out[i, 0] = out[i, 1] = np.nan
            failed += 1
    return failed
