"""Summary of a homogeneity map: shares of the area, errors, and laws compared."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from stereomate.parallax.laws import ParallaxLaw
from stereomate.rectify.job import RectifyJob
from stereomate.stereo.kernels import homogeneity as kernels

Floats32 = NDArray[np.float32]

# Shares are of |t_x| up to these.
LIMITS: Final = (0.05, 0.10)
_BINS: Final = np.linspace(-1.0, 1.0, 201)


@dataclass(frozen=True)
class LawSummary:
    """Heights of objects read through a law, relative to their own, over the area seen by both.

    Attributes
    ----------
    kind : str
    within_5_percent, within_10_percent : float
        Shares of the area.
    mean, rms, largest : float
    """

    kind: str
    within_5_percent: float
    within_10_percent: float
    mean: float
    rms: float
    largest: float


@dataclass(frozen=True, eq=False)
class HomogeneitySummary:
    """A homogeneity map in figures.

    Attributes
    ----------
    object_height_m : float
    area_m2 : float
        Ground that a model serves.
    seen_by_both : float
        Share of it on which the object appears in both photographs.
    within_5_percent, within_10_percent : float
        Shares of the area seen by both with \\|t_x\\| up to these.
    t_y_within_5_percent : float
        The same of \\|t_y\\|.
    error_rms_m : float
        Of object heights read through the product's law.
    t_x_histogram : ndarray of int (200,)
        Positions by t_x from -1 to 1.
    laws : tuple of LawSummary
        The product's law first.
    path : Path or None
    """

    object_height_m: float
    area_m2: float
    seen_by_both: float
    within_5_percent: float
    within_10_percent: float
    t_y_within_5_percent: float
    error_rms_m: float
    t_x_histogram: NDArray[np.int64]
    laws: tuple[LawSummary, ...]
    path: Path | None = None

    def as_record(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "object_height_m": self.object_height_m,
            "area_m2": self.area_m2,
            "seen_by_both": self.seen_by_both,
            "within_5_percent": self.within_5_percent,
            "within_10_percent": self.within_10_percent,
            "t_y_within_5_percent": self.t_y_within_5_percent,
            "error_rms_m": self.error_rms_m,
            "laws": [vars(law) for law in self.laws],
            "file": None if self.path is None else self.path.name,
        }


def map_counts(values: Floats32) -> dict[str, Any]:
    """What the summary needs of a part of a map (rows, cols, 4), as plain values."""
    t_x, t_y, error, seen = np.moveaxis(values, -1, 0)
    known = np.isfinite(t_x)
    t_x, t_y, error = t_x[known], t_y[known], error[known].astype(np.float64)
    return {
        "served": int(np.isfinite(seen).sum()),
        "both": int((seen == 3.0).sum()),
        "known": int(known.sum()),
        "within": [int((np.abs(t_x) <= limit).sum()) for limit in LIMITS],
        "t_y_within": int((np.abs(t_y) <= LIMITS[0]).sum()),
        "error_squares": float(np.sum(np.square(error[np.isfinite(error)]))),
        "histogram": np.histogram(t_x, _BINS)[0].tolist(),
    }


def map_summary(
    job: RectifyJob,
    laws: tuple[ParallaxLaw, ...],
    object_height_m: float,
    found: list[dict[str, Any]],
    path: Path | None,
) -> HomogeneitySummary:
    """The summary of a map from `map_counts` and the statistics of its parts.

    Parameters
    ----------
    laws : tuple of ParallaxLaw
        The job's own first, then those it is compared with, as in the statistics.
    """

    def total(key: str) -> float:
        return float(sum(part[key] for part in found))

    def share(count: float, of: float) -> float:
        return count / of if of else math.nan

    statistics = np.array([part["statistics"] for part in found])
    sums, largest = statistics.sum(axis=0), statistics.max(axis=0)[:, kernels.LARGEST]
    compared = []
    for law, row, most in zip(laws, sums, largest, strict=True):
        count = row[kernels.COUNT]
        compared.append(
            LawSummary(
                law.kind,
                share(row[kernels.WITHIN_5], count),
                share(row[kernels.WITHIN_10], count),
                share(row[kernels.SUM], count),
                math.sqrt(row[kernels.SQUARES] / count) if count else math.nan,
                float(most),
            )
        )
    within = np.sum([part["within"] for part in found], axis=0)
    known = total("known")
    return HomogeneitySummary(
        object_height_m=object_height_m,
        area_m2=total("served") * (job.grid.gsd * job.frame.unit_m) ** 2,
        seen_by_both=share(total("both"), total("served")),
        within_5_percent=share(float(within[0]), known),
        within_10_percent=share(float(within[1]), known),
        t_y_within_5_percent=share(total("t_y_within"), known),
        error_rms_m=math.sqrt(total("error_squares") / known) if known else math.nan,
        t_x_histogram=np.sum([part["histogram"] for part in found], axis=0).astype(np.int64),
        laws=tuple(compared),
        path=path,
    )
