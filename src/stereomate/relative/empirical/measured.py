"""A measured pair on the instrument: orientation points chosen among the matches of two photographs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.model import Camera
from stereomate.errors import InputError, NotDeterminedError
from stereomate.geometry.rotations import opk_from_rotation, rotation_z
from stereomate.relative.automatic import AutomaticOrientation
from stereomate.relative.empirical.projectors import PlotterModel, Projector, Setting
from stereomate.relative.model import model_points
from stereomate.relative.pair import RelativePose

FloatArray = NDArray[np.float64]

# Part of the overlap's width or height within which a match stands for a chosen point.
_REACH: Final = 0.15
# Part of the overlap on its narrower side that points 3 to 6 use at most.
_EDGE: Final = 0.85


@dataclass(frozen=True)
class MeasuredPair:
    """Orientation points of a pair, ready for the instrument.

    Attributes
    ----------
    names : (str, str)
        Left and right photograph.
    model : PlotterModel
        Points 1 to 6 (1, 3, 5 nearest to the left centre, 2, 4, 6 to the right one) and those of the
        sections between as ``p1.1``, ``p1.3``, ``p1.5`` and so on; photographs laid in by whole degrees.
    profiles : tuple of (str, str, str)
        Points of every section.
    start : Setting
        All motions at zero.
    given : Setting
        The orientation to compare with (that of the project, or the rigorous one of the matches), for the
        dependent pair with the right projector moved.
    failed : tuple of str
        Points that could not be matched.
    pixel : float
        Angle of a pixel in radians: y-parallaxes below it times the flying height are of the measurement.
    """

    names: tuple[str, str]
    model: PlotterModel
    profiles: tuple[tuple[str, str, str], ...]
    start: Setting
    given: Setting
    failed: tuple[str, ...]
    pixel: float


@dataclass(frozen=True)
class Laying:
    """How the chosen points are laid out, and the scale of the model.

    Attributes
    ----------
    profiles : int
        Sections along the base, the outermost ones holding points 1 to 6.
    base_m : float or None
        Length of the base, which two photographs alone do not tell; None: from `flying_height_m`.
    flying_height_m : float
        Mean depth of the points below the base.
    """

    profiles: int = 9
    base_m: float | None = None
    flying_height_m: float = 1500.0

    def __post_init__(self) -> None:
        if self.profiles < 2:
            raise InputError("must be 2 or more", field="profiles", value=self.profiles)
        for name in ("base_m", "flying_height_m"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise InputError("must be positive and finite", field=name, value=value)


def measured_photographs(
    result: AutomaticOrientation,
    cameras: tuple[Camera, Camera],
    names: tuple[str, str],
    laying: Laying | None = None,
) -> MeasuredPair:
    """Choose orientation points among the least-squares matches of two photographs.

    The points lie where von Gruber wants them, as far as the overlap goes: below the base, and on both sides
    at one length of it or 85 % of the narrower side of the overlap; the match nearest to each place is taken.

    Parameters
    ----------
    result : AutomaticOrientation
        Of the two photographs; its orientation is what the hand's is compared with.
    cameras : (Camera, Camera)
    names : (str, str)
    laying : Laying, optional

    Raises
    ------
    NotDeterminedError
        If the photographs are not oriented, or one of the six points has no match near its place.
    """
    laying = laying or Laying()
    if result.orientation is None or not result.determined:
        raise NotDeterminedError(f"{names[0]} and {names[1]}: {'; '.join(result.reasons)}")
    orientation = result.orientation
    correspondences = orientation.adjustment.correspondences
    rows = np.flatnonzero(orientation.used)
    places = model_points(orientation.pose, correspondences)[rows]
    labels, profiles = section_labels(laying.profiles)
    chosen = _nearest(places[:, :2], _wanted(places, laying.profiles))
    missing = [label for label, row in zip(labels, chosen, strict=True) if row < 0]
    require_six(names, missing)
    kept = [k for k, row in enumerate(chosen) if row >= 0]
    points = rows[chosen[kept]]
    turns = _turns(orientation.pose)
    vectors = [
        np.column_stack([photo[points], np.full(len(points), -1.0)]) @ turn.T
        for photo, turn in zip((correspondences.left, correspondences.right), turns, strict=True)
    ]
    base = laying.base_m
    if base is None:
        base = laying.flying_height_m / float(np.abs(places[:, 2]).mean())
    found = tuple(labels[k] for k in kept)
    return MeasuredPair(
        names=names,
        model=PlotterModel(found, vectors[0], vectors[1]),
        profiles=tuple(profile for profile in profiles if set(profile) <= set(found)),
        start=Setting(base),
        given=_given(base, orientation.pose, turns),
        failed=tuple(missing),
        pixel=max(pixel_angle(camera) for camera in cameras),
    )


def section_labels(sections: int) -> tuple[list[str], list[tuple[str, str, str]]]:
    """Names of the points of sections from the left to the right photograph, and the sections by them."""
    profiles = [("1", "3", "5")]
    profiles += [(f"p{k}.1", f"p{k}.3", f"p{k}.5") for k in range(1, sections - 1)]
    profiles.append(("2", "4", "6"))
    return [label for profile in profiles for label in profile], profiles


def require_six(names: tuple[str, str], missing: list[str]) -> None:
    """Raise NotDeterminedError if one of points 1 to 6 is missing."""
    six = [label for label in missing if not label.startswith("p")]
    if six:
        raise NotDeterminedError(f"{names[0]} and {names[1]}: no match at point {', '.join(six)}")


def pixel_angle(camera: Camera) -> float:
    """Angle of a pixel in the middle of a photograph, radians."""
    middle = np.array(camera.size_px) / 2.0
    rays = camera.rays_from_image(np.stack((middle, middle + np.array([0.0, 1.0]))))
    return float(np.linalg.norm(rays[1] - rays[0]))


def dependent_setting(base: float, left: FloatArray, right: FloatArray) -> Setting:
    """A known orientation as elements of the right projector, the left one at zero, with bx as `base`.

    Parameters
    ----------
    left, right : ndarray (3, 3)
        Rotations from the photographs, as laid in, to a frame whose x axis is the base.
    """
    return _right_projector(base, left.T @ np.array([1.0, 0.0, 0.0]), left.T @ right)


def _given(base: float, pose: RelativePose, turns: tuple[FloatArray, FloatArray]) -> Setting:
    """The pose as elements of the right projector, with the photographs laid in by `turns`."""
    return _right_projector(base, turns[0] @ pose.base, turns[0] @ pose.left_from_right @ turns[1].T)


def _right_projector(base: float, direction: FloatArray, left_from_right: FloatArray) -> Setting:
    omega, phi, kappa = opk_from_rotation(left_from_right).tolist()
    by, bz = (base * direction[1:] / direction[0]).tolist()
    return Setting(base, right=Projector(by, bz, omega, phi, kappa))


def _wanted(places: FloatArray, sections: int) -> FloatArray:
    """Places (3 * sections, 2) along and across the base, in bases: 1, 3, 5 of each section."""
    low, high = np.percentile(places[:, :2], [4.0, 96.0], axis=0)
    middle = 0.0 if low[1] < 0.0 < high[1] else 0.5 * float(low[1] + high[1])
    side = min(1.0, _EDGE * float(min(middle - low[1], high[1] - middle)))
    if side < 0.2 * float(high[1] - low[1]):
        # The overlap lies on one side of the base: points 3 and 5 go to its edges.
        middle = 0.5 * float(low[1] + high[1])
        side = 0.5 * _EDGE * float(high[1] - low[1])
    # The overlap may lie askew to the base: the sections go as far as all three rows of points do.
    rows = middle, middle - side, middle + side
    near = [np.abs(places[:, 1] - y) < 0.5 * _REACH * (high[1] - low[1]) for y in rows]
    ends = [np.percentile(places[row, 0], [5.0, 95.0]) for row in near if row.any()]
    start, stop = max(0.0, *(end[0] for end in ends)), min(1.0, *(end[1] for end in ends))
    along = np.linspace(start, stop, sections) if start < stop else np.linspace(low[0], high[0], sections)
    return np.array([(x, y) for x in along for y in (middle, middle - side, middle + side)])


def _nearest(places: FloatArray, wanted: FloatArray) -> NDArray[np.int64]:
    """Row of the match nearest to each place, each match once, points 1 to 6 first; -1 where none is near."""
    size = np.ptp(np.percentile(places, [2.0, 98.0], axis=0), axis=0)
    free = np.ones(len(places), dtype=bool)
    found = np.full(len(wanted), -1, dtype=np.int64)
    for k in sorted(range(len(wanted)), key=lambda k: 3 <= k < len(wanted) - 3):
        off = np.abs(places - wanted[k]) / size
        distance = np.where(free, np.hypot(off[:, 0], off[:, 1]), np.inf)
        row = int(np.argmin(distance))
        if distance[row] <= _REACH:
            found[k], free[row] = row, False
    return found


def _turns(pose: RelativePose) -> tuple[FloatArray, FloatArray]:
    """Turns by whole degrees that bring the base to the right of each photograph."""
    sides = pose.base, pose.left_from_right.T @ pose.base
    left, right = (
        rotation_z(math.radians(-round(math.degrees(math.atan2(side[1], side[0]))))) for side in sides
    )
    return left, right
