"""STAC items of products, with the ISO 19115 association that makes two rasters a stereo pair.

STAC 1.1 (https://github.com/radiantearth/stac-spec), extensions projection 2.0, file 2.1. ISO 19115-1 knows
the association type code `stereoMate`, "part of a stereo pair of images": it stands as a link between the
assets, in the properties and in the roles.
"""

from __future__ import annotations

import datetime as dt
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from stereomate.raster.files import write_whole

_SCHEMAS: Final = (
    "https://stac-extensions.github.io/projection/v2.0.0/schema.json",
    "https://stac-extensions.github.io/file/v2.1.0/schema.json",
)
_COG: Final = "image/tiff; application=geotiff; profile=cloud-optimized"
# Multihash prefix of SHA-256: code 0x12, length 0x20.
_SHA256_PREFIX: Final = "1220"


@dataclass(frozen=True)
class StacProduct:
    """What a STAC item says of a product.

    Attributes
    ----------
    identifier, title : str
    outline : sequence of (longitude, latitude)
        Corners of the raster in WGS84 degrees, counter-clockwise, not closed.
    epsg : int or None
    wkt : str
    shape : (rows, cols)
    transform : tuple of 6 floats
    gsd_m : float
    times : (first, last) or None
        Seconds since 1970 of the photographs; None where unknown.
    files : mapping of role to file name
        Roles "ortho", "mate", "lineage", "stereo", "report".
    hashes : mapping of file name to SHA-256
    """

    identifier: str
    title: str
    outline: tuple[tuple[float, float], ...]
    epsg: int | None
    wkt: str
    shape: tuple[int, int]
    transform: tuple[float, ...]
    gsd_m: float
    times: tuple[float, float] | None
    files: Mapping[str, str]
    hashes: Mapping[str, str]


def stac_item(product: StacProduct, now: dt.datetime) -> dict[str, Any]:
    """The item as plain values."""
    ring = [list(point) for point in product.outline]
    ring.append(ring[0])
    lon, lat = zip(*product.outline, strict=True)
    return {
        "type": "Feature",
        "stac_version": "1.1.0",
        "stac_extensions": list(_SCHEMAS),
        "id": product.identifier,
        "geometry": {"type": "Polygon", "coordinates": [ring]},
        "bbox": [min(lon), min(lat), max(lon), max(lat)],
        "properties": _properties(product, now),
        "links": _links(product),
        "assets": {role: _asset(product, role, name) for role, name in product.files.items()},
    }


def write_stac_item(path: Path, product: StacProduct, now: dt.datetime) -> None:
    """Write the item, whole or not at all."""
    write_whole(path, [json.dumps(stac_item(product, now), indent=1, ensure_ascii=False).encode()])


def _properties(product: StacProduct, now: dt.datetime) -> dict[str, Any]:
    properties: dict[str, Any] = {"title": product.title, "created": _text(now), "gsd": product.gsd_m}
    if product.times is None:
        # STAC demands a time; that of processing, said to be so.
        properties["datetime"] = _text(now)
        properties["stereomate:datetime"] = "of processing: the photographs carry no time"
    else:
        first, last = (dt.datetime.fromtimestamp(t, dt.UTC) for t in product.times)
        properties["datetime"] = _text(first)
        properties["start_datetime"], properties["end_datetime"] = _text(first), _text(last)
    if product.epsg is not None:
        properties["proj:code"] = f"EPSG:{product.epsg}"
    else:
        properties["proj:code"] = None
        properties["proj:wkt2"] = product.wkt
    properties["proj:shape"] = list(product.shape)
    properties["proj:transform"] = [*product.transform, 0.0, 0.0, 1.0]
    if "mate" in product.files:
        properties["iso19115:associatedResource"] = [
            {"associationType": "stereoMate", "resource": role, "associatedWith": other}
            for role, other in (("ortho", "mate"), ("mate", "ortho"))
        ]
    return properties


def _links(product: StacProduct) -> list[dict[str, str]]:
    if "mate" not in product.files:
        return []
    return [
        {
            "rel": "stereoMate",
            "href": f"./{product.files['mate']}",
            "type": _COG,
            "title": "Stereomate of the orthophoto (ISO 19115 DS_AssociationTypeCode stereoMate)",
        }
    ]


def _asset(product: StacProduct, role: str, name: str) -> dict[str, Any]:
    titles = {
        "ortho": ("Orthophoto, for the left eye", _COG, ["data", "visual", "stereoMate"]),
        "mate": ("Stereomate, for the right eye", _COG, ["data", "visual", "stereoMate"]),
        "lineage": ("Photograph of each pixel", _COG, ["metadata"]),
        "stereo": ("Definition of the stereo product", "application/json", ["metadata"]),
        "report": ("Report", "text/html", ["metadata", "overview"]),
    }
    title, media, roles = titles[role]
    asset: dict[str, Any] = {"href": f"./{name}", "title": title, "type": media, "roles": roles}
    if name in product.hashes:
        asset["file:checksum"] = _SHA256_PREFIX + product.hashes[name]
    return asset


def _text(time: dt.datetime) -> str:
    return time.astimezone(dt.UTC).replace(microsecond=0, tzinfo=None).isoformat() + "Z"
