"""How well left and right agree in a product, measured by image matching on a sample of windows.

Two figures, stated with every run. Orthophoto against orthophoto: the left and the right photographs, each
rectified over the same height model, must show the same ground at the same place; what remains is the error
of orientation and height model. Orthophoto against stereomate: the measured x-parallax minus q(h), and the
y-parallax, of what a person sees in stereo. Left minus right, in product pixels.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from stereomate.measurement.least_squares_matching import LeastSquaresOptions, match_least_squares
from stereomate.raster import Window
from stereomate.rectify.engine import Part, orthophoto_part, stereomate_part
from stereomate.rectify.ground import ground_of, heights_of
from stereomate.rectify.job import RectifyJob
from stereomate.rectify.serving import camera_nodes, models_of_window
from stereomate.tiles import Executor, map_items

Floats = NDArray[np.float64]

NMAD = 1.4826

# Weakest corner that is matched, as a share of the strongest of its window.
_LEAST_CORNER: Final = 0.002
# Edges of the blocks that are drawn anew for the error of a median, how many there must be, and how often.
_BLOCKS_PX: Final = (256, 128, 64)
_LEAST_BLOCKS: Final = 8
_DRAWS: Final = 200
_SEED: Final = 1


@dataclass(frozen=True)
class AgreementOptions:
    """Where and how parallaxes are measured: normalised cross-correlation, then least-squares matching.

    Attributes
    ----------
    windows : int
        Windows in which points are matched, spread over the product, as far as there is common ground.
    window_px : int
        Largest edge of a window.
    points : int
        At most so many, the same share for each window.
    template_px : int
        Edge of the template of the correlation, odd.
    search_px : int
        Search on each side of the predicted position.
    min_correlation : float
        Weaker peaks are not refined.
    radius_px : int
        Of the window of the least-squares matching, whose affine part takes up the slope of the parallax.
    spacing_px : int
        Least distance of points.
    """

    windows: int = 12
    window_px: int = 512
    points: int = 4800
    template_px: int = 21
    search_px: int = 5
    min_correlation: float = 0.6
    radius_px: int = 8
    spacing_px: int = 10

    @property
    def reach_px(self) -> int:
        """Pixels around a point that its measurement looks at."""
        return max(self.template_px // 2, self.radius_px) + self.search_px + 3


@dataclass(frozen=True)
class ParallaxStatistics:
    """Median and normalised median absolute deviation of measured parallaxes, product pixels.

    Attributes
    ----------
    count : int
        Matches.
    median_px, nmad_px : (x, y)
        NaN without matches.
    largest_px : (x, y)
        Largest parallax in absolute value.
    standard_error_px : (x, y)
        Of the median. Neighbouring residuals share the error of the height model between its nodes and are
        not independent, so whole blocks of the product are drawn anew (bootstrap); NaN with too few blocks.
    """

    count: int
    median_px: tuple[float, float]
    nmad_px: tuple[float, float]
    largest_px: tuple[float, float]
    standard_error_px: tuple[float, float] = (math.nan, math.nan)


@dataclass(frozen=True, eq=False)
class Agreement:
    """Measured agreement of a product.

    Attributes
    ----------
    ortho_ortho, ortho_mate : ParallaxStatistics
        Of the residuals: for the stereomate the x-parallax minus q(h).
    points : (n, 2)
        Map positions of the matches in orthophoto and stereomate.
    residuals : (n, 2)
        Their residual parallaxes in pixels.
    parallaxes : (n,)
        q(h) at the matches, pixels.
    """

    ortho_ortho: ParallaxStatistics
    ortho_mate: ParallaxStatistics
    points: Floats
    residuals: Floats
    parallaxes: Floats

    @property
    def parallax_range_px(self) -> tuple[float, float]:
        """Least and greatest artificial parallax at the matches; NaN without."""
        if not len(self.parallaxes):
            return float("nan"), float("nan")
        return float(self.parallaxes.min()), float(self.parallaxes.max())

    def as_record(self) -> dict[str, Any]:
        """Plain values for stereo.json and the report."""
        return {
            "orthophoto_against_orthophoto": vars(self.ortho_ortho),
            "orthophoto_against_stereomate": vars(self.ortho_mate),
            "parallax_range_px": list(self.parallax_range_px),
        }


def statistics(residuals: Floats, pixels: Floats) -> ParallaxStatistics:
    """Robust statistics of residual parallaxes (n, 2) at product pixels (n, 2)."""
    nothing = (math.nan, math.nan)
    if len(residuals) == 0:
        return ParallaxStatistics(0, nothing, nothing, nothing, nothing)
    median = np.median(residuals, axis=0)
    nmad = NMAD * np.median(np.abs(residuals - median), axis=0)
    largest = np.abs(residuals).max(axis=0)
    error = _standard_error(residuals, pixels)
    return ParallaxStatistics(len(residuals), _pair(median), _pair(nmad), _pair(largest), error)


def _standard_error(residuals: Floats, pixels: Floats) -> tuple[float, float]:
    """Of the medians, by drawing blocks with replacement: the largest blocks of which there are enough."""
    for edge in _BLOCKS_PX:
        cells = np.floor(pixels / edge).astype(np.int64)
        names, block = np.unique(cells, axis=0, return_inverse=True)
        if len(names) < _LEAST_BLOCKS:
            continue
        members = [np.flatnonzero(block == k) for k in range(len(names))]
        rng = np.random.default_rng(_SEED)
        drawn = [
            np.median(residuals[np.concatenate([members[k] for k in choice])], axis=0)
            for choice in rng.integers(0, len(names), (_DRAWS, len(names)))
        ]
        return _pair(np.std(drawn, axis=0, ddof=1))
    return math.nan, math.nan


def sample_windows(size: tuple[int, int], edge: int) -> list[Window]:
    """Windows of at most `edge` pixels that cover a raster without overlap, neighbours far apart in the list.

    Whoever takes the first few of them has a sample of the whole raster.
    """
    cols, rows = (math.ceil(n / edge) for n in size)
    count = cols * rows
    # Steps of about the golden section of the count visit every cell once, far from the ones before.
    step = next(k for k in itertools.count(round(0.618 * count)) if math.gcd(k, count) == 1)
    x, y = ([k * n // parts for k in range(parts + 1)] for n, parts in zip(size, (cols, rows), strict=True))
    order = (divmod(k * step % count, cols) for k in range(count))
    return [Window(x[c], y[r], x[c + 1] - x[c], y[r + 1] - y[r]) for r, c in order]


def measure_agreement(
    job: RectifyJob, options: AgreementOptions | None = None, executor: Executor | None = None
) -> Agreement:
    """Match orthophoto against orthophoto and against stereomate in windows of the product.

    Parameters
    ----------
    executor : Executor, optional
        Where the windows are matched; one thread without.
    """
    options = options or AgreementOptions()
    windows = _sample(job, options)
    match = _MatchWindow(job, options, options.points // max(len(windows), 1))
    found = [part for part in map_items(match, windows, executor) if part is not None]
    plain = _Matches.joined([part[0] for part in found])
    stereo = _Matches.joined([part[1] for part in found])
    return Agreement(
        statistics(plain.residuals, plain.pixels),
        statistics(stereo.residuals, stereo.pixels),
        job.grid.map_from_pixel(stereo.pixels),
        stereo.residuals,
        stereo.parallaxes,
    )


@dataclass(frozen=True)
class _MatchWindow:
    """Matches one window: orthophoto against orthophoto, and against stereomate; None without texture."""

    job: RectifyJob
    options: AgreementOptions
    points: int

    def __call__(self, window: Window) -> tuple[_Matches, _Matches] | None:
        job, options = self.job, self.options
        right = _copy(orthophoto_part(job, window, "right"))
        left = _copy(orthophoto_part(job, window, "left"))
        texture = _texture_points(left, right, self.points, options)
        if len(texture) == 0:
            return None
        plain = _matched(left, right, texture, np.zeros(len(texture)), 0, options)
        heights = heights_of(job, ground_of(job, window), "ortho heights")
        q = _parallax_px(job, heights, texture)
        stereo = _match_stereomate(job, window, left, texture, q, options)
        return _Matches(*plain).moved(window), _Matches(*stereo).moved(window)


def _sample(job: RectifyJob, options: AgreementOptions) -> list[Window]:
    """The windows to match in, with what the measurement looks at around them.

    Those in which a node of the lattice lies in both photographs of a model come first; where they are too
    few, those that may show such ground follow.
    """
    reach = options.reach_px
    sure: list[Window] = []
    unsure: list[Window] = []
    for core in sample_windows(job.grid.size, options.window_px):
        window = Window(core.col0 - reach, core.row0 - reach, core.cols + 2 * reach, core.rows + 2 * reach)
        ground = ground_of(job, window)
        if ground.is_void:
            continue
        nodes = camera_nodes(job, ground)
        models = [m for m in models_of_window(job, ground, nodes) if m.right >= 0]
        height = 0.5 * sum(ground.height_range)
        shown = _shown_by(job, nodes[..., :3] + height * nodes[..., 3:])
        if any((shown[m.left] & shown[m.right]).any() for m in models):
            sure.append(window)
        elif models:
            unsure.append(window)
        if len(sure) == options.windows:
            break
    return (sure + unsure)[: options.windows]


def _shown_by(job: RectifyJob, points: Floats) -> NDArray[np.bool_]:
    """Whether points of the camera frames (photographs, ..., 3) lie inside their photographs."""
    return np.array(
        [p.camera.image_from_camera(at)[1] for p, at in zip(job.photographs, points, strict=True)]
    )


@dataclass(frozen=True)
class _Matches:
    """Matches: product pixels (n, 2), residual parallaxes (n, 2), and the law's share (n,)."""

    pixels: Floats
    residuals: Floats
    parallaxes: Floats

    def moved(self, window: Window) -> _Matches:
        """The same, whose pixels were counted from a window's corner."""
        return replace(self, pixels=self.pixels + np.array([window.col0, window.row0]))

    @staticmethod
    def joined(parts: Sequence[_Matches]) -> _Matches:
        """Those of several windows."""
        nothing = np.empty((0, 2))
        return _Matches(
            np.concatenate([*(part.pixels for part in parts), nothing]),
            np.concatenate([*(part.residuals for part in parts), nothing]),
            np.concatenate([*(part.parallaxes for part in parts), nothing[:, 0]]),
        )


def _match_stereomate(
    job: RectifyJob, window: Window, left: Part, texture: Floats, q: Floats, options: AgreementOptions
) -> tuple[Floats, Floats, Floats]:
    known = np.isfinite(q)
    texture, q = texture[known], q[known]
    if len(q) == 0:
        return np.empty((0, 2)), np.empty((0, 2)), np.empty(0)
    # The ground of the window lies in the stereomate between these columns.
    first = window.col0 - math.ceil(q.max()) - options.reach_px
    last = window.col1 - math.floor(q.min()) + options.reach_px
    mate = stereomate_part(job, Window(first, window.row0, last - first, window.rows))
    return _matched(left, mate, texture, q, window.col0 - first, options)


def _parallax_px(job: RectifyJob, heights: NDArray[np.float32], points: Floats) -> Floats:
    cols, rows = points[:, 0].astype(int), points[:, 1].astype(int)
    return np.asarray(job.law.q(heights[rows, cols].astype(np.float64))) / job.grid.gsd


def _texture_points(left: Part, right: Part, most: int, options: AgreementOptions) -> Floats:
    """Centres of at most so many pixels with texture on ground that both show, off the window's border."""
    edge = options.reach_px
    both = np.minimum(left.valid, right.valid)
    inner = cv2.erode(both, np.ones((2 * edge + 1, 2 * edge + 1), np.uint8), borderValue=0)
    grey = _grey(left.pixels)
    found = cv2.goodFeaturesToTrack(grey, max(most, 1), _LEAST_CORNER, options.spacing_px, mask=inner)
    return np.empty((0, 2)) if found is None else found[:, 0, :].astype(np.float64) + 0.5


def _matched(
    left: Part, right: Part, points: Floats, q: Floats, offset: int, options: AgreementOptions
) -> tuple[Floats, Floats, Floats]:
    """Points that match, (x-parallax - q, y-parallax), and q; `right` begins `offset` columns earlier."""
    a, b = _grey(left.pixels), _grey(right.pixels)
    predicted = points + np.column_stack([offset - q, np.zeros(len(q))])
    found = np.array(
        [_correlate(a, b, right.valid, at, to, options) for at, to in zip(points, predicted, strict=True)]
    ).reshape(-1, 2)
    matches = match_least_squares(
        a, b, points, found, options=LeastSquaresOptions(radius_px=options.radius_px)
    )
    good = matches.matched
    parallax = points[good] + [offset, 0] - matches.right_px[good]
    parallax[:, 0] -= q[good]
    return points[good], parallax, q[good]


def _correlate(
    a: NDArray[np.uint8],
    b: NDArray[np.uint8],
    valid: NDArray[np.uint8],
    at: Floats,
    to: Floats,
    options: AgreementOptions,
) -> tuple[float, float]:
    """Where the template around the pixel `at` in `a` is most like `b` near `to`; NaN if nowhere enough."""
    half, search = options.template_px // 2, options.search_px
    x, y = math.floor(at[0]), math.floor(at[1])
    predicted = math.floor(to[0])
    reach = half + search
    if y - reach < 0 or y + reach >= b.shape[0] or predicted - reach < 0 or predicted + reach >= b.shape[1]:
        return math.nan, math.nan
    area = (slice(y - reach, y + reach + 1), slice(predicted - reach, predicted + reach + 1))
    if not valid[area].all():
        return math.nan, math.nan
    template = a[y - half : y + half + 1, x - half : x + half + 1]
    score = cv2.matchTemplate(b[area], template, cv2.TM_CCOEFF_NORMED)
    row, col = divmod(int(np.argmax(score)), score.shape[1])
    inside = 0 < row < 2 * search and 0 < col < 2 * search
    if not inside or score[row, col] < options.min_correlation:
        return math.nan, math.nan
    return predicted + col - search + 0.5, y + row - search + 0.5


def _grey(pixels: NDArray[Any]) -> NDArray[np.uint8]:
    """8-bit mean of the bands; other types stretched to the window's 1 to 99 percentiles."""
    mean = pixels.mean(axis=2, dtype=np.float32)
    if pixels.dtype != np.uint8:
        low, high = np.percentile(mean, (1.0, 99.0))
        mean = (mean - low) * (255.0 / max(high - low, 1e-6))
    grey: NDArray[np.uint8] = np.clip(np.rint(mean), 0, 255).astype(np.uint8)
    return grey


def _copy(part: Part) -> Part:
    return Part(part.pixels.copy(), part.valid.copy(), part.photograph.copy())


def _pair(values: Floats) -> tuple[float, float]:
    return float(values[0]), float(values[1])
