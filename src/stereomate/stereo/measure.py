"""Measuring in a stereo product: exact points from positions on orthophoto and stereomate.

The height that the law alone gives stands beside the exact one, with the difference, the y-parallax and the
miss distance of the rays. What cannot be measured is flagged with its reason, never guessed.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag
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
# A ray that ends this much before its ground met something else, metres.
_HIDDEN_M: Final = 0.1
# Half of a step of numeric derivatives of the map, metres.
_STEP_M: Final = 5.0


class Flag(IntFlag):
    """Why a measured point is not to be trusted, or is not there at all."""

    GOOD = 0
    OUTSIDE = 1
    """The position lies outside the product."""
    NODATA = 2
    """The product shows nothing there, or the height model has no height."""
    NO_BASE = 4
    """Orthophoto and stereomate show the same photograph there: there is nothing to intersect."""
    OTHER_MODEL = 8
    """The two photographs come from different models (at a seam); the point is exact all the same."""
    FOLD = 16
    """The stereomate folds there: the highest ground is taken, and its noise grows without bound."""
    UNCERTAIN = 32
    """The standard deviation of the height is several times that of the product."""
    MISSED = 64
    """The rays miss each other by more than the noise explains: a wrong pair of positions, or orientation."""
    BEHIND = 128
    """The rays meet behind a projection centre."""
    HIDDEN = 256
    """The height model hides the ground behind the pixel: what the photograph shows stands before it."""
    SEAM = 512
    """Another photograph begins within three standard deviations: the position may belong to it."""


REFUSED: Final = Flag.OUTSIDE | Flag.NODATA | Flag.NO_BASE | Flag.BEHIND


@dataclass(frozen=True)
class MeasureOptions:
    """How well positions were measured, and how well the photographs are oriented.

    Attributes
    ----------
    sigma_px : float
        Standard deviation of every measured coordinate in each product, pixels of the product.
    centre_sigma_m, angle_sigma_rad : float
        Standard deviations of projection centres (per axis) and of rotations (about each axis), the same and
        independent for every photograph. Both 0: what the product knows of them; their share is left out
        where it knows nothing.
    check_hidden : bool
        Trace the rays to the height model, to flag ground that it hides from its photograph.
    """

    sigma_px: float = 0.3
    centre_sigma_m: float = 0.0
    angle_sigma_rad: float = 0.0
    check_hidden: bool = True

    def __post_init__(self) -> None:
        if not (np.isfinite(self.sigma_px) and self.sigma_px > 0.0):
            raise InputError("must be positive", field="sigma_px", value=self.sigma_px)
        for name in ("centre_sigma_m", "angle_sigma_rad"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0.0):
                raise InputError("must be 0 or more", field=name, value=value)


@dataclass(frozen=True, eq=False)
class Measurement:
    """Measured points; n of them, NaN where they are refused.

    Attributes
    ----------
    points : ndarray (n, 3)
        Easting, northing, height in the systems of the project.
    covariance : ndarray (n, 3, 3)
        Of `points`, from the noise of the four measured coordinates.
    orientation_covariance : ndarray (n, 3, 3)
        From the orientation of the two photographs: common to all points of a model, so it does not average
        out. 0 where no accuracy of the orientation was given; NaN where the product knows that of its
        photographs, but not how far these two err together.
    law_heights : ndarray (n,)
        Read through the law alone.
    y_parallax_m : ndarray (n,)
        Left minus right, product axes.
    miss_m : ndarray (n,)
        Shortest distance of the rays: the quality of the orientation.
    standardized : ndarray (n,)
        The one residual of each point over its standard deviation.
    photographs : ndarray of int (n, 2)
        Left and right, indices into the job's photographs; -1 for none.
    ground : ndarray (n, 2)
        Heights of the height model at the two ground points behind the point.
    flags : ndarray of int (n,)
        Sums of `Flag`.
    flying_height_m : ndarray (n,)
        Mean height of the two centres above the point.
    """

    points: Floats
    covariance: Floats
    orientation_covariance: Floats
    law_heights: Floats
    y_parallax_m: Floats
    miss_m: Floats
    standardized: Floats
    photographs: Ints
    ground: Floats
    flags: Ints
    flying_height_m: Floats

    @property
    def heights(self) -> Floats:
        """Exact heights."""
        return self.points[:, 2]

    @property
    def differences(self) -> Floats:
        """Height read through the law minus exact height."""
        return np.asarray(self.law_heights - self.points[:, 2])

    @property
    def sigma(self) -> Floats:
        """Standard deviations (n, 3) from the noise of measuring."""
        return np.asarray(np.sqrt(np.einsum("nii->ni", self.covariance)))

    @property
    def measured(self) -> NDArray[np.bool_]:
        """Points that are not refused."""
        return np.asarray((self.flags & int(REFUSED)) == 0)

    @property
    def reliable(self) -> NDArray[np.bool_]:
        """Points without any flag that casts doubt; a seam does not."""
        return np.asarray((self.flags & ~int(Flag.OTHER_MODEL | Flag.HIDDEN)) == 0)

    def reasons(self, index: int) -> tuple[str, ...]:
        """Names of the flags of a point, in small letters."""
        return tuple(str(flag.name).lower() for flag in Flag if flag and int(self.flags[index]) & flag)

    def summary(self) -> dict[str, float | int]:
        """Accuracy in the terms of the literature, over the reliable points.

        Medians of the standard deviation of height in metres and in per mille of the flying height, and the
        rms difference of the law's heights.
        """
        good = self.reliable
        sigma, flying = self.sigma[good, 2], self.flying_height_m[good]
        some = bool(good.any())
        nan = float("nan")
        return {
            "points": len(self.flags),
            "reliable": int(good.sum()),
            "refused": int((~self.measured).sum()),
            "sigma_height_m": float(np.median(sigma)) if some else nan,
            "sigma_height_per_mille": float(np.median(1e3 * sigma / flying)) if some else nan,
            "law_minus_exact_rms_m": float(np.sqrt(np.mean(self.differences[good] ** 2))) if some else nan,
            "law_minus_exact_largest_m": float(np.abs(self.differences[good]).max()) if some else nan,
            "miss_rms_m": float(np.sqrt(np.mean(self.miss_m[good] ** 2))) if some else nan,
            "y_parallax_rms_m": float(np.sqrt(np.mean(self.y_parallax_m[good] ** 2))) if some else nan,
        }


@dataclass(frozen=True, eq=False)
class ObjectHeights:
    """Heights of objects both ways.

    Attributes
    ----------
    foot, top : Measurement
    """

    foot: Measurement
    top: Measurement

    @property
    def heights(self) -> Floats:
        """Exact: top minus foot."""
        return np.asarray(self.top.heights - self.foot.heights)

    @property
    def sigma(self) -> Floats:
        """Standard deviations from the noise of measuring; the orientation's share nearly cancels."""
        return np.asarray(np.hypot(self.top.sigma[:, 2], self.foot.sigma[:, 2]))

    @property
    def law_heights(self) -> Floats:
        """Read through the law alone."""
        return np.asarray(self.top.law_heights - self.foot.law_heights)

    @property
    def differences(self) -> Floats:
        """Law minus exact."""
        return np.asarray(self.law_heights - self.heights)

    @property
    def leaning_m(self) -> Floats:
        """Horizontal distance (n,) of top and foot."""
        return np.asarray(np.hypot(*(self.top.points - self.foot.points)[:, :2].T))

    @property
    def flags(self) -> Ints:
        """Flags of both ends."""
        return self.foot.flags | self.top.flags


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
