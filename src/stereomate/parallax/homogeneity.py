"""Homogeneity relaxation in photo coordinates and relative heights: equations (12) to (17) and Table 1.

Jachimski 1980, for a base along the rows (By = Bz = 0). The linear form (16) is misprinted in the scan of
the paper; the natural one is not in it. Both follow from (7), (11) and (12).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import InputError

Floats = NDArray[np.float64]
RelativeLaw = Literal["logarithmic", "linear", "natural", "none"]


def homogeneity(
    x_mm: ArrayLike,
    y_mm: ArrayLike,
    principal_distance_mm: ArrayLike,
    base_mm: ArrayLike,
    level: ArrayLike,
    object_height: ArrayLike,
    slope_x_deg: ArrayLike,
    slope_y_deg: ArrayLike,
    law: RelativeLaw = "logarithmic",
) -> tuple[Floats, Floats]:
    """How far the residual parallax of an object is from what it would be on level ground.

    All array arguments broadcast against each other.

    Parameters
    ----------
    x_mm, y_mm : array_like
        Photo coordinates of the terrain point in the left photograph, from the nadir; x along the base.
    principal_distance_mm : array_like
    base_mm : array_like
        Base in the scale of the photograph, Bx c / w0.
    level : array_like
        Height of the terrain point above the reference level over the flying height, h_T / w0.
    object_height : array_like
        Height of the object over the flying height, Δh / w0; 0 is the limit of low objects.
    slope_x_deg, slope_y_deg : array_like
        Slope of the terrain along and across the base, positive where it rises.
    law : {"logarithmic", "linear", "natural", "none"}
        Artificial parallax of the stereomate; "none" is a pair of orthophotos.

    Returns
    -------
    t_x, t_y : ndarray
        Fractions of the ideal parallax: Δp_x / Δp°° - 1 and Δp_y / Δp°°. NaN where a ray of the object point
        does not meet the plane of the terrain.

    Raises
    ------
    InputError
        If the law is unknown, or a principal distance or base is not positive.
    """
    if law not in get_args(RelativeLaw):
        raise InputError(f"must be one of {', '.join(get_args(RelativeLaw))}", field="law", value=law)
    x, y, c, b, d, gk = (
        np.asarray(value, np.float64)
        for value in (x_mm, y_mm, principal_distance_mm, base_mm, level, object_height)
    )
    for name, value in (("principal_distance_mm", c), ("base_mm", b)):
        if not (value > 0.0).all():
            raise InputError("must be positive", field=name, value=float(value.min()))
    tan_x = np.tan(np.radians(np.asarray(slope_x_deg, np.float64)))
    tan_y = np.tan(np.radians(np.asarray(slope_y_deg, np.float64)))
    below = 1.0 - d  # the terrain point under the flying height
    top = below - gk  # the object point under the flying height
    a = x * tan_x + y * tan_y + c * top / below
    denominator = a * below - b * tan_x
    met = (a > 0.0) & (denominator > 0.0) & (top > 0.0)
    a, denominator = np.where(met, a, np.nan), np.where(met, denominator, np.nan)
    t_p = 1.0 - top * c / denominator
    t_x = (
        top * c * (1.0 / denominator - x * tan_x / (a * denominator)) + _artificial(law, t_p, below, gk) - 1.0
    )
    t_y = -top * c * y * tan_x / (a * denominator)
    return np.asarray(t_x), np.asarray(t_y)


def _artificial(law: RelativeLaw, t_p: Floats, below: Floats, gk: Floats) -> Floats:
    """t_q: difference of artificial parallax over the ideal parallax."""
    top = below - gk
    if law == "none":
        return np.zeros_like(t_p)
    if law == "linear":
        return np.asarray(top * t_p)
    if law == "natural":
        under = below - gk * t_p  # the ground behind the object; above the flying height the law has no value
        return np.asarray(top * t_p / (below * np.where(under > 0.0, under, np.nan)))
    # -(top / gk) ln(1 - gk t_p / below), whose limit for gk -> 0 is t_p
    low = np.where(gk == 0.0, 1.0, gk)
    with np.errstate(divide="ignore", invalid="ignore"):
        logarithm = np.asarray(-top / low * np.log1p(-gk * t_p / below))
    return np.where(gk == 0.0, t_p, logarithm)


def ideal_parallax_mm(base_mm: ArrayLike, level: ArrayLike, object_height: ArrayLike) -> Floats:
    """Δp°° in the scale of the photograph, (14): b gk / (1 - d - gk)."""
    gk = np.asarray(object_height, np.float64)
    return np.asarray(np.asarray(base_mm) * gk / (1.0 - np.asarray(level) - gk), np.float64)


@dataclass(frozen=True)
class TableCase:
    """A line of a homogeneity table.

    Attributes
    ----------
    principal_distance_mm, format_mm : float
        Camera; the format gives base and points.
    level, object_height : float
        h_T / w0 and Δh / w0.
    """

    principal_distance_mm: float
    format_mm: float
    level: float
    object_height: float

    @property
    def base_mm(self) -> float:
        """Photo base of 60 % overlap."""
        return BASE_SHARE * self.format_mm

    @property
    def points_mm(self) -> Floats:
        """The six points of the stereo model in the left photograph, (6, 2)."""
        return self.format_mm * np.array(_POINTS)


@dataclass(frozen=True, eq=False)
class TableRow:
    """Values of a line: ideal parallax in mm in the scale of the photograph, t_x and t_y at six points."""

    case: TableCase
    ideal_mm: float
    t_x: Floats
    t_y: Floats


BASE_SHARE: Final = 0.4
_HALF_WIDTH: Final = 0.35
_POINTS: Final = (
    (0.0, 0.0),
    (BASE_SHARE, 0.0),
    (0.0, _HALF_WIDTH),
    (0.0, -_HALF_WIDTH),
    (BASE_SHARE, -_HALF_WIDTH),
    (BASE_SHARE, _HALF_WIDTH),
)

# The lines of Table 1 of the paper, for slopes of 20 degrees along and 30 degrees across the base.
PAPER_CASES: Final = tuple(
    TableCase(c, s, d, gk)
    for c, s, d, gk in (
        (152.0, 230.0, 0.1, 0.05),
        (152.0, 230.0, 0.0, 0.05),
        (152.0, 230.0, 0.0, 0.03),
        (152.0, 230.0, 0.0, 0.01),
        (152.0, 230.0, -0.1, 0.05),
        (210.0, 180.0, 0.1, 0.05),
        (210.0, 180.0, 0.0, 0.05),
        (210.0, 180.0, -0.1, 0.05),
    )
)
PAPER_SLOPES_DEG: Final = (20.0, 30.0)


def homogeneity_table(
    cases: Iterable[TableCase] = PAPER_CASES,
    slopes_deg: tuple[float, float] = PAPER_SLOPES_DEG,
    law: RelativeLaw = "logarithmic",
) -> tuple[TableRow, ...]:
    """Homogeneity relaxation at the six points of a stereo model; Table 1 of the paper by default."""
    rows = []
    for case in cases:
        x, y = case.points_mm.T
        t_x, t_y = homogeneity(
            x,
            y,
            case.principal_distance_mm,
            case.base_mm,
            case.level,
            case.object_height,
            *slopes_deg,
            law,
        )
        ideal = float(ideal_parallax_mm(case.base_mm, case.level, case.object_height))
        rows.append(TableRow(case, ideal, t_x, t_y))
    return tuple(rows)


def error_vectors_mm(
    case: TableCase,
    points_mm: ArrayLike,
    slopes_deg: tuple[float, float],
    law: RelativeLaw,
    enlargement: float,
) -> Floats:
    """Errors of the residual parallax as vectors in the scale of the map, as in Fig. 2 of the paper.

    Parameters
    ----------
    case : TableCase
    points_mm : array_like (..., 2)
        Photo coordinates of terrain points.
    slopes_deg : (float, float)
    law : str
    enlargement : float
        Scale of the orthophoto over that of the photograph, w0 / (c M0).

    Returns
    -------
    ndarray (..., 2)
        (t_x, t_y) Δp°°, mm.
    """
    points = np.asarray(points_mm, np.float64)
    t_x, t_y = homogeneity(
        points[..., 0],
        points[..., 1],
        case.principal_distance_mm,
        case.base_mm,
        case.level,
        case.object_height,
        *slopes_deg,
        law,
    )
    ideal = ideal_parallax_mm(case.base_mm, case.level, case.object_height) * enlargement
    return np.stack([t_x, t_y], axis=-1) * ideal
