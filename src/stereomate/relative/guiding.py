"""Where a point of the left photograph is expected in the right one, once something is known of the pair.

Depth comes from neighbours that are oriented already, or from a height above which the cameras fly; the small
neighbourhood of a point is taken as a piece of the model's mean plane, whose image gives the affine
transformation between the two photographs there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from stereomate.camera.model import Camera
from stereomate.relative.pair import Correspondences, RelativePose

Array = NDArray[np.float64]

_NEIGHBOURS: Final = 6


@dataclass(frozen=True)
class Prediction:
    """Expected places in the right photograph.

    Parameters
    ----------
    pixels : ndarray, shape (n, 2)
        Column and row; NaN where the point is not on the right photograph.
    reach_px : ndarray, shape (n,)
        How far the neighbours disagree.
    """

    pixels: Array
    reach_px: Array


def distances_along_left(pose: RelativePose, correspondences: Correspondences) -> Array:
    """Distance of every point along its left ray (x/c, y/c, -1), in bases; shape (n,)."""
    left = np.column_stack([correspondences.left, -np.ones(len(correspondences))])
    right = np.column_stack([correspondences.right, -np.ones(len(correspondences))]) @ pose.left_from_right.T
    a, c = np.einsum("ij,ij->i", left, left), np.einsum("ij,ij->i", right, right)
    d = np.einsum("ij,ij->i", left, right)
    sine2 = np.maximum(a * c - d * d, 1e-12)
    distance: Array = (c * (left @ pose.base) - d * (right @ pose.base)) / sine2
    return distance


def project_right(camera: Camera, pose: RelativePose, points: Array) -> Array:
    """Pixels in the right photograph of points (..., 3) of the left camera's frame, in bases; NaN outside."""
    pixels, inside = camera.image_from_camera((points - pose.base) @ pose.left_from_right)
    return np.where(inside[..., None], pixels, np.nan)


def predict_from_neighbours(
    left_camera: Camera,
    right_camera: Camera,
    pose: RelativePose,
    known_px: Array,
    known_distance: Array,
    wanted_px: Array,
) -> Prediction:
    """Place points at the distances of their nearest known neighbours.

    Parameters
    ----------
    known_px, known_distance : ndarray, shape (m, 2) and (m,)
        Left pixels of oriented points and their distances (`distances_along_left`).
    wanted_px : ndarray, shape (n, 2)
        Left pixels.
    """
    count = min(_NEIGHBOURS, len(known_px))
    _, rows = cKDTree(known_px).query(wanted_px, k=count)
    rows = rows.reshape(len(wanted_px), count)
    distances = known_distance[rows]
    rays = left_camera.rays_from_image(wanted_px)
    middle = np.median(distances, axis=1)
    pixels = project_right(right_camera, pose, rays * middle[:, None])
    spread = np.stack(
        [
            project_right(right_camera, pose, rays * end(distances, axis=1)[:, None]) - pixels
            for end in (np.min, np.max)
        ]
    )
    reach = np.linalg.norm(spread, axis=2)
    reach = np.where(np.isfinite(reach), reach, 0.0).max(axis=0)
    return Prediction(pixels, reach)


def plane_normal(pose: RelativePose, correspondences: Correspondences) -> Array:
    """Normal (3,) of the model's mean plane in the left camera's frame, by least absolute deviations."""
    rays = np.column_stack([correspondences.left, -np.ones(len(correspondences))])
    points = rays * distances_along_left(pose, correspondences)[:, None]
    weights = np.ones(len(points))
    normal = np.array([0.0, 0.0, 1.0])
    for _ in range(10):
        centre = np.average(points, axis=0, weights=weights)
        centred = points - centre
        normal = np.linalg.eigh((centred * weights[:, None]).T @ centred)[1][:, 0]
        off = np.abs(centred @ normal)
        weights = 1.0 / np.maximum(off, 0.1 * np.median(off) + 1e-12)
    return normal


def local_affine(
    left_camera: Camera,
    right_camera: Camera,
    pose: RelativePose,
    left_px: Array,
    distance: Array,
    normal: Array,
    step_px: float = 5.0,
) -> Array:
    """Right from left pixel differences of a small plane piece through every point; shape (n, 2, 2).

    The unit matrix where it cannot be computed (at the edge of a photograph, or seen edge-on).
    """
    rays = left_camera.rays_from_image(left_px)
    offset = (rays * distance[:, None]) @ normal
    columns = []
    for axis in range(2):
        ends = []
        for sign in (1.0, -1.0):
            moved = left_px.copy()
            moved[:, axis] += sign * step_px
            ray = left_camera.rays_from_image(moved)
            with np.errstate(divide="ignore", invalid="ignore"):
                along = offset / (ray @ normal)
            ends.append(project_right(right_camera, pose, ray * along[:, None]))
        columns.append((ends[0] - ends[1]) / (2.0 * step_px))
    affine = np.stack(columns, axis=2)
    good = np.isfinite(affine).all(axis=(1, 2)) & (np.abs(affine).max(axis=(1, 2)) < 5.0)
    typical = np.median(affine[good], axis=0) if good.any() else np.eye(2)
    return np.where(good[:, None, None], affine, typical)
