"""Orthophoto and stereomate as tiles that a browser shows, at every level, both eyes stretched alike."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import imagecodecs
import numpy as np
from numpy.typing import NDArray

from stereomate.raster.pyramid import PyramidReader, open_pyramid

TileFormat = Literal["jpg", "png"]

# Edge of a tile without its apron, and pixels of the neighbours around it: with them the GPU interpolates
# across the border of two tiles as if there were none.
TILE: Final = 512
APRON: Final = 1
# Parts of the pixels of the orthophoto that the stretch lets go black and white.
_TAILS: Final = (0.5, 99.5)
_SAMPLE_PX: Final = 1024


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


def read_tile(image: PyramidReader, stretch: Stretch, level: int, col: int, row: int) -> NDArray[np.uint8]:
    """A tile with its apron, (rows + 2, cols + 2, bands); at the edge of the image its pixels are repeated.

    What is not valid is black.

    Raises
    ------
    KeyError
        If there is no such tile.
    """
    cols, rows = image.size(level)
    col0, row0 = col * TILE, row * TILE
    if not (0 <= col0 < cols and 0 <= row0 < rows):
        raise KeyError((level, col, row))
    pixels, valid, window = image.read(level, col0 - APRON, row0 - APRON, TILE + 2 * APRON, TILE + 2 * APRON)
    shown = stretch.apply(pixels)
    if not valid.all():
        shown[~valid] = 0
    before = (window.row0 - (row0 - APRON), window.col0 - (col0 - APRON))
    wanted = (min(TILE, rows - row0) + 2 * APRON, min(TILE, cols - col0) + 2 * APRON)
    after = tuple(wanted[k] - before[k] - shown.shape[k] for k in range(2))
    if any(before) or any(after):
        shown = np.pad(shown, ((before[0], after[0]), (before[1], after[1]), (0, 0)), mode="edge")
    return shown


def encode_image(pixels: NDArray[np.uint8], kind: TileFormat, quality: int) -> bytes:
    """Pixels (rows, cols, 1 or 3) as a JPEG, or as a PNG without loss.

    Colours are never subsampled: each eye of an anaglyph sees only some of them.
    """
    shown = pixels[..., 0] if pixels.shape[2] == 1 else pixels
    if kind == "png":
        return bytes(imagecodecs.png_encode(shown, level=3))
    return bytes(imagecodecs.jpeg_encode(np.ascontiguousarray(shown), level=quality, subsampling="444"))
