"""The graphical determination of the over-correction factor, as values (Kasper 1956, Figs. 3-6).

Everything is constructed as on paper: perpendiculars to the projection rays at their points, intersections of
straight lines, projections onto a ray. No over-correction formula is used here, so that the number read off
the drawing and the formula check each other.

Three perpendiculars: A3 and A5 are where the perpendiculars of 3 and 5 meet that of 1, a' = A3 A5; D is where
the parallel to the perpendicular of 1 through O meets the perpendicular of 5, d' = O D; n = d'/a' (eq. 9).
Projected onto the ray O 5, d' becomes d = O 5 and a' becomes a = F 5, with F the foot of A3; n = d/a
(eq. 10). A3 lies opposite O on the critical circle, hence F is where the ray meets that circle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import InputError, NotDeterminedError
from stereomate.relative.critical import ROLES, CriticalCircle, critical_circle, one_section

FloatArray = NDArray[np.float64]
Point = tuple[float, float]
Construction = Literal["general", "nadir", "flat"]

# Heights or offsets below this part of the flying height count as flat, or as at the nadir, on paper.
_ON_PAPER = 1e-9


@dataclass(frozen=True)
class SectionDrawing:
    """Geometry of the drawing of one cross-section; y to the right, z down, O at the origin, metres.

    Attributes
    ----------
    section : ndarray (3, 2)
        The three points in the order of the rows given.
    numbers : tuple of int
        Their numbers: (1, 3, 5) or (2, 4, 6).
    roles : tuple of int
        Rows of the first and the second cleared point and of the corrected one.
    profile : ndarray (m, 2) or None
        Terrain profile through the points, if one was given.
    construction : {"general", "nadir", "flat"}
        How many perpendiculars have to be drawn: three (Fig. 4), two (Fig. 5), one (Fig. 6).
    meeting_3 : point
        A3, where the perpendiculars of the two cleared points meet: opposite O on the critical circle.
    meeting_5 : point or None
        A5, where the perpendicular of the corrected point meets that of the first; None if parallel.
    end_d : point or None
        D on the perpendicular of the corrected point, OD parallel to the perpendicular of the first.
    foot : point
        F, the foot of A3 on the ray to the corrected point.
    circle : CriticalCircle
        Through O and the two cleared points.
    """

    section: FloatArray
    numbers: tuple[int, int, int]
    roles: tuple[int, int, int]
    profile: FloatArray | None
    construction: Construction
    meeting_3: Point
    meeting_5: Point | None
    end_d: Point | None
    foot: Point
    circle: CriticalCircle

    @property
    def first(self) -> Point:
        """The first cleared point, whose perpendicular carries A3 and A5."""
        return _point(self.section[self.roles[0]])

    @property
    def second(self) -> Point:
        """The second cleared point."""
        return _point(self.section[self.roles[1]])

    @property
    def corrected(self) -> Point:
        """The point at which the tilt is over-corrected."""
        return _point(self.section[self.roles[2]])

    @property
    def d(self) -> float:
        """Length O 5 in metres."""
        return math.hypot(*self.corrected)

    @property
    def a(self) -> float:
        """Length F 5 in metres, measured away from O: negative inside the critical circle."""
        return _along(self.foot, self.corrected, self.corrected)

    @property
    def d_primed(self) -> float | None:
        """Length O D along the perpendicular of point 1."""
        if self.end_d is None:
            return None
        return _along((0.0, 0.0), self.end_d, _perpendicular(self.first))

    @property
    def a_primed(self) -> float | None:
        """Length A3 A5 along the perpendicular of point 1, in the direction in which d' is measured."""
        if self.meeting_5 is None:
            return None
        return _along(self.meeting_3, self.meeting_5, _perpendicular(self.first))

    @property
    def factor(self) -> float:
        """n = d/a as read off the drawing (eq. 10); ±inf if F and 5 coincide."""
        return _ratio(self.d, self.a)

    @property
    def factor_primed(self) -> float | None:
        """n = d'/a' as read off the drawing (eq. 9); None if that construction has no intersections."""
        if self.d_primed is None or self.a_primed is None:
            return None
        return _ratio(self.d_primed, self.a_primed)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Smallest and largest y and z of all that is drawn except the circle beyond the points."""
        points = [(0.0, 0.0), *map(_point, self.section), self.foot, self.meeting_3]
        points += [point for point in (self.meeting_5, self.end_d) if point is not None]
        array = np.array(points)
        if self.profile is not None:
            array = np.concatenate([array, self.profile])
        (y0, z0), (y1, z1) = array.min(axis=0), array.max(axis=0)
        return float(y0), float(y1), float(z0), float(z1)


def section_drawing(
    section: ArrayLike, corrected: int = 5, profile: ArrayLike | None = None
) -> SectionDrawing:
    """Construct the drawing for one cross-section.

    Parameters
    ----------
    section : array_like, shape (3, 2)
        Points 1, 3, 5 (or 2, 4, 6) by y, z, as for `overcorrection_factor`.
    corrected : {5, 3, 1, 6, 4, 2}
        Number of the point at which the tilt is over-corrected.
    profile : array_like, shape (m, 2), optional
        Terrain profile to draw, y and z; nan where there is none.

    Raises
    ------
    InputError
        If the section or the profile is not valid.
    NotDeterminedError
        If the two cleared points lie on one ray: their perpendiculars do not meet.
    """
    points = one_section(section)
    circle = critical_circle(points, corrected)
    roles = ROLES[corrected]
    first, second, last = (_point(points[row]) for row in roles)
    meeting_3 = _meeting(first, second)
    if meeting_3 is None:
        raise NotDeterminedError("the perpendiculars of the two cleared points are parallel: no drawing")
    return SectionDrawing(
        section=points,
        numbers=(1, 3, 5) if corrected % 2 else (2, 4, 6),
        roles=roles,
        profile=None if profile is None else _profile(profile),
        construction=_construction(first, second, last),
        meeting_3=meeting_3,
        meeting_5=_meeting(first, last),
        end_d=_parallel_through_origin(first, last),
        foot=_foot(meeting_3, last, _sine(first, second)),
        circle=circle,
    )


def _profile(profile: ArrayLike) -> FloatArray:
    line = np.asarray(profile, dtype=np.float64)
    if line.ndim != 2 or line.shape[1] != 2:
        raise InputError("must have shape (m, 2): y, z", field="profile", value=line.shape)
    line = line[np.isfinite(line).all(axis=1)]
    if len(line) < 2:
        raise InputError("must have two points or more with heights", field="profile", value=len(line))
    return line


def _construction(first: Point, second: Point, last: Point) -> Construction:
    tolerance = _ON_PAPER * first[1]
    if abs(first[0]) > tolerance:
        return "general"
    if abs(second[1] - first[1]) <= tolerance and abs(last[1] - first[1]) <= tolerance:
        return "flat"
    return "nadir"


def _point(values: FloatArray) -> Point:
    return float(values[0]), float(values[1])


def _perpendicular(point: Point) -> Point:
    """Direction perpendicular to the ray O-point: to the right for a point below O."""
    return point[1], -point[0]


def _meeting(one: Point, other: Point) -> Point | None:
    """Intersection of the perpendiculars to two rays at their points; None if they are parallel."""
    area = one[0] * other[1] - one[1] * other[0]
    r1, r2 = math.hypot(*one), math.hypot(*other)
    if abs(area) <= 8.0 * np.finfo(np.float64).eps * r1 * r2:
        return None
    # Both lines are p·x = |p|².
    return (r1**2 * other[1] - r2**2 * one[1]) / area, (r2**2 * one[0] - r1**2 * other[0]) / area


def _sine(one: Point, other: Point) -> float:
    """Sine of the angle between two rays from O, without its sign."""
    return abs(one[0] * other[1] - one[1] * other[0]) / (math.hypot(*one) * math.hypot(*other))


def _foot(meeting: Point, last: Point, sine: float) -> Point:
    """Foot of A3 on the ray to the corrected point; that point itself where the two coincide to rounding."""
    distance = math.hypot(*last)
    part = (meeting[0] * last[0] + meeting[1] * last[1]) / distance**2
    # A3 is the less certain the more the two perpendiculars run together.
    uncertainty = 16.0 * np.finfo(np.float64).eps * (1.0 + math.hypot(*meeting) / distance) / sine
    return last if abs(1.0 - part) <= uncertainty else (part * last[0], part * last[1])


def _parallel_through_origin(first: Point, last: Point) -> Point | None:
    """Where the parallel through O to the perpendicular of `first` meets the perpendicular of `last`."""
    direction = _perpendicular(first)
    across = direction[0] * last[0] + direction[1] * last[1]
    square = last[0] ** 2 + last[1] ** 2
    if abs(across) <= 8.0 * np.finfo(np.float64).eps * math.hypot(*first) * math.sqrt(square):
        return None
    return direction[0] * square / across, direction[1] * square / across


def _along(start: Point, end: Point, direction: Point) -> float:
    """Signed length from start to end along a direction."""
    return ((end[0] - start[0]) * direction[0] + (end[1] - start[1]) * direction[1]) / math.hypot(*direction)


def _ratio(numerator: float, denominator: float) -> float:
    return numerator / denominator if denominator != 0.0 else math.copysign(math.inf, numerator)
