"""What a Cloud Optimized GeoTIFF is to be: type, bands, nodata or mask, codec, overviews, band roles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from stereomate.errors import InputError

Compression = Literal["zstd", "deflate", "jpeg", "webp", "none"]
Overviews = Literal["average", "nearest"]

DTYPES: Final = ("uint8", "uint16", "int16", "float32")
DEFAULT_LEVELS: Final[dict[str, int]] = {"zstd": 1, "deflate": 6, "jpeg": 90, "webp": 90, "none": 0}
_LEVEL_RANGES: Final = {"zstd": (1, 22), "deflate": (1, 12), "jpeg": (1, 100), "webp": (1, 100)}
ROLES: Final = ("gray", "red", "green", "blue", "alpha", "undefined")


@dataclass(frozen=True)
class CogProfile:
    """What every tile of a file has in common.

    Parameters
    ----------
    dtype : {"uint8", "uint16", "int16", "float32"}
        Type of the pixels.
    bands : int
        Bands, interleaved by pixel.
    nodata : float, optional
        Value of invalid pixels. A valid sample that happens to have this value is moved by one step, so
        that it stays valid. NaN for floats.
    mask : bool
        Keep validity in an internal mask instead; valid zeros stay zeros. Not together with `nodata`.
    compression : {"zstd", "deflate", "jpeg", "webp", "none"}
        Codec of the tiles. JPEG takes 1 or 3 bands of uint8, WebP 3 or 4.
    level : int, optional
        zstd 1-22 (default 1), deflate 1-12 (6), JPEG and WebP quality 1-100 (90; WebP 100 is lossless).
    overviews : {"average", "nearest"}
        Mean of the valid pixels among 2 x 2, or the first of them (for categories, whose samples are never
        moved).
    roles : tuple of str
        Colour of each band: "gray", "red", "green", "blue", "alpha", "undefined". Empty: red, green, blue for
        three bands, and the fourth undefined; else gray and undefined.
    descriptions : tuple of str
        Band descriptions; empty for none.
    statistics : bool
        Write exact minimum, maximum, mean and standard deviation of the valid pixels of each band.

    Raises
    ------
    InputError
        If a combination cannot be written.
    """

    dtype: str
    bands: int
    nodata: float | None = None
    mask: bool = False
    compression: Compression = "zstd"
    level: int | None = None
    overviews: Overviews = "average"
    roles: tuple[str, ...] = ()
    descriptions: tuple[str, ...] = ()
    statistics: bool = True

    def __post_init__(self) -> None:
        _require(self.dtype in DTYPES, f"must be one of {', '.join(DTYPES)}", "dtype", self.dtype)
        _require(self.bands >= 1, "must be 1 or more", "bands", self.bands)
        _require(self.compression in DEFAULT_LEVELS, "must be a known codec", "compression", self.compression)
        _require(
            self.overviews in ("average", "nearest"),
            "must be average or nearest",
            "overviews",
            self.overviews,
        )
        _require(
            not (self.mask and self.nodata is not None), "must not have a mask as well", "nodata", self.nodata
        )
        for name, per_band in (("roles", self.roles), ("descriptions", self.descriptions)):
            _require(
                len(per_band) in (0, self.bands), f"must be {self.bands}, one for each band", name, per_band
            )
        for role in self.roles:
            _require(role in ROLES, f"must be one of {', '.join(ROLES)}", "roles", role)
        self._require_codec()
        self._require_nodata()

    def _require_codec(self) -> None:
        bands_of = {"jpeg": (1, 3), "webp": (3, 4)}.get(self.compression)
        if bands_of is not None:
            rule = f"must be lossless unless there are {bands_of[0]} or {bands_of[1]} bands of uint8"
            _require(self.dtype == "uint8" and self.bands in bands_of, rule, "compression", self.compression)
        if self.level is not None and self.compression in _LEVEL_RANGES:
            low, high = _LEVEL_RANGES[self.compression]
            _require(
                low <= self.level <= high,
                f"must be {low} to {high} for {self.compression}",
                "level",
                self.level,
            )
        lossless = self.compression in ("zstd", "deflate", "none")
        _require(lossless or self.nodata is None, "must be a mask with lossy tiles", "nodata", self.nodata)

    def _require_nodata(self) -> None:
        if self.nodata is None:
            return
        if self.dtype == "float32":
            representable = np.isnan(self.nodata) or float(np.float32(self.nodata)) == self.nodata
        else:
            limits = np.iinfo(self.dtype)
            representable = float(self.nodata).is_integer() and limits.min <= self.nodata <= limits.max
        _require(bool(representable), f"must be a value of {self.dtype}", "nodata", self.nodata)

    @property
    def numpy_dtype(self) -> np.dtype[Any]:
        """Type of the pixels."""
        return np.dtype(self.dtype)

    @property
    def codec_level(self) -> int:
        """Level or quality of the codec."""
        return DEFAULT_LEVELS[self.compression] if self.level is None else self.level

    @property
    def predictor(self) -> int:
        """TIFF's predictor: 1 none, 2 horizontal differences, 3 floating point."""
        if self.compression not in ("zstd", "deflate"):
            return 1
        return 3 if self.dtype == "float32" else 2

    @property
    def band_roles(self) -> tuple[str, ...]:
        """Colour of each band, defaults filled in."""
        if self.roles:
            return self.roles
        if self.bands in (3, 4):
            return ("red", "green", "blue", "undefined")[: self.bands]
        return ("gray", *["undefined"] * (self.bands - 1))

    @property
    def fill(self) -> float:
        """What invalid pixels are stored as."""
        return 0.0 if self.nodata is None else float(self.nodata)

    @property
    def nudged(self) -> float:
        """What a valid sample equal to nodata is stored as: the next value towards zero or upwards.

        Categories (overviews "nearest") keep their values: there 0 in one of several bands means "none".
        """
        if self.nodata is None or np.isnan(self.nodata) or self.overviews == "nearest":
            return self.fill
        if self.dtype == "float32":
            return float(np.nextafter(np.float32(self.nodata), np.float32(0.0 if self.nodata else 1.0)))
        return self.nodata + 1 if self.nodata <= 0 else self.nodata - 1


def _require(holds: bool, rule: str, field: str, value: object) -> None:
    if not holds:
        raise InputError(rule, field=field, value=value)
