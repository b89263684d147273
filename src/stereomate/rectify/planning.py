"""From a survey, a height model and options to the jobs of its products."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray

from stereomate.coverage.footprints import Footprint
from stereomate.coverage.pairs import Pair
from stereomate.coverage.summary import Coverage
from stereomate.coverage.survey import Survey
from stereomate.errors import CoverageError
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.transform import map_from_map
from stereomate.parallax.laws import ParallaxLaw
from stereomate.rectify.grid import ProductGrid
from stereomate.rectify.job import RectifyJob
from stereomate.rectify.layout import (
    StereoModel,
    choose_rotation,
    oriented_models,
    serving_groups,
    suitable_pairs,
)
from stereomate.rectify.options import RectifyOptions
from stereomate.terrain.model import HeightModel, windows

Array = NDArray[np.float64]

# The reference level is the lowest ground, rounded down to this.
REFERENCE_STEP_M = 10.0
# Added to the score of a single photograph: it serves the orthophoto only where no model does.
_MONO_PENALTY = 100.0
# Ground positions per side that are asked which model serves them, to find the law's nominal values.
_SAMPLES = 80
# Products coarser or finer than the photographs by more than this are mistakes.
_MOST_GSD_RATIO = 100.0
# The ground that a stereomate shows reaches beyond the product by less than this share of its size.
_BEYOND = 0.1


@dataclass(frozen=True)
class Request:
    """What is asked for besides the options.

    Attributes
    ----------
    pairs : tuple of (str, str) or None
        Names of photographs: these models instead of all that serve.
    stereo : bool
        False: an orthophoto alone, from all photographs.
    area : shapely geometry or None
        Area of interest in map coordinates.
    bands : tuple of int
        Bands of the photographs to take, from 0.
    dtype : str
        Type of the products.
    """

    pairs: tuple[tuple[str, str], ...] | None = None
    stereo: bool = True
    area: shapely.Geometry | None = None
    bands: tuple[int, ...] = (0,)
    dtype: str = "uint8"


def plan_products(
    survey: Survey,
    heights: HeightModel,
    coverage: Coverage,
    options: RectifyOptions,
    request: Request,
) -> list[RectifyJob]:
    """The jobs of all products of a block, the one with the most common ground first.

    Raises
    ------
    CoverageError
        If no pair can make a model, the area asked for has no ground that a pair shares, or the GSD asked for
        is far from that of the photographs.
    """
    gsd = options.gsd or default_gsd(coverage, survey)
    _require_sensible(gsd, coverage.gsd_m / survey.frame.unit_m)
    if not request.stereo:
        used = [i for i, f in enumerate(coverage.footprints) if f is not None]
        models = [StereoModel(i, -1) for i in used]
        rotation = _fixed_rotation(options) or 0.0
        return [_job("", survey, heights, coverage, options, request, models, rotation, gsd)]
    groups = _groups(survey, coverage, options, request)
    jobs = []
    for k, group in enumerate(groups):
        fixed = _fixed_rotation(options)
        rotation = fixed if fixed is not None else choose_rotation(group, options.object_height_m, gsd)
        models = oriented_models(group, rotation)
        name = "" if k == 0 else str(k + 1)
        jobs.append(_job(name, survey, heights, coverage, options, request, models, rotation, gsd))
    return jobs


def default_gsd(coverage: Coverage, survey: Survey) -> float:
    """Median GSD of the photographs in map units, to two significant digits."""
    gsd = coverage.gsd_m / survey.frame.unit_m
    digits = 1 - math.floor(math.log10(gsd))
    return round(gsd, digits)


def _require_sensible(gsd: float, of_photographs: float) -> None:
    """A unit taken for another one is no product: it would fill the disk, or hold no pixel."""
    if not 1.0 / _MOST_GSD_RATIO <= gsd / of_photographs <= _MOST_GSD_RATIO:
        raise CoverageError(
            f"must be within {_MOST_GSD_RATIO:g} times that of the photographs, {of_photographs:.3g}",
            field="products.gsd",
            value=gsd,
            hint="in units of the map",
        )


def _fixed_rotation(options: RectifyOptions) -> float | None:
    if options.rotation == "auto":
        return None
    return 0.0 if options.rotation == "north-up" else -math.radians(float(options.rotation))


def _groups(
    survey: Survey, coverage: Coverage, options: RectifyOptions, request: Request
) -> list[list[Pair]]:
    if request.pairs is not None:
        return serving_groups([_named_pair(survey, coverage, names) for names in request.pairs])
    usable = suitable_pairs(list(coverage.pairs), options.min_base_height, options.max_base_height)
    groups = serving_groups(usable)
    if not groups:
        best = max((p.overlap for p in coverage.pairs), default=0.0)
        raise CoverageError(
            "no two photographs make a model: 15 % of common ground and a base/height ratio of "
            f"{options.min_base_height} to {options.max_base_height} are needed",
            field="photos",
            value=f"{len(coverage.pairs)} pairs, largest overlap {best:.0%}",
        )
    return groups


def _named_pair(survey: Survey, coverage: Coverage, names: tuple[str, str]) -> Pair:
    wanted = {survey.index(name) for name in names}
    for pair in coverage.pairs:
        if {pair.first, pair.second} == wanted:
            return pair
    raise CoverageError("the two photographs share too little ground", field="pair", value=names)


def _job(
    name: str,
    survey: Survey,
    heights: HeightModel,
    coverage: Coverage,
    options: RectifyOptions,
    request: Request,
    models: Sequence[StereoModel],
    rotation: float,
    gsd: float,
) -> RectifyJob:
    used = sorted({i for m in models for i in (m.left, m.right) if i >= 0})
    new = {old: k for k, old in enumerate(used)} | {-1: -1}
    renumbered = tuple(replace(m, left=new[m.left], right=new[m.right]) for m in models)
    footprints = [f for i in used if (f := coverage.footprints[i]) is not None]
    grid = _grid(footprints, options, request, rotation, gsd)
    centres = survey.centres_map[used]
    height_range = ground_range(survey.frame, heights, grid)
    law = ParallaxLaw("none", 1.0, 1.0)
    if request.stereo:
        law = _law(options, renumbered, footprints, centres, height_range[0], survey.frame.unit_m)
        _require_below_flight(law, height_range[1])
        renumbered += tuple(StereoModel(k, -1, penalty=_MONO_PENALTY) for k in range(len(used)))
    in_model = map_from_map(heights.frame, survey.frame, centres)
    return RectifyJob(
        name=name,
        frame=survey.frame,
        tangent=survey.tangent,
        photographs=tuple(survey.photographs[i] for i in used),
        reductions=tuple(max(1, math.floor(gsd * survey.frame.unit_m / f.gsd_m + 0.1)) for f in footprints),
        heights=heights,
        centres_in_height_model=np.column_stack([heights.pixel_from_map(in_model[:, :2]), centres[:, 2]]),
        grid=grid,
        models=renumbered,
        law=law,
        height_range=height_range,
        bands=request.bands,
        dtype=np.dtype(request.dtype),
        options=options,
    )


def _grid(
    footprints: Sequence[Footprint], options: RectifyOptions, request: Request, rotation: float, gsd: float
) -> ProductGrid:
    """The grid over the footprints, cut to the bounds and the area asked for."""
    area = shapely.union_all([f.polygon for f in footprints])
    if options.bounds is not None:
        area = area.intersection(shapely.box(*options.bounds))
    if request.area is not None:
        area = area.intersection(request.area)
    if area.is_empty:
        asked = "area" if options.bounds is None else "bounds"
        outline = request.area.bounds if options.bounds is None and request.area else options.bounds
        raise CoverageError("must lie on ground of the photographs", field=f"products.{asked}", value=outline)
    # Bounds that are asked for are kept whole; an area is only covered.
    outline = shapely.box(*options.bounds) if options.bounds is not None and rotation == 0.0 else area
    return ProductGrid.covering(
        shapely.get_coordinates(outline.envelope if rotation == 0.0 else area), gsd, rotation
    )


def ground_range(frame: MapFrame, heights: HeightModel, grid: ProductGrid) -> tuple[float, float]:
    """Lowest and highest ground under a product and around it, in the height system of the law.

    Raises
    ------
    CoverageError
        If there is no height under the product.
    """
    cols, rows = grid.size
    share = np.linspace(-_BEYOND, 1.0 + _BEYOND, 9)
    pixels = np.stack(np.meshgrid(share * cols, share * rows), axis=-1).reshape(-1, 2)
    points = np.column_stack([grid.map_from_pixel(pixels), np.zeros(len(pixels))])
    in_model = map_from_map(heights.frame, frame, points)
    at = heights.pixel_from_map(in_model[:, :2])
    model_rows, model_cols = heights.shape
    col0, row0 = np.clip(np.floor(at.min(axis=0)).astype(int) - 2, 0, (model_cols, model_rows))
    col1, row1 = np.clip(np.ceil(at.max(axis=0)).astype(int) + 2, 0, (model_cols, model_rows))
    low, high = math.inf, -math.inf
    for c0, r0, width, depth in windows((int(row1 - row0), int(col1 - col0))):
        lowest, highest = heights.patch(int(col0) + c0, int(row0) + r0, width, depth).range
        low, high = min(low, lowest), max(high, highest)
    if not low <= high:
        raise CoverageError("has no heights under the photographs", file=heights.path, field="terrain")
    # Heights of both ends in the law's system, wherever the offset is least and largest.
    ends = []
    for height in (low, high):
        there = np.column_stack([in_model[:, :2], np.full(len(in_model), height)])
        ends.append(map_from_map(frame, heights.frame, there)[:, 2])
    return float(ends[0].min()), float(ends[1].max())


def _law(
    options: RectifyOptions,
    models: Sequence[StereoModel],
    footprints: Sequence[Footprint],
    centres: Array,
    lowest: float,
    unit_m: float,
) -> ParallaxLaw:
    """The law with its nominal values: from the options, else from what serves the ground."""
    reference = options.reference_m
    if reference is None:
        reference = math.floor(lowest / REFERENCE_STEP_M) * REFERENCE_STEP_M
    share = serving_share(models, footprints, centres)
    base = options.base_m
    if base is None:
        base = _weighted_median(np.array([m.base_u_m for m in models]) / unit_m, share)
    w0 = options.w0_m
    if w0 is None:
        weight = np.zeros(len(centres))
        for m, s in zip(models, share, strict=True):
            weight[m.left] += s
            weight[m.right] += s
        w0 = _weighted_median(centres[:, 2] - reference, weight)
        if w0 <= 0.0:
            rule = f"must be below the photographs, which are at {w0 + reference:.1f}"
            raise CoverageError(rule, field="products.reference_m", value=reference)
    if options.law_heights_m is not None and options.law_parallaxes_m is not None:
        above = [height - reference for height in options.law_heights_m]
        return ParallaxLaw.from_table(
            above, options.law_parallaxes_m, base_m=base, w0_m=w0, reference_m=reference
        )
    return ParallaxLaw(options.law, base, w0, reference)


def _require_below_flight(law: ParallaxLaw, highest: float) -> None:
    """A logarithmic or natural law ends at its flying height."""
    if not np.isfinite(law.q(highest)):
        above = highest - law.reference_m
        raise CoverageError(
            f"must be more than {above:.1f}, the highest ground above reference_m, for the {law.kind} law",
            field="products.w0_m",
            value=law.w0_m,
            hint='another area, w0_m or reference_m, or law = "linear"',
        )


def serving_share(models: Sequence[StereoModel], footprints: Sequence[Footprint], centres: Array) -> Array:
    """How much ground each model serves, as counts of sample positions (the rule of `rectify.serving`)."""
    area = shapely.union_all([f.polygon for f in footprints])
    x_min, y_min, x_max, y_max = area.bounds
    x, y = np.meshgrid(np.linspace(x_min, x_max, _SAMPLES), np.linspace(y_min, y_max, _SAMPLES))
    at = np.column_stack([x.ravel(), y.ravel()])
    inside = np.array([shapely.contains_xy(f.polygon, at[:, 0], at[:, 1]) for f in footprints])
    ground = np.array([f.ground_m for f in footprints])
    tangent = (
        np.hypot(at[:, 0] - centres[:, :1], at[:, 1] - centres[:, 1:2]) / (centres[:, 2] - ground)[:, None]
    )
    best = np.full(len(at), math.inf)
    winner = np.full(len(at), -1)
    for k, m in enumerate(models):
        score = np.maximum(tangent[m.left], tangent[m.right]) + m.penalty
        better = inside[m.left] & inside[m.right] & (score < best)
        best[better], winner[better] = score[better], k
    share = np.bincount(winner[winner >= 0], minlength=len(models)).astype(np.float64)
    return share if share.any() else np.ones(len(models))


def _weighted_median(values: Array, weights: Array) -> float:
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])
