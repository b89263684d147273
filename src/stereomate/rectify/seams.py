"""Seams of a product as a value: the ground each model serves, as polygons, and how wide seams are mixed.

Everything is in product pixels of the ground (the orthophoto's own); the stereomate asks with the ground
position its pixels show, so the seams of both are one line on the ground.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
import shapely
from numpy.typing import NDArray

from stereomate.raster import Window
from stereomate.rectify.kernels.seam_levels import level_pixels
from stereomate.rectify.kernels.seams import feather_pixels, label_pixels
from stereomate.rectify.scratch import scratch

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Ints = NDArray[np.int64]

# Coordinates are whole multiples of this, exact in binary and in text: seams read back are the same.
GRAIN_PX: Final = 1.0 / 64.0


@dataclass(frozen=True)
class SeamLine:
    """A piece of seam between two models.

    Attributes
    ----------
    models : (int, int)
        Indices of the job's models on both sides.
    points : tuple of (x, y, half width)
        Product pixels; over the half width on each side the photographs of both models are mixed.
    levels : tuple of (reach, logarithms of the left eye by band, of the right eye)
        At each point: how much brighter the second model is there, and over how many pixels on each side both
        are brought together. Empty: they are left as they are.
    """

    models: tuple[int, int]
    points: tuple[tuple[float, float, float], ...]
    levels: tuple[tuple[float, ...], ...] = ()


@dataclass(frozen=True)
class Seams:
    """Which model serves which ground.

    Attributes
    ----------
    polygons : tuple of (int, shapely Polygon)
        Index of the job's model, and the ground it serves wherever its photographs show it. Where no polygon
        lies, or its model cannot serve, the rule of `rectify.serving` decides.
    lines : tuple of SeamLine
        Seams along which photographs are mixed; empty: nowhere.
    """

    polygons: tuple[tuple[int, shapely.Polygon], ...]
    lines: tuple[SeamLine, ...] = ()

    @cached_property
    def _edges(self) -> tuple[Floats, Ints]:
        """Edges (n, 4) of all rings, turned as `label_pixels` takes them, and their models."""
        parts: list[Floats] = []
        labels: list[Ints] = []
        for model, polygon in self.polygons:
            rings = [(polygon.exterior, False), *((ring, True) for ring in polygon.interiors)]
            for ring, is_hole in rings:
                points = np.asarray(ring.coords)[:, :2]
                if ring.is_ccw != is_hole:
                    points = points[::-1]
                edges = np.hstack([points[:-1], points[1:]])
                edges = edges[edges[:, 1] != edges[:, 3]]
                parts.append(edges)
                labels.append(np.full(len(edges), model))
        if not parts:
            return np.empty((0, 4)), np.empty(0, np.int64)
        return np.concatenate(parts), np.concatenate(labels).astype(np.int64)

    @cached_property
    def _segments(self) -> tuple[Floats, Ints]:
        """Segments (n, 6) of the lines that are mixed, and the models on both sides."""
        parts, sides = [], []
        for line in self.lines:
            points = np.asarray(line.points)
            segments = np.hstack([points[:-1], points[1:]])
            segments = segments[np.maximum(segments[:, 2], segments[:, 5]) > 0.0]
            parts.append(segments)
            sides.append(np.tile(line.models, (len(segments), 1)))
        if not parts:
            return np.empty((0, 6)), np.empty((0, 2), np.int64)
        return np.concatenate(parts), np.concatenate(sides).astype(np.int64)

    @cached_property
    def _levels(self) -> tuple[Floats, Ints, Floats]:
        """Segments (n, 6) of levelled lines, models on both sides, logarithms (n, 2, eyes x bands)."""
        parts, sides, values = [], [], []
        for line in self.lines:
            if not line.levels:
                continue
            points, levels = np.asarray(line.points)[:, :2], np.asarray(line.levels)
            ends = np.hstack([points, levels[:, :1]])
            segments = np.hstack([ends[:-1], ends[1:]])
            wanted = np.maximum(segments[:, 2], segments[:, 5]) > 0.0
            parts.append(segments[wanted])
            sides.append(np.tile(line.models, (int(wanted.sum()), 1)))
            values.append(np.stack([levels[:-1, 1:], levels[1:, 1:]], axis=1)[wanted])
        if not parts:
            return np.empty((0, 6)), np.empty((0, 2), np.int64), np.empty((0, 2, 0))
        return np.concatenate(parts), np.concatenate(sides).astype(np.int64), np.concatenate(values)

    @property
    def is_levelled(self) -> bool:
        """Whether brightness is brought together at any seam."""
        return len(self._levels[0]) > 0

    @cached_property
    def _reach(self) -> float:
        """Pixels from a seam to where no pixel is changed by it."""
        widths = [w for line in self.lines for _, _, w in line.points]
        return max(widths + [level[0] for line in self.lines for level in line.levels], default=0.0)

    def labels(self, window: Window, columns: Floats32, out: NDArray[np.int16]) -> None:
        """Model of the polygon under each pixel of a window; -1 for none.

        Parameters
        ----------
        columns : (rows or 1, cols)
            Ground columns relative to the window's first one.
        """
        edges, labels = self._edges
        near = (np.minimum(edges[:, 1], edges[:, 3]) <= window.row1) & (
            np.maximum(edges[:, 1], edges[:, 3]) >= window.row0
        )
        label_pixels(edges[near], labels[near], columns, float(window.col0), float(window.row0), out)

    def only(self, ground: Window) -> int | None:
        """The model whose polygon holds a whole window of ground; None if there is no such one."""
        edges, _ = self._edges
        low, high = np.minimum(edges[:, :2], edges[:, 2:]), np.maximum(edges[:, :2], edges[:, 2:])
        # Beside a seam pixels are changed, also where it runs outside.
        reach = self._reach
        meets = (high[:, 0] >= ground.col0 - reach) & (low[:, 0] <= ground.col1 + reach)
        meets &= (high[:, 1] >= ground.row0 - reach) & (low[:, 1] <= ground.row1 + reach)
        if meets.any():
            return None
        middle = np.array([[0.5 * ground.cols]], np.float32)
        label = np.empty((1, 1), np.int16)
        self.labels(Window(ground.col0, ground.row0 + ground.rows // 2, 1, 1), middle, label)
        found = int(label[0, 0])
        return found if found >= 0 else None

    def feather(
        self,
        window: Window,
        columns: Floats32,
        owner: NDArray[np.int16],
        partner: NDArray[np.int16],
        weight: Floats32,
    ) -> int:
        """Model across the seam and its share for every pixel of a window; returns how many have one."""
        segments, sides = self._segments
        if len(segments) == 0:
            return 0
        reach = np.maximum(segments[:, 2], segments[:, 5])
        near = np.minimum(segments[:, 1], segments[:, 4]) - reach <= window.row1
        near &= np.maximum(segments[:, 1], segments[:, 4]) + reach >= window.row0
        if not near.any():
            return 0
        at = float(window.col0), float(window.row0)
        return int(feather_pixels(segments[near], sides[near], owner, columns, *at, partner, weight))

    def level(
        self, window: Window, columns: Floats32, owner: NDArray[np.int16], eye: int, bands: int
    ) -> Floats32 | None:
        """Logarithms (rows, cols, bands) to add to the brightness of a window's pixels; None for nothing.

        Parameters
        ----------
        owner : (rows, cols)
            Model of the polygon that serves each pixel; -1 where another one does.
        eye : int
            0 for the left photographs, 1 for the right ones.
        """
        segments, sides, values = self._levels
        reach = np.maximum(segments[:, 2], segments[:, 5])
        near = np.minimum(segments[:, 1], segments[:, 4]) - reach <= window.row1
        near &= np.maximum(segments[:, 1], segments[:, 4]) + reach >= window.row0
        if not near.any():
            return None
        own = np.ascontiguousarray(values[near][:, :, eye * bands : (eye + 1) * bands])
        out = scratch("seam level", (*owner.shape, bands), np.float32)
        at = float(window.col0), float(window.row0)
        return out if level_pixels(segments[near], sides[near], own, owner, columns, *at, out) else None


def grained(geometry: Any) -> Any:
    """A geometry with coordinates in whole grains."""
    return shapely.transform(geometry, lambda xy: np.round(xy / GRAIN_PX) * GRAIN_PX)


def seams_record(seams: Seams | None) -> dict[str, Any] | None:
    """Plain values for stereo.json."""
    if seams is None:
        return None
    return {
        "polygons": [
            {"model": model, "pixels": shapely.to_wkt(polygon, rounding_precision=-1)}
            for model, polygon in seams.polygons
        ],
        "mixed": [
            {
                "models": list(line.models),
                "pixels": _wkt_with_widths(line),
                "levels": [list(level) for level in line.levels],
            }
            for line in seams.lines
        ],
    }


def _wkt_with_widths(line: SeamLine) -> str:
    return str(shapely.to_wkt(shapely.LineString(line.points), rounding_precision=-1, output_dimension=3))


def seams_from_record(record: dict[str, Any] | None) -> Seams | None:
    """Inverse of `seams_record`."""
    if record is None:
        return None
    polygons = tuple((int(r["model"]), shapely.from_wkt(r["pixels"])) for r in record["polygons"])
    lines = []
    for r in record["mixed"]:
        points: Sequence[tuple[float, float, float]] = [
            (float(x), float(y), float(w))
            for x, y, w in shapely.get_coordinates(shapely.from_wkt(r["pixels"]), include_z=True)
        ]
        levels = tuple(tuple(map(float, level)) for level in r["levels"])
        lines.append(SeamLine((int(r["models"][0]), int(r["models"][1])), tuple(points), levels))
    return Seams(polygons, tuple(lines))
