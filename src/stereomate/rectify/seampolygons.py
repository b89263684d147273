"""From regions of cells to seams: polygons in product pixels, and how wide the photographs are mixed."""

from __future__ import annotations

import itertools
from typing import Final

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray

from stereomate.raster import Window
from stereomate.rectify.arcs import seam_arcs
from stereomate.rectify.disagreement import disagreement
from stereomate.rectify.layout import StereoModel
from stereomate.rectify.overviews import Overviews
from stereomate.rectify.seam_levels import level_reaches, seam_levels
from stereomate.rectify.seams import GRAIN_PX, SeamLine, Seams, grained

Floats = NDArray[np.float64]
Labels = NDArray[np.int32]
Polygons = tuple[tuple[int, shapely.Polygon], ...]

# Stairs of cells become lines that stay within about this many cells.
_TOLERANCE_CELLS: Final = 1.5
# Points along a seam at which the width of mixing is asked, cells.
_SPACING_CELLS: Final = 4.0
# Cells around the windows in which widths are asked.
_PAD: Final = 4


def region_polygons(label: Labels, factor: int, size: tuple[int, int]) -> Polygons:
    """Polygons of the regions in product pixels; together they cover the product without overlap.

    Parameters
    ----------
    label : (rows, cols)
        A model in every cell.
    factor : int
        Product pixels along the side of a cell.
    size : (int, int)
        Columns and rows of the product.
    """
    rows, cols = label.shape
    border = shapely.box(0, 0, cols, rows).exterior
    lines = [border, *(shapely.LineString(arc.vertices) for arc in seam_arcs(label))]
    cells = shapely.get_parts(shapely.polygonize([shapely.node(shapely.multilinestrings(_open(lines)))]))
    # Before lines are simplified: a small region may then lie beside its own cells.
    inside = shapely.get_coordinates(shapely.point_on_surface(cells)).astype(np.int64)
    models = label[inside[:, 1], inside[:, 0]].tolist()
    # The border stays as it is, or a seam that ends near a corner would cut it off.
    cells = shapely.coverage_simplify(cells, _TOLERANCE_CELLS, simplify_boundary=False)
    product = shapely.box(0, 0, *size)
    found = []
    for cell, model in zip(cells, models, strict=True):
        scaled = grained(shapely.transform(cell, lambda xy: xy * factor))
        for part in shapely.get_parts(shapely.intersection(scaled, product)):
            if isinstance(part, shapely.Polygon) and part.area > 0.0:
                found.append((model, grained(shapely.normalize(part))))
    return tuple(sorted(found, key=lambda item: (item[0], *item[1].bounds)))


def _open(lines: list[shapely.LineString]) -> list[shapely.LineString]:
    """Rings as line strings: collections of one kind are noded at once."""
    return [shapely.LineString(line.coords) for line in lines]


def shared_edges(polygons: Polygons) -> list[tuple[tuple[int, int], shapely.LineString]]:
    """Lines that two polygons of different models have in common, vertex by vertex."""
    sides: dict[tuple[tuple[float, float], tuple[float, float]], list[int]] = {}
    for model, polygon in polygons:
        for ring in (polygon.exterior, *polygon.interiors):
            points = [(x, y) for x, y in ring.coords]
            for a, b in itertools.pairwise(points):
                sides.setdefault((min(a, b), max(a, b)), []).append(model)
    between: dict[tuple[int, int], list[shapely.LineString]] = {}
    for ends, models in sides.items():
        if len(models) == 2 and models[0] != models[1]:
            between.setdefault((min(models), max(models)), []).append(shapely.LineString(ends))
    found = []
    for pair in sorted(between):
        merged = shapely.line_merge(shapely.MultiLineString(between[pair]))
        found += [(pair, line) for line in shapely.get_parts(shapely.normalize(merged))]
    return found


def finished_seams(
    overviews: Overviews,
    models: tuple[StereoModel, ...],
    polygons: Polygons,
    half_width_px: float,
    scale: float,
    is_levelled: bool,
) -> Seams:
    """Seams of polygons, mixed over at most `half_width_px` on each side, on open ground alone, and levelled.

    The half width ends before the nearest place where the two models differ in colour or parallax, and goes
    to 0 at junctions.
    """
    shared = shared_edges(polygons) if half_width_px > 0.0 or is_levelled else []
    chains = [_points(line, overviews.factor) for _, line in shared]
    reaches = level_reaches(chains, overviews.factor)
    lines = []
    for (pair, line), points, reach in zip(shared, chains, reaches, strict=True):
        both = models[pair[0]], models[pair[1]]
        room = _room(overviews, both, points, scale)
        steps = np.hypot(*np.diff(points, axis=0).T)
        along = np.concatenate([[0.0], np.cumsum(steps)])
        if not line.is_closed:
            room = np.minimum(room, np.minimum(along, along[-1] - along))
        width = np.floor(np.clip(room, 0.0, half_width_px) / GRAIN_PX) * GRAIN_PX
        levels: tuple[tuple[float, ...], ...] = ()
        if is_levelled:
            logs = np.round(seam_levels(overviews, both, points).reshape(len(points), -1), 4)
            wide = np.floor(reach / GRAIN_PX) * GRAIN_PX
            levels = tuple(map(tuple, np.column_stack([wide, logs]).tolist()))
        if is_levelled or (width > 0.0).any():
            triples = np.column_stack([points, width]).tolist()
            lines.append(SeamLine(pair, tuple((x, y, w) for x, y, w in triples), levels))
    return Seams(polygons, tuple(lines))


def _points(line: shapely.LineString, factor: int) -> Floats:
    """Points (n, 2) along a seam, in whole grains."""
    points = shapely.get_coordinates(shapely.segmentize(line, _SPACING_CELLS * factor))
    return np.asarray(np.round(points / GRAIN_PX) * GRAIN_PX)


def _room(
    overviews: Overviews, models: tuple[StereoModel, StereoModel], points: Floats, scale: float
) -> Floats:
    """Distance (n,) in product pixels from points to the nearest place where two models do not agree."""
    rows, cols = overviews.shape
    cells = points / overviews.factor
    col0, row0 = np.maximum(np.floor(cells.min(axis=0)).astype(int) - _PAD, 0).tolist()
    col1, row1 = np.minimum(np.ceil(cells.max(axis=0)).astype(int) + _PAD, (cols, rows)).tolist()
    agrees = disagreement(overviews, *models, Window(col0, row0, col1 - col0, row1 - row0), scale).agrees
    # The border of the window counts as agreeing: what lies beyond is further than the pad.
    distance = cv2.distanceTransform(np.pad(agrees.astype(np.uint8), 1, constant_values=1), cv2.DIST_L2, 5)
    distance = distance[1:-1, 1:-1]
    row = np.clip(np.floor(cells[:, 1]).astype(int) - row0, 0, agrees.shape[0] - 1)
    col = np.clip(np.floor(cells[:, 0]).astype(int) - col0, 0, agrees.shape[1] - 1)
    # from the middle of a cell to the edge of the other: one cell less
    room = np.clip(distance[row, col].astype(np.float64) - 1.0, 0.0, max(agrees.shape))
    return np.asarray(room * overviews.factor)
