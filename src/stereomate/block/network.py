"""A network: everything a bundle adjustment is given, as frozen values over arrays.

All coordinates are in the tangent frame (Cartesian, metres), rotations are object from camera, image
coordinates are pixels (column, row), standard deviations are a priori ones. Photographs, points and cameras
are known by their index; names are for the reader.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.block.network_fields import finite, first_twice, own, own_mount, positive, within
from stereomate.camera.model import Camera
from stereomate.errors import InputError

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

# Parameters of the pixel array that a camera may have free besides its `parameter_names`: ratio of the scales
# along x and y of the photo system minus one, and the shear of the x axis by y.
PIXEL_PARAMETERS: Final = ("pixel_aspect", "pixel_shear")


@dataclass(frozen=True, eq=False)
class BlockCamera:
    """A camera of the block and which of its interior parameters are unknown.

    Parameters
    ----------
    camera : Camera
        Its values are the start, and the observed values of the priors.
    free : mapping of str to float
        Name of an unknown parameter (of ``camera.parameter_names``, ``pixel_aspect``, ``pixel_shear``) to the
        standard deviation of its prior, in its own unit; ``math.inf`` for no prior.
    """

    camera: Camera
    free: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        known = (*self.camera.parameter_names, *PIXEL_PARAMETERS)
        for name, sigma in self.free.items():
            where = f"camera {self.camera.name!r}: free.{name}"
            if name not in known:
                raise InputError(f"must be one of {', '.join(known)}", field=where)
            if not sigma > 0.0:
                raise InputError(
                    "standard deviation of a prior must be positive, or infinite", field=where, value=sigma
                )
        object.__setattr__(self, "free", dict(self.free))


@dataclass(frozen=True, eq=False)
class Photographs:
    """Photographs with their approximate orientations.

    Parameters
    ----------
    names : tuple of str (n)
    camera : ndarray of int, shape (n,)
        Index of the camera.
    centres : ndarray, shape (n, 3)
    rotations : ndarray, shape (n, 3, 3)
        Object from camera.
    fixed : ndarray of bool, shape (n, 6), optional
        Unknowns that keep their start: centre x y z, rotations about the tangent axes x y z.
    """

    names: tuple[str, ...]
    camera: Integers
    centres: Array
    rotations: Array
    fixed: Mask | None = None

    def __post_init__(self) -> None:
        n = len(self.names)
        own(self, "camera", np.int64, (n,))
        own(self, "centres", np.float64, (n, 3))
        own(self, "rotations", np.float64, (n, 3, 3))
        if self.fixed is not None:
            own(self, "fixed", np.bool_, (n, 6))
        twice = first_twice(self.names)
        if twice is not None:
            raise InputError("must not name a photograph twice", field="photographs.names", value=twice)
        finite("photographs.centres", self.centres, self.names)
        finite("photographs.rotations", self.rotations, self.names)


@dataclass(frozen=True, eq=False)
class Points:
    """Object points with approximate coordinates.

    Parameters
    ----------
    names : tuple of str (p)
    xyz : ndarray, shape (p, 3)
    """

    names: tuple[str, ...]
    xyz: Array

    def __post_init__(self) -> None:
        own(self, "xyz", np.float64, (len(self.names), 3))
        finite("points.xyz", self.xyz, self.names)


@dataclass(frozen=True, eq=False)
class ImagePoints:
    """Image observations, in any order.

    Parameters
    ----------
    photo, point : ndarray of int, shape (m,)
    xy : ndarray, shape (m, 2)
        Column and row, pixels.
    sigma : ndarray, shape (m, 2) or float
        Standard deviations, pixels.
    """

    photo: Integers
    point: Integers
    xy: Array
    sigma: Array

    def __post_init__(self) -> None:
        m = len(self.photo)
        own(self, "photo", np.int64, (m,))
        own(self, "point", np.int64, (m,))
        own(self, "xy", np.float64, (m, 2))
        own(self, "sigma", np.float64, (m, 2))
        finite("image.xy", self.xy)
        positive("image.sigma", self.sigma)


@dataclass(frozen=True, eq=False)
class Control:
    """Control and check points.

    Parameters
    ----------
    point : ndarray of int, shape (k,)
    xyz : ndarray, shape (k, 3)
        NaN is allowed where the axis is not known.
    sigma : ndarray, shape (k, 3) or float
        Metres; infinite for an axis that is not known (plan only, height only), 0 for one held fixed.
    covariance : ndarray, shape (k, 3, 3), optional
        Instead of `sigma`, for points known in all axes (rows of NaN: take `sigma`).
    check : ndarray of bool, shape (k,), optional
        Check points take no part in the adjustment; they are compared with its result.
    """

    point: Integers
    xyz: Array
    sigma: Array
    covariance: Array | None = None
    check: Mask | None = None

    def __post_init__(self) -> None:
        k = len(self.point)
        own(self, "point", np.int64, (k,))
        own(self, "xyz", np.float64, (k, 3))
        own(self, "sigma", np.float64, (k, 3))
        object.__setattr__(self, "check", np.zeros(k, np.bool_) if self.check is None else self.check)
        own(self, "check", np.bool_, (k,))
        if self.covariance is not None:
            own(self, "covariance", np.float64, (k, 3, 3))
        if not np.all(self.sigma >= 0.0):
            raise InputError("must not be negative", field="control.sigma", value=self.sigma.min())
        if not np.isfinite(self.xyz[np.isfinite(self.sigma)]).all():
            raise InputError("must be finite where the axis has a standard deviation", field="control.xyz")


@dataclass(frozen=True, eq=False)
class Positions:
    """Observed positions of the antenna: ``X = X0 + R lever_arm + shift[strip] + drift[strip] (t - mean t)``.

    A lever arm that nobody measured well is unknown too: one correction for each mount, camera axes.

    Parameters
    ----------
    photo : ndarray of int, shape (g,)
    xyz : ndarray, shape (g, 3)
    sigma : ndarray, shape (g, 3) or float
        Metres; infinite for an axis that is not known.
    lever_arm : ndarray, shape (g, 3) or (3,)
        From the projection centre to the antenna, camera axes, metres.
    strip : ndarray of int, shape (g,), optional
        Group that shares a shift and a drift; -1 for none.
    time : ndarray, shape (g,), optional
        Seconds, for the drift; the order in the strip if None.
    shift, drift : bool
        Whether each strip has an unknown shift, an unknown drift.
    shift_sigma : ndarray, shape (3,) or float
        Standard deviation of the prior (shift is 0), metres; infinite for none.
    lever_arm_sigma : float or ndarray, shape (3,)
        Standard deviation of the lever arm, metres: 0 holds it, infinite says that nothing is known of it.
    drift_sigma : ndarray, shape (3,) or float
        Standard deviation of the prior (drift is 0), metres in a unit of `time`; infinite for none.
    strip_names : tuple of str
        Names of the strips, by their numbers; those without are called by them.
    mount : ndarray of int, shape (g,), optional
        Group that shares the correction of a lever arm.
    mount_names : tuple of str
    """

    photo: Integers
    xyz: Array
    sigma: Array
    lever_arm: Array = field(default_factory=lambda: np.zeros(3))
    strip: Integers | None = None
    time: Array | None = None
    shift: bool = False
    drift: bool = False
    shift_sigma: Array = field(default_factory=lambda: np.full(3, math.inf))
    lever_arm_sigma: Array = field(default_factory=lambda: np.zeros(3))
    drift_sigma: Array = field(default_factory=lambda: np.full(3, math.inf))
    strip_names: tuple[str, ...] = ()
    mount: Integers | None = None
    mount_names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        g = len(self.photo)
        own(self, "lever_arm_sigma", np.float64, (3,))
        if not (self.lever_arm_sigma >= 0.0).all():
            least = float(self.lever_arm_sigma.min())
            raise InputError("must not be negative", field="positions.lever_arm_sigma", value=least)
        if (self.lever_arm_sigma > 0.0).any() and not (self.lever_arm_sigma > 0.0).all():
            raise InputError("must be positive in all axes or zero in all", field="positions.lever_arm_sigma")
        own(self, "photo", np.int64, (g,))
        own(self, "xyz", np.float64, (g, 3))
        own(self, "sigma", np.float64, (g, 3))
        own(self, "lever_arm", np.float64, (g, 3))
        object.__setattr__(self, "strip", np.zeros(g, np.int64) if self.strip is None else self.strip)
        own(self, "strip", np.int64, (g,))
        own_mount(self, g)
        for name in ("shift_sigma", "drift_sigma"):
            own(self, name, np.float64, (3,))
            positive(f"positions.{name}", getattr(self, name))
        if self.time is not None:
            own(self, "time", np.float64, (g,))
        positive("positions.sigma", self.sigma)
        finite("positions.xyz", self.xyz[np.isfinite(self.sigma)])

    def strip_name(self, strip: int) -> str:
        """What a strip is called."""
        return self.strip_names[strip] if 0 <= strip < len(self.strip_names) else str(strip)


@dataclass(frozen=True, eq=False)
class Attitudes:
    """Observed rotations: ``R_observed = R exp(boresight)``, its error turns about the tangent axes.

    Parameters
    ----------
    photo : ndarray of int, shape (g,)
    rotations : ndarray, shape (g, 3, 3)
        Object from camera, as the inertial system says.
    sigma : ndarray, shape (g, 3) or float
        Of the rotations about the tangent axes x y z, radians.
    boresight : bool
        Whether a misalignment common to each mount (rotation vector in camera axes) is unknown.
    boresight_sigma : float
        Standard deviation of its prior (0), radians; infinite for none.
    mount : ndarray of int, shape (g,), optional
        Group that shares a misalignment.
    mount_names : tuple of str
    """

    photo: Integers
    rotations: Array
    sigma: Array
    boresight: bool = False
    boresight_sigma: float = math.inf
    mount: Integers | None = None
    mount_names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        g = len(self.photo)
        own(self, "photo", np.int64, (g,))
        own(self, "rotations", np.float64, (g, 3, 3))
        own(self, "sigma", np.float64, (g, 3))
        own_mount(self, g)
        positive("attitudes.sigma", self.sigma)
        finite("attitudes.rotations", self.rotations)


@dataclass(frozen=True, eq=False)
class Network:
    """A block to be adjusted; indices are checked here, once.

    Parameters
    ----------
    cameras : tuple of BlockCamera
    photographs : Photographs
    points : Points
    image : ImagePoints
    control : Control, optional
    positions : Positions, optional
    attitudes : Attitudes, optional
    """

    cameras: tuple[BlockCamera, ...]
    photographs: Photographs
    points: Points
    image: ImagePoints
    control: Control | None = None
    positions: Positions | None = None
    attitudes: Attitudes | None = None

    def __post_init__(self) -> None:
        twice = first_twice(tuple(c.camera.name for c in self.cameras))
        if twice is not None:
            raise InputError("must not hold two cameras of one name", field="cameras", value=twice)
        n, p = len(self.photographs.names), len(self.points.names)
        within("photographs.camera", self.photographs.camera, len(self.cameras))
        within("image.photo", self.image.photo, n)
        within("image.point", self.image.point, p)
        key = self.image.photo * max(p, 1) + self.image.point
        order = np.argsort(key, kind="stable")
        again = np.flatnonzero(np.diff(key[order]) == 0)
        if again.size:
            row = int(order[again[0]])
            raise InputError(
                f"point {self.points.names[self.image.point[row]]} is observed twice in "
                f"{self.photographs.names[self.image.photo[row]]}",
                field="image",
            )
        if self.control is not None:
            within("control.point", self.control.point, p)
            if len(np.unique(self.control.point)) < len(self.control.point):
                raise InputError("must not name a point twice", field="control.point")
        for name in ("positions", "attitudes"):
            value = getattr(self, name)
            if value is not None:
                within(f"{name}.photo", value.photo, n)

    def moved_to(self, centres: Array, rotations: Array, xyz: Array) -> Network:
        """The same network from other approximate values."""
        photographs = replace(self.photographs, centres=centres, rotations=rotations)
        return replace(self, photographs=photographs, points=replace(self.points, xyz=xyz))

    def holding(self, fixed: Mask) -> Network:
        """The same network with unknowns of photographs (n, 6) held; what was looked at is not again."""
        photographs, network = copy.copy(self.photographs), copy.copy(self)
        object.__setattr__(photographs, "fixed", fixed)
        object.__setattr__(network, "photographs", photographs)
        return network
