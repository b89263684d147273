"""Height systems that are in use at a place, as PROJ's database knows them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from pyproj.aoi import AreaOfInterest
from pyproj.database import query_crs_info
from pyproj.enums import PJType

from stereomate.errors import InputError
from stereomate.frames.audit.readings import HeightCandidate
from stereomate.frames.heights import HeightSystem, geoid_description
from stereomate.frames.mapframe import MapFrame

# Levels of tides and the like: no national height system among them.
_NO_LAND_HEIGHTS: Final = ("depth", "water", "msl", "mhw", "mhhw", "hhwlt", "hat ", "example", "mhws")
# Tried where nothing nearer is at hand: every drone and every receiver knows them.
_WORLD: Final = ("EPSG:3855", "EPSG:5773")


def world_geoids(
    frame: MapFrame, lon: float, lat: float, tried: Sequence[HeightCandidate] = ()
) -> list[HeightCandidate]:
    """EGM2008 and EGM96, as far as PROJ has their grids on this machine and they were not tried yet."""
    found = []
    for code in _WORLD:
        if code in {candidate.text for candidate in tried}:
            continue
        system = HeightSystem.vertical_crs(code)
        try:
            system.ellipsoidal_from_system(lon, lat, 0.0, frame.geodetic)
        except InputError:
            continue
        found.append(HeightCandidate(code, system.description, system))
    return found


def vertical_names(lon: float, lat: float) -> list[str]:
    """Names and codes of the height systems registered for a place, whether or not their geoid is here."""
    area = AreaOfInterest(lon, lat, lon, lat)
    return [
        f"{info.name} ({info.auth_name}:{info.code})"
        for info in query_crs_info(pj_types=PJType.VERTICAL_CRS, area_of_interest=area, contains=True)
        if not info.deprecated
        and info.auth_name == "EPSG"
        and not any(word in info.name.lower() for word in _NO_LAND_HEIGHTS)
    ]


def grid_file_candidate(
    path: Path, text: str, frame: MapFrame, lon: float, lat: float
) -> HeightCandidate | None:
    """A geoid grid file as a candidate, if it is one and covers the place."""
    try:
        system = HeightSystem.grid_file(path)
        system.ellipsoidal_from_system(lon, lat, 0.0, frame.geodetic)
    except InputError:
        return None
    says = geoid_description(system)
    name = f"heights above the geoid of {path.name}" + (f" ({says})" if says != path.name else "")
    return HeightCandidate(text, name, system)
