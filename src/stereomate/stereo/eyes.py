"""Which positions belong to which eye: whether orthophoto and stereomate were exchanged."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.errors import InputError
from stereomate.rectify.job import RectifyJob
from stereomate.stereo.exact import GroundPoints
from stereomate.stereo.surface import JobSurface

Floats = NDArray[np.float64]

# Points on the ground fit the right way round by so many times better than the wrong one.
_BETTER: Final = 4.0
# Above the reference level exchanged eyes always fit worse: pixels that no noise makes.
_TOLD_PX: Final = 3.0
# Else objects may show as much as exchanged eyes do; none shows more than a tenth of the flying height.
_TALLEST: Final = 0.1


def checked_positions(xy: ArrayLike, name: str) -> Floats:
    """Map positions as an array (n, 2).

    Raises
    ------
    InputError
        If they are of another shape, or not finite.
    """
    array = np.asarray(xy, np.float64)
    if array.ndim == 1:
        array = array[None]
    if array.ndim != 2 or array.shape[1] != 2:
        raise InputError("must be map positions (n, 2)", field=name, value=array.shape)
    if not np.isfinite(array).all():
        raise InputError("must be finite", field=name)
    return array


def require_left_is_left(
    job: RectifyJob, surface: JobSurface, left: GroundPoints, left_uv: Floats, right_uv: Floats
) -> None:
    """Exchanged products show parallaxes of the wrong sign: then most points fit only the other way round.

    With q of the ground and p of the object, the right order leaves p and the wrong one 2 q + p: where q is
    above 0 that is always more. Where the ground lies at the reference level nothing can be told.

    Raises
    ------
    InputError
        If the eyes are exchanged.
    """
    parallax = left_uv[:, 0] - right_uv[:, 0]
    q = job.law.q(left.uvh[:, 2])
    as_said = np.abs(parallax - q)
    exchanged = np.abs(-parallax - job.law.q(surface.heights(right_uv)[:, 0]))
    known = np.isfinite(as_said) & np.isfinite(exchanged)
    if not known.any():
        return
    far = _TOLD_PX * job.grid.gsd if (q[known] > 0.0).all() else _TALLEST * job.law.base_m
    if np.median(as_said[known]) > max(far, _BETTER * float(np.median(exchanged[known]))):
        raise InputError(
            "must be positions on the orthophoto, and right_xy those on the stereomate: the sign of the "
            "parallaxes says that they are exchanged",
            field="left_xy",
            value=f"median parallax {float(np.median(parallax[known])):.2f}",
        )
