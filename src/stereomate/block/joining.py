"""Join oriented pairs to models of many photographs: the start of a block without approximate values.

A model begins with its best pair. Photographs are added one by one, each by resection on the points that the
model has already, its own tie points are intersected, and the whole is adjusted whenever it has grown by a
part. When no photograph can be added any more, another model begins with what is left; models that share
points are joined by a similarity. All in a Cartesian frame of arbitrary place, direction and scale.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import InputError, NotDeterminedError
from stereomate.geometry.adjustment import AdjustmentOptions
from stereomate.geometry.collinearity import camera_from_object, photo_from_camera
from stereomate.geometry.intersection import Rays, intersect_rays, intersect_two_rays
from stereomate.geometry.resection import resect
from stereomate.geometry.similarity import SpaceTransform, estimate_space_transform

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

# A tie point with flatter rays is not intersected: its distance would be a guess.
_LEAST_ANGLE: Final = 0.01
_ROBUST: Final = AdjustmentOptions(loss="huber", max_iterations=30)


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


@dataclass(frozen=True)
class Joining:
    """Models, the largest first, and why photographs could not be joined: index -> reason."""

    models: tuple[Model, ...]
    reasons: dict[int, str] = field(default_factory=dict)


def join(
    images: BlockImages,
    pairs: Sequence[PairPose],
    adjuster: Adjuster,
    options: JoiningOptions | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Joining:
    """Join the photographs of a block.

    Parameters
    ----------
    images : BlockImages
    pairs : sequence of PairPose
        Determined relative orientations: the seeds.
    adjuster : callable
        Adjusts a model in place.
    options : JoiningOptions, optional
    progress : callable, optional
        Gets the number of joined photographs and of all.

    Returns
    -------
    Joining
        Photographs in no model have a reason each.
    """
    options = options or JoiningOptions()
    work = _Work(images, pairs, options)
    free = np.ones(images.photographs, dtype=np.bool_)
    models: list[Model] = []
    reasons: dict[int, str] = {}
    while True:
        model = work.seed([pair for pair in pairs if free[pair.first] and free[pair.second]])
        if model is None:
            break
        done = int(np.count_nonzero(~free))
        reasons = work.grow(
            model,
            free & ~model.joined,
            adjuster,
            lambda joined, done=done: progress and progress(done + joined, images.photographs),  # type: ignore[misc]
        )
        free &= ~model.joined
        models.append(model)
    models = work.united(models, adjuster)
    joined = np.zeros(images.photographs, dtype=np.bool_)
    for model in models:
        joined |= model.joined
    return Joining(
        tuple(models),
        {k: work.reason(k, pairs, reasons) for k in np.flatnonzero(~joined).tolist()},
    )


class _Work:
    """The observations with what the steps share."""

    def __init__(self, images: BlockImages, pairs: Sequence[PairPose], options: JoiningOptions) -> None:
        self.images = images
        self.options = options
        # Rotations of photographs against their neighbours: neighbour, neighbour from photograph.
        self.turns: list[list[tuple[int, Array]]] = [[] for _ in range(images.photographs)]
        for pair in pairs:
            self.turns[pair.second].append((pair.first, pair.first_from_second))
            self.turns[pair.first].append((pair.second, pair.first_from_second.T))
        order = np.argsort(images.photo, kind="stable")
        starts = np.searchsorted(images.photo[order], np.arange(images.photographs + 1))
        self.rows = [order[a:b] for a, b in itertools.pairwise(starts)]

    def _common(self, one: int, other: int) -> tuple[Integers, Integers]:
        """Rows of the observations of points that both photographs see."""
        images = self.images
        a, b = self.rows[one], self.rows[other]
        _, i, j = np.intersect1d(images.point[a], images.point[b], return_indices=True)
        return a[i], b[j]

    def seed(self, pairs: Sequence[PairPose]) -> Model | None:
        """A model of the pair with the most points that are intersected well."""
        best: tuple[float, PairPose] | None = None
        for pair in pairs:
            a, b = self._common(pair.first, pair.second)
            if len(a) < self.options.least_points:
                continue
            score = float(np.minimum(self._angles(pair, a, b), 0.2).sum())
            if best is None or score > best[0]:
                best = score, pair
        if best is None:
            return None
        images, pair = self.images, best[1]
        model = Model(
            np.full((images.photographs, 3), np.nan),
            np.full((images.photographs, 3, 3), np.nan),
            np.full((images.points, 3), np.nan),
            np.ones(len(images.point), dtype=np.bool_),
        )
        model.centres[pair.first], model.rotations[pair.first] = np.zeros(3), np.eye(3)
        model.centres[pair.second], model.rotations[pair.second] = pair.base, pair.first_from_second
        self.intersect(model)
        return model

    def _angles(self, pair: PairPose, a: Integers, b: Integers) -> Array:
        """Angles of intersection; 0 for points behind a camera."""
        left = _directions(self.images.image[a])
        right = _directions(self.images.image[b]) @ pair.first_from_second.T
        depths = intersect_two_rays(np.zeros(3), left, pair.base, right).depths
        cosine = np.sum(left * right, axis=1) / np.linalg.norm(left, axis=1) / np.linalg.norm(right, axis=1)
        angle = np.arccos(np.clip(cosine, -1.0, 1.0))
        return np.where((depths > 0.0).all(axis=1), angle, 0.0)

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

    def grow(
        self,
        model: Model,
        free: Mask,
        adjuster: Adjuster,
        progress: Callable[[int], object],
    ) -> dict[int, str]:
        """Add photographs while any can be added; returns why the others could not."""
        reasons: dict[int, str] = {}
        adjusted = int(np.count_nonzero(model.joined))
        adjuster(model)
        self.intersect(model)
        while True:
            progress(int(np.count_nonzero(model.joined)))
            added = self._add_one(model, free & ~model.joined, reasons)
            count = int(np.count_nonzero(model.joined))
            if added and count < (1.0 + self.options.growth) * adjusted:
                continue
            if count > adjusted:
                adjuster(model)
                self.intersect(model)
                adjusted = count
            elif not added:
                return reasons

    def _add_one(self, model: Model, free: Mask, reasons: dict[int, str]) -> bool:
        """Add the photograph that sees most points of the model, if it fits; else the next."""
        images = self.images
        known = np.isfinite(model.points[:, 0])
        seen = {k: self.rows[k][known[images.point[self.rows[k]]]] for k in np.flatnonzero(free).tolist()}
        for k in sorted(seen, key=lambda k: (-len(seen[k]), k)):
            rows = seen[k]
            if len(rows) < self.options.least_points:
                reasons[k] = f"sees {len(rows)} points of the model, {self.options.least_points} are needed"
                continue
            reason = self._resected(model, k, rows)
            if reason is None:
                reasons.pop(k, None)
                self.intersect(model, k)
                return True
            reasons[k] = reason
        return False

    def _resected(self, model: Model, k: int, rows: Integers) -> str | None:
        """Put a photograph into the model by resection; why not, if it does not fit."""
        least = max(self.options.least_points, int(self.options.least_share * len(rows)))
        count, reason = 0, ""
        # With the rotation of a neighbour's pair the search over triples of points is saved.
        for start in (self._from_neighbours(model, k, rows), None):
            try:
                count = self._fitted(model, k, rows, start)
            except NotDeterminedError as error:
                reason = str(error)
                continue
            if count >= least:
                return None
        model.centres[k], model.rotations[k] = np.nan, np.nan
        return reason or f"only {count} of the {len(rows)} points it sees agree with the model"

    def _fitted(self, model: Model, k: int, rows: Integers, start: tuple[Array, Array] | None) -> int:
        """Resect a photograph; how many points agree, the gross errors left out of the last resection."""
        images = self.images
        points, image, sigma = model.points[images.point[rows]], images.image[rows], images.sigma[rows]
        found = resect(image, points, sigma=sigma[:, None], start=start, options=_ROBUST)
        model.centres[k], model.rotations[k] = found.centre, found.object_from_camera
        good = self.standardized(model, rows) <= self.options.limit_sigmas
        if np.count_nonzero(good) < self.options.least_points:
            return int(np.count_nonzero(good))
        at = found.centre, found.object_from_camera
        found = resect(image[good], points[good], sigma=sigma[good][:, None], start=at)
        model.centres[k], model.rotations[k] = found.centre, found.object_from_camera
        return int(np.count_nonzero(self.standardized(model, rows) <= self.options.limit_sigmas))

    def _from_neighbours(self, model: Model, k: int, rows: Integers) -> tuple[Array, Array] | None:
        """Start of a resection: the rotation of a pair, the centre that its rays then have in common."""
        images = self.images
        joined = model.joined
        best: tuple[Array, Array] | None = None
        most = 3
        points = model.points[images.point[rows]]
        for other, turn in self.turns[k]:
            if not joined[other]:
                continue
            rotation = model.rotations[other] @ turn
            centre = _common_centre(points, _directions(images.image[rows]) @ rotation.T)
            model.centres[k], model.rotations[k] = centre, rotation
            # The rotation of one pair is good to a few standard deviations of an image point at best.
            agree = int(np.count_nonzero(self.standardized(model, rows) <= 5.0 * self.options.limit_sigmas))
            if agree > most:
                best, most = (centre, rotation), agree
        return best

    def united(self, models: list[Model], adjuster: Adjuster) -> list[Model]:
        """Models that share points joined by a similarity; the largest first."""
        models = sorted(models, key=lambda m: -int(np.count_nonzero(m.joined)))
        done: list[Model] = []
        for model in models:
            for other in done:
                if self._join_models(other, model):
                    adjuster(other)
                    self.intersect(other)
                    break
            else:
                done.append(model)
        return sorted(done, key=lambda m: -int(np.count_nonzero(m.joined)))

    def _join_models(self, one: Model, other: Model) -> bool:
        both = np.isfinite(one.points[:, 0]) & np.isfinite(other.points[:, 0])
        if np.count_nonzero(both) < self.options.least_points:
            return False
        try:
            found = estimate_space_transform(other.points[both], one.points[both], options=_ROBUST)
        except NotDeterminedError:
            return False
        distance = np.linalg.norm(one.points[both] - one.centres[one.joined].mean(axis=0), axis=1)
        good = np.linalg.norm(found.residuals, axis=1) < 0.02 * distance
        enough = max(self.options.least_points, self.options.least_share * np.count_nonzero(both))
        if np.count_nonzero(good) < enough:
            return False
        other.moved(found.transform)
        one.centres[other.joined] = other.centres[other.joined]
        one.rotations[other.joined] = other.rotations[other.joined]
        self.intersect(one)
        return True

    def reason(self, k: int, pairs: Sequence[PairPose], reasons: dict[int, str]) -> str:
        """Why a photograph is in no model."""
        if not len(self.rows[k]):
            return "has no tie points with any other photograph"
        if k in reasons:
            return reasons[k]
        if not any(k in (pair.first, pair.second) for pair in pairs):
            return "no relative orientation with another photograph is determined"
        return f"shares fewer than {self.options.least_points} tie points with another photograph"


def _directions(image: Array) -> Array:
    return np.column_stack([image, -np.ones(len(image))])


def _common_centre(points: Array, directions: Array) -> Array:
    """Where rays of given directions through points meet, those far off weighted down; shape (3,)."""
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    projectors = np.eye(3) - unit[:, :, None] * unit[:, None, :]
    weights = np.ones(len(points))
    centre = np.zeros(3)
    for _ in range(8):
        weighted = projectors * weights[:, None, None]
        normal, right = weighted.sum(axis=0), np.einsum("nij,nj->i", weighted, points)
        centre = np.linalg.lstsq(normal, right, rcond=None)[0]
        miss = np.linalg.norm(np.einsum("nij,nj->ni", projectors, points - centre), axis=1)
        weights = 1.0 / np.maximum(miss, max(float(np.median(miss)), 1e-12))
    return centre


def _worst_of_each(point: Integers, residual: Array, bad: Mask) -> Integers:
    """Rows of the largest residual of every point that has a bad one."""
    rows = np.flatnonzero(bad)
    order = rows[np.lexsort((rows, -residual[rows], point[rows]))]
    _, first = np.unique(point[order], return_index=True)
    return np.asarray(order[first], dtype=np.int64)
