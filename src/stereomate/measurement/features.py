"""Distinct points of a photograph with their descriptors (SIFT, D. Lowe 2004).

Pixels are (column, row) with centres at +0.5. The image is worked through in tiles that overlap, so that
memory is bounded, and the points are spread over the photograph instead of crowding where contrast is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from stereomate.errors import ImageError, InputError

Array = NDArray[np.float64]

# Descriptors reach this far: tiles overlap by it, and points nearer to a tile's edge belong to its neighbour.
_MARGIN_PX: Final = 48


@dataclass(frozen=True)
class FeatureOptions:
    """How many points are wanted and how weak they may be.

    Parameters
    ----------
    max_features : int
        Per image; the strongest of every cell of a grid, so that they are spread.
    contrast : float
        Least contrast of a point, 0 to 1 of the grey range (Lowe: 0.04; low for hazy air photographs).
    edge : float
        Largest ratio of principal curvatures.
    tile_px : int
        Size of the tiles the image is worked through in.
    cells : int
        Cells along the longer side for spreading the points.
    """

    max_features: int = 8000
    contrast: float = 0.02
    edge: float = 10.0
    tile_px: int = 2048
    cells: int = 24

    def __post_init__(self) -> None:
        if self.max_features < 1 or self.cells < 1:
            raise InputError("must be at least 1", field="max_features, cells")
        if self.tile_px < 4 * _MARGIN_PX:
            raise InputError(f"must be at least {4 * _MARGIN_PX}", field="tile_px", value=self.tile_px)
        if not (0.0 < self.contrast < 1.0 and self.edge > 1.0):
            raise InputError("contrast must lie between 0 and 1 and edge above 1", field="contrast, edge")


@dataclass(frozen=True)
class Features:
    """Points of one photograph.

    Parameters
    ----------
    pixels : ndarray, shape (n, 2)
        Column and row.
    size_px, angle : ndarray, shape (n,)
        Diameter of the point's neighbourhood, and its direction (radians, clockwise from the columns).
    response : ndarray, shape (n,)
        Strength.
    descriptors : ndarray of float32, shape (n, 128)
        Of unit length: square roots of SIFT's sums (R. Arandjelović, A. Zisserman 2012), so that the scalar
        product is the similarity.
    """

    pixels: Array
    size_px: Array
    angle: Array
    response: Array
    descriptors: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.pixels)

    def select(self, rows: NDArray[Any]) -> Features:
        """The points of some rows (indices or a mask)."""
        return Features(
            self.pixels[rows],
            self.size_px[rows],
            self.angle[rows],
            self.response[rows],
            self.descriptors[rows],
        )

    def scaled(self, factor: float) -> Features:
        """The same points in an image `factor` times as large."""
        return Features(
            self.pixels * factor, self.size_px * factor, self.angle, self.response, self.descriptors
        )


def grey_image(pixels: NDArray[Any]) -> NDArray[np.uint8]:
    """Grey values 0-255 of an image (rows, cols) or (rows, cols, bands) of any type.

    Bytes keep their values (the first three bands weighted as the eye does); other types are stretched
    between their 0.1 and 99.9 percentiles.

    Raises
    ------
    ImageError
        If the array is not an image.
    """
    image = np.asarray(pixels)
    if image.ndim not in (2, 3) or min(image.shape[:2]) < 1:
        raise ImageError("must be rows x columns (x bands)", field="pixels", value=image.shape)
    if image.ndim == 3:
        bands = image[..., :3] if image.shape[2] >= 3 else image[..., :1]
        weights = np.array([0.299, 0.587, 0.114]) if bands.shape[2] == 3 else np.ones(1)
        if image.dtype == np.uint8 and bands.shape[2] == 3:
            return _bytes(cv2.cvtColor(np.ascontiguousarray(bands), cv2.COLOR_RGB2GRAY))
        image = bands @ weights
    if image.dtype == np.uint8:
        return np.ascontiguousarray(image)
    finite = np.isfinite(image)
    if not finite.any():
        return np.zeros(image.shape, np.uint8)
    low, high = np.percentile(image[finite][:: max(1, finite.sum() // 1_000_000)], [0.1, 99.9])
    stretched = (np.where(finite, image, low) - low) * (255.0 / max(high - low, 1e-12))
    return _bytes(np.clip(np.rint(stretched), 0, 255))


def reduced_image(image: NDArray[np.uint8], factor: int) -> NDArray[np.uint8]:
    """Means over blocks of ``factor`` x ``factor`` pixels; incomplete blocks at the far edges are dropped."""
    if factor <= 1:
        return image
    rows, cols = (side // factor * factor for side in image.shape)
    size = (cols // factor, rows // factor)
    return _bytes(cv2.resize(image[:rows, :cols], size, interpolation=cv2.INTER_AREA))


def detect_features(
    image: NDArray[np.uint8],
    options: FeatureOptions | None = None,
    mask: NDArray[np.bool_] | None = None,
) -> Features:
    """Find and describe points of a grey image.

    Parameters
    ----------
    image : ndarray of uint8, shape (rows, cols)
    options : FeatureOptions, optional
    mask : ndarray of bool, shape (rows, cols), optional
        Where points may lie.

    Returns
    -------
    Features
        In order of falling response.

    Raises
    ------
    ImageError
        If the image is not a grey image of bytes, or the mask has another shape.
    """
    options = options or FeatureOptions()
    if image.ndim != 2 or image.dtype != np.uint8:
        raise ImageError("must be bytes, rows x columns", field="image", value=(image.shape, image.dtype))
    if mask is not None and mask.shape != image.shape:
        raise ImageError("must have the shape of the image", field="mask", value=mask.shape)
    sift = cv2.SIFT.create(
        nfeatures=0,
        contrastThreshold=options.contrast,
        edgeThreshold=options.edge,
        enable_precise_upscale=True,
    )
    parts = [_tile_features(sift, image, mask, box) for box in _tiles(image.shape, options.tile_px)]
    rows = np.concatenate([part[0] for part in parts])
    descriptors = np.concatenate([part[1] for part in parts])
    keep = _spread(rows, image.shape, options)
    rows, descriptors = rows[keep], descriptors[keep]
    total = descriptors.sum(axis=1, keepdims=True)
    return Features(
        rows[:, :2],
        rows[:, 2],
        rows[:, 3],
        rows[:, 4],
        np.sqrt(descriptors / np.maximum(total, 1e-12)).astype(np.float32),
    )


def _bytes(image: Any) -> NDArray[np.uint8]:
    return np.asarray(image, dtype=np.uint8)


def _tiles(shape: tuple[int, ...], size: int) -> list[tuple[int, int, int, int]]:
    """Boxes (row0, row1, col0, col1) of the tiles without their margins."""
    sides = []
    for length in shape:
        count = max(1, -(-length // size))
        edges = np.linspace(0, length, count + 1).astype(int)
        sides.append(list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)))
    return [(*rows, *cols) for rows in sides[0] for cols in sides[1]]


def _tile_features(
    sift: Any, image: NDArray[np.uint8], mask: NDArray[np.bool_] | None, box: tuple[int, int, int, int]
) -> tuple[Array, NDArray[np.float32]]:
    """Rows (column, row, size, angle, response) and descriptors of the points inside a box."""
    row0, row1, col0, col1 = box
    top, left = max(0, row0 - _MARGIN_PX), max(0, col0 - _MARGIN_PX)
    bottom, right = min(image.shape[0], row1 + _MARGIN_PX), min(image.shape[1], col1 + _MARGIN_PX)
    window = np.ascontiguousarray(image[top:bottom, left:right])
    allowed = None
    if mask is not None:
        allowed = np.ascontiguousarray(mask[top:bottom, left:right]).astype(np.uint8) * 255
    points, descriptors = sift.detectAndCompute(window, allowed)
    if descriptors is None or not points:
        return np.empty((0, 5)), np.empty((0, 128), np.float32)
    # OpenCV counts from the centre of the first pixel.
    rows = np.array(
        [(p.pt[0] + left + 0.5, p.pt[1] + top + 0.5, p.size, np.deg2rad(p.angle), p.response) for p in points]
    )
    inside = (rows[:, 0] >= col0) & (rows[:, 0] < col1) & (rows[:, 1] >= row0) & (rows[:, 1] < row1)
    return rows[inside], descriptors[inside]


def _spread(rows: Array, shape: tuple[int, ...], options: FeatureOptions) -> NDArray[np.int64]:
    """Indices of the points to keep: strongest first within every cell, cells served in turn."""
    order = np.lexsort((rows[:, 0], rows[:, 1], -rows[:, 4]))
    if len(rows) <= options.max_features:
        return order
    cell = max(shape) / options.cells
    columns = int(shape[1] / cell) + 1
    number = (rows[order, 1] / cell).astype(int) * columns + (rows[order, 0] / cell).astype(int)
    # Rank of each point within its cell.
    by_cell = np.argsort(number, kind="stable")
    starts = np.flatnonzero(np.r_[True, np.diff(number[by_cell]) != 0])
    lengths = np.diff(np.r_[starts, len(by_cell)])
    rank = np.empty(len(order), dtype=np.int64)
    rank[by_cell] = np.arange(len(by_cell)) - np.repeat(starts, lengths)
    chosen = np.sort(np.argsort(rank, kind="stable")[: options.max_features])
    kept: NDArray[np.int64] = order[chosen]
    return kept
