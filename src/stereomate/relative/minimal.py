"""The five-point problem: every relative orientation that five pairs of rays allow."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import InputError
from stereomate.relative.kernels.coplanarity import adjust
from stereomate.relative.kernels.five_point import MAX_SOLUTIONS
from stereomate.relative.kernels.five_point import five_point as five_point_kernel
from stereomate.relative.kernels.pose import choose_arrangement, pose_from_essential
from stereomate.relative.pair import Correspondences, RelativePose


def five_point(left: ArrayLike, right: ArrayLike, in_front: int = 5) -> tuple[RelativePose, ...]:
    """Relative orientations through five pairs of rays, tested by cheirality.

    Parameters
    ----------
    left, right : array_like, shape (5, 2)
        Photo coordinates over the principal distance, x right, y up.
    in_front : int
        How many of the five points must lie before both cameras.

    Returns
    -------
    tuple of RelativePose
        At most ten; of the four arrangements of each the one with most points in front.

    Raises
    ------
    InputError
        If the arrays are not five finite points each.

    Notes
    -----
    D. Nistér, "An efficient solution to the five-point relative pose problem", PAMI 26 (2004).
    """
    rays = []
    for name, given in (("left", left), ("right", right)):
        points = np.asarray(given, dtype=np.float64)
        if points.shape != (5, 2) or not np.isfinite(points).all():
            raise InputError("must be five finite points, shape (5, 2)", field=name, value=points.shape)
        rays.append(np.ascontiguousarray(np.column_stack([points, -np.ones(5)])))
    essentials = np.empty((MAX_SOLUTIONS, 9))
    everything = np.ones(5, dtype=np.bool_)
    poses = []
    for k in range(five_point_kernel(rays[0], rays[1], essentials)):
        base, first, second, rotation = np.empty(3), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
        if not pose_from_essential(essentials[k], base, first, second):
            continue
        front = choose_arrangement(
            rays[0][:, :2].copy(), rays[1][:, :2].copy(), everything, base, first, second, rotation
        )
        if front >= in_front:
            _polish(rays, base, rotation)
            poses.append(RelativePose(base, rotation))
    return tuple(poses)


def most_in_front(pose: RelativePose, correspondences: Correspondences) -> RelativePose:
    """Of the four arrangements of one essential matrix the one with most points before both cameras."""
    base, rotation = np.empty(3), np.empty((3, 3))
    first, second = np.empty((3, 3)), np.empty((3, 3))
    if not pose_from_essential(pose.essential.ravel(), base, first, second):
        return pose
    left, right = correspondences.left, correspondences.right
    choose_arrangement(left, right, np.ones(len(left), dtype=np.bool_), base, first, second, rotation)
    return RelativePose(base, rotation)


def _polish(
    rays: list[NDArray[np.float64]], base: NDArray[np.float64], rotation: NDArray[np.float64]
) -> None:
    """Newton steps on the five conditions themselves, in place: ill-placed points lose digits before."""
    equal = np.array([[1e-6, 0.0, 1e-6]])
    start = base.copy(), rotation.copy()
    _, _, state = adjust(
        rays[0][:, :2].copy(),
        rays[1][:, :2].copy(),
        equal,
        equal,
        np.ones(5),
        base,
        rotation,
        np.zeros((5, 4)),
        np.empty((5, 5)),
        10,
    )
    if state != 0:
        base[:], rotation[:] = start
