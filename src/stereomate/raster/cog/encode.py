"""What a task does with its pixels: encode each tile once, with the overviews that lie inside the chunk."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import InputError
from stereomate.raster.cog import kernels
from stereomate.raster.cog.blob import BlobHeader
from stereomate.raster.cog.codecs import bound_of, encode_full_mask, encode_mask, encode_tile, pack, unpack
from stereomate.raster.cog.layout import Layout, chunk_levels, overview_count
from stereomate.raster.cog.profile import CogProfile
from stereomate.raster.cog.statistics import statistics_of
from stereomate.raster.scratch import SCRATCH

_NO_MASK = np.empty((0, 0), np.uint8)


@dataclass(frozen=True)
class Patch:
    """Pixels of one level of a chunk, or of one tile: (rows, cols, bands), and which of them are valid.

    `valid` is uint8 (rows, cols), None where all are.
    """

    pixels: NDArray[Any]
    valid: NDArray[np.uint8] | None

    @property
    def mask(self) -> NDArray[np.uint8]:
        """Validity as kernels take it; not looked at where all are valid."""
        return _NO_MASK if self.valid is None else self.valid


def encode_chunk(
    profile: CogProfile, layout: Layout, pixels: NDArray[Any], valid: NDArray[np.bool_] | None = None
) -> bytes:
    """The blob of a chunk: its encoded tiles and overviews, statistics, and what coarser levels need.

    Parameters
    ----------
    profile : CogProfile
        What the file is to be.
    layout : TilePlan
        The plan the chunk is from.
    pixels : ndarray of the profile's type, shape (rows, cols, bands) or (rows, cols) for one band
        The chunk's window; fastest if C-contiguous. What invalid pixels hold does not matter.
    valid : ndarray of bool, shape (rows, cols), optional
        Without it, pixels with any sample other than nodata are valid, all if the profile has no nodata.

    Returns
    -------
    bytes
        For `stereomate.tiles.Ledger.put`, and from there `assemble_cog`.

    Raises
    ------
    InputError
        If type or shape is not the profile's.
    """
    patch = _checked(profile, layout, pixels, valid)
    if patch.valid is not None and not patch.valid.any():
        return BlobHeader((), (0, 0), ()).to_bytes()
    statistics = statistics_of(profile, patch.pixels, patch.valid) if profile.statistics else ()
    arena = SCRATCH.array("arena", (_arena_bytes(profile, layout, patch),), np.uint8).data
    sizes: list[tuple[int, int]] = []
    end = 0
    last = chunk_levels(layout)
    for level in range(last + 1):
        for tile_sizes in _encode_level(profile, layout.block, patch, arena[end:]):
            sizes.append(tile_sizes)
            end += sum(tile_sizes)
        if level < last:
            patch = halved(profile, patch, f"level {level % 2}")
    reduced = (0, 0)
    if overview_count(layout) > last:
        parts = pack_patch(halved(profile, patch, f"level {last % 2}"))
        reduced = (len(parts[0]), len(parts[1]))
        for part in parts:
            arena[end : end + len(part)] = part
            end += len(part)
    header = BlobHeader(tuple(sizes), reduced, statistics).to_bytes()
    return b"".join((header, arena[:end]))


def _checked(
    profile: CogProfile, layout: Layout, pixels: NDArray[Any], valid: NDArray[np.bool_] | None
) -> Patch:
    if pixels.ndim == 2:
        pixels = pixels[..., np.newaxis]
    if pixels.ndim != 3 or pixels.shape[2] != profile.bands:
        raise InputError(f"must be (rows, cols, {profile.bands})", field="pixels", value=pixels.shape)
    if pixels.dtype != profile.numpy_dtype:
        raise InputError(f"must be {profile.dtype}", field="pixels", value=str(pixels.dtype))
    edge = layout.block * layout.chunk_tiles
    if not (0 < pixels.shape[0] <= edge and 0 < pixels.shape[1] <= edge):
        raise InputError(f"must have 1 to {edge} rows and columns", field="pixels", value=pixels.shape)
    pixels = np.ascontiguousarray(pixels)
    if valid is None:
        return Patch(pixels, _valid_by_nodata(profile, pixels))
    if valid.shape != pixels.shape[:2]:
        raise InputError(f"must be {pixels.shape[:2]}", field="valid", value=valid.shape)
    if not profile.mask and profile.nodata is None and not valid.all():
        raise InputError("must be all valid in a file without mask and nodata", field="valid")
    return Patch(pixels, _none_if_full(np.ascontiguousarray(valid, dtype=np.bool_).view(np.uint8)))


def _valid_by_nodata(profile: CogProfile, pixels: NDArray[Any]) -> NDArray[np.uint8] | None:
    if profile.nodata is None:
        return None
    valid = SCRATCH.array("valid", pixels.shape[:2], np.uint8)
    count = kernels.valid_by_nodata(pixels, profile.numpy_dtype.type(profile.nodata), valid)
    return None if count == valid.size else valid


def _none_if_full(valid: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
    return None if valid.all() else valid


def _arena_bytes(profile: CogProfile, layout: Layout, patch: Patch) -> int:
    """Room for all tiles, should none of them compress; only what is used is ever touched."""
    tile = layout.block * layout.block * profile.bands * profile.numpy_dtype.itemsize
    mask = layout.block * layout.block // 8 if profile.mask else 0
    per_side = layout.chunk_tiles
    tiles = sum((per_side >> level) ** 2 for level in range(per_side.bit_length()))
    return (tiles + 1) * (bound_of(tile) + bound_of(mask)) + bound_of(patch.pixels.nbytes)


def _encode_level(profile: CogProfile, block: int, patch: Patch, arena: memoryview) -> list[tuple[int, int]]:
    rows, cols = patch.pixels.shape[:2]
    sizes, end = [], 0
    for row0 in range(0, rows, block):
        for col0 in range(0, cols, block):
            tile_sizes = encode_tile_of(profile, block, patch, (col0, row0), arena[end:])
            sizes.append(tile_sizes)
            end += sum(tile_sizes)
    return sizes


def encode_tile_of(
    profile: CogProfile, block: int, patch: Patch, place: tuple[int, int], out: memoryview
) -> tuple[int, int]:
    """Encode the tile of a patch that begins at (column, row) and its mask, one after the other.

    Returns
    -------
    data, mask : int
        Bytes written of each; 0 for a tile without a valid pixel, and for the mask if there is none.
    """
    col0, row0 = place
    valid = None
    if patch.valid is not None:
        valid = _none_if_full(patch.valid[row0 : row0 + block, col0 : col0 + block])
        if valid is not None and not valid.any():
            return (0, 0)
    tile = _predicted(profile, block, patch if valid is not None else Patch(patch.pixels, None), place)
    size = encode_tile(profile, tile, out)
    if not profile.mask:
        return (size, 0)
    if valid is None:
        rows, cols = (min(block, n - at) for n, at in zip(patch.pixels.shape[:2], (row0, col0), strict=True))
        mask = encode_full_mask(profile, block, cols, rows)
    else:
        whole = np.zeros((block, block), np.uint8)
        whole[: valid.shape[0], : valid.shape[1]] = valid
        mask = encode_mask(profile, whole)
    out[size : size + len(mask)] = mask
    return (size, len(mask))


def _predicted(profile: CogProfile, block: int, patch: Patch, place: tuple[int, int]) -> NDArray[Any]:
    """The pixels of a tile as the codec gets them: filled, nodata kept apart, predictor applied."""
    col0, row0 = place
    shape, dtype = (block, block, profile.bands), profile.numpy_dtype
    tile = SCRATCH.array("tile", shape, dtype)
    if profile.predictor == 2 and patch.valid is None and profile.nodata is None:
        kernels.take_differences(patch.pixels, row0, col0, tile)
        return tile
    fill, nudged = dtype.type(profile.fill), dtype.type(profile.nudged)
    masked = patch.valid is not None
    kernels.fill_tile(patch.pixels, patch.mask, masked, row0, col0, fill, nudged, tile)
    if profile.predictor == 1:
        return tile
    predicted = SCRATCH.array("predicted", shape, dtype)
    if profile.predictor == 2:
        kernels.take_differences(tile, 0, 0, predicted)
    else:
        width = block * profile.bands * dtype.itemsize
        source, target = (a.view(np.uint8).reshape(block, width) for a in (tile, predicted))
        kernels.take_float_differences(source, profile.bands, target)
    return predicted


def halved(profile: CogProfile, patch: Patch, name: str) -> Patch:
    """The next level of a patch, in buffers of this name."""
    rows, cols = (-(-n // 2) for n in patch.pixels.shape[:2])
    out = SCRATCH.array(f"{name} pixels", (rows, cols, profile.bands), profile.numpy_dtype)
    masked = patch.valid is not None
    out_valid = SCRATCH.array(f"{name} valid", (rows, cols) if masked else (0, 0), np.uint8)
    if profile.overviews == "nearest":
        kernels.halve_nearest(patch.pixels, patch.mask, masked, out, out_valid)
    elif profile.dtype == "float32":
        kernels.halve_floats(patch.pixels, patch.mask, masked, out, out_valid)
    else:
        width = patch.pixels.shape[1] * profile.bands
        sums = SCRATCH.array("sums", (width,), np.uint16 if profile.dtype == "uint8" else np.int32)
        kernels.halve_integers(patch.pixels, patch.mask, masked, sums, out, out_valid)
    return Patch(out, _none_if_full(out_valid) if masked else None)


def pack_patch(patch: Patch) -> tuple[bytes, bytes]:
    """A patch as bytes, without loss: pixels, and validity (nothing where all are valid)."""
    return pack(patch.pixels), b"" if patch.valid is None else pack(patch.valid)


def unpack_patch(profile: CogProfile, size: tuple[int, int], pixels: bytes, valid: bytes) -> Patch:
    """The patch of (columns, rows) that `pack_patch` made into bytes."""
    cols, rows = size
    mask = unpack(valid, np.dtype(np.uint8), (rows, cols)) if valid else None
    return Patch(unpack(pixels, profile.numpy_dtype, (rows, cols, profile.bands)), mask)
