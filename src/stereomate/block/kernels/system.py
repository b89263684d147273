"""The system of photographs and its border: observations of single photographs; photographs moved."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import kernel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@kernel
def add_group(
    photo: Indices,
    residual: Array,
    weight: Array,
    by_photo: Array,
    columns: Indices,
    by_shared: Array,
    place: Indices,
    skew: int,
    band: Array,
    border: Array,
    corner: Array,
    right: Array,
    right_border: Array,
    diagonal: Array,
    diagonal_border: Array,
) -> float:
    """Add observations of single photographs (`navigation.Group`) to the normal equations; their cost."""
    cost = 0.0
    s = columns.shape[1]
    for g in range(photo.shape[0]):
        k = photo[g]
        at = place[k] * 6
        for i in range(3):
            w, r = weight[g, i], residual[g, i]
            if w == 0.0:
                continue
            cost += w * r * r
            for a in range(6):
                ja = w * by_photo[g, i, a]
                if ja == 0.0:
                    continue
                right[at + a] += ja * r
                diagonal[at + a] += ja * by_photo[g, i, a]
                shift = at - skew * (at + a)
                for b in range(a, 6):
                    band[at + a, shift + b] += ja * by_photo[g, i, b]
                for b in range(s):
                    if columns[g, b] >= 0:
                        border[columns[g, b], at + a] += ja * by_shared[g, i, b]
            for a in range(s):
                c = columns[g, a]
                if c < 0 or by_shared[g, i, a] == 0.0:
                    continue
                ja = w * by_shared[g, i, a]
                right_border[c] += ja * r
                diagonal_border[c] += ja * by_shared[g, i, a]
                for b in range(s):
                    if columns[g, b] >= 0:
                        corner[c, columns[g, b]] += ja * by_shared[g, i, b]
    return cost


@kernel
def move(step: Array, centres: Array, rotations: Array) -> None:
    """Corrections of photographs (n, 6) applied in place; rotations turn from the left (Rodrigues)."""
    r = np.empty((3, 3))
    for k in range(step.shape[0]):
        for x in range(3):
            centres[k, x] += step[k, x]
        tx, ty, tz = step[k, 3], step[k, 4], step[k, 5]
        square = tx * tx + ty * ty + tz * tz
        angle = math.sqrt(square)
        first, second = 1.0 - square / 6.0, 0.5 - square / 24.0
        if angle > 1e-4:
            first, second = math.sin(angle) / angle, (1.0 - math.cos(angle)) / square
        xx, yy, zz = second * tx * tx, second * ty * ty, second * tz * tz
        xy, xz, yz = second * tx * ty, second * tx * tz, second * ty * tz
        x, y, z = first * tx, first * ty, first * tz
        turn = (
            (1.0 - yy - zz, xy - z, xz + y),
            (xy + z, 1.0 - xx - zz, yz - x),
            (xz - y, yz + x, 1.0 - xx - yy),
        )
        r[:] = rotations[k]
        for a in range(3):
            for b in range(3):
                rotations[k, a, b] = turn[a][0] * r[0, b] + turn[a][1] * r[1, b] + turn[a][2] * r[2, b]
