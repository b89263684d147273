"""The image file directories of a Cloud Optimized GeoTIFF: image, mask, and theirs at each overview level."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.raster.cog.codecs import COMPRESSION_TAGS, mask_compression
from stereomate.raster.cog.georeference import EXTRA_SAMPLES, GDAL_NODATA, PHOTOMETRIC
from stereomate.raster.cog.profile import CogProfile
from stereomate.raster.cog.tags import LONG, RATIONAL, SHORT, Directory, Tag

Sizes = NDArray[np.uint64]

_REDUCED, _MASK = 1, 4
_YCBCR, _TRANSPARENCY_MASK = 6, 4
_SAMPLE_FORMATS: Final = {"u": 1, "i": 2, "f": 3}


def image_directory(
    profile: CogProfile,
    block: int,
    level: tuple[int, tuple[int, int]],
    template: Mapping[int, Tag],
    tiles: tuple[Sizes, Sizes],
) -> Directory:
    """Directory of the image at a level.

    Parameters
    ----------
    profile : CogProfile
    block : int
    level : (int, (int, int))
        Number of the level, and its columns and rows.
    template : mapping
        From `template_tags`.
    tiles : (offsets, sizes)
        Of its tiles, row by row.
    """
    number, size = level
    dtype = profile.numpy_dtype
    tags = [
        *_common(size, block, _REDUCED if number else 0, COMPRESSION_TAGS[profile.compression]),
        Tag.of_values(258, SHORT, [dtype.itemsize * 8] * profile.bands),
        Tag.of_values(277, SHORT, profile.bands),
        Tag.of_values(339, SHORT, [_SAMPLE_FORMATS[dtype.kind]] * profile.bands),
    ]
    if profile.predictor != 1:
        tags.append(Tag.of_values(317, SHORT, profile.predictor))
    # Overviews carry what a reader needs to show them; place and metadata are the main image's.
    copied = (PHOTOMETRIC, EXTRA_SAMPLES, GDAL_NODATA) if number else tuple(template)
    tags += [_photometric(profile, template[code]) for code in copied if code in template]
    if profile.compression == "jpeg" and profile.bands == 3:
        tags.append(Tag.of_values(530, SHORT, [2, 2]))
        tags.append(Tag.of_values(532, RATIONAL, [0, 1, 255, 1, 128, 1, 255, 1, 128, 1, 255, 1]))
    return Directory(tags, *tiles)


def mask_directory(
    profile: CogProfile, block: int, level: tuple[int, tuple[int, int]], tiles: tuple[Sizes, Sizes]
) -> Directory:
    """Directory of the mask at a level: one bit per pixel."""
    number, size = level
    kind = _MASK | (_REDUCED if number else 0)
    tags = [
        *_common(size, block, kind, COMPRESSION_TAGS[mask_compression(profile)]),
        Tag.of_values(258, SHORT, 1),
        Tag.of_values(PHOTOMETRIC, SHORT, _TRANSPARENCY_MASK),
        Tag.of_values(277, SHORT, 1),
        Tag.of_values(339, SHORT, 1),
    ]
    return Directory(tags, *tiles)


def ghost_area(masked: bool) -> bytes:
    """GDAL's structural metadata: tiles row by row, each between its size and its last four bytes.

    Readers that know it fetch a tile and its size in one request (GDAL, "COG -- Cloud Optimized GeoTIFF
    generator", header ghost area).
    """
    lines = [
        "LAYOUT=IFDS_BEFORE_DATA",
        "BLOCK_ORDER=ROW_MAJOR",
        "BLOCK_LEADER=SIZE_AS_UINT4",
        "BLOCK_TRAILER=LAST_4_BYTES_REPEATED",
        *(["MASK_INTERLEAVED_WITH_IMAGERY=YES"] if masked else []),
        "KNOWN_INCOMPATIBLE_EDITION=NO",
    ]
    # The space is there for editors that turn NO into YES.
    text = "".join(f"{line}\n" for line in lines) + " "
    return f"GDAL_STRUCTURAL_METADATA_SIZE={len(text):06d} bytes\n{text}".encode()


def _common(size: tuple[int, int], block: int, kind: int, compression: int) -> list[Tag]:
    return [
        Tag.of_values(254, LONG, kind),
        Tag.of_values(256, LONG, size[0]),
        Tag.of_values(257, LONG, size[1]),
        Tag.of_values(259, SHORT, compression),
        Tag.of_values(284, SHORT, 1),
        Tag.of_values(322, SHORT, block),
        Tag.of_values(323, SHORT, block),
    ]


def _photometric(profile: CogProfile, tag: Tag) -> Tag:
    if tag.code == PHOTOMETRIC and profile.compression == "jpeg" and profile.bands == 3:
        return Tag.of_values(PHOTOMETRIC, SHORT, _YCBCR)
    return tag
