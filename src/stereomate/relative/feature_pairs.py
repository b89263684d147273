"""Relative orientation of two photographs from their features: matches, orientation, guided matches.

The features of a photograph are found once and serve all its pairs. `stereomate.relative.automatic` measures
the points of a single pair further, by least-squares matching; a block measures its tie points itself.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.model import Camera
from stereomate.errors import InputError
from stereomate.measurement.features import (
    FeatureOptions,
    Features,
    detect_features,
    reduced_image,
)
from stereomate.measurement.least_squares_matching import LeastSquaresOptions
from stereomate.measurement.matching import (
    Matches,
    MatchOptions,
    match_features,
    match_features_near,
)
from stereomate.relative.guiding import distances_along_left, predict_from_neighbours
from stereomate.relative.orientation import RelativeOptions, RelativeOrientation, relative_orientation
from stereomate.relative.pair import Correspondences, RelativePose, correspondences_from_pixels

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# A feature is located to about this part of a pixel of the image it was found in.
FEATURE_SIGMA_PX: Final = 0.35


@dataclass(frozen=True)
class AutomaticOptions:
    """Options of the steps, and what is asked of the result.

    Parameters
    ----------
    largest_side_px : int
        Features are looked for in images reduced by a whole number to at most this side.
    features, matching, guided, least_squares, orientation
        Options of the steps; `guided` for the second matching near the expected places.
    guided_reach_px : float
        Radius of the second search in the reduced image, beyond what the relief asks for.
    least_points : int
        Fewer orientation points are no orientation.
    least_spread : float
        Least share of the model's width and height over which the points must lie, of what the two
        photographs have in common.
    """

    largest_side_px: int = 2200
    features: FeatureOptions = field(default_factory=FeatureOptions)
    matching: MatchOptions = field(default_factory=MatchOptions)
    guided: MatchOptions = field(default_factory=lambda: MatchOptions(ratio=0.9))
    least_squares: LeastSquaresOptions = field(default_factory=LeastSquaresOptions)
    orientation: RelativeOptions = field(default_factory=RelativeOptions)
    guided_reach_px: float = 6.0
    least_points: int = 30
    least_spread: float = 0.35

    def __post_init__(self) -> None:
        if self.largest_side_px < 200:
            raise InputError("must be at least 200", field="largest_side_px", value=self.largest_side_px)
        if self.least_points < 12:
            raise InputError("must be at least 12", field="least_points", value=self.least_points)


@dataclass(frozen=True)
class Prior:
    """What is known of a pair beforehand.

    Parameters
    ----------
    pose : RelativePose
        Approximate relative orientation, from navigation or a former adjustment.
    distance : float
        Typical distance of the ground along the left camera's axis, in bases.
    reach_px : float
        How far, in pixels, a point may be from where these put it.
    """

    pose: RelativePose
    distance: float
    reach_px: float


@dataclass(frozen=True)
class FeatureOrientation:
    """Orientation of two photographs from their features.

    Attributes
    ----------
    orientation : RelativeOrientation or None
        Of the last step that was reached; None where there was nothing to orient from.
    matches : Matches
        Its correspondences, as rows of the features.
    reasons : tuple of str
        Why there is no orientation; empty if there is.
    counts : dict of str to int
        Features, matches and points after every step.
    """

    orientation: RelativeOrientation | None
    matches: Matches
    reasons: tuple[str, ...]
    counts: dict[str, int]

    @property
    def used(self) -> Matches:
        """The matches that agree with the orientation."""
        if self.orientation is None:
            return self.matches.select(np.zeros(len(self.matches), dtype=np.bool_))
        return self.matches.select(self.orientation.used)


@dataclass(frozen=True)
class FeaturePair:
    """Two photographs with their cameras and features (in pixels of the whole photographs)."""

    left_camera: Camera
    right_camera: Camera
    left_features: Features
    right_features: Features
    options: AutomaticOptions

    def orient(self, prior: Prior | None = None) -> FeatureOrientation:
        """Match, find the orientation most matches agree on, match again near the expected places."""
        counts = {"left features": len(self.left_features), "right features": len(self.right_features)}
        matches = self._first_matches(prior)
        counts["matches"] = len(matches)
        least = self.options.least_points
        if len(matches) < least:
            reason = f"only {len(matches)} matches, {least} are needed: no overlap or no common texture"
            return FeatureOrientation(None, matches, (reason,), counts)
        first = self._orientation(matches)
        counts["matches that agree"] = int(np.count_nonzero(first.used))
        if not first.determined:
            return FeatureOrientation(first, matches, first.reasons, counts)
        matches = self._guided_matches(first, matches)
        counts["guided matches"] = len(matches)
        second = self._orientation(matches)
        agree = int(np.count_nonzero(second.used))
        counts["guided matches that agree"] = agree
        reasons = second.reasons
        if not reasons and agree < least:
            reasons = (f"only {agree} matches agree, {least} are needed",)
        return FeatureOrientation(second, matches, reasons, counts)

    def _first_matches(self, prior: Prior | None) -> Matches:
        if prior is None:
            return match_features(self.left_features, self.right_features, self.options.matching)
        rays = self.left_camera.rays_from_image(self.left_features.pixels)
        points = rays * prior.distance
        # A point expected just outside may still lie inside: only places behind the camera are left out.
        pixels, _ = self.right_camera.image_from_camera(
            (points - prior.pose.base) @ prior.pose.left_from_right
        )
        return match_features_near(
            self.left_features, self.right_features, pixels, prior.reach_px, self.options.matching
        )

    def _factor(self) -> float:
        return float(
            max(
                reduction(self.left_camera.size_px, self.options),
                reduction(self.right_camera.size_px, self.options),
            )
        )

    def _orientation(self, matches: Matches) -> RelativeOrientation:
        return relative_orientation(self._correspondences(matches), self.options.orientation)

    def _correspondences(self, matches: Matches) -> Correspondences:
        return correspondences_from_pixels(
            self.left_camera,
            self.right_camera,
            self.left_features.pixels[matches.left],
            self.right_features.pixels[matches.right],
            FEATURE_SIGMA_PX * self._factor(),
        )

    def _guided_matches(self, first: RelativeOrientation, matches: Matches) -> Matches:
        used = np.flatnonzero(first.used)
        distance = distances_along_left(first.pose, first.adjustment.correspondences)
        known = used[distance[used] > 0.0]
        prediction = predict_from_neighbours(
            self.left_camera,
            self.right_camera,
            first.pose,
            self.left_features.pixels[matches.left[known]],
            distance[known],
            self.left_features.pixels,
        )
        reach = self.options.guided_reach_px * self._factor() + 1.5 * prediction.reach_px
        reach = np.minimum(reach, 0.1 * max(self.right_camera.size_px))
        guided = match_features_near(
            self.left_features, self.right_features, prediction.pixels, reach, self.options.guided
        )
        return _united(guided, matches, first.used)


def photo_features(image: NDArray[np.uint8], options: AutomaticOptions | None = None) -> Features:
    """Features of a grey photograph, in its own pixels, found in an image reduced as the options say."""
    options = options or AutomaticOptions()
    factor = reduction((image.shape[1], image.shape[0]), options)
    return detect_features(reduced_image(image, factor), options.features).scaled(float(factor))


def reduction(size_px: tuple[int, int], options: AutomaticOptions) -> int:
    """By what whole number a photograph is reduced before features are looked for."""
    return max(1, -(-max(size_px) // options.largest_side_px))


def _united(guided: Matches, first: Matches, used: Mask) -> Matches:
    """Guided matches, and those of the first ones that agreed and whose points are still free."""
    keep = used & ~np.isin(first.left, guided.left) & ~np.isin(first.right, guided.right)
    rows = np.flatnonzero(keep)
    order = np.argsort(np.concatenate([guided.left, first.left[rows]]), kind="stable")
    return Matches(
        np.concatenate([guided.left, first.left[rows]])[order],
        np.concatenate([guided.right, first.right[rows]])[order],
        np.concatenate([guided.distance, first.distance[rows]])[order],
        np.concatenate([guided.ratio, first.ratio[rows]])[order],
    )
