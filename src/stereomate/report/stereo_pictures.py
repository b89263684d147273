"""Pictures of products: thumbnails and anaglyphs, from the rasters."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stereomate.raster import open_photo
from stereomate.raster.thumbnail import read_thumbnail
from stereomate.raster.windows import Window

Pixels = NDArray[np.uint8]

# Colour of what is not there.
EMPTY = 235


def png_uri(pixels: Pixels) -> str:
    """A data URI of an RGB picture."""
    done, data = cv2.imencode(
        ".png", np.ascontiguousarray(pixels[..., ::-1]), [cv2.IMWRITE_PNG_COMPRESSION, 7]
    )
    if not done:
        raise ValueError("the picture cannot be encoded")
    return "data:image/png;base64," + base64.b64encode(data.tobytes()).decode()


def jpeg_uri(pixels: Pixels, quality: int = 88) -> str:
    """A data URI of an RGB picture, smaller and lossy."""
    done, data = cv2.imencode(
        ".jpg", np.ascontiguousarray(pixels[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, quality]
    )
    if not done:
        raise ValueError("the picture cannot be encoded")
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode()


def stretch_limits(pixels: NDArray[Any], valid: NDArray[np.bool_]) -> tuple[float, float]:
    """Limits that both eyes are stretched with: 0 to 255 for 8 bits, else the 1 and 99 percentiles."""
    if pixels.dtype == np.uint8:
        return 0.0, 255.0
    if not valid.any():
        return 0.0, 1.0
    low, high = np.percentile(pixels[valid][:, : min(3, pixels.shape[2])], (1.0, 99.0))
    return float(low), float(max(high, low + 1e-6))


def as_rgb(pixels: NDArray[Any], valid: NDArray[np.bool_], limits: tuple[float, float]) -> Pixels:
    """Three bands of 8 bits, light grey where not valid."""
    low, high = limits
    bands = pixels[..., :3] if pixels.shape[2] >= 3 else np.repeat(pixels[..., :1], 3, axis=2)
    scaled = (bands.astype(np.float32) - low) * (255.0 / (high - low))
    rgb: Pixels = np.clip(np.nan_to_num(scaled), 0.0, 255.0).astype(np.uint8)
    rgb[~valid] = EMPTY
    return rgb


def grey_anaglyph(left: Pixels, right: Pixels, both: NDArray[np.bool_]) -> Pixels:
    """Red-cyan anaglyph of the luminances: left eye red, right eye cyan; empty where an eye has nothing."""
    weights = np.array([0.299, 0.587, 0.114], np.float32)
    out = np.empty_like(left)
    out[..., 0] = (left @ weights).astype(np.uint8)
    out[..., 1] = out[..., 2] = (right @ weights).astype(np.uint8)
    out[~both] = EMPTY
    return out


def product_pictures(
    folder: Path, ortho: str, mate: str | None, parallax_px: float, longest_px: int = 1000
) -> dict[str, Pixels]:
    """Thumbnails of orthophoto and stereomate, and the anaglyph of the whole.

    Ground of the artificial parallax `parallax_px` lies in the plane of the screen.
    """
    left, left_valid, step = read_thumbnail(folder / ortho, longest_px)
    limits = stretch_limits(left, left_valid)
    pictures = {"ortho": as_rgb(left, left_valid, limits)}
    if mate is not None:
        right, right_valid, _ = read_thumbnail(folder / mate, longest_px)
        pictures["mate"] = as_rgb(right, right_valid, limits)
        shift = round(parallax_px / step)
        moved = np.roll(pictures["mate"], shift, axis=1)
        both = left_valid & np.roll(right_valid, shift, axis=1)
        pictures["anaglyph"] = grey_anaglyph(pictures["ortho"], moved, both)
    return pictures


def detail_anaglyph(
    folder: Path, ortho: str, mate: str, centre: tuple[float, float], parallax_px: float, edge: int = 700
) -> Pixels:
    """Anaglyph of a detail at full resolution, the ground of its centre in the plane of the screen.

    Parameters
    ----------
    centre : (col, row)
        In the orthophoto.
    parallax_px : float
        Artificial parallax of the ground there: the stereomate is moved by it.
    """
    col0, row0 = round(centre[0]) - edge // 2, round(centre[1]) - edge // 2
    shift = round(parallax_px)
    left, left_valid = _window(folder / ortho, Window(col0, row0, edge, edge))
    right, right_valid = _window(folder / mate, Window(col0 - shift, row0, edge, edge))
    limits = stretch_limits(left, left_valid)
    return grey_anaglyph(
        as_rgb(left, left_valid, limits), as_rgb(right, right_valid, limits), left_valid & right_valid
    )


def _window(path: Path, window: Window) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Pixels of a window that may reach beyond the raster."""

    with open_photo(path) as reader:
        inside = window.clamped(reader.size)
        pixels = np.zeros((window.rows, window.cols, reader.bands), reader.dtype)
        valid = np.zeros((window.rows, window.cols), np.bool_)
        if not inside.is_empty:
            place = (
                slice(inside.row0 - window.row0, inside.row1 - window.row0),
                slice(inside.col0 - window.col0, inside.col1 - window.col0),
            )
            pixels[place] = reader.read_window(*inside)[0]
            valid[place] = reader.read_mask(*inside)[0]
    return pixels, valid
