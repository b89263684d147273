"""Orientation points of every pair of a project from cross-sections of its height model."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import shapely
from numpy.typing import NDArray

from stereomate.coverage.pairs import Pair
from stereomate.coverage.summary import Coverage, survey_coverage
from stereomate.coverage.survey import Photograph, Survey
from stereomate.errors import InputError
from stereomate.frames.transform import map_from_tangent
from stereomate.project.model import Project
from stereomate.raster import PhotoReader, open_photo
from stereomate.relative.sections import (
    OrientationSection,
    PairSections,
    SectionOptions,
    pair_sections,
    section_of_points,
)
from stereomate.terrain.sections import CrossSection, cross_sections, section_axes

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Verdict = Literal["good", "weak", "near critical", "no section"]

# Photographs kept open: a strip and its neighbours.
_OPEN_PHOTOGRAPHS = 12
# Two bases are of one strip if they turn by less than this.
_STRIP_TURN = math.radians(45.0)


@dataclass(frozen=True)
class ProjectSectionOptions:
    """Where sections are taken and which ground is usable.

    Attributes
    ----------
    profiles : int
        Cross-sections of each pair, evenly spread over the common ground; two of them under the centres,
        where both photographs see that.
    rays : int
        Rays of each profile.
    widest : float
        y/z beyond which no rays are sent, however far the common ground goes.
    texture_radius_px : int
        Of the window in both photographs whose contrast is looked at.
    least_contrast : float
        Standard deviation of grey values (0-255) below which nothing can be observed, as on water; with 0
        the images are not looked at.
    min_overlap : float
        Pairs that share less of the smaller footprint are left out.
    section : SectionOptions
    """

    profiles: int = 9
    rays: int = 121
    widest: float = 2.5
    texture_radius_px: int = 10
    least_contrast: float = 3.0
    min_overlap: float = 0.2
    section: SectionOptions = field(default_factory=SectionOptions)


@dataclass(frozen=True)
class PairGeometry:
    """How well one pair can be oriented.

    Attributes
    ----------
    names : (str, str)
    base_m, height_m : float
        Length of the base, mean depth of the ground below it.
    nominal : float
        y/z of von Gruber's points 3 and 5, as wide as base over height and the photographs allow.
    sections : PairSections
    points : tuple of ndarray (3, 3)
        Points 1, 3, 5 of each section in the tangent frame.
    points_map : tuple of ndarray (3, 3)
        The same in the map and height system of the project.
    centres_map : ndarray (2, 3)
        Both projection centres there.
    profiles : tuple of ndarray (m, 2)
        Profile of the ground of each section by y and z, NaN where there is none.
    previous : str or None
        Photograph before this pair in its strip.
    from_previous : OrientationSection or None
        The section under the common centre formed from points of the previous model.
    """

    names: tuple[str, str]
    base_m: float
    height_m: float
    nominal: float
    sections: PairSections
    points: tuple[FloatArray, ...]
    points_map: tuple[FloatArray, ...]
    centres_map: FloatArray
    profiles: tuple[FloatArray, ...] = ()
    previous: str | None = None
    from_previous: OrientationSection | None = None

    @property
    def end_factors(self) -> tuple[float, float] | None:
        """n of the sections nearest to the first and the second centre."""
        sections = self.sections.sections
        if not sections:
            return None
        ends = [min(sections, key=lambda section: abs(section.place - place)) for place in (0.0, 1.0)]
        return ends[0].strength.factor, ends[1].strength.factor

    @property
    def verdict(self) -> Verdict:
        """In one word, from all sections together."""
        if not self.sections.sections:
            return "no section"
        if self.sections.near_critical:
            return "near critical"
        return "weak" if self.sections.weak else "good"


def project_sections(
    project: Project,
    options: ProjectSectionOptions | None = None,
    only: tuple[str, str] | None = None,
) -> tuple[PairGeometry, ...]:
    """Sections of the pairs of a project.

    Parameters
    ----------
    project : Project
    options : ProjectSectionOptions, optional
    only : (str, str), optional
        Names of one pair, in either order.

    Raises
    ------
    ProjectError
        If the project has no height model.
    InputError
        If `only` is no pair of the project.
    """
    chosen = options if options is not None else ProjectSectionOptions()
    coverage = survey_coverage(project.survey, project.require_heights(), chosen.min_overlap)
    return sections_of_coverage(project, coverage, chosen, only)


def sections_of_coverage(
    project: Project,
    coverage: Coverage,
    options: ProjectSectionOptions | None = None,
    only: tuple[str, str] | None = None,
) -> tuple[PairGeometry, ...]:
    """As `project_sections`, where the coverage is known already."""
    chosen = options if options is not None else ProjectSectionOptions()
    pairs: Sequence[Pair] = [pair for pair in coverage.pairs if pair.overlap >= chosen.min_overlap]
    if only is not None:
        pairs = [pair for pair in pairs if set(pair.names) == set(only)]
        if not pairs:
            raise InputError(
                f"must be a pair that overlaps by {chosen.min_overlap:.0%} or more", field="pair", value=only
            )
    with _Texture(chosen) as texture:
        found = [
            _pair_geometry(project, pair, _layout(project, pair, coverage, chosen), texture, chosen)
            for pair in pairs
        ]
    return tuple(_with_previous(project.survey, geometry, found, chosen) for geometry in found)


def _layout(
    project: Project, pair: Pair, coverage: Coverage, options: ProjectSectionOptions
) -> tuple[tuple[float, ...], FloatArray]:
    """Places of the sections along the base and y/z of their rays, as far as the common ground goes.

    Two places are under the centres, where both photographs see that.
    """
    one, two = coverage.footprints[pair.first], coverage.footprints[pair.second]
    if one is None or two is None:
        return (0.0, 1.0), np.linspace(-options.widest, options.widest, options.rays)
    centres = project.survey.centres_map[[pair.first, pair.second], :2]
    base = centres[1] - centres[0]
    common = shapely.get_coordinates(one.polygon.intersection(two.polygon)) - centres[0]
    along = common @ base / (base @ base)
    # The outermost strips are cut by the photographs' edges.
    low, high = np.quantile([along.min(), along.max()], [0.08, 0.92]).tolist()
    ends = [place for place in (0.0, 1.0) if low < place < high]
    places = np.linspace(low, high, max(options.profiles - len(ends), 1))
    across = np.abs(common @ np.array([-base[1], base[0]])).max() / float(np.hypot(*base))
    reach = 1.2 * across * project.frame.unit_m / pair.height_above_ground_m
    widest = float(min(reach, options.widest))
    return (
        tuple(sorted({*ends, *(round(float(place), 4) for place in places)})),
        np.linspace(-widest, widest, options.rays),
    )


def _pair_geometry(
    project: Project,
    pair: Pair,
    layout: tuple[tuple[float, ...], FloatArray],
    texture: _Texture,
    options: ProjectSectionOptions,
) -> PairGeometry:
    one, two = project.survey.photographs[pair.first], project.survey.photographs[pair.second]
    start = np.array(one.orientation.centre)
    base = np.array(two.orientation.centre) - start
    places, tangents = layout
    model = project.require_heights()
    starts = start + np.array(places)[:, None] * base
    crosses = cross_sections(model, project.tangent, starts, base, tangents)
    points = np.concatenate([cross.points for cross in crosses])
    good = _inside(points, one) & _inside(points, two) & ~_on_water(project, points)
    good = texture.usable(two, points, texture.usable(one, points, good))
    usable = np.split(good, len(crosses))
    height = _mean_depth(crosses)
    length = float(np.linalg.norm(base))
    nominal = _nominal(length / height, crosses, usable)
    sections = pair_sections(
        [(place, cross.section, good) for place, cross, good in zip(places, crosses, usable, strict=True)],
        nominal,
        options.section,
    )
    by_place = dict(zip(places, crosses, strict=True))
    triples = tuple(by_place[section.place].points[list(section.indices)] for section in sections.sections)
    tangent, frame = project.tangent, project.frame
    return PairGeometry(
        names=(one.name, two.name),
        base_m=length,
        height_m=height,
        nominal=nominal,
        sections=sections,
        points=triples,
        points_map=tuple(map_from_tangent(tangent, frame, three) for three in triples),
        centres_map=map_from_tangent(tangent, frame, np.array([start, start + base])),
        profiles=tuple(by_place[section.place].section for section in sections.sections),
    )


def _with_previous(
    survey: Survey, geometry: PairGeometry, all_pairs: list[PairGeometry], options: ProjectSectionOptions
) -> PairGeometry:
    """The pair with the section under its first centre from the model that precedes it in the strip."""
    centres = {photo.name: np.array(photo.orientation.centre) for photo in survey.photographs}
    first, second = geometry.names
    base = centres[second] - centres[first]
    candidates = []
    for other in all_pairs:
        if first not in other.names or set(other.names) == set(geometry.names) or not other.points:
            continue
        name = next(n for n in other.names if n != first)
        before = centres[first] - centres[name]
        cosine = float(before @ base) / float(np.linalg.norm(before) * np.linalg.norm(base))
        if cosine > math.cos(_STRIP_TURN):
            candidates.append((float(np.linalg.norm(before)), name, other))
    if not candidates:
        return geometry
    _, name, other = min(candidates, key=lambda item: item[0])
    third = survey.photographs[survey.index(second)]
    points = np.concatenate(other.points)
    points = points[_inside(points, third)]
    axes = section_axes(survey.tangent, centres[first], base)
    found = section_of_points(
        (points - centres[first]) @ axes.T,
        x=0.0,
        width=0.3 * geometry.base_m,
        nominal=geometry.nominal,
        options=options.section,
    )
    return replace(geometry, previous=name, from_previous=found)


def _mean_depth(crosses: Sequence[CrossSection]) -> float:
    """Mean depth of the ground below the base, from the inner half of the profiles."""
    inner = [cross.z[np.abs(cross.tangents) < 0.5] for cross in crosses]
    depths = np.concatenate(inner)
    depths = depths[np.isfinite(depths)]
    return float(depths.mean()) if depths.size else math.inf


def _nominal(ratio: float, crosses: Sequence[CrossSection], usable: list[BoolArray]) -> float:
    """Base over height, or nine tenths of what both photographs show on the narrower side."""
    reaches = []
    for cross, good in zip(crosses, usable, strict=True):
        t = cross.tangents[good]
        if (t < 0.0).any() and (t > 0.0).any():
            reaches.append(min(-float(t.min()), float(t.max())))
    widest = 0.9 * float(np.median(reaches)) if reaches else ratio
    nominal = min(ratio, widest)
    # Photographs that see one side only leave no width: then any triple will do.
    return nominal if nominal > 0.02 else 0.02


def _inside(points: FloatArray, photo: Photograph) -> BoolArray:
    safe = np.where(np.isfinite(points), points, 0.0)
    _, inside = photo.camera.image_from_camera(photo.orientation.camera_from_tangent(safe))
    seen: BoolArray = inside & np.isfinite(points).all(axis=-1)
    return seen


def _on_water(project: Project, points: FloatArray) -> BoolArray:
    water = np.zeros(len(points), dtype=bool)
    known = np.isfinite(points).all(axis=1)
    if project.water is not None and known.any():
        plan = map_from_tangent(project.tangent, project.frame, points[known])[:, :2]
        water[known] = shapely.contains_xy(project.water, plan[:, 0], plan[:, 1])
    return water


class _Texture:
    """Looks into photographs for contrast; keeps some open, for neighbouring pairs share theirs.

    Formats without windows are decoded whole when first read, so closing one too early costs much.
    """

    def __init__(self, options: ProjectSectionOptions) -> None:
        self.radius, self.least = options.texture_radius_px, options.least_contrast
        self.readers: OrderedDict[Path, PhotoReader] = OrderedDict()

    def __enter__(self) -> _Texture:
        return self

    def __exit__(self, *_: object) -> None:
        for reader in self.readers.values():
            reader.close()

    def usable(self, photo: Photograph, points: FloatArray, good: BoolArray) -> BoolArray:
        """Where a photograph has contrast round points (n, 3), of those that are good (n,)."""
        if photo.path is None or self.least <= 0.0 or not good.any():
            return good
        rows = np.flatnonzero(good)
        pixels, _ = photo.camera.image_from_camera(photo.orientation.camera_from_tangent(points[rows]))
        reader = self._reader(photo.path)
        windows = [_window(reader, pixel, self.radius) for pixel in pixels]
        # Other types than bytes fill their range as they like: the brightest value seen stands for 255.
        brightest = max((float(values.max()) for values in windows if values is not None), default=1.0)
        result = np.zeros(len(good), dtype=bool)
        for row, values in zip(rows, windows, strict=True):
            if values is not None:
                scale = 1.0 if values.dtype == np.uint8 else 255.0 / max(brightest, 1e-12)
                result[row] = float(values.mean(axis=2, dtype=np.float64).std()) * scale >= self.least
        return result

    def _reader(self, path: Path) -> PhotoReader:
        if path not in self.readers:
            while len(self.readers) >= _OPEN_PHOTOGRAPHS:
                self.readers.popitem(last=False)[1].close()
            self.readers[path] = open_photo(path)
        self.readers.move_to_end(path)
        return self.readers[path]


def _window(reader: PhotoReader, pixel: FloatArray, radius: int) -> NDArray[Any] | None:
    """Pixels round a point; None where part of them has no data."""
    col, row = (math.floor(float(value)) - radius for value in pixel)
    side = 2 * radius + 1
    values, window = reader.read_window(col, row, side, side)
    valid, _ = reader.read_mask(col, row, side, side)
    colours = min(reader.bands, 3)
    return None if window.is_empty or not valid.all() else values[..., :colours]
