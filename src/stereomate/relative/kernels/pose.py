"""Base and rotation of a pair: from an essential matrix, small changes of them, and which side points lie on.

The frame is the left camera's (x right, y up, looking along -z). `base` is the unit vector from the left to
the right projection centre; `rotation` turns right camera axes into left camera axes:
``E = [base]x rotation`` and a pair of rays meets where ``l' E r = 0``. Image points are pairs (x/c, y/c); the
ray is (x/c, y/c, -1).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.geometry.kernels import solve_symmetric
from stereomate.jit import kernel

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@kernel
def essential_from_pose(base: Array, rotation: Array, essential: Array) -> None:
    """Write ``[base]x rotation`` into `essential` (9,)."""
    for j in range(3):
        essential[j] = base[1] * rotation[2, j] - base[2] * rotation[1, j]
        essential[3 + j] = base[2] * rotation[0, j] - base[0] * rotation[2, j]
        essential[6 + j] = base[0] * rotation[1, j] - base[1] * rotation[0, j]


@kernel
def orthonormalise(rotation: Array) -> None:
    """Gram-Schmidt on the columns, in place: rounding must not grow over many steps."""
    n0 = np.sqrt(rotation[0, 0] ** 2 + rotation[1, 0] ** 2 + rotation[2, 0] ** 2)
    for i in range(3):
        rotation[i, 0] /= n0
    dot = rotation[0, 0] * rotation[0, 1] + rotation[1, 0] * rotation[1, 1] + rotation[2, 0] * rotation[2, 1]
    for i in range(3):
        rotation[i, 1] -= dot * rotation[i, 0]
    n1 = np.sqrt(rotation[0, 1] ** 2 + rotation[1, 1] ** 2 + rotation[2, 1] ** 2)
    for i in range(3):
        rotation[i, 1] /= n1
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        rotation[i, 2] = rotation[j, 0] * rotation[k, 1] - rotation[k, 0] * rotation[j, 1]


@kernel
def pose_from_essential(essential: Array, base: Array, first: Array, second: Array) -> bool:
    """Base and the two rotations of an essential matrix (B. Horn 1990: cofactors minus and plus ``[b]x E``).

    The base may also be taken with the opposite sign: four arrangements in all.
    """
    e = essential.reshape(3, 3)
    best = -1.0
    for i in range(3):
        j = (i + 1) % 3
        x = e[1, i] * e[2, j] - e[2, i] * e[1, j]
        y = e[2, i] * e[0, j] - e[0, i] * e[2, j]
        z = e[0, i] * e[1, j] - e[1, i] * e[0, j]
        size = x * x + y * y + z * z
        if size > best:
            best = size
            base[0], base[1], base[2] = x, y, z
    if not best > 0.0:
        return False
    norm = np.sqrt(best)
    trace = 0.0
    for i in range(9):
        trace += essential[i] ** 2
    scale = np.sqrt(2.0 / trace)
    for i in range(3):
        base[i] /= norm
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for c in range(3):
            d, f = (c + 1) % 3, (c + 2) % 3
            cofactor = scale * scale * (e[j, d] * e[k, f] - e[j, f] * e[k, d])
            cross = scale * (base[j] * e[k, c] - base[k] * e[j, c])
            first[i, c] = cofactor - cross
            second[i, c] = cofactor + cross
    # A matrix that is essential only to some digits gives rotations to some digits.
    orthonormalise(first)
    orthonormalise(second)
    return True


@kernel
def turn(rotation: Array, x: float, y: float, z: float) -> None:
    """``exp([v]x) rotation`` in place, by Rodrigues' formula, made orthonormal again."""
    angle2 = x * x + y * y + z * z
    angle = np.sqrt(angle2)
    if angle < 1e-6:
        a, b = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0
    else:
        a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle2
    for c in range(3):
        u, v, w = rotation[0, c], rotation[1, c], rotation[2, c]
        dot = x * u + y * v + z * w
        cu, cv, cw = y * w - z * v, z * u - x * w, x * v - y * u
        rotation[0, c] = u + a * cu + b * (x * dot - angle2 * u)
        rotation[1, c] = v + a * cv + b * (y * dot - angle2 * v)
        rotation[2, c] = w + a * cw + b * (z * dot - angle2 * w)
    orthonormalise(rotation)


@kernel
def tangents(base: Array, tangent: Array) -> None:
    """Two unit vectors perpendicular to the base and to each other, rows of `tangent` (2, 3)."""
    x, y, z = base[0], base[1], base[2]
    # The axis least along the base; for a base along x the tangents are y and z: by and bz.
    if abs(x) >= abs(y) and abs(x) >= abs(z):
        ax, ay, az = 0.0, 1.0, 0.0
    elif abs(y) >= abs(z):
        ax, ay, az = 0.0, 0.0, 1.0
    else:
        ax, ay, az = 1.0, 0.0, 0.0
    dot = ax * x + ay * y + az * z
    ax, ay, az = ax - dot * x, ay - dot * y, az - dot * z
    norm = np.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / norm, ay / norm, az / norm
    tangent[0, 0], tangent[0, 1], tangent[0, 2] = ax, ay, az
    tangent[1, 0] = y * az - z * ay
    tangent[1, 1] = z * ax - x * az
    tangent[1, 2] = x * ay - y * ax


@kernel
def move(base: Array, rotation: Array, tangent: Array, step: Array) -> None:
    """Apply a step (two of the base along `tangent`, three of the rotation in the left camera's axes)."""
    for i in range(3):
        base[i] += tangent[0, i] * step[0] + tangent[1, i] * step[1]
    norm = np.sqrt(base[0] ** 2 + base[1] ** 2 + base[2] ** 2)
    for i in range(3):
        base[i] /= norm
    turn(rotation, step[2], step[3], step[4])


@kernel
def ray_geometry(
    base: Array, rotation: Array, lx: float, ly: float, rx: float, ry: float
) -> tuple[float, float, float, float]:
    """Signed distances along both rays to where they come closest, times ``s``, then ``s`` and ``s0``.

    ``s0`` is the product of the squared lengths of the rays, ``s`` that times the squared sine of the angle
    between them: the distances, in units of the base along (x/c, y/c, -1), are the first two over ``s``.
    """
    u = rotation[0, 0] * rx + rotation[0, 1] * ry - rotation[0, 2]
    v = rotation[1, 0] * rx + rotation[1, 1] * ry - rotation[1, 2]
    w = rotation[2, 0] * rx + rotation[2, 1] * ry - rotation[2, 2]
    a = lx * lx + ly * ly + 1.0
    c = u * u + v * v + w * w
    d = lx * u + ly * v - w
    lb = lx * base[0] + ly * base[1] - base[2]
    rb = u * base[0] + v * base[1] + w * base[2]
    return c * lb - d * rb, d * lb - a * rb, a * c - d * d, a * c


@kernel
def count_in_front(left: Array, right: Array, use: Mask, base: Array, rotation: Array) -> tuple[int, int]:
    """How many used points lie before both cameras, and before neither, for this base: (n, n)."""
    front, behind = 0, 0
    for i in range(left.shape[0]):
        if use[i]:
            s, t, _, _ = ray_geometry(base, rotation, left[i, 0], left[i, 1], right[i, 0], right[i, 1])
            if s > 0.0 and t > 0.0:
                front += 1
            elif s < 0.0 and t < 0.0:
                behind += 1
    return front, behind


@kernel
def share_behind(
    left: Array, right: Array, use: Mask, base: Array, rotation: Array, variance: float
) -> float:
    """Share of the used points that lie behind a camera by more than their noise.

    `variance` is that of the angle between two rays; points too far away to tell do not count as behind.
    """
    total, behind = 0, 0
    for i in range(left.shape[0]):
        if not use[i]:
            continue
        total += 1
        s, t, sine2, squares = ray_geometry(base, rotation, left[i, 0], left[i, 1], right[i, 0], right[i, 1])
        if s > 0.0 and t > 0.0:
            continue
        if sine2 > 16.0 * variance * squares:
            behind += 1
    return behind / max(total, 1)


@kernel
def choose_arrangement(
    left: Array, right: Array, use: Mask, base: Array, first: Array, second: Array, rotation: Array
) -> int:
    """Of the four arrangements keep the one with most used points before both cameras; their number."""
    f1, b1 = count_in_front(left, right, use, base, first)
    f2, b2 = count_in_front(left, right, use, base, second)
    best = max(max(f1, b1), max(f2, b2))
    chosen = first if max(f1, b1) >= max(f2, b2) else second
    flip = (b1 > f1) if max(f1, b1) >= max(f2, b2) else (b2 > f2)
    for i in range(3):
        for j in range(3):
            rotation[i, j] = chosen[i, j]
        if flip:
            base[i] = -base[i]
    return best


@kernel
def solve_five(normal: Array, rhs: Array, solution: Array, inverse: Array) -> bool:
    """Solve and invert the normal equations (5, 5) of an orientation; False if they are singular."""
    return solve_symmetric(normal, rhs, solution, inverse, 1e-15)
