"""Coordinate reference systems as PROJ knows them: parsed, checked and transformed, without network or
ballpark.

Geodetic coordinates inside stereomate are (longitude, latitude) in degrees, east of Greenwich, and metres
above the ellipsoid of their own datum. PROJ's native units and prime meridians stay in this module.
"""

from __future__ import annotations

import re
import threading
import warnings
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pyproj
import pyproj.datadir
from numpy.typing import NDArray
from pyproj.exceptions import CRSError as PyprojCrsError
from pyproj.exceptions import ProjError
from pyproj.transformer import TransformerGroup

from stereomate.errors import CrsError, HeightSystemError, MissingGridError
from stereomate.frames.perthread import per_thread

Array = NDArray[np.float64]

# The geodetic system of a tangent frame or a height system when none is given.
WGS84: Final = "EPSG:4979"

_DEGREE: Final = np.pi / 180.0
_LOCK = threading.Lock()


def parse(text: str) -> pyproj.CRS:
    """CRS of anything PROJ reads (authority code, WKT, PROJ string, PROJJSON), cached per thread.

    Raises
    ------
    CrsError
        If PROJ does not know it.
    """
    crs: pyproj.CRS = per_thread(("crs", text), lambda: _parse(text))
    return crs


def _parse(text: str) -> pyproj.CRS:
    try:
        return pyproj.CRS.from_user_input(text)
    except PyprojCrsError as error:
        raise CrsError(
            "must be a coordinate reference system known to PROJ", field="crs", value=text
        ) from error


def horizontal_part(crs: pyproj.CRS) -> pyproj.CRS:
    """The two-dimensional horizontal part of a projected, geographic or compound CRS."""
    if crs.is_compound:
        crs = crs.sub_crs_list[0]
    return crs.to_2d() if len(crs.axis_info) == 3 else crs


def vertical_part(crs: pyproj.CRS) -> pyproj.CRS | None:
    """The vertical part of a compound CRS, or None."""
    return crs.sub_crs_list[1] if crs.is_compound and len(crs.sub_crs_list) > 1 else None


@dataclass(frozen=True)
class Geodetic:
    """A geodetic datum as it is used here: its CRS text, ellipsoid, and PROJ's native unit and prime
    meridian.

    Attributes
    ----------
    crs : str
        Geographic CRS (two-dimensional) that PROJ uses, as WKT or authority code.
    semi_major_m, flattening : float
        The ellipsoid.
    unit_deg : float
        Degrees per native angular unit (1 for degrees, 0.9 for grads).
    prime_meridian_deg : float
        Longitude of the native prime meridian east of Greenwich.
    declared : bool
        False where only an ellipsoid is named ("Unknown based on ... ellipsoid").
    """

    crs: str
    name: str
    semi_major_m: float
    flattening: float
    unit_deg: float
    prime_meridian_deg: float
    declared: bool

    def native(self, lon: Array, lat: Array) -> tuple[Array, Array]:
        """Longitude and latitude in PROJ's native unit and from its prime meridian."""
        if self.unit_deg == 1.0 and self.prime_meridian_deg == 0.0:
            return lon, lat
        return (lon - self.prime_meridian_deg) / self.unit_deg, lat / self.unit_deg

    def normal(self, lon: Array, lat: Array) -> tuple[Array, Array]:
        """Degrees east of Greenwich from PROJ's native values."""
        if self.unit_deg == 1.0 and self.prime_meridian_deg == 0.0:
            return lon, lat
        return lon * self.unit_deg + self.prime_meridian_deg, lat * self.unit_deg


def geodetic_of(text: str) -> Geodetic:
    """The geodetic datum under a CRS.

    Raises
    ------
    CrsError
        If the CRS has none (an engineering or purely vertical CRS).
    """
    value: Geodetic = per_thread(("geodetic", text), lambda: _geodetic_of(text))
    return value


def _geodetic_of(text: str) -> Geodetic:
    geodetic = horizontal_part(parse(text)).geodetic_crs
    if geodetic is None:
        raise CrsError("must be based on an ellipsoid", field="crs", value=text)
    if geodetic.is_geocentric:
        geodetic = pyproj.CRS.from_json_dict(_geographic_twin(geodetic))
    geodetic = horizontal_part(geodetic)
    ellipsoid, meridian = geodetic.ellipsoid, geodetic.prime_meridian
    if ellipsoid is None or meridian is None:
        raise CrsError("must be based on an ellipsoid", field="crs", value=text)
    inverse, unit = ellipsoid.inverse_flattening, geodetic.axis_info[0].unit_conversion_factor
    authority = geodetic.to_authority(min_confidence=100)
    datum = geodetic.datum
    return Geodetic(
        crs=":".join(authority) if authority else geodetic.to_wkt(),
        name=geodetic.name,
        semi_major_m=ellipsoid.semi_major_metre,
        flattening=1.0 / inverse if inverse else 0.0,
        unit_deg=1.0 if abs(unit - _DEGREE) < 1e-15 else unit / _DEGREE,
        prime_meridian_deg=meridian.longitude * float(meridian.unit_conversion_factor) / _DEGREE,
        declared=not (datum is not None and datum.name.lower().startswith("unknown")),
    )


def _geographic_twin(geocentric: pyproj.CRS) -> dict[str, Any]:
    document = geocentric.to_json_dict()
    document["type"] = "GeographicCRS"
    document["coordinate_system"] = {
        "subtype": "ellipsoidal",
        "axis": [
            {"name": "Longitude", "abbreviation": "lon", "direction": "east", "unit": "degree"},
            {"name": "Latitude", "abbreviation": "lat", "direction": "north", "unit": "degree"},
        ],
    }
    document.pop("id", None)
    return document


def projection(text: str) -> pyproj.Transformer:
    """Transformer from the native geographic CRS of a projected CRS to it, ``always_xy``, cached per thread.

    A map projection without any datum change.
    """

    def build() -> pyproj.Transformer:
        target = horizontal_part(parse(text))
        try:
            return pyproj.Transformer.from_crs(
                target.geodetic_crs, target, always_xy=True, allow_ballpark=False
            )
        except ProjError as error:
            raise CrsError(f"PROJ cannot project into it: {error}", field="crs", value=text) from error

    transformer: pyproj.Transformer = per_thread(("projection", text), build)
    return transformer


def transform(source: str, target: str, x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
    """Transform between two CRS in ``always_xy`` order with the best transformation PROJ knows, or not at
    all.

    Raises
    ------
    MissingGridError
        If the best transformation needs a grid that is not installed; the message names it.
    CrsError
        If the installed database knows no transformation, or a point lies outside the area of all of them.
    """
    transformer = _best_transformer(source, target)
    out = transformer.transform(x, y, z, errcheck=False)
    result = tuple(np.asarray(part, dtype=np.float64) for part in out)
    bad = ~np.isfinite(result[0] + result[1] + result[2]) & np.isfinite(x + y + z)
    if np.any(bad):
        first = np.flatnonzero(np.ravel(bad))[0]
        where = (float(np.ravel(x)[first]), float(np.ravel(y)[first]))
        grids = _missing_grids(source, target)
        if grids:
            raise _missing_grid(source, target, grids)
        raise CrsError(
            f"no transformation from {_short(source)} to {_short(target)} is valid at {where}", field="crs"
        )
    return result[0], result[1], result[2]


def _best_transformer(source: str, target: str) -> pyproj.Transformer:
    def build() -> pyproj.Transformer:
        try:
            return pyproj.Transformer.from_crs(
                parse(source), parse(target), always_xy=True, only_best=True, allow_ballpark=False
            )
        except ProjError as error:
            found = re.search(r"Grid (\S+) is not available", str(error))
            grids = [found.group(1)] if found else _missing_grids(source, target)
            if grids:
                raise _missing_grid(source, target, grids) from error
            raise CrsError(
                f"PROJ's database here has no transformation from {_short(source)} to {_short(target)}",
                field="crs",
            ) from error

    transformer: pyproj.Transformer = per_thread(("best", source, target), build)
    return transformer


def _missing_grids(source: str, target: str) -> list[str]:
    # Only on the way to an error. The warnings module is not thread-safe, so one thread at a time.
    with _LOCK, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # PROJ warns about exactly what is asked here
        group = TransformerGroup(parse(source), parse(target), always_xy=True, allow_ballpark=False)
    return [
        grid.short_name for op in group.unavailable_operations[:1] for grid in op.grids if not grid.available
    ]


def _missing_grid(source: str, target: str, grids: list[str]) -> MissingGridError:
    names = ", ".join(grids)
    folder = pyproj.datadir.get_user_data_dir()  # type: ignore[attr-defined]
    return MissingGridError(
        f"the transformation from {_short(source)} to {_short(target)} needs the grid {names}, "
        "which is not on this machine",
        file=grids[0],
        hint=f"put it into {folder}, or name a geoid grid file as the height system",
    )


def _short(text: str) -> str:
    """A CRS by its name, for messages."""
    return text if len(text) < 40 else parse(text).name


def same_crs(first: str, second: str) -> bool:
    """Whether the horizontal parts of two CRSs are the same, the order of axes aside."""
    a, b = (horizontal_part(parse(text)) for text in (first, second))
    return bool(a.equals(b, ignore_axis_order=True))


def same_datum(first: Geodetic, second: Geodetic) -> bool:
    """Whether two geodetic systems are one: same definition, or one of them is only an ellipsoid and it
    agrees.

    A CRS written as ``+proj=... +ellps=WGS84`` names no datum. It is taken to be that of its partner where
    the ellipsoids agree; `datum_note` says so, because it is an assumption.
    """
    if first.crs == second.crs:
        return True
    if first.declared and second.declared:
        a, b = parse(first.crs), parse(second.crs)
        return bool(a.datum == b.datum)
    return (
        abs(first.semi_major_m - second.semi_major_m) < 1e-3
        and abs(first.flattening - second.flattening) < 1e-12
    )


def datum_note(first: Geodetic, second: Geodetic) -> str | None:
    """What is assumed when two geodetic systems are taken as one, or None where nothing is."""
    if first.crs == second.crs or (first.declared and second.declared) or not same_datum(first, second):
        return None
    unknown, other = (second, first) if first.declared else (first, second)
    nameless = unknown.name.lower() == "unknown"
    what = "one of the two CRS" if nameless else repr(unknown.name)
    return f"{what} names only an ellipsoid; it is taken to be on the datum of {other.name!r}"


def datum_operation(
    source: Geodetic, target: Geodetic, lon: float, lat: float
) -> tuple[str, float | None] | None:
    """Name and accuracy in metres (None if unknown) of the transformation at a place; None if none is needed.

    For reports: a transformation without a grid may be good to metres only.

    Raises
    ------
    CrsError, MissingGridError
        As `convert_geodetic`.
    """
    if same_datum(source, target):
        return None
    place = (np.array([lon]), np.array([lat]), np.zeros(1))
    convert_geodetic(source, target, *place)
    transformer = _best_transformer(_three_dimensional(source.crs), _three_dimensional(target.crs))
    try:
        used = transformer.get_last_used_operation()
    except ProjError:  # a transformer that holds one operation only does not tell
        used = transformer
    name = str(used.description).replace("axis order change (2D)", "").strip(" +")
    return name, float(used.accuracy) if used.accuracy >= 0.0 else None


def convert_geodetic(
    source: Geodetic, target: Geodetic, lon: Array, lat: Array, h: Array
) -> tuple[Array, Array, Array]:
    """Geodetic coordinates on another datum (degrees, ellipsoidal metres).

    Raises
    ------
    CrsError, MissingGridError
        As `transform`; also where a datum is not declared and the ellipsoids differ.
    """
    if same_datum(source, target):
        return lon, lat, h
    if not (source.declared and target.declared):
        unknown = target if source.declared else source
        raise CrsError(
            "names only an ellipsoid and cannot be transformed to or from a system on another "
            f"ellipsoid ({source.name!r}, {target.name!r})",
            field="crs",
            value=unknown.name,
        )
    x, y = source.native(lon, lat)
    x, y, z = transform(_three_dimensional(source.crs), _three_dimensional(target.crs), x, y, h)
    return (*target.normal(x, y), z)


def _three_dimensional(text: str) -> str:
    """The three-dimensional geographic CRS on the datum of a two-dimensional one, as text."""

    def build() -> str:
        crs = parse(text).to_3d()
        authority = crs.to_authority(min_confidence=100)
        return ":".join(authority) if authority else crs.to_wkt()

    value: str = per_thread(("3d", text), build)
    return value


def vertical_heights(
    geodetic: Geodetic, vertical: str, lon: Array, lat: Array, h: Array, *, to_ellipsoid: bool
) -> Array:
    """Heights between a vertical CRS and the ellipsoid of `geodetic` through PROJ's best transformation.

    Raises
    ------
    MissingGridError
        If the geoid grid is not installed.
    HeightSystemError
        If PROJ knows no transformation between the two, or no datum is declared.
    """
    if not geodetic.declared:
        raise HeightSystemError(
            f"a vertical CRS ({vertical}) needs a map CRS with a declared datum",
            field="heights",
            value=geodetic.name,
            hint="name the datum in the crs (for example +datum=WGS84), or give a geoid grid file",
        )
    compound = per_thread(("compound", geodetic.crs, vertical), lambda: _compound(geodetic.crs, vertical))
    ellipsoidal = _three_dimensional(geodetic.crs)
    x, y = geodetic.native(lon, lat)
    try:
        if to_ellipsoid:
            return transform(compound, ellipsoidal, x, y, h)[2]
        return transform(ellipsoidal, compound, x, y, h)[2]
    except MissingGridError:
        raise
    except CrsError as error:
        raise HeightSystemError(
            f"heights in {vertical} cannot be brought to the ellipsoid of {geodetic.name}: {error.rule}",
            field="heights",
        ) from error


def _compound(geodetic_crs: str, vertical: str) -> str:
    horizontal, up = parse(geodetic_crs), parse(vertical)
    if not up.is_vertical or up.is_compound:
        raise HeightSystemError("must be a vertical CRS", field="heights", value=vertical)
    document: str = pyproj.crs.CompoundCRS(f"{horizontal.name} + {up.name}", [horizontal, up]).to_wkt()
    return document
