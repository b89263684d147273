"""Sums behind the tests of degeneracy: a rotation without base, the fit of an orientation to points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import kernel
from stereomate.relative.kernels.mixture import square_distance

Array = NDArray[np.float64]


@kernel
def correlation_of_rays(left: Array, right: Array, out: Array) -> None:
    """Sum of l r' over directions (x, y, -1), that of the left one over its square length; out (3, 3)."""
    out[:] = 0.0
    for i in range(left.shape[0]):
        x, y = left[i, 0], left[i, 1]
        weight = 1.0 / (x * x + y * y + 1.0)
        u, v = right[i, 0], right[i, 1]
        out[0, 0] += weight * x * u
        out[0, 1] += weight * x * v
        out[0, 2] -= weight * x
        out[1, 0] += weight * y * u
        out[1, 1] += weight * y * v
        out[1, 2] -= weight * y
        out[2, 0] -= weight * u
        out[2, 1] -= weight * v
        out[2, 2] += weight


@kernel
def _solve_three(n: Array, h: Array, step: Array) -> None:
    """Solution of a symmetric positive system by its adjugate; zero if singular."""
    a = n[1, 1] * n[2, 2] - n[1, 2] * n[1, 2]
    b = n[0, 2] * n[1, 2] - n[0, 1] * n[2, 2]
    c = n[0, 1] * n[1, 2] - n[0, 2] * n[1, 1]
    d = n[0, 0] * n[2, 2] - n[0, 2] * n[0, 2]
    e = n[0, 1] * n[0, 2] - n[0, 0] * n[1, 2]
    f = n[0, 0] * n[1, 1] - n[0, 1] * n[0, 1]
    determinant = n[0, 0] * a + n[0, 1] * b + n[0, 2] * c
    scale = 1.0 / determinant if determinant > 0.0 else 0.0
    step[0] = scale * (a * h[0] + b * h[1] + c * h[2])
    step[1] = scale * (b * h[0] + d * h[1] + e * h[2])
    step[2] = scale * (c * h[0] + e * h[1] + f * h[2])


@kernel
def _turn(rotation: Array, step: Array) -> None:
    """Rotation becomes exp(step) rotation (Rodrigues)."""
    angle = np.sqrt(step[0] * step[0] + step[1] * step[1] + step[2] * step[2])
    if angle < 1e-300:
        return
    s, c = np.sin(angle) / angle, (1.0 - np.cos(angle)) / (angle * angle)
    for k in range(3):
        x, y, z = rotation[0, k], rotation[1, k], rotation[2, k]
        u = step[1] * z - step[2] * y
        v = step[2] * x - step[0] * z
        w = step[0] * y - step[1] * x
        rotation[0, k] = x + s * u + c * (step[1] * w - step[2] * v)
        rotation[1, k] = y + s * v + c * (step[2] * u - step[0] * w)
        rotation[2, k] = z + s * w + c * (step[0] * v - step[1] * u)


@kernel
def rotation_only(left: Array, right: Array, rotation: Array, steps: int) -> float:
    """Gauss-Newton steps of a rotation without base; the square sum that it leaves in left coordinates."""
    normal, rhs, step = np.empty((3, 3)), np.empty(3), np.empty(3)
    total = 0.0
    for iteration in range(steps + 1):
        total = 0.0
        normal[:] = 0.0
        rhs[:] = 0.0
        for i in range(left.shape[0]):
            u, v = right[i, 0], right[i, 1]
            scale = -1.0 / (rotation[2, 0] * u + rotation[2, 1] * v - rotation[2, 2])
            x = scale * (rotation[0, 0] * u + rotation[0, 1] * v - rotation[0, 2])
            y = scale * (rotation[1, 0] * u + rotation[1, 1] * v - rotation[1, 2])
            dx, dy = left[i, 0] - x, left[i, 1] - y
            total += dx * dx + dy * dy
            a0, a1, a2 = x * y, -(1.0 + x * x), -y
            b0, b1, b2 = 1.0 + y * y, -x * y, x
            normal[0, 0] += a0 * a0 + b0 * b0
            normal[0, 1] += a0 * a1 + b0 * b1
            normal[0, 2] += a0 * a2 + b0 * b2
            normal[1, 1] += a1 * a1 + b1 * b1
            normal[1, 2] += a1 * a2 + b1 * b2
            normal[2, 2] += a2 * a2 + b2 * b2
            rhs[0] += a0 * dx + b0 * dy
            rhs[1] += a1 * dx + b1 * dy
            rhs[2] += a2 * dx + b2 * dy
        if iteration < steps:
            _solve_three(normal, rhs, step)
            _turn(rotation, step)
    return total


@kernel
def square_sum(e: Array, left: Array, right: Array, vl: float, vr: float) -> float:
    """Sum of the squares of the Sampson distances in sigmas, for the essential matrix e (9,)."""
    total = 0.0
    for i in range(left.shape[0]):
        total += square_distance(e, vl, vr, left[i, 0], left[i, 1], right[i, 0], right[i, 1])
    return total
