"""Parallax laws: how much a stereomate is shifted where the ground has a given height.

q(h) in ground metres along the rows of the product, for h above a reference level:

- linear: q = B h / w0, an oblique parallel projection;
- logarithmic: q = B ln(w0 / (w0 - h)); dq/dh = B / (w0 - h) is what a small object standing at level h
  shows, so that terrain and objects can be measured with one formula;
- natural: q = B h / (w0 - h), what a pair of photographs shows of the terrain itself;
- table: any rising function, through given points.

B, w0 and the reference level are nominal values of a product. Sources: Jachimski 1980, formula (17);
Blachut & van Wijk 1970; Collins 1970.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import InputError
from stereomate.parallax import kernels

Floats = NDArray[np.float64]
LawKind = Literal["linear", "logarithmic", "natural", "table", "none"]

_CODES: Final[dict[str, int]] = {
    "none": kernels.NONE,
    "linear": kernels.LINEAR,
    "logarithmic": kernels.LOGARITHMIC,
    "natural": kernels.NATURAL,
    "table": kernels.TABLE,
}


@dataclass(frozen=True)
class ParallaxLaw:
    """A parallax law q(h) with its nominal values.

    All heights given to and returned by the methods are in the height system of ``reference_m`` (the
    project's), not above the reference level. Methods take arrays of any shape.

    Attributes
    ----------
    kind : {"linear", "logarithmic", "natural", "table", "none"}
        "none" is q = 0: a pair of plain orthophotos.
    base_m : float
        Base B along the rows; positive, as the left photograph lies at the smaller column.
    w0_m : float
        Flying height above the reference level.
    reference_m : float
        Height of the reference level, where q = 0.
    table_heights_m, table_parallaxes_m : tuple of float
        For a table: heights above the reference level and their q, both strictly rising, two or more.
        In between a monotone cubic runs through them (PCHIP), beyond them straight lines.

    Raises
    ------
    InputError
        If base or w0 is not positive, a value is not finite, or the table does not rise.
    """

    kind: LawKind
    base_m: float
    w0_m: float
    reference_m: float = 0.0
    table_heights_m: tuple[float, ...] = ()
    table_parallaxes_m: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.kind not in get_args(LawKind):
            raise InputError(f"must be one of {', '.join(get_args(LawKind))}", field="law", value=self.kind)
        for name in ("base_m", "w0_m"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InputError("must be a positive number", field=f"law.{name}", value=value)
        if not math.isfinite(self.reference_m):
            raise InputError("must be a finite number", field="law.reference_m", value=self.reference_m)
        object.__setattr__(self, "table_heights_m", tuple(float(h) for h in self.table_heights_m))
        object.__setattr__(self, "table_parallaxes_m", tuple(float(q) for q in self.table_parallaxes_m))
        if self.kind == "table":
            _require_rising_table(self.table_heights_m, self.table_parallaxes_m)
        elif self.table_heights_m or self.table_parallaxes_m:
            raise InputError("a table belongs to the law 'table' only", field="law", value=self.kind)

    @classmethod
    def from_table(
        cls,
        heights_m: Sequence[float],
        parallaxes_m: Sequence[float],
        *,
        base_m: float,
        w0_m: float,
        reference_m: float = 0.0,
    ) -> ParallaxLaw:
        """A law through points: heights above the reference level and their parallaxes, both rising."""
        return cls("table", base_m, w0_m, reference_m, tuple(heights_m), tuple(parallaxes_m))

    def kernel_parameters(self) -> tuple[int, Floats]:
        """(code, parameters) for ``stereomate.parallax.kernels``."""
        heights, parallaxes = np.array(self.table_heights_m), np.array(self.table_parallaxes_m)
        head = [self.base_m, self.w0_m, self.reference_m, float(heights.size)]
        slopes = monotone_slopes(heights, parallaxes) if heights.size else heights
        return _CODES[self.kind], np.concatenate([head, heights, parallaxes, slopes])

    def q(self, height: ArrayLike) -> Floats:
        """Artificial parallax, ground metres; NaN at and above the flying height (not for linear, table)."""
        return self._evaluate(kernels.q_of_heights, height)

    def inverse(self, q: ArrayLike) -> Floats:
        """Height whose artificial parallax is ``q`` metres; NaN where there is none."""
        return self._evaluate(kernels.heights_of_q, q)

    def slope(self, height: ArrayLike) -> Floats:
        """dq/dh, metres of parallax per metre of height."""
        return self._evaluate(kernels.slopes, height)

    def limit_slope(self, height: ArrayLike) -> Floats:
        """Steepest rise of the ground along the rows, dh/du = 1 / (dq/dh), before the stereomate folds."""
        with np.errstate(divide="ignore"):
            return np.asarray(1.0 / self.slope(height))

    def height_per_pixel(self, height: ArrayLike, gsd_m: float) -> Floats:
        """Change of height that shows as one pixel of parallax, metres."""
        return self.limit_slope(height) * gsd_m

    def _evaluate(self, function: Callable[..., None], values: ArrayLike) -> Floats:
        array = np.asarray(values, np.float64)
        out = np.empty(array.size)
        function(*self.kernel_parameters(), np.ascontiguousarray(array).ravel(), out)
        return out.reshape(array.shape)

    def as_record(self) -> dict[str, Any]:
        """Plain values for a file; `law_from_record` reads them."""
        record: dict[str, Any] = {
            "kind": self.kind,
            "base_m": self.base_m,
            "w0_m": self.w0_m,
            "reference_m": self.reference_m,
        }
        if self.kind == "table":
            record["table_heights_m"] = list(self.table_heights_m)
            record["table_parallaxes_m"] = list(self.table_parallaxes_m)
        return record


def law_from_record(record: dict[str, Any], *, file: object | None = None) -> ParallaxLaw:
    """The law of a record made by `ParallaxLaw.as_record`.

    Raises
    ------
    InputError
        If keys are missing or unknown, or the values break the rules of `ParallaxLaw`.
    """
    required = {"kind", "base_m", "w0_m", "reference_m"}
    allowed = required | {"table_heights_m", "table_parallaxes_m"}
    if not required <= record.keys() <= allowed:
        raise InputError(
            f"must have the keys {', '.join(sorted(required))} (and those of a table)",
            file=file,
            field="law",
            value=sorted(record),
        )
    return ParallaxLaw(**record)


def monotone_slopes(heights: Floats, parallaxes: Floats) -> Floats:
    """Slopes at the knots of a monotone cubic through rising points (Fritsch & Butland 1984, as PCHIP).

    All are positive: where PCHIP sets an end slope to zero, a third of the secant is taken instead, which is
    monotone too, so that the law stays invertible and extends beyond its ends.
    """
    steps = np.diff(heights)
    secants = np.diff(parallaxes) / steps
    if secants.size == 1:
        return np.repeat(secants, 2)
    slopes = np.empty(heights.size)
    weight_left, weight_right = 2 * steps[1:] + steps[:-1], steps[1:] + 2 * steps[:-1]
    slopes[1:-1] = (weight_left + weight_right) / (weight_left / secants[:-1] + weight_right / secants[1:])
    slopes[0] = _end_slope(steps[0], steps[1], secants[0], secants[1])
    slopes[-1] = _end_slope(steps[-1], steps[-2], secants[-1], secants[-2])
    return slopes


def _end_slope(step: float, inner_step: float, secant: float, inner_secant: float) -> float:
    three_point = ((2 * step + inner_step) * secant - step * inner_secant) / (step + inner_step)
    return float(min(max(three_point, secant / 3.0), 3.0 * secant))


def _require_rising_table(heights: tuple[float, ...], parallaxes: tuple[float, ...]) -> None:
    if len(heights) != len(parallaxes) or len(heights) < 2:
        raise InputError(
            "a table needs two or more heights and as many parallaxes",
            field="law.table",
            value=(len(heights), len(parallaxes)),
        )
    for name, values in (("heights", heights), ("parallaxes", parallaxes)):
        if not all(map(math.isfinite, values)) or not all(a < b for a, b in pairwise(values)):
            raise InputError("must be finite and strictly rising", field=f"law.table_{name}_m", value=values)
