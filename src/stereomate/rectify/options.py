"""What the orthophoto and its stereomate shall be: the `[products]` section of a project file as a value."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final, Literal, get_args

from stereomate.errors import ProjectError

LawKind = Literal["logarithmic", "linear", "natural", "table"]
Hidden = Literal["nodata", "fill", "keep"]
Resampling = Literal["nearest", "bilinear", "cubic", "lanczos"]
HeightsInterpolation = Literal["bilinear", "cubic"]
Compression = Literal["zstd", "deflate", "jpeg", "webp"]
Rotation = Literal["auto", "north-up"] | float
DataType = Literal["uint8", "uint16", "int16", "float32"]
Masking = Literal["auto", "mask", "nodata"]
SeamKind = Literal["least-cost", "nearest"]

# Highest level each codec knows; JPEG and WebP have a quality instead.
_LEVELS: Final = {"zstd": 22, "deflate": 9}
_LOSSY: Final = ("jpeg", "webp")


@dataclass(frozen=True)
class RectifyOptions:
    """Options of the products; everything that is None is chosen from the survey and reported.

    Attributes
    ----------
    gsd : float or None
        Ground sampling distance of the products in units of the map grid.
    law : str
        Parallax law of the stereomate.
    law_heights_m, law_parallaxes_m : tuple of float or None
        Of the law "table": heights in the project's system and their parallaxes, both rising.
    base_m, w0_m, reference_m : float or None
        Nominal base, flying height above the reference level, and reference level of the law.
    hidden : str
        Ground that a photograph does not see: "nodata", "fill" (from another photograph), "keep" (what the
        photograph shows there, doubled).
    resampling, heights_interpolation : str
        Interpolation of the photographs and of the height model.
    rotation : "auto", "north-up" or float
        Direction of the rows: along the base when that is needed, always east, or turned by this many
        degrees (clockwise, of the column axis from grid east).
    object_height_m : float
        Height of the object that may show at most 1 px of y-parallax for "auto" to stay north-up.
    bounds : (x_min, y_min, x_max, y_max) or None
        Extent in the map grid; snapped outwards to whole GSDs.
    min_base_height, max_base_height : float
        Range of base/height ratios of pairs that may serve a stereomate.
    compression, compression_level, quality : str, int or None, int
        Codec of the tiles; the level counts for zstd and deflate, the quality for JPEG and WebP.
    blocksize : int
        Side of a tile of the COG in pixels.
    overviews : bool
        Always true: a Cloud Optimized GeoTIFF has them.
    masking : "auto", "mask" or "nodata"
        How empty pixels are told: a mask band or a nodata value; auto takes nodata where `nodata` is given
        or the photographs are float, else a mask.
    nodata : float or None
        Value of empty pixels; None with ``masking = "nodata"``: NaN for floats, else 0. A valid pixel of
        this value is moved by one step.
    dtype : str or None
        Type of the products; None keeps that of the photographs.
    bands : tuple of int or None
        Bands to take, counted from 1.
    seams : "least-cost" or "nearest"
        Where one model gives way to the next: along least-cost paths, or where the other one looks down more
        steeply.
    feather_px : float
        Half width in product pixels of the strip along seams in which photographs are mixed, on open ground;
        0 mixes nowhere.
    balance : bool
        Bring the photographs of a block to one brightness.
    strict : bool
        One bad photograph stops the run.

    Raises
    ------
    ProjectError
        Naming the key, the rule and the value.
    """

    gsd: float | None = None
    law: LawKind = "logarithmic"
    law_heights_m: tuple[float, ...] | None = None
    law_parallaxes_m: tuple[float, ...] | None = None
    base_m: float | None = None
    w0_m: float | None = None
    reference_m: float | None = None
    hidden: Hidden = "fill"
    resampling: Resampling = "cubic"
    heights_interpolation: HeightsInterpolation = "bilinear"
    rotation: Rotation = "auto"
    object_height_m: float = 20.0
    bounds: tuple[float, float, float, float] | None = None
    min_base_height: float = 0.05
    max_base_height: float = 2.0
    compression: Compression = "zstd"
    compression_level: int | None = None
    quality: int = 90
    blocksize: int = 512
    overviews: bool = True
    masking: Masking = "auto"
    nodata: float | None = None
    dtype: DataType | None = None
    bands: tuple[int, ...] | None = None
    seams: SeamKind = "least-cost"
    feather_px: float = 8.0
    balance: bool = True
    strict: bool = False

    def __post_init__(self) -> None:
        for name, kind in _CHOICES.items():
            _require(getattr(self, name) in get_args(kind), name, f"must be one of {_listed(kind)}", self)
        known = self.dtype is None or self.dtype in get_args(DataType)
        _require(known, "dtype", f"must be one of {_listed(DataType)}", self)
        for name in ("gsd", "base_m", "w0_m"):
            value = getattr(self, name)
            _require(value is None or (math.isfinite(value) and value > 0), name, "must be positive", self)
        for name in ("reference_m", "nodata"):
            value = getattr(self, name)
            finite = value is None or math.isfinite(value) or (name == "nodata" and math.isnan(value))
            _require(finite, name, "must be a finite number", self)
        _require(
            _finite(self.object_height_m) and self.object_height_m >= 0, "object_height_m", _NOT_NEG, self
        )
        _require(
            _finite(self.feather_px) and 0 <= self.feather_px <= 100, "feather_px", "must be 0 to 100", self
        )
        self._check_law()
        self._check_rotation_and_bounds()
        self._check_encoding()

    def _check_law(self) -> None:
        heights, parallaxes = self.law_heights_m, self.law_parallaxes_m
        if self.law != "table":
            rule = 'has a meaning only with law = "table"'
            _require(heights is None and parallaxes is None, "law_table", rule, self, self.law)
            return
        rule = 'must be given with law = "table": a CSV with height and parallax'
        _require(heights is not None and parallaxes is not None, "law_table", rule, self, None)
        assert heights is not None
        assert parallaxes is not None
        for values in (heights, parallaxes):
            rising = len(values) == len(heights) >= 2 and all(map(_finite, values))
            rising = rising and all(a < b for a, b in pairwise(values))
            rule = "must be two or more heights with as many parallaxes, both rising"
            _require(rising, "law_table", rule, self, list(values))

    def _check_rotation_and_bounds(self) -> None:
        turned = not isinstance(self.rotation, str)
        known = (turned and _finite(self.rotation)) or self.rotation in ("auto", "north-up")
        _require(known, "rotation", 'must be "auto", "north-up" or degrees', self)
        if self.bounds is not None:
            ordered = all(map(_finite, self.bounds))
            ordered = ordered and self.bounds[0] < self.bounds[2] and self.bounds[1] < self.bounds[3]
            _require(ordered, "bounds", "must be [x_min, y_min, x_max, y_max] with min below max", self)
        low, high = self.min_base_height, self.max_base_height
        _require(_finite(low) and low >= 0, "min_base_height", _NOT_NEG, self)
        _require(_finite(high) and high > low, "max_base_height", "must exceed min_base_height", self)

    def _check_encoding(self) -> None:
        size = self.blocksize
        power = 128 <= size <= 4096 and size & (size - 1) == 0
        _require(power, "blocksize", "must be a power of two from 128 to 4096", self)
        _require(self.overviews, "overviews", "must be true: a Cloud Optimized GeoTIFF has overviews", self)
        level, codec = self.compression_level, self.compression
        if level is not None:
            _require(codec in _LEVELS, "compression_level", f"has no meaning with {codec}: use quality", self)
            highest = _LEVELS[codec]
            _require(1 <= level <= highest, "compression_level", f"must be 1 to {highest} for {codec}", self)
        _require(1 <= self.quality <= 100, "quality", "must be 1 to 100", self)
        if codec in _LOSSY:
            _require(self.dtype in (None, "uint8"), "dtype", f"must be uint8 with {codec}", self)
            rule = f"cannot be kept by the lossy {codec}: use a mask"
            _require(self.nodata is None and self.masking != "nodata", "nodata", rule, self)
        rule = 'has no meaning with masking = "mask"'
        _require(self.nodata is None or self.masking != "mask", "nodata", rule, self)
        if self.nodata is not None and self.dtype is not None:
            rule = f"must be a value of {self.dtype}"
            _require(_representable(self.nodata, self.dtype), "nodata", rule, self)
        if self.bands is not None:
            distinct = len(set(self.bands)) == len(self.bands) > 0 and min(self.bands) >= 1
            _require(distinct, "bands", "must be distinct band numbers, counted from 1", self)


# The value of the option itself.
_OWN: Final = object()
_NOT_NEG: Final = "must be 0 or more"
_CHOICES: Final[dict[str, Any]] = {
    "law": LawKind,
    "hidden": Hidden,
    "resampling": Resampling,
    "heights_interpolation": HeightsInterpolation,
    "compression": Compression,
    "masking": Masking,
    "seams": SeamKind,
}
_INTEGER_RANGES: Final = {"uint8": (0, 255), "uint16": (0, 65535), "int16": (-32768, 32767)}


def _require(holds: bool, name: str, rule: str, options: RectifyOptions, value: Any = _OWN) -> None:
    if not holds:
        shown = getattr(options, name) if value is _OWN else value
        raise ProjectError(rule, field=f"products.{name}", value=shown)


def _finite(value: Any) -> bool:
    return isinstance(value, int | float) and math.isfinite(value)


def _listed(kind: Any) -> str:
    return ", ".join(f'"{choice}"' for choice in get_args(kind))


def _representable(value: float, dtype: str) -> bool:
    if dtype not in _INTEGER_RANGES:
        return True
    low, high = _INTEGER_RANGES[dtype]
    return math.isfinite(value) and value == int(value) and low <= value <= high
