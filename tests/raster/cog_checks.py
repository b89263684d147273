"""Checks of the structure of a Cloud Optimized GeoTIFF, after GDAL's validate_cloud_optimized_geotiff."""

from __future__ import annotations

import itertools
import struct
from dataclasses import dataclass
from pathlib import Path

import tifffile


@dataclass
class Image:
    """A directory of the file: where it stands, what it is, where its tiles are."""

    ifd: int
    kind: int
    shape: tuple[int, ...]
    offsets: tuple[int, ...]
    sizes: tuple[int, ...]

    @property
    def is_mask(self) -> bool:
        return bool(self.kind & 4)


def images_of(path: Path) -> list[Image]:
    with tifffile.TiffFile(path) as file:
        return [
            Image(page.offset, int(page.subfiletype), page.shape, page.dataoffsets, page.databytecounts)
            for page in file.pages
        ]


def require_valid(path: Path) -> list[Image]:
    """Raise AssertionError unless the file is laid out as GDAL's COG driver does; its directories."""
    data = path.read_bytes()
    big = data[:4] == b"II\x2b\x00"
    assert big or data[:4] == b"II\x2a\x00"
    images = images_of(path)
    _require_ghost(data, big, images)
    pictures = [image for image in images if not image.is_mask]
    masks = [image for image in images if image.is_mask]
    assert pictures[0].kind == 0
    assert all(image.kind == 1 for image in pictures[1:])
    assert [image.ifd for image in images] == sorted(image.ifd for image in images)
    for larger, smaller in itertools.pairwise(pictures):
        assert smaller.shape[0] == -(-larger.shape[0] // 2)
        assert smaller.shape[1] == -(-larger.shape[1] // 2)
        first = [next((o for o in image.offsets if o), None) for image in (larger, smaller)]
        assert None in first or first[0] > first[1]
    assert max(pictures[-1].shape[:2]) <= 512
    last_ifd = max(image.ifd for image in images)
    assert all(offset == 0 or offset > last_ifd for image in images for offset in image.offsets)
    if masks:
        assert [mask.shape[:2] for mask in masks] == [image.shape[:2] for image in pictures]
    ends = [len(data)]
    for number, image in enumerate(pictures):
        used = [offset for offset in image.offsets if offset]
        assert used == sorted(used)
        for tile, (offset, size) in enumerate(zip(image.offsets, image.sizes, strict=True)):
            _require_framed(data, offset, size)
            if masks:
                mask = masks[number]
                _require_framed(data, mask.offsets[tile], mask.sizes[tile])
                assert mask.offsets[tile] == (offset + size + 8 if offset else 0)
                offset, size = mask.offsets[tile], mask.sizes[tile]
            ends.append(offset + size + 4 if offset else 0)
    assert max(ends) == len(data)
    return images


def _require_ghost(data: bytes, big: bool, images: list[Image]) -> None:
    start = 16 if big else 8
    assert data[start:].startswith(b"GDAL_STRUCTURAL_METADATA_SIZE=")
    size = int(data[start + 30 : start + 36])
    begin = start + 43
    text = data[begin : begin + size].decode()
    assert "LAYOUT=IFDS_BEFORE_DATA\nBLOCK_ORDER=ROW_MAJOR\nBLOCK_LEADER=SIZE_AS_UINT4\n" in text
    assert text.endswith("KNOWN_INCOMPATIBLE_EDITION=NO\n ")
    assert ("MASK_INTERLEAVED_WITH_IMAGERY=YES" in text) == any(image.is_mask for image in images)
    assert images[0].ifd == begin + size + (begin + size) % 2


def _require_framed(data: bytes, offset: int, size: int) -> None:
    assert (offset == 0) == (size == 0)
    if size:
        assert struct.unpack("<I", data[offset - 4 : offset])[0] == size
        assert data[offset + size : offset + size + 4] == data[offset + size - 4 : offset + size]
