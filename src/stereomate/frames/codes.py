"""How other programs name a coordinate reference system."""

from __future__ import annotations

from stereomate.frames.crs import horizontal_part, parse

# A code counts as this CRS only when PROJ is sure of it.
_CONFIDENCE = 100


def epsg_code(crs: str) -> int | None:
    """EPSG code of the horizontal part of a CRS, None where it has none."""
    return horizontal_part(parse(crs)).to_epsg(min_confidence=_CONFIDENCE)


def wkt_of(crs: str) -> str:
    """WKT2 of the horizontal part of a CRS."""
    return str(horizontal_part(parse(crs)).to_wkt())
