"""How far a product is from the truth of the world it shows.

Positions are compared as computed by the product's own warp, not as matched: for product pixels, the
position in the photograph that the product resamples against the exact one. The truth goes another way:
heights of the world, its own inversion of the stereomate, rigorous point transformation, exact projection.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from stereomate.raster.windows import Window
from stereomate.rectify.ground import Ground, ground_of, heights_of, mate_positions, shown_ground
from stereomate.rectify.job import RectifyJob
from stereomate.rectify.kernels.warp import warp
from stereomate.rectify.serving import Pixels, camera_nodes
from stereomate.stereo.agreement import NMAD, Agreement
from stereomate.synthetic.survey import SyntheticSurvey

Array = NDArray[np.float64]
Product = Literal["orthophoto", "stereomate"]

# Side of the ground within which matches are taken to err alike, pixels.
_BLOCK_PX: Final = 256
# Ground closer than this to the place where it would be looked for, in pixels, when a row is scanned.
_SCAN_STEP_PX: Final = 0.25
_WINDOW: Final = (256, 48)


@dataclass(frozen=True)
class WarpError:
    """Differences of photograph positions, product less truth, in photograph pixels."""

    count: int
    rms_px: float
    largest_px: float


@dataclass(frozen=True)
class MatchedError:
    """Residual parallaxes measured by matching on open ground (product pixels), and the heights they read.

    Attributes
    ----------
    count : int
    median_px, nmad_px : (float, float)
        Of x-parallax less q(h), and of y-parallax.
    height_mean_m, height_sigma_m : float
        Heights read back through the law less true heights; sigma from the nmad.
    height_bound_m : float
        Three standard deviations of the mean: larger means are a bias. Neighbouring matches err alike, so the
        deviation is that of blocks of ground, not of single matches.
    """

    count: int
    median_px: tuple[float, float]
    nmad_px: tuple[float, float]
    height_mean_m: float
    height_sigma_m: float
    height_bound_m: float


def warp_error(
    survey: SyntheticSurvey, job: RectifyJob, product: Product, count: int = 4000, seed: int = 1
) -> WarpError:
    """Positions at random pixels of a product, in every photograph of its side that sees them.

    Parameters
    ----------
    job : RectifyJob
        The product's definition; its photographs bear the names of the survey's.
    count : int
        About so many positions.
    """
    rng = np.random.default_rng(seed)
    sides = {m.left if product == "orthophoto" else m.right for m in job.models}
    windows = max(4, count // 400)
    errors: list[Array] = []
    total = 0
    for _ in range(20 * windows):
        if total >= count:
            break
        window = _random_window(job, rng)
        spots = np.stack([rng.integers(0, window.rows, 60), rng.integers(0, window.cols, 60)], axis=-1)
        errors.append(_errors_in_window(survey, job, product, sorted(sides), window, spots))
        total += len(errors[-1])
    found = np.concatenate([*errors, np.empty((0, 2))])
    if len(found) == 0:
        return WarpError(0, float("nan"), float("nan"))
    length = np.hypot(found[:, 0], found[:, 1])
    return WarpError(len(found), float(np.sqrt(np.mean(length**2))), float(length.max()))


def _random_window(job: RectifyJob, rng: np.random.Generator) -> Window:
    cols, rows = min(_WINDOW[0], job.grid.size[0]), min(_WINDOW[1], job.grid.size[1])
    col0 = int(rng.integers(0, job.grid.size[0] - cols + 1))
    row0 = int(rng.integers(0, job.grid.size[1] - rows + 1))
    return Window(col0, row0, cols, rows)


def _errors_in_window(
    survey: SyntheticSurvey,
    job: RectifyJob,
    product: Product,
    photographs: list[int],
    window: Window,
    spots: NDArray[np.int64],
) -> Array:
    """Differences (n, 2) at pixels (row, col) of a window, in every photograph that sees them."""
    shown = _shown_ground(job, product, window)
    pixels = spots[:, ::-1] + np.array([window.col0 + 0.5, window.row0 + 0.5])
    ground = pixels if product == "orthophoto" else true_mate_ground(survey, job, pixels)
    points = survey.world.on_ground(job.grid.map_from_pixel(ground))
    errors = [np.empty((0, 2))]
    for p in photographs:
        used, valid = _positions(job, shown, p)
        there = valid[spots[:, 0], spots[:, 1]]
        if there.any():
            exact, inside = survey.project(survey.survey.index(job.photographs[p].name), points[there])
            # near the border one may be inside and the other not
            errors.append((used[spots[there, 0], spots[there, 1]] - exact)[inside])
    return np.concatenate(errors)


def _shown_ground(job: RectifyJob, product: Product, window: Window) -> tuple[Ground, Pixels, Array]:
    """Ground of a window, the ground positions its pixels show, and the nodes of all photographs."""
    if product == "orthophoto":
        ground = ground_of(job, window)
        columns = np.arange(window.cols, dtype=np.float32)[None, :] + np.float32(0.5)
        heights = heights_of(job, ground, "ortho heights")
    else:
        ground = shown_ground(job, window)
        columns, heights, _ = mate_positions(job, window, ground)
    nodes = np.empty(0) if ground.is_void else camera_nodes(job, ground)
    return ground, Pixels(window, columns, heights), nodes


def _positions(
    job: RectifyJob, shown: tuple[Ground, Pixels, Array], p: int
) -> tuple[Array, NDArray[np.bool_]]:
    """Photograph positions (rows, cols, 2) that a product uses in a window, and where it has any."""
    ground, pixels, nodes = shown
    window = pixels.window
    shape = (window.rows, window.cols)
    positions, valid = np.zeros((*shape, 2)), np.zeros(shape, dtype=np.uint8)
    if ground.is_void:
        return positions, valid != 0
    camera = job.photographs[p].camera
    code, parameters = camera.kernel_parameters()
    middle = (camera.size_px[0] // 2, camera.size_px[1] // 2)
    map_x, map_y = np.empty(shape, np.float32), np.empty(shape, np.float32)
    lattice = ground.lattice
    warp(
        pixels.columns, pixels.heights, np.empty((0, 0), np.uint16), 1, nodes[p],
        lattice.col0 - window.col0, lattice.row0, lattice.step, float(window.row0), code, parameters, 1.0,
        float(middle[0]), float(middle[1]), map_x, map_y, valid,
    )  # fmt: skip
    positions[..., 0], positions[..., 1] = map_x, map_y
    return positions + np.array(middle) + 0.5, valid != 0


def true_mate_ground(survey: SyntheticSurvey, job: RectifyJob, pixels: Array) -> Array:
    """Ground (n, 2) in product pixels that stereomate pixels (n, 2) must show; NaN where there is none.

    The largest column x with x - q(h(x)) at the pixel, found by scanning the row in steps of a quarter pixel
    and bisection: where the stereomate folds, the upper surface wins.
    """
    world, gsd = survey.world, job.grid.gsd

    def shown(columns: Array) -> Array:
        """Where ground columns (n, m) of the pixels' rows appear, less the pixels' own columns."""
        rows = np.broadcast_to(pixels[:, 1:], columns.shape)
        heights = world.height(job.grid.map_from_pixel(np.stack([columns, rows], axis=-1)))
        return np.asarray(columns - job.law.q(heights) / gsd - pixels[:, :1])

    low, high = (float(q) / gsd for q in job.law.q([world.heights.min(), world.heights.max()]))
    steps = np.arange(low - 1.0, high + 1.0 + _SCAN_STEP_PX, _SCAN_STEP_PX)
    scanned = pixels[:, :1] + steps
    signs = shown(scanned) < 0.0
    crossing = signs[:, :-1] & ~signs[:, 1:]
    last = crossing.shape[1] - 1 - np.argmax(crossing[:, ::-1], axis=1)
    left = np.take_along_axis(scanned, last[:, None], axis=1)
    right = left + _SCAN_STEP_PX
    for _ in range(40):
        middle = 0.5 * (left + right)
        below = shown(middle) < 0.0
        left, right = np.where(below, middle, left), np.where(below, right, middle)
    columns = np.where(crossing.any(axis=1), 0.5 * (left + right)[:, 0], np.nan)
    return np.stack([columns, pixels[:, 1]], axis=-1)


def matched_error(survey: SyntheticSurvey, job: RectifyJob, agreement: Agreement) -> MatchedError:
    """Residual parallaxes of a product's own matches that lie on open ground, and the heights they read.

    The heights are read as a person with a stereoscope would: from the parallax through the inverse of the
    law, against the true height of the ground.
    """
    open_ground = survey.world.is_clear(agreement.points)
    points, residuals = agreement.points[open_ground], agreement.residuals[open_ground]
    if len(points) == 0:
        nothing = (float("nan"), float("nan"))
        return MatchedError(0, nothing, nothing, float("nan"), float("nan"), float("nan"))
    median = np.median(residuals, axis=0)
    spread = NMAD * np.median(np.abs(residuals - median), axis=0)
    heights = survey.world.height(points)
    read = np.asarray(job.law.inverse(job.law.q(heights) + residuals[:, 0] * job.grid.gsd))
    error = read - heights
    sigma = float(NMAD * np.median(np.abs(error - np.median(error))))
    return MatchedError(
        len(points),
        (float(median[0]), float(median[1])),
        (float(spread[0]), float(spread[1])),
        float(error.mean()),
        sigma,
        3.0 * error_of_mean(error, job.grid.pixel_from_map(points)),
    )


def error_of_mean(values: Array, pixels: Array) -> float:
    """Standard deviation of the mean of values (n,) that err alike within blocks of ground.

    By the sums of blocks of 256 x 256 of the product's `pixels` (n, 2): the variance of a mean of clusters,
    with no model of how they are correlated. NaN where all lie in one block.
    """
    _, block = np.unique(np.floor(pixels / _BLOCK_PX).astype(np.int64), axis=0, return_inverse=True)
    count = int(block.max()) + 1
    if count < 2:
        return float("nan")
    away = np.bincount(block, values - values.mean())
    return float(np.sqrt(np.sum(away**2) * count / (count - 1.0)) / len(values))
