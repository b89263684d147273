"""Attitudes as they are written, and the rotation from the camera to the tangent frame they mean.

A written attitude is three angles, a matrix or a quaternion about some axes. Everything here is a product of
two rotations: ``axes_from_camera``, which the numbers say, and ``tangent_from_axes``, which depends on where
the camera was. Conventions (georeferencing theory, section 5):

- omega-phi-kappa ``R = Rx(omega) Ry(phi) Rz(kappa)``; phi-omega-kappa ``R = Ry(phi) Rx(omega) Rz(kappa)``;
- roll-pitch-heading: body forward-right-down, ``R_nb = Rz(heading) Ry(pitch) Rx(roll)`` to north-east-down,
  ``axes_from_camera = T R_nb mount boresight`` with ``T`` from north-east-down to east-north-up;
- map axes at a projection centre: ``R_grid = Rz(gamma) R_enu``. Adding gamma to kappa is wrong for tilted
  photographs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import OrientationError
from stereomate.frames.crs import convert_geodetic
from stereomate.frames.factors import grid_axes, grid_factors_geodetic
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import (
    TangentFrame,
    geocentric_from_geodetic,
    geodetic_from_geocentric,
    rotation_geocentric_from_enu,
)
from stereomate.geometry.rotations import (
    opk_from_rotation,
    pok_from_rotation,
    quaternion_from_rotation,
    rotation_from_opk,
    rotation_from_pok,
    rotation_from_quaternion,
    rotation_x,
    rotation_y,
    rotation_z,
)
from stereomate.units import AngleUnit, from_radians, radians_from

Array = NDArray[np.float64]

AttitudeKind = Literal["opk", "pok", "rph", "matrix", "quaternion"]
AttitudeAxes = Literal["grid", "grid_east_north", "local", "tangent", "geocentric"]
Mount = Literal["x_forward", "y_forward", "gimbal"]
CameraAxes = Literal["photogrammetric", "computer_vision"]

# Body (forward, right, down) from camera (right, up, backwards).
MOUNTS: Final[dict[str, Array]] = {
    # Right edge of the image towards the nose.
    "x_forward": np.diag([1.0, -1.0, -1.0]),
    # Upper edge of the image towards the nose.
    "y_forward": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
    # Angles are those of a camera that looks forward at pitch 0 and down at -90 degrees (drone gimbals).
    "gimbal": np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]),
}
# East-north-up from north-east-down, and back.
_ENU_FROM_NED: Final = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
# Camera x right, y up, z backwards from x right, y down, z forwards.
_PHOTO_FROM_VISION: Final = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class AttitudeConvention:
    """What a written attitude means.

    Attributes
    ----------
    kind : str
        ``opk`` (omega, phi, kappa), ``pok`` (phi, omega, kappa), ``rph`` (roll, pitch, heading), ``matrix``
        (3 x 3) or ``quaternion`` (w, x, y, z).
    axes : str
        ``grid``: axes of the map at each projection centre, in the right-handed working frame of the map (its
        own x and y, exchanged where they are left-handed); heading from grid north. ``grid_east_north``: the
        same about grid east and north, whatever the axes of the coordinates. ``local``: east-north-up at each
        centre; heading from true north. ``tangent``: of a tangent frame with a stated origin. ``geocentric``.
    unit : str
        ``deg``, ``gon``, ``rad``, ``deg.mmss``; for angles.
    mount : str
        For ``rph``: how the camera sits in the body: ``x_forward``, ``y_forward``, ``gimbal``.
    boresight_rad : (3,)
        For ``rph``: omega, phi, kappa of ``boresight = Rx Ry Rz`` in camera axes.
    camera_axes : str
        ``photogrammetric`` (x right, y up, z backwards) or ``computer_vision`` (x right, y down, z forwards).
    inverse : bool
        True where the written rotation is camera-from-axes.

    Raises
    ------
    OrientationError
        If a name is unknown, or roll-pitch-heading is asked about geocentric axes.
    """

    kind: AttitudeKind
    axes: AttitudeAxes
    unit: AngleUnit = "deg"
    mount: Mount = "y_forward"
    boresight_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    camera_axes: CameraAxes = "photogrammetric"
    inverse: bool = False

    def __post_init__(self) -> None:
        for field, allowed in (
            ("kind", get_args(AttitudeKind)),
            ("axes", get_args(AttitudeAxes)),
            ("unit", get_args(AngleUnit)),
            ("mount", get_args(Mount)),
            ("camera_axes", get_args(CameraAxes)),
        ):
            value = getattr(self, field)
            if value not in allowed:
                raise OrientationError(f"must be one of {', '.join(allowed)}", field=field, value=value)
        if self.kind == "rph" and self.axes == "geocentric":
            raise OrientationError("roll, pitch and heading need a horizon", field="axes", value=self.axes)

    @property
    def body_from_camera(self) -> Array:
        """Mount times boresight, (3, 3)."""
        body: Array = MOUNTS[self.mount] @ rotation_from_opk(self.boresight_rad)
        return body


def axes_from_camera(values: ArrayLike, convention: AttitudeConvention) -> Array:
    """Rotations (..., 3, 3) from camera axes to the axes of the convention that written values mean.

    Parameters
    ----------
    values : array_like
        (..., 3) angles, (..., 3, 3) matrices or (..., 4) quaternions w, x, y, z.

    Raises
    ------
    OrientationError
        If the shape is wrong or a matrix is not a rotation to 1e-6 (it is then made one exactly).
    """
    written = np.asarray(values, dtype=np.float64)
    kind = convention.kind
    shape = {"matrix": (3, 3), "quaternion": (4,)}.get(kind, (3,))
    if written.shape[-len(shape) :] != shape:
        raise OrientationError(f"values of kind {kind} have shape (..., {shape})", value=written.shape)
    if kind == "matrix":
        rotation = _nearest_rotation(written)
    elif kind == "quaternion":
        rotation = rotation_from_quaternion(written)
    else:
        angles = _radians(written, convention.unit)
        if kind == "opk":
            rotation = rotation_from_opk(angles)
        elif kind == "pok":
            rotation = rotation_from_pok(angles)
        else:
            navigation = rotation_z(angles[..., 2]) @ rotation_y(angles[..., 1]) @ rotation_x(angles[..., 0])
            rotation = _ENU_FROM_NED @ navigation @ convention.body_from_camera
    if convention.inverse:
        rotation = np.swapaxes(rotation, -1, -2)
    return rotation @ _PHOTO_FROM_VISION if convention.camera_axes == "computer_vision" else rotation


def written_from_axes(rotation: ArrayLike, convention: AttitudeConvention) -> Array:
    """Written values of rotations (..., 3, 3) from camera axes to the axes of the convention: the inverse.

    Headings come in [0, 360) degrees (or the like in the unit), other angles as the functions of
    `geometry.rotations` give them.
    """
    r = np.asarray(rotation, dtype=np.float64)
    if convention.camera_axes == "computer_vision":
        r = r @ _PHOTO_FROM_VISION
    if convention.inverse:
        r = np.swapaxes(r, -1, -2)
    if convention.kind == "matrix":
        return r
    if convention.kind == "quaternion":
        return quaternion_from_rotation(r)
    if convention.kind == "opk":
        angles = opk_from_rotation(r)
    elif convention.kind == "pok":
        angles = pok_from_rotation(r)
    else:
        n = _ENU_FROM_NED @ r @ convention.body_from_camera.T
        level = np.hypot(n[..., 0, 0], n[..., 1, 0])
        pitch = np.arctan2(-n[..., 2, 0], level)
        roll = np.arctan2(n[..., 2, 1], n[..., 2, 2])
        heading = np.arctan2(n[..., 1, 0], n[..., 0, 0])
        # At pitch ±90 degrees (a gimbal looking straight down) only heading ∓ roll is determined: roll is 0.
        locked = level < 1e-12
        roll = np.where(locked, 0.0, roll)
        heading = np.where(locked, np.arctan2(-n[..., 0, 1], n[..., 1, 1]), heading)
        angles = np.stack([roll, pitch, np.mod(heading, 2.0 * np.pi)], axis=-1)
    return _written(angles, convention.unit)


def object_from_camera(
    values: ArrayLike,
    convention: AttitudeConvention,
    tangent: TangentFrame,
    centres: ArrayLike,
    frame: MapFrame | None = None,
    origin: TangentFrame | None = None,
) -> Array:
    """Rotations (..., 3, 3) from camera to tangent axes that written attitudes mean.

    Parameters
    ----------
    values : array_like
        As `axes_from_camera`.
    centres : array_like (..., 3)
        True projection centres in the tangent frame.
    frame : MapFrame, optional
        The map whose grid or datum the axes belong to; needed for grid axes, and for local axes on another
        datum.
    origin : TangentFrame, optional
        For tangent axes: the frame they are those of, if it is not `tangent` itself.

    Raises
    ------
    OrientationError
        If the values cannot be an attitude, or grid axes are asked without a frame.
    CrsError
        If grid axes are asked in a geographic or non-conformal CRS.
    """
    rotation: Array = rotation_tangent_from_axes(
        convention.axes, tangent, centres, frame, origin
    ) @ axes_from_camera(values, convention)
    return rotation


def written_attitude(
    rotation: ArrayLike,
    convention: AttitudeConvention,
    tangent: TangentFrame,
    centres: ArrayLike,
    frame: MapFrame | None = None,
    origin: TangentFrame | None = None,
) -> Array:
    """Attitudes as a convention writes them, from rotations camera to tangent: the inverse of
    `object_from_camera`."""
    turn = rotation_tangent_from_axes(convention.axes, tangent, centres, frame, origin)
    return written_from_axes(np.swapaxes(turn, -1, -2) @ np.asarray(rotation, dtype=np.float64), convention)


def rotation_tangent_from_axes(
    axes: AttitudeAxes,
    tangent: TangentFrame,
    centres: ArrayLike,
    frame: MapFrame | None = None,
    origin: TangentFrame | None = None,
) -> Array:
    """Rotations (..., 3, 3) from the axes attitudes are written about to tangent axes, at projection centres.

    Parameters and errors as `object_from_camera`.
    """
    if axes == "geocentric":
        return tangent.rotation_geocentric_from_tangent.T
    if axes == "tangent":
        if origin is None:
            return np.eye(3)
        turn: Array = tangent.rotation_geocentric_from_tangent.T @ origin.rotation_geocentric_from_tangent
        return turn
    lon_lat_h = tangent.geodetic_from_tangent(centres)
    tangent_from_enu, lon, lat = _tangent_from_enu(tangent, frame, lon_lat_h)
    if axes == "local":
        return tangent_from_enu
    if frame is None:
        raise OrientationError("angles about grid axes need the map CRS", field="axes", value=axes)
    _, gamma = grid_factors_geodetic(frame.crs, lon, lat)
    enu_from_grid = rotation_z(-gamma)
    if axes == "grid":
        working = np.eye(3)
        working[:2, :2] = grid_axes(frame.crs).working_from_east_north
        enu_from_grid = enu_from_grid @ working.T
    result: Array = tangent_from_enu @ enu_from_grid
    return result


def _tangent_from_enu(
    tangent: TangentFrame, frame: MapFrame | None, lon_lat_h: Array
) -> tuple[Array, Array, Array]:
    """East-north-up at points, on the datum of `frame`, in tangent axes; and longitude and latitude on
    that datum."""
    lon, lat, h = lon_lat_h[..., 0], lon_lat_h[..., 1], lon_lat_h[..., 2]
    datum = tangent.geodetic
    if frame is None or datum is None or datum == frame.geodetic:
        return tangent.rotation_tangent_from_enu(lon, lat), lon, lat
    other = frame.geodetic
    there = np.stack(convert_geodetic(datum, other, lon, lat, h), axis=-1)
    axes = rotation_geocentric_from_enu(there[..., 0], there[..., 1])
    # The other datum's axes as chords of 2 km through the centre, brought over by the datum transformation.
    here = geocentric_from_geodetic(there, other.semi_major_m, other.flattening)
    chords = []
    for k in range(3):
        ends = []
        for sign in (1000.0, -1000.0):
            point = geodetic_from_geocentric(here + sign * axes[..., k], other.semi_major_m, other.flattening)
            back = convert_geodetic(other, datum, point[..., 0], point[..., 1], point[..., 2])
            ends.append(tangent.tangent_from_geodetic(np.stack(back, axis=-1)))
        chords.append(ends[0] - ends[1])
    return _nearest_rotation(np.stack(chords, axis=-1) / 2000.0, 1e-3), there[..., 0], there[..., 1]


def _nearest_rotation(matrix: Array, tolerance: float = 1e-6) -> Array:
    """The rotation nearest to a matrix that is one but for rounding."""
    if not np.isfinite(matrix).all():
        raise OrientationError("a rotation matrix must be of finite numbers")
    u, s, vt = np.linalg.svd(matrix)
    if np.abs(s - 1.0).max(initial=0.0) > tolerance or np.any(np.linalg.det(matrix) < 0.0):
        raise OrientationError(
            f"a rotation matrix is orthonormal with determinant +1 (to {tolerance:g})",
            field="matrix",
            value=matrix.reshape(-1, 3, 3)[0].tolist(),
            hint="a determinant of -1 means left-handed axes; exchange two of them",
        )
    rotation: Array = u @ vt
    return rotation


def _radians(values: Array, unit: AngleUnit) -> Array:
    if unit == "deg.mmss":
        flat = [radians_from(float(value), unit) for value in values.ravel()]
        return np.array(flat).reshape(values.shape)
    return values * radians_from(1.0, unit)


def _written(angles: Array, unit: AngleUnit) -> Array:
    if unit == "deg.mmss":
        flat = [from_radians(float(value), unit) for value in angles.ravel()]
        return np.array(flat).reshape(angles.shape)
    return angles * from_radians(1.0, unit)
