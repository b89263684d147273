"""Codecs of tiles and masks. Encoded bytes go into a buffer of the caller; nothing is allocated per tile."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Final, cast

import imagecodecs as typed_imagecodecs
import numpy as np
from numpy.typing import NDArray

from stereomate.raster.cog.profile import CogProfile

# Its annotations know bytes only; it takes any buffer.
imagecodecs: Any = typed_imagecodecs

# TIFF's numbers of the codecs.
COMPRESSION_TAGS: Final = {"none": 1, "jpeg": 7, "deflate": 8, "zstd": 50000, "webp": 50001}
_MASK_DEFLATE_LEVEL: Final = 6


def encode_tile(profile: CogProfile, tile: NDArray[Any], out: memoryview) -> int:
    """Encode a tile (its predictor applied already) to the beginning of `out`.

    Parameters
    ----------
    profile : CogProfile
    tile : ndarray, shape (block, block, bands)
        C-contiguous.
    out : memoryview of bytes
        At least `bound_of` long.

    Returns
    -------
    int
        Bytes written.
    """
    level = profile.codec_level
    if profile.compression == "zstd":
        return len(imagecodecs.zstd_encode(tile, level=level, out=out))
    if profile.compression == "deflate":
        return len(imagecodecs.deflate_encode(tile, level=level, out=out))
    if profile.compression == "none":
        data: Any = tile.reshape(-1).view(np.uint8).data
    elif profile.compression == "jpeg":
        data = _jpeg(tile, level)
    else:
        # Method 4 is libwebp's default; 100 means without loss, as in GDAL.
        lossless = level == 100
        data = imagecodecs.webp_encode(tile, level=level, lossless=lossless)
    out[: len(data)] = data
    return len(data)


def bound_of(tile_bytes: int) -> int:
    """Bytes an encoded tile may take; more than any codec here makes of noise."""
    return tile_bytes + tile_bytes // 8 + 4096


def _jpeg(tile: NDArray[Any], quality: int) -> bytes:
    if tile.shape[2] == 1:
        return cast(bytes, imagecodecs.jpeg8_encode(tile[..., 0], level=quality))
    return cast(
        bytes,
        imagecodecs.jpeg8_encode(
            tile, level=quality, colorspace="RGB", outcolorspace="YCBCR", subsampling="420"
        ),
    )


def mask_compression(profile: CogProfile) -> str:
    """Codec of the mask's tiles: the image's where it is one for bits, else deflate."""
    return profile.compression if profile.compression in ("zstd", "deflate", "none") else "deflate"


def encode_mask(profile: CogProfile, valid: NDArray[np.uint8]) -> bytes:
    """Encode a tile of validity (block, block) as one bit per pixel, 1 valid."""
    bits = np.packbits(valid, axis=1)
    compression = mask_compression(profile)
    if compression == "zstd":
        return cast(bytes, imagecodecs.zstd_encode(bits, level=profile.codec_level))
    if compression == "deflate":
        return cast(bytes, imagecodecs.deflate_encode(bits, level=_MASK_DEFLATE_LEVEL))
    return bits.tobytes()


@lru_cache(maxsize=64)
def encode_full_mask(profile: CogProfile, block: int, cols: int, rows: int) -> bytes:
    """Mask of a tile that is valid in its first columns and rows, which is the image's inside it."""
    valid = np.zeros((block, block), np.uint8)
    valid[:rows, :cols] = 1
    return encode_mask(profile, valid)


def pack(array: NDArray[Any]) -> bytes:
    """Any array as few bytes, without loss."""
    return cast(bytes, imagecodecs.zstd_encode(array, level=1))


def unpack(data: bytes, dtype: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """The array that `pack` made into bytes."""
    return np.frombuffer(imagecodecs.zstd_decode(data), dtype).reshape(shape)
