"""Accuracy of a product from independent check points, in the terms of the standards.

ASPRS Positional Accuracy Standards for Digital Geospatial Data, edition 2 (2023): root mean square errors,
the error of the survey of the check points included, at least 30 points; no 95 % figures. ISO 19157: the
basic measures of positional accuracy by their numbers. Both say nothing where there are too few points, and
so does this module.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import InputError

Array = NDArray[np.float64]
Verdict = Literal["pass", "fail", "not assessed"]

ASPRS_LEAST_POINTS: Final = 30
# Quantiles of the normal distribution of one, of the Rayleigh distribution of two coordinates.
_LE95: Final = 1.959964
_CE95: Final = 2.447747


@dataclass(frozen=True)
class ComponentAccuracy:
    """One component: `points`, mean, standard deviation about the mean, and root mean square, metres.

    `survey_m` is the root mean square of the check points' own standard deviations; `total_m` holds both:
    ``hypot(rmse, survey)``.
    """

    points: int
    mean_m: float
    std_m: float
    rmse_m: float
    survey_m: float

    @property
    def total_m(self) -> float:
        """Root mean square error with that of the survey of the check points."""
        return math.hypot(self.rmse_m, self.survey_m)


@dataclass(frozen=True)
class PointAccuracy:
    """Accuracy by check points.

    Attributes
    ----------
    east, north, height : ComponentAccuracy
    horizontal_points, spatial_points : int
        Points with both plan coordinates, and with all three.
    horizontal_m : float
        Radial root mean square error in plan, with the survey's: ``sqrt(RMSE_x² + RMSE_y² + RMSE_survey²)``.
    vertical_m : float
    """

    east: ComponentAccuracy
    north: ComponentAccuracy
    height: ComponentAccuracy
    horizontal_points: int
    spatial_points: int

    @property
    def horizontal_m(self) -> float:
        """``RMSE_H``, metres; NaN without points."""
        return math.hypot(self.east.total_m, self.north.total_m)

    @property
    def vertical_m(self) -> float:
        """``RMSE_V``, metres; NaN without points."""
        return self.height.total_m

    @property
    def spatial_m(self) -> float:
        """``RMSE_3D = hypot(RMSE_H, RMSE_V)``, metres."""
        return math.hypot(self.horizontal_m, self.vertical_m)

    def verdict(self, part: Literal["horizontal", "vertical"], requested_m: float | None) -> Verdict:
        """Whether a requested accuracy (root mean square, metres) is kept, where there are points enough."""
        count = self.horizontal_points if part == "horizontal" else self.height.points
        if requested_m is None or count < ASPRS_LEAST_POINTS:
            return "not assessed"
        return (
            "pass"
            if (self.horizontal_m if part == "horizontal" else self.vertical_m) <= requested_m
            else "fail"
        )

    def statement(self, part: Literal["horizontal", "vertical"]) -> str:
        """The sentence of ASPRS 2023, or why it cannot be said."""
        count = self.horizontal_points if part == "horizontal" else self.height.points
        if count < ASPRS_LEAST_POINTS:
            return (
                f"ASPRS 2023 {part} accuracy is not stated: {count} check points, at least "
                f"{ASPRS_LEAST_POINTS} are needed"
            )
        value = self.horizontal_m if part == "horizontal" else self.vertical_m
        name = "RMSE_H" if part == "horizontal" else "RMSE_V"
        return (
            f"Tested by {count} check points to {name} = {100.0 * value:.1f} cm, their own survey "
            f"included: {accuracy_class_cm(value):g}-cm {part} class of ASPRS 2023"
        )

    def iso19157(self) -> tuple[dict[str, Any], ...]:
        """Measures of ISO 19157 with their numbers; those of too few points (fewer than 2) are left out."""
        measures: list[dict[str, Any]] = []

        def add(identifier: int, name: str, value: float, points: int) -> None:
            measures.append({"measure": identifier, "name": name, "value_m": value, "points": points})

        for name, part in (("east", self.east), ("north", self.north), ("height", self.height)):
            if part.points:
                add(128, f"bias of positions, {name}", part.mean_m, part.points)
        if self.height.points >= 2:
            add(39, "root mean square error, height", self.height.rmse_m, self.height.points)
            add(36, "linear map accuracy at 95 %, height", _LE95 * self.height.rmse_m, self.height.points)
        if self.horizontal_points >= 2:
            plan = math.hypot(self.east.rmse_m, self.north.rmse_m)
            add(47, "root mean square error of planimetry", plan, self.horizontal_points)
            circular = _CE95 * plan / math.sqrt(2.0)
            add(45, "circular error at 95 %", circular, self.horizontal_points)
        return tuple(measures)

    def as_record(self) -> dict[str, Any]:
        """For JSON; None where a figure is not known."""
        parts = {
            name: {
                "points": part.points,
                **{
                    key: _known(getattr(part, key))
                    for key in ("mean_m", "std_m", "rmse_m", "survey_m", "total_m")
                },
            }
            for name, part in (("east", self.east), ("north", self.north), ("height", self.height))
        }
        return {
            **parts,
            "horizontal_points": self.horizontal_points,
            "spatial_points": self.spatial_points,
            "rmse_h_m": _known(self.horizontal_m),
            "rmse_v_m": _known(self.vertical_m),
            "rmse_3d_m": _known(self.spatial_m),
            "asprs_2023": {part: self.statement(part) for part in ("horizontal", "vertical")},
            "iso_19157": list(self.iso19157()),
        }


def point_accuracy(differences_m: ArrayLike, sigma_m: ArrayLike | None = None) -> PointAccuracy:
    """Accuracy from differences product minus check point.

    Parameters
    ----------
    differences_m : array_like (n, 3)
        East, north, height; NaN where the check point has no such coordinate.
    sigma_m : array_like (n, 3), optional
        Standard deviations of the check points; zero if not given.

    Raises
    ------
    InputError
        If the shapes do not fit or a standard deviation is negative.
    """
    d = np.asarray(differences_m, np.float64)
    s = np.zeros_like(d) if sigma_m is None else np.asarray(sigma_m, np.float64)
    if d.ndim != 2 or d.shape[1] != 3 or s.shape != d.shape:
        raise InputError(
            "must be two arrays (n, 3)", field="differences_m, sigma_m", value=(d.shape, s.shape)
        )
    if (s < 0.0).any():
        raise InputError("must not be negative", field="sigma_m", value=float(s.min()))
    east, north, height = (_component(d[:, k], s[:, k]) for k in range(3))
    plan = np.isfinite(d[:, :2]).all(axis=1)
    return PointAccuracy(east, north, height, int(plan.sum()), int((plan & np.isfinite(d[:, 2])).sum()))


def accuracy_class_cm(rmse_m: float) -> float:
    """The smallest class, in centimetres with two digits, that a root mean square error keeps."""
    cm = 100.0 * rmse_m
    if not cm > 0.0:
        return 0.0
    step = 10.0 ** (math.floor(math.log10(cm)) - 1)
    return float(f"{math.ceil(cm / step - 1e-9) * step:.12g}")


def _component(differences: Array, sigma: Array) -> ComponentAccuracy:
    known = np.isfinite(differences)
    d, s = differences[known], sigma[known]
    if not d.size:
        return ComponentAccuracy(0, math.nan, math.nan, math.nan, math.nan)
    return ComponentAccuracy(
        d.size,
        float(d.mean()),
        float(d.std(ddof=1)) if d.size > 1 else math.nan,
        float(np.sqrt(np.mean(d * d))),
        float(np.sqrt(np.mean(s * s))),
    )


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None
