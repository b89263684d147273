"""Polygons and lines of any vector format GDAL reads: GeoPackage, GeoJSON, Shapefile."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from stereomate.errors import FormatError


@dataclass(frozen=True)
class Feature:
    """A geometry in the CRS of its file, and its attributes."""

    geometry: shapely.Geometry
    attributes: Mapping[str, Any]


@dataclass(frozen=True)
class FeatureFile:
    """The first layer of a vector file. `crs` is empty where the file states none."""

    path: Path
    crs: str
    features: tuple[Feature, ...]


def read_features(path: Path) -> FeatureFile:
    """Read all features with a geometry of the first layer; multi-part geometries are taken apart.

    Raises
    ------
    FormatError
        If the file is missing, no vector file, or holds no geometry.
    """
    # Most projects have no such file: their runs start without this library.
    import pyogrio
    from pyogrio.errors import DataSourceError

    if not path.is_file():
        raise FormatError("does not exist", file=path)
    try:
        meta, _, geometries, columns = pyogrio.raw.read(path)
    except DataSourceError as error:
        raise FormatError(f"must be a vector file: {error}", file=path) from error
    names = [str(name) for name in meta["fields"]]
    features = []
    for index, geometry in enumerate(shapely.from_wkb(geometries)):
        if geometry is None or geometry.is_empty:
            continue
        values = {name: _plain(column[index]) for name, column in zip(names, columns, strict=True)}
        features += [Feature(part, values) for part in getattr(geometry, "geoms", [geometry])]
    if not features:
        raise FormatError("holds no geometry", file=path)
    return FeatureFile(path, meta["crs"] or "", tuple(features))


def _plain(value: Any) -> Any:
    value = value.item() if isinstance(value, np.generic) else value
    return None if isinstance(value, float) and np.isnan(value) else value
