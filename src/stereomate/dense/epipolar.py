"""Epipolar images of two oriented photographs: the same object point lies in the same row of both.

Both photographs are turned about their centres, by computation, into cameras that look the same way, at right
angles to the base; their rows run along it. Distortion, tilts and the turns of stored pixels are gone. The
images are laid so that ground of a mean depth has no parallax: what remains is relief.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from stereomate.coverage.survey import Photograph
from stereomate.errors import NotDeterminedError

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Mask = NDArray[np.bool_]

# Positions of photographs' edges that are followed to find what both show.
_EDGE = 9
# Rows that are resampled at a time: their positions are float64.
_ROWS = 256


@dataclass(frozen=True, eq=False)
class EpipolarPair:
    """Where the pixels of two epipolar images lie.

    Attributes
    ----------
    left, right : Photograph
        The base runs from left to right along the rows.
    axes : ndarray, shape (3, 3)
        From the epipolar frame (x along the base, z backwards) to the tangent frame.
    focal_px : float
        Principal distance in pixels of the epipolar images.
    centres_px : (float, float)
        Column of the principal point of the left and of the right image.
    centre_row_px : float
        Its row, that of both.
    size : (int, int)
        Columns and rows.
    base_m : float
    reduction : int
        Pixels of the photographs per pixel of the images.
    """

    left: Photograph
    right: Photograph
    axes: Array
    focal_px: float
    centres_px: tuple[float, float]
    centre_row_px: float
    size: tuple[int, int]
    base_m: float
    reduction: int

    @property
    def plain_px(self) -> float:
        """Difference of the columns of the two principal points: part of every parallax."""
        return self.centres_px[0] - self.centres_px[1]

    def parallax(self, depth_m: Array) -> Array:
        """Parallaxes left minus right, pixels, of points at a depth below the base."""
        return np.asarray(self.focal_px * self.base_m / depth_m + self.plain_px)

    def depth(self, parallax_px: Array) -> Array:
        """Depths below the base of parallaxes; NaN where rays do not meet before the cameras."""
        whole = np.asarray(parallax_px - self.plain_px, dtype=np.float64)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(whole > 0.0, self.focal_px * self.base_m / whole, math.nan)

    def epipolar_from_tangent(self, points: Array) -> Array:
        """Coordinates (..., 3) in the epipolar frame about the left centre."""
        return np.asarray((points - np.array(self.left.orientation.centre)) @ self.axes)

    def points(self, columns: Array, rows: Array, parallax_px: Array) -> Array:
        """Tangent coordinates (n, 3) of positions in the left image and their parallaxes."""
        depth = self.depth(parallax_px)
        x = (columns - self.centres_px[0]) / self.focal_px * depth
        y = (self.centre_row_px - rows) / self.focal_px * depth
        local = np.stack([x, y, -depth], axis=-1)
        return np.asarray(local @ self.axes.T + np.array(self.left.orientation.centre))

    def sigma_m(self, parallax_px: Array, sigma_px: Array) -> Array:
        """Standard deviations of depths from those of parallaxes."""
        depth = self.depth(parallax_px)
        return np.asarray(depth * depth / (self.focal_px * self.base_m) * sigma_px)

    def image(self, which: int, grey: Bytes) -> tuple[Bytes, Mask]:
        """The epipolar image of the left (0) or right (1) photograph, and where it shows anything.

        Parameters
        ----------
        which : {0, 1}
        grey : (rows, cols) uint8
            The photograph, reduced by `reduction`.
        """
        photograph = (self.left, self.right)[which]
        camera, turn = photograph.camera, photograph.orientation.object_from_camera
        cols, rows = self.size
        x = (np.arange(cols) + 0.5 - self.centres_px[which]) / self.focal_px
        image, valid = np.empty((rows, cols), np.uint8), np.empty((rows, cols), np.bool_)
        for row0 in range(0, rows, _ROWS):
            part = slice(row0, min(row0 + _ROWS, rows))
            y = (self.centre_row_px - np.arange(part.start, part.stop) - 0.5) / self.focal_px
            rays = np.empty((len(y), cols, 3))
            rays[..., 0], rays[..., 1], rays[..., 2] = x[None, :], y[:, None], -1.0
            pixels, inside = camera.image_from_camera(rays @ (self.axes.T @ turn))
            place = np.nan_to_num(pixels / self.reduction - 0.5, nan=-1e4).astype(np.float32)
            image[part] = cv2.remap(
                grey, place[..., 0], place[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
            )
            valid[part] = inside & camera.in_picture(pixels)
        image[~valid] = 0
        return image, valid


def epipolar_pair(
    first: Photograph, second: Photograph, points: Array, reduction: int
) -> EpipolarPair | None:
    """Epipolar images of two photographs of some ground.

    Parameters
    ----------
    first, second : Photograph
    points : ndarray, shape (n, 3)
        Points of the ground in the tangent frame.
    reduction : int
        Whole pixels of the photographs that become one.

    Returns
    -------
    EpipolarPair or None
        None where the photographs have no ground in common.

    Raises
    ------
    NotDeterminedError
        If they were taken from one place, or look along their base.
    """
    ends = [np.array(photo.orientation.centre) for photo in (first, second)]
    length = float(np.linalg.norm(ends[1] - ends[0]))
    if not length > 0.0:
        raise NotDeterminedError(f"surface: {first.name} and {second.name} were taken from one place")
    axes = _axes((ends[1] - ends[0]) / length, first, second)
    seen = [_inside(photo, points) for photo in (first, second)]
    common = points[seen[0] & seen[1]]
    if not len(common):
        return None
    focal = min(_focal_px(photo) for photo in (first, second)) / reduction
    depth = -((common - ends[0]) @ axes)[:, 2]
    if not (depth > 0.0).all():
        raise NotDeterminedError(f"surface: {first.name} and {second.name} look along their base")
    middle = float(np.median(depth))
    shift = focal * length / middle
    # Columns of the left image, in which the right one is laid over it at the middle depth.
    bounds = np.array([_bounds(photo, axes, focal) for photo in (first, second)])
    bounds[1, :2] += shift
    west, east = bounds[:, 0].max(), bounds[:, 1].min()
    low, high = bounds[:, 2].max(), bounds[:, 3].min()
    # Relief moves what is common by as much as its parallaxes differ.
    reach = focal * length * (1.0 / float(depth.min()) - 1.0 / float(depth.max()))
    west, east = max(west - reach, bounds[:, 0].min()), min(east + reach, bounds[:, 1].max())
    cols, rows = math.ceil(east - west), math.ceil(high - low)
    if cols < 1 or rows < 1:
        return None
    return EpipolarPair(
        first, second, axes, focal, (-west, shift - west), high, (cols, rows), length, reduction
    )


def _axes(base: Array, first: Photograph, second: Photograph) -> Array:
    """x along the base, z as nearly as it can be against the views of both."""
    back = sum(photo.orientation.object_from_camera[:, 2] for photo in (first, second))
    back = back - base * float(back @ base)
    size = float(np.linalg.norm(back))
    if size < 1e-3:
        raise NotDeterminedError(f"surface: {first.name} and {second.name} look along their base")
    back = back / size
    return np.stack([base, np.cross(back, base), back], axis=1)


def _focal_px(photograph: Photograph) -> float:
    """Principal distance in pixels of the photograph, the mean of both axes."""
    (a, b, _), (d, e, _) = photograph.camera.pixel_from_photo
    return photograph.camera.principal_distance_mm * math.sqrt(abs(a * e - b * d))


def _inside(photograph: Photograph, points: Array) -> Mask:
    return photograph.camera.image_from_camera(photograph.orientation.camera_from_tangent(points))[1]


def _bounds(photograph: Photograph, axes: Array, focal_px: float) -> tuple[float, float, float, float]:
    """Least and largest x and y (up) of a photograph's edge in the epipolar plane, pixels."""
    t = np.linspace(0.0, 1.0, _EDGE)
    zero, one = np.zeros_like(t), np.ones_like(t)
    edge = np.concatenate([np.stack(side, axis=1) for side in ((t, zero), (t, one), (zero, t), (one, t))])
    rays = photograph.camera.rays_from_image(photograph.camera.picture_px(edge))
    local = rays @ (axes.T @ photograph.orientation.object_from_camera).T
    with np.errstate(divide="ignore", invalid="ignore"):
        plane = local[:, :2] / -local[:, 2:]
    plane = focal_px * plane[np.isfinite(plane).all(axis=1) & (local[:, 2] < -0.05)]
    if not len(plane):
        raise NotDeterminedError(f"surface: {photograph.name} looks along its base")
    (west, low), (east, high) = plane.min(axis=0), plane.max(axis=0)
    return float(west), float(east), float(low), float(high)


__all__ = ["EpipolarPair", "epipolar_pair"]
