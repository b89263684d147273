"""Everything a worker needs to rectify any chunk of a product, as a value that can be sent to it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from stereomate.coverage.survey import Photograph
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import map_from_tangent
from stereomate.parallax.laws import ParallaxLaw
from stereomate.rectify.grid import ProductGrid
from stereomate.rectify.layout import StereoModel
from stereomate.rectify.options import RectifyOptions
from stereomate.rectify.radiometry import Balance
from stereomate.rectify.seams import Seams
from stereomate.terrain.model import HeightModel


@dataclass(frozen=True, eq=False)
class RectifyJob:
    """One product of a block: what is to be computed, and from what.

    Attributes
    ----------
    photographs : tuple of Photograph
        Those that serve this product; models and lineage index them (lineage counts from 1).
    reductions : tuple of int
        Per photograph: how many of its pixels are averaged in each direction before resampling.
    centres_in_height_model : (photographs, 3)
        Projection centres as column, row of the height model and height in the law's system: where rays end.
    law : ParallaxLaw
        Of kind "none" for an orthophoto without stereomate.
    height_range : (low, high)
        Lowest and highest ground in the height system of the law.
    seams : Seams or None
        Which model serves which ground, before the rule of `rectify.serving`.
    balance : Balance or None
        What the photographs are multiplied by.
    """

    name: str
    frame: MapFrame
    tangent: TangentFrame
    photographs: tuple[Photograph, ...]
    reductions: tuple[int, ...]
    heights: HeightModel
    centres_in_height_model: NDArray[np.float64]
    grid: ProductGrid
    models: tuple[StereoModel, ...]
    law: ParallaxLaw
    height_range: tuple[float, float]
    bands: tuple[int, ...]
    dtype: np.dtype[np.generic]
    options: RectifyOptions
    seams: Seams | None = None
    balance: Balance | None = None

    @property
    def is_stereo(self) -> bool:
        """Whether a stereomate belongs to the product."""
        return self.law.kind != "none"

    @property
    def centres_tangent(self) -> NDArray[np.float64]:
        """Projection centres in the tangent frame, shape (photographs, 3)."""
        return np.array([p.orientation.centre for p in self.photographs])

    @cached_property
    def centres_map(self) -> NDArray[np.float64]:
        """Projection centres in the map, shape (photographs, 3)."""
        return map_from_tangent(self.tangent, self.frame, self.centres_tangent)
