"""What a person declares about a file of orientations where the file itself does not say it.

A file of numbers rarely says in which frame its positions are and about which axes its angles turn. What is
neither in the file nor fixed by its format has to be declared; what is missing is refused with the list of
possibilities, never guessed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.model import Camera
from stereomate.errors import FormatError
from stereomate.formats.opensfm import OpenSfmFrame
from stereomate.formats.orientation_set import GeocentricFrame, Place, axes_of_place
from stereomate.frames.attitude import AttitudeAxes, AttitudeConvention, AttitudeKind, Mount
from stereomate.frames.crs import WGS84, geodetic_of, parse, vertical_part
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.units import AngleUnit

MatrixDirection = Literal["object_from_camera", "camera_from_object"]

AXES_WORDS: Final[dict[AttitudeAxes, str]] = {
    "grid": "grid (the map's own axes at each centre)",
    "grid_east_north": "grid_east_north (grid east and north, whatever the axes of the coordinates)",
    "local": "local (east, north, up at each centre)",
    "tangent": "tangent (those of the tangent frame)",
    "geocentric": "geocentric",
}
_CHOICES: Final[dict[str, tuple[str, ...]]] = {
    "axes": get_args(AttitudeAxes),
    "order": ("opk", "pok", "rph"),
    "unit": get_args(AngleUnit),
    "mount": get_args(Mount),
    "matrix": get_args(MatrixDirection),
    "opensfm_frame": get_args(OpenSfmFrame),
}
_FULL_TURN: Final[dict[AngleUnit, float]] = {
    "deg": 360.0,
    "gon": 400.0,
    "rad": 2.0 * math.pi,
    "deg.mmss": 360.0,
}


@dataclass(frozen=True)
class Declared:
    """Declarations about one file; None where nothing is declared.

    Attributes
    ----------
    crs : str or None
        CRS of the positions: projected, geographic, compound, or geocentric. With `origin`: only its datum.
    heights : HeightSystem or None
    origin : (longitude, latitude, height) or None
        The positions are topocentric, east north up about this point (degrees, ellipsoidal metres).
    axes : str or None
        What angles and matrices are about.
    order : str or None
        ``opk``, ``pok`` or ``rph``, for files of angles.
    unit : str or None
        Unit of angles.
    mount : str or None
        For roll, pitch and heading.
    boresight_deg : (3,)
        For roll, pitch and heading.
    matrix : str or None
        Direction of written rotation matrices, for formats that come in both.
    offset : (3,)
        Added to the coordinates of the file to get those of the frame; taken off when writing.
    opensfm_frame : str or None
        Of a ``reconstruction.json``: ``projected`` or ``topocentric``.
    columns, separator
        Of delimited text, as `read_orientation_table`.
    cameras : mapping of str to Camera
        Cameras by name, for formats that must hold them.
    """

    crs: str | None = None
    heights: HeightSystem | None = None
    origin: tuple[float, float, float] | None = None
    axes: AttitudeAxes | None = None
    order: AttitudeKind | None = None
    unit: AngleUnit | None = None
    mount: Mount | None = None
    boresight_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    matrix: MatrixDirection | None = None
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    opensfm_frame: OpenSfmFrame | None = None
    columns: Sequence[str] | None = None
    separator: str | None = None
    cameras: Mapping[str, Camera] = field(default_factory=dict)

    def place(self, default_crs: str | None = None) -> Place | None:
        """The frame that is declared, or None.

        Parameters
        ----------
        default_crs : str, optional
            What the file itself says, if nothing is declared.
        """
        crs = self.crs or default_crs
        if self.origin is not None:
            return TangentFrame.at_geodetic(geodetic_of(crs or WGS84), *self.origin)
        if crs is None:
            return None
        parsed = parse(crs)
        if parsed.is_geocentric:
            return GeocentricFrame(crs)
        return MapFrame(crs, self.heights or _heights_of(crs))

    def require_place(self, path: Path, default_crs: str | None = None) -> Place:
        """The frame that is declared.

        Raises
        ------
        FormatError
            If none is, with the list of possibilities.
        """
        place = self.place(default_crs)
        if place is None:
            raise FormatError(
                "does not say in which coordinate system its positions are",
                file=path,
                field="crs",
                hint="declare one of: a map CRS (EPSG:25832) with its heights; a geocentric CRS (EPSG:4978); "
                "an origin longitude,latitude,height for topocentric coordinates",
            )
        return place

    def require_map(self, path: Path, default_crs: str | None = None) -> MapFrame:
        """The map frame that is declared, for formats that hold map coordinates only."""
        place = self.require_place(path, default_crs)
        if not isinstance(place, MapFrame):
            raise FormatError("must be a map CRS for this format", file=path, field="crs", value=self.crs)
        return place

    def require_axes(self, path: Path, place: Place) -> AttitudeAxes:
        """The axes angles are about, as declared.

        Raises
        ------
        FormatError
            If they are not declared, with the possibilities in this frame.
        """
        allowed = axes_of_place(place)
        if self.axes is None:
            words = "; ".join(AXES_WORDS[axes] for axes in allowed)
            rule = "does not say about which axes its angles turn"
            raise FormatError(rule, file=path, field="axes", hint=f"declare one of: {words}")
        return self.axes

    def require_unit(
        self, path: Path, angles: NDArray[np.float64], written: AngleUnit | None = None
    ) -> AngleUnit:
        """The unit of angles: what the file says, else what is declared.

        Raises
        ------
        FormatError
            If neither says it, or both say different things, or an angle is beyond a full turn.
        """
        if written is not None and self.unit is not None and written != self.unit:
            raise FormatError(
                f"has angles in {written}, but {self.unit} is declared", file=path, field="unit"
            )
        unit = written or self.unit
        largest = float(np.abs(angles).max(initial=0.0))
        possible = ", ".join(name for name, turn in _FULL_TURN.items() if largest <= turn)
        if unit is None:
            rule = f"does not say the unit of its angles (the largest is {largest:g})"
            raise FormatError(rule, file=path, field="unit", hint=f"declare one of: {possible}")
        if largest > _FULL_TURN[unit]:
            rule = f"has an angle beyond a full turn of {_FULL_TURN[unit]:g} {unit}"
            raise FormatError(
                rule, file=path, field="unit", value=largest, hint=f"possible: {possible or 'none'}"
            )
        return unit

    def angle_convention(
        self, kind: AttitudeKind, axes: AttitudeAxes, unit: AngleUnit, path: Path
    ) -> AttitudeConvention:
        """Convention of angles in a file.

        Raises
        ------
        FormatError
            If roll, pitch and heading are written and no mount is declared.
        """
        if kind != "rph":
            return AttitudeConvention(kind, axes, unit)
        if self.mount is None:
            raise FormatError(
                "does not say how the camera sits in the body that roll, pitch and heading are of",
                file=path,
                field="mount",
                hint="declare one of: y_forward (upper edge of the image to the nose), x_forward (its right "
                "edge), gimbal (looks forward at pitch 0, down at -90)",
            )
        omega, phi, kappa = (math.radians(value) for value in self.boresight_deg)
        return AttitudeConvention(kind, axes, unit, self.mount, (omega, phi, kappa))

    def require_matrix(self, path: Path) -> MatrixDirection:
        """Direction of the matrices of a file whose format comes in both."""
        if self.matrix is None:
            raise FormatError(
                "does not say which way its rotation matrices go, and files of both kinds exist",
                file=path,
                field="matrix",
                hint="declare one of: object_from_camera (columns are the camera's axes), camera_from_object "
                "(rows are); a wrong choice turns kappa to -kappa",
            )
        return self.matrix


def check_choice(name: str, value: str, field: str) -> None:
    """Check a declared word, such as the unit of angles.

    Raises
    ------
    FormatError
        If it is none of the choices of the attribute `name`; they are listed.
    """
    if name in _CHOICES and value not in _CHOICES[name]:
        raise FormatError(f"must be one of {', '.join(_CHOICES[name])}", field=field, value=value)


def _heights_of(crs: str) -> HeightSystem:
    """Heights a CRS says itself: its vertical part, ellipsoidal where it is three-dimensional."""
    parsed = parse(crs)
    vertical = vertical_part(parsed)
    if vertical is not None:
        authority = vertical.to_authority(min_confidence=100)
        return HeightSystem.vertical_crs(":".join(authority) if authority else vertical.to_wkt())
    return HeightSystem.ellipsoidal() if len(parsed.axis_info) == 3 else HeightSystem.undeclared()
