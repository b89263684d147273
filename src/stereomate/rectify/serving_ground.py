"""Which model should serve which ground: the score of every model at every place, and the best of them.

The score of a model at a place is the sum of

- obliquity: tangent of the steeper of its two rays' nadir angles;
- base: how far its base/height ratio is from the group's usual one (`rectify.layout`);
- homogeneity: how wrongly a low object there is read through the law of the product, along the rows and
  across them, on the slope that the ground really has;
- edge: nearness of the edge of one of its photographs, where seams would leave no room.

All of them are pure numbers; obliquity of 45 degrees counts as much as a reading wrong by twice the object.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
import scipy  # its parts load when they are used
from numpy.typing import NDArray

from stereomate.raster import Window
from stereomate.rectify.job import RectifyJob
from stereomate.rectify.layout import StereoModel
from stereomate.rectify.overviews import Overviews, intersection

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Bools = NDArray[np.bool_]
Labels = NDArray[np.int32]

HOMOGENEITY_WEIGHT: Final = 0.5
EDGE_WEIGHT: Final = 0.3
# Readings wrong by more than this are all alike: a score must not run away at a cliff.
_WORST_READING: Final = 1.0
# The edge is near within this share of the smaller side of what a model shows.
_EDGE_SHARE: Final = 0.08
# Slopes are those of the ground smoothed over this share of a model: seams do not follow ditches.
_SLOPE_SHARE: Final = 0.04
# Regions smaller than this share of a model's ground are given to their neighbours.
_LEAST_SHARE: Final = 0.02
_LEAST_CELLS: Final = 9
# Cells between ground of models and ground that single photographs are asked for.
_OFF: Final = 3


def law_reading_errors(
    base: Floats, place: Floats, depth: Floats, slopes: Floats, law_slope: Floats
) -> tuple[Floats, Floats]:
    """What a low object reads through the law, less one, and its y-parallax; fractions of its height.

    The limit of equations (7), (10) and (11) of the theory for low objects on a slope.

    Parameters
    ----------
    base : (3,)
        Right centre minus left: u, v, height.
    place : (..., 2)
        Ground from the nadir of the left centre: u, v.
    depth : (...)
        Left centre above the ground.
    slopes : (..., 2)
        dh/du, dh/dv.
    law_slope : (...)
        dq/dh at the ground.
    """
    left = depth + slopes[..., 0] * place[..., 0] + slopes[..., 1] * place[..., 1]
    right = left - (slopes[..., 0] * base[0] + slopes[..., 1] * base[1] - base[2])
    met = (left > 0.0) & (right > 0.0)
    left, right = np.where(met, left, np.nan), np.where(met, right, np.nan)
    foot = 1.0 - (depth + base[2]) / right
    x = place[..., 0] / left - (place[..., 0] - base[0]) / right + law_slope * foot
    y = place[..., 1] / left - (place[..., 1] - base[1]) / right
    return np.asarray(x / law_slope - 1.0), np.asarray(y / law_slope)


def best_models(overviews: Overviews, job: RectifyJob) -> Labels:
    """Index of the best model of the job in every cell, -1 where none has both its photographs there.

    Parameters
    ----------
    job : RectifyJob
        The product itself; models without a right photograph count only where no other kind is near.
    """
    stereo = [k for k, m in enumerate(job.models) if m.right >= 0]
    single = [k for k, m in enumerate(job.models) if m.right < 0]
    label = np.full(overviews.shape, -1, np.int32)
    _label_free_ground(overviews, job, stereo, np.ones(overviews.shape, np.bool_), label)
    # Off by some cells, so that a seam that is made smoother takes nothing from the models.
    free = cv2.dilate((label >= 0).astype(np.uint8), np.ones((2 * _OFF + 1, 2 * _OFF + 1), np.uint8)) == 0
    _label_free_ground(overviews, job, single, free, label)
    return label


def _label_free_ground(
    overviews: Overviews, job: RectifyJob, models: list[int], free: Bools, label: Labels
) -> None:
    """Label the free cells with the best of some models, in place."""
    best = np.full(label.shape, np.inf, np.float32)
    found = np.full(label.shape, -1, np.int32)
    areas = []
    slopes: Floats32 | None = None
    for k in models:
        shown = model_ground(overviews, job.models[k])
        if shown is None:
            continue
        window, valid = shown
        if slopes is None:
            side = max(1, int(_SLOPE_SHARE * np.sqrt(valid.sum())))
            slopes = _slopes(overviews, job, side)
        areas.append(int(valid.sum()))
        at = (slice(window.row0, window.row1), slice(window.col0, window.col1))
        score = _score(overviews, job, job.models[k], window, valid, slopes[at])
        better = valid & free[at] & (score < best[at])
        best[at][better] = score[better]
        found[at][better] = k
    if areas:
        first = found.copy()
        _absorb_small_regions(found, max(_LEAST_CELLS, int(_LEAST_SHARE * np.median(areas))))
        found = where_shown(overviews, job.models, found, first)
        label[found >= 0] = found[found >= 0]


def where_shown(
    overviews: Overviews, models: tuple[StereoModel, ...], label: Labels, first: Labels
) -> Labels:
    """The labels, but `first` where their model does not show the ground and the first one does.

    Else the rule of `rectify.serving` would serve it, up to the very edge of a photograph.
    """
    lost = (label != first) & (first >= 0) & (label >= 0)
    for k in np.unique(label[lost]):
        shown = model_ground(overviews, models[k])
        if shown is not None:
            window, valid = shown
            at = (slice(window.row0, window.row1), slice(window.col0, window.col1))
            lost[at] &= ~(valid & (label[at] == k))
    regions, count = scipy.ndimage.label(lost)
    large = np.bincount(regions.ravel(), minlength=count + 1) >= _LEAST_CELLS
    large[0] = False
    return np.where(large[regions], first, label)


def model_ground(overviews: Overviews, model: StereoModel) -> tuple[Window, Bools] | None:
    """Cells that both photographs of a model show; None if there are none."""
    left = overviews.photographs[model.left]
    if left is None:
        return None
    if model.right < 0:
        return left.window, left.valid
    right = overviews.photographs[model.right]
    if right is None:
        return None
    window = intersection(left.window, right.window)
    if window.is_empty:
        return None
    valid = left.within(window)[1] & right.within(window)[1]
    return (window, valid) if valid.any() else None


def _slopes(overviews: Overviews, job: RectifyJob, side: int) -> Floats32:
    """dh/du, dh/dv (rows, cols, 2) of the smoothed ground; 0 where there is none."""
    known = np.isfinite(overviews.heights)
    filled = np.where(known, overviews.heights, np.float32(0.0))
    weight = cv2.blur(known.astype(np.float32), (2 * side + 1, 2 * side + 1))
    smooth = cv2.blur(filled, (2 * side + 1, 2 * side + 1)) / np.maximum(weight, 1e-6)
    smooth[weight < 0.5] = np.nan
    step = overviews.job.grid.gsd
    dv, du = np.gradient(smooth, step) if min(smooth.shape) > 1 else (smooth * 0, smooth * 0)
    # rows run against v
    return np.asarray(np.nan_to_num(np.stack([du, -dv], axis=-1)), np.float32)


def _score(
    overviews: Overviews,
    job: RectifyJob,
    model: StereoModel,
    window: Window,
    valid: Bools,
    slopes: Floats32,
) -> Floats32:
    at = (slice(window.row0, window.row1), slice(window.col0, window.col1))
    height = overviews.heights[at].astype(np.float64)
    height = np.where(np.isfinite(height), height, 0.5 * sum(job.height_range))
    unit = job.frame.unit_m / job.frame.heights.metres_per_unit
    score = np.zeros(valid.shape)
    places = []
    for p in (model.left, model.right) if model.right >= 0 else (model.left,):
        centre = overviews.centres[p]
        u = (np.arange(window.col0, window.col1) + 0.5 - centre[0]) * overviews.job.grid.gsd * unit
        v = (centre[1] - np.arange(window.row0, window.row1) - 0.5) * overviews.job.grid.gsd * unit
        depth = np.maximum(centre[2] - height, 1e-3)
        places.append((np.stack(np.broadcast_arrays(u[None, :], v[:, None]), axis=-1), depth))
        score = np.maximum(score, np.hypot(u[None, :], v[:, None]) / depth)
    score += model.penalty + EDGE_WEIGHT * _edge(valid, window, overviews.shape)
    if model.right >= 0 and job.is_stereo:
        (place, depth), other = places
        base = np.array([*(place - other[0])[0, 0], float(other[1][0, 0] - depth[0, 0])])
        slope = np.asarray(job.law.slope(height), np.float64) * unit
        wrong = law_reading_errors(base, place, depth, np.asarray(slopes / unit, np.float64), slope)
        for part in wrong:
            size = np.where(np.isfinite(part), np.abs(part), _WORST_READING)
            score += HOMOGENEITY_WEIGHT * np.minimum(size, _WORST_READING)
    return score.astype(np.float32)


def _edge(valid: Bools, window: Window, shape: tuple[int, int]) -> Floats32:
    """1 at the edge of what a model shows, falling to 0; the border of the product is no edge."""
    reach = max(2.0, _EDGE_SHARE * min(valid.shape))
    pad = int(reach) + 1
    rows, cols = shape
    open_sides = (window.row0 == 0, window.row1 == rows, window.col0 == 0, window.col1 == cols)
    top, bottom, left, right = (pad if side else 1 for side in open_sides)
    padded = cv2.copyMakeBorder(valid.astype(np.uint8), top, bottom, left, right, cv2.BORDER_REPLICATE)
    for side, line in zip(open_sides, (padded[0], padded[-1], padded[:, 0], padded[:, -1]), strict=True):
        if not side:
            line[:] = 0
    distance = cv2.distanceTransform(padded, cv2.DIST_L2, 3)[top:-bottom, left:-right]
    return np.asarray(np.clip(1.0 - distance / reach, 0.0, 1.0), np.float32)


def _absorb_small_regions(label: Labels, least: int) -> None:
    """Give regions of fewer cells than `least` to whatever surrounds them, in place."""
    for k in np.unique(label[label >= 0]):
        regions, count = scipy.ndimage.label(label == k)
        sizes = np.bincount(regions.ravel(), minlength=count + 1)
        sizes[0] = least
        small = (sizes < least)[regions]
        if small.any():
            label[small] = -2
    if (label == -2).any():
        wanted = label == -2
        if not (label >= 0).any():
            label[wanted] = -1
            return
        nearest = scipy.ndimage.distance_transform_edt(label < 0, return_distances=False, return_indices=True)
        label[wanted] = label[nearest[0][wanted], nearest[1][wanted]]


def everywhere(label: Labels) -> Labels:
    """The labels carried on to every cell: -1 takes the nearest one."""
    if not (label < 0).any() or not (label >= 0).any():
        return label
    nearest = scipy.ndimage.distance_transform_edt(label < 0, return_distances=False, return_indices=True)
    return np.ascontiguousarray(label[nearest[0], nearest[1]])
