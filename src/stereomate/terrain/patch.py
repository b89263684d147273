"""A window of a height model in memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import InputError
from stereomate.terrain import kernels

Floats = NDArray[np.float64]
Interpolation = Literal["bilinear", "cubic"]


@dataclass(frozen=True, eq=False)
class SurfacePatch:
    """Heights of a window of a height model.

    Attributes
    ----------
    heights : ndarray of float64, shape (rows, cols)
        NaN = void or outside the model.
    col0, row0 : int
        Pixel of the model that ``heights[0, 0]`` is; may be negative.
    """

    heights: Floats
    col0: int = 0
    row0: int = 0

    @property
    def is_void(self) -> bool:
        """Whether there is no height at all."""
        return bool(np.isnan(self.heights).all())

    @property
    def range(self) -> tuple[float, float]:
        """Lowest and highest node; (inf, -inf) where all is void."""
        if self.is_void:
            return np.inf, -np.inf
        return float(np.nanmin(self.heights)), float(np.nanmax(self.heights))

    def sample(self, cols: ArrayLike, rows: ArrayLike, method: Interpolation = "bilinear") -> Floats:
        """Heights at pixel coordinates of the model (centres at +0.5); NaN outside and at voids."""
        col, row = np.broadcast_arrays(np.asarray(cols, np.float64), np.asarray(rows, np.float64))
        out = np.empty(col.size)
        function = sampler(method)
        function(self.heights, (col - self.col0).ravel(), (row - self.row0).ravel(), out)
        return out.reshape(col.shape)


def sampler(method: str) -> kernels.Sampler:
    """The kernel that samples scattered points by a method.

    Raises
    ------
    InputError
        If the method is neither "bilinear" nor "cubic".
    """
    if method == "bilinear":
        return kernels.bilinear_points
    if method == "cubic":
        return kernels.cubic_points
    raise InputError("must be 'bilinear' or 'cubic'", field="heights interpolation", value=method)
