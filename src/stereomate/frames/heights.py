"""Height systems: what a written height means, and how it becomes metres above the ellipsoid."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import HeightSystemError, MissingGridError
from stereomate.frames import kernels
from stereomate.frames.crs import WGS84, Geodetic, geodetic_of, parse, vertical_heights
from stereomate.raster.grids import GeoidGrid, read_geoid_grid

Array = NDArray[np.float64]
HeightKind = Literal["ellipsoidal", "vertical_crs", "grid_file", "undeclared"]


@dataclass(frozen=True)
class HeightSystem:
    """Meaning of a height. Build it with the class methods.

    Attributes
    ----------
    kind : str
        ``ellipsoidal``; ``vertical_crs`` (PROJ applies the geoid of `reference`); ``grid_file`` (undulations
        are read from the file `reference`); ``undeclared`` (one unknown common system, taken as it is).
    reference : str
        The vertical CRS or the path of the grid file.
    unit_m : float
        Metres per unit of height. A vertical CRS carries its own unit; with one this is its units per unit
        that is written, 1 unless a file departs from it.
    """

    kind: HeightKind
    reference: str = ""
    unit_m: float = 1.0

    @classmethod
    def ellipsoidal(cls, unit_m: float = 1.0) -> HeightSystem:
        """Heights above the ellipsoid of the map's datum."""
        return cls("ellipsoidal", unit_m=unit_m)

    @classmethod
    def vertical_crs(cls, crs: str) -> HeightSystem:
        """Heights of a vertical CRS, such as ``EPSG:5773``.

        Raises
        ------
        CrsError, HeightSystemError
            If PROJ does not know it or it is not vertical.
        """
        if not parse(crs).is_vertical or parse(crs).is_compound:
            raise HeightSystemError("must be a vertical CRS", field="heights", value=crs)
        return cls("vertical_crs", crs)

    @classmethod
    def grid_file(cls, path: str | Path, unit_m: float = 1.0) -> HeightSystem:
        """Heights above the geoid of a grid file.

        Raises
        ------
        MissingGridError
            If the file is not there.
        HeightSystemError
            If it is no geoid grid.
        """
        # Absolute, so that it means the same file in a worker of another folder.
        reference = str(Path(path).absolute())
        _grid(reference)
        return cls("grid_file", reference, unit_m)

    @classmethod
    def undeclared(cls, unit_m: float = 1.0) -> HeightSystem:
        """One unknown common system, taken as it is; the maths treats it as ellipsoidal and the report
        says so."""
        return cls("undeclared", unit_m=unit_m)

    @classmethod
    def from_text(cls, text: str, folder: Path | None = None) -> HeightSystem:
        """Height system as a project file writes it: ``ellipsoidal``, ``undeclared``, a vertical CRS, or a
        grid file.

        A relative path is looked for in `folder`.

        Raises
        ------
        MissingGridError, CrsError, HeightSystemError
            If it is none of them.
        """
        if text == "ellipsoidal":
            return cls.ellipsoidal()
        if text == "undeclared":
            return cls.undeclared()
        path = Path(text) if folder is None else folder / text
        if path.is_file():
            return cls.grid_file(path)
        if path.suffix.lower() in {".tif", ".tiff", ".gtx", ".byn", ".bin", ".ggf"}:
            raise MissingGridError("the geoid grid is not on this machine", file=path, field="heights")
        return cls.vertical_crs(text)

    @property
    def description(self) -> str:
        """The system in words, for reports."""
        if self.kind == "vertical_crs":
            return f"{parse(self.reference).name} ({self.reference})"
        if self.kind == "grid_file":
            return f"heights above the geoid of {Path(self.reference).name}"
        if self.kind == "undeclared":
            return "undeclared: one unknown common system, taken as it is"
        return "ellipsoidal heights"

    @property
    def metres_per_unit(self) -> float:
        """Metres per unit of height, also of a vertical CRS."""
        if self.kind == "vertical_crs":
            return self.unit_m * float(parse(self.reference).axis_info[0].unit_conversion_factor)
        return self.unit_m

    def ellipsoidal_from_system(
        self, lon: ArrayLike, lat: ArrayLike, h: ArrayLike, geodetic: Geodetic | None = None
    ) -> Array:
        """Ellipsoidal heights in metres from heights of this system.

        Parameters
        ----------
        lon, lat : array_like
            Degrees; NaN where there is no point.
        h : array_like
            Heights in this system and its unit, same shape.
        geodetic : Geodetic, optional
            The datum of the coordinates and of the ellipsoidal heights; WGS 84 if absent.

        Raises
        ------
        MissingGridError
            If PROJ lacks the geoid grid of the vertical CRS, or the grid file is gone.
        HeightSystemError
            If the grid does not cover a point.
        """
        lon, lat, h = np.broadcast_arrays(*(np.asarray(part, dtype=np.float64) for part in (lon, lat, h)))
        if self.kind == "vertical_crs":
            written = h * self.unit_m
            return vertical_heights(
                geodetic or geodetic_of(WGS84), self.reference, lon, lat, written, to_ellipsoid=True
            )
        if self.kind == "grid_file":
            return h * self.unit_m + self._undulation(lon, lat)
        return h * self.unit_m

    def system_from_ellipsoidal(
        self, lon: ArrayLike, lat: ArrayLike, h: ArrayLike, geodetic: Geodetic | None = None
    ) -> Array:
        """Heights of this system, in its unit, from ellipsoidal metres: the inverse of
        `ellipsoidal_from_system`."""
        lon, lat, h = np.broadcast_arrays(*(np.asarray(part, dtype=np.float64) for part in (lon, lat, h)))
        if self.kind == "vertical_crs":
            datum = geodetic or geodetic_of(WGS84)
            return vertical_heights(datum, self.reference, lon, lat, h, to_ellipsoid=False) / self.unit_m
        if self.kind == "grid_file":
            return (h - self._undulation(lon, lat)) / self.unit_m
        return h / self.unit_m

    def _undulation(self, lon: Array, lat: Array) -> Array:
        grid = _grid(self.reference)
        out = np.empty(lon.shape)
        kernels.grid_values(
            grid.values,
            grid.west_deg,
            grid.north_deg,
            grid.step_lon_deg,
            grid.step_lat_deg,
            np.ascontiguousarray(lon).ravel(),
            np.ascontiguousarray(lat).ravel(),
            out.reshape(-1),
        )
        # NaN asked, NaN given; NaN where a point was asked is a point without geoid.
        bad = np.isnan(out)
        if bad.any():
            bad &= ~np.isnan(lon + lat)
        if bad.any():
            first = np.unravel_index(int(np.argmax(bad)), bad.shape)
            west, south, east, north = grid.bounds_deg
            raise HeightSystemError(
                f"the geoid grid does not cover longitude {lon[first]:.6f} latitude {lat[first]:.6f}; "
                f"it covers longitude {west:.4f} to {east:.4f}, latitude {south:.4f} to {north:.4f}",
                file=self.reference,
                field="heights",
            )
        return out


def geoid_description(system: HeightSystem) -> str:
    """What the file of a geoid grid says about itself; its name if nothing."""
    return _grid(system.reference).description


@functools.lru_cache(maxsize=8)
def _grid(path: str) -> GeoidGrid:
    return read_geoid_grid(path)
