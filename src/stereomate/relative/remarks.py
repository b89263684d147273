"""What a reader should know of a relative orientation besides its numbers, in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.relative.diagnosis import GeometryDiagnosis
from stereomate.relative.orientation import RelativeOrientation

# Beyond these the orientation is possible, but more often something else is wrong.
_LARGE_SIGMA0: Final = 3.0
_STEEP_BASE: Final = 0.5
_NEARLY_CRITICAL: Final = 60.0
_MOST_NAMES: Final = 20


def remarks(orientation: RelativeOrientation, names: Sequence[str] | None = None) -> tuple[str, ...]:
    """Remarks on a determined orientation; none where it is not, for then its reasons say enough.

    Parameters
    ----------
    orientation : RelativeOrientation
    names : sequence of str, optional
        Of the correspondences: points that were left out are named.
    """
    if not orientation.determined:
        return ()
    said = []
    if orientation.adjustment.redundancy == 0:
        said.append("five points have no redundancy: an error in one of them cannot be seen")
    said += _about_the_geometry(orientation.diagnosis)
    said += _about_the_base(orientation.pose.base)
    said += _about_the_noise(orientation)
    if names is not None:
        said += _left_out(names, orientation.used)
    return tuple(said)


def _about_the_geometry(diagnosis: GeometryDiagnosis | None) -> list[str]:
    if diagnosis is None:
        return []
    said = []
    if diagnosis.planar:
        said.append(
            "the points lie on one plane within their noise; the orientation is determined all the same, "
            "because the second solution of a plane has points behind a camera"
        )
    if diagnosis.inflation_omega > _NEARLY_CRITICAL:
        said.append(
            "the points are near a critical cylinder: the tilt round the base is "
            f"{diagnosis.inflation_omega:.0f} times worse known than by itself"
        )
    return said


def _about_the_base(base: NDArray[np.float64]) -> list[str]:
    said = []
    if base[0] < -0.5:
        said.append(
            "the right photograph lies to the left of the left one (exchanged? or stored upside down): the "
            "elements hold for the order given"
        )
    if abs(base[2]) > _STEEP_BASE:
        inclination = math.degrees(math.asin(min(1.0, abs(float(base[2])))))
        said.append(
            f"the base is inclined by {inclination:.0f}° to the left photograph: unless that is so, one "
            "principal distance or the unit of one photograph is wrong"
        )
    return said


def _about_the_noise(orientation: RelativeOrientation) -> list[str]:
    if not orientation.sigma0 > _LARGE_SIGMA0:
        return []
    c = orientation.adjustment.correspondences
    stated = math.sqrt(sum(sigma * sigma for sigma in c.sigmas) / 2.0)
    times = f"{orientation.sigma0:.1f} times what a standard deviation of {stated:.3g} {c.unit} allows"
    causes = "larger errors than stated, gross errors, another principal distance or other units"
    return [f"the residuals are {times}: {causes}"]


def _left_out(names: Sequence[str], used: NDArray[np.bool_]) -> list[str]:
    out = [names[int(row)] for row in np.flatnonzero(~used)]
    if not out:
        return []
    shown = ", ".join(out[:_MOST_NAMES]) + (
        f" and {len(out) - _MOST_NAMES} more" if len(out) > _MOST_NAMES else ""
    )
    return [f"{len(out)} of {len(names)} points do not agree with the others and are left out: {shown}"]
