"""Folds of a stereomate along its rows, and the exact inverse of x - q(h(x))."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import InputError
from stereomate.parallax import kernels
from stereomate.parallax.laws import ParallaxLaw

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Fold:
    """Ground that a stereomate does not show, though nothing is missing in the raster.

    Attributes
    ----------
    hidden_x : (float, float)
        Ground along the row that does not appear.
    hiding_x : (float, float)
        Higher ground that appears in its place.
    u : (float, float)
        Where in the stereomate: the branches overlap there.
    """

    hidden_x: tuple[float, float]
    hiding_x: tuple[float, float]
    u: tuple[float, float]

    @property
    def width_m(self) -> float:
        """Extent of the overlap in the stereomate."""
        return self.u[1] - self.u[0]


@dataclass(frozen=True, eq=False)
class RowProfile:
    """The ground along one row of a product under a parallax law: forward map and its inverse.

    Attributes
    ----------
    law : ParallaxLaw
    x : ndarray (n,)
        Positions along the row, rising, metres.
    heights : ndarray (n,)
        Height system of the law; linear in between, NaN = void.

    Raises
    ------
    InputError
        If there are fewer than two positions, or they do not rise.
    """

    law: ParallaxLaw
    x: Floats
    heights: Floats

    def __post_init__(self) -> None:
        for name in ("x", "heights"):
            values = np.ascontiguousarray(getattr(self, name), np.float64)
            object.__setattr__(self, name, values)
        if self.x.ndim != 1 or self.x.shape != self.heights.shape or self.x.size < 2:
            raise InputError(
                "must be two flat arrays of one size, 2 or more", field="profile", value=self.x.shape
            )
        if not (np.isfinite(self.x).all() and (np.diff(self.x) > 0).all()):
            raise InputError("positions must rise", field="profile.x")

    def forward(self, positions: ArrayLike) -> Floats:
        """u = x - q(h(x)); NaN off the profile and in voids."""
        at = np.asarray(positions, np.float64)
        height = np.interp(at, self.x, self.heights, left=np.nan, right=np.nan)
        return np.asarray(at - self.law.q(height), np.float64)

    def inverse(self, u: ArrayLike) -> Floats:
        """The position that the stereomate shows at u: where it folds, the highest ground.

        NaN where there is none, and where the profile ends in a fold: higher ground may hide what is known.
        """
        values = np.asarray(u, np.float64)
        out = np.empty(values.size)
        code, parameters = self.law.kernel_parameters()
        flat = np.ascontiguousarray(values).ravel()
        kernels.winners(code, parameters, self.x, self.heights, self._pieces, flat, out)
        return out.reshape(values.shape)

    def hidden(self, positions: ArrayLike) -> NDArray[np.bool_]:
        """Whether positions do not appear in the stereomate: hidden by its fold, off the profile, or void."""
        at = np.asarray(positions, np.float64)
        out = np.empty(at.size, np.bool_)
        kernels.hidden_positions(self._pieces, np.ascontiguousarray(at).ravel(), out)
        return out.reshape(at.shape)

    @property
    def folds(self) -> tuple[Fold, ...]:
        """All folds, in the order of the row. Ground hidden across a void is not among them."""
        folds = []
        pieces = self._pieces[::-1]
        for before, after in pairwise(pieces):
            first, last = int(before[4]), int(after[4])
            if before[1] < after[0] and np.isfinite(self.heights[first : last + 2]).all():
                folds.append(self._fold(float(before[1]), float(after[0])))
        return tuple(folds)

    def _fold(self, start: float, end: float) -> Fold:
        """The fold of hidden ground: it reaches to where the ground behind shows the largest u of it."""
        code, parameters = self.law.kernel_parameters()
        low = float(self.forward(end))
        high = float(kernels.highest_u(code, parameters, self.x, self.heights, start, end))
        behind = float(self.inverse(min(high, float(self._pieces[0, 3]))))
        return Fold((start, end), (end, behind), (low, high))

    @cached_property
    def _pieces(self) -> Floats:
        code, parameters = self.law.kernel_parameters()
        return np.asarray(kernels.visible_pieces(code, parameters, self.x, self.heights))


def fold_ratio(law: ParallaxLaw, heights: ArrayLike, step_m: float) -> Floats:
    """q'(h) dh/du of heights on a product grid (..., columns): the stereomate folds where it exceeds 1.

    Differences between neighbours along the rows, in both directions, the steeper one; NaN at voids.

    Parameters
    ----------
    law : ParallaxLaw
    heights : array_like (..., n)
        Along the rows of the product, in the height system of the law.
    step_m : float
        Distance of the columns.
    """
    array = np.asarray(heights, np.float64)
    rise = np.diff(array, axis=-1) / step_m
    edge = np.full((*array.shape[:-1], 1), -np.inf)
    steepest = np.maximum(np.concatenate([edge, rise], axis=-1), np.concatenate([rise, edge], axis=-1))
    return np.asarray(law.slope(array) * steepest, np.float64)
