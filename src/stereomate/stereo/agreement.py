"""How well left and right agree in a product, measured by image matching on a sample of windows.

Two figures, stated with every run. Orthophoto against orthophoto: the left and the right photographs, each
rectified over the same height model, must show the same ground at the same place; what remains is the error
of orientation and height model. Orthophoto against stereomate: the measured x-parallax minus q(h), and the
y-parallax, of what a person sees in stereo. Left minus right, in product pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stereomate.raster import Window
from stereomate.rectify.engine import Part, orthophoto_part, stereomate_part
from stereomate.rectify.ground import ground_of, heights_of
from stereomate.rectify.job import RectifyJob

Floats = NDArray[np.float64]

NMAD = 1.4826


@dataclass(frozen=True)
class MatchOptions:
    """How parallaxes are measured: normalised cross-correlation, then sub-pixel.

    Attributes
    ----------
    template_px : int
        Edge of the template, odd.
    search_px : int
        Search on each side of the predicted position.
    min_correlation : float
        Weaker peaks are not used.
    spacing_px : int
        Least distance of points.
    """

    template_px: int = 21
    search_px: int = 5
    min_correlation: float = 0.8
    spacing_px: int = 12


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
    """

    count: int
    median_px: tuple[float, float]
    nmad_px: tuple[float, float]
    largest_px: tuple[float, float]


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


def statistics(residuals: Floats) -> ParallaxStatistics:
    """Robust statistics of residual parallaxes (n, 2)."""
    if len(residuals) == 0:
        nothing = (float("nan"), float("nan"))
        return ParallaxStatistics(0, nothing, nothing, nothing)
    median = np.median(residuals, axis=0)
    nmad = NMAD * np.median(np.abs(residuals - median), axis=0)
    largest = np.abs(residuals).max(axis=0)
    return ParallaxStatistics(len(residuals), _pair(median), _pair(nmad), _pair(largest))


def sample_windows(size: tuple[int, int], edge: int, count: int) -> list[Window]:
    """About `count` windows of `edge` pixels spread evenly over a raster."""
    cols, rows = max(1, size[0] // edge), max(1, size[1] // edge)
    cells = [(c, r) for r in range(rows) for c in range(cols)]
    step = max(1.0, len(cells) / count)
    chosen = [cells[int((k + 0.5) * step)] for k in range(min(count, len(cells)))]
    pad_x, pad_y = (size[0] - cols * edge) // 2, (size[1] - rows * edge) // 2
    return [
        Window(max(pad_x, 0) + c * edge, max(pad_y, 0) + r * edge, min(edge, size[0]), min(edge, size[1]))
        for c, r in chosen
    ]


def measure_agreement(
    job: RectifyJob, windows: list[Window], options: MatchOptions | None = None
) -> Agreement:
    """Match orthophoto against orthophoto and against stereomate in windows of the product."""
    options = options or MatchOptions()
    plain, stereo, points, parallaxes = [], [], [], []
    for window in windows:
        left = _copy(orthophoto_part(job, window, "left"))
        if not left.valid.any():
            continue
        texture = _texture_points(left, options)
        right = _copy(orthophoto_part(job, window, "right"))
        _, residual = _matched(left, right, texture, np.zeros(len(texture)), 0, options)
        plain.append(residual)
        heights = heights_of(job, ground_of(job, window), "ortho heights")
        q = _parallax_px(job, heights, texture)
        at, residual, shown = _match_stereomate(job, window, left, texture, q, options)
        pixels = at + np.array([window.col0 + 0.5, window.row0 + 0.5])
        points.append(job.grid.map_from_pixel(pixels))
        stereo.append(residual)
        parallaxes.append(shown)
    residuals = np.concatenate([*stereo, np.empty((0, 2))])
    return Agreement(
        statistics(np.concatenate([*plain, np.empty((0, 2))])),
        statistics(residuals),
        np.concatenate([*points, np.empty((0, 2))]),
        residuals,
        np.concatenate([*parallaxes, np.empty(0)]),
    )


def _match_stereomate(
    job: RectifyJob, window: Window, left: Part, texture: Floats, q: Floats, options: MatchOptions
) -> tuple[Floats, Floats, Floats]:
    known = np.isfinite(q)
    texture, q = texture[known], q[known]
    if len(q) == 0:
        return np.empty((0, 2)), np.empty((0, 2)), np.empty(0)
    # The ground of the window lies in the stereomate between these columns.
    first = window.col0 - int(np.ceil(q.max())) - options.search_px - options.template_px
    last = window.col1 - int(np.floor(q.min())) + options.search_px + options.template_px
    mate = stereomate_part(job, Window(first, window.row0, last - first, window.rows))
    kept, residual = _matched(left, mate, texture, q, window.col0 - first, options)
    return texture[kept], residual, q[kept]


def _parallax_px(job: RectifyJob, heights: NDArray[np.float32], points: Floats) -> Floats:
    cols, rows = points[:, 0].astype(int), points[:, 1].astype(int)
    return np.asarray(job.law.q(heights[rows, cols].astype(np.float64))) / job.grid.gsd


def _texture_points(part: Part, options: MatchOptions) -> Floats:
    grey = _grey(part.pixels)
    edge = options.template_px // 2 + options.search_px + 1
    inner = cv2.erode(part.valid, np.ones((2 * edge + 1, 2 * edge + 1), np.uint8), borderValue=0)
    found = cv2.goodFeaturesToTrack(grey, 400, 0.01, options.spacing_px, mask=inner)
    return np.empty((0, 2)) if found is None else found[:, 0, :].astype(np.float64)


def _matched(
    left: Part, right: Part, points: Floats, q: Floats, offset: int, options: MatchOptions
) -> tuple[NDArray[np.int64], Floats]:
    """Indices of the points that match, and their (x-parallax - q, y-parallax)."""
    a, b = _grey(left.pixels), _grey(right.pixels)
    kept, residuals = [], []
    for k, (x, y) in enumerate(points):
        predicted = x - q[k] + offset
        found = _correlate(a, b, right.valid, (round(x), round(y)), round(predicted), options)
        if found is not None:
            parallax = (round(x) + offset - found[0], round(y) - found[1])
            kept.append(k)
            residuals.append((parallax[0] - q[k], parallax[1]))
    return np.array(kept, np.int64), np.array(residuals, np.float64).reshape(-1, 2)


def _correlate(
    a: NDArray[np.uint8],
    b: NDArray[np.uint8],
    valid: NDArray[np.uint8],
    at: tuple[int, int],
    predicted: int,
    options: MatchOptions,
) -> tuple[float, float] | None:
    """Sub-pixel position in `b` of the template around `at` in `a`; None if there is no good peak inside."""
    half, search = options.template_px // 2, options.search_px
    x, y = at
    reach = half + search
    if y - reach < 0 or y + reach >= b.shape[0] or predicted - reach < 0 or predicted + reach >= b.shape[1]:
        return None
    area = (slice(y - reach, y + reach + 1), slice(predicted - reach, predicted + reach + 1))
    template = a[y - half : y + half + 1, x - half : x + half + 1]
    if not valid[area].all() or template.shape != (2 * half + 1, 2 * half + 1):
        return None
    score = cv2.matchTemplate(b[area], template, cv2.TM_CCOEFF_NORMED)
    row, col = np.unravel_index(int(np.argmax(score)), score.shape)
    if not (0 < row < 2 * search and 0 < col < 2 * search) or score[row, col] < options.min_correlation:
        return None
    dx = _peak(score[row, col - 1], score[row, col], score[row, col + 1])
    dy = _peak(score[row - 1, col], score[row, col], score[row + 1, col])
    return predicted + int(col) - search + dx, y + int(row) - search + dy


def _peak(before: float, at: float, after: float) -> float:
    """Vertex of the parabola through three values."""
    bend = before - 2.0 * at + after
    return 0.0 if bend >= 0.0 else float(0.5 * (before - after) / bend)


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
