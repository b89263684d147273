"""Where rays of the tangent frame meet a height model: rigorous, through the model's own CRS and heights.

A ray is straight in the tangent frame and very slightly bent in the pixels and heights of a model. Pieces of
it are taken as chords there (they sag by less than 2 cm), met with the bilinear surface exactly, and the
chord around the meeting point is then shrunk until nothing remains of the bend.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import map_from_tangent
from stereomate.terrain import kernels
from stereomate.terrain.model import HeightModel, height_unit_m

Floats = NDArray[np.float64]

# Horizontal length of a chord: it sags by 1000^2 / 8R = 2 cm.
_CHORD_M: Final = 1000.0
# Half lengths of the chords that follow: they sag by 30 micrometres, then by 0.1.
_REACHES_M: Final = (20.0, 1.0)
# Rays are followed to these depths for the part of the model that they cross: no land is lower than the
# first, no sea bed than the second. Geoid and ellipsoid differ by less than the last.
_DEPTHS_M: Final = (-500.0, -11500.0)
_UNDULATION_M: Final = 110.0
# Cells of a patch held at a time (32 MB).
_PATCH_CELLS: Final = 4_000_000
_LEVEL_ITERATIONS: Final = 12
_LEVEL_TOLERANCE_M: Final = 1e-7


def distances_to_level(
    frame: MapFrame, tangent: TangentFrame, starts: Floats, directions: Floats, level: float
) -> Floats:
    """How far along rays a height of a map frame is reached from above.

    Parameters
    ----------
    starts, directions : (n, 3)
        Tangent frame; directions are unit vectors.
    level : float
        Height in the frame's height system.

    Returns
    -------
    (n,) metres; 0 where the ray starts at or below the level, NaN where it never comes down to it.
    """
    heights = map_from_tangent(tangent, frame, starts)[:, 2]
    up = _up_at(frame, tangent, starts)
    sink = np.einsum("ij,ij->i", directions, up)
    # h(s) = h0 + sink s + (1 - sink^2) s^2 / 2R: on the sphere, then corrected by the true heights
    curvature = (1.0 - sink**2) / tangent.semi_major_m
    discriminant = sink**2 - 2.0 * curvature * (heights - level)
    with np.errstate(invalid="ignore"):
        root = np.sqrt(discriminant)
        distance = np.where(sink < 0.0, 2.0 * (heights - level) / (root - sink), np.nan)
    below = heights <= level
    distance[below] = 0.0
    active = np.flatnonzero(np.isfinite(distance) & ~below)
    for _ in range(_LEVEL_ITERATIONS):
        if active.size == 0:
            break
        points = starts[active] + distance[active, None] * directions[active]
        excess = map_from_tangent(tangent, frame, points)[:, 2] - level
        distance[active] -= excess / (sink[active] + curvature[active] * distance[active])
        active = active[np.abs(excess) > _LEVEL_TOLERANCE_M]
    return distance


def ground_distances(model: HeightModel, tangent: TangentFrame, starts: Floats, directions: Floats) -> Floats:
    """Distance along rays to where they first meet the bilinear surface of a height model.

    Parameters
    ----------
    model : HeightModel
    tangent : TangentFrame
        The frame of the rays.
    starts, directions : (n, 3)
        Rays from above the surface; directions are unit vectors.

    Returns
    -------
    (n,) metres; NaN where a ray does not come down, or leaves the model, or ends in a void.
    """
    starts = np.ascontiguousarray(np.broadcast_to(starts, directions.shape), np.float64)
    low, high = _range_under(model, tangent, starts, directions)
    if not low <= high:
        return np.full(len(starts), np.nan)
    near = distances_to_level(model.frame, tangent, starts, directions, high)
    far = distances_to_level(model.frame, tangent, starts, directions, low)
    # both bounds lie on the surface where it is level: a little room above and below
    near, far = np.maximum(near - 1.0, 0.0), far + 1.0
    out = np.full(len(starts), np.nan)
    active = np.flatnonzero(np.isfinite(near) & np.isfinite(far))
    level_part = np.sqrt(
        np.maximum(1.0 - np.einsum("ij,ij->i", directions, _up_at(model.frame, tangent, starts)) ** 2, 1e-12)
    )
    length = np.minimum(_CHORD_M / level_part, np.maximum(far - near, 1e-6))
    while active.size:
        stop = np.minimum(near[active] + length[active], far[active])
        hit = _chord_distances(model, tangent, starts[active], directions[active], near[active], stop)
        out[active] = hit
        near[active] = stop
        active = active[np.isnan(hit) & (stop < far[active])]
    return _refined(model, tangent, starts, directions, out)


def _range_under(
    model: HeightModel, tangent: TangentFrame, starts: Floats, directions: Floats
) -> tuple[float, float]:
    """Bounds of the heights that rays can meet, from the part of the model under them."""
    low, high = np.inf, -np.inf
    # a geoid grid may end beside the model: the plan position needs none
    frame = MapFrame(model.frame.crs, HeightSystem.ellipsoidal())
    for depth in _DEPTHS_M:
        far = distances_to_level(frame, tangent, starts, directions, depth - _UNDULATION_M)
        down = np.isfinite(far)
        if not down.any():
            break
        ends = np.concatenate([starts[down], starts[down] + far[down, None] * directions[down]])
        pixels = model.pixel_from_map(map_from_tangent(tangent, frame, ends)[:, :2])
        limit = np.array(model.shape[::-1], np.float64)
        first = np.clip(np.floor(pixels.min(axis=0)) - 2, 0, limit)
        size = np.clip(np.ceil(pixels.max(axis=0)) + 2, 0, limit) - first
        low, high = model.range_around(int(first[0]), int(first[1]), int(size[0]), int(size[1]))
        if low * height_unit_m(model.frame.heights) > depth:
            break
    return low, high


def _chord_distances(
    model: HeightModel, tangent: TangentFrame, starts: Floats, directions: Floats, near: Floats, far: Floats
) -> Floats:
    first = pixels_and_heights(model, tangent, starts + near[:, None] * directions)
    last = pixels_and_heights(model, tangent, starts + far[:, None] * directions)
    return np.asarray(near + (far - near) * _hits_of_chords(model, first, last))


def _refined(
    model: HeightModel, tangent: TangentFrame, starts: Floats, directions: Floats, distances: Floats
) -> Floats:
    found = np.flatnonzero(np.isfinite(distances))
    for reach in _REACHES_M:
        if found.size:
            near = np.maximum(distances[found] - reach, 0.0)
            far = distances[found] + reach
            again = _chord_distances(model, tangent, starts[found], directions[found], near, far)
            # a ray that only grazes the surface may miss it on the shorter chord: then the sag remains
            distances[found] = np.where(np.isfinite(again), again, distances[found])
    return distances


def pixels_and_heights(model: HeightModel, tangent: TangentFrame, points: Floats) -> Floats:
    """Tangent points (n, 3) as (col, row, height) of a model, its height system."""
    mapped = map_from_tangent(tangent, model.frame, points)
    return np.column_stack([model.pixel_from_map(mapped[:, :2]), mapped[:, 2]])


def _hits_of_chords(model: HeightModel, first: Floats, last: Floats) -> Floats:
    """First hits (n,) as fractions of chords given by their ends (n, 3); patches stay small."""
    low = np.floor(np.minimum(first, last)[:, :2].min(axis=0)) - 1
    high = np.ceil(np.maximum(first, last)[:, :2].max(axis=0)) + 1
    rows, cols = model.shape
    low, high = np.maximum(low, 0), np.minimum(high, (cols, rows))
    size = high - low
    out = np.full(len(first), np.nan)
    if not (size > 0).all():
        return out
    if size.prod() <= _PATCH_CELLS:
        patch = model.patch(int(low[0]), int(low[1]), int(size[0]), int(size[1]))
        offset = np.array([patch.col0, patch.row0, 0.0])
        kernels.first_hits(patch.heights, first - offset, last - first, np.ones(len(first)), out)
        return out
    if len(first) > 1:
        middle = 0.5 * (first + last)
        axis = int(np.argmax(np.ptp(middle[:, :2], axis=0)))
        order = np.argsort(middle[:, axis], kind="stable")
        for part in np.array_split(order, 2):
            out[part] = _hits_of_chords(model, first[part], last[part])
        return out
    half = 0.5 * (first + last)
    upper = 0.5 * _hits_of_chords(model, first, half)
    return upper if np.isfinite(upper[0]) else 0.5 + 0.5 * _hits_of_chords(model, half, last)


def _up_at(frame: MapFrame, tangent: TangentFrame, points: Floats) -> Floats:
    """Local vertical at tangent points (n, 3), as unit vectors of the tangent frame."""
    geodetic = tangent.geodetic_from_tangent(points)
    return np.asarray(tangent.rotation_tangent_from_enu(geodetic[:, 0], geodetic[:, 1])[..., 2])
