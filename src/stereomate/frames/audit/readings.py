"""The readings of an orientation an audit tries: attitudes, heights, and the way the block was adjusted.

Each reading turns the same written numbers into projection centres and rotations in a tangent frame, and says
what a project file has to declare for it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any, Final, Literal

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
    unit : str
        Where the heights are in another unit than the project file can say: its name.
    """

    text: str
    name: str
    system: HeightSystem
    unit: str = ""

    @property
    def value(self) -> str:
        """What the project file has to say."""
        if not self.unit:
            return f'"{self.text}"'
        return f'"{self.text}"  # multiply the heights by {self.system.unit_m:.10g}: they are in {self.unit}'

    @property
    def label(self) -> str:
        """For tables: the last part of a path, and the unit where it is no metre."""
        return self.text.rsplit("/", 1)[-1] + (f" in {self.unit}" if self.unit else "")

    def in_unit(self, unit_m: float, unit: str) -> HeightCandidate:
        """The same heights written in another unit."""
        system = replace(self.system, unit_m=unit_m)
        return HeightCandidate(self.text, f"{self.name} in {unit}", system, unit)


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
        Keys of the project file and their values.
    unsaid : tuple of str
        What no key of the project file can say.
    mistakes : int
        How many errors it supposes of the one who declared the orientation.
    """

    name: str
    convention: AttitudeConvention
    image_turn_deg: float = 0.0
    wrong_convergence_sign: bool = False
    clockwise: bool = False
    keys: tuple[tuple[str, str], ...] = field(default=())
    unsaid: tuple[str, ...] = ()
    mistakes: int = 0

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


@dataclass(frozen=True)
class _Mistake:
    """One error in the declaration of attitudes, and how the project file is to be corrected.

    Attributes
    ----------
    words : str
    fields : mapping of str to object
        Of the reading that differ; those of its convention in `convention`.
    key : (str, str) or None
        None where no key can say it.
    """

    words: str
    key: tuple[str, str] | None
    convention: dict[str, Any] = field(default_factory=dict)
    fields: dict[str, Any] = field(default_factory=dict)


def attitude_readings(convention: AttitudeConvention) -> tuple[AttitudeReading, ...]:
    """The declared meaning and those it is commonly mistaken for, singly and about each kind of axes."""
    bases = _bases(convention)
    single = [_mistaken(base, (m,)) for base in bases for group in _aspects(convention) for m in group]
    return (*bases, *single)


def combined_readings(convention: AttitudeConvention) -> tuple[AttitudeReading, ...]:
    """Meanings that differ from the declared one in several ways at once, those of fewest errors first.

    Axes and the convergence's sign, with any two or more of: order of the angles, unit, sense, direction of
    the rotation, camera axes, mount, turned pixels.
    """
    found = [
        _mistaken(base, errors)
        for base in _bases(convention)
        for errors in _combinations(_aspects(convention))
    ]
    return tuple(sorted(found, key=lambda reading: reading.mistakes))


def _bases(convention: AttitudeConvention) -> list[AttitudeReading]:
    """About each kind of axes; the declared one first."""
    bases = [
        AttitudeReading(_axes_name(other), other, keys=_axes_keys(other), mistakes=int(other != convention))
        for other in _axes_of(convention)
    ]
    bases[0] = replace(bases[0], name=f"as declared ({bases[0].name})")
    if convention.axes in ("grid", "grid_east_north", "local"):
        grid = next(r for r in bases if r.convention.axes in ("grid", "grid_east_north"))
        name = "about grid axes, convergence of the wrong sign"
        wrong = replace(grid, name=name, wrong_convergence_sign=True, keys=(), unsaid=(name,), mistakes=1)
        bases.append(wrong)
    return bases


def _combinations(aspects: list[list[_Mistake]]) -> Iterator[tuple[_Mistake, ...]]:
    """One error or none of each aspect, at least two together."""
    for choice in product(*([None, *group] for group in aspects)):
        errors = tuple(error for error in choice if error is not None)
        if len(errors) >= 2:
            yield errors


def _mistaken(base: AttitudeReading, errors: tuple[_Mistake, ...]) -> AttitudeReading:
    """A reading with errors on top of those of its axes."""
    convention = base.convention
    fields: dict[str, Any] = {}
    for error in errors:
        convention = replace(convention, **error.convention)
        fields |= error.fields
    where = _axes_name(base.convention) + (", convergence of the wrong sign" * base.wrong_convergence_sign)
    return replace(
        base,
        name=", ".join([*(error.words for error in errors), where]),
        convention=convention,
        keys=(*base.keys, *(error.key for error in errors if error.key is not None)),
        unsaid=(*base.unsaid, *(error.words for error in errors if error.key is None)),
        mistakes=base.mistakes + len(errors),
        **fields,
    )


def _aspects(convention: AttitudeConvention) -> list[list[_Mistake]]:
    """The errors that exclude each other, group by group."""
    groups: list[list[_Mistake]] = []
    if convention.kind in ("opk", "pok"):
        other = "pok" if convention.kind == "opk" else "opk"
        order = {"opk": "omega-phi-kappa", "pok": "phi-omega-kappa"}[other]
        groups.append([_Mistake(order, ("photos.angle_order", f'"{order}"'), {"kind": other})])
    if convention.kind in ("opk", "pok", "rph"):
        units = [unit for unit in ("deg", "gon", "rad") if unit != convention.unit]
        groups.append(
            [_Mistake(f"angles in {u}", ("photos.angle_unit", f'"{u}"'), {"unit": u}) for u in units]
        )
        sense = "heading counts counter-clockwise" if convention.kind == "rph" else "kappa counts clockwise"
        groups.append([_Mistake(sense, None, fields={"clockwise": True})])
    if convention.kind == "rph":
        mounts = [mount for mount in ("y_forward", "x_forward", "gimbal") if mount != convention.mount]
        groups.append([_Mistake(f"mount {m}", ("photos.mount", f'"{m}"'), {"mount": m}) for m in mounts])
    inverse = "rotation from camera to object" if convention.inverse else "rotation from object to camera"
    groups.append([_Mistake(inverse, None, {"inverse": not convention.inverse})])
    vision = convention.camera_axes == "computer_vision"
    words = "camera axes y up" if vision else "camera axes x right, y down, z forwards"
    axes: CameraAxes = "photogrammetric" if vision else "computer_vision"
    groups.append([_Mistake(words, None, {"camera_axes": axes})])
    groups.append(
        [
            _Mistake(
                f"pixels turned by {turn}°",
                ("camera.rotation", f"{turn}"),
                fields={"image_turn_deg": float(turn)},
            )
            for turn in (90, 180, 270)
        ]
    )
    return groups


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
