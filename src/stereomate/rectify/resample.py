"""Resampling of a photograph at given positions: a window of it is read, reduced if need be, and remapped."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stereomate.camera.model import Camera
from stereomate.raster import PhotoReader, Window
from stereomate.rectify.kernels.warp import move
from stereomate.rectify.options import Resampling

Floats32 = NDArray[np.float32]

_FLAGS: dict[str, int] = {
    "nearest": cv2.INTER_NEAREST,
    "bilinear": cv2.INTER_LINEAR,
    "cubic": cv2.INTER_CUBIC,
    "lanczos": cv2.INTER_LANCZOS4,
}
# Pixels on each side of a position that carry weight.
_REACH: dict[str, int] = {"nearest": 1, "bilinear": 1, "cubic": 2, "lanczos": 4}

# Rows that are resampled at once where a window is not full.
_BAND_PX = 128


def resample(
    reader: PhotoReader,
    bands: tuple[int, ...],
    positions: tuple[NDArray[np.float32], NDArray[np.float32]],
    extremes: tuple[float, float, float, float],
    shift: tuple[int, int],
    reduction: int,
    method: Resampling,
    out: NDArray[Any],
    valid: NDArray[np.uint8],
) -> tuple[int, int]:
    """Values of a photograph at positions, written to `out`; `valid` is cleared where the photograph is.

    Parameters
    ----------
    bands : tuple of int
        Bands to take, counted from 0.
    positions : (map_x, map_y), each (rows, cols) float32
        Relative to `shift`, in pixels of the reduced photograph, 0 at the centre of a pixel; moved in place.
    extremes : (min_x, max_x, min_y, max_y) of the positions.
    reduction : int
        Photograph pixels averaged (reduction x reduction) before resampling.
    out : (rows, cols, bands)
    valid : (rows, cols) uint8
        255 where the positions are meant; set to 0 where any pixel with weight is masked in the photograph.

    Returns
    -------
    Column and row of the reduced photograph that the moved positions are counted from.
    """
    min_x, max_x, min_y, max_y = extremes
    reach = _REACH[method]
    col0 = math.floor(min_x) - reach + shift[0]
    row0 = math.floor(min_y) - reach + shift[1]
    col1 = math.floor(max_x) + reach + 2 + shift[0]
    row1 = math.floor(max_y) + reach + 2 + shift[1]
    wanted = Window(col0 * reduction, row0 * reduction, (col1 - col0) * reduction, (row1 - row0) * reduction)
    source, window = reader.read_window(*wanted)
    usable = source_mask(reader, wanted, source)
    source = take_bands(source, bands)
    if reduction > 1:
        source, usable, window = _reduced(source, usable, window, reduction)
    move(*positions, float(shift[0] - window.col0), float(shift[1] - window.row0))
    for part in filled_parts(valid):
        _remap(source, (positions[0][part], positions[1][part]), _FLAGS[method], out[part])
    if usable is not None:
        _clear_masked(usable, positions, method, valid)
    return window.col0, window.row0


def clear_frame(
    camera: Camera,
    positions: tuple[Floats32, Floats32],
    shift: tuple[int, int],
    reduction: int,
    method: Resampling,
    valid: NDArray[np.uint8],
) -> bool:
    """Clear what would take any of the frame of a film into it; whether anything is left.

    Positions as `resample` takes them.
    """
    if camera.format_mm is None:
        return True
    place = [(part + np.float32(0.5) + s) * reduction for part, s in zip(positions, shift, strict=True)]
    # Every pixel with weight has to lie in the picture.
    margin = (_REACH[method] + 0.5) * reduction
    valid[~camera.in_picture(np.stack(place, axis=-1), margin)] = 0
    return bool(valid.any())


def filled_parts(valid: NDArray[np.uint8]) -> list[tuple[slice, slice]]:
    """The parts of a window worth resampling: all of it, or bands of rows cut to their valid columns."""
    rows, cols = valid.shape
    if cv2.countNonZero(valid) == valid.size:
        return [(slice(0, rows), slice(0, cols))]
    parts = []
    for row0 in range(0, rows, _BAND_PX):
        band = slice(row0, min(row0 + _BAND_PX, rows))
        used = np.flatnonzero(valid[band].any(axis=0))
        if used.size:
            parts.append((band, slice(int(used[0]), int(used[-1]) + 1)))
    return parts


def source_mask(reader: PhotoReader, window: Window, source: NDArray[Any]) -> NDArray[np.bool_] | None:
    """Valid pixels of a window, or None where all are; invalid floats are set to 0 in `source`."""
    info = reader.info
    masks: list[NDArray[np.bool_]] = []
    if info.has_mask or info.nodata is not None:
        masks.append(reader.read_mask(*window)[0])
    if source.dtype.kind == "f":
        finite = np.isfinite(source).all(axis=2)
        if not finite.all():
            masks.append(finite)
            source[~finite] = 0.0
    if not masks:
        return None
    mask = masks[0] if len(masks) == 1 else masks[0] & masks[1]
    return None if mask.all() else mask


def take_bands(source: NDArray[Any], bands: tuple[int, ...]) -> NDArray[Any]:
    """The chosen bands, contiguous; the array itself when they are all of them in order."""
    if bands == tuple(range(source.shape[2])):
        return source
    return np.ascontiguousarray(source[:, :, list(bands)])


def _reduced(
    source: NDArray[Any], usable: NDArray[np.bool_] | None, window: Window, factor: int
) -> tuple[NDArray[Any], NDArray[np.bool_] | None, Window]:
    """Average over factor x factor pixels. The window starts on a multiple unless it was clamped to 0."""
    cols, rows = window.cols // factor * factor, window.rows // factor * factor
    size = (cols // factor, rows // factor)
    if 0 in size:
        empty = np.zeros((1, 1, source.shape[2]), source.dtype)
        return empty, np.zeros((1, 1), np.bool_), Window(window.col0 // factor, window.row0 // factor, 1, 1)
    small = cv2.resize(source[:rows, :cols], size, interpolation=cv2.INTER_AREA)
    small = small.reshape(size[1], size[0], source.shape[2])
    if usable is not None:
        blocks = usable[:rows, :cols].reshape(size[1], factor, size[0], factor)
        usable = np.asarray(np.min(blocks, axis=(1, 3)), np.bool_)
    return small, usable, Window(window.col0 // factor, window.row0 // factor, *size)


def _remap(
    source: NDArray[Any],
    positions: tuple[NDArray[np.float32], NDArray[np.float32]],
    flag: int,
    out: NDArray[Any],
) -> None:
    bands = source.shape[2]
    if source.size == 0:
        return
    if bands in (1, 3, 4):
        # OpenCV writes in place where it can address the part, else into a new array.
        result = cv2.remap(source, *positions, flag, dst=out, borderMode=cv2.BORDER_REPLICATE)
        if result is not out:
            out[...] = result.reshape(out.shape)
        return
    for band in range(bands):
        plane = np.ascontiguousarray(source[:, :, band])
        out[:, :, band] = cv2.remap(plane, *positions, flag, borderMode=cv2.BORDER_REPLICATE)


def _clear_masked(
    usable: NDArray[np.bool_],
    positions: tuple[NDArray[np.float32], NDArray[np.float32]],
    method: Resampling,
    valid: NDArray[np.uint8],
) -> None:
    mask = usable.astype(np.uint8)
    if mask.size == 0:
        return
    # Bilinear weights reach the four neighbours; wider kernels see one ring more per extra pixel of reach.
    extra = _REACH[method] - 1
    if extra > 0:
        mask = cv2.erode(mask, np.ones((2 * extra + 1, 2 * extra + 1), np.uint8), borderValue=1)
    flag = cv2.INTER_NEAREST if method == "nearest" else cv2.INTER_LINEAR
    share = cv2.remap(mask * np.uint8(255), *positions, flag, borderMode=cv2.BORDER_REPLICATE)
    valid[share < 254] = 0
