"""The critical circle of a cross-section: where three points cannot determine the lateral tilt."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import InputError, NotDeterminedError
from stereomate.relative.overcorrection import overcorrection_factor

FloatArray = NDArray[np.float64]
Side = Literal["inside", "on", "outside"]

# Row of the corrected point and of the two whose parallaxes are removed before.
ROLES: Final = {1: (1, 2, 0), 3: (0, 2, 1), 5: (0, 1, 2), 2: (1, 2, 0), 4: (0, 2, 1), 6: (0, 1, 2)}


@dataclass(frozen=True)
class CriticalCircle:
    """Circle through the projection centre O (the origin) and the two points cleared first.

    A third point on it leaves the tilt undetermined (n = ±inf); inside it n is negative.

    Attributes
    ----------
    centre_y, centre_z : float
        Metres from the projection centre, z down.
    """

    centre_y: float
    centre_z: float

    @property
    def radius(self) -> float:
        """Radius in metres: the circle passes through the origin."""
        return math.hypot(self.centre_y, self.centre_z)

    @property
    def antipode(self) -> tuple[float, float]:
        """Point opposite O, where the perpendiculars to the two rays at their points meet (Thales)."""
        return 2.0 * self.centre_y, 2.0 * self.centre_z

    def signed_distance(self, point: ArrayLike) -> float:
        """Distance of a point (y, z) from the circle in metres: positive outside, negative inside."""
        y, z = (float(value) for value in np.asarray(point, dtype=np.float64))
        return math.hypot(y - self.centre_y, z - self.centre_z) - self.radius

    def depths_at(self, y: float) -> tuple[float, float] | None:
        """Depths z of the circle at y, upper and lower, or None where it does not reach."""
        inside = self.radius**2 - (y - self.centre_y) ** 2
        if inside < 0.0:
            return None
        half = math.sqrt(inside)
        return self.centre_z - half, self.centre_z + half

    def outline(self, count: int = 361) -> FloatArray:
        """Points (count, 2) along the circle, closed, beginning at O."""
        start = math.atan2(-self.centre_z, -self.centre_y)
        angle = start + np.linspace(0.0, 2.0 * math.pi, count)
        return np.stack(
            (self.centre_y + self.radius * np.cos(angle), self.centre_z + self.radius * np.sin(angle)),
            axis=-1,
        )


def critical_circle(section: ArrayLike, corrected: int = 5) -> CriticalCircle:
    """Critical circle of one section: through O and the two points other than the corrected one.

    Parameters
    ----------
    section : array_like, shape (3, 2)
        Points 1, 3, 5 (or 2, 4, 6) by y, z, as for `overcorrection_factor`.
    corrected : {5, 3, 1, 6, 4, 2}
        Number of the point at which the tilt is over-corrected.

    Raises
    ------
    InputError
        If the section is not valid.
    NotDeterminedError
        If the two points lie on one ray from O: then there is no circle.
    """
    points = one_section(section)
    if math.isnan(overcorrection_factor(points, corrected)):
        first, second, _ = ROLES[corrected]
        raise NotDeterminedError(
            f"points {points[first].tolist()} and {points[second].tolist()} lie on one ray "
            "from the projection centre: no critical circle, no over-correction factor"
        )
    first, second, _ = ROLES[corrected]
    (y1, z1), (y3, z3) = points[first], points[second]
    # K = |p|²/z is linear in t = y/z along a circle through O: K = 2 cy t + 2 cz.
    t1, t3 = y1 / z1, y3 / z3
    k1, k3 = z1 + y1 * t1, z3 + y3 * t3
    slope = (k3 - k1) / (t3 - t1)
    return CriticalCircle(float(0.5 * slope), float(0.5 * (k1 - slope * t1)))


def side_of_circle(section: ArrayLike, corrected: int = 5) -> Side:
    """Which side of the critical circle the corrected point is on; `on` exactly where n is ±inf."""
    n = overcorrection_factor(one_section(section), corrected)
    if math.isnan(n):
        raise NotDeterminedError("the two cleared points lie on one ray: no critical circle")
    if math.isinf(n):
        return "on"
    return "outside" if n > 0.0 else "inside"


def one_section(section: ArrayLike) -> FloatArray:
    """The section as an array (3, 2).

    Raises
    ------
    InputError
        If it is not one section of three points.
    """
    points = np.asarray(section, dtype=np.float64)
    if points.shape != (3, 2):
        raise InputError(
            "must have shape (3, 2): points 1, 3, 5 by y, z", field="section", value=points.shape
        )
    return points
