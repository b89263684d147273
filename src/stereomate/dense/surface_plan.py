"""What is matched to make the surface of a block: pairs, resolution, cells; no pixel is read for it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.coverage.pairs import Pair
from stereomate.coverage.summary import survey_coverage
from stereomate.coverage.survey import Survey
from stereomate.dense.epipolar import EpipolarPair, epipolar_pair
from stereomate.dense.pair_surface import CellGrid
from stereomate.errors import InputError, NotDeterminedError
from stereomate.frames.transform import map_from_map, tangent_from_map
from stereomate.terrain.model import HeightModel

Array = NDArray[np.float64]

# Base over height above ground: below, heights are weak; above, the photographs look too different.
_BASE_HEIGHT: Final = (0.08, 0.9)
_BEST_BASE_HEIGHT: Final = 0.35
_LEAST_OVERLAP: Final = 0.2
# Nodes along each side of the block where the known ground is sampled.
_NODES: Final = 160
# Ground sampling distances of the epipolar images per cell.
_CELL_PX: Final = 2.0


@dataclass(frozen=True)
class PlanOptions:
    """Resolution and pairs of a surface.

    Attributes
    ----------
    largest_side_px : int
        Photographs are reduced by whole pixels until neither side is longer.
    pairs_per_photo : int
        Models of each photograph, those of good base and overlap first.
    cell : float or None
        Map units; twice the ground sampling distance of the reduced photographs if None.

    Raises
    ------
    InputError
        Naming the field, the rule and the value.
    """

    largest_side_px: int = 2200
    pairs_per_photo: int = 4
    cell: float | None = None

    def __post_init__(self) -> None:
        if self.largest_side_px < 100:
            raise InputError("must be 100 or more", field="largest_side_px", value=self.largest_side_px)
        if self.pairs_per_photo < 1:
            raise InputError("must be 1 or more", field="pairs_per_photo", value=self.pairs_per_photo)
        if self.cell is not None and not (math.isfinite(self.cell) and self.cell > 0.0):
            raise InputError("must be positive", field="cell", value=self.cell)


@dataclass(frozen=True, eq=False)
class SurfacePlan:
    """Pairs to match and the grid of the surface.

    Attributes
    ----------
    survey : Survey
    pairs : tuple of EpipolarPair
    grid : CellGrid
    reduction : int
    ground : ndarray, shape (n, 3)
        Points of the ground as known beforehand, tangent frame.
    """

    survey: Survey
    pairs: tuple[EpipolarPair, ...]
    grid: CellGrid
    reduction: int
    ground: Array


def plan_surface(survey: Survey, model: HeightModel, options: PlanOptions | None = None) -> SurfacePlan:
    """Plan the surface of a block.

    Parameters
    ----------
    survey : Survey
    model : HeightModel
        The ground as known beforehand, to a tenth of the flying height.
    options : PlanOptions, optional

    Raises
    ------
    NotDeterminedError
        If no two photographs show common ground from different places.
    CoverageError
        If nothing is known of the ground below the photographs.
    """
    options = options or PlanOptions()
    coverage = survey_coverage(survey, model)
    chosen = choose_models(coverage.pairs, options.pairs_per_photo)
    side = max(max(photo.camera.size_px) for photo in survey.photographs)
    reduction = max(1, math.ceil(side / options.largest_side_px))
    ground = known_ground(survey, model, np.array([f.polygon.bounds for f in coverage.known]))
    pairs = []
    for pair in chosen:
        first, second = (survey.photographs[k] for k in (pair.first, pair.second))
        found = epipolar_pair(first, second, ground, reduction)
        if found is not None:
            pairs.append(found)
    if not pairs:
        raise NotDeterminedError("surface: no two photographs show common ground from different places")
    gsd = float(np.median([f.gsd_m for f in coverage.known])) / survey.frame.unit_m
    cell = options.cell or _rounded(_CELL_PX * reduction * gsd)
    bounds = np.array([f.polygon.bounds for f in coverage.known])
    west, south = np.floor(bounds[:, :2].min(axis=0) / cell) * cell
    east, north = np.ceil(bounds[:, 2:].max(axis=0) / cell) * cell
    size = round((east - west) / cell), round((north - south) / cell)
    grid = CellGrid(float(west), float(north), cell, size)
    return SurfacePlan(survey, tuple(pairs), grid, reduction, ground)


def choose_models(pairs: Sequence[Pair], per_photo: int) -> list[Pair]:
    """The models of every photograph that serve its surface best, in the order of the survey."""
    low, high = _BASE_HEIGHT
    usable = [p for p in pairs if low <= p.base_height <= high and p.overlap >= _LEAST_OVERLAP]
    ranked = sorted(usable, key=lambda p: (-_merit(p), p.first, p.second))
    taken: dict[int, int] = {}
    chosen = set()
    for pair in ranked:
        ends = pair.first, pair.second
        if any(taken.get(k, 0) < per_photo for k in ends):
            chosen.add(ends)
            for k in ends:
                taken[k] = taken.get(k, 0) + 1
    return [p for p in usable if (p.first, p.second) in chosen]


def _merit(pair: Pair) -> float:
    """Common ground, less for bases far from the one that is neither weak nor too different."""
    return pair.overlap * math.exp(-abs(math.log(pair.base_height / _BEST_BASE_HEIGHT)))


def known_ground(survey: Survey, model: HeightModel, bounds: Array) -> Array:
    """Points of a height model over map bounds (n, 4) of the survey, in the tangent frame."""
    west, south = bounds[:, :2].min(axis=0)
    east, north = bounds[:, 2:].max(axis=0)
    xy = np.stack(np.meshgrid(np.linspace(west, east, _NODES), np.linspace(south, north, _NODES)), axis=-1)
    flat = np.column_stack([xy.reshape(-1, 2), np.zeros(_NODES * _NODES)])
    place = map_from_map(model.frame, survey.frame, flat)
    place[:, 2] = model.heights_at(place[:, :2])
    return tangent_from_map(survey.tangent, model.frame, place[np.isfinite(place[:, 2])])


def _rounded(value: float) -> float:
    """To two digits: a cell that people can read."""
    step: float = 10.0 ** (math.floor(math.log10(value)) - 1)
    digits = max(0, 1 - math.floor(math.log10(value)))
    return round(round(value / step) * step, digits)
