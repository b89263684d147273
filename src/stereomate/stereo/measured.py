"""What measuring in a stereo product gives: points, how well they are known, and what is wrong with them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import InputError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Flag(IntFlag):
    """Why a measured point is not to be trusted, or is not there at all."""

    GOOD = 0
    OUTSIDE = 1
    """The position lies outside the product."""
    NODATA = 2
    """The product shows nothing there, or the height model has no height."""
    NO_BASE = 4
    """Orthophoto and stereomate show the same photograph there, or two from one place: no base."""
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
