"""Orthophoto and stereomate as tiles that a browser shows, at every level, both eyes stretched alike."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import imagecodecs
import numpy as np
from numpy.typing import NDArray

from stereomate.raster.pyramid import PyramidReader, open_pyramid
from stereomate.viewer.kept import Kept

TileFormat = Literal["jpg", "png"]

# Edge of a tile without its apron, and pixels of the neighbours around it: with them the GPU interpolates
# across the border of two tiles as if there were none.
TILE: Final = 512
APRON: Final = 1
# Parts of the pixels of the orthophoto that the stretch lets go black and white.
_TAILS: Final = (0.5, 99.5)
_SAMPLE_PX: Final = 1024
# Where the pixels of a neighbour lie in a tile: before it, beside it, behind it.
_OUTER: Final = {-1: slice(0, APRON), 0: slice(APRON, -APRON), 1: slice(-APRON, None)}


@dataclass(frozen=True)
class Stretch:
    """Which values are black and white, for each band shown; the same for both eyes.

    Attributes
    ----------
    bands : tuple of int
        Indices of the bands shown: one (grey) or three (red, green, blue).
    low, high : tuple of float
    """

    bands: tuple[int, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]

    def apply(self, pixels: NDArray[Any]) -> NDArray[np.uint8]:
        """Bands shown as bytes, (rows, cols, bands)."""
        if pixels.dtype == np.uint8:
            if self.bands == tuple(range(pixels.shape[2])):
                return pixels
            return np.ascontiguousarray(pixels[..., list(self.bands)])
        low, high = np.array(self.low, np.float32), np.array(self.high, np.float32)
        shown = pixels[..., list(self.bands)].astype(np.float32)
        scaled = np.nan_to_num((shown - low) * (255.0 / (high - low)))
        return np.asarray(np.clip(np.rint(scaled), 0.0, 255.0), np.uint8)


def stretch_of(path: Path) -> Stretch:
    """The stretch of a product, from its orthophoto: bytes as they are, others between percentiles."""
    with open_pyramid(path) as image:
        roles = image.info.roles
        colours = tuple(roles.index(name) for name in ("red", "green", "blue") if name in roles)
        usable = image.info.colour_bands
        bands = colours if len(colours) == 3 else usable[:3] if len(usable) >= 3 else usable[:1]
        if image.info.dtype == np.uint8:
            return Stretch(bands, (0.0,) * len(bands), (255.0,) * len(bands))
        level = image.levels(_SAMPLE_PX) - 1
        pixels, valid, _ = image.read(level, 0, 0, *image.size(level))
    sample = pixels[valid][:, list(bands)].astype(np.float64)
    if not len(sample):
        return Stretch(bands, (0.0,) * len(bands), (1.0,) * len(bands))
    low, high = np.percentile(sample, _TAILS, axis=0)
    high = np.maximum(high, low + 1e-6 * np.maximum(1.0, np.abs(low)))
    return Stretch(bands, tuple(low.tolist()), tuple(high.tolist()))


class TileReader:
    """Tiles of one raster, with their aprons, made of blocks that were read lately.

    A tile needs a pixel of each of its eight neighbours, which a file keeps in nine blocks: read one by one
    and kept for a while, each is decoded once for all around it. Safe to use from any number of threads.
    """

    def __init__(self, image: PyramidReader, stretch: Stretch) -> None:
        self.image, self._stretch = image, stretch
        self._blocks: Kept[tuple[int, int, int], NDArray[np.uint8]] = Kept(lambda block: block.nbytes)

    def read(self, level: int, col: int, row: int) -> NDArray[np.uint8]:
        """A tile with its apron, (rows + 2, cols + 2, bands); where the image ends its pixels are repeated.

        What is not valid is black.

        Raises
        ------
        KeyError
            If there is no such tile.
        """
        if not self._exists(level, col, row):
            raise KeyError((level, col, row))
        middle = self._block(level, col, row)
        rows, cols, bands = middle.shape
        tile = np.empty((rows + 2 * APRON, cols + 2 * APRON, bands), np.uint8)
        tile[APRON:-APRON, APRON:-APRON] = middle
        for down in (-1, 0, 1):
            for right in (-1, 0, 1):
                if down or right:
                    # where there is no neighbour the tile's own edge stands in for it
                    across = right if self._exists(level, col + right, row) else 0
                    along = down if self._exists(level, col, row + down) else 0
                    near = self._block(level, col + across, row + along)
                    tile[_OUTER[down], _OUTER[right]] = near[
                        _inner(down, along, rows), _inner(right, across, cols)
                    ]
        return tile

    def _exists(self, level: int, col: int, row: int) -> bool:
        cols, rows = self.image.size(level)
        return 0 <= col * TILE < cols and 0 <= row * TILE < rows

    def _block(self, level: int, col: int, row: int) -> NDArray[np.uint8]:
        return self._blocks.get((level, col, row), self._made)

    def _made(self, place: tuple[int, int, int]) -> NDArray[np.uint8]:
        level, col, row = place
        pixels, valid, _ = self.image.read(level, col * TILE, row * TILE, TILE, TILE)
        shown = self._stretch.apply(pixels)
        if not valid.all():
            shown[~valid] = 0
        return shown


def _inner(side: int, towards: int, size: int) -> slice:
    """Pixels of the block `towards` a side (0: the tile's own) that a tile of `size` shows at that side."""
    if side == 0:
        return slice(0, size)
    # the end of the block before, the beginning of the one behind; of the tile's own the edge itself
    return slice(-APRON, None) if (side < 0) == (towards != 0) else slice(0, APRON)


def encode_image(pixels: NDArray[np.uint8], kind: TileFormat, quality: int) -> bytes:
    """Pixels (rows, cols, 1 or 3) as a JPEG, or as a PNG without loss.

    Colours are never subsampled: each eye of an anaglyph sees only some of them.
    """
    shown = pixels[..., 0] if pixels.shape[2] == 1 else pixels
    if kind == "png":
        return bytes(imagecodecs.png_encode(shown, level=3))
    return bytes(imagecodecs.jpeg_encode(np.ascontiguousarray(shown), level=quality, subsampling="444"))
