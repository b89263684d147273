"""Measurements of a synthetic survey with noise and planted gross errors: image points, navigation, ground.

Every set keeps its truth beside it, so that an adjustment can be judged: what was measured, what is true, and
where a gross error was planted and how large.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import InputError
from stereomate.synthetic.survey import GroundPoint, SyntheticSurvey

Array = NDArray[np.float64]


@dataclass(frozen=True)
class NoiseOptions:
    """Noise and planted gross errors of one set of observations.

    Parameters
    ----------
    sigma : float
        Standard deviation of each coordinate: pixels, metres or degrees, as the set is.
    gross_share : float
        Share of the observations in which a gross error is planted, 0 to 1.
    gross_range : (float, float)
        Least and largest size of a planted error, in units of the observation; its direction is random.
    seed : int
    """

    sigma: float
    gross_share: float = 0.0
    gross_range: tuple[float, float] = (5.0, 500.0)
    seed: int = 1

    def __post_init__(self) -> None:
        if not self.sigma >= 0.0:
            raise InputError("must not be negative", field="sigma", value=self.sigma)
        if not 0.0 <= self.gross_share <= 1.0:
            raise InputError("must be between 0 and 1", field="gross_share", value=self.gross_share)
        if not 0.0 <= self.gross_range[0] <= self.gross_range[1]:
            raise InputError("must be two rising sizes", field="gross_range", value=self.gross_range)


@dataclass(frozen=True, eq=False)
class ImageObservations:
    """Image coordinates of object points.

    Attributes
    ----------
    points : ndarray (m, 3)
        True positions: map coordinates, ellipsoidal heights.
    names : tuple of str (m)
    photograph, point : ndarray of int (n,)
        Which photograph and which point each observation is of.
    pixels, true_pixels : ndarray (n, 2)
        Measured and exact.
    gross_px : ndarray (n, 2)
        Planted errors; 0 where there is none.
    """

    points: Array
    names: tuple[str, ...]
    photograph: NDArray[np.int64]
    point: NDArray[np.int64]
    pixels: Array
    true_pixels: Array
    gross_px: Array


@dataclass(frozen=True, eq=False)
class NavigationObservations:
    """Positions and attitudes from GNSS and an inertial system, one row for each photograph.

    Attributes
    ----------
    centres, true_centres : ndarray (n, 3)
        Map coordinates, ellipsoidal heights.
    angles_deg, true_angles_deg : ndarray (n, 3)
        Omega, phi, kappa about the grid axes.
    gross_m, gross_deg : ndarray (n, 3)
        Planted errors; 0 where there is none.
    """

    centres: Array
    true_centres: Array
    angles_deg: Array
    true_angles_deg: Array
    gross_m: Array
    gross_deg: Array


def observe_points(
    survey: SyntheticSurvey, points: ArrayLike, names: tuple[str, ...], noise: NoiseOptions
) -> ImageObservations:
    """Image coordinates of map points (m, 3) in every photograph in which nothing hides them.

    A planted error may carry an observation off its photograph: that is what a confused point does.
    """
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    if len(names) != len(points):
        raise InputError("must be one for each point", field="names", value=len(names))
    photographs, numbers, exact = [], [], []
    for number in range(len(survey.survey.photographs)):
        pixels, _ = survey.project(number, points)
        seen = np.flatnonzero(survey.visible(number, points))
        photographs.append(np.full(len(seen), number))
        numbers.append(seen)
        exact.append(pixels[seen])
    true = np.concatenate([np.empty((0, 2)), *exact])
    rng = np.random.default_rng([noise.seed, 21])
    gross = _planted(rng, len(true), 2, noise)
    return ImageObservations(
        points,
        names,
        np.concatenate([np.empty(0, np.int64), *photographs]),
        np.concatenate([np.empty(0, np.int64), *numbers]),
        true + noise.sigma * rng.standard_normal(true.shape) + gross,
        true,
        gross,
    )


def observe_signalised(survey: SyntheticSurvey, noise: NoiseOptions) -> ImageObservations:
    """Image coordinates of the control and check points; their names tell which is which."""
    signalised = (*survey.control_points, *survey.check_points)
    positions = np.array([point.position for point in signalised]).reshape(-1, 3)
    return observe_points(survey, positions, tuple(point.name for point in signalised), noise)


def observe_tie_points(survey: SyntheticSurvey, count: int, noise: NoiseOptions) -> ImageObservations:
    """Image coordinates of points spread over the block that at least two photographs see.

    They lie where a ray of a random pixel first meets the world: on the ground, on roofs and on crowns.

    Parameters
    ----------
    count : int
        Points before those are left out that fewer than two photographs see.
    """
    rng = np.random.default_rng([noise.seed, 22])
    photographs = survey.survey.photographs
    chosen = rng.integers(0, len(photographs), count)
    share = rng.uniform(0.02, 0.98, (count, 2))
    found = []
    for number, photograph in enumerate(photographs):
        pixels = share[chosen == number] * photograph.camera.size_px
        rays = photograph.camera.rays_from_image(pixels) @ photograph.orientation.object_from_camera.T
        found.append(survey.world.first_hit(np.array(photograph.orientation.centre), rays).points)
    points = np.concatenate(found)
    points = points[np.isfinite(points).all(axis=1)]
    seen = sum(survey.visible(number, points).astype(np.int64) for number in range(len(photographs)))
    points = points[seen >= 2]
    names = tuple(f"T{i + 1:05d}" for i in range(len(points)))
    return observe_points(survey, points, names, noise)


def observe_navigation(
    survey: SyntheticSurvey, position: NoiseOptions, attitude: NoiseOptions
) -> NavigationObservations:
    """Centres (metres, one sigma for plan and height) and angles (degrees) with noise and planted errors."""
    rng = np.random.default_rng([position.seed, attitude.seed, 23])
    shape = survey.centres.shape
    gross_m, gross_deg = _planted(rng, shape[0], 3, position), _planted(rng, shape[0], 3, attitude)
    return NavigationObservations(
        survey.centres + position.sigma * rng.standard_normal(shape) + gross_m,
        survey.centres,
        survey.angles_deg + attitude.sigma * rng.standard_normal(shape) + gross_deg,
        survey.angles_deg,
        gross_m,
        gross_deg,
    )


def observe_ground(
    points: tuple[GroundPoint, ...], noise: NoiseOptions, kind: Literal["full", "plan", "height"] = "full"
) -> tuple[Array, Array]:
    """Surveyed map coordinates (n, 3) of signalised points, and the errors (n, 3) planted in them.

    Parameters
    ----------
    kind : {"full", "plan", "height"}
        Coordinates that were not surveyed are NaN.
    """
    rng = np.random.default_rng([noise.seed, 24])
    true = np.array([point.position for point in points]).reshape(-1, 3)
    gross = _planted(rng, len(true), 3, noise)
    measured = true + noise.sigma * rng.standard_normal(true.shape) + gross
    if kind == "plan":
        measured[:, 2] = np.nan
    elif kind == "height":
        measured[:, :2] = np.nan
    return measured, gross


def _planted(rng: np.random.Generator, count: int, axes: int, noise: NoiseOptions) -> Array:
    """Gross errors (count, axes) in a share of the rows: random directions, sizes log-uniform."""
    errors = np.zeros((count, axes))
    hit = np.flatnonzero(rng.random(count) < noise.gross_share)
    direction = rng.standard_normal((len(hit), axes))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    low, high = (max(size, 1e-12) for size in noise.gross_range)
    size = np.exp(rng.uniform(np.log(low), np.log(high), len(hit)))
    errors[hit] = direction * size[:, None]
    return errors
