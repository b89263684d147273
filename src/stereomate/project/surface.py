"""The height model of a project, its break-lines, and the areas its products shall cover."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray

from stereomate.errors import FormatError, InputError
from stereomate.formats.vector import Feature, FeatureFile, read_features
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.transform import map_from_map
from stereomate.project.model import Sheet
from stereomate.project.orientations import Reading, height_system, named
from stereomate.project.schema import ProjectFile
from stereomate.terrain.breaklines import BurnedSurface, SurfaceFeature
from stereomate.terrain.model import HeightModel

Array = NDArray[np.float64]

# Level ground reaches this many flying heights beyond the outermost centres.
_FLYING_HEIGHTS = 10.0


def open_terrain(
    file: ProjectFile, reading: Reading, centres: Array, frame: MapFrame, notes: list[str]
) -> HeightModel | None:
    """The height model, or None where the project has none.

    Parameters
    ----------
    centres : ndarray (n, 3)
        Projection centres in the map of the project: level ground reaches around them.

    Raises
    ------
    ImageError, CrsError, HeightSystemError, CoverageError
        If it cannot serve.
    """
    section = file.terrain
    if section is None:
        return None
    if section.level is not None or section.file is None:
        level = section.level or 0.0
        notes.append(f"the ground is taken as level at {level:g}")
        return _level_ground(level, centres, frame)
    heights = height_system(section.heights, reading.heights, reading, "terrain.heights")
    model = HeightModel.open(
        reading.folder / section.file,
        heights,
        crs=section.crs,
        unit=section.unit,
        nodata=section.nodata,
    )
    notes.append(f"height model: {model.name}, {model.frame.name}, {heights.description}")
    return model


def _level_ground(level: float, centres: Array, frame: MapFrame) -> HeightModel:
    above = float(np.max(centres[:, 2] - level))
    margin = max(_FLYING_HEIGHTS * above, 100.0) / frame.unit_m
    low, high = centres[:, :2].min(axis=0) - margin, centres[:, :2].max(axis=0) + margin
    nodes = 16
    step = (high - low) / nodes
    affine = (float(step[0]), 0.0, float(low[0]), 0.0, -float(step[1]), float(high[1]))
    return HeightModel.from_array(np.full((nodes, nodes), level), affine, frame)


def with_breaklines(model: HeightModel, file: ProjectFile, reading: Reading, notes: list[str]) -> HeightModel:
    """The height model with the project's break-lines and bridges burned in.

    Attributes of a feature: ``height`` (one height for all of it, else the z of its vertices), ``rule``
    (replace, raise, lower) and ``width`` of a line in map units.
    """
    name = file.products.breaklines
    if name is None:
        return model
    source = read_features(reading.folder / name)
    frame = _frame_of(source, model.frame)
    features = [_surface_feature(feature, frame, model.frame, source.path) for feature in source.features]
    notes.append(f"{len(features)} break-lines or bridges of {source.path.name} are burned into the surface")
    return BurnedSurface.of(model, features)


def read_area(file: ProjectFile, reading: Reading, frame: MapFrame) -> shapely.Geometry | None:
    """Area of interest in the map of the project: the union of the polygons of a file."""
    name = file.products.area
    if name is None:
        return None
    return shapely.union_all([sheet.geometry for sheet in _polygons(reading.folder / name, frame)])


def read_water(file: ProjectFile, reading: Reading, frame: MapFrame) -> shapely.Geometry | None:
    """Water in the map of the project: the union of the polygons of a file."""
    name = None if file.terrain is None else file.terrain.water
    if name is None:
        return None
    return shapely.union_all([part for _, _, part in _plain_polygons(reading.folder / name, frame)])


def read_sheets(file: ProjectFile, reading: Reading, frame: MapFrame) -> tuple[Sheet, ...]:
    """Map sheets: one product for each polygon, named by its attribute ``name`` or its number."""
    name = file.products.sheets
    if name is None:
        return ()
    sheets = _polygons(reading.folder / name, frame)
    if len({sheet.name for sheet in sheets}) < len(sheets):
        raise FormatError("must name each sheet differently", file=reading.folder / name, field="name")
    return tuple(sheets)


def _polygons(path: Path, frame: MapFrame) -> list[Sheet]:
    sheets = []
    for number, feature, geometry in _plain_polygons(path, frame):
        label = feature.attributes.get("name")
        if label is not None and not re.fullmatch(r"[\w][\w.-]*", str(label)):
            rule = "must be letters, digits, _, - and .: it becomes part of a file name"
            raise FormatError(rule, file=path, field=f"feature {number}.name", value=label)
        sheets.append(Sheet(f"sheet_{number}" if label is None else str(label), geometry))
    return sheets


def _plain_polygons(path: Path, frame: MapFrame) -> Iterator[tuple[int, Feature, shapely.Geometry]]:
    """Number, feature and plan geometry in another frame of the polygons of a file."""
    source = read_features(path)
    own = _frame_of(source, frame)
    for number, feature in enumerate(source.features, 1):
        if feature.geometry.geom_type != "Polygon":
            rule = "must hold polygons only"
            raise FormatError(rule, file=path, field=f"feature {number}", value=feature.geometry.geom_type)
        yield number, feature, _in_frame(shapely.force_2d(feature.geometry), own, frame)


def _frame_of(source: FeatureFile, default: MapFrame) -> MapFrame:
    return MapFrame(source.crs or default.crs, HeightSystem.ellipsoidal())


def _in_frame(geometry: shapely.Geometry, own: MapFrame, target: MapFrame) -> shapely.Geometry:
    """The geometry in another CRS; heights stay as they are written."""
    if own.crs == target.crs:
        return geometry
    plain = MapFrame(target.crs, HeightSystem.ellipsoidal())

    def moved(points: Array) -> Array:
        flat = np.column_stack([points[:, :2], np.zeros(len(points))])
        return np.column_stack([map_from_map(plain, own, flat)[:, :2], points[:, 2:]])

    return shapely.transform(geometry, moved, include_z=bool(geometry.has_z))


def _surface_feature(feature: Feature, own: MapFrame, target: MapFrame, path: Path) -> SurfaceFeature:
    attributes = feature.attributes
    height, width = attributes.get("height"), attributes.get("width")
    try:
        return SurfaceFeature(
            _in_frame(feature.geometry, own, target),
            attributes.get("rule") or "replace",
            None if height is None else float(height),
            None if width is None else float(width),
        )
    except InputError as error:
        raise named(error, path, error.field or "feature") from error
    except (TypeError, ValueError) as error:
        raise FormatError("height and width must be numbers", file=path, field="feature") from error
