"""The site of a product whose pictures are replaced by patterns that are known at every pixel."""

from __future__ import annotations

import json
import re

import numpy as np

from stereomate.viewer.imagery import TILE, encode_image
from stereomate.viewer.site import Site

_TILE = re.compile(r"data/0/(ortho|mate)/(\d+)/(\d+)_(\d+)\.(jpg|png)")


def pattern(eye: str, col: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Colours (..., 3) that say the pixel, different for both eyes."""
    col, row = np.broadcast_arrays(col, row)
    if eye == "ortho":
        return np.stack([(3 * col) % 251, (5 * row) % 241, (col + 2 * row) % 239], axis=-1).astype(np.uint8)
    return np.stack([(7 * row) % 251, (2 * col + row) % 241, (3 * col) % 233], axis=-1).astype(np.uint8)


class PatternSite:
    """The files of a site; pictures at full resolution hold `pattern`, those of coarser levels are grey."""

    def __init__(self, site: Site) -> None:
        self.site = site
        self.size = site.sources[0].product.job.grid.size

    def read(self, name: str) -> bytes:
        """As `Site.read`."""
        if name == "data/0/product.json":
            record = json.loads(self.site.read(name))
            record["tiles"]["format"] = "png"
            record["key"] = record["version"] = "pattern"
            return json.dumps(record).encode()
        found = _TILE.fullmatch(name)
        if not found:
            return self.site.read(name)
        level, tile_col, tile_row = (int(found[k]) for k in (2, 3, 4))
        cols, rows = (-(-n >> level) for n in self.size)
        width, height = min(TILE, cols - tile_col * TILE), min(TILE, rows - tile_row * TILE)
        if level:
            return encode_image(np.full((height + 2, width + 2, 3), 90, np.uint8), "png", 90)
        col = np.clip(np.arange(-1, width + 1) + tile_col * TILE, 0, cols - 1)
        row = np.clip(np.arange(-1, height + 1) + tile_row * TILE, 0, rows - 1)
        return encode_image(pattern(found[1], col[None, :], row[:, None]), "png", 90)
