"""The grid of a product: where each pixel of orthophoto and stereomate lies on the map.

Columns run along u (the direction of the base, along which all parallaxes lie), rows against v. The origin
is the outer corner of the first pixel; u and v are metres in the map plane, measured from the map's origin.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ProductGrid:
    """A raster grid in the map plane, possibly rotated, never mirrored.

    Parameters
    ----------
    u0, v0 : float
        Map coordinates of the outer corner of the first pixel, in the rotated system (metres).
    gsd : float
        Edge of a pixel in map metres.
    size : (int, int)
        Columns and rows.
    rotation : float
        Direction of u, radians from the map's first axis (east) counter-clockwise; 0 is north-up.
    """

    u0: float
    v0: float
    gsd: float
    size: tuple[int, int]
    rotation: float = 0.0

    @property
    def cos_sin(self) -> tuple[float, float]:
        """Cosine and sine of the rotation, exact for a north-up grid."""
        return (1.0, 0.0) if self.rotation == 0.0 else (math.cos(self.rotation), math.sin(self.rotation))

    @property
    def affine(self) -> tuple[float, float, float, float, float, float]:
        """(a, b, c, d, e, f): x = a col + b row + c, y = d col + e row + f (rasterio's order)."""
        c, s = self.cos_sin
        g = self.gsd
        x0, y0 = c * self.u0 - s * self.v0, s * self.u0 + c * self.v0
        return (g * c, g * s, x0, g * s, -g * c, y0)

    def uv_from_map(self, xy: ArrayLike) -> Array:
        """(u, v) of map positions, shape (..., 2)."""
        xy = np.asarray(xy, dtype=np.float64)
        c, s = self.cos_sin
        return np.stack([c * xy[..., 0] + s * xy[..., 1], -s * xy[..., 0] + c * xy[..., 1]], axis=-1)

    def map_from_uv(self, uv: ArrayLike) -> Array:
        """Map positions of (u, v), shape (..., 2)."""
        uv = np.asarray(uv, dtype=np.float64)
        c, s = self.cos_sin
        return np.stack([c * uv[..., 0] - s * uv[..., 1], s * uv[..., 0] + c * uv[..., 1]], axis=-1)

    def pixel_from_map(self, xy: ArrayLike) -> Array:
        """(col, row), the outer corner of the first pixel being (0, 0), of map positions."""
        uv = self.uv_from_map(xy)
        return np.stack([(uv[..., 0] - self.u0) / self.gsd, (self.v0 - uv[..., 1]) / self.gsd], axis=-1)

    def map_from_pixel(self, pixels: ArrayLike) -> Array:
        """Map positions of (col, row)."""
        pixels = np.asarray(pixels, dtype=np.float64)
        u = self.u0 + pixels[..., 0] * self.gsd
        v = self.v0 - pixels[..., 1] * self.gsd
        return self.map_from_uv(np.stack([u, v], axis=-1))

    @classmethod
    def covering(
        cls, xy: ArrayLike, gsd: float, rotation: float = 0.0, *, margin: float = 0.0
    ) -> ProductGrid:
        """The smallest grid that covers map positions, its origin on whole GSDs.

        A position on a grid line to within 1e-6 of a pixel does not open another pixel.
        """
        probe = cls(0.0, 0.0, gsd, (1, 1), rotation)
        uv = probe.uv_from_map(xy).reshape(-1, 2)
        low, high = uv.min(axis=0) - margin, uv.max(axis=0) + margin
        first = np.floor(low / gsd + 1e-6).astype(np.int64)
        last = np.ceil(high / gsd - 1e-6).astype(np.int64)
        cols, rows = (int(max(1, n)) for n in last - first)
        return cls(float(first[0] * gsd), float(last[1] * gsd), gsd, (cols, rows), rotation)

    def corners(self) -> Array:
        """Map positions of the four outer corners, shape (4, 2), starting at the first pixel, clockwise."""
        cols, rows = self.size
        return self.map_from_pixel([(0, 0), (cols, 0), (cols, rows), (0, rows)])
