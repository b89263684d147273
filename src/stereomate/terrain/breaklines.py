"""Bridges, walls and break-lines burned into a height model.

A height model on a grid has no bridge deck, and rounds a retaining wall. Features with heights replace the
nodes they cover, so that the orthophoto and the stereomate are made from the corrected surface; between a
burned node and its neighbour the surface runs as it always does, within one cell.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

import numpy as np
import shapely
from numpy.typing import NDArray

from stereomate.errors import InputError
from stereomate.terrain.model import HeightModel
from stereomate.terrain.patch import SurfacePatch

Floats = NDArray[np.float64]
Rule = Literal["replace", "raise", "lower"]


@dataclass(frozen=True)
class SurfaceFeature:
    """A polygon or line with heights that becomes part of the surface.

    Attributes
    ----------
    geometry : shapely Polygon or LineString
        In the CRS and the height system of the height model. Polygons without z need ``height``.
    rule : {"replace", "raise", "lower"}
        Whether the surface takes the feature's height everywhere, only where it is higher, or only where it
        is lower. Voids are filled in any case.
    height : float, optional
        One height for all of it.
    width : float, optional
        Of a line, in map units; one cell if absent.

    Raises
    ------
    InputError
        If the geometry is of another kind, invalid, or has no heights.
    """

    geometry: shapely.Geometry
    rule: Rule = "replace"
    height: float | None = None
    width: float | None = None

    def __post_init__(self) -> None:
        kind = self.geometry.geom_type
        if kind not in ("Polygon", "LineString"):
            raise InputError("must be a polygon or a line", field="feature", value=kind)
        if self.rule not in get_args(Rule):
            raise InputError(
                f"must be one of {', '.join(get_args(Rule))}", field="feature.rule", value=self.rule
            )
        if self.geometry.is_empty or not self.geometry.is_valid:
            reason = shapely.is_valid_reason(self.geometry)
            raise InputError("must be a valid geometry", field="feature", value=reason)
        if self.height is None:
            z = shapely.get_coordinates(self.geometry, include_z=True)[:, 2]
            if not np.isfinite(z).all():
                raise InputError("must have a height at every vertex, or one height", field="feature")
        elif not np.isfinite(self.height):
            raise InputError("must be a finite number", field="feature.height", value=self.height)
        if self.width is not None and not self.width > 0.0:
            raise InputError("must be positive", field="feature.width", value=self.width)

    def outline(self, cell: float) -> shapely.Geometry:
        """The area whose nodes it covers, for cells of a given size in map units."""
        if self.geometry.geom_type == "Polygon":
            return self.geometry
        return self.geometry.buffer(0.5 * (self.width or cell), cap_style="flat")

    def heights_at(self, x: Floats, y: Floats) -> Floats:
        """Its heights at points inside it: linear between the vertices."""
        if self.height is not None:
            return np.full(x.shape, self.height)
        if self.geometry.geom_type == "LineString":
            return _heights_along(self.geometry, x, y)
        # Half of the time a command takes to start would be this import, for features that few projects have.
        from scipy.interpolate import LinearNDInterpolator

        vertices = shapely.get_coordinates(self.geometry, include_z=True)
        middle = vertices[:, :2].mean(axis=0)
        interpolate = LinearNDInterpolator(vertices[:, :2] - middle, vertices[:, 2])
        return np.asarray(interpolate(x - middle[0], y - middle[1]), np.float64)


@dataclass(frozen=True, eq=False)
class BurnedSurface(HeightModel):
    """A height model with features burned in, in their order; otherwise used like any other."""

    features: tuple[SurfaceFeature, ...] = ()

    @classmethod
    def of(cls, model: HeightModel, features: Iterable[SurfaceFeature]) -> BurnedSurface:
        """The surface of a model with features."""
        return cls(model.source, model.frame, model.affine, model.path, tuple(features))

    @property
    def content_hash(self) -> str:
        """SHA-256 of the model's hash and the features."""
        digest = hashlib.sha256(self.source.content_hash.encode())
        for feature in self.features:
            digest.update(shapely.to_wkb(feature.geometry, output_dimension=3, byte_order=1))
            digest.update(repr((feature.rule, feature.height, feature.width)).encode())
        return digest.hexdigest()

    def patch(self, col0: int, row0: int, cols: int, rows: int) -> SurfacePatch:
        """Heights of a window with the features burned in; outside the model NaN."""
        patch = super().patch(col0, row0, cols, rows)
        for feature, outline in zip(self.features, self._outlines, strict=True):
            self._burn(patch, feature, outline)
        return patch

    @cached_property
    def _outlines(self) -> tuple[shapely.Geometry, ...]:
        a, b, _, d, e, _ = self.affine
        cell = min(float(np.hypot(a, d)), float(np.hypot(b, e)))
        outlines = tuple(feature.outline(cell) for feature in self.features)
        shapely.prepare(list(outlines))
        return outlines

    def _burn(self, patch: SurfacePatch, feature: SurfaceFeature, outline: shapely.Geometry) -> None:
        x0, y0, x1, y1 = outline.bounds
        corners = self.pixel_from_map([(x0, y0), (x0, y1), (x1, y0), (x1, y1)])
        model_rows, model_cols = self.shape
        first = np.maximum(np.floor(corners.min(axis=0)), (max(patch.col0, 0), max(patch.row0, 0)))
        rows, cols = patch.heights.shape
        end = (min(patch.col0 + cols, model_cols), min(patch.row0 + rows, model_rows))
        last = np.minimum(np.ceil(corners.max(axis=0)), end)
        if not (first < last).all():
            return
        row, col = np.mgrid[int(first[1]) : int(last[1]), int(first[0]) : int(last[0])]
        xy = self.map_from_pixel(np.stack([col + 0.5, row + 0.5], axis=-1))
        covered = shapely.contains_xy(outline, xy[..., 0], xy[..., 1])
        if not covered.any():
            return
        new = feature.heights_at(xy[covered][:, 0], xy[covered][:, 1])
        place = (row[covered] - patch.row0, col[covered] - patch.col0)
        old = patch.heights[place]
        if feature.rule == "raise":
            new = np.fmax(old, new)
        elif feature.rule == "lower":
            new = np.fmin(old, new)
        patch.heights[place] = np.where(np.isnan(new), old, new)


def _heights_along(line: shapely.Geometry, x: Floats, y: Floats) -> Floats:
    vertices = shapely.get_coordinates(line, include_z=True)
    lengths = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(vertices[:, :2], axis=0).T))])
    along = shapely.line_locate_point(line, shapely.points(x, y))
    return np.asarray(np.interp(along, lengths, vertices[:, 2]), np.float64)
