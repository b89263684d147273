"""Join oriented pairs to models of many photographs: the start of a block without approximate values.

A model begins with its best pair. Photographs are added one by one, each by resection on the points that the
model has already, its own tie points are intersected, and the whole is adjusted whenever it has grown by a
part. When no photograph can be added any more, another model begins with what is left; models that share
points are joined by a similarity. All in a Cartesian frame of arbitrary place, direction and scale.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.block.models import Adjuster, BlockImages, JoiningOptions, Model, PairPose, Seen
from stereomate.errors import NotDeterminedError
from stereomate.geometry.adjustment import AdjustmentOptions
from stereomate.geometry.intersection import intersect_two_rays
from stereomate.geometry.resection import resect
from stereomate.geometry.similarity import estimate_space_transform

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

_ROBUST: Final = AdjustmentOptions(loss="huber", max_iterations=30)


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


class _Work(Seen):
    """The observations with what the steps share."""

    def __init__(self, images: BlockImages, pairs: Sequence[PairPose], options: JoiningOptions) -> None:
        super().__init__(images, options)
        # Rotations of photographs against their neighbours: neighbour, neighbour from photograph.
        self.turns: list[list[tuple[int, Array]]] = [[] for _ in range(images.photographs)]
        for pair in pairs:
            self.turns[pair.second].append((pair.first, pair.first_from_second))
            self.turns[pair.first].append((pair.second, pair.first_from_second.T))

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
