"""The coplanarity condition, its derivatives and its least squares (Gauss-Helmert), per pair of points.

Condition: ``w = l . (b x R r) = 0``. Unknowns: two steps of the base perpendicular to it, three of the
rotation in the left camera's axes. Observations: the four image coordinates, with a covariance per photograph
and point (xx, xy, yy). All coordinates divided by the principal distance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import kernel
from stereomate.relative.kernels.pose import move, solve_five, tangents

Array = NDArray[np.float64]


@kernel
def coplanarity(
    base: Array, rotation: Array, tangent: Array, lx: float, ly: float, rx: float, ry: float
) -> tuple[float, float, float, float, float, float, float, float, float, float]:
    """Closure, four derivatives by the coordinates and five by the unknowns, as one tuple."""
    b0, b1, b2 = base[0], base[1], base[2]
    u = rotation[0, 0] * rx + rotation[0, 1] * ry - rotation[0, 2]
    v = rotation[1, 0] * rx + rotation[1, 1] * ry - rotation[1, 2]
    w = rotation[2, 0] * rx + rotation[2, 1] * ry - rotation[2, 2]
    # n = b x R r: by the left ray.
    n0, n1, n2 = b1 * w - b2 * v, b2 * u - b0 * w, b0 * v - b1 * u
    closure = lx * n0 + ly * n1 - n2
    # m = l x b: by the turned right ray.
    m0, m1, m2 = ly * b2 + b1, -b0 - lx * b2, lx * b1 - ly * b0
    by_rx = rotation[0, 0] * m0 + rotation[1, 0] * m1 + rotation[2, 0] * m2
    by_ry = rotation[0, 1] * m0 + rotation[1, 1] * m1 + rotation[2, 1] * m2
    # g = R r x l: by the base.
    g0, g1, g2 = -v - w * ly, w * lx + u, u * ly - v * lx
    by_t0 = g0 * tangent[0, 0] + g1 * tangent[0, 1] + g2 * tangent[0, 2]
    by_t1 = g0 * tangent[1, 0] + g1 * tangent[1, 1] + g2 * tangent[1, 2]
    # R r x (l x b): by the rotation.
    return (
        closure,
        n0,
        n1,
        by_rx,
        by_ry,
        by_t0,
        by_t1,
        v * m2 - w * m1,
        w * m0 - u * m2,
        u * m1 - v * m0,
    )


@kernel
def closure_and_image_derivatives(
    base: Array, rotation: Array, lx: float, ly: float, rx: float, ry: float
) -> tuple[float, float, float, float, float]:
    """Closure and its four derivatives by the image coordinates."""
    b0, b1, b2 = base[0], base[1], base[2]
    u = rotation[0, 0] * rx + rotation[0, 1] * ry - rotation[0, 2]
    v = rotation[1, 0] * rx + rotation[1, 1] * ry - rotation[1, 2]
    w = rotation[2, 0] * rx + rotation[2, 1] * ry - rotation[2, 2]
    n0, n1, n2 = b1 * w - b2 * v, b2 * u - b0 * w, b0 * v - b1 * u
    m0, m1, m2 = ly * b2 + b1, -b0 - lx * b2, lx * b1 - ly * b0
    return (
        lx * n0 + ly * n1 - n2,
        n0,
        n1,
        rotation[0, 0] * m0 + rotation[1, 0] * m1 + rotation[2, 0] * m2,
        rotation[0, 1] * m0 + rotation[1, 1] * m1 + rotation[2, 1] * m2,
    )


@kernel
def closure_variance(cl: Array, cr: Array, dlx: float, dly: float, drx: float, dry: float) -> float:
    """Variance of the closure from the covariances (xx, xy, yy) of both image points."""
    variance: float = (
        cl[0] * dlx * dlx
        + 2.0 * cl[1] * dlx * dly
        + cl[2] * dly * dly
        + cr[0] * drx * drx
        + 2.0 * cr[1] * drx * dry
        + cr[2] * dry * dry
    )
    return variance


# Lower triangle of the normal equations row by row, then the right side: kept in registers in the loop.
Sums = tuple[
    float, float, float, float, float, float, float, float, float, float,
    float, float, float, float, float, float, float, float, float, float,
]  # fmt: skip
NO_SUMS: Sums = (
    0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
    0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
)  # fmt: skip


@kernel
def add_condition(s: Sums, p: float, f: float, a0: float, a1: float, a2: float, a3: float, a4: float) -> Sums:
    """Sums of the normal equations with one more condition of closure f, derivatives a and weight p."""
    p0, p1, p2, p3, p4 = p * a0, p * a1, p * a2, p * a3, p * a4
    return (
        s[0] + p0 * a0,
        s[1] + p1 * a0,
        s[2] + p1 * a1,
        s[3] + p2 * a0,
        s[4] + p2 * a1,
        s[5] + p2 * a2,
        s[6] + p3 * a0,
        s[7] + p3 * a1,
        s[8] + p3 * a2,
        s[9] + p3 * a3,
        s[10] + p4 * a0,
        s[11] + p4 * a1,
        s[12] + p4 * a2,
        s[13] + p4 * a3,
        s[14] + p4 * a4,
        s[15] - p0 * f,
        s[16] - p1 * f,
        s[17] - p2 * f,
        s[18] - p3 * f,
        s[19] - p4 * f,
    )


@kernel
def write_normal(s: Sums, normal: Array, rhs: Array) -> None:
    """Both triangles of the normal equations (5, 5) and their right side from the sums."""
    k = 0
    for i in range(5):
        for j in range(i + 1):
            normal[i, j] = s[k]
            normal[j, i] = s[k]
            k += 1
        rhs[i] = s[15 + i]


@kernel
def gauss_helmert_pass(
    left: Array,
    right: Array,
    cov_left: Array,
    cov_right: Array,
    weight: Array,
    residual: Array,
    base: Array,
    rotation: Array,
    normal: Array,
    rhs: Array,
) -> float:
    """Residuals that close every condition at this orientation, and the normal equations there.

    `residual` (n, 4), observed minus adjusted, is carried from pass to pass: the condition is linearised at
    the observations adjusted before, which makes the repetition exact. `cov_left` and `cov_right` have
    n rows or one for all; points of weight 0 get residuals and do not count. Returns the weighted square sum.
    """
    tangent = np.empty((2, 3))
    tangents(base, tangent)
    step_l = 1 if cov_left.shape[0] > 1 else 0
    step_r = 1 if cov_right.shape[0] > 1 else 0
    normal[:] = 0.0
    rhs[:] = 0.0
    sums = NO_SUMS
    total = 0.0
    for i in range(left.shape[0]):
        cl, cr = cov_left[i * step_l], cov_right[i * step_r]
        lx, ly, rx, ry = left[i, 0], left[i, 1], right[i, 0], right[i, 1]
        v0, v1, v2, v3 = residual[i, 0], residual[i, 1], residual[i, 2], residual[i, 3]
        f, dlx, dly, drx, dry = closure_and_image_derivatives(
            base, rotation, lx - v0, ly - v1, rx - v2, ry - v3
        )
        f += dlx * v0 + dly * v1 + drx * v2 + dry * v3
        k = f / (closure_variance(cl, cr, dlx, dly, drx, dry) + 1e-300)
        v0, v1 = k * (cl[0] * dlx + cl[1] * dly), k * (cl[1] * dlx + cl[2] * dly)
        v2, v3 = k * (cr[0] * drx + cr[1] * dry), k * (cr[1] * drx + cr[2] * dry)
        residual[i, 0], residual[i, 1], residual[i, 2], residual[i, 3] = v0, v1, v2, v3
        p = weight[i]
        if p <= 0.0:
            continue
        f, dlx, dly, drx, dry, a0, a1, a2, a3, a4 = coplanarity(
            base, rotation, tangent, lx - v0, ly - v1, rx - v2, ry - v3
        )
        f += dlx * v0 + dly * v1 + drx * v2 + dry * v3
        p /= closure_variance(cl, cr, dlx, dly, drx, dry) + 1e-300
        total += p * f * f
        sums = add_condition(sums, p, f, a0, a1, a2, a3, a4)
    write_normal(sums, normal, rhs)
    return total


@kernel
def adjust(
    left: Array,
    right: Array,
    cov_left: Array,
    cov_right: Array,
    weight: Array,
    base: Array,
    rotation: Array,
    residual: Array,
    cofactor: Array,
    max_iterations: int,
) -> tuple[float, int, int]:
    """Gauss-Helmert adjustment from the given base and rotation, which are changed in place.

    Returns (square sum, iterations, state): state 0 converged, 1 not converged, 2 singular. A step that makes
    the square sum larger is halved.
    """
    normal, rhs, step = np.empty((5, 5)), np.empty(5), np.empty(5)
    tangent = np.empty((2, 3))
    old_base, old_rotation = base.copy(), rotation.copy()
    residual[:] = 0.0
    total = gauss_helmert_pass(
        left, right, cov_left, cov_right, weight, residual, base, rotation, normal, rhs
    )
    state = 1
    for iteration in range(1, max_iterations + 1):
        if not solve_five(normal, rhs, step, cofactor):
            return total, iteration, 2
        tangents(base, tangent)
        old_base[:] = base
        old_rotation[:] = rotation
        size = 0.0
        for i in range(5):
            size = max(size, abs(step[i]))
        shrink = 1.0 if size < 0.5 else 0.5 / size
        new_total = total
        for _ in range(12):
            base[:] = old_base
            rotation[:] = old_rotation
            move(base, rotation, tangent, step * shrink)
            new_total = gauss_helmert_pass(
                left, right, cov_left, cov_right, weight, residual, base, rotation, normal, rhs
            )
            if new_total <= total * (1.0 + 1e-9) + 1e-30 or size < 1e-7:
                break
            shrink *= 0.5
        total = new_total
        if size * shrink < 1e-10:
            state = 0
            break
    if not solve_five(normal, rhs, step, cofactor):
        return total, iteration, 2
    return total, iteration, state


@kernel
def point_statistics(
    left: Array,
    right: Array,
    cov_left: Array,
    cov_right: Array,
    residual: Array,
    base: Array,
    rotation: Array,
    cofactor: Array,
    out: Array,
) -> None:
    """Per point into `out` (n, 8): closure, its standard deviation, leverage of a weight of one, derivatives
    of the closure by x and y left and right, sign of the closure for left minus right.

    Closures are those of the original observations, linearised at the adjusted ones.
    """
    tangent = np.empty((2, 3))
    tangents(base, tangent)
    step_l = 1 if cov_left.shape[0] > 1 else 0
    step_r = 1 if cov_right.shape[0] > 1 else 0
    a = np.empty(5)
    for i in range(left.shape[0]):
        f, dlx, dly, drx, dry, a[0], a[1], a[2], a[3], a[4] = coplanarity(
            base,
            rotation,
            tangent,
            left[i, 0] - residual[i, 0],
            left[i, 1] - residual[i, 1],
            right[i, 0] - residual[i, 2],
            right[i, 1] - residual[i, 3],
        )
        f += dlx * residual[i, 0] + dly * residual[i, 1] + drx * residual[i, 2] + dry * residual[i, 3]
        q = closure_variance(cov_left[i * step_l], cov_right[i * step_r], dlx, dly, drx, dry)
        leverage = 0.0
        for j in range(5):
            for k in range(5):
                leverage += a[j] * cofactor[j, k] * a[k]
        out[i, 0] = f
        out[i, 1] = np.sqrt(q)
        out[i, 2] = leverage / q
        out[i, 3], out[i, 4], out[i, 5], out[i, 6] = dlx, dly, drx, dry
        # Along +y of the left photograph the closure grows with dly: left minus right has its sign.
        out[i, 7] = 1.0 if dly >= 0.0 else -1.0
