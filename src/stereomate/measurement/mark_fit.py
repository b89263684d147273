"""The centre of a fiducial mark in a window of a scan, from its picture: least squares, parts of a pixel."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from stereomate.geometry.adjustment import AdjustmentOptions
from stereomate.geometry.transforms import estimate_plane_transform
from stereomate.measurement.least_squares_matching import LeastSquaresOptions, match_least_squares

Array = NDArray[np.float64]
Picture = NDArray[np.float32]
Point = tuple[float, float]

# Templates up to this are fitted as a whole (across): parts of a circle would slide along it.
_SMALL_PX: Final = 100
_LARGEST_RADIUS: Final = 20
# Standard deviation of the Gaussian before a fit, pixels.
_SMOOTHING: Final = 0.7
_EDGE: Final = 4
_HUBER: Final = 2.0
# Standard deviation of scale and turn before a fit: films are laid by hand.
_PRIOR: Final = 0.02
_STEPS: Final = 30
_LAST_STEP: Final = 1e-3
# Pixels from the start, and turn (or change of scale) beyond which it is not the mark.
_FURTHEST: Final = 2.0
_TURNED: Final = 0.2


def fitted_centre(template: Picture, centre_px: Point, part: Picture, col: float, row: float) -> Point:
    """Centre of the template in a window of the scan that it fits best at (col, row).

    By least squares over the whole where it is small; else by matching of parts that move together: a
    similarity through those that could be matched, the median shift where they are few.
    """
    rows, cols = template.shape
    if min(rows, cols) <= _SMALL_PX:
        return _whole(template, centre_px, part, col, row)
    radius = _LARGEST_RADIUS
    here = np.stack(np.meshgrid(_parts(cols, radius), _parts(rows, radius)), axis=-1).reshape(-1, 2)
    # Grey values of drawn pictures are from 0 to 1: contrast is told in the scan's.
    stretch = float(part.std()) / max(float(template.std()), 1e-12)
    options = LeastSquaresOptions(
        radius_px=radius, largest_way_px=5.0, least_correlation=0.6, largest_deformation=0.15
    )
    found = match_least_squares(
        template * np.float32(stretch), part, here, here + np.array([col, row]), None, options
    )
    good = found.matched
    centre = np.array(centre_px)
    if not good.any():
        return _whole(template, centre_px, part, col, row)
    source, target = found.left_px[good], found.right_px[good]
    shifts = target - source
    middle = np.median(shifts, axis=0)
    near = np.linalg.norm(shifts - middle, axis=1) <= 2.0
    if not near.any():
        return _whole(template, centre_px, part, col, row)
    source, target, shifts = source[near], target[near], shifts[near]
    if len(source) < 4 or float(np.ptp(source, axis=0).max()) < 2.0 * radius:
        x, y = (centre + np.median(shifts, axis=0)).tolist()
        return x, y
    estimate = estimate_plane_transform("similarity", source, target, 0.1, AdjustmentOptions(loss="huber"))
    x, y = np.asarray(estimate.transform.apply(centre)).tolist()
    return x, y


def _whole(template: Picture, centre_px: Point, part: Picture, col: float, row: float) -> Point:
    """Centre of the template moved as a whole: shift, turn and scale about the mark's centre, contrast.

    A dot looks the same however it is turned: turned about its centre, that does not move it.
    """
    wanted = cv2.GaussianBlur(template, (0, 0), _SMOOTHING)
    smooth = cv2.GaussianBlur(np.asarray(part, np.float32), (0, 0), _SMOOTHING)
    rows, cols = wanted.shape
    cx, cy = centre_px[0] - 0.5, centre_px[1] - 0.5  # OpenCV counts from the middle of the first pixel
    right, down = np.meshgrid(np.arange(cols) - cx, np.arange(rows) - cy)
    # What surrounds a mark may be another thing in every scan.
    inner = (
        (slice(_EDGE, -_EDGE), slice(_EDGE, -_EDGE)) if min(rows, cols) > 4 * _EDGE else (slice(None),) * 2
    )
    shift, turn = np.array([col, row]), np.array([1.0, 0.0])  # scale cos, scale sin
    for _ in range(_STEPS):
        a, b = turn
        move = np.array([[a, -b, cx - a * cx + b * cy + shift[0]], [b, a, cy - b * cx - a * cy + shift[1]]])
        seen = cv2.warpAffine(
            smooth, move, (cols, rows), flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REPLICATE,
        )  # fmt: skip
        gy, gx = np.gradient(seen.astype(np.float64))
        columns = (
            gx,
            gy,
            gx * right + gy * down,
            gy * right - gx * down,
            -wanted,
            -np.ones_like(wanted),
            seen,
        )
        equations = np.stack(columns, axis=-1)[inner].reshape(-1, 7).astype(np.float64)
        step = _robust(equations[:, :6], -equations[:, 6], turn - (1.0, 0.0))
        shift, turn = shift + step[:2], turn + step[2:4]
        if not (np.abs(shift - (col, row)).max() <= _FURTHEST and np.hypot(*(turn - (1.0, 0.0))) <= _TURNED):
            return col + centre_px[0], row + centre_px[1]
        if np.abs(step[:2]).max() < _LAST_STEP:
            break
    return float(shift[0]) + centre_px[0], float(shift[1]) + centre_px[1]


def _robust(design: Array, observed: Array, turn: Array) -> Array:
    """Least squares, once more with weights that fall off for what does not fit (Huber's).

    Scale and turn have a prior, for pictures that do not tell them.
    """
    found = np.linalg.lstsq(design, observed, rcond=None)[0]
    misfit = np.abs(design @ found - observed)
    noise = max(1.4826 * float(np.median(misfit)), 1e-6)
    root = np.sqrt(_HUBER * noise / np.maximum(misfit, _HUBER * noise))
    prior = np.zeros((2, design.shape[1]))
    prior[0, 2] = prior[1, 3] = noise / _PRIOR
    design = np.concatenate([design * root[:, None], prior])
    observed = np.concatenate([observed * root, -turn * noise / _PRIOR])
    return np.asarray(np.linalg.lstsq(design, observed, rcond=None)[0], np.float64)


def _parts(length: int, radius: int) -> Array:
    """Middles of windows that fit into a length, a radius apart, in pixel centres."""
    first, last = radius + 2, length - radius - 3
    if last <= first:
        return np.array([length // 2 + 0.5])
    count = max(2, (last - first) // radius + 1)
    return np.floor(np.linspace(first, last, count)) + 0.5
