"""Height models: a raster of heights in its own CRS and height system, read by windows."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import CoverageError, CrsError, HeightSystemError, ImageError
from stereomate.frames.crs import parse
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import tangent_from_map
from stereomate.raster import open_heights
from stereomate.terrain.patch import Interpolation, SurfacePatch, sampler
from stereomate.terrain.source import ArraySource, FileSource, HeightSource, metres_per_unit

Floats = NDArray[np.float64]
Affine6 = tuple[float, float, float, float, float, float]

# Windows of a pass over the whole model and of scattered sampling: 8 MB of heights.
_BLOCK = 1024
# Nodes around a window that bicubic interpolation needs.
_APRON = 2


@dataclass(frozen=True, eq=False)
class HeightModel:
    """A height model, opened once, read by windows, larger than memory. Pickles as path and metadata.

    Attributes
    ----------
    source : HeightSource
        Where the heights come from.
    frame : MapFrame
        The model's own CRS and height system. Heights are in metres; those of a vertical CRS in its unit.
    affine : tuple of 6 floats
        (a, b, c, d, e, f): x = a col + b row + c, y = d col + e row + f, pixel to map of its own CRS.
    path : Path or None
        The file, if there is one.
    """

    source: HeightSource
    frame: MapFrame
    affine: Affine6
    path: Path | None = None

    def __post_init__(self) -> None:
        a, b, _, d, e, _ = self.affine
        if not all(map(math.isfinite, self.affine)) or a * e - b * d == 0.0:
            raise ImageError(
                "must have an invertible geotransform", file=self.path, field="transform", value=self.affine
            )

    @classmethod
    def open(
        cls,
        path: str | Path,
        heights: HeightSystem,
        *,
        crs: str | None = None,
        unit: str | None = None,
        nodata: float | None = None,
    ) -> HeightModel:
        """Open a single-band raster as a height model.

        Parameters
        ----------
        path : path
        heights : HeightSystem
            What its heights mean. A vertical CRS inside the file is not applied (``frame.vertical_name``).
        crs : str, optional
            Its CRS where the file states none, or a wrong one.
        unit : str, optional
            Unit of the stored heights ("metre", "foot", "us-survey-foot") where the file states none, or a
            wrong one. Without either, metres, or the unit of the vertical CRS.
        nodata : float, optional
            A value that means void besides what the file declares.

        Raises
        ------
        ImageError
            If the file is missing, damaged, has several bands, or no geotransform.
        CrsError
            If it states no CRS and none is given.
        HeightSystemError
            If its unit is unknown.
        """
        path = Path(path)
        with open_heights(path) as reader:
            info, written = reader.info, reader.scale.units
        if info.transform is None:
            raise ImageError("must have a geotransform to be a height model", file=path)
        text = crs or info.crs_wkt
        if not text:
            raise CrsError("states no CRS", file=path, hint="say it with terrain.crs")
        wanted = height_unit_m(heights)
        unit = unit or written
        factor = metres_per_unit(unit, file=path) / wanted if unit else 1.0
        return cls(FileSource(path, nodata, factor), MapFrame(text, heights), info.transform, path)

    @classmethod
    def from_array(cls, heights: ArrayLike, affine: Affine6, frame: MapFrame) -> HeightModel:
        """A height model in memory: (rows, cols), NaN = void, heights in the frame's height system."""
        array = np.array(heights, np.float64)
        if array.ndim != 2 or array.size == 0:
            raise ImageError("heights must be an array (rows, cols)", value=array.shape)
        array.flags.writeable = False
        return cls(ArraySource(array), frame, affine)

    @property
    def name(self) -> str:
        """The file, or what stands for it in messages."""
        return str(self.path) if self.path is not None else "height model in memory"

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        cols, rows = self.source.size
        return rows, cols

    @property
    def content_hash(self) -> str:
        """SHA-256 of the file, hexadecimal (of the heights where there is no file)."""
        return self.source.content_hash

    @cached_property
    def cell_size_m(self) -> tuple[float, float]:
        """Width and height of the pixel in the middle of the model, in metres on the ground."""
        rows, cols = self.shape
        middle = np.array([cols / 2, rows / 2])
        corners = self.map_from_pixel(middle + np.array([(0, 0), (1, 0), (0, 1)]))
        frame = MapFrame(self.frame.crs, HeightSystem.ellipsoidal())
        points = np.column_stack([corners, np.zeros(3)])
        local = tangent_from_map(TangentFrame.at_map(frame, points[0]), frame, points)
        return float(np.linalg.norm(local[1] - local[0])), float(np.linalg.norm(local[2] - local[0]))

    @property
    def resolution_m(self) -> float:
        """Ground size of a pixel: the shorter side."""
        return min(self.cell_size_m)

    @property
    def outline(self) -> Floats:
        """Corners of the raster in its own CRS, (4, 2), counter-clockwise in pixel space."""
        rows, cols = self.shape
        return self.map_from_pixel([(0, 0), (0, rows), (cols, rows), (cols, 0)])

    def map_from_pixel(self, pixels: ArrayLike) -> Floats:
        """Map positions (..., 2) in the model's CRS of pixel coordinates (..., 2) as (col, row)."""
        col, row = np.moveaxis(np.asarray(pixels, np.float64), -1, 0)
        a, b, c, d, e, f = self.affine
        return np.stack([a * col + b * row + c, d * col + e * row + f], axis=-1)

    def pixel_from_map(self, xy: ArrayLike) -> Floats:
        """Pixel coordinates (..., 2) as (col, row) of map positions (..., 2) in the model's CRS."""
        a, b, c, d, e, f = self.affine
        x, y = np.moveaxis(np.asarray(xy, np.float64), -1, 0)
        x, y = x - c, y - f
        determinant = a * e - b * d
        return np.stack([(e * x - b * y) / determinant, (a * y - d * x) / determinant], axis=-1)

    def patch(self, col0: int, row0: int, cols: int, rows: int) -> SurfacePatch:
        """Heights of a window; outside the model NaN.

        Raises
        ------
        ImageError
            If the file is damaged there.
        """
        heights = np.full((max(rows, 0), max(cols, 0)), np.nan)
        model_rows, model_cols = self.shape
        left, top = max(col0, 0), max(row0, 0)
        right, bottom = min(col0 + cols, model_cols), min(row0 + rows, model_rows)
        if right > left and bottom > top:
            inside = self.source.read(left, top, right - left, bottom - top)
            heights[top - row0 : bottom - row0, left - col0 : right - col0] = inside
        return SurfacePatch(heights, col0, row0)

    def heights_at(self, xy: ArrayLike, method: Interpolation = "bilinear") -> Floats:
        """Heights (...) at map positions (..., 2) in the model's CRS; NaN outside and at voids.

        Reads block by block: memory does not grow with the spread of the points.
        """
        pixels = self.pixel_from_map(xy)
        return sample_blockwise(self, pixels.reshape(-1, 2), method).reshape(pixels.shape[:-1])

    @cached_property
    def range(self) -> tuple[float, float]:
        """Lowest and highest height, from a pass over the whole model by windows.

        Raises
        ------
        CoverageError
            If there is no height at all.
        """
        rows, cols = self.shape
        low, high = self.range_around(0, 0, cols, rows)
        if not low <= high:
            raise CoverageError("must hold heights: all of it is nodata", file=self.path or self.name)
        return low, high

    def range_around(self, col0: int, row0: int, cols: int, rows: int) -> tuple[float, float]:
        """Lowest and highest height of the blocks that a window touches; (inf, -inf) where all is void.

        A bound for the window, not its own range. Each block is read once and remembered, so that a survey
        reads only the part of a large model that it flies over.
        """
        model_rows, model_cols = self.shape
        low, high = math.inf, -math.inf
        for i in range(max(row0, 0) // _BLOCK, -(-min(row0 + rows, model_rows) // _BLOCK)):
            for j in range(max(col0, 0) // _BLOCK, -(-min(col0 + cols, model_cols) // _BLOCK)):
                if (i, j) not in self._block_ranges:
                    block = self.patch(j * _BLOCK, i * _BLOCK, _BLOCK, _BLOCK)
                    self._block_ranges[i, j] = block.range
                lowest, highest = self._block_ranges[i, j]
                low, high = min(low, lowest), max(high, highest)
        return low, high

    @cached_property
    def _block_ranges(self) -> dict[tuple[int, int], tuple[float, float]]:
        return {}

    @property
    def min(self) -> float:
        """Lowest height."""
        return self.range[0]

    @property
    def max(self) -> float:
        """Highest height."""
        return self.range[1]


def windows(shape: tuple[int, int], block: int = _BLOCK) -> Iterator[tuple[int, int, int, int]]:
    """Windows (col0, row0, cols, rows) that cover a raster (rows, cols) once."""
    rows, cols = shape
    for row0 in range(0, rows, block):
        for col0 in range(0, cols, block):
            yield col0, row0, min(block, cols - col0), min(block, rows - row0)


def sample_blockwise(model: HeightModel, pixels: Floats, method: Interpolation) -> Floats:
    """Heights (n,) at pixel coordinates (n, 2), with one block of the model in memory at a time."""
    function = sampler(method)
    out = np.full(len(pixels), np.nan)
    rows, cols = model.shape
    inside = np.flatnonzero(((pixels >= 0.0) & (pixels <= (cols, rows))).all(axis=1))
    if inside.size == 0:
        return out
    col = np.minimum(pixels[inside, 0], cols - 1).astype(np.int64) // _BLOCK
    row = np.minimum(pixels[inside, 1], rows - 1).astype(np.int64) // _BLOCK
    key = row * (cols // _BLOCK + 1) + col
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    for members in np.split(inside[order], starts[1:]):
        col0, row0 = np.floor(pixels[members].min(axis=0)).astype(int) - _APRON
        col1, row1 = np.floor(pixels[members].max(axis=0)).astype(int) + _APRON + 1
        patch = model.patch(int(col0), int(row0), int(col1 - col0), int(row1 - row0)).heights
        values = np.empty(members.size)
        function(patch, pixels[members, 0] - col0, pixels[members, 1] - row0, values)
        out[members] = values
    return out


def height_unit_m(heights: HeightSystem) -> float:
    """Metres per unit of the heights that a height system takes."""
    if heights.kind != "vertical_crs":
        return heights.unit_m
    axis = parse(heights.reference).axis_info[0]
    if axis.direction.lower() != "up":
        raise HeightSystemError(
            "must count heights upwards", field="heights", value=f"{heights.reference} ({axis.direction})"
        )
    return float(axis.unit_conversion_factor)
