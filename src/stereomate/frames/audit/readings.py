"""The readings of an orientation an audit tries: attitudes, heights, and the way the block was adjusted.

Each reading turns the same written numbers into projection centres and rotations in a tangent frame, and says
what a project file has to declare for it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from stereomate.frames.attitude import (
    AttitudeConvention,
    CameraAxes,
    object_from_camera,
    rotation_tangent_from_axes,
)
from stereomate.frames.audit.observations import WrittenBlock
from stereomate.frames.factors import grid_factors_geodetic
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.geometry.rotations import rotation_z

Array = NDArray[np.float64]

Work = Literal["space", "adjusted", "curvature", "cartesian"]
WORKS: Final[tuple[Work, ...]] = ("space", "adjusted", "curvature", "cartesian")
WORK_WORDS: Final[dict[str, str]] = {
    "space": "rigorous, centres are true positions",
    "adjusted": "rigorous, centres' heights freed of the grid's scale",
    "curvature": "grid as Cartesian, classical curvature correction",
    "cartesian": "grid as Cartesian, no correction",
}
# What [photos] adjusted_in has to say.
ADJUSTED_IN: Final[dict[str, str]] = {
    "space": "space",
    "adjusted": "grid",
    "curvature": "grid",
    "cartesian": "grid",
}


@dataclass(frozen=True)
class HeightCandidate:
    """A height system that may be meant.

    Attributes
    ----------
    text : str
        As a project file writes it.
    name : str
        In words.
    system : HeightSystem
    """

    text: str
    name: str
    system: HeightSystem


@dataclass(frozen=True)
class AttitudeReading:
    """One meaning of written attitudes.

    Attributes
    ----------
    name : str
        In words.
    convention : AttitudeConvention
    image_turn_deg : float
        The pixels are turned by this against the attitude (about the camera's axis, counter-clockwise).
    wrong_convergence_sign : bool
        The attitudes were brought to the grid with the convergence of the wrong sign.
    clockwise : bool
        Kappa, or the heading, counts the other way round.
    keys : tuple of (str, str)
        Keys of the project file and their values; empty if the file cannot say it.
    """

    name: str
    convention: AttitudeConvention
    image_turn_deg: float = 0.0
    wrong_convergence_sign: bool = False
    clockwise: bool = False
    keys: tuple[tuple[str, str], ...] = field(default=())

    def rotations(self, block: WrittenBlock, tangent: TangentFrame, centres: Array, frame: MapFrame) -> Array:
        """Rotations (p, 3, 3) from camera to tangent axes."""
        values = block.attitudes
        if {self.convention.kind, block.convention.kind} == {"opk", "pok"}:
            values = values[:, [1, 0, 2]]  # each kind takes its angles in the order of its name
        if self.clockwise:
            values = values * np.array([1.0, 1.0, -1.0])
        grid = None if self.convention.axes == "tangent" else frame
        rotations = object_from_camera(values, self.convention, tangent, centres, grid, block.origin)
        if self.image_turn_deg:
            rotations = rotations @ rotation_z(np.deg2rad(self.image_turn_deg))
        if self.wrong_convergence_sign:
            up = rotation_tangent_from_axes("local", tangent, centres, frame)
            lon, lat, _ = frame.geodetic_from_map(block.positions).T
            _, gamma = grid_factors_geodetic(frame.crs, lon, lat)
            rotations = up @ rotation_z(2.0 * gamma) @ np.swapaxes(up, -1, -2) @ rotations
        return rotations


def attitude_readings(convention: AttitudeConvention) -> tuple[AttitudeReading, ...]:
    """The declared meaning and those it is commonly mistaken for, singly and about each kind of axes."""
    plain = [
        AttitudeReading(_axes_name(other), other, keys=_axes_keys(other)) for other in _axes_of(convention)
    ]
    plain[0] = replace(plain[0], name="as declared: " + plain[0].name)
    readings = list(plain)
    if convention.axes in ("grid", "grid_east_north", "local"):
        grid = next(r for r in plain if r.convention.axes in ("grid", "grid_east_north"))
        readings.append(
            replace(
                grid,
                name="about grid axes, convergence of the wrong sign",
                wrong_convergence_sign=True,
                keys=(),
            )
        )
    mistakes: list[AttitudeReading] = []
    for base in plain:
        mistakes += _mistakes_of(base)
    return (*readings, *mistakes)


def _mistakes_of(base: AttitudeReading) -> list[AttitudeReading]:
    convention = base.convention
    where = f", {_axes_name(convention)}"
    found = []
    if convention.kind in ("opk", "pok", "rph"):
        for unit in ("deg", "gon", "rad"):
            if unit != convention.unit:
                keys = (*base.keys, ("photos.angle_unit", f'"{unit}"'))
                found.append(
                    AttitudeReading(f"angles in {unit}{where}", replace(convention, unit=unit), keys=keys)
                )
        word = "heading counts counter-clockwise" if convention.kind == "rph" else "kappa counts clockwise"
        found.append(AttitudeReading(word + where, convention, clockwise=True))
    if convention.kind in ("opk", "pok"):
        other: Literal["opk", "pok"] = "pok" if convention.kind == "opk" else "opk"
        order = {"opk": "omega-phi-kappa", "pok": "phi-omega-kappa"}[other]
        keys = (*base.keys, ("photos.angle_order", f'"{order}"'))
        found.append(AttitudeReading(order + where, replace(convention, kind=other), keys=keys))
    if convention.kind == "rph":
        for mount in ("y_forward", "x_forward", "gimbal"):
            if mount != convention.mount:
                keys = (*base.keys, ("photos.mount", f'"{mount}"'))
                found.append(
                    AttitudeReading(f"mount {mount}{where}", replace(convention, mount=mount), keys=keys)
                )
    found.append(
        AttitudeReading(
            "rotation from object to camera" + where, replace(convention, inverse=not convention.inverse)
        )
    )
    vision: CameraAxes = "computer_vision"
    if convention.camera_axes == vision:
        vision = "photogrammetric"
    words = "camera axes x right, y down, z forwards" if vision == "computer_vision" else "camera axes y up"
    found.append(AttitudeReading(words + where, replace(convention, camera_axes=vision)))
    for turn, rotation in ((90.0, "90"), (180.0, "180"), (270.0, "270")):
        keys = (*base.keys, ("camera.rotation", rotation))
        found.append(
            AttitudeReading(f"pixels turned by {turn:g}°{where}", convention, image_turn_deg=turn, keys=keys)
        )
    return found


def _axes_of(convention: AttitudeConvention) -> list[AttitudeConvention]:
    """The convention and its like about the other kind of axes at the projection centres."""
    if convention.axes == "local":
        return [
            convention,
            replace(convention, axes="grid_east_north" if convention.kind == "rph" else "grid"),
        ]
    if convention.axes in ("grid", "grid_east_north"):
        return [convention, replace(convention, axes="local")]
    return [convention]


def _axes_name(convention: AttitudeConvention) -> str:
    names = {
        "grid": "about grid axes",
        "grid_east_north": "about grid axes",
        "local": "about true north",
        "tangent": "about tangent axes",
        "geocentric": "about geocentric axes",
    }
    return names[convention.axes]


def _axes_keys(convention: AttitudeConvention) -> tuple[tuple[str, str], ...]:
    if convention.kind == "rph":
        return (
            ("photos.angles", '"rph"'),
            ("photos.north", '"true"' if convention.axes == "local" else '"grid"'),
        )
    name = "grid" if convention.axes == "grid_east_north" else convention.axes
    return (("photos.angles", f'"{name}"'),) if name in ("grid", "local", "tangent") else ()
