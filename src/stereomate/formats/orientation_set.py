"""Orientations of a file as one value, with the frame they are in, and the way from frame to frame.

Every reader of an orientation format returns an `OrientationSet`, every writer takes one. A conversion goes
through a tangent frame at the middle of the block, so nothing but rounding is lost between a map grid,
a topocentric frame and geocentric coordinates.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.camera.model import Camera
from stereomate.errors import CrsError, HeightSystemError, OrientationError
from stereomate.frames.adjusted import grid_from_space_centres, space_from_grid_centres
from stereomate.frames.attitude import AttitudeAxes, rotation_tangent_from_axes
from stereomate.frames.crs import Geodetic, datum_note, datum_operation, geodetic_of, same_datum
from stereomate.frames.factors import grid_factors_geodetic
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame, geodetic_from_geocentric
from stereomate.frames.transform import map_from_map, tangent_from_map

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GeocentricFrame:
    """Geocentric coordinates X, Y, Z in metres on the datum of a CRS (EPSG:4978 is WGS 84)."""

    crs: str

    def __post_init__(self) -> None:
        geodetic_of(self.crs)

    @property
    def geodetic(self) -> Geodetic:
        """The datum."""
        return geodetic_of(self.crs)


Place = MapFrame | TangentFrame | GeocentricFrame

_ADJUSTED: Final = "centres were adjusted in the grid"
# Axes that make sense for coordinates of each kind of frame.
_AXES: Final[dict[type, tuple[AttitudeAxes, ...]]] = {
    MapFrame: ("grid", "grid_east_north", "local", "geocentric"),
    TangentFrame: ("tangent", "local", "geocentric"),
    GeocentricFrame: ("geocentric", "local"),
}


def axes_of_place(place: Place) -> tuple[AttitudeAxes, ...]:
    """Axes that angles may be about beside coordinates in a frame; the usual ones first."""
    if isinstance(place, MapFrame) and place.is_geographic:
        return "local", "geocentric"
    return _AXES[type(place)]


@dataclass(frozen=True, eq=False)
class OrientationSet:
    """Exterior orientations of photographs in one declared frame.

    Attributes
    ----------
    names : tuple of str
        As the file writes them.
    positions : ndarray (n, 3)
        Projection centres in `place`: map coordinates and heights, tangent or geocentric metres.
    rotations : ndarray (n, 3, 3)
        From camera axes (x right, y up, z backwards) to `axes`.
    place : MapFrame, TangentFrame or GeocentricFrame
        What the positions are.
    axes : str
        What the rotations are about, as `AttitudeConvention.axes`; ``tangent`` means those of `place`.
    cameras : tuple of str or None
        The camera of each photograph, where the file names one.
    camera_values : mapping of str to Camera
        Cameras the file defines.
    notes : tuple of str
        What was assumed or found out, in sentences.

    Raises
    ------
    OrientationError
        If names repeat, lengths differ, a number is not finite, or the axes make no sense in the frame.
    """

    names: tuple[str, ...]
    positions: Array
    rotations: Array
    place: Place
    axes: AttitudeAxes
    cameras: tuple[str | None, ...] = ()
    camera_values: Mapping[str, Camera] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        count = len(self.names)
        if count == 0:
            raise OrientationError("needs at least one photograph", field="names", value=0)
        twice = sorted({name for name in self.names if self.names.count(name) > 1}) if count < 2000 else []
        if twice or len(set(self.names)) != count:
            raise OrientationError("names a photograph twice", field="names", value=twice or count)
        positions = np.array(self.positions, dtype=np.float64)
        rotations = np.array(self.rotations, dtype=np.float64)
        if positions.shape != (count, 3) or rotations.shape != (count, 3, 3):
            raise OrientationError(
                f"needs {count} positions and rotations", value=(positions.shape, rotations.shape)
            )
        if not (np.isfinite(positions).all() and np.isfinite(rotations).all()):
            raise OrientationError("positions and rotations must be finite numbers")
        if self.axes not in axes_of_place(self.place):
            allowed = ", ".join(axes_of_place(self.place))
            rule = f"must be one of {allowed} for coordinates in {describe_place(self.place)}"
            raise OrientationError(rule, field="axes", value=self.axes)
        positions.setflags(write=False)
        rotations.setflags(write=False)
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "rotations", rotations)
        object.__setattr__(self, "cameras", tuple(self.cameras) or (None,) * count)
        if len(self.cameras) != count:
            raise OrientationError(f"needs a camera for each of {count}", value=len(self.cameras))

    def with_notes(self, *notes: str) -> OrientationSet:
        """The same with more said about it."""
        return replace(self, notes=(*self.notes, *(note for note in notes if note not in self.notes)))


def describe_place(place: Place) -> str:
    """A frame in words."""
    if isinstance(place, MapFrame):
        return f"{place.name} with {place.heights.description}"
    if isinstance(place, TangentFrame):
        datum = place.geodetic
        return (
            f"a tangent frame at longitude {place.longitude_deg:.9g}, latitude {place.latitude_deg:.9g}, "
            f"height {place.height_m:.4f}" + (f" on {datum.name}" if datum else "")
        )
    return f"geocentric coordinates on {place.geodetic.name}"


def datum_of(place: Place) -> Geodetic:
    """The datum of a frame.

    Raises
    ------
    CrsError
        If a tangent frame does not name one.
    """
    datum = place.geodetic
    if datum is None:
        raise CrsError("does not name its datum", field="tangent frame", value=describe_place(place))
    return datum


def converted(source: OrientationSet, place: Place, axes: AttitudeAxes | None = None) -> OrientationSet:
    """The same orientations in another frame or about other axes.

    Parameters
    ----------
    source : OrientationSet
    place : MapFrame, TangentFrame or GeocentricFrame
        Frame of the result.
    axes : str, optional
        Axes of the result; the usual ones of `place` if absent.

    Raises
    ------
    CrsError, HeightSystemError, MissingGridError, OrientationError
        If a datum or height transformation is not known, grid axes are asked of a map that has none, or only
        one of the two height systems is declared.
    """
    axes = axes or axes_of_place(place)[0]
    positions, notes = positions_in(source.place, place, source.positions)
    if place == source.place and axes == source.axes:
        rotations = source.rotations
    else:
        turns = rotations_between(source.place, source.axes, place, axes, source.positions)
        rotations = turns @ source.rotations
    result = replace(source, positions=positions, rotations=rotations, place=place, axes=axes)
    datums = datum_words(source.place, place, source.positions[0])
    return result.with_notes(*notes, *datums, *_scale_notes(source, place))


def positions_in(source: Place, target: Place, points: ArrayLike) -> tuple[Array, tuple[str, ...]]:
    """Points (n, 3) of one frame in another, exactly, and what was assumed about datum and heights."""
    xyz = np.asarray(points, dtype=np.float64)
    if source == target:
        return np.array(xyz), ()
    _require_heights(source, target)
    note = datum_note(datum_of(source), datum_of(target))
    notes = () if note is None else (note,)
    if isinstance(source, MapFrame) and isinstance(target, MapFrame):
        return map_from_map(target, source, xyz), notes
    geodetic = source if isinstance(source, MapFrame) else _geodetic_map(source)
    if isinstance(source, MapFrame):
        here = xyz
    elif isinstance(source, TangentFrame):
        here = source.geodetic_from_tangent(xyz)
    else:
        here = geodetic_from_geocentric(xyz, source.geodetic.semi_major_m, source.geodetic.flattening)
    if isinstance(target, MapFrame):
        return map_from_map(target, geodetic, here), notes
    if isinstance(target, TangentFrame):
        return tangent_from_map(target, geodetic, here), notes
    # Any tangent frame on the target's datum serves as a stepping stone.
    step = TangentFrame.at_geodetic(target.geodetic, 0.0, 0.0, 0.0)
    return step.geocentric_from_tangent(tangent_from_map(step, geodetic, here)), notes


def datum_words(source: Place, target: Place, point: ArrayLike) -> tuple[str, ...]:
    """Which transformation leads from one datum to the other at a point (3,) of the source; empty if none."""
    plain = _ellipsoidal(source)
    lon, lat, _ = positions_in(plain, _geodetic_map(source), np.asarray(point, dtype=np.float64)[None])[0][0]
    used = datum_operation(datum_of(source), datum_of(target), float(lon), float(lat))
    if used is None:
        return ()
    name, accuracy = used
    good = "of unknown accuracy" if accuracy is None else f"accurate to {accuracy:g} m"
    return (f"datums differ: transformed by {name}, {good}",)


def space_from_grid(source: OrientationSet, reference_height: float) -> OrientationSet:
    """True positions from centres adjusted in the map grid (georeferencing theory, section 9).

    Raises
    ------
    OrientationError
        If the positions are not coordinates of a map.
    CrsError, HeightSystemError
        As `space_from_grid_centres`.
    """
    frame = _grid_of(source.place)
    result = space_from_grid_centres(frame, source.positions, reference_height)
    mean = float(result.shift_m.mean())
    return replace(source, positions=result.centres).with_notes(
        f"{_ADJUSTED} with control at height {reference_height:g}: true heights are {mean:+.3f} m on average"
    )


def grid_from_space(source: OrientationSet, reference_height: float) -> OrientationSet:
    """Centres as an adjustment in the map grid would have given them: the inverse of `space_from_grid`."""
    centres = grid_from_space_centres(_grid_of(source.place), source.positions, reference_height)
    mean = float((centres - source.positions)[:, 2].mean())
    return replace(source, positions=centres).with_notes(
        f"centres are written as an adjustment in the grid with control at height {reference_height:g} "
        f"gives them: {mean:+.3f} in height on average"
    )


def _grid_of(place: Place) -> MapFrame:
    if not isinstance(place, MapFrame):
        rule = "has a meaning only for coordinates of a map grid"
        raise OrientationError(rule, field="reference height", value=describe_place(place))
    return place


def _geodetic_map(place: Place) -> MapFrame:
    return MapFrame(datum_of(place).crs, HeightSystem.ellipsoidal())


def _require_heights(source: Place, target: Place) -> None:
    undeclared = [_undeclared(source), _undeclared(target)]
    if undeclared[0] == undeclared[1]:
        return
    which = "source" if undeclared[0] else "target"
    other = describe_place(target if undeclared[0] else source)
    raise HeightSystemError(
        f"of the {which} are undeclared, so they cannot be brought to or from {other}",
        field="heights",
        hint='declare them: "ellipsoidal", a vertical CRS such as EPSG:5773, or a geoid grid file',
    )


def _undeclared(place: Place) -> bool:
    return isinstance(place, MapFrame) and place.heights.kind == "undeclared"


def rotations_between(
    source: Place, source_axes: AttitudeAxes, target: Place, target_axes: AttitudeAxes, points: ArrayLike
) -> Array:
    """Rotations (n, 3, 3) from axes in one frame to axes in another at points (n, 3) of the first.

    Raises
    ------
    CrsError, OrientationError
        If grid axes are asked of a map that has none, or a datum transformation is not known.
    """
    xyz = np.asarray(points, dtype=np.float64)
    fixed = [place for place in (source, target) if not isinstance(place, MapFrame)]
    if len(fixed) == 2 and not same_datum(datum_of(fixed[0]), datum_of(fixed[1])):
        # Rotations change datum along east, north and up of a map: through longitude and latitude.
        step = _geodetic_map(target)
        there = positions_in(source, step, xyz)[0]
        onwards = rotations_between(step, "local", target, target_axes, there)
        return onwards @ rotations_between(source, source_axes, step, "local", xyz)
    working = _working_frame(fixed[0] if fixed else source, source, xyz)
    centres = positions_in(_ellipsoidal(source), working, xyz)[0]
    here = _tangent_from_axes(source, source_axes, working, centres)
    there = _tangent_from_axes(target, target_axes, working, centres)
    turns: Array = np.swapaxes(there, -1, -2) @ here
    return np.broadcast_to(turns, (len(xyz), 3, 3))


def _ellipsoidal(place: Place) -> Place:
    """For axes only: undeclared heights are taken as ellipsoidal (100 m turn a plumb line by nothing)."""
    return MapFrame(place.crs, HeightSystem.ellipsoidal()) if _undeclared(place) else place  # type: ignore[union-attr]


def _working_frame(place: Place, source: Place, points: Array) -> TangentFrame:
    if isinstance(place, TangentFrame):
        return place
    datum = datum_of(place)
    target = MapFrame(datum.crs, HeightSystem.ellipsoidal())
    middle = points.mean(axis=0)[None]
    lon, lat, h = positions_in(_ellipsoidal(source), target, middle)[0][0]
    return TangentFrame.at_geodetic(datum, float(lon), float(lat), float(h))


def _tangent_from_axes(place: Place, axes: AttitudeAxes, working: TangentFrame, centres: Array) -> Array:
    if isinstance(place, MapFrame):
        if axes in ("grid", "grid_east_north"):
            place.require_conformal()
        return rotation_tangent_from_axes(axes, working, centres, place)
    origin = place if isinstance(place, TangentFrame) else None
    return rotation_tangent_from_axes(axes, working, centres, None, origin)


def _scale_notes(source: OrientationSet, place: Place) -> tuple[str, ...]:
    """What reading or writing centres of a projected map as true positions means."""
    frames = [p for p in (source.place, place) if isinstance(p, MapFrame) and not p.is_geographic]
    said = any(note.startswith(_ADJUSTED) for note in source.notes)
    if place == source.place or not frames or said:
        return ()
    frame = frames[0]
    try:
        frame.require_conformal()
    except CrsError:  # without one scale there is nothing to say about it
        return ()
    here = source.positions
    points = here if frame is source.place else positions_in(source.place, frame, here)[0]
    geodetic = MapFrame(frame.crs, HeightSystem.ellipsoidal()).geodetic_from_map(points)
    tau, _ = grid_factors_geodetic(frame.crs, geodetic[:, 0], geodetic[:, 1])
    return (
        (
            "centres are taken as true positions; had they been adjusted in the grid, their heights would be "
            f"off by {1e6 * (float(tau.mean()) - 1.0):+.0f} ppm (at the ellipsoid) of the height above ground"
        ),
    )
