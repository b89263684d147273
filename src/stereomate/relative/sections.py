"""Orientation points from cross-sections of the ground, and how strongly they determine the lateral tilt.

The points are von Gruber's where the ground allows: below the base, and at equal distances on both sides.
Where one of them is on water, in a void or outside the photographs, the nearest usable place is taken, and if
a whole side is unusable or the result would be near critical, the three usable places that determine the
tilt best.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import InputError
from stereomate.relative.critical import CriticalCircle, Side, critical_circle, side_of_circle
from stereomate.relative.drawing import section_drawing
from stereomate.relative.overcorrection import (
    factor_change_per_metre,
    flat_overcorrection_factor,
    overcorrection_factor,
    tilt_standard_deviation,
)

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Choice = Literal["standard", "moved", "free"]

# Strength is compared with flat ground under a normal-angle camera, points at y/z = 1/3 (Kasper's Table I):
# the weakest geometry that practice called regular.
_REFERENCE_SECTION: Final = ((0.0, 1.0), (-1.0 / 3.0, 1.0), (1.0 / 3.0, 1.0))
# Usable places among which a free choice is made; all triples of them are compared.
_CANDIDATES = 41


@dataclass(frozen=True)
class SectionStrength:
    """Everything the over-correction factor says about one section.

    Attributes
    ----------
    section : ndarray (3, 2)
        The points by y and z, metres.
    corrected : int
        Number of the over-corrected point.
    factor : float
        n, ±inf on the critical circle.
    d, a : float
        Lengths of the drawing in metres, n = d/a.
    circle : CriticalCircle
    side : {"inside", "on", "outside"}
        Where the corrected point lies.
    distance : float
        Of the corrected point from the circle in metres, negative inside.
    change_per_metre : tuple of float
        Change of n per metre of height at each point; nan on the circle.
    change : float
        Standard deviation of n when the three heights have independent errors of one metre.
    tilt_std_per_metre : float
        Standard deviation of ω in radians per metre of y-parallax in the model.
    tilt_std_per_angle : float
        The same per radian of parallax angle, that is per unit of y-parallax in the image over the principal
        distance: compares sections of any size.
    """

    section: FloatArray
    corrected: int
    factor: float
    d: float
    a: float
    circle: CriticalCircle
    side: Side
    distance: float
    change_per_metre: tuple[float, float, float]
    change: float
    tilt_std_per_metre: float
    tilt_std_per_angle: float


def section_strength(section: ArrayLike, corrected: int = 5) -> SectionStrength:
    """Strength of one section, shape (3, 2), as for `overcorrection_factor`.

    Raises
    ------
    InputError
        If the section is not valid.
    NotDeterminedError
        If the two cleared points lie on one ray.
    """
    drawing = section_drawing(section, corrected)
    circle = critical_circle(section, corrected)
    points = drawing.section
    change = factor_change_per_metre(points, corrected)
    return SectionStrength(
        section=points,
        corrected=corrected,
        factor=overcorrection_factor(points, corrected),
        d=drawing.d,
        a=drawing.a,
        circle=circle,
        side=side_of_circle(points, corrected),
        distance=circle.signed_distance(drawing.corrected),
        change_per_metre=(float(change[0]), float(change[1]), float(change[2])),
        change=float(np.sqrt((change**2).sum())),
        tilt_std_per_metre=tilt_standard_deviation(points),
        tilt_std_per_angle=tilt_standard_deviation(points, points[:, 1]),
    )


@dataclass(frozen=True)
class SectionOptions:
    """How points are chosen and when a section counts as weak.

    Attributes
    ----------
    tolerance : float
        Part of the nominal distance within which a place still counts as the standard one.
    search : float
        Part of the nominal distance within which another place is taken for a standard one.
    limit_factor : float
        Size of n above which the section is near the critical circle.
    limit_ratio : float
        `OrientationSection.ratio` above which a section is weak.
    """

    tolerance: float = 0.05
    search: float = 0.35
    limit_factor: float = 10.0
    limit_ratio: float = 4.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.tolerance <= self.search < 0.5:
            raise InputError(
                "must be in order: 0 <= tolerance <= search < 0.5",
                field="section options",
                value=(self.tolerance, self.search),
            )


@dataclass(frozen=True)
class OrientationSection:
    """Points chosen in one cross-section.

    Attributes
    ----------
    place : float
        Position along the base, 0 under the first and 1 under the second centre.
    choice : {"standard", "moved", "free"}
        Von Gruber's points; some of them moved to usable ground; or chosen freely for strength.
    indices : tuple of int
        Of points 1, 3 and 5 in the profile.
    strength : SectionStrength
    ratio : float
        Standard deviation of ω, for parallaxes measured in the image, over that of flat ground under a
        normal-angle camera (y/z = 1/3).
    near_critical, weak : bool
        Size of n, or ratio, above the limit.
    """

    place: float
    choice: Choice
    indices: tuple[int, int, int]
    strength: SectionStrength
    ratio: float
    near_critical: bool
    weak: bool


def orientation_section(
    y: ArrayLike,
    z: ArrayLike,
    usable: ArrayLike,
    nominal: float,
    place: float = 0.0,
    options: SectionOptions | None = None,
) -> OrientationSection | None:
    """Choose orientation points in a profile of the ground.

    Parameters
    ----------
    y, z : array_like, shape (m,)
        Profile across the strip, metres from the projection centre (or the base line), z down.
    usable : array_like of bool, shape (m,)
        Where a parallax can be observed: land with texture, seen in both photographs.
    nominal : float
        y/z of von Gruber's points 3 and 5: usually base over flying height.
    place : float
        Position of the profile along the base, passed on.
    options : SectionOptions, optional

    Returns
    -------
    OrientationSection or None
        None where fewer than three usable places are far enough apart.

    Raises
    ------
    InputError
        If the arrays do not match, or the nominal tangent is not positive.
    """
    chosen = options if options is not None else SectionOptions()
    profile = np.column_stack([np.asarray(y, np.float64).ravel(), np.asarray(z, np.float64).ravel()])
    good = np.asarray(usable, dtype=bool).ravel()
    if len(good) != len(profile):
        raise InputError("must be as many as the profile", field="usable", value=(len(good), len(profile)))
    if not (math.isfinite(nominal) and nominal > 0.0):
        raise InputError("must be positive and finite", field="nominal", value=nominal)
    good = good & np.isfinite(profile).all(axis=1) & (profile[:, 1] > 0.0)
    regular = _standard_points(profile, good, nominal, chosen)
    found = None if regular is None else _section(profile, regular, place, chosen)
    if found is None or found.near_critical or found.weak:
        free = _strongest_points(profile, good, nominal)
        other = None if free is None else _section(profile, free, place, chosen)
        if found is None or (other is not None and other.ratio < 0.5 * found.ratio):
            found = other
    return found


def _section(
    profile: FloatArray, choice: tuple[tuple[int, int, int], Choice], place: float, options: SectionOptions
) -> OrientationSection:
    indices, kind = choice
    strength = section_strength(profile[list(indices)])
    ratio = strength.tilt_std_per_angle / reference_std()
    return OrientationSection(
        place=float(place),
        choice=kind,
        indices=indices,
        strength=strength,
        ratio=float(ratio),
        near_critical=not abs(strength.factor) <= options.limit_factor,
        weak=not ratio <= options.limit_ratio,
    )


@dataclass(frozen=True)
class PairSections:
    """Sections of one pair and what they say together.

    Attributes
    ----------
    sections : tuple of OrientationSection
        By their place along the base.
    missing : tuple of float
        Places at which no section could be formed.
    flat_factor : float
        n of flat ground with von Gruber's points, for comparison (1).
    tilt_std_per_angle : float
        Standard deviation of ω from the weighted mean of all sections, per radian of parallax angle (the
        paper takes the plain mean: the same where the sections are equally strong).
    """

    sections: tuple[OrientationSection, ...]
    missing: tuple[float, ...]
    flat_factor: float
    tilt_std_per_angle: float

    @property
    def near_critical(self) -> bool:
        """Whether every section is near the critical circle, or there is none."""
        return all(section.near_critical for section in self.sections)

    @property
    def weak(self) -> bool:
        """Whether even the mean of all sections determines ω worse than the limit of a single one."""
        return all(section.weak for section in self.sections)

    @property
    def strength(self) -> float:
        """Standard deviation of ω of the reference section over that of all sections together.

        The reference is that of `OrientationSection.ratio`. More is better, 0 is critical.
        """
        return reference_std() / self.tilt_std_per_angle

    def under(self, place: float) -> OrientationSection | None:
        """The section at a place along the base: 0 under the first, 1 under the second centre."""
        return next((section for section in self.sections if abs(section.place - place) < 1e-6), None)


def reference_std() -> float:
    """Standard deviation of ω per radian of parallax angle on flat ground, points at y/z = 1/3: 11.02."""
    return float(tilt_standard_deviation(_REFERENCE_SECTION))


def pair_sections(
    profiles: list[tuple[float, FloatArray, BoolArray]],
    nominal: float,
    options: SectionOptions | None = None,
) -> PairSections:
    """Choose points in several cross-sections of a pair.

    Parameters
    ----------
    profiles : list of (place, section, usable)
        Position along the base, profile (m, 2) by y and z, and where it is usable (m,).
    nominal : float
        y/z of von Gruber's points.
    options : SectionOptions, optional
    """
    sections, missing = [], []
    for place, profile, usable in sorted(profiles, key=lambda item: item[0]):
        found = orientation_section(profile[:, 0], profile[:, 1], usable, nominal, place, options)
        if found is None:
            missing.append(float(place))
        else:
            sections.append(found)
    spread = [section.strength.tilt_std_per_angle for section in sections]
    weights = [1.0 / value**2 for value in spread if value > 0.0]
    total = sum(weights)
    return PairSections(
        sections=tuple(sections),
        missing=tuple(missing),
        flat_factor=float(flat_overcorrection_factor(1.0, nominal)),
        tilt_std_per_angle=math.sqrt(1.0 / total) if total > 0.0 else math.inf,
    )


def section_of_points(
    points: ArrayLike,
    x: float,
    width: float,
    nominal: float,
    place: float = 0.0,
    options: SectionOptions | None = None,
) -> OrientationSection | None:
    """Choose a section among points of the previous model with nearly equal x (aerial triangulation).

    Parameters
    ----------
    points : array_like, shape (m, 3)
        x along the base, y across, z down, metres from the projection centre of the new model.
    x : float
        Where the section is wanted.
    width : float
        Points within half of it on either side belong to the section.
    nominal, place, options
        As for `orientation_section`; with scattered points "moved" and "free" are the rule.

    Raises
    ------
    InputError
        If the points have another shape or the width is not positive.
    """
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError("must have shape (m, 3)", field="points", value=array.shape)
    if not width > 0.0:
        raise InputError("must be positive", field="width", value=width)
    near = np.abs(array[:, 0] - x) <= 0.5 * width
    return orientation_section(array[:, 1], array[:, 2], near, nominal, place, options)


def _standard_points(
    profile: FloatArray, good: BoolArray, nominal: float, options: SectionOptions
) -> tuple[tuple[int, int, int], Choice] | None:
    """The usable places nearest to von Gruber's, or None if one of the three has none near."""
    with np.errstate(divide="ignore", invalid="ignore"):
        tangent = profile[:, 0] / profile[:, 1]
    chosen, choice = [], "standard"
    for wanted in (0.0, -nominal, nominal):
        offset = np.where(good, np.abs(tangent - wanted), np.inf)
        index = int(np.argmin(offset)) if len(offset) else -1
        if index < 0 or offset[index] > options.search * nominal:
            return None
        if offset[index] > options.tolerance * nominal:
            choice = "moved"
        chosen.append(index)
    first, second, last = chosen
    return (first, second, last), "standard" if choice == "standard" else "moved"


def _strongest_points(
    profile: FloatArray, good: BoolArray, nominal: float
) -> tuple[tuple[int, int, int], Choice] | None:
    """The three usable places with the smallest standard deviation of ω, a quarter of nominal apart."""
    rows = np.flatnonzero(good)
    if len(rows) > _CANDIDATES:
        rows = rows[np.unique(np.linspace(0, len(rows) - 1, _CANDIDATES).round().astype(int))]
    if len(rows) < 3:
        return None
    tangent = profile[rows, 0] / profile[rows, 1]
    rows = rows[np.argsort(tangent)]
    tangent = np.sort(tangent)
    triples = np.array(list(combinations(range(len(rows)), 3)))
    apart = np.minimum(
        tangent[triples[:, 1]] - tangent[triples[:, 0]], tangent[triples[:, 2]] - tangent[triples[:, 1]]
    )
    triples = triples[apart >= 0.25 * nominal]
    if len(triples) == 0:
        return None
    # From side to side they are 3, 1, 5.
    sections = profile[rows[triples[:, [1, 0, 2]]]]
    best = triples[int(np.argmin(tilt_standard_deviation(sections, sections[..., 1])))]
    return (int(rows[best[1]]), int(rows[best[0]]), int(rows[best[2]])), "free"
