"""Which law suits a block: what each choice means for viewing, folding and the heights it makes one read.

A block has many models, a product one law. On level ground at height h a model with base B_i, azimuth δ_i off
the rows and centres Z_i above the ground shows an object of height Δh with the parallax B_i cos δ_i
Δh / (Z_i - Δh); the law turns it into a height. The better q'(h) follows B_i cos δ_i / Z_i over the area, the
truer the reading; nothing says that the logarithmic law follows it best.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import InputError
from stereomate.parallax.laws import LawKind, ParallaxLaw

Floats = NDArray[np.float64]

# Disparities within one degree are viewed without strain (Lambooij et al. 2009, J. Imaging Sci. Technol. 53).
COMFORT_DEG: Final = 1.0
# Laws whose reading errors differ by less (fraction of the object height) count as equally true: as much as
# the logarithmic law costs where it is exact for low objects.
_EQUALLY_TRUE: Final = 0.01
# A law that folds on more of the ground than this is not recommended while another folds on less.
_FOLDED_SHARE: Final = 0.001
# A fitted table that is off by more shows that the models differ among each other.
_NO_LAW_SUITS: Final = 0.05
_TABLE_KNOTS: Final = 12


@dataclass(frozen=True)
class Screen:
    """Where the product is looked at.

    Attributes
    ----------
    pixel_mm : float
        Size of a pixel of the product on the screen.
    distance_mm : float
        From the eyes to the screen.
    """

    pixel_mm: float = 0.25
    distance_mm: float = 600.0

    def __post_init__(self) -> None:
        for name in ("pixel_mm", "distance_mm"):
            if not getattr(self, name) > 0.0:
                raise InputError("must be positive", field=f"screen.{name}", value=getattr(self, name))

    def degrees(self, parallax_px: ArrayLike) -> Floats:
        """Angle between the eyes' lines that a difference of parallax makes."""
        half = 0.5 * np.asarray(parallax_px, np.float64) * self.pixel_mm / self.distance_mm
        return np.asarray(2.0 * np.degrees(np.arctan(half)))


@dataclass(frozen=True, eq=False)
class BlockSamples:
    """Ground positions of a block and the model that serves each.

    Attributes
    ----------
    heights_m : ndarray (n,)
        Of the ground, height system of the law.
    base_along_m : ndarray (n,)
        B_i cos δ_i: base of the serving model along the rows.
    depth_m : ndarray (n,)
        Z_i: height of its centres above this ground.
    slopes : ndarray (n,)
        Rise of the ground along the rows, dh/du.

    Raises
    ------
    InputError
        If sizes differ, there is no sample, or a base or a depth is not positive.
    """

    heights_m: Floats
    base_along_m: Floats
    depth_m: Floats
    slopes: Floats

    def __post_init__(self) -> None:
        for name in ("heights_m", "base_along_m", "depth_m", "slopes"):
            values = np.asarray(getattr(self, name), np.float64)
            object.__setattr__(self, name, values)
            if values.shape != (self.heights_m.size,) or values.size == 0 or not np.isfinite(values).all():
                raise InputError(
                    "must be flat arrays of one size, finite, not empty",
                    field=f"block.{name}",
                    value=values.shape,
                )
        for name in ("base_along_m", "depth_m"):
            if not (getattr(self, name) > 0.0).all():
                raise InputError(
                    "must be positive", field=f"block.{name}", value=float(getattr(self, name).min())
                )

    def object_parallax(self, object_height_m: float) -> Floats:
        """Parallax along the rows of an object on level ground at each position, metres."""
        return np.asarray(self.base_along_m * object_height_m / (self.depth_m - object_height_m))


@dataclass(frozen=True)
class LawAssessment:
    """What a law means for a block.

    Attributes
    ----------
    law : ParallaxLaw
    parallax_px : (float, float)
        Least and largest artificial parallax over the ground.
    range_px, range_deg : float
        Between them, in pixels and as an angle on the screen.
    comfortable : bool
        Whether the whole range stays within one degree.
    height_per_pixel_m : (float, float)
        Change of height that shows as one pixel: least and largest over the ground.
    limit_slope : float
        Rise along the rows at which the stereomate folds, at the height where that is least.
    folded : float
        Share of the ground that is steeper than that at its height.
    error_mean, error_rms, error_max : float
        Error of the height of an object on level ground read through the law, fraction of its height.
    within_5_percent : float
        Share of the ground where it stays below 5 %.
    """

    law: ParallaxLaw
    parallax_px: tuple[float, float]
    range_px: float
    range_deg: float
    comfortable: bool
    height_per_pixel_m: tuple[float, float]
    limit_slope: float
    folded: float
    error_mean: float
    error_rms: float
    error_max: float
    within_5_percent: float


@dataclass(frozen=True)
class LawChoice:
    """The alternatives and the one that is recommended, with reasons.

    Attributes
    ----------
    assessments : tuple of LawAssessment
        Linear, logarithmic, natural, and the fitted table.
    recommended : LawAssessment
    reasons : tuple of str
        Sentences.
    """

    assessments: tuple[LawAssessment, ...]
    recommended: LawAssessment
    reasons: tuple[str, ...]


def read_object_heights(law: ParallaxLaw, block: BlockSamples, object_height_m: float) -> Floats:
    """Height that a law makes one read for an object on level ground at each position, metres."""
    shown = law.q(block.heights_m) + block.object_parallax(object_height_m)
    return np.asarray(law.inverse(shown) - block.heights_m)


def assess_law(
    law: ParallaxLaw, block: BlockSamples, gsd_m: float, screen: Screen, object_height_m: float = 20.0
) -> LawAssessment:
    """What a law means for a block.

    Parameters
    ----------
    law : ParallaxLaw
    block : BlockSamples
    gsd_m : float
        Pixel of the product.
    screen : Screen
    object_height_m : float
        Height of the objects whose reading is judged.

    Raises
    ------
    InputError
        If the pixel or the object height is not positive, or a model is not above such objects.
    """
    _check(block, gsd_m, object_height_m)
    q = law.q(block.heights_m) / gsd_m
    per_pixel = law.height_per_pixel(block.heights_m, gsd_m)
    limit = law.limit_slope(block.heights_m)
    error = read_object_heights(law, block, object_height_m) / object_height_m - 1.0
    low, high = float(q.min()), float(q.max())
    degrees = float(screen.degrees(high - low))
    return LawAssessment(
        law=law,
        parallax_px=(low, high),
        range_px=high - low,
        range_deg=degrees,
        comfortable=degrees <= COMFORT_DEG,
        height_per_pixel_m=(float(per_pixel.min()), float(per_pixel.max())),
        limit_slope=float(limit.min()),
        folded=float(np.mean(block.slopes >= limit)),
        error_mean=float(error.mean()),
        error_rms=float(np.sqrt(np.mean(error**2))),
        error_max=float(error[np.abs(error).argmax()]),
        within_5_percent=float(np.mean(np.abs(error) <= 0.05)),
    )


def fitted_law(
    block: BlockSamples, base_m: float, w0_m: float, reference_m: float, object_height_m: float = 20.0
) -> ParallaxLaw:
    """The monotone table that makes objects read most truly: least squares of relative errors.

    At each height the best slope of a law against wanted slopes w is Σw² / Σw; heights are taken in
    classes of equal area.
    """
    wanted = block.base_along_m / (block.depth_m - object_height_m)
    middle = block.heights_m + 0.5 * object_height_m
    order = np.argsort(middle, kind="stable")
    classes = np.array_split(order, min(_TABLE_KNOTS, max(1, order.size // 20)))
    heights = np.array([middle[part].mean() for part in classes])
    best = np.array([np.sum(wanted[part] ** 2) / np.sum(wanted[part]) for part in classes])
    relief = max(float(np.ptp(middle)), 1.0)
    keep = np.append(True, np.diff(heights) > 1e-3 * relief)
    ends = float(middle.min()) - 0.5 * relief, float(middle.max()) + 0.5 * relief
    knots = np.concatenate([[ends[0]], heights[keep], [ends[1]]])
    slopes = np.interp(knots, heights[keep], best[keep])
    q = np.concatenate([[0.0], np.cumsum(0.5 * (slopes[1:] + slopes[:-1]) * np.diff(knots))])
    table = ParallaxLaw("table", base_m, w0_m, reference_m, tuple(knots - reference_m), tuple(q))
    zero = float(table.q(reference_m))
    return ParallaxLaw("table", base_m, w0_m, reference_m, tuple(knots - reference_m), tuple(q - zero))


def choose_law(
    block: BlockSamples,
    nominal: tuple[float, float, float],
    gsd_m: float,
    screen: Screen | None = None,
    object_height_m: float = 20.0,
) -> LawChoice:
    """All laws assessed for a block, and the one to take.

    Parameters
    ----------
    block : BlockSamples
    nominal : (base_m, w0_m, reference_m)
        Nominal values of the product.
    gsd_m, screen, object_height_m
        As `assess_law`.
    """
    _check(block, gsd_m, object_height_m)
    screen = screen or Screen()
    kinds: tuple[LawKind, ...] = ("linear", "logarithmic", "natural")
    laws = [ParallaxLaw(kind, *nominal) for kind in kinds]
    laws.append(fitted_law(block, *nominal, object_height_m))
    highest = float(block.heights_m.max())
    laws = [law for law in laws if np.isfinite(law.q(highest))]
    found = tuple(assess_law(law, block, gsd_m, screen, object_height_m) for law in laws)
    least_folded = min(a.folded for a in found)
    flat = [a for a in found if a.folded <= max(_FOLDED_SHARE, least_folded)]
    truest = min(a.error_rms for a in flat)
    # of those that are equally true the best known is taken
    preference = ("logarithmic", "linear", "natural", "table")
    equal = [a for a in flat if a.error_rms <= truest + _EQUALLY_TRUE]
    best = min(equal, key=lambda a: preference.index(a.law.kind))
    return LawChoice(found, best, _reasons(found, best, object_height_m))


def _check(block: BlockSamples, gsd_m: float, object_height_m: float) -> None:
    for name, value in (("gsd_m", gsd_m), ("object_height_m", object_height_m)):
        if not value > 0.0:
            raise InputError("must be positive", field=name, value=value)
    if not (block.depth_m > object_height_m).all():
        raise InputError(
            "must be less than the height of the centres above the ground",
            field="object_height_m",
            value=object_height_m,
        )


def _reasons(
    found: tuple[LawAssessment, ...], best: LawAssessment, object_height_m: float
) -> tuple[str, ...]:
    errors = ", ".join(f"{a.law.kind} {a.error_rms:.1%}" for a in found)
    reasons = [
        f"heights of {object_height_m:g} m objects on level ground are read with an rms error of: {errors}"
    ]
    if best.error_rms <= min(a.error_rms for a in found) + 1e-12:
        reasons.append(f"the {best.law.kind} law reads them most truly")
    elif all(a.folded <= best.folded + _FOLDED_SHARE for a in found):
        reasons.append(
            f"the {best.law.kind} law is as true as any other within {_EQUALLY_TRUE:.1%}, and well known"
        )
    for a in found:
        if a.folded > max(_FOLDED_SHARE, best.folded):
            reasons.append(f"the {a.law.kind} law folds on {a.folded:.1%} of the ground")
    if best.folded > 0.0:
        reasons.append(
            f"it folds on {best.folded:.2%} of the ground: where that rises by {best.limit_slope:.2f} "
            "and more along the rows"
        )
    if not best.comfortable:
        share = COMFORT_DEG / best.range_deg
        reasons.append(
            f"its parallaxes span {best.range_deg:.1f} degrees on this screen, more than {COMFORT_DEG:g}: "
            f"a base of {best.law.base_m * share:.0f} m, a smaller zoom or a cursor that moves with the "
            "terrain brings them back"
        )
    table = found[-1]
    if table.error_rms > _NO_LAW_SUITS:
        reasons.append(
            f"no law of height alone suits all models: even the fitted one is off by {table.error_rms:.0%}, "
            "as models at one height differ in base over flying height; measure through the photographs"
        )
    return tuple(reasons)
