"""Photographs of a block: their grey values and their features."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.model import Camera
from stereomate.errors import ImageError
from stereomate.measurement.features import Features, grey_image
from stereomate.raster import open_photo
from stereomate.relative.feature_pairs import AutomaticOptions, photo_features

# Half the width of the window that describes a feature, in its diameters.
_DESCRIBED: Final = 3.0


@dataclass(frozen=True)
class BlockPhoto:
    """A photograph of a block: its number in the database (from 1), file, camera and fingerprint.

    `format_mm` is the width and height of the picture about the fiducial centre of film: what lies beyond is
    the frame with its marks, the same in every photograph.
    """

    number: int
    name: str
    path: Path
    camera: Camera
    digest: str
    format_mm: tuple[float, float] | None = None


def grey_of_photo(photo: BlockPhoto) -> NDArray[np.uint8]:
    """Grey values of a whole photograph.

    Raises
    ------
    ImageError
        If it cannot be read or is not of its camera's size.
    """
    columns, rows = photo.camera.size_px
    with open_photo(photo.path) as reader:
        if reader.info.size != (columns, rows):
            raise ImageError(
                f"must have the {columns} x {rows} pixels of camera {photo.camera.name}",
                file=photo.path,
                value=f"{reader.info.size[0]} x {reader.info.size[1]}",
            )
        reader.require_complete()
        pixels, _ = reader.read_window(0, 0, columns, rows)
    return grey_image(pixels)


def features_of_photo(photo: BlockPhoto, options: AutomaticOptions) -> Features:
    """Features of a photograph; those of a mirrored scan are found in it mirrored back.

    Descriptors know any turn, but no mirror: a film that lay face down would match none that lay face up.
    """
    grey = grey_of_photo(photo)
    if is_mirrored(photo.camera):
        found = photo_features(np.ascontiguousarray(grey[:, ::-1]), options)
        pixels = found.pixels * [-1.0, 1.0] + [grey.shape[1], 0.0]
        found = replace(found, pixels=pixels, angle=np.pi - found.angle)
    else:
        found = photo_features(grey, options)
    if photo.format_mm is None:
        return found
    # The window that describes a feature must not see the frame either.
    reach = _DESCRIBED * found.size_px[:, None] * _pitch_mm(photo.camera)
    inside = np.abs(photo.camera.photo_from_image(found.pixels)) + reach <= np.array(photo.format_mm) / 2.0
    return found.select(np.flatnonzero(inside.all(axis=1)))


def _pitch_mm(camera: Camera) -> float:
    (a, b, _), (d, e, _) = camera.pixel_from_photo
    return 1.0 / math.sqrt(abs(a * e - b * d))


def is_mirrored(camera: Camera) -> bool:
    """Rows run down and y up: stored pixels are as seen where the two differ in sense."""
    (a, b, _), (d, e, _) = camera.pixel_from_photo
    return a * e - b * d > 0.0
