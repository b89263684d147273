"""Layers of points and lines in one GeoPackage, the same bytes for the same values."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely

from stereomate.errors import StorageError
from stereomate.raster.files import storing

# GeoPackages bear the time of their last change; a fixed one keeps runs the same to the byte.
_CLOCK: Final = {"OGR_CURRENT_DATE": "2000-01-01T00:00:00.000Z"}


@dataclass(frozen=True, eq=False)
class Layer:
    """A layer of a GeoPackage.

    Attributes
    ----------
    name : str
    geometry_type : str
        As GDAL names it, "Point Z" or "LineString Z".
    geometries : sequence of shapely geometries
    columns : mapping of str to sequence
        Text, whole numbers or numbers; NaN for a missing number.
    """

    name: str
    geometry_type: str
    geometries: Sequence[shapely.Geometry]
    columns: Mapping[str, Sequence[Any]]


def write_layers(path: Path, layers: Sequence[Layer], crs: str) -> None:
    """Write layers into a new GeoPackage, whole or not at all; empty layers are left out.

    Raises
    ------
    StorageError
        If the file cannot be written.
    """
    import pyogrio
    from pyogrio.errors import DataSourceError

    with storing(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f".{path.name}.part.gpkg")
    unfinished.unlink(missing_ok=True)
    pyogrio.set_gdal_config_options(_CLOCK)
    try:
        for layer in layers:
            if not len(layer.geometries):
                continue
            pyogrio.raw.write(
                unfinished,
                shapely.to_wkb(np.asarray(layer.geometries, dtype=object), output_dimension=3),
                [_column(values) for values in layer.columns.values()],
                list(layer.columns),
                layer=layer.name,
                driver="GPKG",
                geometry_type=layer.geometry_type,
                crs=crs,
                append=unfinished.exists(),
            )
        os.replace(unfinished, path)
    except (OSError, DataSourceError) as error:
        raise StorageError(f"{path}: cannot be written ({error})") from error
    finally:
        pyogrio.set_gdal_config_options(dict.fromkeys(_CLOCK))
        unfinished.unlink(missing_ok=True)


def _column(values: Sequence[Any]) -> Any:
    listed = list(values)
    return np.array(listed, np.object_) if listed and isinstance(listed[0], str) else np.array(listed)
