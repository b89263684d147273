"""Relative orientation from two photographs alone: features, matches, orientation, least-squares matching.

Four steps, each of which can end it with a reason: features of both photographs are matched (reduced images,
where they are large); the orientation most matches agree on is found; with it, points are looked for again
near their expected places; the orientation points are measured anew by least-squares matching in the full
images, and these measurements alone make the result. An orientation is only called determined if the features
and the least-squares measurements tell the same.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.model import Camera
from stereomate.errors import ImageError
from stereomate.measurement.features import Features, grey_image
from stereomate.measurement.least_squares_matching import match_least_squares
from stereomate.measurement.matching import Matches
from stereomate.relative.feature_pairs import AutomaticOptions, FeaturePair, Prior, photo_features
from stereomate.relative.guiding import distances_along_left, local_affine, plane_normal
from stereomate.relative.orientation import RelativeOptions, RelativeOrientation, relative_orientation
from stereomate.relative.pair import correspondences_from_pixels
from stereomate.relative.remarks import remarks
from stereomate.relative.robust import RobustOptions

__all__ = [
    "AutomaticOptions",
    "AutomaticOrientation",
    "Prior",
    "orient_features",
    "orient_photographs",
    "photo_features",
]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# What least-squares matching does not know of its own errors, at the least: relief in the window, aliasing.
_WINDOW_SIGMA_PX: Final = 0.05
# Median of the square of a normal variable of unit variance.
_MEDIAN_OF_SQUARES: Final = 0.4549


@dataclass(frozen=True)
class AutomaticOrientation:
    """Result of the automatic relative orientation.

    Parameters
    ----------
    orientation : RelativeOrientation or None
        From the least-squares measurements (or the last step that was reached); None where there was nothing
        to orient from.
    reasons : tuple of str
        Why there is no orientation; empty if there is.
    left_px, right_px : ndarray, shape (n, 2)
        Pixels of the correspondences of `orientation`.
    counts : dict of str to int
        Features, matches and points after every step.
    notes : tuple of str
        What a reader should know besides: points that could not be measured, agreement of the two steps.
    """

    orientation: RelativeOrientation | None
    reasons: tuple[str, ...]
    left_px: Array
    right_px: Array
    counts: dict[str, int]
    notes: tuple[str, ...] = ()

    @property
    def determined(self) -> bool:
        """There is an orientation."""
        return not self.reasons

    @property
    def rms_px(self) -> float:
        """Root mean square Sampson distance of the points used, pixels; NaN without an orientation."""
        return math.nan if self.orientation is None else self.orientation.sampson_rms


def orient_photographs(
    left: NDArray[Any],
    right: NDArray[Any],
    left_camera: Camera,
    right_camera: Camera,
    options: AutomaticOptions | None = None,
    prior: Prior | None = None,
) -> AutomaticOrientation:
    """Orient two photographs to each other from their pixels.

    Parameters
    ----------
    left, right : ndarray, shape (rows, cols) or (rows, cols, bands)
        Whole photographs as stored.
    left_camera, right_camera : Camera
        Their calibrations.
    options : AutomaticOptions, optional
    prior : Prior, optional
        Narrows the search for matches.

    Returns
    -------
    AutomaticOrientation
        With reasons where the photographs do not give an orientation.

    Raises
    ------
    ImageError
        If an image does not have the size its camera says.
    """
    options = options or AutomaticOptions()
    grey = []
    for name, image, camera in (("left", left, left_camera), ("right", right, right_camera)):
        if (image.shape[1], image.shape[0]) != camera.size_px:
            raise ImageError(
                f"must have the size of camera {camera.name!r}, {camera.size_px[0]} x {camera.size_px[1]} px",
                field=name,
                value=(image.shape[1], image.shape[0]),
            )
        grey.append(grey_image(image))
    found = [photo_features(image, options) for image in grey]
    pair = _Pair(grey[0], grey[1], left_camera, right_camera, found[0], found[1], options)
    return pair.orient(prior)


def orient_features(
    left: tuple[NDArray[np.uint8], Features],
    right: tuple[NDArray[np.uint8], Features],
    left_camera: Camera,
    right_camera: Camera,
    options: AutomaticOptions | None = None,
    prior: Prior | None = None,
) -> AutomaticOrientation:
    """As `orient_photographs`, from grey images and features found before (`photo_features`).

    For blocks: the features of a photograph are found once and serve all its pairs.
    """
    options = options or AutomaticOptions()
    pair = _Pair(left[0], right[0], left_camera, right_camera, left[1], right[1], options)
    return pair.orient(prior)


@dataclass(frozen=True)
class _Pair:
    left: NDArray[np.uint8]
    right: NDArray[np.uint8]
    left_camera: Camera
    right_camera: Camera
    left_features: Features
    right_features: Features
    options: AutomaticOptions

    def orient(self, prior: Prior | None) -> AutomaticOrientation:
        pair = FeaturePair(
            self.left_camera, self.right_camera, self.left_features, self.right_features, self.options
        )
        result = pair.orient(prior)
        if result.orientation is None:
            return _failed(result.reasons[0], result.counts)
        if result.reasons:
            own = result.orientation.reasons
            return self._result(
                result.orientation, result.matches, result.counts, () if own else result.reasons
            )
        return self._measured(result.orientation, result.matches, result.counts)

    def _measured(
        self, found: RelativeOrientation, matches: Matches, counts: dict[str, int]
    ) -> AutomaticOrientation:
        """Least-squares matching of the points that agree, and the orientation from these alone."""
        used = np.flatnonzero(found.used)
        c = found.adjustment.correspondences
        distance = distances_along_left(found.pose, c)
        used = used[distance[used] > 0.0]
        left_px = self.left_features.pixels[matches.left[used]]
        right_px = self.right_features.pixels[matches.right[used]]
        normal = plane_normal(found.pose, c.select(used))
        affine = local_affine(
            self.left_camera, self.right_camera, found.pose, left_px, distance[used], normal
        )
        measured = match_least_squares(
            self.left, self.right, left_px, right_px, affine, self.options.least_squares
        )
        good = measured.matched & _on_photo(measured.right_px, self.right_camera)
        good = _without_repetitions(measured.left_px, good)
        counts["measured by least squares"] = int(np.count_nonzero(good))
        failures = ", ".join(f"{count} {reason}" for reason, count in measured.failures().items())
        notes = [f"not measured: {failures}"] if failures else []
        if np.count_nonzero(good) < self.options.least_points:
            reason = f"only {np.count_nonzero(good)} points could be measured by least-squares matching"
            return self._result(found, matches, counts, (reason,), tuple(notes))
        left_px, right_px = measured.left_px[good], measured.right_px[good]
        covariance = measured.covariance_px[good]
        result = self._weighted(left_px, right_px, covariance, _WINDOW_SIGMA_PX, 2.5)
        if result.determined:
            # What the noise of the pixels does not explain: unmodelled distortion, relief, moving leaves.
            unmodelled = _unmodelled_px(result, covariance)
            notes.append(f"beyond the noise of the pixels: {unmodelled:.2f} px per coordinate")
            result = self._weighted(left_px, right_px, covariance, unmodelled, 1.0)
        counts["orientation points"] = int(np.count_nonzero(result.used))
        reasons = result.reasons or self._doubts(found, result, left_px)
        notes += remarks(result)
        return AutomaticOrientation(result, reasons, left_px, right_px, counts, tuple(notes))

    def _weighted(
        self, left_px: Array, right_px: Array, covariance: Array, floor_px: float, widening: float
    ) -> RelativeOrientation:
        """Orientation of measured points whose coordinates have another `floor_px` beside their noise."""
        correspondences = correspondences_from_pixels(
            self.left_camera,
            self.right_camera,
            left_px,
            right_px,
            floor_px,
            (None, covariance + np.array([1.0, 0.0, 1.0]) * floor_px**2),
        )
        o = self.options.orientation
        search = RobustOptions(
            limit_sigmas=widening * o.search.limit_sigmas,
            confidence=o.search.confidence,
            least_samples=o.search.least_samples,
            most_samples=o.search.most_samples,
            subset=o.search.subset,
            widening=1.0,
            seed=o.search.seed,
        )
        options = RelativeOptions(o.robust, search, o.adjustment, o.snooping, o.diagnosis)
        return relative_orientation(correspondences, options)

    def _doubts(
        self, features: RelativeOrientation, measured: RelativeOrientation, left_px: Array
    ) -> tuple[str, ...]:
        """Reasons not to believe an orientation that converged."""
        doubts = []
        count = int(np.count_nonzero(measured.used))
        if count < self.options.least_points:
            doubts.append(f"only {count} orientation points agree, {self.options.least_points} are needed")
        share = self._spread(measured, left_px)
        if share < self.options.least_spread:
            doubts.append(
                f"the orientation points span {100.0 * share:.0f} % of the overlap's width or height, "
                f"{100.0 * self.options.least_spread:.0f} % are needed: no common texture in the rest"
            )
        turn, tilt = features.pose.angles_to(measured.pose)
        covariance = features.adjustment.covariance + measured.adjustment.covariance
        allowed = 6.0 * math.sqrt(float(np.linalg.eigvalsh(covariance)[-1])) + math.radians(0.05)
        if max(turn, tilt) > allowed:
            doubts.append(
                "features and least-squares matching give different orientations: "
                f"{math.degrees(max(turn, tilt)):.2f}° apart, {math.degrees(allowed):.2f}° expected at most"
            )
        return tuple(doubts)

    def _spread(self, result: RelativeOrientation, left_px: Array) -> float:
        """Smaller of the shares of the overlap's width and height in the left photograph that points span."""
        distance = distances_along_left(result.pose, result.adjustment.correspondences)
        typical = float(np.median(distance[result.used]))
        columns, rows = self.left_camera.size_px
        grid = np.stack(
            np.meshgrid((np.arange(40) + 0.5) / 40 * columns, (np.arange(40) + 0.5) / 40 * rows), axis=-1
        ).reshape(-1, 2)
        points = self.left_camera.rays_from_image(grid) * typical
        _, inside = self.right_camera.image_from_camera(
            (points - result.pose.base) @ result.pose.left_from_right
        )
        if np.count_nonzero(inside) < 4:
            return 0.0
        whole = np.ptp(grid[inside], axis=0) + np.array([columns, rows]) / 40
        low, high = np.percentile(left_px[result.used], [2.0, 98.0], axis=0)
        return float(min(1.0, ((high - low) / 0.96 / whole).min()))

    def _result(
        self,
        orientation: RelativeOrientation,
        matches: Matches,
        counts: dict[str, int],
        reasons: tuple[str, ...],
        notes: tuple[str, ...] = (),
    ) -> AutomaticOrientation:
        return AutomaticOrientation(
            orientation,
            (*orientation.reasons, *reasons),
            self.left_features.pixels[matches.left],
            self.right_features.pixels[matches.right],
            counts,
            notes,
        )


def _failed(reason: str, counts: dict[str, int]) -> AutomaticOrientation:
    nothing = np.empty((0, 2))
    return AutomaticOrientation(None, (reason,), nothing, nothing, counts)


def _on_photo(pixels: Array, camera: Camera) -> Mask:
    # Comparisons with NaN, where nothing was measured, are false.
    inside = (pixels > 0.0) & (pixels < np.array(camera.size_px))
    return np.asarray(inside.all(axis=1))


def _unmodelled_px(result: RelativeOrientation, covariance: Array) -> float:
    """Standard deviation per coordinate that the y-parallaxes have beside the noise of matching.

    The one with which half of the normalised squares lie below the median of their distribution (0.455 for
    one degree of freedom), so that gross errors do not count; at least `_WINDOW_SIGMA_PX`.
    """
    statistics = result.points()
    squares = statistics.y_parallax[statistics.used] ** 2
    noise = 0.5 * (covariance[:, 0] + covariance[:, 2])[statistics.used]
    low, high = 2.0 * _WINDOW_SIGMA_PX**2, float(squares.max()) + 2.0 * _WINDOW_SIGMA_PX**2
    for _ in range(40):
        middle = 0.5 * (low + high)
        if float(np.median(squares / (noise + middle))) > _MEDIAN_OF_SQUARES:
            low = middle
        else:
            high = middle
    # Left and right coordinates have half of it each.
    return math.sqrt(0.5 * low)


def _without_repetitions(left_px: Array, good: Mask) -> Mask:
    """Several features in one pixel make one orientation point."""
    rows = np.flatnonzero(good)
    _, first = np.unique(left_px[rows], axis=0, return_index=True)
    kept = np.zeros(len(good), dtype=np.bool_)
    kept[rows[first]] = True
    return kept
