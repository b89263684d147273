"""How well the rays of each model meet: the quality of its orientation, as the product itself shows it.

The miss distance of two rays that show the same point says how good the orientation is, whatever the height
model. The y-parallax in the product stands beside it: it also holds the height model's error times t_y.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from stereomate.stereo.agreement import Agreement
from stereomate.stereo.measured import MeasureOptions
from stereomate.stereo.product import StereoProduct

Floats = NDArray[np.float64]

NMAD: Final = 1.4826
# Classes of distances: so many per pixel, up to so many pixels on both sides.
_PER_PIXEL: Final = 100
_REACH_PX: Final = 4
_CLASSES: Final = 2 * _PER_PIXEL * _REACH_PX


@dataclass(frozen=True)
class ModelQuality:
    """Miss distances and y-parallaxes of a model, metres; left minus right across the rows, north positive.

    Attributes
    ----------
    left, right : str
        Names of the photographs.
    count : int
        Matches.
    miss_median_m, miss_nmad_m, miss_rms_m : float
        Shortest distance of the rays, with its sign.
    y_median_m, y_nmad_m, y_rms_m : float
        y-parallax in the product.
    """

    left: str
    right: str
    count: int
    miss_median_m: float
    miss_nmad_m: float
    miss_rms_m: float
    y_median_m: float
    y_nmad_m: float
    y_rms_m: float

    def as_record(self) -> dict[str, Any]:
        """Plain values."""
        return dict(vars(self))


def quality_of(names: tuple[str, str], miss: Floats, y_parallax: Floats) -> ModelQuality:
    """Statistics of miss distances (n,) and y-parallaxes (n,) of one model, metres."""
    figures: list[float] = []
    for values in (miss, y_parallax):
        median = float(np.median(values))
        nmad = NMAD * float(np.median(np.abs(values - median)))
        figures += [median, nmad, float(np.sqrt(np.mean(values**2)))]
    return ModelQuality(*names, len(miss), *figures)


def quality_of_agreement(product: StereoProduct, agreement: Agreement) -> tuple[ModelQuality, ...]:
    """Of the models behind the matches of a product's agreement, most matches first."""
    job, gsd = product.job, product.job.grid.gsd
    if len(agreement.points) == 0:
        return ()
    left = job.grid.uv_from_map(agreement.points)
    # rows count downwards, v upwards
    shift = np.stack(
        [-(agreement.parallaxes + agreement.residuals[:, 0]), agreement.residuals[:, 1]], axis=-1
    )
    right = job.grid.map_from_uv(left + gsd * shift)
    found = product.measure(agreement.points, right, MeasureOptions(check_hidden=False))
    good = found.measured & np.isfinite(found.miss_m)
    qualities = []
    for pair in np.unique(found.photographs[good], axis=0):
        mine = good & (found.photographs == pair).all(axis=1)
        names = job.photographs[pair[0]].name, job.photographs[pair[1]].name
        miss = found.miss_m[mine] * np.where(found.standardized[mine] < 0.0, -1.0, 1.0)
        qualities.append(quality_of(names, miss, found.y_parallax_m[mine]))
    return tuple(sorted(qualities, key=lambda q: -q.count))


@dataclass(eq=False)
class ModelTally:
    """Counts of many matches per pair of photographs, from which `qualities` takes medians."""

    gsd: float
    counts: dict[str, dict[str, list[float]]] = field(default_factory=dict)

    def add(self, photographs: NDArray[np.int16], miss: NDArray[Any], y_parallax: NDArray[Any]) -> None:
        """Take in points: photographs (2, ...), miss distances and y-parallaxes (...) in units of the gsd."""
        known = np.isfinite(miss) & np.isfinite(y_parallax) & (photographs[0] >= 0)
        pairs = photographs[:, known].astype(np.int64)
        values = np.stack([miss[known], y_parallax[known]]).astype(np.float64) / self.gsd
        key = pairs[0] * 65536 + pairs[1]
        for k in np.unique(key):
            mine = values[:, key == k]
            name = f"{k // 65536} {k % 65536}"
            entry = {
                "n": [float(mine.shape[1])],
                "squares": np.sum(mine**2, axis=1).tolist(),
                "miss": _histogram(mine[0]),
                "y": _histogram(mine[1]),
            }
            self._merge(name, entry)

    def merge(self, counts: Mapping[str, Mapping[str, list[float]]]) -> None:
        """Add counts of another tally."""
        for name, entry in counts.items():
            self._merge(name, entry)

    def _merge(self, name: str, entry: Mapping[str, list[float]]) -> None:
        mine = self.counts.setdefault(name, {})
        for key, values in entry.items():
            before = mine.get(key)
            mine[key] = list(values) if before is None else (np.add(before, values)).tolist()

    def qualities(self, names: Iterable[str], unit_m: float) -> tuple[ModelQuality, ...]:
        """Of every pair, named as the photographs, most matches first; `unit_m` metres per map unit."""
        every = list(names)
        scale = self.gsd * unit_m
        found = []
        for pair, entry in self.counts.items():
            left, right = (every[int(k)] for k in pair.split())
            n = entry["n"][0]
            figures = []
            for k, what in enumerate(("miss", "y")):
                median, nmad = _median_and_nmad(np.array(entry[what]))
                figures += [scale * median, scale * nmad, scale * float(np.sqrt(entry["squares"][k] / n))]
            found.append(ModelQuality(left, right, int(n), *figures))
        return tuple(sorted(found, key=lambda q: -q.count))


def _histogram(values_px: Floats) -> list[float]:
    inside = np.clip(values_px, -_REACH_PX + 1e-9, _REACH_PX - 1e-9)
    counts: list[float] = np.histogram(inside, _CLASSES, (-_REACH_PX, _REACH_PX))[0].tolist()
    return counts


def _median_and_nmad(counts: Floats) -> tuple[float, float]:
    """From a histogram, interpolated inside its classes."""
    edges = np.linspace(-_REACH_PX, _REACH_PX, _CLASSES + 1)
    below = np.concatenate([[0.0], np.cumsum(counts)]) / counts.sum()
    median = float(np.interp(0.5, below, edges))
    # share of values within a distance of the median
    distances = np.linspace(0.0, 2.0 * _REACH_PX, 4 * _CLASSES)
    within = np.interp(median + distances, edges, below) - np.interp(median - distances, edges, below)
    return median, NMAD * float(np.interp(0.5, within, distances))
