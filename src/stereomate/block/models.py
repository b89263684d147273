"""Models of joined photographs: what they are; their tie points intersected, gross errors left out."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import InputError
from stereomate.geometry.collinearity import camera_from_object, photo_from_camera
from stereomate.geometry.intersection import Rays, intersect_rays
from stereomate.geometry.similarity import SpaceTransform

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

# A tie point with flatter rays is not intersected: its distance would be a guess.
_LEAST_ANGLE: Final = 0.01


@dataclass(frozen=True)
class JoiningOptions:
    """What it takes to add a photograph, and what counts as a gross error on the way.

    Parameters
    ----------
    least_points : int
        Points of the model that a new photograph must agree with.
    least_share : float
        Of those it sees.
    limit_sigmas : float
        Residuals beyond are gross errors; the model itself is allowed several standard deviations on the
        way, for the camera is not calibrated yet.
    growth : float
        Part by which a model grows between two adjustments.
    """

    least_points: int = 15
    least_share: float = 0.35
    limit_sigmas: float = 12.0
    growth: float = 0.3

    def __post_init__(self) -> None:
        if self.least_points < 6:
            raise InputError("must be at least 6", field="least_points", value=self.least_points)
        if not (0.0 < self.least_share <= 1.0 and self.limit_sigmas > 0.0 and self.growth > 0.0):
            raise InputError("must be positive", field="least_share, limit_sigmas, growth")


@dataclass(frozen=True)
class PairPose:
    """Relative orientation of two photographs: base and second rotation in the first camera's frame."""

    first: int
    second: int
    base: Array
    first_from_second: Array


@dataclass(frozen=True)
class BlockImages:
    """Image observations as ideal coordinates.

    Parameters
    ----------
    photographs, points : int
        How many there are.
    photo, point : ndarray of int, shape (m,)
    image : ndarray, shape (m, 2)
        In units of the principal distance, y up.
    sigma : ndarray, shape (m,)
        Standard deviations, same unit.
    """

    photographs: int
    points: int
    photo: Integers
    point: Integers
    image: Array
    sigma: Array


@dataclass
class Model:
    """Photographs joined in one frame; grows in place.

    Attributes
    ----------
    centres, rotations : ndarray, shape (n, 3) and (n, 3, 3)
        Of all photographs of the block; NaN for those that are not in the model.
    points : ndarray, shape (k, 3)
        Of all tie points; NaN for those that are not determined.
    used : ndarray of bool, shape (m,)
        Observations that are no gross errors so far.
    """

    centres: Array
    rotations: Array
    points: Array
    used: Mask

    @property
    def joined(self) -> Mask:
        """Photographs in the model, shape (n,)."""
        return np.asarray(np.isfinite(self.centres[:, 0]))

    def moved(self, transform: SpaceTransform) -> None:
        """Bring the model into another frame."""
        turn = np.array(transform.rotation)
        self.centres[self.joined] = transform.apply(self.centres[self.joined])
        self.rotations[self.joined] = turn @ self.rotations[self.joined]
        known = np.isfinite(self.points[:, 0])
        self.points[known] = transform.apply(self.points[known])


# Adjusts a model in place (free network); what it needs besides is bound by whoever makes it.
Adjuster = Callable[[Model], None]


class Seen:
    """The observations, by photograph, and what a model makes of them."""

    def __init__(self, images: BlockImages, options: JoiningOptions) -> None:
        self.images = images
        self.options = options
        order = np.argsort(images.photo, kind="stable")
        starts = np.searchsorted(images.photo[order], np.arange(images.photographs + 1))
        self.rows = [order[a:b] for a, b in itertools.pairwise(starts)]

    def intersect(self, model: Model, of_photo: int | None = None) -> None:
        """Intersect points anew from the photographs in the model; gross errors are left out.

        Parameters
        ----------
        model : Model
        of_photo : int, optional
            Only the points that this photograph sees.
        """
        images = self.images
        wanted = np.ones(images.points, dtype=np.bool_)
        if of_photo is not None:
            wanted[:] = False
            wanted[images.point[self.rows[of_photo]]] = True
        mine = model.joined[images.photo] & wanted[images.point]
        model.used[mine] = True
        model.points[wanted] = np.nan
        for _ in range(3):
            rows = np.flatnonzero(mine & model.used)
            rays = Rays(
                images.point[rows],
                model.centres[images.photo[rows]],
                model.rotations[images.photo[rows]],
                images.image[rows],
                images.sigma[rows],
            )
            found = intersect_rays(rays, images.points, max_iterations=8).points
            model.points[wanted] = found[wanted]
            residual = self.standardized(model, rows)
            bad = ~(residual <= self.options.limit_sigmas)
            if not bad.any():
                break
            # The worst ray of each point goes; the others are tried again without it.
            worst = _worst_of_each(images.point[rows], np.where(np.isfinite(residual), residual, 1e9), bad)
            model.used[rows[worst]] = False
        rows = np.flatnonzero(mine & model.used)
        self._without_weak(model, rows, wanted)

    def _without_weak(self, model: Model, rows: Integers, wanted: Mask) -> None:
        """Points whose rays are nearly parallel, or that still do not fit, are not determined."""
        images = self.images
        point = images.point[rows]
        directions = model.points[point] - model.centres[images.photo[rows]]
        with np.errstate(invalid="ignore"):
            directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        sums = np.stack([np.bincount(point, d, images.points) for d in np.nan_to_num(directions).T], axis=1)
        count = np.bincount(point, minlength=images.points)
        # The mean direction is the shorter the more the rays spread.
        length = np.linalg.norm(sums, axis=1) / np.maximum(count, 1)
        spread = np.sqrt(np.maximum(2.0 * (1.0 - np.minimum(length, 1.0)), 0.0))
        misfit = np.zeros(images.points)
        np.maximum.at(misfit, point, np.nan_to_num(self.standardized(model, rows), nan=np.inf))
        weak = (count < 2) | (spread < 0.5 * _LEAST_ANGLE) | (misfit > self.options.limit_sigmas)
        model.points[weak & wanted] = np.nan

    def standardized(self, model: Model, rows: Integers) -> Array:
        """Length of the residual of observations over its standard deviation; NaN behind a camera."""
        images = self.images
        photo = images.photo[rows]
        local = camera_from_object(
            model.points[images.point[rows]], model.centres[photo], model.rotations[photo]
        )
        with np.errstate(invalid="ignore", divide="ignore"):
            computed = photo_from_camera(local, 1.0)
            return np.asarray(np.linalg.norm(images.image[rows] - computed, axis=1) / images.sigma[rows])


def _worst_of_each(point: Integers, residual: Array, bad: Mask) -> Integers:
    """Rows of the largest residual of every point that has a bad one."""
    rows = np.flatnonzero(bad)
    order = rows[np.lexsort((rows, -residual[rows], point[rows]))]
    _, first = np.unique(point[order], return_index=True)
    return np.asarray(order[first], dtype=np.int64)
