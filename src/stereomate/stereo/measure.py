"""Measuring in a stereo product: exact points from positions on orthophoto and stereomate.

The height that the law alone gives stands beside the exact one, with the difference, the y-parallax and the
miss distance of the rays. What cannot be measured is flagged with its reason, never guessed.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.coverage.covariance import OrientationCovariance
from stereomate.errors import InputError
from stereomate.frames.transform import map_from_tangent
from stereomate.rectify.job import RectifyJob
from stereomate.stereo.exact import (
    ExactPoints,
    GroundPoints,
    ground_of_orthophoto,
    ground_of_stereomate,
    intersect_grounds,
    orientation_jacobians,
)
from stereomate.stereo.eyes import checked_positions, require_left_is_left
from stereomate.stereo.lineage import Lineage
from stereomate.stereo.measured import REFUSED, Flag, Measurement, MeasureOptions
from stereomate.stereo.orientation_share import covariances_of, orientation_share
from stereomate.stereo.surface import JobSurface
from stereomate.terrain.intersection import ground_distances

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Beside a fold the noise of the stereomate grows by 1 / (1 - q' dh/du): from here on it is flagged.
FOLD_GROWTH: Final = 4.0
# A height whose standard deviation is this many times the nominal one w0/B sigma sqrt(2) is flagged.
UNCERTAIN: Final = 4.0
# Rays that miss each other by more standard deviations than this do not show the same point.
MISSED_SIGMAS: Final = 5.0
# Two centres nearer to each other than this share of the distance to the ground have no base.
_NO_BASE: Final = 1e-3
# A ray that ends this much before its ground met something else, metres.
_HIDDEN_M: Final = 0.1
# Half of a step of numeric derivatives of the map, metres.
_STEP_M: Final = 5.0


def measure(
    job: RectifyJob,
    lineage: Lineage,
    left_xy: ArrayLike,
    right_xy: ArrayLike,
    options: MeasureOptions | None = None,
    orientation: OrientationCovariance | None = None,
) -> Measurement:
    """Points from map positions (n, 2) on the orthophoto and on the stereomate.

    Parameters
    ----------
    orientation : OrientationCovariance, optional
        What is known of the photographs' orientations; used where `options` state nothing.

    Raises
    ------
    InputError
        If the product has no stereomate, the arrays do not match, a position is not finite, or left and right
        are exchanged.
    """
    options = options or MeasureOptions()
    if not job.is_stereo:
        raise InputError("must have a stereomate to be measured in", field="product", value=job.name)
    left_map, right_map = checked_positions(left_xy, "left_xy"), checked_positions(right_xy, "right_xy")
    if len(left_map) != len(right_map):
        raise InputError(
            "must be as many positions as left_xy", field="right_xy", value=(len(left_map), len(right_map))
        )
    left_uv, right_uv = job.grid.uv_from_map(left_map), job.grid.uv_from_map(right_map)
    surface = JobSurface(job)
    left = ground_of_orthophoto(surface, left_uv)
    right = ground_of_stereomate(surface, job.law, right_uv)
    require_left_is_left(job, surface, left, left_uv, right_uv)
    photographs, flags = _photographs(job, lineage, left_map, right_map)
    flags[~np.isfinite(left.uvh[:, 2]) | ~np.isfinite(right.uvh[:, 2])] |= int(Flag.NODATA)
    centres_of = job.centres_tangent
    centres = centres_of[photographs[:, 0]], centres_of[photographs[:, 1]]
    sigma = 4 * (options.sigma_px * job.grid.gsd,)
    exact = intersect_grounds(left, right, centres, sigma)
    flags[(exact.depths <= 0.0).any(axis=1)] |= int(Flag.BEHIND)
    flags[(photographs >= 0).all(axis=1) & _without_base(left, centres)] |= int(Flag.NO_BASE)
    refused = (flags & int(REFUSED)) != 0
    exact.points[refused] = np.nan
    points, by = _mapped(job, exact.points)
    covariance = by @ exact.covariance @ np.swapaxes(by, 1, 2)
    stated = options.centre_sigma_m, options.angle_sigma_rad
    share = orientation_share(
        orientation_jacobians(exact, centres, sigma),
        covariances_of(job, photographs, stated, orientation),
    )
    flags |= _beside_seams(job, lineage, (left_map, right_map), photographs, options) * ~refused
    flags |= _doubts(job, right, exact, covariance, options) * ~refused
    if options.check_hidden:
        for side, centre in zip((left, right), centres, strict=True):
            flags |= _hidden(job, side, centre) * int(Flag.HIDDEN) * ~refused
    heights = job.law.inverse(left_uv[:, 0] - right_uv[:, 0])
    flying = 0.5 * (centres[0][:, 2] + centres[1][:, 2]) - exact.points[:, 2]
    for values in (heights, exact.miss, exact.standardized):
        values[refused] = np.nan
    covariance[refused] = np.nan
    return Measurement(
        points=points,
        covariance=covariance,
        orientation_covariance=by @ share @ np.swapaxes(by, 1, 2),
        law_heights=heights,
        y_parallax_m=np.where(refused, np.nan, left_uv[:, 1] - right_uv[:, 1]) * job.frame.unit_m,
        miss_m=exact.miss,
        standardized=exact.standardized,
        photographs=photographs,
        ground=np.column_stack([left.uvh[:, 2], right.uvh[:, 2]]),
        flags=flags,
        flying_height_m=flying,
    )


def _photographs(job: RectifyJob, lineage: Lineage, left_map: Floats, right_map: Floats) -> tuple[Ints, Ints]:
    """Indices (n, 2) of the photographs behind the positions, -1 for none, and what is wrong with them."""
    cols, rows = job.grid.size
    flags = np.zeros(len(left_map), np.int64)
    found = np.zeros((len(left_map), 2), np.int64)
    for side, xy in enumerate((left_map, right_map)):
        pixels = job.grid.pixel_from_map(xy)
        outside = ~((pixels >= 0.0) & (pixels < (cols, rows))).all(axis=1)
        flags[outside] |= int(Flag.OUTSIDE)
        found[:, side] = lineage.photographs(side, pixels)
        flags[(found[:, side] == 0) & ~outside] |= int(Flag.NODATA)
    if found.max(initial=0) > len(job.photographs):
        raise InputError(
            f"must name one of the {len(job.photographs)} photographs",
            field="lineage",
            value=int(found.max()),
            hint="it does not belong to this product",
        )
    found -= 1
    both = (found >= 0).all(axis=1)
    flags[both & (found[:, 0] == found[:, 1])] |= int(Flag.NO_BASE)
    models = {(m.left, m.right) for m in job.models}
    pairs = [(int(a), int(b)) not in models and a != b for a, b in found]
    flags[both & np.array(pairs, np.bool_)] |= int(Flag.OTHER_MODEL)
    return found, flags


def _without_base(left: GroundPoints, centres: tuple[Floats, Floats]) -> NDArray[np.bool_]:
    """Whether the two centres are practically one: the rays meet anywhere along themselves."""
    base = np.linalg.norm(centres[1] - centres[0], axis=1)
    return np.asarray(base < _NO_BASE * np.linalg.norm(left.points - centres[0], axis=1))


def _beside_seams(
    job: RectifyJob,
    lineage: Lineage,
    positions: tuple[Floats, Floats],
    photographs: Ints,
    options: MeasureOptions,
) -> Ints:
    """Flag of points that noise may have carried over a seam."""
    near = np.zeros(len(photographs), np.bool_)
    reach = 3.0 * options.sigma_px
    for side, xy in enumerate(positions):
        pixels = job.grid.pixel_from_map(xy)
        for shift in ((reach, 0.0), (-reach, 0.0), (0.0, reach), (0.0, -reach)):
            there = lineage.photographs(side, pixels + np.array(shift)) - 1
            near |= (there >= 0) & (there != photographs[:, side])
    return near * np.int64(Flag.SEAM)


def _mapped(job: RectifyJob, points: Floats) -> tuple[Floats, Floats]:
    """Tangent points (n, 3) in the map, and derivatives (n, 3, 3)."""
    out, by = np.full(points.shape, np.nan), np.full((len(points), 3, 3), np.nan)
    known = np.isfinite(points).all(axis=1)
    if known.any():
        at = points[known]
        out[known] = map_from_tangent(job.tangent, job.frame, at)
        for k in range(3):
            shift = _STEP_M * np.eye(3)[k]
            ends = [map_from_tangent(job.tangent, job.frame, at + s * shift) for s in (1.0, -1.0)]
            by[known, :, k] = (ends[0] - ends[1]) / (2.0 * _STEP_M)
    return out, by


def _hidden(job: RectifyJob, ground: GroundPoints, centres: Floats) -> NDArray[np.bool_]:
    """Whether the ray meets the height model before the ground that it was traced to."""
    ray = ground.points - centres
    length = np.linalg.norm(ray, axis=1)
    known = np.flatnonzero(np.isfinite(length) & (length > 0.0))
    hidden = np.zeros(len(ray), np.bool_)
    if known.size:
        met = ground_distances(job.heights, job.tangent, centres[known], ray[known] / length[known, None])
        # bicubic ground may lie a little below the bilinear surface that rays are traced to
        cubic = job.options.heights_interpolation == "cubic"
        room = max(_HIDDEN_M, min(job.heights.cell_size_m)) if cubic else _HIDDEN_M
        hidden[known] = met < length[known] - room
    return hidden


def _doubts(
    job: RectifyJob, right: GroundPoints, exact: ExactPoints, covariance: Floats, options: MeasureOptions
) -> Ints:
    flags = np.zeros(len(covariance), np.int64)
    flags[~(right.steepness > 1.0 / FOLD_GROWTH) | (right.branches > 1)] |= int(Flag.FOLD)
    nominal = job.law.w0_m / job.law.base_m * options.sigma_px * job.grid.gsd * np.sqrt(2.0)
    flags[~(np.sqrt(covariance[:, 2, 2]) <= UNCERTAIN * nominal)] |= int(Flag.UNCERTAIN)
    flags[np.abs(exact.standardized) > MISSED_SIGMAS] |= int(Flag.MISSED)
    return flags
