"""Seams of products as polygons in a GeoPackage, written to be edited, and read back.

Layer ``seams``, one polygon or multipolygon per model and product: columns ``product`` (empty for the first),
``left`` and ``right`` (names of the photographs; ``right`` empty in an orthophoto without stereomate).
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import shapely

from stereomate.errors import FormatError, StorageError
from stereomate.raster.files import storing

LAYER: Final = "seams"
COLUMNS: Final = ("product", "left", "right")
# GeoPackages bear the time of their last change; a fixed one keeps runs the same to the byte.
_CLOCK: Final = {"OGR_CURRENT_DATE": "2000-01-01T00:00:00.000Z"}


@dataclass(frozen=True)
class SeamRecord:
    """Ground that a model serves in a product.

    Attributes
    ----------
    product, left, right : str
    geometry : shapely Polygon or MultiPolygon
        Map coordinates.
    row : int
        Feature in the file, counted from 1.
    base_height : float
        Base/height ratio of the model, for information; NaN where it has none.
    """

    product: str
    left: str
    right: str
    geometry: shapely.Geometry
    row: int = 0
    base_height: float = float("nan")


def write_seams(path: Path, records: Sequence[SeamRecord], crs: str) -> None:
    """Write seams, whole or not at all.

    Raises
    ------
    StorageError
        If the file cannot be written.
    """
    # One product of one model has no seams: its run does without this library.
    import pyogrio
    from pyogrio.errors import DataSourceError

    text = {name: np.array([getattr(r, name) for r in records], np.object_) for name in COLUMNS}
    numbers = {
        "base_height": np.array([r.base_height for r in records], np.float64),
        "area": np.array([r.geometry.area for r in records], np.float64),
    }
    columns = {**text, **numbers}
    shapes = [shapely.multipolygons(shapely.get_parts(r.geometry)) for r in records]
    unfinished = path.with_name(f".{path.name}.part.gpkg")
    with storing(path):
        unfinished.unlink(missing_ok=True)
    pyogrio.set_gdal_config_options(_CLOCK)
    try:
        pyogrio.raw.write(
            unfinished, shapely.to_wkb(shapes), list(columns.values()), list(columns), layer=LAYER,
            driver="GPKG", geometry_type="MultiPolygon", crs=crs,
        )  # fmt: skip
        os.replace(unfinished, path)
    except (OSError, DataSourceError) as error:
        raise StorageError(f"{path}: cannot be written ({error})") from error
    finally:
        pyogrio.set_gdal_config_options(dict.fromkeys(_CLOCK))
        unfinished.unlink(missing_ok=True)


def read_seams(path: Path) -> tuple[list[SeamRecord], str]:
    """Seams of a file, and the CRS it bears ("" for none).

    Raises
    ------
    FormatError
        If it is no such file, lacks the layer or a column, or a feature has no usable polygon.
    """
    import pyogrio
    from pyogrio.errors import DataLayerError, DataSourceError

    if not path.is_file():
        raise FormatError("does not exist", file=path)
    try:
        layers = [str(row[0]) for row in pyogrio.list_layers(path)]
        if LAYER not in layers:
            rule = f'must have a layer "{LAYER}", as a run writes it'
            raise FormatError(rule, file=path, value=layers)
        meta, _, geometries, fields = pyogrio.raw.read(path, layer=LAYER)
    except (DataSourceError, DataLayerError) as error:
        raise FormatError(f"cannot be read as vector data ({error})", file=path) from error
    columns = {str(name).lower(): values for name, values in zip(meta["fields"], fields, strict=True)}
    for name in COLUMNS:
        if name not in columns:
            rule = f"must have the columns {', '.join(COLUMNS)}"
            raise FormatError(rule, file=path, field=name, value=sorted(columns))
    records = []
    for k, blob in enumerate(geometries):
        product, left, right = (_text(columns[name][k]) for name in COLUMNS)
        records.append(SeamRecord(product, left, right, _polygon(path, k + 1, blob), k + 1))
    if not records:
        raise FormatError("must hold at least one polygon", file=path, field=LAYER)
    return records, str(meta["crs"] or "")


def _text(value: object) -> str:
    return "" if value is None else str(value).strip()


def _polygon(path: Path, row: int, blob: bytes | None) -> shapely.Geometry:
    geometry = None if blob is None else shapely.force_2d(shapely.from_wkb(blob))
    if geometry is None or geometry.is_empty or geometry.geom_type not in ("Polygon", "MultiPolygon"):
        kind = "nothing" if geometry is None else geometry.geom_type
        raise FormatError("must be a polygon or multipolygon", file=path, field=f"feature {row}", value=kind)
    if not geometry.is_valid:
        reason = shapely.is_valid_reason(geometry)
        raise FormatError("must be a valid polygon", file=path, field=f"feature {row}", value=reason)
    return geometry
